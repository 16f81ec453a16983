"""Trajectories: quintic segments, validation, behaviour outside the interval, hash; and plans."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from plan_samples import make_plan

from construction_twin.robot.motion_errors import TrajectoryError
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory, whole_nanoseconds

NAMES = ("joint_a1", "joint_a2")


def trajectory(**changes) -> Trajectory:
    values = dict(
        joint_names=NAMES,
        times=[0.0, 0.5, 2.0],
        positions=[[0.0, 1.0], [0.5, 0.8], [2.0, -1.0]],
        velocities=[[0.1, 0.0], [1.0, -1.0], [0.2, 0.3]],
        accelerations=[[0.5, -0.5], [0.0, 2.0], [-0.4, 0.6]],
    )
    return Trajectory(**(values | changes))


def polynomial_trajectory(coefficients: np.ndarray, times: np.ndarray) -> Trajectory:
    """Sample the polynomials (one per joint, ascending powers) and their derivatives at `times`."""
    polynomials = [np.polynomial.Polynomial(row) for row in coefficients]
    rows = [np.column_stack([p.deriv(order)(times) for p in polynomials]) for order in range(3)]
    return Trajectory(NAMES, times, *rows)


def plan(**changes) -> Plan:
    return replace(make_plan(trajectory(), "p1"), **changes)


class TestSample:
    def test_meets_every_waypoint(self):
        motion = trajectory()
        for row, t in enumerate(motion.times):
            q, qd, qdd = motion.sample(t)
            assert np.array_equal(q, motion.positions[row])
            assert np.array_equal(qd, motion.velocities[row])
            assert np.array_equal(qdd, motion.accelerations[row])

    def test_reproduces_any_quintic(self):
        coefficients = np.random.default_rng(1).normal(size=(2, 6))
        motion = polynomial_trajectory(coefficients, np.array([0.0, 0.3, 0.35, 1.1]))
        for t in np.linspace(0.0, 1.1, 57):
            q, qd, qdd = motion.sample(t)
            for joint, row in enumerate(coefficients):
                p = np.polynomial.Polynomial(row)
                sampled, exact = [q[joint], qd[joint], qdd[joint]], [p(t), p.deriv()(t), p.deriv(2)(t)]
                np.testing.assert_allclose(sampled, exact, atol=1e-9)

    def test_velocity_and_acceleration_are_the_position_s_derivatives(self):
        motion = trajectory()
        h = 1e-5
        for t in (0.1, 0.49, 0.7, 1.9):
            before, (q, qd, qdd), after = motion.sample(t - h)[0], motion.sample(t), motion.sample(t + h)[0]
            np.testing.assert_allclose((after - before) / (2 * h), qd, atol=1e-8)
            np.testing.assert_allclose((after - 2 * q + before) / h**2, qdd, atol=1e-4)

    @pytest.mark.parametrize(("t", "row"), [(-1.0, 0), (-1e-12, 0), (2.0 + 1e-9, -1), (1e9, -1), (math.inf, -1)])
    def test_rests_at_the_ends_outside(self, t, row):
        motion = trajectory()
        q, qd, qdd = motion.sample(t)
        assert np.array_equal(q, motion.positions[row])
        assert not qd.any() and not qdd.any()

    def test_refuses_nan(self):
        with pytest.raises(TrajectoryError, match="a trajectory cannot be sampled at time nan"):
            trajectory().sample(math.nan)

    def test_many_equals_one_by_one(self):
        motion = trajectory()
        times = np.concatenate((np.linspace(-0.5, 2.5, 101), motion.times))
        q, qd, qdd, _ = motion.sample_many(times)
        for row, t in enumerate(times):
            for many, one in zip((q, qd, qdd), motion.sample(t)):
                np.testing.assert_allclose(many[row], one, rtol=0, atol=1e-12)

    def test_many_gives_jerk(self):
        coefficients = np.array([[0, 0, 0, 1.0, 0, 0], [0, 0, 0, 0, 1.0, 0]])
        jerk = polynomial_trajectory(coefficients, np.array([0.0, 1.0, 2.0])).sample_many([0.5, 1.5, 2.5])[3]
        np.testing.assert_allclose(jerk, [[6.0, 12.0], [6.0, 36.0], [0.0, 0.0]], atol=1e-12)


class TestValidation:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            (dict(joint_names=()), "joint names"),
            (dict(joint_names=("a", "a")), "all different"),
            (dict(joint_names=("a", "b", "c")), r"positions have shape \(3, 2\); expected \(3, 3\)"),
            (dict(times=[0.0, 1.0]), r"expected \(2, 2\)"),
            (dict(times=[0.0], positions=[[0, 0]], velocities=[[0, 0]], accelerations=[[0, 0]]), "at least two"),
            (dict(times=[0.1, 0.5, 2.0]), "first waypoint is at 0.1 s"),
            (dict(times=[0.0, 0.5, 0.5]), "waypoint 2 is at 0.500000000 s"),
            (dict(times=[0.0, 1e-10, 1.0]), "waypoint 1"),
            (dict(times=[0.0, math.nan, 1.0]), "time of waypoint 1 is nan"),
            (dict(times=[[0.0, 0.5, 2.0]]), "times have 2 dimensions"),
            (dict(positions=[[0.0, 1.0], [0.5, math.nan], [2.0, -1.0]]), "positions of waypoint 1: joint_a2 is nan"),
            (dict(velocities=[[0.0, 1.0], [0.5, 1.0], [math.inf, -1.0]]), "velocities of waypoint 2: joint_a1 is inf"),
            (dict(accelerations=[[], [], []]), "accelerations have shape"),
            (dict(accelerations=[[0.0, 0.0], [0.0], [0.0, 0.0]]), "accelerations are not a regular array"),
        ],
    )
    def test_refuses_with_the_place(self, changes, message):
        with pytest.raises(TrajectoryError, match=message):
            trajectory(**changes)

    def test_times_are_whole_nanoseconds(self):
        motion = trajectory(times=[0.0, 1 / 3, 2 / 3])
        assert motion.times.tolist() == [0.0, 333333333 / 1e9, 666666667 / 1e9]
        assert motion.duration == 666666667 / 1e9
        assert np.array_equal(whole_nanoseconds(motion.times), motion.times)


class TestHash:
    def test_is_of_the_content(self):
        assert trajectory().content_hash() == trajectory().content_hash()
        assert len(trajectory().content_hash()) == 64

    @pytest.mark.parametrize("name", ["positions", "velocities", "accelerations"])
    def test_sees_the_last_bit(self, name):
        values = getattr(trajectory(), name).copy()
        values[1, 1] = math.nextafter(values[1, 1], 9.0)
        assert trajectory(**{name: values}).content_hash() != trajectory().content_hash()

    def test_sees_names_and_times(self):
        assert trajectory(joint_names=("joint_a1", "joint_a3")).content_hash() != trajectory().content_hash()
        assert trajectory(times=[0.0, 0.5, 2.000000001]).content_hash() != trajectory().content_hash()


class TestPlan:
    def test_refuses_another_trajectory_s_hash(self):
        with pytest.raises(TrajectoryError, match="plan p1 has hash 'abc', its content has"):
            plan(hash="abc")

    def test_takes_another_trajectory_only_with_its_hash(self):
        other = trajectory(times=[0.0, 0.6, 2.0])
        with pytest.raises(TrajectoryError, match="has hash '.*', its content has"):
            plan(trajectory=other)
        assert plan(trajectory=other, hash=other.content_hash()).trajectory is other
