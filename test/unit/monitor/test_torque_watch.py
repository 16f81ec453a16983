"""Torques against what the motion should take: N in a row hold the gate, which opens when they agree again; off by default."""

from __future__ import annotations

import math

import pytest
from gate_bench import CODEC, LIMITS, START, Bench, states
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import understood
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.mock.servo import RealisticServo
from construction_twin.monitor.gate import Gate, GateSettings, WatchedArm
from construction_twin.monitor.states import SyncState
from construction_twin.monitor.torque_watch import HISTORY, LONGEST_GAP, TorqueSettings, TorqueWatch, thresholds

FIRST = 1000 * CYCLE_NS
INERTIA = 10.0


def dynamics(q, speed, acceleration):
    """Two flywheels, the second with weight."""
    return (INERTIA * acceleration[0], 100.0 + INERTIA * acceleration[1])


def watch(samples=3, threshold=(20.0, 20.0)) -> TorqueWatch:
    return TorqueWatch(TorqueSettings(threshold, samples), dynamics)


def resting(cycles=10, **settings) -> tuple[TorqueWatch, int]:
    """Return a watch of an arm that stands, and the stamp of its last command."""
    found = watch(**settings)
    for k in range(cycles):
        found.on_command(FIRST + k * CYCLE_NS, (0.0, 0.0))
    return found, FIRST + (cycles - 1) * CYCLE_NS


def test_a_difference_counts_from_the_last_of_n_in_a_row():
    found, stamp = resting()
    for _ in range(2):
        assert found.on_torques((0.0, 121.0), stamp) is None
    assert found.on_torques((0.0, 119.0), stamp) is None
    for _ in range(2):
        assert found.on_torques((0.0, 121.0), stamp) is None
    difference = found.on_torques((0.0, 121.0), stamp)
    assert (difference.joint, difference.measured, difference.expected, difference.threshold) == (1, 121.0, 100.0, 20.0)
    assert found.on_torques((0.0, 119.0), stamp) is None and found.difference is None


def test_the_axis_furthest_over_its_threshold_is_named():
    found, stamp = resting(samples=1, threshold=(2.0, 20.0))
    assert found.on_torques((5.0, 139.0), stamp).joint == 0
    assert found.on_torques((5.0, 200.0), stamp).joint == 1


def test_what_cannot_be_compared_changes_nothing():
    found, stamp = resting(samples=1)
    assert found.on_torques((math.nan, math.nan), stamp) is None
    assert found.on_torques((0.0, 500.0), 0) is None
    assert found.on_torques((0.0, 500.0), stamp + 1) is None
    assert found.on_torques((0.0, 500.0), FIRST - 2 * CYCLE_NS) is None
    assert found.compared == 1
    before = found.on_torques((0.0, 500.0), stamp)
    assert before is not None
    # nor does it end a difference
    assert found.on_torques((0.0, 100.0), 0) is before


@pytest.mark.parametrize("scale", [1.0, -3.0])
def test_the_expected_motion_is_that_of_the_realistic_servo(scale):
    found, servo = watch(), RealisticServo(resolution=0.0)
    servo.reset((0.0, 0.0))
    before, speed = (0.0, 0.0), (0.0, 0.0)
    for k in range(200):
        command = (0.1 * scale * math.sin(k * CYCLE * 3.0), 0.0)
        stamp = FIRST + k * CYCLE_NS
        found.on_command(stamp, command)
        q = servo.step(command)
        motion = found.motions[-1]
        assert motion.speed == pytest.approx([(b - a) / CYCLE for a, b in zip(before, q)], abs=1e-9)
        before = q
        assert found.expected(stamp)[0] == pytest.approx(INERTIA * motion.acceleration[0])
    assert speed == (0.0, 0.0)


def test_between_two_commands_the_torques_are_between_theirs():
    found = watch()
    for k in range(5):
        found.on_command(FIRST + k * CYCLE_NS, (0.01 * k * k, 0.0))
    first, second = (found.expected(FIRST + k * CYCLE_NS)[0] for k in (3, 4))
    assert found.expected(FIRST + 3 * CYCLE_NS + CYCLE_NS // 4)[0] == pytest.approx(0.75 * first + 0.25 * second)


@given(st.lists(st.tuples(st.integers(-2 * CYCLE_NS, 2 * LONGEST_GAP), st.floats(-3.0, 3.0)), min_size=1, max_size=40))
def test_whatever_comes_a_motion_is_kept_for_at_most_two_seconds_and_in_order(commands):
    found, stamp = watch(), FIRST
    for step, angle in commands:
        stamp += step
        found.on_command(stamp, (angle, -angle))
        kept = [motion.stamp for motion in found.motions]
        assert len(kept) <= HISTORY and kept == sorted(set(kept))
        assert all(math.isfinite(value) for value in found.expected(kept[-1]))


def test_after_a_long_gap_the_motion_begins_at_rest():
    found, stamp = resting()
    later = stamp + LONGEST_GAP + 1
    found.on_command(later, (1.0, 1.0))
    assert found.expected(stamp) is None and found.expected(later) == pytest.approx((0.0, 100.0))


def test_thresholds_are_fractions_or_numbers_and_an_unknown_limit_is_not_watched():
    names = "a", "b", "c"
    assert thresholds(0.1, {"b": 7.0}, names, (50.0, 50.0, None)) == (5.0, 7.0, math.inf)


# -- in the gate


class Watched(Bench):
    """A gate in its loop that watches torques; the arm gives `extra` more than expected on the second axis."""

    def __init__(self, **settings):
        super().__init__()
        self.gate = Gate(
            LIMITS, CODEC, GateSettings(**{"torque_samples": 3} | settings), 0, WatchedArm(dynamics, (1000.0, 200.0))
        )
        self.extra = 0.0

    def cycle(self, *arguments, **keywords):
        command = super().cycle(*arguments, **keywords)
        if command is not None:
            expected = self.gate.watch_of_torques.expected(self.stamp)
            self.gate.on_torques((expected[0], expected[1] + self.extra), self.stamp, self.stamp)
        return command


def test_a_collision_holds_the_gate_says_so_and_lets_go_when_it_is_over():
    bench = Watched().opened()
    states(bench.gate)
    bench.extra = 25.0
    for _ in range(3):
        bench.cycle()
    assert states(bench.gate) == [("torque_differs", "HOLDING")]
    said = understood(bench.gate.cause.sentence)
    assert (said.key, said.values["axis"]) == ("reason.gate.torque", "A2")
    assert str(bench.gate.reason).startswith("collision or lost load on axis A2: measured 125 Nm, expected 100 Nm")
    # the poses agree all the time: only the torques keep it closed
    bench.run(1.0)
    assert bench.state is SyncState.HOLDING and not bench.gate.agreed(bench.stamp)
    bench.extra = 0.0
    bench.run(0.2)
    assert states(bench.gate) == [("opened", "IN_SYNC")] and bench.gate.cause is None


def test_two_of_three_do_not_hold_it():
    bench = Watched().opened()
    for k in range(60):
        bench.extra = 0.0 if k % 3 == 0 else 25.0
        bench.cycle()
    assert bench.state is SyncState.IN_SYNC


def test_a_held_gate_repeats_its_command_and_the_policy_follows():
    bench = Watched(policy="stop").opened()
    states(bench.gate)
    bench.extra = -25.0
    commands = bench.run(0.1)
    assert states(bench.gate) == [("torque_differs", "HOLDING"), ("policy_stop", "STOPPED")]
    assert set(commands) == {START}


def test_a_new_session_forgets_the_difference():
    bench = Watched().opened()
    bench.extra = 25.0
    bench.run(0.1)
    bench.gate.restart("a person has looked", bench.stamp)
    assert bench.gate.watch_of_torques.difference is None


def test_by_default_torques_are_not_watched():
    bench = Bench().opened()
    assert bench.gate.watch_of_torques is None
    assert bench.gate.on_torques((1e6, 1e6), bench.stamp, bench.stamp) is None
    assert bench.state is SyncState.IN_SYNC


def test_its_settings_change_at_rest_and_a_joint_must_exist():
    bench = Watched().opened()
    bench.run(0.6)
    with pytest.raises(ConfigurationError, match="joint_a1, joint_a2"):
        bench.gate.configure(GateSettings(torque_thresholds={"joint_a9": 5.0}), "Ada", bench.stamp)
    bench.gate.configure(GateSettings(torque_thresholds={"joint_a2": 30.0}), "Ada", bench.stamp)
    bench.extra = 25.0
    bench.run(0.2)
    assert bench.state is SyncState.IN_SYNC
