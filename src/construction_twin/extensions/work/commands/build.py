"""Builds a model with the mock arm, as a person would who approves every plan: the command behind `make build`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pydantic
import rospy
from rich.console import Console

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RequestRefused
from construction_twin.core.files import check_writable
from construction_twin.core.records import json_value, to_json
from construction_twin.core.reports import WorkReport
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.msg import Execution, Link, Sync, ToolState, WorkTask, WorkTasks
from construction_twin.robot.tool import read_tool
from construction_twin.ros.commands.experiment import point_latest
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.node import ending_on_signals
from construction_twin.ros.shared.params import Parameters, read_parameters
from construction_twin.ros.shared.robot_client import OperatorClient
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import WorkDecide
from construction_twin.validation import StrictModel

#: Who approves, for the record.
PERSON = "make build"
_SETTLED = ("done", "skipped", "held")
_MOST_PLANS = 5
_TOPICS = {"work/tasks": WorkTasks, "execution": Execution, "link": Link, "sync": Sync, "tool": ToolState}


class Settings(StrictModel):
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
        self._settings = settings
        self._print = partial(console.print, soft_wrap=True, highlight=False)
        self._client = OperatorClient(rospy.get_namespace(), settings.timeout, PERSON)
        self._confirm = read_tool(settings.tool).tool.grip.confirm
        self._newest: dict[str, Any] = {topic: kind() for topic, kind in _TOPICS.items()}
        self._subscribers = [
            Subscriber(topic, kind, partial(self._newest.__setitem__, topic), warn_of_refusals(), queue_size=5)
            for topic, kind in _TOPICS.items()
        ]

    def run(self) -> Path:
        """Build, and write the figures, also of a session that a task ended; return their file."""
        self._wait(self._is_ready, "the system to get ready")
        self._wait(self._is_read, "a work node that reads the model")
        if self._work.schedule == "proposed":
            self._decide("accept_schedule")
            self._wait(lambda: self._work.schedule == "accepted", "the schedule to be accepted")
        wanted = [task.id for task in self._work.tasks][: self._settings.most or None]
        failure = ""
        try:
            for number, task in enumerate(wanted, start=1):
                self._finish_task(task, f"{number} of {len(wanted)}: {self._row(task).name}")
        except (ConstructionTwinError, rospy.ROSException, rospy.ServiceException) as error:
            failure = str(error)
        file = self._write(wanted)
        if missing := [self._row(task).name for task in wanted if self._row(task).state != "done"]:
            raise ConstructionTwinError(f"{failure or 'not done: ' + ', '.join(missing)}; see {file}")
        return file

    def _write(self, wanted: list[str]) -> Path:
        tasks = [task for task in from_msg(WorkReport, self._work).tasks if task.id in wanted]
        results = Path(self._settings.results_dir).expanduser()
        directory = results / time.strftime("%Y-%m-%d_%H-%M-%S_build")
        directory.mkdir(parents=True)
        done = sum(task.state == "done" for task in tasks)
        content = {"tasks": len(tasks), "done": done, "elements": [json_value(task) for task in tasks]}
        (directory / "work.json").write_bytes(to_json(content))
        point_latest(results, directory)
        return directory / "work.json"

    def _finish_task(self, task: str, title: str) -> None:
        rests, plans = ("ready", "carried", "asks", *_SETTLED), 0
        while True:
            # what comes before it was done a moment ago, or its plan has ended
            self._wait(lambda: self._row(task).state in rests, f"task {task}")
            row = self._row(task)
            if row.state in _SETTLED:
                far = f", {row.deviation_mm:.3f} mm off" if math.isfinite(row.deviation_mm) else ""
                self._print(f"{title}: {row.state}{far}")
                return
            if row.state == "asks":
                self._answer(row)
            elif plans >= _MOST_PLANS:
                raise ConstructionTwinError(f"{title} is not done after {_MOST_PLANS} plans")
            else:
                plans += 1
                self._wait(self._is_ready, "the system to get ready")
                self._plan_and_play(row, title)

    def _plan_and_play(self, row: WorkTask, title: str) -> None:
        try:
            plan = self._client.plan(GoalRequest("work_task", task=row.id)).fields
        except RequestRefused as error:
            raise ConstructionTwinError(f"{title} cannot be planned: {error}") from error
        plan_id = str(plan["plan_id"])
        verdict = ReviewRequest(plan_id, str(plan["plan_hash"]), "approved", PERSON, "nobody is near a mock arm")
        self._wait(lambda: self._approve(verdict), f"plan {plan_id} to be approved")
        self._wait(lambda: self._is_over(plan_id), f"plan {plan_id} to end")
        execution = self._newest["execution"]
        if execution.outcome != "finished":
            self._print(f"{title}: {execution.outcome}: {execution.reason}")

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
        tool = self._newest["tool"]
        holds = tool.known and self._confirm.items() <= dict(zip(tool.inputs, tool.input_values)).items()
        answer = "in_grip" if holds else "in_stock"
        if not tool.known or answer not in row.answers:
            raise ConstructionTwinError(f"{row.name}: {row.question}: none of {', '.join(row.answers)} is surely true")
        self._print(f"asked: {row.question} Answer: {answer}")
        self._decide("answer", row.id, answer)
        self._wait(lambda: self._row(row.id).state != "asks", f"the answer to task {row.id} to be recorded")

    def _decide(self, decision: str, task: str = "", answer: str = "") -> None:
        fields = {"task": task, "decision": decision, "answer": answer, "person": PERSON, "reason": "a mock arm"}
        self._client.ask("work/decide", WorkDecide, **fields)

    @property
    def _work(self) -> WorkTasks:
        return self._newest["work/tasks"]

    def _row(self, task: str) -> WorkTask:
        return next(one for one in self._work.tasks if one.id == task)

    def _is_ready(self) -> bool:
        link, sync, execution = (self._newest[topic].state for topic in ("link", "sync", "execution"))
        return (link, sync, execution) == (Link.ARMED, Sync.IN_SYNC, Execution.IDLE)

    def _is_over(self, plan_id: str) -> bool:
        now = self._newest["execution"]
        return now.plan_id == plan_id and now.state in (Execution.WAITING, Execution.IDLE) and bool(now.outcome)

    def _is_read(self) -> bool:
        if self._work.model and not (self._work.schedule or self._work.reading):
            raise ConstructionTwinError(f"the model cannot be read: {self._work.reason}")
        return bool(self._work.schedule)

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + self._settings.timeout
        while not condition():
            if time.monotonic() > deadline:
                executor, work = self._newest["execution"].reason, self._work.reason
                waited = f"waited {self._settings.timeout:g} s in vain for {what}"
                raise ConstructionTwinError(f"{waited}; executor: {executor}; work: {work or 'no report'}")
            if rospy.is_shutdown():
                raise ConstructionTwinError("interrupted")
            time.sleep(0.05)


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
