"""Texts about work from a building model: its tasks as a list, and one of them. Deviations in mm and deg."""

from __future__ import annotations

import math
from collections.abc import Sequence

from construction_twin.core.errors import RequestRefused
from construction_twin.core.reports import TaskReport, WorkReport
from construction_twin.core.sentences import Sentence


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
        several = ", ".join([*(task.name or task.id for task in found[:5]), *(["..."] if len(found) > 5 else [])])
        raise RequestRefused(Sentence("view.work.several", text=repr(text), count=len(found), several=several))
    raise RequestRefused(Sentence("view.work.none", text=repr(text)))


def list_lines(work: WorkReport) -> list[str]:
    """Return the tasks in their order, after two lines about the whole; the notes behind them."""
    schedule = work.schedule or Sentence("view.work.not_read")
    model = Sentence("view.work.schedule", model=work.model, schedule=schedule)
    lines = [f"model      {model}", f"work       {work.reason}"]
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
            asked = Sentence("view.work.answers", question=task.question, answers=", ".join(task.answers))
            lines.append(f"        {asked}")
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
        f"after      {', '.join(names.get(one) or one for one in task.after) or Sentence('view.work.nothing')}",
        f"robot      {task.robot or Sentence('view.work.any')}",
    ]
    if task.plan_id:
        lines.append(f"plan       {task.plan_id}")
    if math.isfinite(task.deviation_mm):
        off = Sentence("view.work.deviation", mm=task.deviation_mm, deg=task.deviation_deg)
        lines.append(f"deviation  {off}")
    if task.question:
        lines += [f"question   {task.question}", f"answers    {', '.join(task.answers)}"]
    return lines
