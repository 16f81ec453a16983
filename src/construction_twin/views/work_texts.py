"""Texts about work from a building model: its tasks as a list, and one of them. Deviations in mm and deg."""

from __future__ import annotations

import math
from collections.abc import Sequence

from construction_twin.core.errors import RequestRefused
from construction_twin.core.reports import TaskReport, WorkReport


def chosen(tasks: Sequence[TaskReport], text: str) -> TaskReport:
    """Return the task that a person means by its id, its name, or the beginning of one of them.

    Raises:
        RequestRefused: When none fits, or several do.
    """
    for exact in (lambda task: task.id == text, lambda task: task.name.lower() == text.lower()):
        found = [task for task in tasks if exact(task)]
        if len(found) == 1:
            return found[0]
    low = text.lower()
    found = [task for task in tasks if low and (task.id.lower().startswith(low) or task.name.lower().startswith(low))]
    if len(found) == 1:
        return found[0]
    if found:
        several = ", ".join(task.name or task.id for task in found[:5])
        raise RequestRefused(
            f"{text!r} fits {len(found)} tasks: {several}{', ...' if len(found) > 5 else ''}; give more of it"
        )
    raise RequestRefused(f"no task has the id or name {text!r}; `twin work list` shows them")


def list_lines(work: WorkReport) -> list[str]:
    """Return the tasks in their order, after two lines about the whole; the notes behind them."""
    lines = [f"model      {work.model}, schedule: {work.schedule or 'not read'}", f"work       {work.reason}"]
    wide = max((len(task.name) for task in work.tasks), default=0)
    for number, task in enumerate(work.tasks, start=1):
        mark = ">" if task.id == work.next else " "
        far = f"  {task.deviation_mm:.2f} mm {task.deviation_deg:.3f} deg" if math.isfinite(task.deviation_mm) else ""
        lines.append(f"{mark}{number:4} {task.id} {task.name:{wide}} {task.state:10}{far}".rstrip())
        if task.question:
            lines.append(f"        {task.question} Answers: {', '.join(task.answers)}")
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
