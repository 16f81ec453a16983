"""The dense re-check: every 4 ms sample against limits and scene."""

from __future__ import annotations

import dataclasses
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from construction_twin.core.units import CYCLE
from construction_twin.planning.recheck import CollisionError, LimitError, check_limits, recheck
from construction_twin.planning.timing import VELOCITY_FRACTION, time_path
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.plan import Clearance
from construction_twin.robot.trajectory import Trajectory

ROOT = Path(__file__).parents[3]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
HOME = np.array(ROBOT.home)
GOAL = HOME + [0.6, 0.2, 0, 0, 0, 0]
MOTION = time_path(np.array([HOME, GOAL]), ROBOT)


class WallWorld:
    """A world in which joint 1 touches a wall at an angle."""

    def __init__(self, angle: float):
        self.angle = angle
        self.seen = None

    def first_contact(self, qs):
        self.seen = qs
        touching = np.flatnonzero(qs[:, 0] >= self.angle)
        if not len(touching):
            return None
        row = int(touching[0])
        before = row - 1 + (self.angle - qs[row - 1, 0]) / (qs[row, 0] - qs[row - 1, 0]) if row else 0.0
        return before, SimpleNamespace(between=("link_1", "wall"))

    def clearance_of(self, qs, changing):
        # what no joint changes is none of the plan's
        assert changing
        row = int(np.argmax(qs[:, 0]))
        return Clearance(self.angle - float(qs[row, 0]), ("link_1", "wall"), (1.0, 2.0, 3.0)), row


def clock():
    ticks = count()
    return lambda: 0.25 * next(ticks)


def test_measures_every_sample():
    world = WallWorld(1.0)
    result = recheck(MOTION, ROBOT, world, clock())
    assert len(world.seen) == int(np.ceil(MOTION.duration / CYCLE)) + 1
    assert world.seen[0].tobytes() == HOME.tobytes() and world.seen[-1].tobytes() == GOAL.tobytes()
    assert np.max(np.abs(world.seen[1] - MOTION.sample(CYCLE)[0])) < 1e-12
    assert result.clearance == Clearance(1.0 - GOAL[0], ("link_1", "wall"), (1.0, 2.0, 3.0), MOTION.duration)
    assert result.recheck_time == 0.25
    assert max(result.usage.velocity) <= VELOCITY_FRACTION * (1 + 1e-6) and result.usage.velocity[2:] == (
        0,
        0,
        0,
        0,
    )


def test_contact_says_when():
    with pytest.raises(CollisionError) as caught:
        recheck(MOTION, ROBOT, WallWorld(0.3), clock())
    assert caught.value.between == ("link_1", "wall")
    time = float(caught.value.where.split()[1])
    # where it touches between two samples, to the millisecond that is told
    assert MOTION.sample(time + 1e-3)[0][0] >= 0.3 > MOTION.sample(time - 1e-3)[0][0]


@pytest.mark.parametrize("quantity", ["velocity", "acceleration", "jerk"])
def test_a_broken_limit_names_time_joint_and_values(quantity):
    slower = dataclasses.replace(ROBOT, **{quantity: tuple(0.3 * limit for limit in getattr(ROBOT, quantity))})
    with pytest.raises(LimitError) as caught:
        recheck(MOTION, slower, WallWorld(1.0), clock())
    error = caught.value
    assert error.quantity == quantity and error.joint in ("joint_a1", "joint_a2") and error.value > error.limit
    assert error.limit == getattr(slower, quantity)[ROBOT.joint_names.index(error.joint)]
    assert error.where.startswith("at ") and error.where in str(error)


def test_a_sample_out_of_range_is_refused():
    beyond = HOME + [0, 0, 0, 0, 0, 7.0]
    motion = Trajectory(ROBOT.joint_names, [0.0, 20.0], [HOME, beyond], np.zeros((2, 6)), np.zeros((2, 6)))
    with pytest.raises(LimitError, match="joint_a6 has a position") as caught:
        check_limits(motion, ROBOT)
    assert caught.value.limit == ROBOT.upper[5] and caught.value.value > ROBOT.upper[5]


def test_exactly_at_the_limits_passes():
    fractions = check_limits(MOTION, ROBOT)
    exact = {
        name: tuple(
            max(fraction, 1e-3) * limit for fraction, limit in zip(getattr(fractions, name), getattr(ROBOT, name))
        )
        for name in ("velocity", "acceleration", "jerk")
    }
    assert max(check_limits(MOTION, dataclasses.replace(ROBOT, **exact)).velocity) == pytest.approx(1.0)


def test_the_jerk_just_before_and_after_a_waypoint_counts():
    # the jerk jumps at a waypoint between two samples: no sample of the quintics shows its largest values
    times = np.array([0.0, 1.0021, 2.0])
    positions = HOME + np.array([[0.0], [0.1], [0.2]]) * [1, 0, 0, 0, 0, 0]
    rates = np.zeros((3, 6))
    rates[1, 0] = 0.3
    motion = Trajectory(ROBOT.joint_names, times, positions, rates, np.zeros((3, 6)))
    sides = np.abs(motion.sample_many(np.array([1e-9, 1.0021 - 1e-9, 1.0021 + 1e-9, 2.0 - 1e-9]))[3][:, 0])
    assert check_limits(motion, ROBOT).jerk[0] * ROBOT.jerk[0] == pytest.approx(np.max(sides), rel=1e-5)


def test_the_jerk_of_the_samples_differences_counts():
    # a tick of the acceleration that is over before the next sample: seen in the positions only
    times = np.array([0.0, 1.0, 1.004, 1.008, 1.012, 2.0])
    positions = np.tile(HOME, (6, 1))
    positions[3:, 0] += 2e-6
    motion = Trajectory(ROBOT.joint_names, times, positions, np.zeros((6, 6)), np.zeros((6, 6)))
    q = motion.sample_many(np.arange(0.0, 2.02, CYCLE))[0]
    third = np.max(np.abs(np.diff(q[:, 0], 3))) / CYCLE**3
    assert check_limits(motion, dataclasses.replace(ROBOT, jerk=(1e6,) * 6)).jerk[0] * 1e6 >= third * (1 - 1e-9)


def test_the_jerk_that_no_sample_and_no_waypoint_shows_counts():
    # a waypoint every 4 ms, and between any two of them a jerk that is largest in the middle: the mean of it is what an arm feels
    jerk = 10.0 * np.repeat([1.0, -1.0, -1.0, 1.0], 25)
    at, rate, change = np.zeros((3, len(jerk) + 1))
    for row, mean in enumerate(jerk):
        change[row + 1] = change[row] + mean * CYCLE
        rate[row + 1] = rate[row] + change[row] * CYCLE + mean * CYCLE**2 / 2
        # a jerk of mean - (mean / 2) (6 x^2 - 6 x + 1): half the mean at both ends
        at[row + 1] = at[row] + rate[row] * CYCLE + change[row] * CYCLE**2 / 2 + mean * CYCLE**3 * (1 / 6 - 1 / 120)
    axis = np.eye(6)[0]
    columns = (HOME + at[:, None] * axis, rate[:, None] * axis, change[:, None] * axis)
    motion = Trajectory(ROBOT.joint_names, np.arange(len(at)) * CYCLE, *columns)
    shown = np.abs(motion.sample_many(np.arange(len(jerk)) * CYCLE + 1e-9)[3][:, 0])
    assert np.max(shown) == pytest.approx(5.0, rel=1e-3), (
        "waypoints and samples must not show it, or this test shows nothing"
    )
    wide = dataclasses.replace(ROBOT, jerk=(1e6,) * 6)
    assert check_limits(motion, wide).jerk[0] * 1e6 == pytest.approx(10.0, rel=0.02)
