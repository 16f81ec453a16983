"""Work plans: segments joined at rest to one trajectory, each checked at every 4 ms in its own scene."""

from __future__ import annotations

import dataclasses
import math

import coal
import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_cell import HOME, LEFT, QUICK, REQUEST, RIGHT, ROBOT, SELF_COLLISION, WALL, Clock, solver, standing, world

from construction_twin.core.units import CYCLE
from construction_twin.extensions.planners.waypoint_file import format_plan, parse_waypoints
from construction_twin.planning.pipeline import PlanningPipeline, SceneChangedError
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.recheck import CollisionError, LimitError, recheck
from construction_twin.planning.request_limits import PlanBounds, PlanSizeError
from construction_twin.planning.timing import time_path
from construction_twin.planning.waypoints import START_TOLERANCE_RAD
from construction_twin.planning.work_plan import SegmentError, plan_work
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.motion_errors import PlanningError, SceneError, TrajectoryError
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

HELD = SceneObject("block", "box", (0.3, 0.3, 0.3), (0.0, 0.0, 0.25), link="tool0")
#: Where it is when it is gripped.
BLOCK = standing(HELD, RIGHT)
OPEN = Switch("vacuum", False, (Signal("held", False),), 2.0)
CLOSE = Switch("vacuum", True, (Signal("held", True),), 2.0)
GRIPPED = Signal("held", True)


def motion(begin, end, speed: float = 0.5) -> Trajectory:
    return time_path(np.array([begin, end]), ROBOT, speed_scale=speed)


def task_of(*poses) -> list[WorkSegment]:
    """Three segments: to the block, carry it (it hangs on the tool then), leave without it."""
    first, second, third, fourth = poses or (HOME, RIGHT, LEFT, HOME)
    return [
        WorkSegment("fetch", motion(first, second), True, switches=(CLOSE,), change=SceneChange((HELD,))),
        WorkSegment("carry", motion(second, third), True, (GRIPPED,), (OPEN,), SceneChange((), ("block",))),
        WorkSegment("leave", motion(third, fourth)),
    ]


def asked_with(number: int, **changes) -> list[WorkSegment]:
    asked = task_of()
    asked[number] = dataclasses.replace(asked[number], **changes)
    return asked


def planned(asked, cell=None, present=HOME, bounds=PlanBounds(), task="task-1") -> Plan:
    return plan_work(task, asked, present, REQUEST, world(BLOCK) if cell is None else cell, bounds, Clock())


def test_a_task_is_one_plan_of_segments_that_join_at_rest_in_the_scenes_that_the_changes_leave():
    asked = task_of()
    plan = planned(asked)
    fetch, carry, leave = plan.segments
    start = Scene((BLOCK,), 0.01)
    held, empty = Scene((HELD,), 0.01), Scene((), 0.01)
    assert (plan.planner, plan.task, plan.scene, plan.source) == ("work", "task-1", start.hash, "request")
    assert [(each.scene, each.scene_after) for each in plan.segments] == [
        (start.hash, held.hash), (held.hash, empty.hash), (empty.hash, empty.hash)
    ]  # fmt: skip
    assert (fetch.engaged, carry.engaged, leave.engaged) == (True, True, False)
    assert (fetch.switches, carry.switches, leave.switches) == ((CLOSE,), (OPEN,), ())
    assert carry.requires == (GRIPPED,)
    assert plan.hash == content_hash(plan.trajectory, "task-1", plan.segments) != plan.trajectory.content_hash()
    # ends are times of waypoints, to the last bit; the last one is the duration
    durations = [segment.trajectory.duration for segment in asked]
    assert leave.end == plan.trajectory.duration == pytest.approx(sum(durations), abs=1e-9)
    for segment, pose in zip(plan.segments, (RIGHT, LEFT, HOME)):
        q, qd, qdd = plan.trajectory.sample(segment.end)
        np.testing.assert_array_equal(q, pose)
        assert not qd.any() and not qdd.any()
    assert tuple(plan.trajectory.positions[0]) == tuple(HOME)


def test_the_joined_motion_is_that_of_the_segments():
    asked = task_of()
    plan = planned(asked)
    begin = 0.0
    for item, segment in zip(asked, plan.segments):
        times = np.arange(0.0, item.trajectory.duration, 0.0013)
        for whole, alone in zip(plan.trajectory.sample_many(begin + times), item.trajectory.sample_many(times)):
            np.testing.assert_allclose(whole, alone, rtol=0, atol=1e-6)
        begin = segment.end


def test_the_report_is_the_worst_of_all_segments_at_its_time_in_the_whole():
    asked, cell = task_of(), world(BLOCK)
    plan = planned(asked, cell)
    held = cell.with_scene(Scene((HELD,), 0.01))
    worlds = (cell, held, cell.with_scene(Scene((), 0.01)))
    alone = [recheck(item.trajectory, ROBOT, each, Clock()) for item, each in zip(asked, worlds)]
    worst = min(range(3), key=lambda number: alone[number].clearance.distance)
    begin = ([0.0] + [segment.end for segment in plan.segments])[worst]
    assert plan.report.clearance.distance == alone[worst].clearance.distance
    assert plan.report.clearance.between == alone[worst].clearance.between
    assert plan.report.clearance.time == pytest.approx(begin + alone[worst].clearance.time, abs=1e-12)
    for name in ("velocity", "acceleration", "jerk"):
        largest = np.max([getattr(each.usage, name) for each in alone], axis=0)
        found = np.array(getattr(plan.report.usage, name))
        assert (found >= largest).all() and (found <= 1.0 + 1e-6).all()
        np.testing.assert_allclose(found, largest, rtol=0.02)
    assert plan.report.recheck_time >= sum(each.recheck_time for each in alone) * 0.99


@pytest.mark.parametrize(
    ("number", "changes", "sentence"),
    [
        (0, {"engaged": False}, "it switches vacuum at its end and is not engaged"),
        (0, {"requires": (GRIPPED,)}, "confirms vacuum is required before it"),
        (0, {"switches": (Switch("vacuum", True, (), 1.0),)}, "expected an input that must change"),
        (
            1,
            {"switches": tuple(dataclasses.replace(OPEN, output=f"v{n}") for n in range(9))},
            "9 switches; expected at most 8",
        ),
    ],
)
def test_switches_that_are_not_safe_are_refused(number, changes, sentence):
    with pytest.raises(SegmentError, match=sentence):
        planned(asked_with(number, **changes))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"position": (0.0, 0.0, 0.253)}, "'block' would be 3.* from where it was once tool0 carries it"),
        ({"quaternion": (0.0, 0.0, math.sin(0.005), math.cos(0.005))}, "'block' would be .* from where it was"),
        # a quarter turn maps it onto itself, an eighth does not
        (
            {"quaternion": (0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8))},
            "'block' would be 0 mm and 45 deg from where it was",
        ),
        ({"size": (0.3, 0.3, 0.2)}, "'block' has another shape or size"),
        ({"shape": "sphere", "size": (0.1,)}, "'block' has another shape or size"),
    ],
)
def test_what_is_gripped_is_the_same_thing_in_the_same_place(change, sentence):
    with pytest.raises(SegmentError, match=f"segment 1 .*{sentence}"):
        planned(asked_with(0, change=SceneChange((dataclasses.replace(HELD, **change),))))
    near = dataclasses.replace(HELD, position=(0.0, 0.0, 0.2515))
    assert planned(asked_with(0, change=SceneChange((near,)))).segments


@pytest.mark.parametrize("angle", [math.pi / 2, math.pi, -math.pi / 2])
def test_a_symmetric_thing_may_be_told_as_turned_onto_itself(angle):
    turned = dataclasses.replace(HELD, quaternion=(0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)))
    assert planned(asked_with(0, change=SceneChange((turned,)))).segments


@pytest.mark.parametrize("number", range(3))
def test_a_contact_in_the_scene_of_one_segment_names_the_segment_and_the_pair(number):
    asked = task_of(HOME, RIGHT, LEFT, RIGHT)
    cell = world(BLOCK)
    if number == 0:
        asked, cell = task_of(RIGHT, LEFT, RIGHT, LEFT), world(BLOCK, WALL)
    else:
        before = asked[number - 1]
        asked[number - 1] = dataclasses.replace(
            before, change=SceneChange((*before.change.put, WALL), before.change.remove)
        )
    with pytest.raises(SegmentError, match=f"segment {number + 1} .*touches wall .at") as caught:
        planned(asked, cell, asked[0].trajectory.positions[0])
    assert caught.value.number == number and caught.value.name == asked[number].name
    assert isinstance(caught.value.cause, CollisionError) and "wall" in caught.value.cause.between


def test_what_is_carried_is_part_of_the_arm():
    # the carried beam is 0.5 m long; a post stands where its end passes half way, and the arm alone does not come there
    tool = solver().chain.forward(0.5 * (RIGHT + LEFT))
    post = SceneObject("post", "sphere", (0.05,), tuple((tool.position + 0.5 * tool.rotation[:, 2]).tolist()))
    carried = SceneObject("block", "box", (0.1, 0.1, 0.5), (0.0, 0.0, 0.3), link="tool0")
    beam = standing(carried, RIGHT)
    cell = world(beam, post)
    alone = [WorkSegment("go", motion(HOME, RIGHT)), WorkSegment("pass", motion(RIGHT, LEFT))]
    assert planned(alone, cell).segments[1].name == "pass"
    loaded = [dataclasses.replace(alone[0], change=SceneChange((carried,))), alone[1]]
    with pytest.raises(SegmentError, match="segment 2 .*block touches post") as caught:
        planned(loaded, cell)
    assert caught.value.cause.between == ("block", "post")


def test_what_the_last_change_puts_where_the_arm_stands_is_refused_too():
    chain = solver().chain
    there = SceneObject("late", "sphere", (0.3,), tuple(chain.forward(HOME).position.tolist()))
    with pytest.raises(
        SegmentError, match=r"segment 3 \('leave'\): link_3 touches late \(at its end, after its change"
    ):
        planned(asked_with(2, change=SceneChange((there,))))


def test_a_motion_beyond_a_limit_is_refused_with_segment_time_and_joint():
    slow = motion(RIGHT, LEFT)
    fast = Trajectory(slow.joint_names, slow.times / 4, slow.positions, slow.velocities * 4, slow.accelerations * 16)
    with pytest.raises(SegmentError, match="segment 2 .*joint_a1 has a.*its limit is") as caught:
        planned(asked_with(1, trajectory=fast))
    assert isinstance(caught.value.cause, LimitError)


@pytest.mark.parametrize("gap", [2e-9, 1e-3])
def test_a_gap_between_segments_is_refused(gap):
    with pytest.raises(
        SegmentError, match="^segment 3 .*it begins .* of joint_a3 away from where the segment"
    ) as caught:
        planned(asked_with(2, trajectory=motion(LEFT + gap * np.eye(6)[2], HOME)))
    assert isinstance(caught.value.cause, TrajectoryError)


def test_rounding_between_segments_is_made_exact():
    plan = planned(asked_with(2, trajectory=motion(LEFT + 9e-10, HOME)))
    np.testing.assert_array_equal(plan.trajectory.sample(plan.segments[1].end)[0], LEFT)


@pytest.mark.parametrize("row,what", [(0, "begins"), (-1, "ends")])
@pytest.mark.parametrize("quantity,values", [("velocity", "velocities"), ("acceleration", "accelerations")])
def test_a_segment_that_is_not_at_rest_at_an_end_is_refused(row, what, quantity, values):
    given = motion(RIGHT, LEFT)
    moving = getattr(given, values).copy()
    moving[row, 3] = 1e-3
    with pytest.raises(SegmentError, match=f"segment 2 .*it {what} with a {quantity} of .* of joint_a4; expected rest"):
        planned(asked_with(1, trajectory=dataclasses.replace(given, **{values: moving})))


def test_a_plan_begins_exactly_where_the_arm_is():
    present = np.array(HOME) + START_TOLERANCE_RAD * np.array([0.9, -0.9, 0.5, 0.0, 0.1, -0.3])
    plan = planned(task_of(), present=present)
    np.testing.assert_array_equal(plan.trajectory.positions[0], present)
    np.testing.assert_array_equal(plan.trajectory.sample(plan.segments[0].end)[0], RIGHT)
    # the difference fades: it never grows
    given = task_of()[0].trajectory
    times = np.arange(0.0, given.duration, CYCLE)
    away = np.abs(plan.trajectory.sample_many(times)[0] - given.sample_many(times)[0])
    assert (np.diff(away, axis=0) <= 1e-12).all() and away[0].max() > 0.8 * START_TOLERANCE_RAD


def test_a_plan_from_elsewhere_is_refused():
    with pytest.raises(SegmentError, match="segment 1 .*0.055 deg of joint_a2 away from where the arm is; .* 0.05 deg"):
        planned(task_of(), present=HOME + math.radians(0.055) * np.eye(6)[1])


def test_an_object_to_remove_that_is_not_there_is_refused():
    for name in ("nobody", "block"):  # the second is removed already by the segment before it
        with pytest.raises(SegmentError) as caught:
            planned(asked_with(2, change=SceneChange((), (name,))))
        cause = caught.value.cause
        assert isinstance(cause, SceneError) and caught.value.number == 2
        assert (cause.where, cause.value) == ("an object to remove", name)


def test_an_object_on_a_link_that_does_not_exist_is_refused():
    with pytest.raises(SegmentError, match="segment 1 .*tool9"):
        planned(asked_with(0, change=SceneChange((dataclasses.replace(HELD, link="tool9"),))))


@pytest.mark.parametrize(
    "changes,words",
    [
        ({"name": " "}, "name of the segment"),
        ({"name": "x" * 201}, "name of the segment"),
        ({"name": "two\nlines"}, "name of the segment"),
        ({"switches": (dataclasses.replace(CLOSE, output=""),)}, "name of an output is ''"),
        ({"switches": (dataclasses.replace(CLOSE, confirm=(Signal("", True),)),)}, "name of an input is ''"),
        ({"requires": (Signal("\t", True),)}, "name of an input"),
        ({"switches": (CLOSE, OPEN)}, "switched outputs name 'vacuum' more than once"),
        ({"requires": (Signal("held", True), Signal("held", False))}, "name 'held' more than once"),
        ({"switches": (dataclasses.replace(CLOSE, timeout=0.0),)}, "0.0 s to be confirmed"),
        ({"switches": (dataclasses.replace(CLOSE, timeout=math.nan),)}, "nan s to be confirmed"),
        ({"switches": (dataclasses.replace(CLOSE, timeout=math.inf),)}, "inf s to be confirmed"),
        ({"requires": tuple(Signal(f"s{k}", True) for k in range(65))}, "65 required signals"),
        ({"change": SceneChange((), tuple(map(str, range(2001))))}, "2001 objects to remove"),
    ],
)
def test_names_and_counts_that_make_no_sense_are_refused(changes, words):
    with pytest.raises(SegmentError, match=f"segment 2 .*{words}"):
        planned(asked_with(1, **changes))


@pytest.mark.parametrize(
    "task,asked,words",
    [("", task_of(), "without a task"), ("t", [], "0 segments"), ("t" * 201, task_of(), "name of the task")],
)
def test_a_work_plan_has_a_task_and_segments(task, asked, words):
    with pytest.raises(PlanningError, match=words):
        planned(asked, task=task)
    with pytest.raises(PlanningError, match="a work plan of 201 segments is asked for"):
        planned(task_of()[:1] * 201)


def test_joints_in_another_order_are_refused():
    given = motion(RIGHT, LEFT)
    with pytest.raises(
        SegmentError,
        match="segment 2 .*: its joints are joint_a6, .*; expected joint_a1, .* in this order",
    ):
        planned(asked_with(1, trajectory=dataclasses.replace(given, joint_names=given.joint_names[::-1])))


def test_the_bounds_of_the_planner_hold_for_the_whole():
    asked = task_of()
    duration = sum(item.trajectory.duration for item in asked)
    with pytest.raises(PlanSizeError, check=lambda error: error.quantity == "duration"):
        planned(asked, bounds=PlanBounds(duration - 0.001))
    count = sum(len(item.trajectory.times) for item in asked)
    with pytest.raises(PlanSizeError, check=lambda error: error.quantity == "waypoints"):
        planned(asked, bounds=PlanBounds(waypoints=count - 1))
    assert planned(asked, bounds=PlanBounds(duration + 1e-6, count)).task


def test_the_hash_covers_order_names_switches_and_scenes():
    plan = planned(task_of())
    first, second, third = plan.segments
    others = [
        ("task-2", plan.segments),
        ("task-1", (dataclasses.replace(first, name="grip"), second, third)),
        ("task-1", (dataclasses.replace(first, switches=()), second, third)),
        ("task-1", (first, dataclasses.replace(second, engaged=False), third)),
        ("task-1", (first, dataclasses.replace(second, requires=()), third)),
        ("task-1", (first, second, dataclasses.replace(third, scene_after="another"))),
        ("task-1", (first, dataclasses.replace(second, switches=(CLOSE,)), third)),
    ]
    for task, segments in others:
        assert content_hash(plan.trajectory, task, segments) != plan.hash
        with pytest.raises(TrajectoryError, match="has hash '.*', its content has"):
            dataclasses.replace(plan, task=task, segments=segments)


def test_the_scene_that_changed_meanwhile_drops_the_plan():
    class Editing(Clock):
        def __call__(self):
            now = super().__call__()
            if round(now * 1e3) == 3:
                made.set_scene(Scene((), 0.01))
            return now

    made = PlanningPipeline(ROBOT, solver(), PlannerSettings(**QUICK), SELF_COLLISION, Editing())
    made.set_scene(Scene((BLOCK,), 0.01))
    with pytest.raises(SceneChangedError, match="the scene changed while planning"):
        made.work(HOME, "task-1", task_of(), REQUEST)
    made.set_scene(Scene((BLOCK,), 0.01))
    assert made.work(HOME, "task-1", task_of(), REQUEST).segments[0].name == "fetch"


@settings(max_examples=8)
@given(
    st.lists(st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6), min_size=1, max_size=4),
    st.floats(0.05, 1.0),
    st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6),
)
def test_however_segments_are_joined_every_sample_is_inside_the_limits_and_the_plan_is_whole(turns, speed, away):
    poses = [np.array(HOME) + np.array(turn) for turn in turns]
    poses = [np.array(HOME), *(pose + 0.05 for pose in poses)]
    asked = [
        WorkSegment(str(number), motion(*pair, speed))
        for number, pair in enumerate(zip(poses, poses[1:]))
        if np.abs(pair[1] - pair[0]).max() > 1e-4
    ]
    if not asked or len(asked) != len(poses) - 1:
        return
    present = np.array(HOME) + 0.5 * START_TOLERANCE_RAD * np.array(away)
    plan = planned(asked, world(), present)
    assert plan.segments[-1].end == plan.trajectory.duration
    ends = [segment.end for segment in plan.segments]
    assert set(ends) <= set(plan.trajectory.times.tolist()) and ends == sorted(set(ends))
    report = recheck(plan.trajectory, ROBOT, world(), Clock())
    assert max(map(max, (report.usage.velocity, report.usage.acceleration, report.usage.jerk))) <= 1.0 + 1e-6
    rows = np.searchsorted(plan.trajectory.times, ends)
    np.testing.assert_array_equal(plan.trajectory.positions[rows], poses[1:])
    assert not plan.trajectory.velocities[rows].any() and not plan.trajectory.accelerations[rows].any()


def test_the_other_arm_is_in_every_segment_s_scene():
    """A change of the scene makes another world, in which the other arm still stands."""
    tool = solver().chain.forward(0.5 * (RIGHT + LEFT)).position
    arm = Obstacle("kr120_b/link_3", pinocchio.SE3(np.eye(3), tool), coal.Sphere(0.1))
    cell = world(BLOCK).with_neighbour([arm])
    with pytest.raises(SegmentError, match="segment 2 .*kr120_b/link_3"):
        planned(asked_with(0, change=SceneChange((), ("block",))), cell)


def test_a_work_plan_is_written_as_a_file_with_the_names_of_its_segments():
    text = format_plan(planned(task_of()), ROBOT.linear)
    assert "# task task-1, the path alone" in text and "# segment 'carry' ends at " in text
    waypoints = parse_waypoints(text, ROBOT)
    np.testing.assert_array_equal(waypoints.positions, planned(task_of()).trajectory.positions)
