"""Why the arm holds, as a person reads it on every screen."""

from __future__ import annotations

import re
import time

import pytest

from construction_twin.core.axis_name import axis_name
from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Quantity, Sentence
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
    cause = Sentence(
        "reason.gate.differs", joint="joint_a3", difference=Quantity(0.013177, "rad"), threshold=Quantity(0.01, "rad")
    )
    said = hold_cause(HoldReport(str(cause), SINCE))
    assert isinstance(said, Sentence) and said.key == "reason.holds.differs"
    assert (said.values["joint"], said.values["since"]) == ("A3", "17:46:37")
    assert said.values["difference"].value == pytest.approx(0.013177) and said.values["threshold"].value == 0.01


@pytest.mark.parametrize(
    "difference, threshold, unit",
    [(0.011834, 0.011830, "rad"), (0.011833, 0.011833, "rad"), (0.0050001, 0.005, "m")],
)
def test_a_difference_reads_as_more_than_what_is_allowed(utc, difference, threshold, unit):
    values = {"difference": Quantity(difference, unit), "threshold": Quantity(threshold, unit)}
    said = hold_cause(HoldReport(str(Sentence("reason.gate.differs", joint="joint_a3", **values)), SINCE))
    shown = re.findall(r"\d+\.\d+", said.partition("since")[0])
    assert len(shown) == 2 and shown[0] > shown[1], said
    assert said.values["difference"].value == pytest.approx(difference, abs=2e-5)
