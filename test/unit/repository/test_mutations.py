"""The list of mutations: each breaks a line that is there, and names a test that is there."""

from __future__ import annotations

import ast
from pathlib import Path

import mutations

ROOT = Path(__file__).resolve().parents[3]
LISTED = mutations.read(mutations.LIST)


def test_every_listed_line_stands_where_the_list_says():
    moved = []
    for mutation in LISTED:
        try:
            mutation.break_in((mutations.ROOT / "src/construction_twin" / mutation.file).read_text())
        except (OSError, ValueError) as error:
            moved.append(f"{mutation.file}: {mutation.behaviour}: {error}")
    assert moved == []


def test_every_listed_test_is_there():
    missing = [mutation.test for mutation in LISTED if not is_there(mutation.test)]
    assert missing == []


def test_each_mutation_has_a_behaviour_of_its_own():
    assert len({mutation.behaviour for mutation in LISTED}) == len(LISTED) > 100


def is_there(test: str) -> bool:
    file, *names = test.split("::")
    if not (ROOT / "test" / file).exists():
        return False
    body = ast.parse((ROOT / "test" / file).read_text()).body
    for name in names:
        found = [node for node in body if getattr(node, "name", "") == name]
        if not found:
            return False
        body = found[0].body
    return True
