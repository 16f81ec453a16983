"""Builds a model with the mock arm, as a person would who approves every plan: the command behind `make build`."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pydantic
import rospy
from rich.console import Console
from rich.table import Table

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RequestRefused
from construction_twin.core.files import check_writable
from construction_twin.core.reports import TaskReport
from construction_twin.extensions.work.build_report import HEADS, Decision, TaskResult, rows, write_report
from construction_twin.extensions.work.task_board import removed_command
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.msg import Execution, Link, Plan, Sync, ToolState, WorkTask, WorkTasks
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.tool import read_tool
from construction_twin.ros.commands.experiment import point_latest
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.node import ending_on_signals
from construction_twin.ros.shared.operator_client import OperatorClient
from construction_twin.ros.shared.params import Parameters, PrivateSettings, read_parameters
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import WorkDecide

#: Who approves, for the record.
PERSON = "make build"
#: States in which a task needs no more plan.
_SETTLED = ("done", "skipped", "held")
#: Most plans for one task.
_MOST_PLANS = 5
#: A plan may take that many times its duration, and the timeout of the settings: a hold, switches.
_SLOWER = 4.0
_POLL = 0.05
#: While the model is read, a line says so as often [s].
_LINE = 10.0


class Settings(PrivateSettings):
    """Private parameters, given in launch/build.launch.

    Attributes:
        tool: Path of the tool file.
        most: Tasks to do; 0: all.
        timeout: Longest wait for anything but a motion [s].
    """

    results_dir: str
    arm: str
    tool: str
    most: Annotated[int, pydantic.Field(ge=0)]
    timeout: Annotated[float, pydantic.Field(gt=0.0)]


@dataclass
class _Times:
    """What one task took."""

    planning: float = 0.0
    motion: float = 0.0
    plans: list[str] = field(default_factory=list)


class Builder:
    """One building session."""

    def __init__(self, settings: Settings, console: Console):
        if settings.arm != "mock":
            raise ConfigurationError("arm", settings.arm, "mock: nobody looks at the plans that this command approves")
        self._settings, self._console = settings, console
        self._client = OperatorClient(rospy.get_namespace(), settings.timeout, PERSON)
        self._news = threading.Condition()
        self._newest: dict[str, Any] = {}
        self._times: dict[str, _Times] = {}
        self._decisions: list[Decision] = []
        self._held = 0
        self._confirm = read_tool(settings.tool).tool.grip.confirm
        self._last: dict[str, str] = {}
        reports = {
            "work/tasks": WorkTasks,
            "execution": Execution,
            "link": Link,
            "sync": Sync,
            "plan": Plan,
            "tool": ToolState,
        }
        refuse = warn_of_refusals()
        self._subscribers = {
            topic: Subscriber(topic, kind, partial(self._receive, topic), refuse, queue_size=5)
            for topic, kind in (*reports.items(), ("scene", SceneMsg))
        }

    def run(self) -> tuple[Path, ...]:
        """Build, and write the report; return its files.

        Raises:
            ConstructionTwinError: If the system does not get ready, or a task cannot be done.
        """
        results = Path(self._settings.results_dir).expanduser()
        check_writable(results)
        began = time.monotonic()
        self._wait(self._ready, "the system to get ready")
        self._wait_for_model(began)
        self._accept()
        self._say(f"{self._tasks.model}: {len(self._tasks.tasks)} tasks, ready after {time.monotonic() - began:.0f} s")
        wanted = [task.id for task in self._tasks.tasks][: self._settings.most or None]
        failure: Exception | None = None
        try:
            for number, task in enumerate(wanted, start=1):
                self._do(task, f"{number} of {len(wanted)}")
        except (ConstructionTwinError, rospy.ROSException, rospy.ServiceException) as error:
            failure = error
        # also of a session that a task ended
        files = self._report(results, wanted)
        if failure is not None:
            raise ConstructionTwinError(f"{failure}; see {files[0]}") from failure
        missing = [self._row(task).name for task in wanted if self._row(task).state != "done"]
        if missing:
            raise ConstructionTwinError(
                f"{len(missing)} of {len(wanted)} tasks are not done: {', '.join(missing)}; see {files[0]}"
            )
        return files

    # -- one task

    def _do(self, task: str, title: str) -> None:
        while (row := self._row(task)).state not in _SETTLED:
            if row.state == "asks":
                self._answer(row)
                continue
            self._wait(
                lambda: self._row(task).state in ("ready", "carried", "asks", *_SETTLED) and self._ready(),
                f"task {task}",
            )
            row = self._row(task)
            if row.state == "ready" and any(removed_command(said) in row.reason for said in (task, row.name)):
                self._remove(row)
            elif row.state in ("ready", "carried"):
                self._plan_and_play(task, title)
        times = self._times.get(task, _Times())
        far = f", {row.deviation_mm:.3f} mm off" if math.isfinite(row.deviation_mm) else ""
        self._say(
            f"{title}: {row.name}: {row.state}, planned in {times.planning:.1f} s, {times.motion:.1f} s of motion{far}"
        )

    def _plan_and_play(self, task: str, title: str) -> None:
        times = self._times.setdefault(task, _Times())
        if len(times.plans) >= _MOST_PLANS:
            raise ConstructionTwinError(f"{title}: {self._row(task).name} is not done after {_MOST_PLANS} plans")
        asked = time.monotonic()
        try:
            plan = self._client.plan(GoalRequest("work_task", task=task)).fields
        except RequestRefused as error:
            raise ConstructionTwinError(f"{title}: {self._row(task).name} cannot be planned: {error}") from error
        times.planning, plan_id, plan_hash = time.monotonic() - asked, str(plan["plan_id"]), str(plan["plan_hash"])
        times.plans.append(plan_id)
        self._approve(plan_id, plan_hash)
        self._decided(f"approved plan {plan_id} of {self._row(task).name}, hash {plan_hash[:12]}")
        began = time.monotonic()
        held = self._held
        patience = self._settings.timeout + _SLOWER * self._duration(plan_id)
        self._wait(
            lambda: self._execution.plan_id == plan_id and self._over(),
            f"plan {plan_id} to end",
            patience,
        )
        times.motion = time.monotonic() - began
        if self._execution.outcome != "finished":
            # a hold that the executor did not show as a state of its own
            self._held += self._held == held
            self._say(f"{title}: {self._execution.outcome}: {self._execution.reason}")
        self._wait(lambda: self._row(task).state not in _UNDER_WAY, f"the ledger to know what became of {task}")

    def _approve(self, plan_id: str, plan_hash: str) -> None:
        """Approve a plan; repeated while it, which travels on a topic of its own, has not reached the executor."""

        verdict = ReviewRequest(plan_id, plan_hash, "approved", PERSON, "nobody is near a mock arm")

        def approved() -> bool:
            try:
                self._client.review(verdict)
            except RequestRefused as error:
                if "is not under review" in str(error) or "waits" in str(error):
                    return False
                raise
            return True

        self._wait(approved, f"plan {plan_id} to be approved")

    def _answer(self, row: WorkTask) -> None:
        """Answer as a person would who looks at the mock's gripper."""
        tool: ToolState = self._newest.get("tool")
        if tool is None or not tool.known:
            raise ConstructionTwinError(f"{row.name}: {row.question}: what the gripper holds is not known")
        answer = answer_of(
            dict(zip(tool.inputs, tool.input_values)), self._confirm, self._last.get(row.id, ""), row.answers
        )
        if not answer:
            raise ConstructionTwinError(
                f"{row.name}: {row.question}: none of {', '.join(row.answers)} is known to be true"
            )
        self._say(f"asked: {row.question} Answer: {answer}")
        self._decide(row.id, "answer", answer)
        self._decided(f"answered {answer} for {row.name}: {row.question}")
        self._wait(lambda: self._row(row.id).state != "asks", f"the answer to task {row.id} to be taken")

    def _remove(self, row: WorkTask) -> None:
        """Say that what people take down is gone, as a person would who sees that nothing stands at a mock arm."""
        self._say(row.reason)
        self._decide(row.id, "removed")
        self._decided(f"said that {row.element_name} is gone: {row.name}")
        self._wait(lambda: self._row(row.id).state == "done", f"task {row.id} to be done")

    def _accept(self) -> None:
        if self._tasks.schedule == "proposed":
            self._decide("", "accept_schedule")
            self._decided(f"accepted the proposed schedule of {len(self._tasks.tasks)} tasks")
            self._wait(lambda: self._tasks.schedule == "accepted", "the schedule to be accepted")

    def _decide(self, task: str, decision: str, answer: str = "") -> None:
        fields = {"task": task, "decision": decision, "answer": answer, "person": PERSON, "reason": "a mock arm"}
        self._client.ask("work/decide", WorkDecide, **fields)

    def _decided(self, what: str) -> None:
        self._decisions.append(Decision(time.time(), PERSON, what))

    def _wait_for_model(self, began: float) -> None:
        """Wait until the model is read, as long as a node reads it: a large model on a busy machine takes its time."""
        heard = told = began
        reader = self._subscribers["work/tasks"]
        while self._tasks is None or not self._tasks.schedule:
            now = time.monotonic()
            if self._tasks is not None and not self._tasks.reading:
                raise ConstructionTwinError(f"the model cannot be read: {self._tasks.reason}")
            if self._tasks is not None and reader.get_num_connections() > 0:
                heard = now
            if now - heard > self._settings.timeout:
                raise ConstructionTwinError(
                    f"waited {self._settings.timeout:g} s in vain for a work node that reads the model"
                )
            if now - told >= _LINE:
                told = now
                self._say(f"reading the model: {now - began:.0f} s")
            self._pause()

    def _pause(self) -> None:
        """Wait for the next message."""
        if rospy.is_shutdown():
            raise ConstructionTwinError("interrupted")
        with self._news:
            self._news.wait(_POLL)

    # -- what is known

    @property
    def _tasks(self) -> WorkTasks:
        return self._newest.get("work/tasks")

    @property
    def _execution(self) -> Execution:
        return self._newest.get("execution", Execution())

    def _row(self, task: str) -> WorkTask:
        return next(one for one in self._tasks.tasks if one.id == task)

    def _duration(self, plan_id: str) -> float:
        self._wait(lambda: self._newest.get("plan", Plan()).id == plan_id, f"plan {plan_id} to be told")
        return self._newest["plan"].duration

    def _over(self) -> bool:
        return self._execution.state in (Execution.WAITING, Execution.IDLE) and bool(self._execution.outcome)

    def _ready(self) -> bool:
        link, sync = self._newest.get("link", Link()), self._newest.get("sync", Sync())
        return (link.state, sync.state, self._execution.state) == (Link.ARMED, Sync.IN_SYNC, Execution.IDLE)

    def _report(self, results: Path, wanted: list[str]) -> tuple[Path, ...]:
        found = []
        for row in map(self._row, wanted):
            times, task = self._times.get(row.id, _Times()), from_msg(TaskReport, row)
            people = (PERSON,) if times.plans else ()
            found.append(TaskResult(task, times.planning, times.motion, len(times.plans), people))
        table = Table(*HEADS)
        for cells in rows(found):
            table.add_row(*cells)
        self._console.print(table)
        directory = results / time.strftime("%Y-%m-%d_%H-%M-%S_build")
        directory.mkdir(parents=True)
        files = write_report(
            directory,
            f"{self._tasks.model}, {len(wanted)} tasks",
            found,
            self._held,
            scene_from_msg(self._newest["scene"]),
            self._decisions,
        )
        point_latest(results, directory)
        return files

    def _wait(self, condition: Callable[[], object], what: str, patience: float = 0.0) -> None:
        """Wait, asking after every message; `patience` [s] 0 stands for the timeout of the settings."""
        limit = patience or self._settings.timeout
        deadline = time.monotonic() + limit
        while not condition():
            if time.monotonic() > deadline:
                tasks = self._tasks
                said = tasks.reason if tasks is not None else "the work node says nothing"
                raise ConstructionTwinError(
                    f"waited {limit:g} s in vain for {what}; executor: {self._execution.reason}; work: {said}"
                )
            self._pause()

    def _receive(self, topic: str, message) -> None:
        with self._news:
            if topic == "execution" and message.state == Execution.HELD != self._execution.state:
                self._held += 1
            self._newest[topic] = message
            if topic == "work/tasks":
                self._last |= {row.id: row.state for row in message.tasks if row.state in _UNDER_WAY}
            self._news.notify_all()

    def _say(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, highlight=False)


#: States of a task from which it still leads somewhere by itself.
_UNDER_WAY = ("planned", "working", "gripping", "carrying", "releasing", "retreating")


def answer_of(inputs: Mapping[str, bool], confirm: Mapping[str, bool], last: str, answers: Collection[str]) -> str:
    """Return what became of an element, from the mock's gripper and how far its task had come; empty: not known.

    Args:
        inputs: Of the tool, as they are.
        confirm: What they read while the tool holds something.
        last: Last known state of the task in which something was under way; empty: none.
        answers: What can be answered.
    """
    if bool(confirm) and all(inputs.get(name) == value for name, value in confirm.items()):
        wanted = "in_grip"
    else:
        # what was carried and is not held any more was lost
        wanted = {"releasing": "placed", "retreating": "placed", "carrying": "gone"}.get(last, "in_stock")
    return wanted if wanted in answers else ""


def checked(parameters: Parameters = rospy) -> Settings:
    """Return what the node starts with; raise the ConstructionTwinError that it is refused for."""
    settings = read_parameters(Settings, parameters)
    check_writable(Path(settings.results_dir).expanduser())
    return settings


def main() -> int:
    """Run the session; return the exit code."""
    console = Console()
    try:
        with ending_on_signals():
            rospy.init_node("build", disable_signals=True)
            files = Builder(checked(), console).run()
    except ConstructionTwinError as error:
        console.print(f"build: {error}", soft_wrap=True, highlight=False)
        return 1
    for path in files:
        console.print(str(path), soft_wrap=True, highlight=False)
    return 0
