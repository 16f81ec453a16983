"""Shortens a path of straight edges by shortcuts between points on it, the one that gains most first.

Joint vectors are in the order of `RobotModel.joint_names`, [rad] or [m]; a length is the Euclidean one over all joints. Nothing is
drawn by chance, and it ends when nothing is gained any more, not after a time: the result is the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Distance of the points between which shortcuts are tried: shorter costs more checks and gains little.
SPACING = 0.7
#: A shortcut that gains less than this part of the path's length is not tried.
WORTHWHILE = 0.01


def shortened(path: np.ndarray, free: Callable[[np.ndarray, np.ndarray], bool]) -> np.ndarray:
    """Return a path from the same start to the same goal that is no longer.

    Args:
        path: Shape (m, n). m >= 2; successive points differ, and the edges between them are free.
        free: Whether the straight edge from one point to another is free.

    Returns:
        Shape (k, n). At least two points, both ends to the last bit; every edge is a part of a given one or was found free.
    """
    points = _divided(path)
    blocked: set[tuple[bytes, bytes]] = set()
    while True:
        gains = _gains(points)
        least = WORTHWHILE * float(np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        keys = [point.tobytes() for point in points]
        for index in np.argsort(-gains, axis=None, kind="stable").tolist():
            first, last = divmod(index, len(points))
            if gains[first, last] < least:
                return _fewer(_corners(points), free)
            pair = keys[first], keys[last]
            if pair in blocked:
                continue
            if free(points[first], points[last]):
                points = np.concatenate((points[:first], _divided(points[[first, last]]), points[last + 1 :]))
                break
            blocked.add(pair)
        else:
            return _fewer(_corners(points), free)


def _fewer(points: np.ndarray, free: Callable[[np.ndarray, np.ndarray], bool]) -> np.ndarray:
    """Return the path without the corners that need not be: each one slows the motion, however little it makes it longer."""
    index = 1
    while index < len(points) - 1:
        if free(points[index - 1], points[index + 1]):
            points = np.delete(points, index, axis=0)
            index = max(1, index - 1)
        else:
            index += 1
    return points


def _gains(points: np.ndarray) -> np.ndarray:
    """Return by how much the straight edge between each two points is shorter than the path, shape (m, m)."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    return along - along[:, None] - np.linalg.norm(points[:, None] - points, axis=2)


def _divided(path: np.ndarray) -> np.ndarray:
    """Return the path with points in between, at most `SPACING` apart."""
    counts = np.ceil(np.linalg.norm(np.diff(path, axis=0), axis=1) / SPACING).astype(int)
    pieces = [a + (np.arange(count) / count)[:, None] * (b - a) for a, b, count in zip(path[:-1], path[1:], counts)]
    return np.concatenate([*pieces, path[-1:]])


def _corners(points: np.ndarray) -> np.ndarray:
    """Return the path without the points between two others that lie on the straight line between them."""
    kept = [0]
    for index in range(1, len(points) - 1):
        before, after = points[index] - points[kept[-1]], points[index + 1] - points[kept[-1]]
        sizes = np.linalg.norm(before) * np.linalg.norm(after)
        if sizes - before @ after > 1e-12 * sizes:
            kept.append(index)
    return points[[*kept, len(points) - 1]]
