"""What the gate does about a violation: at once, without chatter, by its policy, and not for ever."""

from __future__ import annotations

import math

import pytest
from gate_bench import CODEC, LIMITS, SETTINGS, START, Bench, moved, states

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.monitor.gate import REST, Gate
from construction_twin.monitor.settings import GateSettings
from construction_twin.monitor.states import SyncEvent, SyncState


def bench(**settings) -> Bench:
    """Return an open bench with these settings."""
    opened = Bench(GateSettings(**settings)).opened()
    opened.gate.pop_transitions()
    return opened


def held_often(gate: Gate) -> tuple[int, float]:
    """Return how often a gate has held, and in which time [s], as its reason for giving up says."""
    assert " times in " in gate.reason
    return gate.reason.values["count"], gate.reason.values["time"]


class TestThresholds:
    def test_one_value_holds_for_all_joints_and_others_are_given_by_name(self):
        settings = GateSettings(threshold=0.02, thresholds={"joint_a2": 0.005}).comparison_settings(LIMITS)
        assert settings.threshold == (0.02, 0.005)

    def test_linear_joints_have_a_value_of_their_own(self):
        limits = MotionLimits(("joint_a1", "track"), (-2.0, 0.0), (2.0, 3.0), (2.0, 1.0), (3.0, 1.0), (False, True))
        assert GateSettings(threshold=0.02, threshold_linear=0.003).comparison_settings(limits).threshold == (
            0.02,
            0.003,
        )

    def test_a_name_that_is_no_joint_is_refused(self):
        with pytest.raises(ConfigurationError, match="joint_a9"):
            Gate(LIMITS, CODEC, GateSettings(thresholds={"joint_a9": 0.1}))

    def test_can_be_changed_at_rest_and_the_change_is_a_transition(self):
        gate = bench().gate
        gate.pop_transitions()
        reason = gate.reason
        gate.configure(GateSettings(threshold=0.3), "Ada changed threshold 0.01 -> 0.3", gate.held_stamp)
        (change,) = gate.pop_transitions()
        assert (change.source, change.event, change.target) == (
            SyncState.IN_SYNC,
            SyncEvent.CONFIGURED,
            SyncState.IN_SYNC,
        )
        assert change.reason == "Ada changed threshold 0.01 -> 0.3" and gate.reason == reason
        gate.on_physical(moved(START, 0.2), 0, gate.held_stamp)
        assert gate.state is SyncState.IN_SYNC
        gate.configure(GateSettings(thresholds={"joint_a1": 0.1}), "Ada", gate.held_stamp)
        gate.on_physical(moved(START, 0.2), 0, gate.held_stamp)
        assert gate.state is SyncState.HOLDING

    def test_a_change_that_makes_no_sense_changes_nothing(self):
        gate = bench().gate
        before = gate.settings
        with pytest.raises(ConfigurationError):
            gate.configure(GateSettings(threshold=0.3, thresholds={"": 0.1}), "Ada", gate.held_stamp)
        assert gate.settings is before
        gate.on_physical(moved(START, 0.2), 0, gate.held_stamp)
        assert gate.state is SyncState.HOLDING

    @pytest.mark.parametrize("stopped", [False, True])
    def test_do_not_change_while_the_arm_leads(self, stopped):
        gate = bench().gate
        before = gate.settings
        if stopped:
            gate.fire(SyncEvent.STOPPED_BEFORE, "by an earlier monitor", gate.held_stamp)
        gate.set_mirrored(True, gate.held_stamp)
        with pytest.raises(ConfigurationError, match="the gate.*an arm that does not: it can move at any moment"):
            gate.configure(GateSettings(threshold=0.3), "Ada", gate.held_stamp)
        assert gate.settings is before


class TestClosing:
    def test_the_first_sample_above_the_threshold_closes_before_any_setpoint(self):
        cell = bench()
        cell.gate.on_physical(
            moved(START, math.nextafter(SETTINGS.threshold + START[0], 9.0) - START[0]), 0, cell.stamp
        )
        assert cell.state is SyncState.IN_SYNC or cell.gate.comparison.last.error[0] > SETTINGS.threshold
        cell.gate.on_physical(moved(START, 1.01 * SETTINGS.threshold), 0, cell.stamp)
        assert (cell.state, cell.gate.violations) == (SyncState.HOLDING, 1)

    def test_one_that_is_gone_with_the_next_sample_closes_too(self):
        cell = bench()
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        cell.gate.on_physical(START, 0, cell.stamp)
        assert cell.cycle(moved(START, 1e-4)) == START and cell.state is SyncState.HOLDING

    def test_the_transition_tells_when_why_and_with_which_values(self):
        cell = bench()
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        (change,) = cell.gate.pop_transitions()
        assert (change.at, change.source, change.event) == (cell.stamp, SyncState.IN_SYNC, SyncEvent.POSE_DIFFERS)
        said = change.reason
        assert said.startswith("A1 differs by ")
        assert (said.values["difference"].value, said.values["threshold"].value) == pytest.approx((0.2, 0.01))
        assert change.comparison.error == pytest.approx((0.2, 0.0))
        assert change.held_stamp == cell.gate.held_stamp == cell.stamp

    def test_stale_feedback_that_comes_back_different_is_a_difference(self):
        cell = bench()
        cell.feedback = False
        cell.run(0.2)
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        assert states(cell.gate) == [("feedback_stale", "STALE"), ("pose_differs", "HOLDING")]
        assert cell.gate.violations == 1

    def test_the_held_stamp_is_that_of_the_last_setpoint_that_passed(self):
        cell = bench().advance(speed=1.0, cycles=20)
        passed = cell.stamp
        cell.offset = 0.2
        cell.run(0.3)
        assert cell.gate.held_stamp == passed
        cell.gate.restart("new command session", cell.stamp)
        assert cell.gate.held_stamp == 0


class TestHysteresis:
    def held(self, offset: float) -> Bench:
        cell = bench()
        cell.offset = 1.1 * SETTINGS.threshold
        cell.cycle()
        cell.offset = offset * SETTINGS.threshold
        cell.run(1.0)
        return cell

    def test_between_the_two_thresholds_a_closed_gate_stays_closed(self):
        assert self.held(0.9).state is SyncState.HOLDING
        assert self.held(0.79).state is SyncState.IN_SYNC

    def test_and_an_open_one_stays_open(self):
        cell = bench()
        cell.offset = 0.99 * SETTINGS.threshold
        cell.run(1.0)
        assert cell.state is SyncState.IN_SYNC and cell.gate.is_agreed(cell.stamp)

    def test_an_error_that_swings_about_the_threshold_does_not_chatter(self):
        cell = bench()
        for k in range(1000):
            cell.offset = (1.0 + 0.05 * (-1) ** k) * SETTINGS.threshold
            cell.cycle()
        assert states(cell.gate) == [("pose_differs", "HOLDING")]

    def test_one_sample_above_the_share_starts_the_time_anew(self):
        cell = self.held(0.9)
        cell.offset = 0.0
        cell.run(0.08)
        cell.offset = 0.9 * SETTINGS.threshold
        cell.cycle()
        cell.offset = 0.0
        cell.run(0.08)
        assert cell.state is SyncState.HOLDING
        cell.run(0.04)
        assert cell.state is SyncState.IN_SYNC


class TestPolicy:
    def test_stop_leads_to_stopped_at_once(self):
        cell = bench(policy="stop")
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        assert states(cell.gate) == [("pose_differs", "HOLDING"), ("policy_stop", "STOPPED")]
        assert cell.gate.reason.startswith("the policy is to stop; A1 differs by ")

    @pytest.mark.parametrize("policy", ["replan", "resume"])
    def test_the_others_open_again(self, policy):
        cell = bench(policy=policy)
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        cell.run(0.2)
        assert states(cell.gate) == [("pose_differs", "HOLDING"), ("opened", "IN_SYNC")]

    def test_a_closed_gate_keeps_the_settings_that_it_closed_with(self):
        cell = bench(policy="resume")
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        stricter = cell.gate.settings.model_copy(update={"policy": "stop"})
        with pytest.raises(ConfigurationError, match="HOLDING"):
            cell.gate.configure(stricter, "Ada", cell.stamp)
        assert cell.gate.policy == "resume"
        cell.run(0.2)
        cell.gate.configure(stricter, "Ada", cell.stamp)
        assert (cell.state, cell.gate.policy) == (SyncState.IN_SYNC, "stop")

    def test_in_motion_no_setting_changes_until_the_arm_has_arrived(self):
        cell = bench()
        gate, stamp = cell.gate, cell.stamp + CYCLE_NS
        gate.on_physical(START, 0, stamp)
        command = gate.pass_next(stamp, moved(START, 1e-5), stamp)
        assert command != START and gate.state is SyncState.IN_SYNC
        for now in (stamp, stamp + REST - 1):
            with pytest.raises(ConfigurationError, match="the gate.*a command that has not changed for"):
                gate.configure(gate.settings.model_copy(update={"threshold": 0.3}), "Ada", now)
        gate.configure(gate.settings.model_copy(update={"threshold": 0.3}), "Ada", stamp + REST)
        assert gate.settings.threshold == 0.3

    def test_a_re_plan_is_a_state_of_its_own_until_the_poses_agree(self):
        cell = bench()
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        asked = [cell.gate.fire(SyncEvent.REPLAN_ASKED, words, cell.stamp) for words in ("asked", "again")]
        assert asked == [True, False]
        cell.run(0.2)
        expected = [("pose_differs", "HOLDING"), ("replan_asked", "REPLANNING"), ("opened", "IN_SYNC")]
        assert states(cell.gate) == expected
        assert not cell.gate.fire(SyncEvent.REPLAN_FAILED, "too late", cell.stamp)

    def test_a_re_plan_that_fails_leaves_it_holding(self):
        cell = bench()
        cell.gate.on_physical(moved(START, 0.2), 0, cell.stamp)
        cell.gate.fire(SyncEvent.REPLAN_ASKED, "asked", cell.stamp)
        assert cell.gate.fire(SyncEvent.REPLAN_FAILED, "no path found", cell.stamp)
        assert (cell.state, cell.gate.reason) == (SyncState.HOLDING, "no path found")

    def test_nobody_plans_around_a_fault(self):
        cell = bench()
        cell.cycle(moved(START, 1.0))
        assert cell.state is SyncState.FAULT and not cell.gate.fire(SyncEvent.REPLAN_ASKED, "asked", cell.stamp)


def close(cell: Bench, cause: str) -> None:
    """Close the gate and keep it closed."""
    if cause == "differs":
        cell.offset = 0.2
        cell.cycle()
    elif cause == "stale":
        cell.feedback = False
        cell.run(0.12)
    elif cause == "fault":
        cell.cycle(moved(START, 1.0))
        cell.offset = 0.2
    else:
        cell.offset = 0.2
        cell.cycle()
        cell.gate.fire(SyncEvent.REPLAN_ASKED, "asked", cell.stamp)


class TestCause:
    """Why the gate is closed stays known until that is mended, whatever state follows."""

    def test_an_open_gate_has_none(self):
        gate = bench().gate
        assert gate.cause is None

    def test_it_is_carried_through_every_later_state_until_the_gate_opens(self):
        cell = bench(give_up_time=0.5)
        close(cell, "differs")
        gate, since = cell.gate, cell.stamp
        cause = gate.cause
        assert cause.sentence.startswith("A1 differs by ") and cause.since == since
        for happens, state in (
            (lambda: gate.fire(SyncEvent.REPLAN_ASKED, "asked", cell.stamp), SyncState.REPLANNING),
            (lambda: gate.fire(SyncEvent.REPLAN_FAILED, "no path found", cell.stamp), SyncState.HOLDING),
            (lambda: cell.run(0.6), SyncState.STOPPED),
        ):
            happens()
            assert (cell.state, gate.cause) == (state, cause)

    def test_after_a_reset_a_pose_that_still_differs_is_the_cause_and_goes_when_it_agrees(self):
        cell = bench(give_up_time=0.5)
        close(cell, "differs")
        cell.run(0.6)
        cell.gate.restart("new command session", cell.stamp)
        assert cell.gate.cause is None, "nothing is compared yet"
        cell.cycle()
        since = cell.stamp
        cell.run(0.1)
        assert cell.state is SyncState.WAITING and cell.gate.cause.since == since
        assert cell.gate.cause.sentence.values["joint"] == "A1"
        cell.offset = 0.0
        cell.cycle()
        assert cell.gate.cause is None

    def test_silence_that_ends_in_a_difference_has_that_as_its_cause(self):
        cell = bench(policy="resume")
        close(cell, "stale")
        since = cell.gate.cause.since
        assert cell.gate.cause.sentence.startswith("last comparable feedback is ")
        cell.feedback, cell.offset = True, 0.2
        cell.cycle()
        assert " differs by " in cell.gate.cause.sentence and cell.gate.cause.since == since

    def test_while_the_arm_leads_there_is_none(self):
        cell = bench()
        close(cell, "differs")
        cell.gate.set_mirrored(True, cell.stamp)
        cell.cycle()
        assert cell.gate.cause is None


class TestGivingUp:
    @pytest.mark.parametrize("cause", ["differs", "stale", "fault", "replan"])
    def test_ends_in_stopped_which_only_a_new_session_leaves(self, cause):
        cell = bench(give_up_time=0.5)
        close(cell, cause)
        closed = next(c for c in cell.gate.pop_transitions() if c.source is SyncState.IN_SYNC).at
        held = set(cell.run(0.6))
        assert cell.state is SyncState.STOPPED and held == {START}
        (gave_up,) = (c for c in cell.gate.pop_transitions() if c.event is SyncEvent.GAVE_UP)
        assert 0.5 * NANOSECONDS < gave_up.at - closed <= 0.5 * NANOSECONDS + 2 * CYCLE_NS
        cell.offset, cell.feedback = 0.0, True
        assert set(cell.run(2.0)) == {START} and cell.state is SyncState.STOPPED
        cell.gate.restart("new command session", cell.stamp)
        assert cell.state is SyncState.WAITING
        cell.opened()

    def test_is_noticed_without_a_setpoint(self):
        cell = bench(give_up_time=0.5)
        close(cell, "differs")
        cell.gate.watch(cell.stamp + NANOSECONDS)
        assert cell.state is SyncState.STOPPED

    def test_waiting_is_no_hold(self):
        cell = Bench(GateSettings(give_up_time=0.1))
        cell.offset = 0.2
        cell.run(1.0)
        assert cell.state is SyncState.WAITING


class TestEscalation:
    def violate(self, cell: Bench, apart: float) -> None:
        cell.offset = 0.2
        cell.cycle()
        cell.offset = 0.0
        cell.run(apart)

    def test_too_many_violations_within_the_time_end_in_stopped(self):
        cell = bench(escalate_count=3, escalate_time=2.0)
        self.violate(cell, 0.3)
        self.violate(cell, 0.3)
        assert cell.state is SyncState.IN_SYNC
        self.violate(cell, 1.0)
        assert cell.state is SyncState.STOPPED and held_often(cell.gate) == (3, 2.0)

    def test_spread_over_a_longer_time_they_do_not(self):
        cell = bench(escalate_count=3, escalate_time=2.0)
        for _ in range(6):
            self.violate(cell, 1.1)
        assert cell.state is SyncState.IN_SYNC and cell.gate.violations == 6

    def test_silence_is_not_counted_as_a_violation_of_the_pose(self):
        cell = bench(escalate_count=2, escalate_time=60.0)
        for _ in range(4):
            cell.feedback = False
            cell.run(0.2)
            assert cell.state is SyncState.STALE
            cell.feedback = True
            cell.opened()
        self.violate(cell, 0.3)
        assert cell.state is SyncState.IN_SYNC

    @pytest.mark.parametrize("replans", [False, True])
    def test_silence_that_ends_in_a_difference_is_counted_once(self, replans):
        cell = bench(escalate_count=3, escalate_time=60.0)
        for left in (2, 1, 0):
            assert cell.state is SyncState.IN_SYNC
            cell.feedback = False
            cell.run(0.2)
            if replans:
                assert cell.gate.fire(SyncEvent.REPLAN_ASKED, "asked", cell.stamp)
            cell.feedback, cell.offset = True, 0.2
            cell.run(0.1)
            assert (cell.state is SyncState.STOPPED) is (left == 0)
            cell.offset = 0.0
            cell.run(0.3)
        assert cell.state is SyncState.STOPPED and held_often(cell.gate) == (3, 60.0)

    def test_a_new_session_begins_counting_anew(self):
        cell = bench(escalate_count=2)
        self.violate(cell, 0.3)
        cell.gate.restart("new command session", cell.stamp)
        cell.opened()
        self.violate(cell, 0.3)
        assert cell.state is SyncState.IN_SYNC


class TestStoppedBefore:
    def test_begins_stopped_and_only_a_new_session_leads_out(self):
        cell = Bench()
        cell.gate.pop_transitions()
        cell.gate.fire(SyncEvent.STOPPED_BEFORE, "it was STOPPED before", cell.stamp)
        assert states(cell.gate) == [("stopped_before", "STOPPED")]
        assert set(cell.run(1.0)) == {None} and cell.state is SyncState.STOPPED
        cell.gate.restart("new command session", cell.stamp)
        cell.opened()


class TestMirror:
    def test_nothing_opens_the_gate_while_the_arm_leads(self):
        cell = bench()
        cell.gate.set_mirrored(True, cell.stamp)
        assert cell.state is SyncState.WAITING
        assert set(cell.run(1.0)) == {None}
        assert cell.state is SyncState.WAITING and cell.gate.held == ()
        cell.gate.set_mirrored(False, cell.stamp)
        cell.gate.restart("new command session", cell.stamp)
        cell.opened()

    def test_is_one_change_however_often_it_is_said(self):
        cell = bench()
        for _ in range(3):
            cell.gate.set_mirrored(True, cell.stamp)
        assert states(cell.gate) == [("mirror", "WAITING")]

    def test_does_not_lead_out_of_stopped(self):
        cell = bench(policy="stop")
        close(cell, "differs")
        cell.gate.set_mirrored(True, cell.stamp)
        assert cell.cycle() is None
        cell.gate.set_mirrored(False, cell.stamp)
        assert cell.cycle() == START and cell.state is SyncState.STOPPED


def test_a_setpoint_every_cycle_costs_no_transition():
    cell = bench()
    cell.run(250 * CYCLE)
    assert not cell.gate.transitions
