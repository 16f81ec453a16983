"""Tolerances as control_msgs means them: 0 is the default, negative is no bound, names decide."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from executor_bench import ROBOT

from construction_twin.core.errors import GoalError, GoalJointsError
from construction_twin.execution.joint_tolerances import AskedTolerance, Tolerances, check_joint_names

NAMES = ROBOT.joint_names
ZERO = (0.0,) * 6
DEFAULT = Tolerances.default(ROBOT, 0.01, 0.005)


def off(joint: int, value: float) -> tuple[float, ...]:
    return tuple(value if index == joint else 0.0 for index in range(6))


def test_zero_is_the_default_negative_no_bound_and_the_rest_as_asked():
    asked = [
        AskedTolerance(NAMES[1], 0.0),
        AskedTolerance(NAMES[2], -1.0, -1.0, -1.0),
        AskedTolerance(NAMES[3], 0.2, 0.5),
    ]
    taken = DEFAULT.asked(ROBOT, asked, "goal_tolerance")
    assert taken.position == (0.01, 0.01, math.inf, 0.2, 0.01, 0.01)
    assert taken.velocity == (math.inf, math.inf, math.inf, 0.5, math.inf, math.inf)
    assert taken.acceleration == (math.inf,) * 6


def test_a_default_of_zero_is_no_bound_and_prismatic_joints_have_their_own():
    track = replace(ROBOT, linear=(True, *ROBOT.linear[1:]))
    assert Tolerances.default(track, 0.0, 0.005).position == (0.005, *(math.inf,) * 5)


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_that_is_off_is_named_with_value_and_tolerance(joint):
    tolerances = DEFAULT.asked(ROBOT, [AskedTolerance(name, 0.1, 0.2, 0.3) for name in NAMES], "path_tolerance")
    assert tolerances.violation(ROBOT, off(joint, -0.1), off(joint, 0.2), off(joint, 0.3)) == ""
    name = NAMES[joint]
    assert tolerances.violation(ROBOT, off(joint, math.radians(-6)), ZERO, ZERO) == (
        f"the position of {name} is off by 6 deg; its tolerance is 5.729578 deg"
    )
    assert tolerances.violation(ROBOT, ZERO, off(joint, 1.0), ZERO).startswith(
        f"the velocity of {name} is off by 57.2958 deg/s"
    )
    assert tolerances.violation(ROBOT, ZERO, ZERO, off(joint, 1.0)).startswith(f"the acceleration of {name} is off by ")


def test_a_pose_that_is_no_number_does_not_pass():
    assert "is off by nan" in DEFAULT.violation(ROBOT, off(0, math.nan), ZERO, ZERO)


def test_a_tolerance_of_a_foreign_joint_or_of_no_number_is_refused():
    with pytest.raises(GoalJointsError, match="path_tolerance names the joint 'elbow'; expected only joint_a1"):
        DEFAULT.asked(ROBOT, [AskedTolerance("elbow", 0.1)], "path_tolerance")
    with pytest.raises(GoalError, match="goal_tolerance: the velocity of joint_a1 is nan; expected a number"):
        DEFAULT.asked(ROBOT, [AskedTolerance("joint_a1", 0.1, math.nan)], "goal_tolerance")


@pytest.mark.parametrize("second", [0.2, 0.1])
def test_a_tolerance_of_a_joint_that_is_named_twice_is_refused(second):
    asked = [AskedTolerance("joint_a1", 0.1), AskedTolerance("joint_a1", second)]
    with pytest.raises(GoalError, match="path_tolerance names joint_a1 twice; expected once"):
        DEFAULT.asked(ROBOT, asked, "path_tolerance")


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (("elbow", *NAMES[1:]), "the goal names the joint 'elbow'; expected each of "),
        ((*NAMES, NAMES[0]), "the goal names the joint joint_a1 twice"),
        (NAMES[1:], "the goal does not name the joint joint_a1"),
        ((), "the goal does not name the joint joint_a1"),
    ],
)
def test_a_goal_names_each_joint_once(names, problem):
    with pytest.raises(GoalJointsError) as caught:
        check_joint_names(ROBOT, names)
    assert problem in str(caught.value)


def test_the_order_of_the_joints_is_free():
    check_joint_names(ROBOT, NAMES[::-1])
