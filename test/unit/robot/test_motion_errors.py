"""What people read of a refused motion: degrees and millimetres, as they ask for it; the data stays SI."""

from __future__ import annotations

import math

import pytest

from construction_twin.core.errors import MotionRefused
from construction_twin.kinematics.solution import NotFoundError, OrientationError, PositionRangeError, UnreachableError
from construction_twin.planning.cartesian import FarWaypointError
from construction_twin.planning.ik_branch import CartesianPathError
from construction_twin.planning.recheck import LimitError
from construction_twin.robot.motion_errors import JointRangeError

A3 = "joint_a3", math.radians(155.0), math.radians(-120.0), math.radians(154.0)
TRACK = "track", 2.6, -2.5, 2.5, True


@pytest.mark.parametrize(
    "error, sentence",
    [
        (JointRangeError(*A3), "joint_a3 is 155 deg, outside its range -120 deg to 154 deg"),
        (JointRangeError(*TRACK), "track is 2600 mm, outside its range -2500 mm to 2500 mm"),
        (
            PositionRangeError(*A3),
            "the target's position needs joint_a3 at 155 deg, outside its range -120 deg to 154 deg; move the target",
        ),
        (
            OrientationError(*TRACK),
            "the target's orientation needs track at 2600 mm, outside its range -2500 mm to 2500 mm; turn the target",
        ),
        (UnreachableError(6.54483), "the target is out of the arm's reach by 6544.83 mm; move it closer to the base"),
        (
            LimitError("at 1.2 s", "joint_a3", "velocity", 2.0 * math.pi, math.pi),
            "at 1.2 s: joint_a3 has a velocity of 360 deg/s; its limit is 180 deg/s; plan again",
        ),
        (
            LimitError("at 1.2 s", "track", "position", 2.6, 2.5, True),
            "at 1.2 s: track has a position of 2600 mm; its limit is 2500 mm; plan again",
        ),
        (MotionRefused("range", "joint_a3", A3[1], A3[3]), "joint_a3: range check failed: 155 deg against 154 deg"),
        (MotionRefused("lead", "", 0.6, 0.5, "s"), "lead check failed: 0.6 s against 0.5 s"),
    ],
)
def test_a_refusal_is_in_degrees_and_millimetres(error, sentence):
    assert str(error) == sentence


@pytest.mark.parametrize(
    "error",
    [
        NotFoundError(5, 0.1, 0.01, 0.2),
        CartesianPathError("unreachable", 0.5, 1.25, 1, "x"),
        FarWaypointError(1, "it", 900.0, 2.7),
    ],
)
def test_nor_is_there_a_radian_or_a_metre_in_the_others(error):
    words = str(error).replace(";", " ").replace(",", " ").split()
    assert not {"rad", "m", "metres"} & set(words)
    assert {"mm", "deg"} & set(words)


def test_the_data_stays_si():
    error = JointRangeError(*TRACK)
    assert (error.value, error.lower, error.upper, error.linear) == (2.6, -2.5, 2.5, True)
