"""Builds a model with the mock arm, as a person would who approves every plan: the command behind `make build`."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pydantic
import rospy
from rich.console import Console
from rich.table import Table

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RequestRefused
from construction_twin.core.files import check_writable
from construction_twin.core.records import json_value, to_json
from construction_twin.core.reports import TaskReport, WorkReport
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.msg import Execution, Link, Sync, ToolState, WorkTask, WorkTasks
from construction_twin.robot.tool import read_tool
from construction_twin.ros.commands.experiment import point_latest
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.node import ending_on_signals
from construction_twin.ros.shared.params import Parameters, PrivateSettings, read_parameters
from construction_twin.ros.shared.robot_client import OperatorClient
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import WorkDecide

#: Who approves, for the record.
PERSON = "make build"
#: States in which a task needs no more plan; from which it still leads somewhere by itself.
_SETTLED = ("done", "skipped", "held")
_UNDER_WAY = ("planned", "working", "gripping", "carrying", "releasing", "retreating")
#: Most plans for one task.
_MOST_PLANS = 5
_POLL = 0.05
_TOPICS = {"work/tasks": WorkTasks, "execution": Execution, "link": Link, "sync": Sync, "tool": ToolState}
#: Figures of a task in the terminal.
_SHOWN = ("name", "state", "grip", "plans", "planning_s", "motion_s", "mass_kg", "deviation_mm", "deviation_deg")


class Settings(PrivateSettings):
    """Private parameters, given in launch/build.launch: path of the tool file, most tasks (0: all), longest wait [s]."""

    results_dir: str
    arm: str
    tool: str
    most: Annotated[int, pydantic.Field(ge=0)]
    timeout: Annotated[float, pydantic.Field(gt=0.0)]


class Builder:
    """One building session."""

    def __init__(self, settings: Settings, console: Console):
        if settings.arm != "mock":
            raise ConfigurationError("arm", settings.arm, "mock: nobody looks at the plans that this command approves")
        self._settings, self._console = settings, console
        self._client = OperatorClient(rospy.get_namespace(), settings.timeout, PERSON)
        self._confirm = read_tool(settings.tool).tool.grip.confirm
        self._message_arrived = threading.Condition()
        self._newest: dict[str, Any] = {"execution": Execution(), "link": Link(), "sync": Sync()}
        #: Times [s] and number of the plans of each task, and its last state in which something was under way.
        self._efforts: dict[str, dict[str, float]] = {}
        self._last: dict[str, str] = {}
        self._decisions: list[dict[str, str]] = []
        refuse = warn_of_refusals()
        self._subscribers = {
            topic: Subscriber(topic, kind, partial(self._receive, topic), refuse, queue_size=5)
            for topic, kind in _TOPICS.items()
        }

    def run(self) -> Path:
        """Build, and write the figures, also of a session that a task ended; return their file."""
        began = time.monotonic()
        self._wait(self._ready, "the system to get ready")
        self._wait(self._is_read, "a work node that reads the model", self._is_reading)
        if self._work_tasks.schedule == "proposed":
            self._decide(f"accepted the proposed schedule of {len(self._work_tasks.tasks)} tasks", "accept_schedule")
            self._wait(lambda: self._work_tasks.schedule == "accepted", "the schedule to be accepted")
        self._print_line(
            f"{self._work_tasks.model}: {len(self._work_tasks.tasks)} tasks, ready after {time.monotonic() - began:.0f} s"
        )
        wanted = [task.id for task in self._work_tasks.tasks][: self._settings.most or None]
        self._efforts = {task: {"plans": 0, "planning_s": 0.0, "motion_s": 0.0} for task in wanted}
        failure = ""
        try:
            for number, task in enumerate(wanted, start=1):
                self._finish_task(task, f"{number} of {len(wanted)}")
        except (ConstructionTwinError, rospy.ROSException, rospy.ServiceException) as error:
            failure = str(error)
        tasks = [task for task in from_msg(WorkReport, self._work_tasks).tasks if task.id in self._efforts]
        missing = [task.name for task in tasks if task.state != "done"]
        if missing and not failure:
            failure = f"{len(missing)} of {len(wanted)} tasks are not done: {', '.join(missing)}"
        file = self._write(tasks)
        if failure:
            raise ConstructionTwinError(f"{failure}; see {file}")
        return file

    def _write(self, tasks: Collection[TaskReport]) -> Path:
        """Show what every task came to, and write it with what was decided; return the file."""
        elements = [{**json_value(task), **self._efforts[task.id]} for task in tasks]
        done = sum(task.state == "done" for task in tasks)
        table = Table(*(name.replace("_", " ") for name in _SHOWN))
        for each in elements:
            values = (each[name] for name in _SHOWN)
            table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value or "") for value in values))
        self._console.print(table)
        results = Path(self._settings.results_dir).expanduser()
        directory = results / time.strftime("%Y-%m-%d_%H-%M-%S_build")
        directory.mkdir(parents=True)
        file = directory / "work.json"
        counts = {"tasks": len(tasks), "done": done}
        file.write_bytes(to_json({**counts, "decisions": self._decisions, "elements": elements}))
        point_latest(results, directory)
        return file

    # -- one task

    def _finish_task(self, task: str, title: str) -> None:
        while (row := self._row(task)).state not in _SETTLED:
            if row.state == "asks":
                self._answer(row)
            elif row.state in ("ready", "carried") and self._ready():
                self._plan_and_play(row, title)
            else:
                states = ("ready", "carried", "asks", *_SETTLED)
                self._wait(lambda: self._row(task).state in states and self._ready(), f"task {task}")
        effort = self._efforts[task]
        far = f", {row.deviation_mm:.3f} mm off" if math.isfinite(row.deviation_mm) else ""
        took = f"planned in {effort['planning_s']:.1f} s, {effort['motion_s']:.1f} s of motion"
        self._print_line(f"{title}: {row.name}: {row.state}, {took}{far}")

    def _plan_and_play(self, row: WorkTask, title: str) -> None:
        effort = self._efforts[row.id]
        if effort["plans"] >= _MOST_PLANS:
            raise ConstructionTwinError(f"{title}: {row.name} is not done after {_MOST_PLANS} plans")
        asked = time.monotonic()
        try:
            plan = self._client.plan(GoalRequest("work_task", task=row.id)).fields
        except RequestRefused as error:
            raise ConstructionTwinError(f"{title}: {row.name} cannot be planned: {error}") from error
        plan_id, plan_hash = str(plan["plan_id"]), str(plan["plan_hash"])
        effort |= {"plans": effort["plans"] + 1, "planning_s": time.monotonic() - asked}
        verdict = ReviewRequest(plan_id, plan_hash, "approved", PERSON, "nobody is near a mock arm")
        self._wait(partial(self._approve, verdict), f"plan {plan_id} to be approved")
        self._record(f"approved plan {plan_id} of {row.name}, hash {plan_hash[:12]}")
        began = time.monotonic()
        self._wait(partial(self._is_over, plan_id), f"plan {plan_id} to end", self._is_playing)
        effort["motion_s"] = time.monotonic() - began
        execution = self._newest["execution"]
        if execution.outcome != "finished":
            self._print_line(f"{title}: {execution.outcome}: {execution.reason}")
        self._wait(lambda: self._row(row.id).state not in _UNDER_WAY, f"the ledger to know what became of {row.id}")

    def _approve(self, verdict: ReviewRequest) -> bool:
        """Approve a plan; return False while it, which travels on a topic of its own, has not reached the executor."""
        try:
            self._client.review(verdict)
        except RequestRefused as error:
            if "is not under review" in str(error) or "waits" in str(error):
                return False
            raise
        return True

    def _answer(self, row: WorkTask) -> None:
        """Answer as a person would who looks at the mock's gripper: a gate that held on a slow machine dropped the plan."""
        tool: ToolState | None = self._newest.get("tool")
        inputs = dict(zip(tool.inputs, tool.input_values)) if tool is not None and tool.known else None
        answer = answer_of(inputs, self._confirm, self._last.get(row.id, ""), row.answers)
        if not answer:
            known = ", ".join(row.answers)
            raise ConstructionTwinError(f"{row.name}: {row.question}: none of {known} is known to be true")
        self._print_line(f"asked: {row.question} Answer: {answer}")
        self._decide(f"answered {answer} for {row.name}: {row.question}", "answer", row.id, answer)
        self._wait(lambda: self._row(row.id).state != "asks", f"the answer to task {row.id} to be taken")

    def _decide(self, what: str, decision: str, task: str = "", answer: str = "") -> None:
        fields = {"task": task, "decision": decision, "answer": answer, "person": PERSON, "reason": "a mock arm"}
        self._client.ask("work/decide", WorkDecide, **fields)
        self._record(what)

    def _record(self, what: str) -> None:
        self._decisions.append({"time": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "person": PERSON, "what": what})

    # -- what is known

    @property
    def _work_tasks(self) -> WorkTasks:
        return self._newest["work/tasks"]

    def _row(self, task: str) -> WorkTask:
        return next(one for one in self._work_tasks.tasks if one.id == task)

    def _ready(self) -> bool:
        link, sync, execution = (self._newest[topic].state for topic in ("link", "sync", "execution"))
        return (link, sync, execution) == (Link.ARMED, Sync.IN_SYNC, Execution.IDLE)

    def _is_over(self, plan_id: str) -> bool:
        now = self._newest["execution"]
        return now.plan_id == plan_id and now.state in (Execution.WAITING, Execution.IDLE) and bool(now.outcome)

    def _is_read(self) -> bool:
        work = self._newest.get("work/tasks")
        if work is not None and not (work.schedule or work.reading):
            raise ConstructionTwinError(f"the model cannot be read: {work.reason}")
        return work is not None and bool(work.schedule)

    def _is_reading(self) -> bool:
        """Return whether a node reads the model, which takes its time with a large one on a busy machine."""
        return "work/tasks" in self._newest and self._subscribers["work/tasks"].get_num_connections() > 0

    def _is_playing(self) -> bool:
        connected = self._subscribers["execution"].get_num_connections() > 0
        return connected and self._newest["execution"].state == Execution.PLAYING

    def _wait(self, condition: Callable[[], bool], what: str, goes_on: Callable[[], bool] = lambda: False) -> None:
        """Wait, asking after every message; while `goes_on` holds, the time does not run."""
        limit = self._settings.timeout
        deadline = time.monotonic() + limit
        while not condition():
            if goes_on():
                deadline = time.monotonic() + limit
            if time.monotonic() > deadline:
                work, executor = self._newest.get("work/tasks"), self._newest["execution"].reason
                said = work.reason if work is not None else "the work node says nothing"
                waited = f"waited {limit:g} s in vain for {what}"
                raise ConstructionTwinError(f"{waited}; executor: {executor}; work: {said}")
            self._pause()

    def _pause(self) -> None:
        """Wait for the next message."""
        if rospy.is_shutdown():
            raise ConstructionTwinError("interrupted")
        with self._message_arrived:
            self._message_arrived.wait(_POLL)

    def _receive(self, topic: str, message: Any) -> None:
        with self._message_arrived:
            self._newest[topic] = message
            if topic == "work/tasks":
                self._last |= {row.id: row.state for row in message.tasks if row.state in _UNDER_WAY}
            self._message_arrived.notify_all()

    def _print_line(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, highlight=False)


def answer_of(
    inputs: Mapping[str, bool] | None, confirm: Mapping[str, bool], last: str, answers: Collection[str]
) -> str:
    """Return what became of an element by the tool's inputs (None: unknown) and how far its task had come; empty: unknown."""
    if inputs is None:
        return ""
    if confirm and confirm.items() <= inputs.items():
        wanted = "in_grip"
    else:
        # what was carried and is not held any more was lost
        wanted = {"releasing": "placed", "retreating": "placed", "carrying": "gone"}.get(last, "in_stock")
    return wanted if wanted in answers else ""


def checked_parameters(parameters: Parameters = rospy) -> Settings:
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
            file = Builder(checked_parameters(), console).run()
    except ConstructionTwinError as error:
        console.print(f"build: {error}", soft_wrap=True, highlight=False)
        return 1
    console.print(str(file), soft_wrap=True, highlight=False)
    return 0
