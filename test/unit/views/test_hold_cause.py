"""Why the arm holds, as a person reads it on every screen."""

from __future__ import annotations

import re
import time

import pytest

from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import axis_name
from construction_twin.views.hold_cause import hold_cause

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


def test_a_difference_names_axis_difference_what_is_allowed_and_since_when(utc):
    said = hold_cause(HoldReport("joint_a3 differs by 0.013177 rad, threshold 0.010000 rad", SINCE))
    assert isinstance(said, Sentence)
    assert said == "A3 is 0.755 deg from the twin, 0.573 deg allowed, since 17:46:37"


@pytest.mark.parametrize(
    "difference, threshold, unit",
    [(0.011834, 0.011830, "rad"), (0.011833, 0.011833, "rad"), (0.0050001, 0.005, "m")],
)
def test_a_difference_reads_as_more_than_what_is_allowed(utc, difference, threshold, unit):
    cause = f"joint_a3 differs by {difference:.6f} {unit}, threshold {threshold:.6f} {unit}"
    said = hold_cause(HoldReport(cause, SINCE))
    shown = re.findall(r"\d+\.\d+", said.partition("since")[0])
    assert len(shown) == 2 and shown[0] > shown[1], said
    assert said.values["difference"].value == pytest.approx(difference, abs=2e-5)
