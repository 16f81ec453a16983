"""Why the arm holds, as a person reads it on every screen."""

from __future__ import annotations

import time

import pytest

from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import axis_name
from construction_twin.views.texts import hold_cause

SINCE = 1_795_369_597_396_012_345


@pytest.fixture
def utc(monkeypatch):
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize(
    "joint, said",
    [
        ("joint_a3", "A3"),
        ("joint_e1", "E1"),
        ("track", "track"),
        ("panda_joint3", "panda_joint3"),
        ("joint_a33", "joint_a33"),
    ],
)
def test_an_axis_has_the_name_that_stands_on_the_pendant(joint, said):
    assert axis_name(joint) == said


def test_it_names_the_cause_and_since_when_and_keeps_the_words_for_another_language(utc):
    cause = Sentence("{joint} differs by {difference}", joint="A3", difference="0.755 deg")
    said = hold_cause(HoldReport(cause, SINCE))
    assert said == "A3 differs by 0.755 deg, since 17:46:37"
    assert isinstance(said, Sentence) and said.values["reason"] is cause
