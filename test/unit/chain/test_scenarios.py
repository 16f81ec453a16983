"""Every shipped scenario on the simulated chain, with the judge of `test/integration/test_scenario.py`.

What the launch has beside the chain is not here: the planner (a straight joint motion), processes, services and topics.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import plan_samples
import pytest
import yaml
from chain_samples import ROBOT, SETTINGS
from rich.console import Console
from simulation import POLL, SimulatedChain

from construction_twin.core.errors import ReviewError
from construction_twin.core.freshness import Moment
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import NANOSECONDS, from_wire, to_wire
from construction_twin.evaluation.recording import PlayedPlan
from construction_twin.execution.approval import Approval
from construction_twin.extensions.physics.process import load_rehearsal
from construction_twin.extensions.physics.rehearsal import Rehearsal
from construction_twin.gateway.states import State
from construction_twin.gateway.trace import TraceEntry
from construction_twin.mock.faults import KINDS, Fault
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.monitor.settings import GateSettings
from construction_twin.mqtt.messages import Control
from construction_twin.planning.timing import time_path
from construction_twin.review.rehearsal_report import RehearsalCheck
from construction_twin.robot.plan import Plan
from construction_twin.ros.commands.driver import RestDetector
from construction_twin.ros.commands.scenario import print_verdict
from construction_twin.ros.nodes.executor import BACKGROUND_PERIOD
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.scenario.definition import STATES, Injection, Move, Scenario, ScenarioError, Step, make_scenario
from construction_twin.scenario.judge import Judgement, judge
from construction_twin.scenario.timeline import Change, GatewayStop, Run, SyncMoment
from construction_twin.scene.objects import Scene

ROOT = Path(__file__).resolve().parents[3]
DECIMALS, CYCLE_MS = 3, 4
DRIVES = str(ROOT / "config/kr120_drives.yaml")
#: Its hash only: nothing is in the way here.
SCENE = "s"
#: As in launch/bringup.launch with the mock; a scenario's own settings have the last word.
LAG_MARGIN = 0.06
#: Longest wait until a plan could be started, and for a `reset` [s].
READY, RESET = 5.0, 5.0
#: Of a re-plan: no faster than the plan before, which is the monitor's rule. The slowest of the scenarios uses this of the limits.
SPEED_SCALE, ACCELERATION_SCALE = 0.15, 0.4


def shipped(name: str) -> dict:
    """Return what the file of a shipped scenario holds."""
    return yaml.safe_load((ROOT / f"config/scenarios/{name}.yaml").read_text())


class ScenarioRun:
    """One scenario on a chain of its own.

    Args:
        content: What the scenario's file holds: the key ``scenario``, and parameters of nodes.
    """

    def __init__(self, name: str, content: dict):
        self.scenario: Scenario = make_scenario(name, content["scenario"])
        file = {"ethernet_xml": (ROOT / "krl/ethernet/ctwin_ethernet.xml").read_text()}
        config = gateway_config(ROBOT, SETTINGS | {"decimals": DECIMALS, "cycle": CYCLE_MS} | file)
        mock_file = yaml.safe_load((ROOT / "config/mock_rsi.yaml").read_text())
        mock_file |= file | {"drives": DRIVES} | content.get("mock_rsi", {})
        mock = MockSettings(gateway_host="simulated", gateway_port=1, **mock_file)
        monitor = yaml.safe_load((ROOT / "config/pca_monitor.yaml").read_text()) | {"lag_margin": LAG_MARGIN}
        monitor |= content.get("pca_monitor", {})
        gate = GateSettings(**{key: value for key, value in monitor.items() if key in GateSettings.model_fields})
        controller = build_controller(mock, ROBOT)
        self.chain = SimulatedChain(
            ROBOT,
            config,
            controller,
            gate,
            planner=self._replan,
            restart_after=mock.restart_after,
        )
        #: What rehearses each plan; None: nothing does.
        self._rehearsal: Rehearsal | None = None
        if content.get("executor", {}).get("rehearsal") == "require":
            files = str(ROOT / "config/kr120_self_collision.yaml"), DRIVES
            self._rehearsal = load_rehearsal(ROBOT, *files, payload=tuple(content["rehearsal"]["payload"]))
        #: What the gateway sent.
        self.trace: list[TraceEntry] = []
        self.chain.gateway.trace = self._on_reply
        self._auto = content.get("executor", {}).get("auto_approve", False)
        chain = self.chain
        self._approval = Approval(
            chain.executor, chain.verdicts.append, nullcontext(), lambda: Moment("c0ffee00", chain.now)
        )
        if self._rehearsal is not None:
            self._approval.rehearsal = RehearsalCheck(required=True)
        self._ids = map(str, itertools.count(1))
        self._seen: list[Change] = []
        self._actions: list[Change] = []
        self._began = self._since = self._moved = self._due = 0
        self._plans: dict[int, PlayedPlan] = {}
        self._stops: dict[GatewayStop, None] = {}
        self._stated: tuple[float, ...] = ()
        self._arm: list[tuple[int, tuple[float, ...]]] = []
        self._missed_at: list[int] = []
        self._missed = self._missed_before = 0
        self._faults: frozenset[str] = frozenset()
        self._rsi_session = 0
        self._rest = RestDetector(1e-6, 0.4)

    def carry_out(self) -> tuple[Run, list[TraceEntry]]:
        """Carry out every step and wait for the end; return what would have been recorded, and the gateway's trace."""
        chain = self.chain
        assert chain.run_until(lambda: chain.ready and bool(self.now("sync") == "IN_SYNC"), READY), chain.gate.reason
        chain.executor.on_scene(SCENE)
        self._begin_recording()
        failure = ""
        deadline = chain.now + round(self.scenario.limit * NANOSECONDS)
        try:
            for step in self.scenario.steps:
                self._carry_out(step, deadline)
            final = self.scenario.expect.final
            self._wait(
                lambda: all(self.now(t) == s for t, s in final.items()) and self._rest.at_rest, f"{final}", deadline
            )
        except (ScenarioError, ReviewError) as error:
            failure = str(error)
        chain.run_for(0.6)
        return self._run(failure), self.trace

    def judge(self, run: Run, trace: list[TraceEntry]) -> Judgement:
        """Judge what came of it."""
        return judge(self.scenario, run, trace, MotionLimits.of(ROBOT), DECIMALS, CYCLE_MS / 1000)

    def now(self, topic: str) -> str:
        """Return the present state on a topic, in the words of its message; of ``outcome`` the last plan's."""
        chain = self.chain
        return {
            "sync": chain.gate.state.name,
            "link": chain.supervisor.state.name,
            "execution": chain.executor.state.name,
            "outcome": chain.executor.outcome,
        }[topic]

    # -- steps

    def _carry_out(self, step: Step, deadline: int) -> None:
        begin = self._moment(step.when, deadline)
        due = begin + round(step.after * NANOSECONDS)
        self._wait(lambda: self.chain.now >= due, f"{step}", deadline)
        self._since = self.chain.now
        if step.move:
            self._move(step.move)
        elif step.approve:
            self._approve(step.approve == "refused")
        elif step.inject:
            self._inject(step.inject)
        elif step.call:
            self._record_action("call", step.call)
            self._call(step.call)

    def _moment(self, when: str, deadline: int) -> int:
        """Wait for what a step waits for; return its moment [ns]."""
        if when == "now":
            return self._since
        if when == "rest":
            self._wait(lambda: self._rest.at_rest, "the arm to stand", deadline)
            return self.chain.now
        executor = self.chain.executor
        if when == "motion":
            self._wait(lambda: executor.plan_start >= self._moved > 0, "the motion to start", deadline)
            return executor.plan_start
        topic, state = when.split(" ")
        self._wait(lambda: self.now(topic) == state or bool(self._entered(topic, state)), when, deadline)
        return self._entered(topic, state) or self._since

    def _entered(self, topic: str, state: str) -> int:
        """Return when a state was entered since the last step [ns]; 0 when it was not."""
        return next(
            (c.stamp for c in self._changes() if (c.topic, c.value) == (topic, state) and c.stamp >= self._since), 0
        )

    def _move(self, move: Move) -> None:
        self._record_action("move", str(move.goal_deg))
        self._moved = self.chain.now
        goal = from_wire(move.goal_deg, ROBOT.linear)
        timing = {"duration": move.duration} if move.duration else {"speed_scale": 0.5}
        self._offer(time_path(np.array([self.chain.twin.pose, goal]), ROBOT, **timing))

    def _offer(self, trajectory) -> None:
        plan = self._plan(trajectory)
        if self._rehearsal is not None:
            self._approval.rehearsal.on_report(self._rehearsal.of_plan(plan, {SCENE: Scene()}, lambda: 0.0))
        self.chain.executor.offer(plan)

    def _plan(self, trajectory) -> Plan:
        return plan_samples.make_plan(trajectory, f"plan-{self.chain.now}", SCENE, asked_ns=self.chain.now)

    def _replan(self, held: tuple[float, ...], goal: tuple[float, ...]) -> Plan:
        timing = {"speed_scale": SPEED_SCALE, "acceleration_scale": ACCELERATION_SCALE}
        return self._plan(time_path(np.array([held, goal]), ROBOT, **timing))

    def _approve(self, refused: bool) -> None:
        plan = self.chain.executor.under_review.plan
        if plan is None:
            raise ScenarioError("there is no plan to approve")
        try:
            self._approval.review(plan.id, plan.hash, True, "scenario", self.scenario.name)
        except ReviewError as error:
            if not refused:
                raise
            self._record_action("refused", plan.id, str(error))
            return
        if refused:
            raise ScenarioError(f"plan {plan.id} was approved; expected a refusal")
        self._record_action("approve", plan.id)

    def _inject(self, injection: Injection) -> None:
        """Switch a fault on or off between two cycles of the controller."""
        axis = ROBOT.axes[ROBOT.joint_names.index(injection.joint)] if injection.joint else None
        kind, values = KINDS[injection.fault], tuple(injection.values)
        if kind.shift and axis is not None:
            values = tuple(axis.sign * value for value in values)
        elif not kind.lasting and len(values) == len(ROBOT.axes):
            values = ROBOT.to_axes(values)
        fault = Fault(injection.fault, axis.name if axis else "", values, injection.direction, injection.duration)
        faults = self.chain.faults
        self._request(lambda: faults.end(fault) if injection.end else faults.inject(fault))
        if injection.fault in ("restart_at", "jog"):
            self._record_action("fault", injection.fault)

    def _request(self, action: Callable[[], object]) -> None:
        """Have the controller do something, and wait until it has."""
        self.chain.requests.append(action)
        assert self.chain.run_until(lambda: not self.chain.requests, 1.0)

    def _call(self, service: str) -> None:
        chain = self.chain
        if service == "stop":
            chain.executor.stop(chain.now)
        elif service == "halt":
            session = chain.supervisor.session
            chain.supervisor.halt("stopped at the gateway on request; call reset")
            chain.gateway.on_control(Control(next(self._ids), session, "stop"), chain.now)
        elif service == "reset":
            before = chain.supervisor.session
            chain.supervisor.request_reset(chain.now)
            armed = chain.run_until(lambda: chain.supervisor.session != before and self.now("link") == "ARMED", RESET)
            if not armed:
                raise ScenarioError(f"not armed within {RESET:g} s: {chain.supervisor.reason}")
        else:
            raise ScenarioError(f"{service}: no scenario on the simulated chain calls it")

    def _wait(self, condition: Callable[[], bool], what: str, deadline: int) -> None:
        left = max(deadline - self.chain.now, 0) / NANOSECONDS
        if not self.chain.run_until(condition, left):
            states = ", ".join(f"{topic} {self.now(topic)}" for topic in STATES)
            raise ScenarioError(f"waited in vain for {what}; {states}")

    # -- what is recorded

    def _begin_recording(self) -> None:
        chain = self.chain
        self._began = self._since = chain.now
        self._missed = self._missed_before = chain.controller.counters["missed"]
        self._rsi_session = chain.controller.session
        # what stands already is the first that is told
        self._seen = [Change(chain.now, topic, self.now(topic)) for topic in STATES]
        chain.transitions.clear()
        chain.observe = self._on_cycle
        chain.repeat(round(BACKGROUND_PERIOD * NANOSECONDS), self._in_the_background)
        chain.repeat(POLL, self._note_states)

    def _in_the_background(self) -> None:
        if self._auto:
            self._approval.approve_automatically(self.chain.now)

    def _record_action(self, topic: str, value: str, reason: str = "") -> None:
        self._actions.append(Change(self.chain.now, topic, value, reason))

    def _last(self, topic: str) -> str:
        return next((change.value for change in reversed(self._seen) if change.topic == topic), "")

    def _note_states(self) -> None:
        """What bridge and executor would publish: at each poll of the bridge, and in every cycle."""
        chain, executor = self.chain, self.chain.executor
        for topic, reason in (("link", chain.supervisor.reason), ("execution", executor.reason)):
            if self.now(topic) != self._last(topic):
                self._seen.append(Change(chain.now, topic, self.now(topic), reason))
        start, plan = executor.plan_start, executor.plan
        if plan is not None and start:
            outcome = "" if self.now("execution") in ("PLAYING", "STOPPING") else executor.outcome
            known = self._plans.get(start)
            if outcome and (known is None or known.outcome != outcome):
                self._seen.append(Change(chain.now, "outcome", outcome, executor.reason))
            self._plans[start] = PlayedPlan(plan.id, start, plan.trajectory.duration, outcome)
        stop = chain.gateway.status()["stop"]
        if stop["took_s"]:
            self._stops[GatewayStop(stop["cause"], tuple(stop["distance_deg"]), tuple(stop["moved_deg"]))] = None

    def _on_cycle(self) -> None:
        """What the mock would publish in a cycle."""
        chain, controller = self.chain, self.chain.controller
        now = chain.now
        true = ROBOT.from_axes(controller.true_position)
        self._arm.append((now, true))
        self._rest.update(now / NANOSECONDS, true)
        if controller.counters["missed"] != self._missed:
            self._missed = controller.counters["missed"]
            self._missed_at.append(now)
        active = frozenset(chain.faults.active)
        for topic, texts in (("fault", active - self._faults), ("fault_end", self._faults - active)):
            for text in sorted(texts):
                name, _, subject = text.partition(" ")
                self._seen.append(Change(now, topic, name, subject))
        self._faults = active
        if controller.session != self._rsi_session:
            self._rsi_session = controller.session
            self._seen.append(Change(now, "session", str(controller.session), controller.reason))
        if controller.ramp is not None and not self._stated:
            self._stated = tuple(to_wire(controller.ramp.distance, ROBOT.linear))
        self._note_states()

    def _on_reply(
        self, ipoc: int, session: int, state: State, stamp: int, position: tuple[float, ...], lost: bool
    ) -> None:
        self.trace.append(TraceEntry(ipoc, stamp, state, session, position, lost))

    def _changes(self) -> list[Change]:
        sync = [Change(change.at, "sync", change.target.name, change.reason) for change in self.chain.transitions]
        return sorted([*self._seen, *sync, *self._actions], key=lambda change: change.stamp)

    def _run(self, failure: str) -> Run:
        recording = replace(self.chain.recording(), plans=tuple(self._plans[start] for start in sorted(self._plans)))
        stamps, arm = zip(*self._arm)
        return Run(
            recording=recording,
            changes=tuple(self._changes()),
            closings=tuple(_closings(self.chain)),
            arm_stamps=np.array(stamps, dtype=np.int64),
            arm=np.array(arm),
            missed=self._missed - self._missed_before,
            missed_at=np.array(self._missed_at, dtype=np.int64),
            failure=failure,
            stops=tuple(self._stops),
            stated=self._stated,
        )


def _closings(chain: SimulatedChain):
    for change in chain.transitions:
        if change.source.name == "IN_SYNC" and change.target.name != "IN_SYNC":
            known = change.comparison
            error, threshold = (known.error, known.threshold) if known is not None else ((), ())
            lag = known.servo_lag if known is not None else float("nan")
            yield SyncMoment(change.at, ROBOT.joint_names, error, threshold, lag)


SHIPPED = sorted(path.stem for path in (ROOT / "config/scenarios").glob("*.yaml"))


@cache
def carried_out(name: str) -> tuple[ScenarioRun, Run, list[TraceEntry]]:
    """Return the first run of a shipped scenario."""
    run = ScenarioRun(name, shipped(name))
    return run, *run.carry_out()


@pytest.mark.parametrize("name", SHIPPED)
def test_the_cell_does_what_the_scenario_expects(name):
    run, *recorded = carried_out(name)
    verdict = run.judge(*recorded)
    failed = [f"{check.name}: {check.found}; expected {check.expected}" for check in verdict.checks if not check.passed]
    assert verdict.passed, "\n".join([*failed, verdict.measured["did"]])
    told = io.StringIO()
    print_verdict(verdict, Console(file=told, width=160))
    assert f"{name}: passed" in told.getvalue()


@pytest.mark.parametrize("name", ["stall_replan", "packets_lost", "encoder_slip", "slow_joint"])
def test_without_its_fault_a_scenario_fails(name):
    content = shipped(name)
    content["scenario"]["steps"] = [step for step in content["scenario"]["steps"] if "inject" not in step]
    content["scenario"]["limit"] = 6.0
    run = ScenarioRun(name, content)
    assert not run.judge(*run.carry_out()).passed


def test_a_scenario_is_the_same_each_time():
    one, other = carried_out("packets_lost")[1:], ScenarioRun("packets_lost", shipped("packets_lost")).carry_out()
    assert one[1] == other[1]
    assert [(change.stamp, change.topic, change.value) for change in one[0].changes] == [
        (change.stamp, change.topic, change.value) for change in other[0].changes
    ]
