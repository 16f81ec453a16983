"""scenario: runs one scenario on a running cell with the mock, records and judges it."""

from __future__ import annotations

import difflib
import json
import shutil
import sys
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
import rospy
import yaml
from rich.console import Console
from rich.table import Table
from rich.text import Text
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, command_message
from construction_twin.core.extensions import node_modules
from construction_twin.core.files import check_writable
from construction_twin.core.limits import MotionLimits
from construction_twin.evaluation.bag import (
    ARM,
    EXECUTION,
    LINK,
    MOCK,
    REPORTS,
    SYNC,
    TRANSITIONS,
    messages_of,
    nanoseconds,
    open_bag,
    read_recording,
)
from construction_twin.evaluation.tables import table_console
from construction_twin.gateway.trace import read_trace
from construction_twin.msg import Execution, Link, Plan, Sync, Transition
from construction_twin.robot.description import RobotModel
from construction_twin.ros.commands.driver import CellDriver, RestDetector
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.master import await_master
from construction_twin.ros.shared.node import ending_on_signals
from construction_twin.ros.shared.params import Parameters, robot_from_parameters
from construction_twin.ros.transport.persistent_service import PersistentService
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.scenario.definition import STATES, Injection, Move, Scenario, ScenarioError, Step, make_scenario
from construction_twin.scenario.judge import Judgement, judge
from construction_twin.scenario.timeline import Change, GatewayStop, Run, SyncMoment
from construction_twin.srv import InjectFault, ReviewPlan
from construction_twin.validation import StrictModel


def print_verdict(verdict: Judgement, console: Console) -> None:
    """Print one run's checks."""
    table = Table(title=f"{verdict.scenario}: {verdict.title}", title_justify="left")
    for column in ("check", "expected", "found", ""):
        table.add_column(column, overflow="fold")
    for check in verdict.checks:
        table.add_row(*map(Text, (check.name, check.expected, check.found, "ok" if check.passed else "FAILED")))
    console.print(table)
    console.print(f"{verdict.scenario}: {'passed' if verdict.passed else 'FAILED'}")


BAG, NOTES, TRACE, VERDICT = "scenario.bag", "run.json", "gateway.trace", "verdict.json"
#: What is recorded, relative to the robot's namespace.
TOPICS = (
    "twin/joint_states",
    "physical/joint_states",
    "physical/feedback",
    "command/joint_states",
    "expected/joint_states",
    "sync",
    "transitions",
    "plan",
    "review",
    "execution",
    "link",
    MOCK,
    ARM,
)
#: Longest wait for the system to get ready, and for the recorder [s].
_READY = 60.0
#: The arm counts as at rest when no joint left this band [rad] for this time [s].
_REST_BAND, _REST_TIME = 1e-6, 0.4


class ScenarioSettings(StrictModel):
    """What the launch file gives beside the scenario itself: `results_dir` and `trace` are absolute paths."""

    name: Annotated[str, pydantic.Field(pattern=r"^[a-z0-9_]+$")]
    results_dir: Annotated[str, pydantic.Field(pattern=r"^[/~]")]
    trace: Annotated[str, pydantic.Field(pattern=r"^/")]
    file: str


class ScenarioDriver(CellDriver):
    """Carries out a scenario's steps as a person would: through topics and services."""

    def __init__(self, scenario: Scenario, robot: RobotModel, console: Console):
        super().__init__("scenario", robot, console, _READY)
        self._scenario = scenario
        #: What was seen and done, in order; `actions` is what this program did itself.
        self.changes: list[Change] = []
        self.actions: list[Change] = []
        self._passed: list[Change] = []
        self._approved = ""
        self._since = self._moved = 0
        self._deadline = 0.0
        refuse = warn_of_refusals()
        for topic, kind in zip(STATES, (Sync, Link, Execution)):
            Subscriber(topic, kind, partial(self._on_state, topic), refuse, queue_size=50)
        Subscriber("transitions", Transition, self._on_transition, refuse, queue_size=50)
        self._rest = RestDetector(_REST_BAND, _REST_TIME)
        self._stop = PersistentService("stop", Trigger)

    def run(self) -> str:
        """Carry out every step and wait for the end; return why it was cut short, empty when it was not."""
        self._deadline = time.monotonic() + self._scenario.limit
        arm = rospy.Subscriber("mock_rsi/joint_states", JointState, self._on_arm, queue_size=10)
        self._since = rospy.Time.now().to_nsec()
        try:
            for step in self._scenario.steps:
                self._carry_out(step)
            final = self._scenario.expect.final
            self._wait(lambda: all(self.now(t) == s for t, s in final.items()) and self._rest.at_rest, f"{dict(final)}")
        except (ConstructionTwinError, rospy.ServiceException, rospy.ROSException) as error:
            return str(error)
        finally:
            arm.unregister()
        return ""

    def now(self, topic: str) -> str:
        """Return the last state of a topic; of ``outcome`` the last plan's."""
        if topic == "outcome":
            return self.execution.outcome
        return next((c.value for c in reversed(self.changes) if c.topic == topic), "")

    # -- steps

    def _carry_out(self, step: Step) -> None:
        begin = self._moment(step.when)
        due = begin + round(step.after * 1e9)
        self._wait(lambda: rospy.Time.now().to_nsec() >= due, f"{step}")
        stamp = rospy.Time.now().to_nsec()
        self.print_line(f"{(stamp - self._since) / 1e9:8.3f} s  {step}")
        self._since = stamp
        if step.move:
            self._move(step.move)
        elif step.approve:
            self._approve(step.approve == "refused")
        elif step.inject:
            self._inject(step.inject, f"{step}")
        elif step.call:
            self._record_action("call", step.call)
            service = self._stop if step.call == "stop" else rospy.ServiceProxy(step.call, Trigger)
            self._check(step.call, service())

    def _moment(self, when: str) -> int:
        """Wait for what a step waits for; return its moment [ns]."""
        if when == "now":
            return self._since
        if when == "rest":
            self._wait(lambda: self._rest.at_rest, "the arm to stand")
            return rospy.Time.now().to_nsec()
        if when == "motion":
            self._wait(self._moving, "the motion to start")
            return self.execution.plan_start.to_nsec()
        topic, state = when.split(" ")
        self._wait(lambda: self.now(topic) == state or self._entered(topic, state), when)
        return self._entered(topic, state) or self._since

    def _moving(self) -> bool:
        state = self.execution
        return state.plan_start.to_nsec() >= self._moved > 0 and bool(state.state == Execution.PLAYING or state.outcome)

    def _entered(self, topic: str, state: str) -> int:
        """Return when a state was entered since the last step [ns]; 0 when it was not."""
        changes = [*self._passed, *self.changes]
        return next((c.stamp for c in changes if (c.topic, c.value) == (topic, state) and c.stamp >= self._since), 0)

    def _move(self, move: Move) -> None:
        self._record_action("move", str(move.goal_deg))
        self._moved = rospy.Time.now().to_nsec()
        self.plan(move.goal_deg, move.duration)

    def _approve(self, refused: bool) -> None:
        plan = self._wait(self._new_plan, "a plan to approve")
        review = rospy.ServiceProxy("review_plan", ReviewPlan)

        def answered():
            # plan and rehearsal travel to the executor on topics of their own
            answer = review(
                plan_id=plan.id, plan_hash=plan.hash, approve=True, reviewer="scenario", reason=self._scenario.name
            )
            early = "is not under review" in answer.message or (refused and "was not rehearsed yet" in answer.message)
            return answer if answer.success or not early else None

        patience = self._deadline if refused else min(self._deadline, time.monotonic() + 2.0)
        answer = self._wait(answered, "the executor to know the plan", patience)
        self._approved = plan.id
        if refused:
            if answer.success:
                raise ScenarioError(f"plan {plan.id} was approved; expected a refusal")
            self.actions.append(Change(rospy.Time.now().to_nsec(), "refused", plan.id, answer.message))
            return
        self._record_action("approve", plan.id)
        self._check("review_plan", answer)

    def _new_plan(self) -> Plan | None:
        plan = self.listener.newest("plan")
        return plan if plan is not None and plan.id != self._approved else None

    def _inject(self, fault: Injection, what: str) -> None:
        answer = rospy.ServiceProxy("mock_rsi/inject", InjectFault)(
            fault.fault, fault.joint, fault.values, fault.direction, fault.duration, not fault.end
        )
        self._check(what, answer)
        if fault.fault in ("restart_at", "jog"):
            self._record_action("fault", fault.fault)

    def _check(self, what: str, answer) -> None:
        if not answer.success:
            raise ScenarioError(f"{what}: {answer.message}")

    def _record_action(self, topic: str, value: str) -> None:
        self.actions.append(Change(rospy.Time.now().to_nsec(), topic, value))

    def _wait(self, condition: Callable[[], Any], what: str, deadline: float | None = None) -> Any:
        def waited_for() -> str:
            return f"{what}; {', '.join(f'{topic} {self.now(topic)}' for topic in STATES)}: {self._reasons()}"

        return self.wait(condition, waited_for, deadline or self._deadline)

    def _reasons(self) -> str:
        return "; ".join(c.reason for topic in STATES for c in [c for c in self.changes if c.topic == topic][-1:])

    # -- subscriptions

    def _on_state(self, topic: str, message) -> None:
        if message.text != self.now(topic):
            self.changes.append(Change(message.header.stamp.to_nsec(), topic, message.text, message.reason))

    def _on_transition(self, message: Transition) -> None:
        # a state that is left within the same cycle, as HOLDING for REPLANNING, is not on `sync`
        self._passed.append(Change(message.header.stamp.to_nsec(), "sync", message.to_text, message.reason))

    def _on_arm(self, message: JointState) -> None:
        self._rest.update(message.header.stamp.to_sec(), message.position)


def run_scenario(settings: ScenarioSettings, content: dict, console: Console) -> Judgement:
    """Run, record and judge; see the module."""
    scenario, robot = make_scenario(settings.name, content), robot_from_parameters()
    folder = Path(settings.results_dir).expanduser() / scenario.name
    check_writable(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name in (BAG, NOTES, TRACE, VERDICT):
        (folder / name).unlink(missing_ok=True)
    driver = ScenarioDriver(scenario, robot, console)
    driver.wait_until_ready("mock_rsi/inject")
    with driver.recording(folder / BAG, TOPICS):
        failure = driver.run()
        rospy.sleep(0.6)  # the mock's next report belongs to the recording
    notes = {"failure": failure, "actions": [asdict(action) for action in driver.actions]}
    (folder / NOTES).write_text(json.dumps(notes, indent=2) + "\n")
    shutil.copyfile(settings.trace, folder / TRACE)
    run, trace = read_run(folder, rospy.get_namespace()), read_trace(str(folder / TRACE))
    decimals, cycle_ms = rospy.get_param("gateway/decimals"), rospy.get_param("gateway/cycle")
    verdict = judge(scenario, run, trace, MotionLimits.of(robot), decimals, cycle_ms / 1000)
    changes = [asdict(change) | {"at_s": round((change.stamp - run.start) / 1e9, 4)} for change in run.changes]
    (folder / VERDICT).write_text(json.dumps(verdict.to_dict() | {"changes": changes}, indent=2, default=str) + "\n")
    return verdict


# -- the recording


def read_run(folder: Path, namespace: str | None = None) -> Run:
    """Read a recorded run from the folder of bag and notes; `namespace` None: of the only robot in the bag."""
    path = folder / BAG
    recording = read_recording(path, namespace)
    prefix = recording.robot.rstrip("/")
    notes = json.loads((folder / NOTES).read_text())
    changes = [Change(**change) for change in notes["actions"]]
    with open_bag(path) as bag:
        read = messages_of(bag, recording.robot, (SYNC, TRANSITIONS, LINK, EXECUTION, MOCK, ARM))
    messages = {name: [message for _, message in found] for name, found in read.items()}
    for name in (SYNC, EXECUTION, MOCK, ARM):
        if name not in messages:
            raise ConstructionTwinError(f"{path} holds no {prefix}/{name}; was the mock controller recorded?")
    reports = [json.loads(message.data) for message in messages[MOCK]]
    transitions = messages.get(TRANSITIONS, [])
    changes += [_gate_state(messages[SYNC][0].text, messages[SYNC][0])]
    # of the gate two changes may come within one cycle, which `sync` does not show
    changes += [_gate_state(message.to_text, message) for message in transitions]
    changes += [Change(c.stamp, c.source, c.state, c.reason) for c in recording.changes if c.source != REPORTS[SYNC]]
    changes += [*_outcomes(messages[EXECUTION]), *_faults(reports)]
    arm = messages[ARM]
    columns = [arm[0].name.index(joint) for joint in recording.joint_names]
    missed = np.array([report["counters"]["missed"] for report in reports])
    told = np.array([report["stamp"] for report in reports], dtype=np.int64)
    return Run(
        recording=recording,
        changes=tuple(sorted(changes, key=lambda change: change.stamp)),
        closings=tuple(_closings(transitions, messages[SYNC])),
        arm_stamps=np.array([nanoseconds(message.header.stamp) for message in arm], dtype=np.int64),
        arm=np.array([message.position for message in arm])[:, columns],
        missed=int(missed[-1] - missed[0]),
        missed_at=told[np.diff(missed, prepend=missed[0]) > 0],
        failure=notes["failure"],
        stops=tuple(dict.fromkeys(_stops(messages.get(LINK, [])))),
        stated=next((tuple(report["stop_ramp"]["distance_deg"]) for report in reports if report["stop_ramp"]), ()),
    )


def _gate_state(state: str, message) -> Change:
    return Change(nanoseconds(message.header.stamp), "sync", state, message.reason)


def _outcomes(messages: list) -> Iterator[Change]:
    last = None
    for message in messages:
        found = message.plan_id, message.outcome
        if message.outcome and found != last:
            yield Change(nanoseconds(message.header.stamp), "outcome", message.outcome, message.reason)
        last = found


def _faults(reports: list[dict]) -> Iterator[Change]:
    before: set[str] = set()
    session = reports[0]["session"]
    for report in reports:
        now = set(report["faults"])
        for topic, texts in (("fault", now - before), ("fault_end", before - now)):
            for text in sorted(texts):
                name, _, subject = text.partition(" ")
                yield Change(report["stamp"], topic, name, subject)
        if report["session"] != session:
            session = report["session"]
            yield Change(report["stamp"], "session", str(session), report["reason"])
        before = now


def _stops(messages: list) -> Iterator[GatewayStop]:
    for message in messages:
        told = {pair.key: pair.value for pair in message.gateway_counters}
        if told.get("stop_took_s"):
            stated, moved = (tuple(map(float, told[f"stop_{name}_deg"].split())) for name in ("distance", "moved"))
            yield GatewayStop(told["stop_cause"], stated, moved)


def _closings(transitions: list, syncs: list) -> Iterator[SyncMoment]:
    stamps = [nanoseconds(sync.header.stamp) for sync in syncs]
    for message in transitions:
        if message.from_text == "IN_SYNC":
            stamp = nanoseconds(message.header.stamp)
            last = syncs[max(0, bisect_right(stamps, stamp) - 1)]
            measured = tuple(message.name), tuple(message.error), tuple(message.threshold)
            yield SyncMoment(stamp, *measured, last.servo_lag)


def checked_parameters(parameters: Parameters = rospy) -> tuple[ScenarioSettings, dict]:
    """Return the node's settings and its scenario; ConstructionTwinError refuses its start."""
    content = parameters.get_param("~", {})
    given = {name: content.pop(name) for name in ScenarioSettings.model_fields if name in content}
    settings = ScenarioSettings.read(given, parameters.get_name())
    make_scenario(settings.name, content)
    known = {*node_modules(), "scenario", "gateway", "separation"}
    for name in yaml.safe_load(Path(settings.file).read_text(encoding="utf-8")):
        if name not in known:
            near = "".join(f"; did you mean {each}?" for each in difflib.get_close_matches(name, known, n=1))
            raise ConfigurationError(settings.file, name, f"`scenario`, or a node whose parameters it changes{near}")
    check_writable(Path(settings.results_dir).expanduser())
    return settings, content


def main() -> int:
    """Run the node; return the process's status: 0 when the scenario passed, else 1."""
    console = table_console(markup=False)
    try:
        await_master()
        with ending_on_signals():
            rospy.init_node("scenario", disable_signals=True)
            settings, content = checked_parameters()
            verdict = run_scenario(settings, content, console)
    except (ConstructionTwinError, rospy.ROSException, OSError) as error:
        print(f"scenario: {command_message(error)}", file=sys.stderr, flush=True)
        return 1
    print_verdict(verdict, console)
    console.print(f"Written: {Path(settings.results_dir).expanduser() / settings.name / VERDICT}", soft_wrap=True)
    sys.stdout.flush()
    return 0 if verdict.passed else 1
