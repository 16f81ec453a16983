"""Waypoints that are timed anew in a scene: through the points, or refused between two of them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from limit_use import limit_use
from planning_cell import HOME, LEFT, QUICK, REQUEST, RIGHT, ROBOT, SELF_COLLISION, WALL, Clock, solver, world

from construction_twin.kinematics.chain import Chain
from construction_twin.planning.curves import interpolated, parameters
from construction_twin.planning.pipeline import PlanningPipeline, RetimedCollisionError
from construction_twin.planning.planner import PlannerSettings
from construction_twin.planning.waypoints import Waypoints, from_points
from construction_twin.robot.plan import Plan
from construction_twin.scene.objects import Scene, SceneObject

PACE = np.array(ROBOT.velocity)
TOOL = Chain(ROBOT)
PIPELINE = PlanningPipeline(ROBOT, solver(), PlannerSettings(**QUICK), SELF_COLLISION, Clock(), "/kr120/scene")


def asked(points: np.ndarray, pauses: float = 0.0) -> Waypoints:
    """Points at each of which the arm is to stop, in times that need too much acceleration; with a pause at each inner one."""
    legs = 2.2 * np.max(np.abs(np.diff(points, axis=0)) / PACE, axis=1)
    times = np.append(0.0, np.cumsum(legs))
    if pauses:
        points = np.repeat(points, [1, *[2] * (len(points) - 2), 1], axis=0)
        times = np.cumsum([0.0, *[gap for leg in legs for gap in (leg, pauses)][:-1]])
    rest = np.zeros_like(points)
    return from_points(ROBOT, ROBOT.joint_names, points, velocities=rest, accelerations=rest, times=times)


def planned(points: Waypoints, *objects: SceneObject) -> Plan:
    PIPELINE.set_scene(Scene(objects, 0.01))
    return PIPELINE.through(points.positions[0], points, REQUEST, retime=True)


def bulge(points: np.ndarray) -> tuple[np.ndarray, int]:
    """Return where the tool is furthest from its way on the straight lines, on the curve through the points; after which point."""
    curve, at = interpolated(points, PACE), parameters(points, PACE)
    s = np.linspace(0.0, at[-1], 200)
    on_lines = np.column_stack([np.interp(s, at, column) for column in points.T])
    tools = [np.array([TOOL.forward(q).position for q in rows]) for rows in (curve(s), on_lines)]
    away = np.min(np.linalg.norm(tools[0][:, None] - tools[1][None], axis=2), axis=1)
    widest = int(np.argmax(away))
    return tools[0][widest], int(np.searchsorted(at, s[widest])) - 1


@settings(max_examples=25, deadline=None)
@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from([-0.9, -0.6, 0.0, 0.6, 0.9]),
            *(st.floats(-most, most) for most in (0.35, 0.4, 0.3, 0.3, 0.3)),
        ),
        min_size=2,
        max_size=4,
    ),
    size=st.floats(0.005, 0.06),
    pauses=st.sampled_from([0.0, 0.3]),
)
def test_a_motion_keeps_clear_of_what_the_curve_meets_or_is_refused_between_the_points_beside_it(steps, size, pauses):
    points = HOME + np.cumsum([np.zeros(6), *steps], axis=0)
    points = np.clip(points, np.array(ROBOT.lower) + 0.01, np.array(ROBOT.upper) - 0.01)
    if np.min(np.max(np.abs(np.diff(points, axis=0)), axis=1)) < 0.05:
        return
    ball = SceneObject("ball", "sphere", (size,), tuple(bulge(points)[0].tolist()))
    cell, given_points = world(ball), asked(points, pauses)
    try:
        plan = planned(given_points, ball)
    except RetimedCollisionError as error:
        numbers = [int(number) for number in re.findall(r"point (\d+)", error.where)]
        assert numbers == [numbers[0], numbers[0] + 1]
        return
    motion, times = plan.trajectory, given_points.times
    assert times is not None and motion.duration >= times[-1] - 1e-6
    use = limit_use(motion, ROBOT)
    assert max(use.velocity, use.acceleration, use.jerk) <= 1.0
    q = motion.sample_many(np.arange(0.0, motion.duration, 0.001))[0]
    assert cell.all_free(q) is None
    assert (plan.retimed in plan.planner) and plan.planner.startswith("waypoints, timed anew (")


def test_where_the_curve_touches_more_points_are_asked_for_between_those_that_the_sender_gave():
    turn, lift = [0.9, 0, 0, 0, 0, 0], [0, 0.35, -0.3, 0, 0, 0]
    points = HOME + np.array([np.zeros(6), turn, np.add(turn, lift), lift])
    place, after = bulge(points)
    ball = SceneObject("ball", "sphere", (0.03,), tuple(place.tolist()))
    # with a pause at each inner point the numbers are those of the message
    for pauses, first in ((0.0, after), (0.3, 2 * after)):
        with pytest.raises(RetimedCollisionError, check=lambda error: error.between[1] == "ball") as caught:
            planned(asked(points, pauses), ball)
        assert caught.value.where == f"between point {first} and point {first + 1}"
        assert "use more points there, or choose another way. The motion was timed anew, because point " in str(
            caught.value
        )
        assert not re.search(r"at \d+\.\d+ s", str(caught.value))


def test_a_single_point_is_named_by_itself():
    single = from_points(ROBOT, ROBOT.joint_names, [LEFT], times=[1.4])
    PIPELINE.set_scene(Scene((WALL,), 0.01))
    with pytest.raises(RetimedCollisionError, match=r"\(on the way to point 0\)"):
        PIPELINE.through(RIGHT, single, REQUEST, retime=True)
