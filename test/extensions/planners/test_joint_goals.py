"""control_msgs/FollowJointTrajectory on the wire: what we serve is what every client in the field speaks."""

from __future__ import annotations

import importlib
import io
import math
import struct
from pathlib import Path

import genpy
import pytest
from executor_bench import ROBOT
from trajectory_msgs.msg import JointTrajectoryPoint

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.planners.joint_tolerances import GoalError, GoalJointsError, Tolerances
from construction_twin.extensions.planners.nodes.joint_goals import (
    GoalDefaults,
    control_messages,
    fill_feedback,
    trajectory_goal,
)
from construction_twin.extensions.planners.tracking import Motion, Sample

#: It is refused where a md5 sum is not the official one.
MESSAGES = control_messages()
DEFAULTS = GoalDefaults(Tolerances.default(ROBOT, 0.01, 0.005), 2.0)


def string(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def numbers(values) -> bytes:
    return struct.pack(f"<I{len(values)}d", len(values), *values)


def header(seq: int, secs: int, nsecs: int, frame: str = "") -> bytes:
    return struct.pack("<3I", seq, secs, nsecs) + string(frame)


def point(positions, velocities, secs: int, nsecs: int) -> bytes:
    return numbers(positions) + numbers(velocities) + numbers([]) + numbers([]) + struct.pack("<2i", secs, nsecs)


def written(message) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_the_definitions_in_the_repository_are_the_official_ones_too():
    """Also where an installed package is used: then these are not what is loaded."""
    folder = Path(__file__).parents[3] / "setup" / "control_msgs"
    goal, result, feedback = (folder / "action" / "FollowJointTrajectory.action").read_text().split("---\n")
    parts = {
        "FollowJointTrajectoryGoal": goal,
        "FollowJointTrajectoryResult": result,
        "FollowJointTrajectoryFeedback": feedback,
    }
    parts["JointTolerance"] = (folder / "msg" / "JointTolerance.msg").read_text()
    for name, text in parts.items():
        ours = [line.split("#")[0].replace(" ", "") for line in text.splitlines()]
        official = [line.split("#")[0].replace(" ", "") for line in definition(getattr(MESSAGES, name))]
        assert list(filter(None, ours)) == list(filter(None, official)), name


def definition(kind: type) -> list[str]:
    """Return the lines of a message's own definition, without what it contains."""
    return kind._full_text.split("=" * 80)[0].splitlines()


def test_feedback_is_these_bytes_in_the_order_of_the_goal_s_joints():
    feedback = MESSAGES.FollowJointTrajectoryFeedback(joint_names=["joint_a2", "joint_a1"])
    desired = Motion((0.5, 1.0), (0.25, 0.0))
    actual = Motion((0.25, 1.5), (0.0, 0.5))
    fill_feedback(feedback, Sample(3_250_000_000, desired, actual), 2_000_000_000, (1, 0))
    time = 1, 250_000_000
    expected = header(0, 0, 0) + struct.pack("<I", 2) + string("joint_a2") + string("joint_a1")
    expected += point([1.0, 0.5], [0.0, 0.25], *time) + point([1.5, 0.25], [0.5, 0.0], *time)
    expected += point([0.5, -0.25], [0.5, -0.25], *time)
    assert written(feedback) == expected


def goal_of(names=ROBOT.joint_names, **fields):
    goal = MESSAGES.FollowJointTrajectoryGoal(**fields)
    goal.trajectory.joint_names = list(names)
    return goal


def test_a_goal_is_known_again_by_its_motion_whatever_its_stamp():
    goals = [goal_of() for _ in range(3)]
    goals[1].trajectory.header.stamp = genpy.Time(1)
    goals[2].trajectory.points = [JointTrajectoryPoint(positions=[0.1] * 6)]
    first, again, other = (trajectory_goal(goal, "g", "/client", ROBOT, DEFAULTS).motion for goal in goals)
    assert first == again != other


def test_foreign_joints_and_tolerances_that_are_no_numbers_are_refused():
    with pytest.raises(GoalJointsError):
        trajectory_goal(goal_of(["elbow"]), "g", "/client", ROBOT, DEFAULTS)
    with pytest.raises(GoalJointsError, match="names the joint 'elbow'; expected only"):
        goal = goal_of(goal_tolerance=[MESSAGES.JointTolerance("elbow", 0.1, 0.0, 0.0)])
        trajectory_goal(goal, "g", "/client", ROBOT, DEFAULTS)
    with pytest.raises(GoalError, match="is nan; expected a number"):
        goal = goal_of(goal_tolerance=[MESSAGES.JointTolerance("joint_a1", math.nan, 0.0, 0.0)])
        trajectory_goal(goal, "g", "/client", ROBOT, DEFAULTS)


@pytest.mark.parametrize(
    "bound", [(0.1, 0.0, 0.0), (-1.0, 0.1, -1.0), (0.0, 0.0, 0.1), (math.nan, 0.0, 0.0), (0.0, 0.0, math.nan)]
)
def test_a_bound_on_the_path_is_refused_and_one_that_asks_for_none_is_not(bound):
    free = [MESSAGES.JointTolerance("joint_a1", -1.0, 0.0, -1.0)]
    assert trajectory_goal(goal_of(path_tolerance=free), "g", "/client", ROBOT, DEFAULTS).client == "/client"
    goal = goal_of(path_tolerance=[*free, MESSAGES.JointTolerance("joint_a2", *bound)])
    with pytest.raises(GoalError, match="a bound on the path of joint_a2; expected none"):
        trajectory_goal(goal, "g", "/client", ROBOT, DEFAULTS)


@pytest.mark.parametrize("seconds", [-1, 601, 2_000_000_000])
def test_a_time_tolerance_outside_of_its_range_is_refused(seconds):
    with pytest.raises(GoalError, match=r"goal_time_tolerance is .* s; expected 0 \(the default\) to 600"):
        trajectory_goal(goal_of(goal_time_tolerance=genpy.Duration(seconds)), "g", "/client", ROBOT, DEFAULTS)
    longest = goal_of(goal_time_tolerance=genpy.Duration(600))
    assert trajectory_goal(longest, "g", "/client", ROBOT, DEFAULTS).time_tolerance == 600.0


def test_a_control_msgs_of_another_kind_is_refused(monkeypatch):
    kind = type("FollowJointTrajectoryAction", (), {"_md5sum": "0" * 32})
    monkeypatch.setattr(importlib.import_module("control_msgs.msg"), "FollowJointTrajectoryAction", kind)
    with pytest.raises(ConfigurationError, match="has the md5 sum 0000"):
        control_messages()
