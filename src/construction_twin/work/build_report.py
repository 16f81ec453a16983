"""What a building session came to: a table, pictures of what stands, a page, and a file of figures. Lengths in m, angles in rad."""

from __future__ import annotations

import html
import json
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from construction_twin.scene.objects import Scene
from construction_twin.work.pieces import Pieces

#: Colours of what stands: built by the arm, in stock, the rest.
_BUILT, _STOCK, _OTHER = "#3f9d55", "#d8b365", "#c8c8c8"
_STYLE = (
    "body{font-family:sans-serif;margin:2em;max-width:70em}table{border-collapse:collapse}"
    "td,th{padding:.25em .8em;border-bottom:1px solid #ddd;text-align:left}img{max-width:100%}"
)


@dataclass(frozen=True)
class TaskResult:
    """One task of the session.

    Attributes
    ----------
    name, element, state : str
    planning, motion : float
        Times [s], of the plan that was carried out.
    plans : int
        How many plans it took.
    deviation_mm, deviation_deg : float
        NaN: not placed.
    """

    name: str
    element: str
    state: str
    planning: float
    motion: float
    plans: int
    deviation_mm: float
    deviation_deg: float


def summary(results: Sequence[TaskResult], held: int) -> dict:
    """Return the figures of ``work.json``.

    Parameters
    ----------
    results : sequence of TaskResult
    held : int
        Plans that were stopped, held or dropped under way.
    """
    placed = [one for one in results if math.isfinite(one.deviation_mm)]
    times = [one.planning for one in results if one.plans]
    return {
        "tasks": len(results),
        "done": sum(one.state == "done" for one in results),
        "held": held,
        "replanned": sum(max(0, one.plans - 1) for one in results),
        "deviation_mm": {"max": max((one.deviation_mm for one in placed), default=None)},
        "deviation_deg": {"max": max((one.deviation_deg for one in placed), default=None)},
        "planning_s": {"median": statistics.median(times) if times else None},
    }


def write_report(folder: Path, title: str, results: Sequence[TaskResult], held: int, scene: Scene) -> tuple[Path, ...]:
    """Write ``work.json``, ``as_built.png`` and ``report.html``; return their paths.

    Parameters
    ----------
    folder : Path
    title : str
    results : sequence of TaskResult
    held : int
    scene : Scene
        What stands now.

    Raises
    ------
    OSError
    """
    figures = folder / "work.json"
    figures.write_text(json.dumps(summary(results, held), indent=2) + "\n", encoding="utf-8")
    picture = folder / "as_built.png"
    built = {one.element: one.name for one in results if one.state == "done"}
    draw(scene, built, title).savefig(picture, dpi=110)
    page = folder / "report.html"
    page.write_text(_page(title, results, held, picture.name), encoding="utf-8")
    return figures, picture, page


def draw(scene: Scene, built: Mapping[str, str], title: str) -> Figure:
    """Return a picture of the elements, from above and from the side; those that were built in green, those in stock in yellow.

    Parameters
    ----------
    scene : Scene
    built : mapping of str to str
        Names of the elements that stand at their places, by GlobalId.
    title : str
    """
    figure = Figure(figsize=(13.0, 6.5))
    corners = []
    slanted = figure.add_subplot(1, 2, 1, projection="3d")
    above = figure.add_subplot(1, 2, 2)
    order = sorted(scene.objects, key=lambda item: item.position[2])
    for item in order:
        element = item.name.split("/", 1)[0]
        if "/" not in item.name or item.link:
            continue
        colour = _BUILT if element in built else _STOCK
        for triangles in _triangles(item):
            slanted.add_collection3d(Poly3DCollection(triangles, facecolors=colour, shade=True))
            corners.append(triangles.reshape(-1, 3))
            low, high = corners[-1].min(axis=0), corners[-1].max(axis=0)
            above.add_patch(
                matplotlib.patches.Rectangle(
                    low[:2], *(high - low)[:2], facecolor=colour, edgecolor="#333333", linewidth=0.6, alpha=0.8
                )
            )
        if element in built and item.name.endswith("/0"):
            middle = corners[-1].mean(axis=0)
            wide, deep = np.ptp(corners[-1], axis=0)[:2]
            turn = 0 if wide >= deep else 90
            above.annotate(built[element], middle[:2], fontsize=6, ha="center", va="center", rotation=turn)
    if corners:
        points = np.concatenate(corners)
        low, high = points.min(axis=0), points.max(axis=0)
        slanted.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        slanted.set_box_aspect(np.maximum(high - low, 0.1))
        slanted.set_zticks(np.round(np.linspace(low[2], high[2], 2), 2))
        above.set(xlim=(low[0] - 0.1, high[0] + 0.1), ylim=(low[1] - 0.1, high[1] + 0.1))
    slanted.view_init(elev=35.0, azim=-60.0)
    above.set_aspect("equal")
    for axes in (slanted, above):
        axes.set(xlabel="x [m]", ylabel="y [m]")
    figure.suptitle(f"{title}: as built (green), in stock (yellow)")
    figure.tight_layout()
    return figure


def _triangles(item) -> list[np.ndarray]:
    """Return the triangles of a convex body where it stands, shape (m, 3, 3) each."""
    from scipy.spatial import ConvexHull

    points = Pieces([item]).points
    return [points[ConvexHull(points).simplices]]


def rows(results: Sequence[TaskResult]) -> list[tuple[str, ...]]:
    """Return the table in words: name, state, plans, planning, motion, deviation in mm and in deg."""
    return [
        (
            one.name,
            one.state,
            str(one.plans),
            f"{one.planning:.1f} s" if one.plans else "",
            f"{one.motion:.1f} s" if one.plans else "",
            _number(one.deviation_mm, 3),
            _number(one.deviation_deg, 4),
        )
        for one in results
    ]


#: Heads of that table.
HEADS = ("task", "state", "plans", "planning", "motion", "deviation mm", "deviation deg")


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else ""


def _page(title: str, results: Sequence[TaskResult], held: int, picture: str) -> str:
    head = "".join(f"<th>{html.escape(word)}</th>" for word in HEADS)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows(results))
    figures = html.escape(json.dumps(summary(results, held), indent=2))
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title><style>{_STYLE}</style>"
        f"<h1>{html.escape(title)}</h1><p>Mock arm: deviations are of its own measured pose when it let go, from the model.</p>"
        f"<img src={picture} alt='as built'><table><tr>{head}</tr>{body}</table><pre>{figures}</pre></html>\n"
    )
