"""Conversions between ROS messages and values: bit-exact, through the wire format. Needs no ROS master."""

from __future__ import annotations

import dataclasses
import io
import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Quaternion, Transform, Vector3
from geometry_msgs.msg import Pose as PoseMsg

from construction_twin.core.freshness import Moment
from construction_twin.robot.motion_errors import TrajectoryError
from construction_twin.robot.plan import Clearance, LimitUsage, Plan, PlanReport, content_hash
from construction_twin.robot.segments import Segment, Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.ros.messages import convert
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.scene_change import SceneChange

NAMES = ("joint_a1", "joint_a2")


def trajectory(waypoints: int = 50) -> Trajectory:
    rng = np.random.default_rng(waypoints)
    return Trajectory(NAMES, np.linspace(0.0, 75.2 / 3, waypoints), *rng.normal(size=(3, waypoints, 2)))


def plan(clearance: Clearance = Clearance(0.0123, ("link_3", "wall"), (1.0, -2.0, 1 / 3), 4.004)) -> Plan:
    motion = trajectory()
    fractions = LimitUsage((0.1, 1 / 3), (0.3, 0.4), (0.5, 0.6))
    return Plan(
        id="p1",
        hash=motion.content_hash(),
        source="request",
        planner="RRTConnect",
        scene="5c",
        asked=Moment("c0ffee00", 1_700_000_123_000_000),
        planning_time=0.1,
        trajectory=motion,
        report=PlanReport(clearance, fractions, 0.017),
    )


def over_the_wire(msg):
    buffer = io.BytesIO()
    msg.serialize(buffer)
    return type(msg)().deserialize(buffer.getvalue())


@pytest.mark.parametrize("waypoints", [2, 3, 1500])
def test_a_trajectory_survives_to_the_last_bit(waypoints):
    sent = trajectory(waypoints)
    received = convert.trajectory_from_msg(over_the_wire(convert.trajectory_to_msg(sent)))
    assert received.content_hash() == sent.content_hash()


def test_a_plan_survives_with_everything_it_carries():
    sent = plan()
    msg = over_the_wire(convert.plan_to_msg(sent, "base_link", np.arange(150.0).reshape(50, 3)))
    received = convert.plan_from_msg(msg)
    for name in ("id", "hash", "source", "planner", "scene", "asked", "planning_time", "report"):
        assert getattr(received, name) == getattr(sent, name)
    assert msg.header.frame_id == "base_link" and msg.duration == sent.trajectory.duration
    assert (len(msg.tool_path), msg.tool_path[1].x, msg.tool_path[1].z) == (50, 3.0, 5.0)


def test_a_plan_changed_on_its_way_is_refused():
    msg = over_the_wire(convert.plan_to_msg(plan(), "base_link", np.zeros((50, 3))))
    positions = list(msg.trajectory.points[7].positions)
    positions[0] = math.nextafter(positions[0], 9.0)
    msg.trajectory.points[7].positions = positions
    with pytest.raises(TrajectoryError, match="its content has"):
        convert.plan_from_msg(msg)


def test_a_pose_is_position_and_rotation():
    half = math.sqrt(0.5)
    pose = convert.pose_from_msg(PoseMsg(Point(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, half, half)))
    np.testing.assert_allclose(pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    assert pose.position.tolist() == [1.0, 2.0, 3.0]
    same = convert.pose_from_transform_msg(Transform(Vector3(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, half, half)))
    assert np.array_equal(same.position, pose.position) and np.array_equal(same.rotation, pose.rotation)


@pytest.mark.parametrize("field", ["clearance", "clearance_time", "jerk_use"])
def test_a_plan_whose_measurements_are_no_numbers_is_refused(field):
    msg = convert.plan_to_msg(plan(), "base_link", np.zeros((50, 3)))
    setattr(msg, field, [math.nan, 0.1] if field == "jerk_use" else math.nan)
    with pytest.raises(TrajectoryError, match="was measured as clearance"):
        convert.plan_from_msg(msg)


def work_plan() -> Plan:
    """A plan of two segments, with every field away from its default, and numbers without a short decimal form."""
    motion = trajectory()
    held = Signal("held", True)
    close = Switch("vacuum", True, (held, Signal("pressure", False)), 2 / 3)
    segments = (
        Segment("fetch", float(motion.times[17]), False, (), (close, Switch("blow", False, (), 1)), "5c", "6d"),
        Segment("carry \N{EM DASH} Träger", motion.duration, True, (held,), (), "6d", "6d"),
    )
    task = "3cUkl32yn9qRSPvBJVyWYp"
    return dataclasses.replace(plan(), hash=content_hash(motion, task, segments), task=task, segments=segments)


def test_a_work_plan_survives_to_the_last_bit_with_its_hash_and_its_changes_of_the_scene():
    sent = work_plan()
    box = SceneObject(
        "e/0", "box", (0.1, 0.2, 1 / 3), (0.0, 0.0, 0.1 / 3), padding=0.001, link="tool0", touch=("rack",)
    )
    changes = (SceneChange((box,), ("e/1",)), SceneChange())
    msg = over_the_wire(convert.plan_to_msg(sent, "base_link", np.zeros((50, 3)), changes))
    received = convert.plan_from_msg(msg)
    assert (received.hash, received.task, received.segments) == (sent.hash, sent.task, sent.segments)
    assert tuple(map(convert.change_from_msg, msg.segments)) == changes
    # a plan may be told without its changes, which are for displays only
    bare = over_the_wire(convert.plan_to_msg(sent, "base_link", np.zeros((50, 3))))
    assert convert.plan_from_msg(bare).hash == sent.hash
    assert set(map(convert.change_from_msg, bare.segments)) == {SceneChange()}


@pytest.mark.parametrize(
    "change",
    [
        lambda msg: setattr(msg, "task", "another"),
        lambda msg: setattr(msg.segments[0], "end", math.nextafter(msg.segments[0].end, 9.0)),
        lambda msg: setattr(msg.segments[0].switches[0], "value", False),
        lambda msg: setattr(msg.segments[0].switches[0].confirm[1], "name", "held"),
        lambda msg: setattr(msg.segments[1], "engaged", False),
        lambda msg: setattr(msg.segments[1], "requires", []),
        lambda msg: setattr(msg.segments[1], "scene_after", "7e"),
        lambda msg: msg.segments.pop(),
        lambda msg: msg.segments.clear(),
    ],
)
def test_a_work_plan_changed_on_its_way_is_refused(change):
    msg = over_the_wire(convert.plan_to_msg(work_plan(), "base_link", np.zeros((50, 3))))
    change(msg)
    with pytest.raises(TrajectoryError):
        convert.plan_from_msg(msg)
