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
WORTHWHILE = 0.02

#: Returns the first of some straight edges that is free, given their starts and ends, shape (k, n); None: none is.
FirstFree = Callable[[np.ndarray, np.ndarray], int | None]


def shortened(path: np.ndarray, first_free: FirstFree) -> np.ndarray:
    """Return a path from the same start to the same goal that is no longer.

    Args:
        path: Shape (m, n). m >= 2; successive points differ, and the edges between them are free.

    Returns:
        Shape (k, n). At least two points, both ends to the last bit; every edge is a part of a given one or was found free.
    """
    points = _divided(path)
    while True:
        gains, length = _gains(points)
        firsts, lasts = np.nonzero(gains >= WORTHWHILE * length)
        order = np.argsort(-gains[firsts, lasts], kind="stable")
        firsts, lasts = firsts[order], lasts[order]
        found = first_free(points[firsts], points[lasts])
        if found is None:
            return _fewer(_corners(points), first_free)
        first, last = firsts[found], lasts[found]
        points = np.concatenate((points[:first], _divided(points[[first, last]]), points[last + 1 :]))


def _fewer(points: np.ndarray, first_free: FirstFree) -> np.ndarray:
    """Return the path without the corners that need not be: each one slows the motion, however little it makes it longer."""
    index = 1
    while index < len(points) - 1:
        if first_free(points[[index - 1]], points[[index + 1]]) is not None:
            points = np.delete(points, index, axis=0)
            index = max(1, index - 1)
        else:
            index += 1
    return points


def _gains(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return by how much the edge between each two points is shorter than the path, shape (m, m), and the path's length."""
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    along = np.concatenate(([0.0], np.cumsum(np.diagonal(apart, 1))))
    return along - along[:, None] - apart, float(along[-1])


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
