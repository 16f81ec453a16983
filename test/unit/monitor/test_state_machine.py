"""Gate and executor under random sequences: never a changed command while not IN_SYNC, never motion without approval.

What goes out is checked with a motion check of the test's own: a stream that may be executed, rounded to the wire.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from executor_bench import GOAL, ROBOT, SCENE, Bench, make_plan, reach
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.limits import MotionCheck, MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.execution.executor import ExecutorState
from construction_twin.monitor.gate import Gate
from construction_twin.monitor.settings import REPLAN, RESUME, STOP, GateSettings
from construction_twin.monitor.states import HELD_STATES, ROWS, SyncEvent, SyncState
from construction_twin.mqtt.joint_string import JointStringCodec

LIMITS = MotionLimits.of(ROBOT)
#: Times short enough that a sequence of a few hundred cycles reaches them.
BRISK = {"agree_time": 0.02, "feedback_timeout": 0.03, "give_up_time": 0.4, "escalate_time": 0.6, "escalate_count": 2}
#: The largest difference that rounding to the wire can make between two setpoints of one pose [rad].
ROUNDING = math.radians(1.0e-3)
#: The executor may move the robots in these; a setpoint of HELD rests on the path.
MOVING = {ExecutorState.PLAYING, ExecutorState.STOPPING, ExecutorState.PAUSING}


class Cell(RuleBasedStateMachine):
    """Gate, executor and twin; the arm does as it is told, or not."""

    #: What the sequences have reached, over all of them.
    seen: Counter = Counter()

    @initialize(
        policy=st.sampled_from((REPLAN, RESUME, STOP)),
        compares=st.sampled_from((True, True, True, False)),
        decimals=st.sampled_from((3, 6)),
    )
    def build(self, policy, compares=True, decimals=3):
        self.codec, self.compares = JointStringCodec.of(ROBOT, decimals), compares
        self.gate = self.new_gate(GateSettings(policy=policy, **BRISK), 1000 * CYCLE_NS)
        bench = Bench()
        self.executor, self.approval = bench.executor, bench.approval
        self.stamp = bench.stamp
        self.twin, self.command = self.codec.quantise(ROBOT.home), None
        self.rest = None
        self.approved: set[str] = set()
        self.state = SyncState.WAITING
        self.new_session = True
        self.plans = 0

    def new_gate(self, settings, now):
        return Gate(LIMITS, self.codec, settings, now, compares=self.compares)

    # -- one cycle

    def cycle(self, feedback: str = "agrees", setpoint=None):
        self.stamp += CYCLE_NS
        stamp, gate, executor = self.stamp, self.gate, self.executor
        gate.on_twin(stamp - CYCLE_NS, self.twin)
        executor.on_twin(stamp - CYCLE_NS, self.twin, stamp)
        if feedback != "none":
            error = {"agrees": 0.0, "close": 0.0085, "differs": 0.2, "nan": math.nan}[feedback]
            gate.on_physical((self.twin[0] + error, *self.twin[1:]), 0, stamp)
        executor.on_sync(gate.state, gate.is_agreed(stamp), gate.policy, gate.held_stamp)
        before = executor.state
        theta_next = executor.step(stamp, stamp)
        given = theta_next if setpoint is None else setpoint
        if given is not None:
            self.take(gate.pass_next(stamp, given, stamp), before, setpoint is not None)
        gate.watch(stamp)
        self.check_transitions()

    def take(self, command, before: ExecutorState, foreign: bool):
        if command is None:
            # a monitor that begins in STOPPED has nothing to repeat
            assert self.gate.state is SyncState.WAITING or self.gate.mirrored or self.command is None
            return
        reference = self.twin if self.command is None else self.command
        if self.command is None:
            self.check = MotionCheck(LIMITS, self.codec.decimals)
            self.check.start(self.stamp - CYCLE_NS, reference)
        # whatever came in, what goes out can be executed
        self.check.accept(self.stamp, command)
        assert self.codec.quantise(command) == command
        if self.gate.state is not SyncState.IN_SYNC:
            assert command == reference
        distance = max(abs(a - b) for a, b in zip(command, reference))
        if distance > ROUNDING and not foreign:
            # a plan that was approved, once, in this session
            assert before in MOVING and self.executor.plan.id in self.approved
            self.seen["moved"] += 1
        # nor does it creep, however slowly, from where the last approved motion left it
        if before in MOVING or foreign or self.rest is None:
            self.rest = command
        assert max(abs(a - b) for a, b in zip(command, self.rest)) <= ROUNDING
        self.twin = self.command = command

    def check_transitions(self):
        for change in self.gate.pop_transitions():
            assert change.target in {row.target for row in ROWS[change.source, change.event]}
            assert change.source is self.state and change.reason and 0 < change.at <= self.stamp
            if change.source is SyncState.STOPPED is not change.target:
                assert change.event is SyncEvent.NEW_SESSION and self.new_session
            if change.event is SyncEvent.POSE_DIFFERS:
                assert self.compares and not change.comparison.agrees
            self.state = change.target
            self.seen[change.event] += 1
        self.new_session = False

    @invariant()
    def the_gate_is_where_its_transitions_lead(self):
        assert self.gate.state is self.state

    # -- what may happen

    @rule(feedback=st.sampled_from(["agrees"] * 4 + ["close", "differs", "none", "nan"]), cycles=st.integers(1, 30))
    def run(self, feedback, cycles):
        for _ in range(cycles):
            self.cycle(feedback)

    @rule()
    def run_long(self):
        for _ in range(120):
            self.cycle()

    @precondition(lambda self: self.state not in (SyncState.IN_SYNC, SyncState.WAITING))
    @rule()
    def stay_closed(self):
        for _ in range(120):
            self.cycle("differs")

    @rule(
        fraction=st.sampled_from([0.5, 3.0, math.inf, math.nan]),
        joint=st.integers(0, 5),
        cycles=st.integers(1, 3),
    )
    def foreign_setpoint(self, fraction, joint, cycles):
        step = fraction * ROBOT.acceleration[joint] * (CYCLE_NS / NANOSECONDS) ** 2
        for k in range(cycles):
            q = list(self.twin)
            q[joint] += step * (k + 1)
            self.cycle(setpoint=tuple(q))

    @rule(back=st.integers(0, 1000))
    def old_setpoint(self, back):
        refused, command = self.gate.refused, self.gate.held
        if self.gate.pass_next(self.stamp - back * CYCLE_NS, GOAL, self.stamp) is not None:
            # before the first setpoint of a session there is no newer one
            assert self.command is None
        assert self.gate.held == command or self.command is None
        assert self.gate.refused >= refused
        self.check_transitions()

    @rule(late=st.sampled_from([0.05, 0.2, 1.0]), cycles=st.integers(1, 40))
    def starve(self, late, cycles):
        """The monitor was not run for a while: setpoints have waited, feedback is fresh again."""
        for _ in range(cycles):
            self.stamp += CYCLE_NS
            now = self.stamp + round(late * NANOSECONDS)
            self.gate.on_physical(self.twin, 0, now)
            command = self.gate.pass_next(self.stamp, self.twin, now)
            if command is not None:
                self.take(command, self.executor.state, False)
        self.stamp += round(late * NANOSECONDS)
        self.check_transitions()
        self.cycle()

    @rule()
    def respawn(self):
        """The monitor begins anew; one that was STOPPED stays so."""
        stopped = self.state is SyncState.STOPPED
        self.gate = self.new_gate(self.gate.settings, self.stamp)
        self.state, self.command = SyncState.WAITING, None
        if stopped:
            self.gate.fire(SyncEvent.STOPPED_BEFORE, "it was STOPPED before", self.stamp)
        self.check_transitions()

    @rule()
    def reset(self):
        self.new_session, self.command = True, None
        self.gate.restart("new command session", self.stamp)
        self.executor.restart("new command session", self.stamp)
        self.approved.clear()
        self.check_transitions()
        for _ in range(12):
            self.cycle()

    @rule(policy=st.sampled_from((REPLAN, RESUME, STOP)), threshold=st.sampled_from([0.002, 0.01, 0.1]))
    def reconfigure(self, policy, threshold):
        before, reason = self.gate.settings, self.gate.reason
        rests = self.gate.is_at_rest(self.stamp)
        try:
            self.gate.configure(GateSettings(policy=policy, threshold=threshold, **BRISK), "by the test", self.stamp)
        except ConfigurationError:
            assert (not rests or self.state in HELD_STATES) and self.gate.settings is before
            self.seen["refused settings"] += 1
        else:
            assert rests and self.state not in HELD_STATES
            assert self.gate.reason == reason.split("; not opened: ")[0]
        self.check_transitions()

    @rule(cycles=st.integers(1, 20), reset=st.booleans())
    def mirror(self, cycles, reset):
        self.gate.set_mirrored(True, self.stamp)
        self.check_transitions()
        for _ in range(cycles):
            self.cycle()
            assert self.state in (SyncState.WAITING, SyncState.STOPPED)
        self.gate.set_mirrored(False, self.stamp)
        if reset:
            self.reset()

    @precondition(lambda self: self.state is SyncState.IN_SYNC and self.compares)
    @rule(feedback=st.sampled_from(["differs", "none"]), cycles=st.sampled_from((10, 20, 120)), replan=st.booleans())
    def violate(self, feedback, cycles, replan):
        self.cycle("differs")
        assert self.state in (SyncState.HOLDING, SyncState.STOPPED)
        if replan:
            self.replan(False)
        for _ in range(cycles):
            self.cycle(feedback)
        for _ in range(cycles):
            self.cycle()

    @precondition(lambda self: self.state is SyncState.IN_SYNC and self.compares)
    @rule(comes_back=st.sampled_from(["agrees", "differs"]), replan=st.booleans())
    def fall_silent(self, comes_back, replan):
        for _ in range(12):
            self.cycle("none")
        assert self.state in (SyncState.STALE, SyncState.STOPPED)
        if replan:
            self.replan(False)
        self.cycle(comes_back)

    @rule(failed=st.booleans())
    def replan(self, failed):
        self.gate.fire(SyncEvent.REPLAN_FAILED if failed else SyncEvent.REPLAN_ASKED, "asked by the test", self.stamp)
        self.check_transitions()

    @rule(approve=st.booleans(), away=st.booleans(), cycles=st.sampled_from([1, 20, 100, 200, 200]))
    def plan(self, approve, away, cycles):
        self.plans += 1
        goal = GOAL if away else ROBOT.home
        plan = make_plan(f"p{self.plans}", reach(self.twin, goal, 1.0), SCENE, self.stamp)
        try:
            self.executor.offer(plan)
            if approve:
                self.approval.review(plan.id, plan.hash, True, "Ada", "")
                self.approved.add(plan.id)
        except ConstructionTwinError:
            self.seen["refused approval"] += 1
        for _ in range(cycles):
            self.cycle()

    @rule(verb=st.sampled_from(["stop", "pause", "resume"]))
    def intervene(self, verb):
        try:
            self.executor.resume() if verb == "resume" else getattr(self.executor, verb)(self.stamp)
        except ConstructionTwinError:
            self.seen["refused request"] += 1


#: What the random sequences must have reached, for their result to mean something.
REACHED = set(SyncEvent) - {SyncEvent.REPLAN_FAILED, SyncEvent.SERVOS_REFINED} | {
    "moved",
    "refused approval",
    "refused settings",
}


def test_whatever_happens_a_closed_gate_changes_nothing_and_nothing_moves_without_approval():
    Cell.seen = Counter()
    run_state_machine_as_test(
        Cell,
        settings=settings(max_examples=100, stateful_step_count=40, deadline=None, derandomize=True, database=None),
    )
    assert set(Cell.seen) >= REACHED, REACHED - set(Cell.seen)


def test_the_cell_above_plays_an_approved_plan_to_its_end():
    cell = Cell()
    cell.build("replan")
    cell.run("agrees", 30)
    cell.plan(True, True, 300)
    assert np.abs(np.array(cell.twin) - GOAL).max() <= ROUNDING
    assert cell.executor.outcome == "finished"
