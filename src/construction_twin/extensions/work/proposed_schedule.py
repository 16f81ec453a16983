"""An order of building for a model that has none, from its geometry. It is a proposal: a person must accept it.

What supports an element comes before it: an upward face supports what a downward face closer than `GAP` to it belongs to. Otherwise
from below, then as in the file. Metres, z upwards. Knows no weights, fasteners, props or robot.
"""

from __future__ import annotations

import heapq
import uuid
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter
from typing import Any, TypeVar

import numpy as np

from construction_twin.extensions.work.building import BuildingModel, Element, Sequence, Task
from construction_twin.extensions.work.errors import ScheduleError
from construction_twin.extensions.work.names import first_few
from construction_twin.extensions.work.wholes import workpieces

T = TypeVar("T")
_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_$"
_IDS = uuid.UUID("5b0f6c3e-9d1a-4b52-8a35-6c1f7d2e9b40")
#: How far apart, or inside of each other, two faces may be that touch as built [m].
GAP = 0.006
#: A face whose normal is closer to the horizontal than this sine supports nothing.
_STEEP = 0.1
#: Vertical lines per direction on which the faces of two elements are compared.
_LINES = 15


def global_id(*words: str) -> str:
    """Return an IFC GlobalId, 22 characters, that follows from words."""
    number = uuid.uuid5(_IDS, "|".join(words)).int
    return "".join(_DIGITS[number >> shift & 63] for shift in range(126, -1, -6))


def propose(model: BuildingModel) -> BuildingModel:
    """Return the model with a task for each element, in an order in which they can be built, and one that nests them all."""
    solids = [_Solid(model.elements[identifier]) for identifier in workpieces(model)]
    if not solids:
        raise ScheduleError(f"{model.file}: it has no workpiece with geometry; an order cannot be proposed")
    before: dict[int, set[int]] = {number: set() for number in range(len(solids))}
    for i, j in _near(solids):
        for lower, upper in ((i, j), (j, i)):
            if _rests_on(solids[upper], solids[lower]):
                before[upper].add(lower)
    try:
        order = in_order(before, lambda number: solids[number].key())
    except CycleError as error:
        circle = first_few(solids[number].element.id for number in error.args[1][1:])
        raise ScheduleError(f"{circle} rest on each other in a circle; an order cannot be proposed") from error
    root = Task(global_id("proposed schedule", model.project), "Proposed order")
    tasks = {}
    for number in order:
        element = solids[number].element
        own = global_id("proposed task", element.id)
        tasks[number] = Task(own, f"Place {element.name or element.id}", parent=root.id, products=(element.id,))
    sequences = [
        Sequence(tasks[first].id, tasks[second].id)
        for second in order
        for first in sorted(before[second], key=order.index)
    ]
    return replace(model, tasks={task.id: task for task in (root, *tasks.values())}, sequences=tuple(sequences))


class _Solid:
    """Faces of one element in the model's frame."""

    def __init__(self, element: Element):
        self.element = element
        pose, (self.low, self.high) = element.model_T_element, element.box
        corners = [body.vertices[body.triangles] for body in element.bodies]
        triangles = np.concatenate(corners) @ pose.rotation.T + pose.position
        first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
        normals = np.cross(first, second)
        size = np.linalg.norm(normals, axis=1)
        slope = np.divide(normals[:, 2], size, out=np.zeros(len(size)), where=size > 0.0)
        self.up, self.down = triangles[slope > _STEEP], triangles[slope < -_STEEP]

    def key(self) -> tuple[float, float]:
        """Lower end in steps of the gap, then the middle's height."""
        return (round(float(self.low[2]) / GAP), round(float(self.low[2] + self.high[2]) / GAP))


def _near(solids: list[_Solid]) -> list[tuple[int, int]]:
    """Return pairs of elements whose boxes are closer than the gap, by a sweep along x."""
    order = sorted(range(len(solids)), key=lambda i: solids[i].low[0])
    pairs: list[tuple[int, int]] = []
    active: list[int] = []
    for i in order:
        low, high = solids[i].low - GAP, solids[i].high + GAP
        active = [j for j in active if solids[j].high[0] >= low[0]]
        pairs += [(i, j) for j in active if np.all(solids[j].low <= high) and np.all(solids[j].high >= low)]
        active.append(i)
    return pairs


def _rests_on(upper: _Solid, lower: _Solid) -> bool:
    """Return whether a downward face of one lies on an upward face of the other."""
    low = np.maximum(upper.low, lower.low)[:2]
    high = np.minimum(upper.high, lower.high)[:2]
    if np.any(high <= low):
        return False
    # lines through the middle of cells, so that none runs along a common edge
    cells = (np.arange(_LINES) + 0.5 + 1e-3 * np.sqrt(2.0)) / _LINES
    x, y = np.meshgrid(low[0] + cells * (high[0] - low[0]), low[1] + cells * (high[1] - low[1]))
    points = np.column_stack((x.ravel(), y.ravel()))
    band = (max(upper.low[2], lower.low[2]) - GAP, min(upper.high[2], lower.high[2]) + GAP)
    tops, bottoms = _heights(lower.up, points, band), _heights(upper.down, points, band)
    for top in tops:
        for bottom in bottoms:
            if np.any(np.abs(bottom - top) <= GAP):  # false where a line misses a face (nan)
                return True
    return False


def _heights(triangles: np.ndarray, points: np.ndarray, band: tuple[float, float]) -> list[np.ndarray]:
    """Return for each face that reaches into a band of heights where vertical lines through points meet it; nan: they do not."""
    z = triangles[:, :, 2]
    found = []
    for a, b, c in triangles[(z.max(axis=1) >= band[0]) & (z.min(axis=1) <= band[1])]:
        ab, ac, ap = b[:2] - a[:2], c[:2] - a[:2], points - a[:2]
        area = ab[0] * ac[1] - ab[1] * ac[0]
        if area == 0.0:
            continue
        u = (ap[:, 0] * ac[1] - ap[:, 1] * ac[0]) / area
        v = (ab[0] * ap[:, 1] - ab[1] * ap[:, 0]) / area
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        if inside.any():
            found.append(np.where(inside, a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]), np.nan))
    return found


def in_order(before: Mapping[T, Collection[T]], key: Callable[[T], Any]) -> list[T]:
    """Return things so that each comes after those before it, otherwise by a key."""
    sorter = TopologicalSorter(before)
    sorter.prepare()
    heap: list[tuple[Any, T]] = []
    order = []
    while sorter.is_active():
        for one in sorter.get_ready():
            heapq.heappush(heap, (key(one), one))
        order.append(heapq.heappop(heap)[1])
        sorter.done(order[-1])
    return order
