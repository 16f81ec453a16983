"""What a building session came to: a table, pictures of what stands, a page, and a file of figures. Lengths in m, angles in rad."""

from __future__ import annotations

import html
import json
import math
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.extras import check_extras
from construction_twin.core.sentences import Sentence
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.work.convex_bodies import Pieces

#: Decimals of deviations: the wire has no more, and what a computer rounds is none.
_MM, _DEG = 3, 4
#: Colours of what stands: built by the arm, in stock; and shades of them, by which elements are told apart.
_BUILT, _STOCK = "#3f9d55", "#d8b365"
_SHADES = (1.0, 0.82, 1.18)
_STYLE = (
    "body{font-family:sans-serif;margin:2em;max-width:70em}table{border-collapse:collapse}"
    "td,th{padding:.25em .8em;border-bottom:1px solid #ddd;text-align:left}img{max-width:100%}"
)


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
        deviation_mm, deviation_deg: NaN: not placed.
        tolerance_mm, tolerance_deg: A deviation beyond one of them is not within tolerance.
        mass: [kg]; NaN: nobody says.
        grip: How it is or was held; empty: not gripped.
        approved_by: Who approved its plans, each once.
        scheduled_start: ISO 8601; empty: the schedule says nothing.
        scheduled_duration: [s]; NaN: the schedule says nothing.
        begun, settled: When it was begun, and done or skipped, since 1970 [s]; 0: not yet.
    """

    name: str
    element: str
    state: str
    planning: float
    motion: float
    plans: int
    deviation_mm: float
    deviation_deg: float
    tolerance_mm: float
    tolerance_deg: float
    mass: float = math.nan
    grip: str = ""
    approved_by: tuple[str, ...] = ()
    scheduled_start: str = ""
    scheduled_duration: float = math.nan
    begun: float = 0.0
    settled: float = 0.0

    @property
    def passed(self) -> bool | None:
        """Whether it stands within tolerance; None: it is not placed, or where was not measured."""
        if not (math.isfinite(self.deviation_mm) and math.isfinite(self.deviation_deg)):
            return None
        return self.deviation_mm <= self.tolerance_mm and self.deviation_deg <= self.tolerance_deg


def summary(results: Sequence[TaskResult], held: int, decisions: Sequence[Decision] = ()) -> dict:
    """Return the figures of ``work.json``.

    Args:
        held: Plans that were stopped, held or dropped under way.
    """
    placed = [one for one in results if math.isfinite(one.deviation_mm)]
    times = [one.planning for one in results if one.plans]
    passed = [one.passed for one in results if one.passed is not None]
    # several tasks can be done on one element
    masses = {one.element: one.mass for one in results if one.state == "done" and math.isfinite(one.mass)}
    built = built_order(results)
    return {
        "tasks": len(results),
        "done": sum(one.state == "done" for one in results),
        "held": held,
        "replanned": sum(max(0, one.plans - 1) for one in results),
        "deviation_mm": {"max": _largest([one.deviation_mm for one in placed], _MM)},
        "deviation_deg": {"max": _largest([one.deviation_deg for one in placed], _DEG)},
        "within_tolerance": {"passed": sum(passed), "not_passed": len(passed) - sum(passed)},
        "placed_kg": _decimals(sum(masses.values()), 3),
        "planning_s": {"median": _decimals(statistics.median(times), 3) if times else None},
        "order": [one.element for one in built],
        "as_scheduled": [one.element for one in results if one in built] == [one.element for one in built],
        "elements": [_figures(one, built) for one in results],
        "decisions": [{"time": _moment(one.time), "person": one.person, "what": one.what} for one in decisions],
    }


def built_order(results: Sequence[TaskResult]) -> list[TaskResult]:
    """Return the tasks that are done, in the order in which they were."""
    return sorted((one for one in results if one.state == "done"), key=lambda one: one.settled)


def _figures(one: TaskResult, built: Sequence[TaskResult]) -> dict:
    """Return what ``work.json`` says of one element."""
    return {
        "element": one.element,
        "name": one.name,
        "state": one.state,
        "order": built.index(one) + 1 if one in built else None,
        "mass_kg": _decimals(one.mass, 3),
        "grip": one.grip,
        "plans": one.plans,
        "approved_by": list(one.approved_by),
        "deviation_mm": _decimals(one.deviation_mm, _MM),
        "deviation_deg": _decimals(one.deviation_deg, _DEG),
        "within_tolerance": one.passed,
        "scheduled_start": one.scheduled_start or None,
        "scheduled_s": _decimals(one.scheduled_duration, 1),
        "begun": _moment(one.begun) or None,
        "settled": _moment(one.settled) or None,
        "took_s": _decimals(_took(one), 1),
    }


def _decimals(value: float, decimals: int) -> float | None:
    """Return a figure with no more digits than it means; None for NaN."""
    return round(value, decimals) + 0.0 if math.isfinite(value) else None


def _largest(values: Sequence[float], decimals: int) -> float | None:
    return _decimals(max(values, default=math.nan), decimals)


def _took(one: TaskResult) -> float:
    """Return the time from the beginning of a task to its end [s]; NaN: one of them is not known."""
    return one.settled - one.begun if 0.0 < one.begun <= one.settled else math.nan


def _moment(since_1970: float) -> str:
    """Return a time as ISO 8601, local and with its offset; empty for 0."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(since_1970)) if since_1970 else ""


def write_report(
    folder: Path,
    title: str,
    results: Sequence[TaskResult],
    held: int,
    scene: Scene,
    decisions: Sequence[Decision] = (),
) -> tuple[Path, ...]:
    """Write ``work.json``, ``as_built.png`` and ``report.html``; return their paths.

    Where no picture in space can be drawn, a sentence of the page says why.

    Raises OSError.
    """
    figures = folder / "work.json"
    contents = summary(results, held, decisions)
    figures.write_text(json.dumps(contents, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    picture = folder / "as_built.png"
    built = {one.element: one.name for one in results if one.state == "done"}
    slanted, without = None, ""
    try:
        slanted = in_space(scene, built)
    except ConstructionTwinError as error:
        without = Sentence("view.build.no_picture", problem=error.sentence)
    draw(scene, built, title, slanted).savefig(picture, dpi=110)
    page = folder / "report.html"
    page.write_text(_page(title, results, held, picture.name, decisions, without), encoding="utf-8")
    return figures, picture, page


def draw(scene: Scene, built: Mapping[str, str], title: str, slanted: np.ndarray | None = None) -> Figure:
    """Return a picture of the elements from above, and beside it one in space; those that were built in green, in stock in yellow.

    Args:
        slanted: Of `in_space`, 8 bits; None: there is none.
    """
    figure = Figure(figsize=(13.0, 6.5) if slanted is not None else (7.0, 6.5))
    above = figure.add_subplot(1, 1 if slanted is None else 2, 1 if slanted is None else 2)
    if slanted is not None:
        beside = figure.add_subplot(1, 2, 1)
        beside.imshow(slanted, interpolation="lanczos")
        beside.set_axis_off()
    corners = []
    for item, points, colour in _drawn(scene, built):
        element = _element(item)
        corners.append(points)
        low, high = points.min(axis=0), points.max(axis=0)
        above.add_patch(
            matplotlib.patches.Rectangle(
                low[:2], *(high - low)[:2], facecolor=colour, edgecolor="#333333", linewidth=0.6, alpha=0.8
            )
        )
        if element in built and item.name.endswith("/0"):
            middle = points.mean(axis=0)
            wide, deep = np.ptp(points, axis=0)[:2]
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


def in_space(scene: Scene, built: Mapping[str, str]) -> np.ndarray | None:
    """Return a picture of the elements in space, drawn as films of rehearsals are; None: there is no element.

    Neighbours have different shades, and every edge is drawn.

    Raises:
        ConstructionTwinError: If the set-up's group ``physics`` is missing, or nothing draws here: one sentence.
    """
    check_extras("physics")
    from construction_twin.physics.still import StandingBody, still

    drawn = _drawn(scene, built)
    shades = {
        element: _SHADES[k % len(_SHADES)] for k, element in enumerate(sorted({_element(i) for i, _, _ in drawn}))
    }
    bodies = []
    for item, points, colour in drawn:
        red, green, blue = (min(1.0, shades[_element(item)] * value) for value in matplotlib.colors.to_rgb(colour))
        bodies.append(StandingBody(points, (red, green, blue)))
    return still(bodies) if bodies else None


def _drawn(scene: Scene, built: Mapping[str, str]) -> list[tuple[SceneObject, np.ndarray, str]]:
    """Return the bodies of elements, the lowest first: each with its corners, shape (n, 3), and its colour."""
    return [
        (item, Pieces([item]).points, _BUILT if _element(item) in built else _STOCK)
        for item in sorted(scene.objects, key=lambda item: item.position[2])
        if "/" in item.name and not item.link
    ]


def _element(item: SceneObject) -> str:
    return item.name.split("/", 1)[0]


def rows(results: Sequence[TaskResult]) -> list[tuple[str, ...]]:
    """Return the table in words, a row for each task in the order of the schedule; see `HEADS`."""
    built = built_order(results)
    return [
        (
            str(built.index(one) + 1) if one in built else "",
            one.name,
            one.state,
            _number(one.mass, 1, " kg"),
            one.grip,
            str(one.plans),
            ", ".join(one.approved_by),
            _number(one.planning, 1, " s") if one.plans else "",
            _number(one.motion, 1, " s") if one.plans else "",
            _number(one.deviation_mm, _MM),
            _number(one.deviation_deg, _DEG),
            {True: "passed", False: "NOT passed", None: ""}[one.passed],
            _scheduled(one),
            _number(_took(one), 0, " s"),
        )
        for one in results
    ]


#: Heads of that table. `order` is the order in which the elements were placed; the rows stand in that of the schedule.
HEADS = (
    "order", "task", "state", "mass", "grip", "plans", "approved by", "planning", "motion", "deviation mm", "deviation deg",
    "tolerance", "scheduled", "took",
)  # fmt: skip


def _scheduled(one: TaskResult) -> str:
    return " ".join(filter(None, (one.scheduled_start, _number(one.scheduled_duration, 0, " s"))))


def _number(value: float, decimals: int, unit: str = "") -> str:
    return f"{value:.{decimals}f}{unit}" if math.isfinite(value) else ""


def _table(heads: Sequence[str], cells: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(word)}</th>" for word in heads)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in cells)
    return f"<table><tr>{head}</tr>{body}</table>"


def _against_schedule(results: Sequence[TaskResult]) -> str:
    """Return the sentences that compare what was done with what was planned."""
    built = built_order(results)
    planned = [one for one in results if one in built]
    moved = [one.name for one, other in zip(built, planned) if one is not other]
    order = "in the order of the schedule" if not moved else f"not in the order of the schedule: {', '.join(moved)}"
    told = f"{len(built)} of {len(results)} elements were placed, {order}."
    timed = [one for one in built if math.isfinite(one.scheduled_duration) and math.isfinite(_took(one))]
    if not timed:
        return f"{told} The schedule says no durations."
    asked, taken = sum(one.scheduled_duration for one in timed), sum(map(_took, timed))
    return f"{told} The {len(timed)} of them with a duration were scheduled for {asked:.0f} s and took {taken:.0f} s."


def _tolerance(results: Sequence[TaskResult]) -> str:
    found = [one for one in results if one.passed is not None]
    failed = [one.name for one in found if not one.passed]
    if not found:
        return "No deviation was measured."
    bound = f"{found[0].tolerance_mm:g} mm and {found[0].tolerance_deg:.2g} deg"
    return (
        f"Tolerance {bound}: passed by {len(found) - len(failed)} of {len(found)}"
        + (f", not by {', '.join(failed)}" if failed else "")
        + "."
    )


def _page(
    title: str, results: Sequence[TaskResult], held: int, picture: str, decisions: Sequence[Decision], without: str
) -> str:
    figures = html.escape(json.dumps(summary(results, held), indent=2))
    said = [(_moment(one.time), one.person, one.what) for one in decisions]
    sentences = html.escape(f"{_against_schedule(results)} {_tolerance(results)}")
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title><style>{_STYLE}</style>"
        f"<h1>{html.escape(title)}</h1><p>Mock arm: deviations are of its own measured pose when it let go, from the model.</p>"
        f"<p>{sentences}</p>"
        f"<img src={picture} alt='as built'>{without and f'<p>{html.escape(without)}</p>'}{_table(HEADS, rows(results))}"
        f"<h2>Who decided what</h2>{_table(('time', 'person', 'decision'), said)}<pre>{figures}</pre></html>\n"
    )
