"""The arm beside the model of its servos: when that is judged, by what, and what is let pass."""

from __future__ import annotations

import math

import pytest
from gate_bench import CODEC, LIMITS, SETTINGS
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.monitor.gate import Gate
from construction_twin.monitor.servo_watch import ENOUGH, LONGEST_GAP, ServoWatch
from construction_twin.monitor.states import SyncEvent, SyncState
from construction_twin.servo.model import STEADY, JointServo, ServoModel, ServoState

MODEL = ServoModel(("joint_a1", "joint_a2"), (JointServo(60.0, 0.8), JointServo(40.0, 1.0, 1.3)), CYCLE_NS)
THRESHOLD = (0.01, 0.01)
BEHIND = 5
ENOUGH_CYCLES = STEADY // CYCLE_NS + 5


class Arm:
    """An arm that answers exactly as the model; what is played lies `BEHIND` cycles behind what is commanded."""

    def __init__(self, model=MODEL):
        self.watch = ServoWatch(MODEL, THRESHOLD)
        self.state = ServoState(model, (0.0, 0.0))
        self.number, self.seq, self.played = 1000, 0, 1000
        self.offset = (0.0, 0.0)
        self.in_sync = True
        self.q = (0.0, 0.0)
        for number in range(1000 - BEHIND, 1001):
            self.watch.on_command(number * CYCLE_NS, self.path(number))

    @staticmethod
    def path(number: float) -> tuple[float, float]:
        t = max(number - 1000, 0.0) * CYCLE
        return (0.6 * (1 - math.cos(2.0 * t)), 0.4 * (1 - math.cos(3.0 * t)))

    def cycle(self, advance: int | None = CYCLE_NS, told: bool = True):
        """One cycle of the controller; None: the reply did not arrive."""
        self.number += 1
        self.watch.on_command(self.number * CYCLE_NS, self.path(self.number))
        self.seq += 1
        self.played += (advance or 0) / CYCLE_NS
        self.q = self.state.advance(self.path(self.played - BEHIND))
        if not told:
            return None
        q = [a + b for a, b in zip(self.q, self.offset)]
        stamp = round((self.played - BEHIND) * CYCLE_NS)
        return self.watch.on_pose(q, self.seq, stamp, self.in_sync)

    def run(self, cycles: int, **how):
        return [self.cycle(**how) for _ in range(cycles)]


def judging() -> Arm:
    arm = Arm()
    arm.run(ENOUGH_CYCLES)
    assert arm.watch.judges
    return arm


def test_an_arm_as_modelled_leaves_no_residual_at_any_speed():
    arm = judging()
    assert arm.run(1000) == [None] * 1000
    assert max(arm.watch.largest) < 1e-9 and arm.watch.judged >= 1000


def test_it_is_not_judged_before_it_has_moved_as_commanded_for_long_enough():
    arm = Arm()
    arm.run(STEADY // CYCLE_NS - 1)
    assert not arm.watch.judges
    arm.offset = (0.02, 0.0)
    assert arm.run(200) == [None] * 200 and not arm.watch.judges


@pytest.mark.parametrize("joint", [0, 1])
def test_a_slip_is_found_at_any_speed_by_the_second_pose(joint):
    for cycles in (1, 50, 120, 300):
        arm = judging()
        arm.run(cycles)
        arm.offset = tuple(math.radians(0.75) if each == joint else 0.0 for each in range(2))
        assert arm.cycle() is None
        found = arm.cycle()
        assert found.joint == joint and found.residual == pytest.approx(math.radians(0.75), abs=1e-6)
        assert found.threshold == 0.01


def test_a_single_pose_that_differs_is_none_and_what_agrees_again_ends_it():
    arm = judging()
    arm.offset = (0.02, 0.0)
    arm.cycle()
    arm.offset = (0.0, 0.0)
    assert arm.run(50) == [None] * 50
    arm.offset = (0.02, 0.0)
    assert arm.run(3)[-1] is not None
    arm.offset = (0.0, 0.0)
    assert arm.cycle() is None and arm.watch.difference is None


def test_a_pose_that_is_no_number_differs():
    arm = judging()
    arm.offset = (math.nan, 0.0)
    assert arm.run(2)[-1] is not None


def test_a_reply_that_did_not_arrive_is_known_and_what_follows_is_not_judged_for_a_while():
    arm = judging()
    arm.run(100)
    assert arm.cycle(advance=None) is None
    residual = [a - b for a, b in zip(arm.q, arm.watch.expected)]
    assert max(map(abs, residual)) < 1e-9 and not arm.watch.judges
    arm.run(ENOUGH_CYCLES)
    assert arm.watch.judges and max(arm.watch.largest) < 1e-9


@pytest.mark.parametrize("advance", [CYCLE_NS // 2, 2 * CYCLE_NS, 0])
def test_a_motion_that_is_stretched_is_followed_but_not_judged(advance):
    arm = judging()
    arm.run(4, advance=advance)
    assert not arm.watch.judges
    assert [a - b for a, b in zip(arm.q, arm.watch.expected)] == pytest.approx([0.0, 0.0], abs=2e-4)


def test_a_playout_that_drifts_is_judged():
    arm = judging()
    assert arm.run(500, advance=CYCLE_NS + CYCLE_NS // 100) == [None] * 500
    assert arm.watch.judges


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, LONGEST_GAP - 1), min_size=1, max_size=6))
def test_states_that_are_missing_change_nothing(gaps):
    arm = judging()
    for gap in gaps:
        arm.run(gap, told=False)
        assert arm.run(5) == [None] * 5
    assert arm.watch.judges and max(arm.watch.largest) < 1e-9


def test_after_a_longer_gap_the_model_begins_anew():
    arm = judging()
    arm.run(LONGEST_GAP + 1, told=False)
    arm.cycle()
    assert not arm.watch.judges
    arm.run(3 * ENOUGH_CYCLES)
    assert arm.watch.judges


def test_nothing_is_known_without_stamp_or_number_or_of_commands_that_were_not_seen():
    for seq, stamp in ((0, 1000 * CYCLE_NS), (5, 0), (5, 10 * CYCLE_NS), (5, 9999 * CYCLE_NS)):
        arm = judging()
        assert arm.watch.on_pose((0.5, 0.5), seq, stamp, True) is None
        assert arm.watch.expected == () and not arm.watch.judges


def test_a_closed_gate_is_not_judged():
    arm = judging()
    arm.in_sync = False
    arm.cycle()
    arm.in_sync, arm.offset = True, (0.02, 0.0)
    assert arm.run(100) == [None] * 100


def test_a_lag_beyond_the_file_is_refined_at_rest_and_the_residual_falls():
    late = MODEL.slower((0.0004, 0.0))
    arm = Arm(late)
    arm.run(ENOUGH_CYCLES)
    arm.run(2 * ENOUGH)
    before = max(arm.watch.largest)
    assert before > 3e-4 and arm.watch.refinement.due
    changes = arm.watch.refine()
    assert changes == {"joint_a1": pytest.approx(0.0004, abs=2e-5)}
    arm.run(100)
    arm.watch.largest = (0.0, 0.0)
    arm.run(1000)
    assert arm.watch.largest[0] < before / 5


class GateLoop:
    """A gate with servos in its loop; twin and arm execute what passes, the arm as the model and `late` by a cycle of nothing."""

    def __init__(self, model=MODEL):
        self.gate = Gate(LIMITS, CODEC, SETTINGS, servos=MODEL)
        self.state = ServoState(model, (0.0, 0.0))
        self.stamp, self.seq, self.offset, self.twin = 1000 * CYCLE_NS, 0, 0.0, (0.0, 0.0)

    def cycle(self, target) -> None:
        before, self.stamp, self.seq = self.stamp, self.stamp + CYCLE_NS, self.seq + 1
        self.gate.on_twin(before, self.twin)
        q = self.state.advance(self.twin)
        self.gate.on_physical((q[0] + self.offset, q[1]), before, self.stamp, seq=self.seq)
        passed = self.gate.pass_next(self.stamp, target, self.stamp)
        if passed is not None:
            self.twin = passed

    def swing(self, cycles: int) -> None:
        begin = self.stamp
        for _ in range(cycles):
            t = (self.stamp - begin) / 1e9
            self.cycle((0.2 * (1 - math.cos(2.5 * t)), 0.0))


def opened() -> GateLoop:
    loop = GateLoop()
    for _ in range(120):
        loop.cycle((0.0, 0.0))
    assert loop.gate.state is SyncState.IN_SYNC
    return loop


def test_the_gate_closes_for_a_slip_that_its_speed_term_would_let_pass():
    loop = opened()
    loop.swing(160)
    assert loop.gate.state is SyncState.IN_SYNC
    loop.offset = -math.radians(0.75)
    loop.swing(0)
    begin = len(loop.gate.pop_transitions())
    assert begin >= 1
    t0 = loop.stamp
    for number in range(3):
        t = 160 * CYCLE + (loop.stamp - t0) / 1e9
        loop.cycle((0.2 * (1 - math.cos(2.5 * t)), 0.0))
    (closed,) = loop.gate.pop_transitions()
    assert (closed.event, closed.target) == (SyncEvent.POSE_DIFFERS, SyncState.HOLDING)
    assert closed.reason.startswith("A1 ") and "servo" in closed.reason
    assert closed.comparison.agrees
    assert not loop.gate.is_agreed(loop.stamp) and loop.gate.cause.sentence == closed.reason


def test_a_gate_without_a_model_has_no_watch():
    assert Gate(LIMITS, CODEC, SETTINGS).servo_watch is None


def test_a_refinement_is_a_transition_at_rest_that_changes_no_state():
    loop = GateLoop(MODEL.slower((0.0004, 0.0)))
    for _ in range(120):
        loop.cycle((0.0, 0.0))
    period = round(2 * math.pi / 2.5 / CYCLE)
    for _ in range(2 * ENOUGH // period + 2):
        loop.swing(period)
    assert loop.gate.state is SyncState.IN_SYNC
    loop.gate.pop_transitions()
    for _ in range(200):
        loop.cycle(loop.twin)
    (change,) = loop.gate.pop_transitions()
    assert (change.source, change.target, change.event) == (
        SyncState.IN_SYNC,
        SyncState.IN_SYNC,
        SyncEvent.SERVOS_REFINED,
    )
    assert "joint_a1 +0.4" in change.reason
