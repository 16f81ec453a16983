"""Tolerances as control_msgs means them: 0 is the default, negative is no bound, names decide."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import pytest
from executor_bench import ROBOT

from construction_twin.core.sentences import Quantity
from construction_twin.extensions.planners.joint_tolerances import (
    GoalError,
    GoalJointsError,
    Tolerances,
    check_joint_names,
)

NAMES = ROBOT.joint_names


class Asked(NamedTuple):
    """As control_msgs/JointTolerance."""

    name: str
    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


DEFAULT = Tolerances.default(ROBOT, 0.01, 0.005)


def off(joint: int, value: float) -> tuple[float, ...]:
    return tuple(value if index == joint else 0.0 for index in range(6))


def test_zero_is_the_default_negative_no_bound_and_the_rest_as_asked():
    asked = [Asked(NAMES[1], 0.0), Asked(NAMES[2], -1.0, -1.0, -1.0), Asked(NAMES[3], 0.2)]
    assert DEFAULT.overridden_by(ROBOT, asked).position == (0.01, 0.01, math.inf, 0.2, 0.01, 0.01)


def test_a_default_of_zero_is_no_bound_and_prismatic_joints_have_their_own():
    track = replace(ROBOT, linear=(True, *ROBOT.linear[1:]))
    assert Tolerances.default(track, 0.0, 0.005).position == (0.005, *(math.inf,) * 5)


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_that_is_off_is_named_with_value_and_tolerance(joint):
    tolerances = DEFAULT.overridden_by(ROBOT, [Asked(name, 0.1) for name in NAMES])
    assert tolerances.violation(ROBOT, off(joint, -0.1)) == ""
    found = tolerances.violation(ROBOT, off(joint, math.radians(-6)))
    assert found.startswith(f"the position of {NAMES[joint]} is off by ")
    assert {key: found.values[key] for key in ("error", "bound")} == {
        "error": Quantity(math.radians(6), "rad"),
        "bound": Quantity(0.1, "rad"),
    }


def test_a_pose_that_is_no_number_does_not_pass():
    assert math.isnan(DEFAULT.violation(ROBOT, off(0, math.nan)).values["error"].value)


@pytest.mark.parametrize("bound", [{"velocity": 0.5}, {"acceleration": 0.5}, {"velocity": math.nan}])
def test_a_bound_that_is_not_watched_is_refused(bound):
    with pytest.raises(
        GoalError, match="goal_tolerance bounds velocity or acceleration of joint_a1; expected a position"
    ):
        DEFAULT.overridden_by(ROBOT, [Asked("joint_a1", 0.1, **bound)])


def test_a_tolerance_of_a_foreign_joint_or_of_no_number_is_refused():
    with pytest.raises(
        GoalJointsError,
        match=f"goal_tolerance names the joint 'elbow'; expected only {', '.join(NAMES)}",
    ):
        DEFAULT.overridden_by(ROBOT, [Asked("elbow", 0.1)])
    with pytest.raises(
        GoalError,
        match="goal_tolerance: the position of joint_a1 is nan",
    ):
        DEFAULT.overridden_by(ROBOT, [Asked("joint_a1", math.nan)])


@pytest.mark.parametrize("second", [0.2, 0.1])
def test_a_tolerance_of_a_joint_that_is_named_twice_is_refused(second):
    asked = [Asked("joint_a1", 0.1), Asked("joint_a1", second)]
    with pytest.raises(GoalError, match="goal_tolerance names joint_a1 twice; expected once"):
        DEFAULT.overridden_by(ROBOT, asked)


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("elbow", *NAMES[1:]), f"elbow, {', '.join(NAMES[1:])}"),
        ((*NAMES, NAMES[0]), f"{', '.join(NAMES)}, joint_a1"),
        (NAMES[1:], ", ".join(NAMES[1:])),
        ((), "none"),
    ],
)
def test_a_goal_names_each_joint_once(names, found):
    with pytest.raises(GoalJointsError, match=f"names the joints {found}; expected each of {', '.join(NAMES)} once"):
        check_joint_names(ROBOT, names)


def test_the_order_of_the_joints_is_free():
    check_joint_names(ROBOT, NAMES[::-1])
