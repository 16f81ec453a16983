"""Sentences say names where elements and tasks have them, in every language; an id only where there is none, or several have it."""

from __future__ import annotations

import pytest

from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.building import labels, with_names

A, B, C = "2bFxRhcgPGFBoAYN2TZ93k", "3aFxRhcgPGFBoAYN2TZ93$", "0SM9YtqojL6QaI3LlZjDF4"
KNOWN = labels({A: "Stud 1", B: "Brick", C: "Brick", f"{A}/2": "Drill stud 1", "#123": ""})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{A} waits", "'Stud 1' waits"),
        (f"'{A}' waits for {A}, {B}", f"'Stud 1' waits for 'Stud 1', 'Brick' ({B})"),
        (f"{A}/0 would touch floor/1", "'Stud 1' would touch floor/1"),
        (f"after {A}/2", "after 'Drill stud 1'"),
        ("line #123, 'x' (y)", "line #123, 'x' (y)"),
    ],
)
def test_names_stand_where_ids_were(text, said):
    assert with_names(text, KNOWN) == said


def test_a_sentence_names_its_values():
    said = with_names(Sentence("{task} waits for {tasks}", task=A, tasks=f"'{A}'"), KNOWN)
    assert said == "'Stud 1' waits for 'Stud 1'" and said.values == {"task": "'Stud 1'", "tasks": "'Stud 1'"}
