"""The command `twin work`: the tasks of a building model from a terminal. Its options are in `views.arguments`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from functools import partial

from geometry_msgs.msg import PoseStamped

from construction_twin.core.errors import RequestRefused
from construction_twin.core.reports import TaskReport, WorkReport
from construction_twin.extensions.work.building import labels, with_names
from construction_twin.link.requests import GoalRequest
from construction_twin.msg import WorkTasks
from construction_twin.ros.messages.convert import pose_to_msg
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.robot_client import OperatorClient
from construction_twin.srv import WorkDecide
from construction_twin.views.arguments import Exit
from construction_twin.views.goals import pose_goal


def find_task(tasks: Sequence[TaskReport], text: str) -> TaskReport:
    """Return the task that a person means by its id, its name, or the beginning of one of them, or raise RequestRefused."""
    low, found = text.lower(), []
    for fits in (
        lambda task: task.id == text,
        lambda task: task.name.lower() == low,
        lambda task: low and (task.id.lower().startswith(low) or task.name.lower().startswith(low)),
    ):
        found = [task for task in tasks if fits(task)]
        if len(found) == 1:
            return found[0]
    if found:
        several = ", ".join([*(task.name or task.id for task in found[:5]), *(["..."] if len(found) > 5 else [])])
        raise RequestRefused(f"{text!r} fits {len(found)} tasks: {several}; give more of it")
    raise RequestRefused(f"no task has the id or name {text!r}; `twin work list` shows them")


def list_lines(work: WorkReport) -> list[str]:
    """Return the tasks in their order, after two lines about the whole; the notes behind them."""
    lines = [f"model      {work.model}, schedule: {work.schedule or 'not read'}", f"work       {work.reason}"]
    names = [task.name for task in work.tasks]
    # the id of what has no name, and beside a name that others have
    called = [
        task.name if names.count(task.name) == 1 and task.name else f"{task.name} {task.id}".strip()
        for task in work.tasks
    ]
    wide = max(map(len, called), default=0)
    for number, (task, name) in enumerate(zip(work.tasks, called, strict=True), start=1):
        mark = ">" if task.id == work.next else " "
        far = f"  {task.deviation_mm:.2f} mm {task.deviation_deg:.3f} deg" if math.isfinite(task.deviation_mm) else ""
        lines.append(f"{mark}{number:4} {name:{wide}} {task.state:10}{far}".rstrip())
        if task.question:
            lines.append(f"        {task.question}; answers: {', '.join(task.answers)}")
    return [*lines, *note_lines(work)]


def note_lines(work: WorkReport) -> list[str]:
    """Return what a person should know of model, schedule and ledger."""
    return [f"note       {note}" for note in work.notes]


def show_lines(work: WorkReport, task: TaskReport) -> list[str]:
    """Return all that is known of one task."""
    names = {each.id: each.name for each in work.tasks}
    lines = [
        f"task       {task.name} ({task.id})",
        f"element    {task.element_name} ({task.element})",
        f"state      {task.state}{f': {task.reason}' if task.reason else ''}",
        f"after      {', '.join(names.get(one) or one for one in task.after) or 'nothing'}",
        f"robot      {task.robot or 'any'}",
    ]
    if task.plan_id:
        lines.append(f"plan       {task.plan_id}")
    if math.isfinite(task.deviation_mm):
        lines.append(f"deviation  {task.deviation_mm:.3f} mm, {task.deviation_deg:.4f} deg from the model")
    if task.question:
        lines += [f"question   {task.question}", f"answers    {', '.join(task.answers)}"]
    return lines


_DECISIONS = {"skip": "skip", "redo": "redo", "answer": "answer", "removed": "removed", "accept": "accept_schedule"}


class WorkCommand:
    """One step of `twin work`; `account`: the user's name, for the record."""

    def __init__(self, options: argparse.Namespace, account: str, client: OperatorClient):
        self._options, self._account, self._client = options, account, client

    def run(self) -> Exit:
        """Do it, or raise RequestRefused with the work node's sentence."""
        step = self._options.step
        if step in _DECISIONS:
            self._decide(step)
        else:
            getattr(self, f"_{step}")()
        return Exit.DONE

    def plan_under_review(self) -> tuple[str, Callable[[str], str]]:
        """Return the id of the plan of a task that waits for approval, and what puts names of elements in place of ids."""
        work = self._read_work()
        found = next((task.plan_id for task in work.tasks if task.state == "planned" and task.plan_id), "")
        if not found:
            raise RequestRefused(f"no task's plan waits: {work.reason}; `twin work next`; a way back: `twin approve`")
        known = labels({task.element: task.element_name for task in work.tasks})
        return found, partial(with_names, known=known)

    def _list(self) -> None:
        print("\n".join(list_lines(self._read_work())))

    def _next(self) -> None:
        task = find_task(self._read_work().tasks, self._options.task).id if self._options.task else ""
        print(self._client.plan(GoalRequest("work_task", task=task)).message)

    def _show(self) -> None:
        work = self._read_work()
        print("\n".join(show_lines(work, find_task(work.tasks, self._options.task))))

    def _decide(self, step: str) -> None:
        work, task = self._read_work(), ""
        if step == "accept":
            # what was left out or understood in some way is known before it is accepted
            print("\n".join(note_lines(work) or ["no notes on model and schedule"]))
        else:
            # of an element with a task of its own name that one is meant which asks
            asking = [each for each in work.tasks if each.question] if step == "answer" else []
            task = find_task(asking or work.tasks, self._options.task).id
        answer = self._options.answer if step == "answer" else ""
        self._call_decide(task=task, decision=_DECISIONS[step], answer=answer)

    def _measured(self) -> None:
        pose = PoseStamped(pose=pose_to_msg(pose_goal(self._options.pose, self._options.frame)))
        pose.header.frame_id = self._options.frame
        self._call_decide(task=self._options.element, decision="measured", pose=pose)

    def _call_decide(self, **fields: object) -> None:
        person = self._options.person or self._account
        print(self._client.ask("work/decide", WorkDecide, **fields, person=person, reason=self._options.reason).message)

    def _read_work(self) -> WorkReport:
        to_do = "start bringup with work_model and work_cell, or see why the node is down"
        message = self._client.latched("work/tasks", WorkTasks, "the work node does not report", to_do)
        return from_msg(WorkReport, message)
