"""The gate: when it opens, what it passes, what it holds, and that its output is always a stream that may be executed."""

from __future__ import annotations

import math
import re

import pytest
from gate_bench import CODEC, FIRST_STEP, SETTINGS, START, Bench, moved

from construction_twin.core.sentences import templates_of
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.monitor.states import SyncState
from construction_twin.mqtt.joint_string import JointStringCodec


class TestOpening:
    def test_sends_nothing_before_it_has_ever_been_open(self):
        bench = Bench()
        assert bench.run(0.05) == [None] * 12 and bench.state is SyncState.WAITING

    def test_opens_after_the_poses_have_agreed_long_enough(self):
        bench = Bench()
        outputs = bench.run(0.2)
        closed = outputs.index(START)
        assert closed * CYCLE == pytest.approx(SETTINGS.agree_time, abs=CYCLE)
        assert set(outputs[closed:]) == {START} and bench.gate.violations == 0

    def test_stays_closed_without_feedback(self):
        bench = Bench()
        bench.feedback = False
        assert set(bench.run(1.0)) == {None}

    def test_stays_closed_without_a_twin(self):
        bench = Bench(pose=None)
        assert {bench.cycle(START) for _ in range(100)} == {None}

    @pytest.mark.parametrize("fraction, opens", [(1.0, True), (-1.0, True), (1.001, False), (-1.001, False)])
    def test_opens_at_its_share_of_the_threshold_and_not_above(self, fraction, opens):
        bench = Bench(pose=(0.0, 0.0))
        bench.offset = fraction * SETTINGS.agree_share * SETTINGS.threshold
        bench.run(0.5)
        assert (bench.state is SyncState.IN_SYNC) is opens

    def test_a_disagreement_starts_the_agreement_anew(self):
        bench = Bench()
        bench.run(0.08)
        bench.offset = 0.02
        bench.cycle()
        bench.offset = 0.0
        assert set(bench.run(0.096)) == {None}
        bench.run(0.02)
        assert bench.state is SyncState.IN_SYNC

    def test_a_single_pose_that_agrees_is_not_enough(self):
        bench = Bench()
        bench.cycle()
        bench.feedback = False
        assert set(bench.run(1.0)) == {None}

    def test_a_gap_in_the_feedback_starts_the_agreement_anew(self):
        bench = Bench()
        bench.run(0.02)
        bench.feedback = False
        bench.run(1.0)
        bench.feedback = True
        assert set(bench.run(0.096)) == {None}
        bench.run(0.02)
        assert bench.state is SyncState.IN_SYNC

    def test_agreement_ends_when_the_feedback_grows_old(self):
        bench = Bench()
        bench.run(0.12)
        last = bench.stamp
        timeout = round(SETTINGS.feedback_timeout * NANOSECONDS)
        assert bench.gate.is_agreed(last + timeout) and not bench.gate.is_agreed(last + timeout + 1)

    @pytest.mark.parametrize("distance", [FIRST_STEP * 3, -FIRST_STEP * 3, 0.1, 5.0, math.inf, math.nan])
    def test_stays_closed_while_the_stream_does_not_continue_from_the_twin(self, distance):
        bench = Bench(codec=JointStringCodec(2, 6))
        for _ in range(100):
            assert bench.cycle(moved(START, distance)) is None
        assert bench.state is SyncState.WAITING and bench.gate.reason.startswith("started; not opened: ")
        bench.cycle()
        assert bench.state is SyncState.IN_SYNC

    def test_a_first_step_within_one_cycle_s_budget_passes(self):
        bench = Bench()
        while not bench.gate.is_agreed(bench.stamp):
            bench.cycle(moved(START, 0.5))
        assert bench.cycle(moved(START, FIRST_STEP)) == CODEC.quantise(moved(START, FIRST_STEP))

    def test_without_an_arm_only_the_motion_is_checked(self):
        bench = Bench(compares=False)
        bench.feedback = False
        assert bench.cycle() == START and bench.state is SyncState.IN_SYNC
        bench.gate.watch(bench.stamp + NANOSECONDS)
        assert bench.cycle(moved(START, 0.5)) == START and bench.state is SyncState.FAULT


class TestPassing:
    def test_passes_setpoints_rounded_to_the_wire(self):
        bench = Bench().opened()
        assert bench.cycle(moved(START, 1.3e-5)) == CODEC.quantise(moved(START, 1.3e-5)) != moved(START, 1.3e-5)

    def test_a_motion_inside_the_limits_passes_unchanged(self):
        bench = Bench().opened().advance(speed=1.5, cycles=150)
        assert bench.state is SyncState.IN_SYNC and bench.gate.refused == bench.gate.violations == 0

    def test_servo_lag_within_the_allowance_passes(self):
        bench = Bench().opened().advance(speed=1.0, cycles=200, lag=0.05)
        assert bench.offset == pytest.approx(-0.05) and bench.gate.violations == 0

    @pytest.mark.parametrize("back", [0, 1, 1000 * CYCLE_NS])
    def test_a_setpoint_that_is_not_newer_is_dropped_and_counted(self, back):
        bench = Bench().opened()
        assert bench.gate.pass_next(bench.stamp - back, START, bench.stamp) is None
        assert bench.gate.refused == 1 and bench.state is SyncState.IN_SYNC
        assert bench.cycle() == START


class TestHolding:
    def test_a_joint_outside_its_threshold_holds_the_last_command_passed(self):
        bench = Bench().opened().advance(speed=1.0, cycles=50)
        held, bench.offset = bench.twin, -0.2
        outputs = [bench.cycle(moved(held, 0.004 * k)) for k in range(1, 100)]
        assert set(outputs) == {held}
        assert bench.state is SyncState.HOLDING and bench.gate.violations == 1
        said = bench.gate.reason
        assert said.startswith("A1 differs by ")
        assert (said.values["difference"].value, said.values["difference"].unit) == (pytest.approx(0.2), "rad")

    def test_a_difference_that_rounds_to_its_threshold_reads_as_more(self):
        bench = Bench().opened()
        bench.offset = -(0.01 + 1e-9)
        bench.cycle()
        found = re.fullmatch(r"A1 differs by (\S+) deg, (\S+) deg allowed", bench.gate.reason)
        assert (found[1], found[2]) == ("0.574", "0.573")

    def test_old_feedback_holds(self):
        bench = Bench().opened()
        bench.feedback = False
        outputs = [bench.cycle(moved(START, 1e-5 * k)) for k in range(50)]
        assert bench.state is SyncState.STALE and bench.gate.violations == 1
        assert outputs[-1] == outputs[30] != START

    def test_closes_without_a_setpoint_when_feedback_grows_old(self):
        bench = Bench().opened()
        timeout = round(SETTINGS.feedback_timeout * NANOSECONDS)
        bench.gate.watch(bench.stamp + timeout)
        assert bench.state is SyncState.IN_SYNC
        bench.gate.watch(bench.stamp + timeout + 1)
        assert (bench.state, bench.gate.violations, bench.gate.held) == (SyncState.STALE, 1, START)
        assert bench.gate.reason.startswith("last comparable feedback is ") and templates_of(bench.gate.reason)

    def test_closes_without_a_setpoint_when_a_joint_differs_and_counts_once(self):
        bench = Bench().opened()
        bench.gate.on_physical(moved(START, 0.2), 0, bench.stamp)
        for _ in range(3):
            bench.gate.watch(bench.stamp)
        bench.offset = 0.2
        assert bench.cycle(moved(START, 1e-5)) == bench.gate.held == START
        assert (bench.state, bench.gate.violations) == (SyncState.HOLDING, 1)

    def test_watching_never_opens(self):
        bench = Bench()
        while not bench.gate.is_agreed(bench.stamp):
            bench.cycle(moved(START, 0.5))
        bench.gate.watch(bench.stamp)
        assert (bench.state, bench.gate.violations, bench.gate.held) == (SyncState.WAITING, 0, ())

    def test_feedback_that_cannot_be_compared_is_no_feedback(self):
        bench = Bench().opened()
        bench.feedback = False
        for _ in range(50):
            bench.gate.on_physical(START, 1, bench.stamp)
            bench.cycle()
        assert bench.state is SyncState.STALE

    def test_opens_again_when_the_poses_agree_and_the_stream_continues_from_the_held_pose(self):
        bench = Bench().opened().advance(speed=1.0, cycles=50)
        held, bench.offset = bench.twin, -0.2
        bench.run(0.5)
        bench.offset = 0.0
        assert set(bench.run(0.2)) == {held}
        assert bench.state is SyncState.IN_SYNC
        assert bench.cycle(moved(held, FIRST_STEP)) != held

    def test_stays_closed_for_a_stream_that_went_on_elsewhere(self):
        bench = Bench().opened().advance(speed=1.0, cycles=50)
        held, bench.offset = bench.twin, -0.2
        bench.cycle()
        bench.offset = 0.0
        for _ in range(100):
            assert bench.cycle(moved(held, 0.05)) == held
        assert bench.state is SyncState.HOLDING and "; not opened: " in bench.gate.reason


@pytest.mark.parametrize(
    "theta_next",
    [
        moved(START, 0.05),  # acceleration
        moved(START, 3.0),  # range
        (START[0], 1.1),
        (math.nan, START[1]),
        (math.inf, START[1]),
        (1e308, START[1]),
        START[:1],
        START + (0.0,),
    ],
)
class TestRefusing:
    def test_a_setpoint_that_breaks_the_limits_holds_and_is_counted(self, theta_next):
        bench = Bench().opened()
        assert bench.cycle(theta_next) == START
        assert bench.state is SyncState.FAULT
        assert (bench.gate.refused, bench.gate.violations) == (1, 1)

    def test_after_it_the_poses_must_agree_anew(self, theta_next):
        bench = Bench().opened()
        bench.cycle(theta_next)
        bench.run(0.08)
        assert bench.state is SyncState.FAULT
        bench.run(0.1)
        assert bench.state is SyncState.IN_SYNC


class TestRestart:
    def test_forgets_every_pose(self):
        bench = Bench().opened()
        bench.gate.restart("new command session", bench.stamp)
        assert bench.state is SyncState.WAITING and bench.gate.reason == "new command session"
        assert not bench.gate.is_agreed(bench.stamp)
        assert bench.gate.pass_next(bench.stamp + CYCLE_NS, START, bench.stamp + CYCLE_NS) is None

    def test_begins_at_the_twin_s_new_pose(self):
        bench = Bench().opened()
        bench.gate.restart("new command session", bench.stamp)
        elsewhere = CODEC.quantise((-1.0, 0.5))
        bench.twin = elsewhere
        assert set(bench.run(0.2)) == {None, elsewhere}

    def test_a_clock_set_back_does_no_harm_after_it(self):
        bench = Bench().opened()
        bench.gate.restart("new command session", bench.stamp)
        bench.stamp = 5 * CYCLE_NS
        bench.run(0.2)
        assert bench.state is SyncState.IN_SYNC
