"""`plan` on MQTT: what is shown."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import struct

import numpy as np
import pytest
from construction_twin.msg import Plan
from geometry_msgs.msg import Point
from plan_samples import make_plan
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.extensions.console.nodes.shown_plan import plan_view
from construction_twin.extensions.console.remote_review import (
    MAX_TRAJECTORY_NUMBERS,
    PathView,
    PlanBoard,
    shortened,
)
from construction_twin.robot.motion_errors import TrajectoryError
from construction_twin.robot.plan import content_hash
from construction_twin.robot.segments import Segment, Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.scene_change import SceneChange

# -- plan


def message(waypoints: int = 3, **changes) -> Plan:
    points = [JointTrajectoryPoint(positions=[0.1 * k, -0.2]) for k in range(waypoints)]
    plan = Plan(
        id="p1", hash="cafe", source="request", planner="RRTConnect", scene="beef", duration=1.5, planning_time=0.25,
        trajectory=JointTrajectory(joint_names=["joint_a1", "joint_a2"], points=points),
        tool_path=[Point(0.1 * k, 1.0, 0.123456789) for k in range(waypoints)],
    )  # fmt: skip
    plan.header.frame_id = "kr120/twin/base_link"
    plan.header.stamp.secs = 7
    for name, value in changes.items():
        setattr(plan, name, value)
    return plan


MEASURED = {
    "clearance": 0.031, "clearance_time": 0.5, "clearance_between": ["link_3", "wall"],
    "clearance_point": Point(1.0, 2.0, 3.0), "velocity_use": [0.5, 0.4], "acceleration_use": [0.9, 0.1], "jerk_use": [0.2, 0.3],
}  # fmt: skip


def document_of(plan: Plan, points: int = 200) -> dict:
    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    return json.loads(plan_view(plan).to_json(points), parse_constant=refuse)


def test_the_tool_that_counts_is_told_where_there_is_one():
    plan = Plan(id="p1", **MEASURED)
    assert "tool" not in document_of(plan)
    assert json.loads(plan_view(plan, "d1e5").to_json(10))["tool"] == "d1e5"


def motion_hash(document: dict) -> str:
    """Return the hash of the motion in a plan, as docs/broker.md says it."""
    motion = hashlib.sha256("\0".join(document["joints"]).encode() + b"\0\0")
    for key in ("times", "positions", "velocities", "accelerations"):
        values = np.ravel(document["trajectory"][key])
        motion.update(struct.pack(f"<{len(values)}d", *values))
    return motion.hexdigest()


def test_a_plan_is_shown_with_what_a_verdict_needs():
    shown_plan = document_of(message(**MEASURED))
    assert {key: shown_plan[key] for key in ("id", "hash", "source", "planner", "scene")} == {
        "id": "p1", "hash": "cafe", "source": "request", "planner": "RRTConnect", "scene": "beef"
    }  # fmt: skip
    assert (shown_plan["duration"], shown_plan["planning_time"], shown_plan["created_ns"]) == (1.5, 0.25, 7_000_000_000)
    assert (shown_plan["joints"], shown_plan["waypoints"]) == (["joint_a1", "joint_a2"], 3)
    assert (shown_plan["start"], shown_plan["goal"]) == ([0.0, -0.2], [0.2, -0.2])
    assert (shown_plan["frame"], shown_plan["tool_path"][1]) == ("kr120/twin/base_link", [0.1, 1.0, 0.1235])
    assert shown_plan["clearance"] == {
        "distance": 0.031, "time": 0.5, "between": ["link_3", "wall"], "point": [1.0, 2.0, 3.0]
    }  # fmt: skip
    assert shown_plan["use"] == {"velocity": [0.5, 0.4], "acceleration": [0.9, 0.1], "jerk": [0.2, 0.3]}


def test_the_hash_of_a_motion_follows_from_the_trajectory_that_the_tablet_got():
    motion = Trajectory(
        ("joint_a1", "joint_a2"),
        [0.0, 0.7, 1.1],
        [[0.0, -0.0], [1 / 3, 1.0], [0.4, 1.1]],
        np.ones((3, 2)),
        np.zeros((3, 2)),
    )
    sent = plan_to_msg(make_plan(motion, "p1", "aa"), "base", np.zeros((3, 3)))
    buffer = io.BytesIO()
    sent.serialize(buffer)
    document = document_of(Plan().deserialize(buffer.getvalue()))
    assert motion_hash(document) == document["hash"] == motion.content_hash()
    assert document["trajectory"]["positions"] == motion.positions.tolist()


def test_a_motion_of_another_last_bit_has_another_hash():
    motion = Trajectory(("joint_a1",), [0.0, 1.0], [[0.0], [1.0]], np.zeros((2, 1)), np.zeros((2, 1)))
    document = document_of(plan_to_msg(make_plan(motion, "p1", "aa"), "base", np.zeros((2, 3))))
    document["trajectory"]["positions"][1][0] = math.nextafter(1.0, 2.0)
    assert motion_hash(document) != document["hash"]


def test_what_was_not_measured_is_not_shown_as_a_measurement():
    shown_plan = document_of(message())
    assert shown_plan["clearance"] is None and shown_plan["use"]["velocity"] == []


def test_nothing_to_touch_is_not_shown_as_a_distance():
    shown_plan = document_of(message(**MEASURED | {"clearance": math.inf, "clearance_between": []}))
    assert shown_plan["clearance"]["distance"] is None


def test_a_plan_without_waypoints_can_be_shown():
    shown_plan = document_of(message(0))
    assert (shown_plan["start"], shown_plan["tool_path"], shown_plan["waypoints"]) == ([], [], 0)


def test_the_longest_plan_stays_far_below_the_broker_s_limit():
    plan = message(20_000, **MEASURED, source="s" * 5000, planner="p" * 5000)
    plan.tool_path = [Point(-1234.56789 - k, -1234.56789, -1234.56789) for k in range(20_000)]
    plan.trajectory.points = [
        JointTrajectoryPoint([-0.12345678901234567] * 6, [-0.12345678901234567] * 6, [0.1] * 6, [], plan.header.stamp)
    ] * 20_000
    payload_bytes = plan_view(plan).to_json(1000)
    assert len(payload_bytes) < 50_000 and json.loads(payload_bytes)["trajectory"] is None
    assert len(plan_view(plan).to_json(200)) < 12_000
    plan.trajectory.points = plan.trajectory.points[: MAX_TRAJECTORY_NUMBERS // 19]
    plan.trajectory.joint_names = [f"joint_a{k}" for k in range(1, 7)]
    assert 1_500_000 < len(plan_view(plan).to_json(1000)) < 2_300_000
    found = json.loads(payload_bytes)
    assert len(found["tool_path"]) == 1000 and found["waypoints"] == 20_000 and found["source"].endswith("...")


def test_a_text_is_cut_only_when_it_is_long():
    assert shortened("x" * 200) == "x" * 200 and shortened("x" * 201) == "x" * 197 + "..."


# -- board


def test_a_verdict_that_arrives_before_its_plan_counts():
    """After a restart of the node the latched plan and the latched verdict come in any order."""
    board = PlanBoard()
    board.on_verdict("p1")
    board.on_plan("p1", b"one")
    assert board.payload == b""


# -- work plans


def work_message(waypoints: int = 9) -> Plan:
    """A work plan of two segments, through the wire format."""
    names = ("joint_a1", "joint_a2")
    rest = np.zeros((waypoints, 2))
    positions = np.linspace((0.0, 0.0), (1.0, -1 / 3), waypoints)
    motion = Trajectory(names, np.linspace(0.0, 10 / 3, waypoints), positions, rest, rest)
    held, free = Signal("held", True), Signal("held", False)
    end = float(motion.times[waypoints // 2])
    segments = (
        Segment("anfahren \N{EM DASH} fetch", end, False, (), (Switch("vacuum", True, (held,), 1 / 3),), "aa", "bb"),
        Segment("set down", motion.duration, True, (held,), (Switch("vacuum", False, (free,), 2.0),), "bb", "cc"),
    )
    plan = dataclasses.replace(
        make_plan(motion, "w1", "aa"), hash=content_hash(motion, "task-1", segments), task="task-1", segments=segments
    )
    bodies = tuple(SceneObject(f"e/{k}", "box", (0.1, 0.1, 0.1), link="tool0") for k in range(22))
    path = np.linspace((0.0, 0.0, 1.0), (2.0, 1.0, 1.0), waypoints)
    message = plan_to_msg(plan, "base", path, (SceneChange(bodies), SceneChange((), ("e/0",))))
    buffer = io.BytesIO()
    message.serialize(buffer)
    return Plan().deserialize(buffer.getvalue())


def test_the_hash_of_a_work_plan_follows_from_what_the_tablet_got_alone():
    """As docs/broker.md says it: SHA-256 of `content`, and `content` is what is shown."""
    document = document_of(work_message())
    assert hashlib.sha256(document["content"].encode()).hexdigest() == document["hash"]
    content = json.loads(document["content"])
    assert content["task"] == document["task"] == "task-1"
    assert motion_hash(document) == content["trajectory"]
    shown_segments = [dict(segment) for segment in document["segments"]]
    for segment in shown_segments:
        for only_for_display in ("tool_path_end", "put", "remove"):
            del segment[only_for_display]

    def named(signals):
        return {signal["name"]: signal["value"] for signal in signals}

    for segment in content["segments"]:
        segment["requires"] = named(segment["requires"])
        segment["switches"] = [switch | {"confirm": named(switch["confirm"])} for switch in segment["switches"]]
    assert shown_segments == content["segments"]


@pytest.mark.parametrize("points", [2, 3, 5, 200])
def test_the_segments_of_a_work_plan_are_shown_with_their_part_of_the_tool_path(points):
    document = document_of(work_message(41), points)
    fetch, down = document["segments"]
    assert (fetch["engaged"], down["engaged"], down["requires"]) == (False, True, {"held": True})
    assert fetch["switches"] == [{"output": "vacuum", "value": True, "confirm": {"held": True}, "timeout": 1 / 3}]
    assert document["tool_path"][fetch["tool_path_end"]] == [1.0, 0.5, 1.0]
    assert down["tool_path_end"] == len(document["tool_path"]) - 1 and down["end"] == pytest.approx(
        document["duration"], abs=1e-6
    )
    assert (len(fetch["put"]), fetch["put"][0], fetch["put"][-1]) == (21, "e/0", "and 2 more")
    assert (fetch["remove"], down["put"], down["remove"]) == ([], [], ["e/0"])


def test_another_plan_has_no_segments_and_no_content():
    assert not {"task", "segments", "content"} & set(document_of(message()))


def test_a_work_plan_that_is_not_what_its_hash_says_is_not_shown():
    spoiled = work_message()
    spoiled.segments[1].engaged = False
    with pytest.raises(TrajectoryError, match="has hash '.*', its content has"):
        plan_view(spoiled)


def test_a_thinned_path_keeps_its_ends_and_its_rests_each_with_its_time():
    path = PathView("p1", [0.1 * k for k in range(11)], [(0.1 * k, 0.123456, 0.0) for k in range(11)])
    said = json.loads(path.to_json(3, required=(7,)))
    assert said["times"] == [0.0, 0.5, 0.7, 1.0]
    assert [point[0] for point in said["tool_path"]] == said["times"]
