"""Waypoints from elsewhere: the first one where the arm is, limits at every sample, sentences that name row and joint."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from limit_use import limit_use

from construction_twin.planning.limit_usage import sampled_usage
from construction_twin.planning.timing import ACCELERATION_FRACTION, time_path
from construction_twin.planning.waypoints import (
    START_TOLERANCE_RAD,
    WaypointsError,
    WaypointTimesError,
    asked_path,
    from_points,
    plan_waypoints,
    time_asked,
)
from construction_twin.robot.description import RobotModel, read_robot_files

ROOT = Path(__file__).parents[3]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
NAMES = list(ROBOT.joint_names)
HOME = np.array(ROBOT.home)
ROWS = np.array([HOME, HOME + 0.1, HOME + [0.3, 0.2, 0.1, 0.0, 0.3, 0.0], HOME + 0.2])


def retimed(points):
    """Return the trajectory through waypoints whose own times break a limit."""
    return time_asked(asked_path(points, HOME, ROBOT), ROBOT, 1.0).trajectory


def refused(rows, present=HOME, **values) -> WaypointsError:
    with pytest.raises(WaypointsError) as caught:
        plan_waypoints(from_points(ROBOT, NAMES, rows, **values), present, ROBOT)
    return caught.value


def samples_of(motion) -> tuple[np.ndarray, np.ndarray]:
    grid = np.arange(0.0, motion.duration, 0.004)
    return grid, motion.sample_many(grid)[0]


def test_waypoints_without_times_are_passed_within_the_limits():
    motion = plan_waypoints(from_points(ROBOT, NAMES, ROWS), HOME, ROBOT, speed_scale=0.5)
    assert motion.positions[0].tobytes() == HOME.tobytes() and motion.positions[-1].tobytes() == ROWS[-1].tobytes()
    use = limit_use(motion, ROBOT)
    assert use.velocity <= 0.5 and use.acceleration <= 0.5 and use.jerk <= 1.0
    _, q = samples_of(motion)
    for row in ROWS:
        assert np.min(np.max(np.abs(q - row), axis=1)) < 5e-3


def test_joints_may_come_in_any_order():
    order = [3, 0, 5, 1, 2, 4]
    names = [NAMES[joint] for joint in order]
    mixed = plan_waypoints(from_points(ROBOT, names, ROWS[:, order]), HOME, ROBOT)
    assert mixed.content_hash() == plan_waypoints(from_points(ROBOT, NAMES, ROWS), HOME, ROBOT).content_hash()


def test_the_timing_is_kept():
    times = [2.0, 3.0, 4.5, 7.0]
    motion = plan_waypoints(from_points(ROBOT, NAMES, ROWS, times=times), HOME, ROBOT)
    assert motion.times.tolist() == [0.0, 1.0, 2.5, 5.0]
    assert np.max(np.abs(motion.positions - ROWS)) == 0.0
    assert not motion.velocities[[0, -1]].any() and not motion.accelerations[[0, -1]].any()
    # smooth between them: the jerk, too, goes on through every waypoint
    inner = motion.times[1:-1]
    before, after = motion.sample_many(inner - 1e-9)[3], motion.sample_many(inner + 1e-9)[3]
    assert np.max(np.abs(before - after)) < 1e-4


def test_a_trajectory_of_our_own_comes_back_as_it_was():
    own = time_path(ROWS, ROBOT)
    points = from_points(ROBOT, NAMES, own.positions, own.velocities, own.accelerations, own.times)
    assert plan_waypoints(points, HOME, ROBOT).content_hash() == own.content_hash()


def test_given_velocities_are_kept_and_accelerations_fit_them():
    own = time_path(ROWS, ROBOT, duration=12.0)
    motion = plan_waypoints(from_points(ROBOT, NAMES, own.positions, own.velocities, times=own.times), HOME, ROBOT)
    assert np.array_equal(motion.velocities, own.velocities)
    assert np.max(np.abs(motion.accelerations - own.accelerations)) < 0.02 * np.max(np.abs(own.accelerations))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    steps=st.lists(st.lists(st.floats(-0.2, 0.2), min_size=6, max_size=6), min_size=1, max_size=6),
    spans=st.lists(st.floats(0.3, 3.0), min_size=6, max_size=6),
)
def test_timed_waypoints_are_within_the_limits_or_refused(steps, spans):
    rows = HOME + np.cumsum(np.vstack([np.zeros(6), steps]), axis=0)
    rows = np.clip(rows, np.array(ROBOT.lower) + 0.1, np.array(ROBOT.upper) - 0.1)
    times = np.concatenate(([0.0], np.cumsum(spans[: len(rows) - 1])))
    try:
        motion = plan_waypoints(from_points(ROBOT, NAMES, rows, times=times), HOME, ROBOT)
    except WaypointsError as error:
        assert error.joint in NAMES and 1 <= error.row < len(rows) and error.value > error.limit
        return
    use = limit_use(motion, ROBOT)
    assert max(use.velocity, use.acceleration, use.jerk) <= 1.0 + 1e-6
    assert np.max(np.abs(motion.sample_many(motion.times)[0] - rows)) < 1e-9


def test_a_first_waypoint_close_to_the_arm_is_where_the_arm_is():
    present = HOME + 0.9 * START_TOLERANCE_RAD
    motion = plan_waypoints(from_points(ROBOT, NAMES, ROWS), present, ROBOT)
    assert motion.positions[0].tobytes() == present.tobytes()


def test_points_that_are_doubled_within_rounding_are_one():
    def motion(rows, **values):
        return plan_waypoints(from_points(ROBOT, NAMES, rows, **values), HOME, ROBOT)

    once = motion(ROWS)
    for noise in (0.0, 1e-9, 1e-6):
        doubled = [row for row in ROWS for row in (row, row + noise)]
        assert motion(doubled).duration == pytest.approx(once.duration, rel=1e-3)
    # points that are close, but go somewhere, stay
    np.testing.assert_allclose(
        motion(np.linspace(HOME, HOME + 1e-4, 400)).positions[-1], HOME + 1e-4, rtol=0, atol=1e-12
    )
    times = [0.0, 2.0, 4.0, 7.0]
    doubled_times = [time for time in times for _ in (0, 1)]
    assert motion(np.repeat(ROWS, 2, axis=0), times=doubled_times).times.tolist() == times
    # at another time it is a pause
    rows = ROWS[[0, 1, 1, 2]]
    assert motion(rows, times=times).times.tolist() == times


def test_messages_count_doubled_points():
    rows = np.repeat(ROWS, 2, axis=0)
    rows[5, 1] = 9.0
    assert refused(rows).row == 5


def test_from_a_hair_outside_its_range_the_arm_comes_in():
    robot = dataclasses.replace(ROBOT, lower=(HOME[0] + math.radians(0.04), *ROBOT.lower[1:]))
    inside = from_points(robot, NAMES, [HOME, HOME + 0.1, HOME + 0.2])
    assert plan_waypoints(inside, HOME, robot).positions[0].tobytes() == HOME.tobytes()
    timed = from_points(robot, NAMES, [HOME, HOME + 0.1, HOME + 0.2], times=[0.0, 2.0, 4.0])
    assert plan_waypoints(timed, HOME, robot).times.tolist() == [0.0, 2.0, 4.0]
    back = from_points(robot, NAMES, [HOME, HOME + 0.1, HOME])
    with pytest.raises(WaypointsError, match="point 2: joint_a1 is 0 rad; its range is"):
        plan_waypoints(back, HOME, robot)
    # no sample goes further out than the start
    swing = from_points(robot, NAMES, [HOME, HOME + 1e-3, HOME + 0.2], times=[0.0, 2.0, 4.0])
    with pytest.raises(WaypointsError, match="joint_a1 overshoots its range"):
        plan_waypoints(swing, HOME, robot)


def test_a_first_waypoint_elsewhere_is_refused():
    present = HOME - [0, 0, 0.5, 0, 0, 0]
    error = refused(ROWS, present)
    assert (error.row, error.joint, error.limit) == (0, "joint_a3", START_TOLERANCE_RAD)
    assert error.value == HOME[2] and "plan a motion to it first" in str(error)


def test_a_waypoint_out_of_range_names_point_joint_and_range():
    rows = ROWS.copy()
    rows[2, 4] = 3.0
    error = refused(rows)
    assert (error.row, error.joint, error.value, error.limit) == (2, "joint_a5", 3.0, ROBOT.upper[4])
    assert "point 2: joint_a5 is 3 rad" in str(error)


@pytest.mark.parametrize(("times", "row"), [([0, 1, 1, 2], 2), ([0, 2, 1, 3], 2), ([0, -1, 1, 3], 1)])
def test_times_must_increase(times, row):
    error = refused(ROWS, times=times)
    assert error.row == row and "times must increase" in str(error)


def test_times_that_the_clock_cannot_tell_apart_are_refused():
    assert "too close together" in str(refused(ROWS, times=[0.0, 1.0, 1.0 + 1e-11, 2.0]))


@pytest.mark.parametrize(("span", "quantity"), [(0.1, "velocity"), (1.0, "acceleration"), (2.0, "jerk")])
def test_too_fast_names_the_limit(span, quantity):
    limits = {"velocity": (1.0, 1e4, 1e6), "acceleration": (1e3, 0.5, 1e6), "jerk": (1e3, 1e3, 0.5)}[quantity]
    robot = _robot(*limits)
    rows = np.array([HOME, HOME + 0.3])
    with pytest.raises(WaypointsError, match=quantity) as caught:
        plan_waypoints(from_points(robot, NAMES, rows, times=[0.0, span]), HOME, robot)
    assert caught.value.row == 1 and caught.value.value > caught.value.limit
    # three times the velocity is a mistake, too much jerk is another timing's to mend
    assert isinstance(caught.value, WaypointTimesError) == (quantity != "velocity")
    assert caught.value.limit == getattr(robot, quantity)[0]


def _robot(velocity, acceleration, jerk):
    return dataclasses.replace(ROBOT, velocity=(velocity,) * 6, acceleration=(acceleration,) * 6, jerk=(jerk,) * 6)


def test_a_swing_past_the_range_between_waypoints_is_refused():
    rows = np.tile(HOME, (4, 1))
    rows[1:, 1] = ROBOT.upper[1] - np.array([0.8, 1e-4, 1e-4])
    error = refused(rows, times=[0.0, 4.0, 6.0, 8.0])
    assert error.joint == "joint_a2" and "overshoots" in str(error)


@pytest.mark.parametrize("end", [0, -1])
@pytest.mark.parametrize("what", ["velocities", "accelerations"])
def test_moving_at_an_end_is_refused(end, what):
    zeros = np.zeros_like(ROWS)
    values = {"velocities": zeros.copy(), "accelerations": zeros.copy()}
    values[what][end, 2] = 0.1
    error = refused(ROWS, times=[0, 2, 4, 6], **values)
    assert error.joint == "joint_a3" and error.row in (0, 3) and "at rest" in str(error)


@pytest.mark.parametrize("names", [NAMES[:5], [*NAMES[:5], "joint_b6"], [*NAMES[:5], "joint_a1"], []])
def test_the_joints_must_be_the_robot_s(names):
    with pytest.raises(WaypointsError, match="expected each of joint_a1"):
        from_points(ROBOT, names, ROWS)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"positions": []}, "0 waypoints"),
        ({"positions": [*ROWS[:2], ROWS[2][:5]]}, "point 2: 5 values of position; expected 6"),
        ({"positions": ROWS, "times": [0, 1]}, "2 times for 4 points"),
        ({"positions": ROWS, "times": [0, 1, 2, 3], "velocities": ROWS[:2]}, "2 points have a velocity"),
        ({"positions": ROWS + [0, 0, np.nan, 0, 0, 0]}, "point 0: joint_a3 has nan"),
        ({"positions": ROWS, "times": [0, 1, math.inf, 3]}, "point 2: the time is inf"),
        (
            {"positions": ROWS, "times": [0, 1, 2, 3], "velocities": np.full((4, 6), np.inf)},
            "velocities; expected a finite",
        ),
    ],
)
def test_values_that_do_not_fit_are_refused(values, message):
    with pytest.raises(WaypointsError, match=message):
        from_points(ROBOT, NAMES, **values)


def test_times_that_are_all_zero_are_none():
    points = from_points(ROBOT, NAMES, ROWS, velocities=[[], [], [], []], times=[0.0] * 4)
    assert points.times is None and points.velocities is None


def test_a_single_point_is_the_goal_of_a_motion_from_the_present_pose():
    goal = HOME + 0.2
    motion = plan_waypoints(from_points(ROBOT, NAMES, [goal]), HOME, ROBOT, speed_scale=0.5)
    assert motion.positions[0].tobytes() == HOME.tobytes() and motion.positions[-1].tobytes() == goal.tobytes()
    assert limit_use(motion, ROBOT).velocity <= 0.5
    # what MATLAB's users send: a time, and velocities of zero
    timed = plan_waypoints(from_points(ROBOT, NAMES, [goal], velocities=[[0.0] * 6], times=[3.0]), HOME, ROBOT)
    assert timed.duration == 3.0 and timed.positions[-1].tobytes() == goal.tobytes()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"times": [0.1]}, "point 0 (on the path to it, 0.028 s after the start): joint_a1 has a velocity of "),
        ({"times": [-1.0]}, "point 0: its time -1 s is not after 0 s; times must increase"),
        (
            {"times": [3.0], "velocities": [[0.1] * 6]},
            "point 0: joint_a1 moves there (0.1 rad/s); the motion must begin",
        ),
    ],
)
def test_a_single_point_that_cannot_be_reached_so_is_refused(values, message):
    assert message in str(refused([HOME + 0.2], **values))


def test_no_point_is_no_motion():
    assert str(refused([])) == "0 waypoints; a motion needs at least one, its goal"


def without_jerk_limit(robot: RobotModel, goal: np.ndarray, period: float = 0.1):
    """A straight motion as planners without a jerk limit time it: full acceleration, full deceleration, points every `period`."""
    way = goal - HOME
    acceleration = float(np.min(np.array(robot.acceleration)[way != 0.0] / np.abs(way[way != 0.0])))
    half = float(np.sqrt(1.0 / acceleration))
    times = np.append(np.arange(0.0, 2 * half, period), 2 * half)
    rising = times < half
    left = 2 * half - times
    part = np.where(rising, 0.5 * acceleration * times**2, 1.0 - 0.5 * acceleration * left**2)
    speed = acceleration * np.where(rising, times, left)
    push = np.where(rising, acceleration, -acceleration)
    return times, HOME + np.outer(part, way), np.outer(speed, way), np.outer(push, way)


@pytest.mark.parametrize("with_accelerations", [True, False])
def test_times_of_planners_without_a_jerk_limit_are_refused_and_may_be_replaced(with_accelerations):
    times, rows, velocities, accelerations = without_jerk_limit(ROBOT, HOME + np.array([0.6, 0.2, -0.3, 0.1, 0.0, 0.4]))
    points = from_points(ROBOT, NAMES, rows, velocities, accelerations if with_accelerations else None, times)
    with pytest.raises(WaypointTimesError):
        plan_waypoints(points, HOME, ROBOT)
    trajectory = retimed(points)
    use = sampled_usage(trajectory, ROBOT).largest()
    assert max(*use.velocity, *use.acceleration) <= ACCELERATION_FRACTION + 1e-6 and max(use.jerk) <= 1.0 + 1e-6
    assert times[-1] <= trajectory.duration < 3.0 * times[-1]
    np.testing.assert_allclose(trajectory.positions[-1], rows[-1], atol=1e-12)
    # the same points: the motion is a straight line, so is this
    way = rows[-1] - HOME
    along = (trajectory.positions - HOME) @ way / (way @ way)
    np.testing.assert_allclose(trajectory.positions, HOME + np.outer(along, way), atol=1e-6)


def test_times_that_are_replaced_are_never_made_shorter():
    """Whoever plans slowly wants it slow: full acceleration of a tenth, over a long time."""
    slow = dataclasses.replace(ROBOT, acceleration=tuple(value / 200 for value in ROBOT.acceleration))
    times, rows, velocities, accelerations = without_jerk_limit(slow, HOME + 0.5)
    points = from_points(ROBOT, NAMES, rows, velocities, accelerations, times)
    with pytest.raises(WaypointTimesError, match="the motion must begin and end at rest"):
        plan_waypoints(points, HOME, ROBOT)
    assert times[-1] <= retimed(points).duration < 1.05 * times[-1]


def test_a_single_point_is_retimed_to_no_less_than_its_time():
    slowly = np.full((1, len(HOME)), 0.01)
    point = from_points(ROBOT, NAMES, [HOME + 0.1], np.zeros_like(slowly), slowly, [60.0])
    with pytest.raises(WaypointTimesError, match="the motion must begin and end at rest"):
        plan_waypoints(point, HOME, ROBOT)
    assert retimed(point).duration == 60.0


def test_a_single_point_whose_time_needs_too_much_jerk_is_retimed_to_no_less_than_its_time():
    way = 0.01
    # a quintic from rest to rest has its largest jerk, 60 times its way per time cubed, at both ends
    asked = float(np.max(np.cbrt(60.0 * way / (1.2 * np.array(ROBOT.jerk)))))
    point = from_points(ROBOT, NAMES, [HOME + way], times=[asked])
    with pytest.raises(WaypointTimesError, match="has a jerk of .*, give it more time"):
        plan_waypoints(point, HOME, ROBOT)
    # times are kept on whole nanoseconds
    assert retimed(point).duration >= asked - 1e-9


#: MoveIt's scaling factor, and the velocity that 1.1.16 gave joint_a1 at point 0 with moveit/config/kr120 [rad/s].
LATE = [(0.1, 0.0027192), (0.5, 0.0135961), (1.0, 0.0271922)]


def totg(scaling: float) -> dict[str, np.ndarray]:
    """A motion of joint_a1 as MoveIt 1.1.12 to 1.1.16 times it.

    Points every 0.1 s, and at each the velocity at the end of the 10 ms step that it lies in; the last point is exact.
    """
    a, v = scaling * ROBOT.acceleration[0], scaling * ROBOT.velocity[0]
    way = np.zeros(6)
    way[0] = 0.5
    rise = min(v / a, math.sqrt(way[0] / a))
    end = way[0] / (a * rise) + rise
    t = np.append(np.arange(0.0, end, 0.1), end)
    late = np.append(np.minimum(t[:-1] + 0.01, end), end)

    def speed(at):
        return np.minimum(np.minimum(a * at, a * rise), a * (end - at))

    left = end - t
    s = np.where(t < rise, a * t**2 / 2, np.where(left < rise, way[0] - a * left**2 / 2, a * rise * (t - rise / 2)))
    push = np.where(t < rise, a, np.where(left <= rise, -a, 0.0))
    unit = way / way[0]
    return {
        "positions": HOME + np.outer(s, unit),
        "velocities": np.outer(speed(late), unit),
        "accelerations": np.outer(push, unit),
        "times": t,
    }


@pytest.mark.parametrize("with_accelerations", [True, False])
@pytest.mark.parametrize(("scaling", "first"), LATE)
def test_velocities_that_moveit_gives_one_step_late_are_timed_anew(scaling, first, with_accelerations):
    given = totg(scaling)
    assert given["velocities"][0, 0] == pytest.approx(first, abs=1e-7) and given["velocities"][-1, 0] == 0.0
    if not with_accelerations:
        del given["accelerations"]
    points = from_points(ROBOT, NAMES, **given)
    with pytest.raises(WaypointTimesError) as caught:
        plan_waypoints(points, HOME, ROBOT)
    assert str(caught.value) == (
        f"point 0: joint_a1 moves there ({first:.6g} rad/s, no more than 10 ms of its acceleration); the motion must begin and end "
        "at rest"
    ).replace(f"{first:.6g}", f"{given['velocities'][0, 0]:.6g}")
    motion = retimed(points)
    assert motion.duration >= given["times"][-1] and not motion.velocities[[0, -1]].any()
    assert motion.positions[-1].tobytes() == given["positions"][-1].tobytes()
    use = limit_use(motion, ROBOT)
    assert use.velocity <= 1.0 and use.acceleration <= 1.0 and use.jerk <= 1.0


@pytest.mark.parametrize("row", [0, -1])
def test_an_end_that_moves_more_than_moveit_s_step_is_refused_by_every_route(row):
    """The end of a motion that goes on elsewhere: it must not become one that rests there."""
    given = totg(1.0)
    given["velocities"][row, 1] = 0.0101 * ROBOT.acceleration[1]
    # the largest velocity there is that of another joint, within its own bound
    assert row == -1 or given["velocities"][0, 0] > given["velocities"][0, 1]
    with pytest.raises(WaypointsError, check=lambda error: error.joint == "joint_a2") as caught:
        plan_waypoints(from_points(ROBOT, NAMES, **given), HOME, ROBOT)
    assert not isinstance(caught.value, WaypointTimesError)


@pytest.mark.parametrize("told", [True, False])
def test_times_for_another_arm_are_refused_also_where_the_ends_would_be_timed_anew(told):
    """More than 1.1 times a joint's velocity is no matter of timing: it was meant for another arm."""
    given = totg(1.0)
    if told:
        given["velocities"][3, 0] = 1.2 * ROBOT.velocity[0]
    else:
        given["times"] = given["times"] / 8.0
    with pytest.raises(WaypointsError, match="joint_a1 has a velocity of") as caught:
        plan_waypoints(from_points(ROBOT, NAMES, **given), HOME, ROBOT)
    assert not isinstance(caught.value, WaypointTimesError)


def test_a_first_point_elsewhere_and_later_is_refused_with_what_to_do():
    error = refused([HOME + 0.2, HOME + 0.3], times=[2.5, 4.0])
    assert str(error).endswith("put the arm's pose before it, at 0 s, or plan a motion to it first")
    with_start = from_points(ROBOT, NAMES, [HOME, HOME + 0.2, HOME + 0.3], times=[0.0, 2.5, 4.0])
    assert plan_waypoints(with_start, HOME, ROBOT).duration == 4.0


#: How a time of `time_from_start` comes to whole nanoseconds: genpy cuts off, roscpp and MATLAB round.
WHOLE_NS = {"cut": lambda times: np.floor(times * 1e9) / 1e9, "rounded": lambda times: np.round(times * 1e9) / 1e9}


def densely(points: int, duration: float, whole: str, more: str, jerk: float = 0.95):
    """One smooth motion in many points, which needs so much of some joint's largest jerk and little else."""
    x = np.linspace(0.0, 1.0, points)
    # a quintic from rest to rest has its largest jerk at both ends, 60 times its way per time cubed
    way = np.array([0.5, -0.4, 0.6, 1.0, -0.8, 1.0])
    way *= jerk * np.min(np.array(ROBOT.jerk) / np.abs(way)) * duration**3 / 60.0
    values = {
        "velocities": np.outer(30.0 * x**2 * (1.0 - x) ** 2 / duration, way),
        "accelerations": np.outer(60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration**2, way),
    }
    rows = HOME + np.outer(x**3 * (10.0 - 15.0 * x + 6.0 * x**2), way)
    given = {name: values[name] for name in ("velocities", "accelerations")[: ("", "v", "va").index(more)]}
    return from_points(ROBOT, NAMES, rows, times=WHOLE_NS[whole](x * duration), **given)


@pytest.mark.parametrize("more", ["", "v", "va"])
@pytest.mark.parametrize("whole", WHOLE_NS)
@settings(max_examples=10, deadline=None)
@given(points=st.integers(500, 20_000), duration=st.floats(0.5, 1.05))
def test_times_that_were_rounded_to_a_nanosecond_are_kept_however_many_points_there_are(whole, more, points, duration):
    given = densely(points, duration, whole, more)
    motion = plan_waypoints(given, HOME, ROBOT)
    np.testing.assert_array_equal(motion.times, given.times)
    # what the controller gets, every 4 ms, has none of it
    _, q = samples_of(motion)
    for order, limits in ((1, ROBOT.velocity), (2, ROBOT.acceleration), (3, ROBOT.jerk)):
        assert np.max(np.abs(np.diff(q, order, axis=0)) / 0.004**order / limits) < 1.0


@pytest.mark.parametrize("more", ["", "v", "va"])
@pytest.mark.parametrize("points", [500, 20_000])
def test_too_much_jerk_is_refused_however_many_points_there_are(points, more):
    with pytest.raises(WaypointTimesError, match="has a jerk of .*, give it more time"):
        plan_waypoints(densely(points, 0.8, "rounded", more, jerk=1.1), HOME, ROBOT)


def passing_times(motion, rows) -> np.ndarray:
    """When a motion along a straight line passes the rows on it."""
    way = rows[-1] - rows[0]
    grid = np.linspace(0.0, motion.duration, 200_001)
    along = np.maximum.accumulate((motion.sample_many(grid)[0] - rows[0]) @ way / (way @ way))
    return np.interp((rows - rows[0]) @ way / (way @ way), along, grid)


@settings(max_examples=15, deadline=None)
@given(
    fast=st.floats(0.3, 0.9),
    slow=st.floats(0.02, 0.15),
    middle=st.floats(0.2, 0.8),
    step=st.sampled_from([0.02, 0.05, 0.1]),
)
def test_a_part_that_is_slow_stays_slow_when_times_are_replaced(fast, slow, middle, step):
    """Pilz' sequences are slow near something and fast elsewhere; between the two the speed jumps here."""
    way = np.array([0.8, 0.3, -0.4, 0.3, -0.2, 0.5])
    full = float(np.min(np.array(ROBOT.velocity) / np.abs(way)))
    at = [0.0]
    while at[-1] < 1.0:
        speed = slow if abs(at[-1] - middle) < 0.1 else fast
        at.append(min(1.0, at[-1] + full * speed * step))
    rows, times = HOME + np.outer(at, way), step * np.arange(len(at))
    points = from_points(ROBOT, NAMES, rows, times=times)
    with pytest.raises(WaypointsError):
        plan_waypoints(points, HOME, ROBOT)
    motion = retimed(points)
    assert np.min(np.diff(passing_times(motion, rows))) >= 0.98 * step
    assert motion.duration < 2.0 * times[-1] + 2.0
    use = limit_use(motion, ROBOT)
    assert use.velocity <= 1.0 and use.acceleration <= 1.0 and use.jerk <= 1.0


def test_a_pause_at_a_point_is_kept_as_time_when_times_are_replaced():
    rows = [HOME, HOME + 0.1, HOME + 0.1, HOME + 0.2]
    points = from_points(ROBOT, NAMES, rows, times=[0.0, 0.2, 5.2, 5.4])
    assert retimed(points).duration >= 5.4


def trapezoid(speed: float, acceleration: float, step: float) -> dict[str, np.ndarray]:
    """What MoveIt's time parameterization makes of a straight line: constant acceleration, speed, deceleration, sampled evenly.

    `speed` and `acceleration` are fractions of the limits.
    """
    way = np.array([0.5, 0.2, -0.3, 0.3, -0.2, 0.4])
    v = np.min(speed * np.array(ROBOT.velocity) / np.abs(way))
    a = np.min(acceleration * np.array(ROBOT.acceleration) / np.abs(way))
    rise = min(v / a, 1.0 / np.sqrt(a))
    end = 1.0 / (a * rise) + rise
    t = np.append(np.arange(0.0, end, step), end)
    late = end - t
    s = np.where(t < rise, a * t**2 / 2, np.where(late < rise, 1 - a * late**2 / 2, a * rise * (t - rise / 2)))
    ds = np.where(t < rise, a * t, np.where(late < rise, a * late, a * rise))
    dds = np.where(t < rise, a, np.where(late < rise, -a, 0.0))
    return {
        "positions": HOME + way * s[:, None],
        "velocities": way * ds[:, None],
        "accelerations": way * dds[:, None],
        "times": t,
    }


@pytest.mark.parametrize(("speed", "acceleration"), [(1.0, 1.0), (0.1, 0.1), (0.5, 0.3)])
@pytest.mark.parametrize("step", [0.1, 0.02])
def test_accelerations_that_jump_are_refused_or_the_same_points_are_passed_in_times_of_our_own(
    speed, acceleration, step
):
    given = trapezoid(speed, acceleration, step)
    rows, asked = given["positions"], given["times"][-1]
    with pytest.raises(WaypointTimesError):
        plan_waypoints(from_points(ROBOT, NAMES, **given), HOME, ROBOT)
    motion = retimed(from_points(ROBOT, NAMES, **given))
    assert motion.positions[-1].tobytes() == rows[-1].tobytes() and motion.duration >= asked - 1e-9
    use = limit_use(motion, ROBOT)
    assert use.velocity <= 1.0 and use.acceleration <= 1.0 and use.jerk <= 1.0
    _, q = samples_of(motion)
    for row in rows:
        assert np.min(np.max(np.abs(q - row), axis=1)) < 5e-3
