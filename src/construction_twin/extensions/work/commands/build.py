"""Builds a model with the mock arm, as a person would who approves every plan: the command behind `make build`."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
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
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.msg import Execution, Link, Plan, Sync, ToolState, WorkTask, WorkTasks
from construction_twin.robot.tool import read_tool
from construction_twin.ros.commands.experiment import point_latest
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.node import ending_on_signals
from construction_twin.ros.shared.operator_client import OperatorClient
from construction_twin.ros.shared.params import Parameters, PrivateSettings, read_parameters
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import WorkDecide

#: Who approves, for the record.
PERSON = "make build"
#: States in which a task needs no more plan; from which it still leads somewhere by itself.
_SETTLED = ("done", "skipped", "held")
_UNDER_WAY = ("planned", "working", "gripping", "carrying", "releasing", "retreating")
#: Most plans for one task.
_MOST_PLANS = 5
#: A plan may take that many times its duration, and the timeout of the settings: a hold, switches.
_SLOWER = 4.0
_POLL = 0.05
#: While the model is read, a line says so as often [s].
_LINE = 10.0
_TOPICS = {"work/tasks": WorkTasks, "execution": Execution, "link": Link, "sync": Sync, "plan": Plan, "tool": ToolState}


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
class Effort:
    """What one task took: times [s] of the plan that was carried out, and how many plans."""

    planning: float = 0.0
    motion: float = 0.0
    plans: int = 0


class Builder:
    """One building session."""

    def __init__(self, settings: Settings, console: Console):
        if settings.arm != "mock":
            raise ConfigurationError("arm", settings.arm, "mock: nobody looks at the plans that this command approves")
        self._settings, self._console = settings, console
        self._client = OperatorClient(rospy.get_namespace(), settings.timeout, PERSON)
        self._news = threading.Condition()
        self._newest: dict[str, Any] = {}
        self._efforts: dict[str, Effort] = defaultdict(Effort)
        self._decisions: list[dict[str, str]] = []
        self._held = 0
        self._confirm = read_tool(settings.tool).tool.grip.confirm
        #: The last state of each task in which something was under way.
        self._last: dict[str, str] = {}
        refuse = warn_of_refusals()
        self._subscribers = {
            topic: Subscriber(topic, kind, partial(self._receive, topic), refuse, queue_size=5)
            for topic, kind in _TOPICS.items()
        }

    def run(self) -> Path:
        """Build, and write the figures, also of a session that a task ended; return their file.

        Raises:
            ConstructionTwinError: If the system does not get ready, or a task cannot be done.
        """
        results = Path(self._settings.results_dir).expanduser()
        began = time.monotonic()
        self._wait(self._ready, "the system to get ready")
        self._wait_for_model(began)
        self._accept()
        self._say(f"{self._work.model}: {len(self._work.tasks)} tasks, ready after {time.monotonic() - began:.0f} s")
        wanted = [task.id for task in self._work.tasks][: self._settings.most or None]
        problem = ""
        try:
            for number, task in enumerate(wanted, start=1):
                self._do(task, f"{number} of {len(wanted)}")
        except (ConstructionTwinError, rospy.ROSException, rospy.ServiceException) as error:
            problem = str(error)
        tasks = [from_msg(TaskReport, self._row(task)) for task in wanted]
        missing = [task.name for task in tasks if task.state != "done"]
        if missing and not problem:
            problem = f"{len(missing)} of {len(wanted)} tasks are not done: {', '.join(missing)}"
        contents = {**figures(tasks, self._efforts), "held": self._held, "decisions": self._decisions}
        self._console.print(table(contents))
        directory = results / time.strftime("%Y-%m-%d_%H-%M-%S_build")
        directory.mkdir(parents=True)
        file = directory / "work.json"
        file.write_text(json.dumps(contents, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        point_latest(results, directory)
        if problem:
            raise ConstructionTwinError(f"{problem}; see {file}")
        return file

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
            if self._row(task).state in ("ready", "carried"):
                self._plan_and_play(task, title)
        effort = self._efforts[task]
        far = f", {row.deviation_mm:.3f} mm off" if math.isfinite(row.deviation_mm) else ""
        took = f"planned in {effort.planning:.1f} s, {effort.motion:.1f} s of motion"
        self._say(f"{title}: {row.name}: {row.state}, {took}{far}")

    def _plan_and_play(self, task: str, title: str) -> None:
        effort, name = self._efforts[task], self._row(task).name
        if effort.plans >= _MOST_PLANS:
            raise ConstructionTwinError(f"{title}: {name} is not done after {_MOST_PLANS} plans")
        asked = time.monotonic()
        try:
            plan = self._client.plan(GoalRequest("work_task", task=task)).fields
        except RequestRefused as error:
            raise ConstructionTwinError(f"{title}: {name} cannot be planned: {error}") from error
        effort.planning, plan_id, plan_hash = time.monotonic() - asked, str(plan["plan_id"]), str(plan["plan_hash"])
        effort.plans += 1
        self._approve(plan_id, plan_hash)
        self._decided(f"approved plan {plan_id} of {name}, hash {plan_hash[:12]}")
        began, held = time.monotonic(), self._held
        self._wait(lambda: self._newest.get("plan", Plan()).id == plan_id, f"plan {plan_id} to be told")
        patience = self._settings.timeout + _SLOWER * self._newest["plan"].duration
        self._wait(lambda: self._execution.plan_id == plan_id and self._over(), f"plan {plan_id} to end", patience)
        effort.motion = time.monotonic() - began
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
        """Answer as a person would who looks at the mock's gripper: a gate that held on a slow machine dropped the plan."""
        tool: ToolState | None = self._newest.get("tool")
        inputs = dict(zip(tool.inputs, tool.input_values)) if tool is not None and tool.known else None
        answer = answer_of(inputs, self._confirm, self._last.get(row.id, ""), row.answers)
        if not answer:
            raise ConstructionTwinError(
                f"{row.name}: {row.question}: none of {', '.join(row.answers)} is known to be true"
            )
        self._say(f"asked: {row.question} Answer: {answer}")
        self._decide(row.id, "answer", answer)
        self._decided(f"answered {answer} for {row.name}: {row.question}")
        self._wait(lambda: self._row(row.id).state != "asks", f"the answer to task {row.id} to be taken")

    def _accept(self) -> None:
        if self._work.schedule != "proposed":
            return
        self._decide("", "accept_schedule")
        self._decided(f"accepted the proposed schedule of {len(self._work.tasks)} tasks")
        self._wait(lambda: self._work.schedule == "accepted", "the schedule to be accepted")

    def _decide(self, task: str, decision: str, answer: str = "") -> None:
        fields = {"task": task, "decision": decision, "answer": answer, "person": PERSON, "reason": "a mock arm"}
        self._client.ask("work/decide", WorkDecide, **fields)

    def _decided(self, what: str) -> None:
        self._decisions.append({"time": _moment(time.time()), "person": PERSON, "what": what})

    # -- what is known

    def _wait_for_model(self, began: float) -> None:
        """Wait until the model is read, as long as a node reads it: a large model on a busy machine takes its time."""
        heard = told = began
        while self._work is None or not self._work.schedule:
            now = time.monotonic()
            if self._work is not None and not self._work.reading:
                raise ConstructionTwinError(f"the model cannot be read: {self._work.reason}")
            if self._work is not None and self._subscribers["work/tasks"].get_num_connections() > 0:
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

    @property
    def _work(self) -> WorkTasks:
        return self._newest.get("work/tasks")

    @property
    def _execution(self) -> Execution:
        return self._newest.get("execution", Execution())

    def _row(self, task: str) -> WorkTask:
        return next(one for one in self._work.tasks if one.id == task)

    def _over(self) -> bool:
        return self._execution.state in (Execution.WAITING, Execution.IDLE) and bool(self._execution.outcome)

    def _ready(self) -> bool:
        link, sync = self._newest.get("link", Link()), self._newest.get("sync", Sync())
        return (link.state, sync.state, self._execution.state) == (Link.ARMED, Sync.IN_SYNC, Execution.IDLE)

    def _wait(self, condition: Callable[[], object], what: str, patience: float = 0.0) -> None:
        """Wait, asking after every message; `patience` [s] 0 stands for the timeout of the settings."""
        limit = patience or self._settings.timeout
        deadline = time.monotonic() + limit
        while not condition():
            if time.monotonic() > deadline:
                said = self._work.reason if self._work is not None else "the work node says nothing"
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


def answer_of(
    inputs: Mapping[str, bool] | None, confirm: Mapping[str, bool], last: str, answers: Collection[str]
) -> str:
    """Return what became of an element, from the mock's gripper and how far its task had come; empty: not known.

    Args:
        inputs: Of the tool, as they are; None: not known.
        confirm: What they read while the tool holds something.
        last: Last known state of the task in which something was under way; empty: none.
        answers: What can be answered.
    """
    if inputs is None:
        return ""
    if bool(confirm) and all(inputs.get(name) == value for name, value in confirm.items()):
        wanted = "in_grip"
    else:
        # what was carried and is not held any more was lost
        wanted = {"releasing": "placed", "retreating": "placed", "carrying": "gone"}.get(last, "in_stock")
    return wanted if wanted in answers else ""


# -- what it came to


def figures(tasks: Sequence[TaskReport], efforts: Mapping[str, Effort]) -> dict[str, Any]:
    """Return the figures of ``work.json``: of the session, then of each task's element; None for what is not known."""
    built = [task.id for task in sorted(tasks, key=lambda one: one.settled) if task.state == "done"]
    elements = [_element(task, efforts[task.id], built) for task in tasks]
    deviations = [each["deviation_mm"] for each in elements if each["deviation_mm"] is not None]
    return {
        "tasks": len(tasks),
        "done": len(built),
        "replanned": sum(max(0, efforts[task.id].plans - 1) for task in tasks),
        "deviation_mm": {"max": max(deviations, default=None)},
        "as_scheduled": [task.id for task in tasks if task.id in built] == built,
        "elements": elements,
    }


def _element(task: TaskReport, effort: Effort, built: Sequence[str]) -> dict[str, Any]:
    """Return the figures of one element; `built`: the tasks that are done, in the order in which they were."""
    took = (task.settled - task.begun) / NANOSECONDS if 0 < task.begun <= task.settled else math.nan
    measured = math.isfinite(task.deviation_mm) and math.isfinite(task.deviation_deg)
    within = task.deviation_mm <= task.tolerance_mm and task.deviation_deg <= task.tolerance_deg
    return {
        "order": built.index(task.id) + 1 if task.id in built else None,
        "element": task.element,
        "name": task.element_name,
        "state": task.state,
        "mass_kg": _rounded(task.mass_kg, 3),
        "grip": task.grip,
        "plans": effort.plans,
        "planning_s": _rounded(effort.planning, 1) if effort.plans else None,
        "motion_s": _rounded(effort.motion, 1) if effort.plans else None,
        "deviation_mm": _rounded(task.deviation_mm, 3),
        "deviation_deg": _rounded(task.deviation_deg, 4),
        "within_tolerance": within if measured else None,
        "scheduled_start": task.scheduled_start or None,
        "scheduled_s": _rounded(task.scheduled_duration, 1),
        "begun": _moment(task.begun / NANOSECONDS) or None,
        "settled": _moment(task.settled / NANOSECONDS) or None,
        "took_s": _rounded(took, 1),
    }


#: Figures of an element that the table in the terminal leaves out.
_NOT_SHOWN = ("element", "scheduled_s", "begun", "settled")


def table(found: Mapping[str, Any]) -> Table:
    """Return the figures of the elements for the terminal, a row for each in the order of the schedule."""
    rows = [{name: value for name, value in each.items() if name not in _NOT_SHOWN} for each in found["elements"]]
    shown = Table(*(name.replace("_", " ") for name in next(iter(rows), {})))
    for row in rows:
        shown.add_row(*("" if value is None else str(value) for value in row.values()))
    return shown


def _rounded(value: float, decimals: int) -> float | None:
    return round(value, decimals) + 0.0 if math.isfinite(value) else None


def _moment(since_1970: float) -> str:
    """Return a time as ISO 8601, local and with its offset; empty for 0."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(since_1970)) if since_1970 else ""


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
            file = Builder(checked(), console).run()
    except ConstructionTwinError as error:
        console.print(f"build: {error}", soft_wrap=True, highlight=False)
        return 1
    console.print(str(file), soft_wrap=True, highlight=False)
    return 0
