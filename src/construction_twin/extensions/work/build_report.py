"""What a building session came to: a table, a picture of what stands, and a file of figures. Lengths in m, angles in rad."""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from construction_twin.core.reports import TaskReport
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.work.convex_bodies import Pieces
from construction_twin.scene.objects import Scene

#: Decimals of deviations: the wire has no more, and what a computer rounds is none.
_MM, _DEG = 3, 4
#: Colours of what stands: built by the arm, in stock.
_BUILT, _STOCK = "#3f9d55", "#d8b365"


@dataclass(frozen=True)
class Decision:
    """What a person, or a command in a person's place, decided.

    Attributes:
        time: Since 1970 [s].
        what: A sentence: which plan was approved, with its hash; which question was answered, and how.
    """

    time: float
    person: str
    what: str


@dataclass(frozen=True)
class TaskResult:
    """One task of the session.

    Attributes:
        planning, motion: Times [s], of the plan that was carried out.
        plans: How many plans it took.
        approved_by: Who approved them, each once.
    """

    task: TaskReport
    planning: float = 0.0
    motion: float = 0.0
    plans: int = 0
    approved_by: tuple[str, ...] = ()

    @property
    def passed(self) -> bool | None:
        """Whether it stands within tolerance; None: it is not placed, or where was not measured."""
        task = self.task
        if not (math.isfinite(task.deviation_mm) and math.isfinite(task.deviation_deg)):
            return None
        return task.deviation_mm <= task.tolerance_mm and task.deviation_deg <= task.tolerance_deg

    @property
    def took(self) -> float:
        """Time from the beginning of the task to its end [s]; NaN: one of them is not known."""
        begun, settled = self.task.begun, self.task.settled
        return (settled - begun) / NANOSECONDS if 0 < begun <= settled else math.nan


def summary(results: Sequence[TaskResult], held: int, decisions: Sequence[Decision] = ()) -> dict:
    """Return the figures of ``work.json``; `held`: plans that were stopped, held or dropped under way."""
    tasks = [one.task for one in results]
    times = [one.planning for one in results if one.plans]
    passed = [one.passed for one in results if one.passed is not None]
    # several tasks can be done on one element
    masses = {task.element: task.mass_kg for task in tasks if task.state == "done" and math.isfinite(task.mass_kg)}
    built = _built(results)
    return {
        "tasks": len(results),
        "done": len(built),
        "held": held,
        "replanned": sum(max(0, one.plans - 1) for one in results),
        "deviation_mm": {"max": _largest([task.deviation_mm for task in tasks], _MM)},
        "deviation_deg": {"max": _largest([task.deviation_deg for task in tasks], _DEG)},
        "within_tolerance": {"passed": sum(passed), "not_passed": len(passed) - sum(passed)},
        "placed_kg": _decimals(sum(masses.values()), 3),
        "planning_s": {"median": _decimals(statistics.median(times), 3) if times else None},
        "order": [one.task.element for one in built],
        "as_scheduled": [one for one in results if one in built] == built,
        "elements": [_figures(one, built) for one in results],
        "decisions": [{"time": _moment(one.time), "person": one.person, "what": one.what} for one in decisions],
    }


def _built(results: Sequence[TaskResult]) -> list[TaskResult]:
    """Return the tasks that are done, in the order in which they were."""
    return sorted((one for one in results if one.task.state == "done"), key=lambda one: one.task.settled)


def _figures(one: TaskResult, built: Sequence[TaskResult]) -> dict:
    """Return what ``work.json`` says of one element."""
    task = one.task
    return {
        "element": task.element,
        "name": task.element_name,
        "state": task.state,
        "order": built.index(one) + 1 if one in built else None,
        "mass_kg": _decimals(task.mass_kg, 3),
        "grip": task.grip,
        "plans": one.plans,
        "approved_by": list(one.approved_by),
        "deviation_mm": _decimals(task.deviation_mm, _MM),
        "deviation_deg": _decimals(task.deviation_deg, _DEG),
        "within_tolerance": one.passed,
        "scheduled_start": task.scheduled_start or None,
        "scheduled_s": _decimals(task.scheduled_duration, 1),
        "begun": _moment(task.begun / NANOSECONDS) or None,
        "settled": _moment(task.settled / NANOSECONDS) or None,
        "took_s": _decimals(one.took, 1),
    }


def _decimals(value: float, decimals: int) -> float | None:
    """Return a figure with no more digits than it means; None for NaN."""
    return round(value, decimals) + 0.0 if math.isfinite(value) else None


def _largest(values: Sequence[float], decimals: int) -> float | None:
    return _decimals(max(filter(math.isfinite, values), default=math.nan), decimals)


def _moment(since_1970: float) -> str:
    """Return a time as ISO 8601, local and with its offset; empty for 0."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(since_1970)) if since_1970 else ""


def write_report(
    folder: Path, title: str, results: Sequence[TaskResult], held: int, scene: Scene, decisions: Sequence[Decision] = ()
) -> tuple[Path, ...]:
    """Write ``work.json`` and ``as_built.png``; return their paths."""
    figures, picture = folder / "work.json", folder / "as_built.png"
    contents = summary(results, held, decisions)
    figures.write_text(json.dumps(contents, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    built = {one.task.element: one.task.element_name for one in _built(results)}
    drawn = draw(scene, built, title)
    FigureCanvasAgg(drawn)
    drawn.savefig(picture, dpi=110)
    return figures, picture


def draw(scene: Scene, built: Mapping[str, str], title: str) -> Figure:
    """Return a picture of the elements from above: those that were built in green, in stock in yellow."""
    figure = Figure(figsize=(7.0, 6.5))
    above = figure.add_subplot()
    corners = []
    # the lowest first
    for item in sorted(scene.objects, key=lambda item: item.position[2]):
        element = item.name.split("/", 1)[0]
        if element == item.name or item.link:
            continue
        points = Pieces([item]).points
        corners.append(points)
        low, high = points.min(axis=0), points.max(axis=0)
        colour = _BUILT if element in built else _STOCK
        above.add_patch(
            Rectangle(low[:2], *(high - low)[:2], facecolor=colour, edgecolor="#333333", linewidth=0.6, alpha=0.8)
        )
        if element in built and item.name.endswith("/0"):
            middle, (wide, deep) = points.mean(axis=0), (high - low)[:2]
            turn = 0 if wide >= deep else 90
            above.annotate(built[element], middle[:2], fontsize=6, ha="center", va="center", rotation=turn)
    if corners:
        points = np.concatenate(corners)
        low, high = points.min(axis=0), points.max(axis=0)
        above.set(xlim=(low[0] - 0.1, high[0] + 0.1), ylim=(low[1] - 0.1, high[1] + 0.1))
    above.set_aspect("equal")
    above.set(xlabel="x [m]", ylabel="y [m]")
    figure.suptitle(f"{title}: as built (green), in stock (yellow)")
    figure.tight_layout()
    return figure


def rows(results: Sequence[TaskResult]) -> list[tuple[str, ...]]:
    """Return the table in words, a row for each task in the order of the schedule; see `HEADS`."""
    built = _built(results)
    return [
        (
            str(built.index(one) + 1) if one in built else "",
            one.task.element_name,
            one.task.state,
            _number(one.task.mass_kg, 1, " kg"),
            one.task.grip,
            str(one.plans),
            ", ".join(one.approved_by),
            _number(one.planning, 1, " s") if one.plans else "",
            _number(one.motion, 1, " s") if one.plans else "",
            _number(one.task.deviation_mm, _MM),
            _number(one.task.deviation_deg, _DEG),
            {True: "passed", False: "NOT passed", None: ""}[one.passed],
            f"{one.task.scheduled_start} {_number(one.task.scheduled_duration, 0, ' s')}".strip(),
            _number(one.took, 0, " s"),
        )
        for one in results
    ]


#: Heads of that table. `order` is the order in which the elements were placed; the rows stand in that of the schedule.
HEADS = (
    "order", "task", "state", "mass", "grip", "plans", "approved by", "planning", "motion", "deviation mm", "deviation deg",
    "tolerance", "scheduled", "took",
)  # fmt: skip


def _number(value: float, decimals: int, unit: str = "") -> str:
    return f"{value:.{decimals}f}{unit}" if math.isfinite(value) else ""
