"""The way back along an executed path: every sample on it, from where the arm is, inside the limits and the present scene."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_cell import HOME, LEFT, QUICK, REQUEST, RIGHT, ROBOT, SELF_COLLISION, WALL, Clock, solver, world

from construction_twin.core.errors import ReviewError
from construction_twin.core.units import CYCLE
from construction_twin.execution.engagement import Engagement, check_way_back
from construction_twin.planning.pipeline import PACE, PlanningPipeline, way_back
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.recheck import CollisionError, recheck
from construction_twin.planning.timing import time_path
from construction_twin.planning.work_plan import SegmentError, joined
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.executed_path import LARGEST_ENTRY, WAY_BACK_TOLERANCE, ExecutedPath, nearest_on_lines
from construction_twin.robot.motion_errors import PlanningError
from construction_twin.robot.segments import Signal
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import Scene

#: Two engaged segments: straight there, and on around a corner; at rest between them. At full speed.
FIRST = time_path(np.array([HOME, RIGHT]), ROBOT)
PATH = joined([FIRST, time_path(np.array([RIGHT, LEFT, HOME + 0.2]), ROBOT)])[0]
BESIDE = np.array([1.0, 0.0, -1.0, 0.0, 0.0, 0.5])

#: Hash of the empty scene.
EMPTY = Scene(padding=0.01).hash


def samples(motion: Trajectory) -> np.ndarray:
    return motion.sample_many(np.append(np.arange(0.0, motion.duration, CYCLE), motion.duration))[0]


def off_the_path(motion: Trajectory, end: float) -> float:
    """Return the largest distance of a sample from the executed path up to `end`."""
    way = PATH.sample_many(np.linspace(0.0, end, int(end / 1e-3) + 2))[0]
    return max(float(nearest_on_lines(way[:-1], way[1:], q)[1].min()) for q in samples(motion)[::7])


@settings(max_examples=10)
@given(st.floats(0.004, PATH.duration))
def test_every_sample_lies_on_the_executed_path_and_inside_the_limits(end):
    present = PATH.sample(end)[0]
    back = way_back(ExecutedPath(PATH, end), present, ROBOT)
    np.testing.assert_allclose(back.positions[0], present, atol=1e-6)
    np.testing.assert_array_equal(back.positions[-1], HOME)
    assert not back.velocities[[0, -1]].any() and not back.accelerations[[0, -1]].any()
    assert off_the_path(back, end) < 1e-6
    usage = recheck(back, ROBOT, world(), Clock()).usage
    assert max(map(max, (usage.velocity, usage.acceleration, usage.jerk))) <= 1.0 + 1e-6
    assert max(usage.velocity) <= PACE


def test_it_goes_back_without_a_detour_and_through_the_rest_between_segments():
    back = way_back(ExecutedPath(PATH, PATH.duration), PATH.positions[-1], ROBOT)
    # the same positions in reverse order: each waypoint of the path is passed once, one after the other
    way = samples(back)
    rows = [int(np.argmin(np.abs(way - q).max(axis=1))) for q in PATH.positions[::-5]]
    assert rows == sorted(rows) and np.abs(way[rows] - PATH.positions[::-5]).max() < 0.01
    assert PATH.duration / PACE <= back.duration < PATH.duration / PACE + 1.0


@pytest.mark.parametrize("end", [0.3, FIRST.duration, 2.5])
def test_an_arm_beside_the_path_goes_straight_to_it_first(end):
    on_path = PATH.sample(end)[0]
    present = on_path + 0.01 * BESIDE
    back = way_back(ExecutedPath(PATH, end), present, ROBOT)
    np.testing.assert_array_equal(back.positions[0], present)
    way = samples(back)
    entry = ExecutedPath(PATH, end).nearest_point(present)
    there = PATH.sample(entry.time)[0]
    row = int(np.argmin(np.abs(way - there).max(axis=1)))
    straight, _ = nearest_on_lines(present[None], there[None], way[0])
    assert straight[0] == 0.0
    assert max(float(nearest_on_lines(present[None], there[None], q)[1][0]) for q in way[: row + 1]) < 1e-6
    assert off_the_path(Trajectory(back.joint_names, *_after(back, row)), end) < WAY_BACK_TOLERANCE
    np.testing.assert_array_equal(back.positions[-1], HOME)


def _after(back: Trajectory, row: int):
    kept = back.times > row * CYCLE
    times = back.times[kept]
    return times - times[0], back.positions[kept], back.velocities[kept], back.accelerations[kept]


def test_an_arm_too_far_from_the_path_must_be_freed_by_hand():
    present = PATH.sample(1.0)[0] + 1.5 * LARGEST_ENTRY * np.ones(6)
    with pytest.raises(PlanningError, match="beside the executed path"):
        way_back(ExecutedPath(PATH, 1.0), present, ROBOT)


@pytest.mark.parametrize("end", [0.0, 0.004, 2.0])
def test_an_arm_at_the_beginning_has_no_way_back(end):
    with pytest.raises(PlanningError, match="at the beginning of the engaged segments"):
        way_back(ExecutedPath(PATH, end), HOME, ROBOT)


@pytest.mark.parametrize("away", [3e-5, 4e-4, 0.01])
def test_an_arm_beside_the_beginning_goes_straight_there(away):
    present = HOME + away * BESIDE
    back = way_back(ExecutedPath(PATH, 0.004), present, ROBOT)
    np.testing.assert_array_equal(back.positions[[0, -1]], [present, HOME])


def test_a_path_of_another_robot_is_refused():
    other = Trajectory(tuple("abcdef"), PATH.times, PATH.positions, PATH.velocities, PATH.accelerations)
    with pytest.raises(PlanningError, match="the executed path is one of"):
        way_back(ExecutedPath(other, 1.0), HOME, ROBOT)


def pipeline(scene: Scene) -> PlanningPipeline:
    made = PlanningPipeline(ROBOT, solver(), PlannerSettings(**QUICK), SELF_COLLISION, Clock())
    made.set_scene(scene)
    return made


def test_it_is_a_work_plan_of_one_engaged_segment_in_the_present_scene():
    scene, held = Scene(padding=0.01), (Signal("held", True),)
    path = ExecutedPath(PATH, 1.0)
    present = PATH.sample(1.0)[0] + 2e-5 * BESIDE
    plan = pipeline(scene).way_back(present, "task-1", path, held, REQUEST)
    (segment,) = plan.segments
    assert (plan.planner, plan.task, plan.scene) == ("way back", "task-1", scene.hash)
    assert (segment.name, segment.engaged, segment.requires, segment.switches) == ("way back", True, held, ())
    assert (segment.scene, segment.scene_after, segment.end) == (scene.hash, scene.hash, plan.trajectory.duration)
    # the last micrometres beside the path fade away on the way
    np.testing.assert_array_equal(plan.trajectory.positions[0], present)
    assert off_the_path(plan.trajectory, 1.0) < WAY_BACK_TOLERANCE / 4


def test_what_stands_in_the_way_back_now_is_not_driven_into():
    with pytest.raises(SegmentError) as caught:
        pipeline(Scene((WALL,), 0.01)).way_back(PATH.positions[-1], "t", ExecutedPath(PATH, PATH.duration), (), REQUEST)
    cause = caught.value.cause
    assert isinstance(cause, CollisionError) and caught.value.name == "way back"
    assert (cause.between, cause.time) == (("link_3", "wall"), 0.0)


@pytest.mark.parametrize("beside", [0.0, 2e-5, 1e-3])
@pytest.mark.parametrize("end", [0.3, FIRST.duration, 2.5, PATH.duration])
def test_the_executor_takes_it_for_the_way_back(end, beside):
    held = (Signal("held", True),)
    engagement = Engagement("p0", "task-1", "carry", ExecutedPath(PATH, end), ((held, EMPTY),), "stopped")
    present = PATH.sample(end)[0] + beside * BESIDE
    plan = pipeline(Scene(padding=0.01)).way_back(present, "task-1", engagement.path, held, REQUEST)
    check_way_back(plan, engagement)


def test_the_executor_takes_no_short_cut_for_the_way_back():
    held = (Signal("held", True),)
    engagement = Engagement("p0", "task-1", "carry", ExecutedPath(PATH, PATH.duration), ((held, EMPTY),), "stopped")
    made = pipeline(Scene(padding=0.01))
    short = WorkSegment("way back", time_path(np.array([PATH.positions[-1], HOME]), ROBOT), True, held)
    with pytest.raises(ReviewError, match="leaves the executed path .* after its start: call plan_way_back"):
        check_way_back(made.work(PATH.positions[-1], "task-1", [short], REQUEST), engagement)
