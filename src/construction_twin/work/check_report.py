"""The findings of a check as one HTML page that needs no other file, with pictures, and as JSON.

In: checked tasks and where the elements are. Out: text. Text of the model is escaped. Writes no file.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from html import escape

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from construction_twin.work.check import CheckedTask
from construction_twin.work.site_scene import Layout

_POSSIBLE, _NOT, _STOCK, _PATH = "#2c8a4b", "#d9541e", "#8a8f98", "#3465a4"
_STYLE = """
:root { color-scheme: light dark; --back: #fff; --ink: #1b1d22; }
@media (prefers-color-scheme: dark) { :root { --back: #16181d; --ink: #d9dce3; } img { filter: brightness(.85); } }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem;
  background: var(--back); color: var(--ink); }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #8883; font-variant-numeric: tabular-nums; }
th.text, td.text { text-align: left; } .not td { background: #d9541e33; } img { max-width: 100%; background: white; }
"""
_COLUMNS = (
    "#",
    "task",
    "element",
    "possible",
    "grip",
    "track, m",
    "clearance, mm",
    "time, s",
    "why not, notes",
)


@dataclass(frozen=True)
class Header:
    """What the findings are about.

    Attributes:
        model, digest, cell, robot: File names, the model's SHA-256, the robot's name.
        proposed: The order is a proposal.
        seconds, rss_mb: How long the check took, and its memory.
        notes: Of reading, order and placement.
    """

    model: str
    digest: str
    cell: str
    robot: str
    proposed: bool
    seconds: float
    rss_mb: float
    notes: tuple[str, ...]


def row(task: CheckedTask) -> tuple[str, ...]:
    """Return a task's cells: number, name, element, possible, grip, track, clearance, time, why not."""
    return (
        str(task.number + 1),
        task.name,
        task.element_name or task.element,
        "yes" if task.possible else "no",
        task.grip,
        "" if task.track is None else f"{task.track:.2f}",
        "" if task.clearance is None else f"{1e3 * task.clearance:.0f}",
        "" if task.duration is None else f"{task.duration:.1f}",
        why(task),
    )


def why(task: CheckedTask) -> str:
    """Return why a task is not possible; empty: it is possible."""
    return f"{task.stage}: {task.reason}" if task.stage else task.reason


def short_why(task: CheckedTask) -> str:
    """Return the part of a task that is not possible, or the beginning of the reason; empty: it is possible."""
    return "" if task.possible else task.stage or task.reason[:30]


def as_json(header: Header, tasks: Sequence[CheckedTask]) -> str:
    """Return the findings as JSON: the header, `tasks` (how many), `possible` (how many), and `checked`, one object per task."""
    checked = [asdict(task) for task in tasks]
    content = {**asdict(header), "tasks": len(tasks), "possible": sum(task.possible for task in tasks)}
    return json.dumps({**content, "checked": checked}, indent=1, allow_nan=False) + "\n"


def page(header: Header, tasks: Sequence[CheckedTask], layout: Layout) -> str:
    """Return the page."""
    possible = sum(task.possible for task in tasks)
    title = f"Check of {header.model}: {possible} of {len(tasks)} tasks are possible"
    motions = sum(task.duration or 0.0 for task in tasks)
    order = "a proposal from the geometry, which a person must accept" if header.proposed else "the model's schedule"
    facts = (
        f"Robot {header.robot}, cell {header.cell}. Order: {order}. Motions of the possible tasks: {motions / 60.0:.1f} min, "
        f"without waiting for the tool. Each task was planned from the home pose, with everything before it in place as designed. "
        f"Checked in {header.seconds:.0f} s with {header.rss_mb:.0f} MB. SHA-256 of the model: {header.digest[:16]}."
    )
    sections = [f"<h1>{escape(title)}</h1>", f"<p>{escape(facts)}</p>"]
    if header.notes:
        sections.append("<ul>" + "".join(f"<li>{escape(note)}</li>" for note in header.notes) + "</ul>")
    sections += [
        _table(tasks),
        _image(model_picture(tasks, layout), "The model as built, green: possible, grey: stands already"),
    ]
    sections += [
        _image(cell_picture(tasks, layout), "The cell from above"),
        _image(time_picture(tasks), "Time of each task"),
    ]
    body = "\n".join(sections)
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{_STYLE}</style>'
    return f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def _table(tasks: Iterable[CheckedTask]) -> str:
    words = {1, 2, 4, 8}

    def cells(values: Sequence[str], tag: str) -> str:
        kinds = (' class="text"' if i in words else "" for i in range(len(values)))
        return "".join(f"<{tag}{kind}>{escape(value)}</{tag}>" for value, kind in zip(values, kinds, strict=True))

    def told(task: CheckedTask) -> tuple[str, ...]:
        *figures, reason = row(task)
        return *figures, ". ".join([*filter(None, [reason]), *(f"Note: {remark}" for remark in task.remarks)])

    rows = "".join(f"<tr{'' if task.possible else ' class=not'}>{cells(told(task), 'td')}</tr>" for task in tasks)
    return f"<h2>Tasks</h2><table><tr>{cells(_COLUMNS, 'th')}</tr>{rows}</table>"


def _image(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode()
    return f'<h2>{escape(caption)}</h2><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'


def model_picture(tasks: Sequence[CheckedTask], layout: Layout) -> bytes:
    """Return a PNG of the elements where they will stand, coloured by what was found; grey: what stands already."""
    figure = Figure(figsize=(9, 6), dpi=100)
    axes = figure.add_subplot(projection="3d")
    points = []
    for task in tasks:
        triangles = _triangles(layout, task.element)
        if triangles is None:
            continue
        colour = _POSSIBLE if task.possible else _NOT
        axes.add_collection3d(
            Poly3DCollection(triangles, facecolor=colour, edgecolor="#0003", linewidth=0.2, alpha=0.7)
        )
        points.append(triangles.reshape(-1, 3))
    made = {task.element for task in tasks}
    for identifier in dict.fromkeys(item.name.rpartition("/")[0] for item in layout.standing):
        triangles = _triangles(layout, identifier)
        if triangles is not None and identifier not in made:
            axes.add_collection3d(
                Poly3DCollection(triangles, facecolor=_STOCK, edgecolor="#0003", linewidth=0.2, alpha=0.3)
            )
    _limits(axes, points)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_zlabel("z, m")
    return _png(figure)


def _limits(axes, points: list[np.ndarray]) -> None:
    if not points:
        return
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    size = np.maximum(high - low, 0.1)
    axes.set_xlim(low[0], low[0] + size[0])
    axes.set_ylim(low[1], low[1] + size[1])
    axes.set_zlim(low[2], low[2] + size[2])
    axes.set_box_aspect(tuple(size))


def cell_picture(tasks: Sequence[CheckedTask], layout: Layout) -> bytes:
    """Return a PNG of the cell from above: base, stock, places, and the tool's paths."""
    figure = Figure(figsize=(9, 7), dpi=100)
    axes = figure.add_subplot()
    for item in layout.site.scene.objects:
        if item.shape == "box" and max(item.size[:2]) < 8.0:
            corners = np.array([(sx * item.size[0], sy * item.size[1], 0.0) for sx, sy in _SQUARE]) / 2.0
            seen = corners @ item.pose.rotation.T + item.pose.position
            axes.fill(seen[:, 0], seen[:, 1], facecolor="#0001", edgecolor="#0004")
            axes.annotate(item.name, (item.position[0], item.position[1]), color="#0008", ha="center")
    for task in tasks:
        if task.element not in layout.order:
            continue
        colour = _POSSIBLE if task.possible else _NOT
        slot, goal = layout.slot(task.element), layout.base_T_goal(task.element)
        if slot is not None:
            axes.plot(*slot.base_T_element.position[:2], ".", color=_STOCK)
        axes.plot(*goal.position[:2], ".", color=colour)
        if task.path:
            path = np.array(task.path)
            axes.plot(path[:, 0], path[:, 1], color=_PATH, linewidth=0.4, alpha=0.5)
    axes.plot(0.0, 0.0, "k^")
    axes.annotate(" base", (0.0, 0.0))
    axes.set_aspect("equal")
    axes.set_xlabel("x in the base, m")
    axes.set_ylabel("y in the base, m")
    axes.set_title("grey: stock, green: can be placed, red: cannot, blue: paths of the tool")
    return _png(figure)


_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def time_picture(tasks: Sequence[CheckedTask]) -> bytes:
    """Return a PNG of the time that each task's motions take."""
    figure = Figure(figsize=(9, 3), dpi=100)
    axes = figure.add_subplot()
    axes.bar([task.number + 1 for task in tasks], [task.duration or 0.0 for task in tasks], color=_POSSIBLE)
    for task in tasks:
        if not task.possible:
            axes.plot(task.number + 1, 0.0, "x", color=_NOT)
    axes.set_xlabel("task")
    axes.set_ylabel("motions, s")
    return _png(figure)


def _triangles(layout: Layout, identifier: str) -> np.ndarray | None:
    """Return the triangles of an element in the base, shape (m, 3, 3)."""
    element = layout.building.element(identifier)
    if not element.bodies:
        return None
    pose = layout.base_T_goal(identifier)
    return np.concatenate(
        [(body.vertices @ pose.rotation.T + pose.position)[body.triangles] for body in element.bodies]
    )


def _png(figure: Figure) -> bytes:
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight")
    return buffer.getvalue()
