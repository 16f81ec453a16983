"""The findings of a check: rows of a table, JSON, a picture of the cell. Writes no file."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from construction_twin.work.check import CheckedTask
from construction_twin.work.site_scene import Layout

_POSSIBLE, _NOT, _STOCK, _PATH = "#2c8a4b", "#d9541e", "#8a8f98", "#3465a4"
_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def row(task: CheckedTask) -> tuple[str, ...]:
    """Return a task's cells: number, name, possible, grip, track [m], clearance [mm], time [s], at what it fails."""
    return (
        str(task.number + 1),
        task.name,
        "yes" if task.possible else "no",
        task.grip,
        "" if task.track is None else f"{task.track:.2f}",
        "" if task.clearance is None else f"{1e3 * task.clearance:.0f}",
        "" if task.duration is None else f"{task.duration:.1f}",
        "" if task.possible else task.stage or task.reason[:30],
    )


def why(task: CheckedTask) -> str:
    """Return why a task is not possible; empty: it is possible."""
    return f"{task.stage}: {task.reason}" if task.stage else task.reason


def as_json(about: Mapping[str, object], tasks: Sequence[CheckedTask]) -> str:
    """Return the findings as JSON: what they are about, `tasks` and `possible` (how many), and `checked`, one object per task."""
    content = {**about, "tasks": len(tasks), "possible": sum(task.possible for task in tasks)}
    return json.dumps({**content, "checked": [asdict(task) for task in tasks]}, indent=1, allow_nan=False) + "\n"


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
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight")
    return buffer.getvalue()
