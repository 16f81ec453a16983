"""The smallest of many distances, found without measuring all of them.

Between two poses the distance of two bodies changes by at most the motion of the bodies, which bounds the distances between two
measured poses. Metres and radians; rows of joint values in Pinocchio's order.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from construction_twin.scene.collision_bodies import Body, RobotBodies

#: Accuracy of a measured distance [m]: Coal's own tolerance.
TOLERANCE = 1e-6
#: Every so many rows all pairs are measured before the search begins.
_STRIDE = 64


class _Gap(NamedTuple):
    """A pair between two measured rows, ordered by the lower bound of its distance there."""

    bound: float
    low: int
    high: int
    pair: int
    at_low: float
    at_high: float


def levers(robot: RobotBodies, bodies: Sequence[Body], pairs: Sequence[tuple], strokes: np.ndarray) -> np.ndarray:
    """Return how far the two bodies of each pair can move relative to each other per unit of each joint.

    Parameters
    ----------
    robot : RobotBodies
    bodies : sequence of Body
    pairs : sequence of tuple
        Their first two entries are indices into `bodies`.
    strokes : array, shape (size,)
        Largest absolute value of each joint, Pinocchio's order; used for prismatic joints [m].

    Returns
    -------
    levers : array, shape (size, p)
        [m/rad], or 1 for prismatic joints; Pinocchio's order.
    """
    model = robot.model
    per_body, _ = body_levers(robot, bodies, strokes)
    moves = np.array(
        [[place in joints for place in range(model.nq)] for joints in map(partial(_joints_below, robot), bodies)]
    ).T
    if not len(pairs):
        return np.zeros((model.nq, 0))
    first, second = np.array([(pair[0], pair[1]) for pair in pairs]).T
    # a joint that moves both bodies moves them together
    return np.where(moves[:, first] ^ moves[:, second], per_body[:, first] + per_body[:, second], 0.0)


def body_levers(robot: RobotBodies, bodies: Sequence[Body], strokes: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Return bounds of the motion of a body's points per unit of each joint, and of their distance from the root.

    Parameters
    ----------
    robot : RobotBodies
    bodies : sequence of Body
    strokes : array, shape (size,)
        As of `levers`.

    Returns
    -------
    levers : array, shape (size, b)
        [m/rad], or 1 for prismatic joints; Pinocchio's order. 0 for a joint that does not move the body.
    reaches : list of float, length b
        Largest distance of any point of it from the root at any joint values [m].
    """
    model = robot.model
    per_body = np.zeros((model.nq, len(bodies)))
    reaches = []
    for column, body in enumerate(bodies):
        body.geometry.computeLocalAABB()
        centre = body.placement.act(np.array(body.geometry.aabb_center))
        distance = float(np.linalg.norm(centre)) + body.geometry.aabb_radius
        joint = body.joint
        while joint:
            index = model.joints[joint].idx_q
            linear = model.joints[joint].shortname().startswith("JointModelP")
            per_body[index, column] = 1.0 if linear else distance
            distance += float(np.linalg.norm(model.jointPlacements[joint].translation)) + linear * strokes[index]
            joint = model.parents[joint]
        reaches.append(distance)
    return per_body, reaches


def _joints_below(robot: RobotBodies, body: Body) -> set[int]:
    """Return the places, in Pinocchio's configuration, of the joints that move a body."""
    model, joint, places = robot.model, body.joint, set()
    while joint:
        places.add(model.joints[joint].idx_q)
        joint = model.parents[joint]
    return places


def smallest(
    travel: np.ndarray, measure_row: Callable[[int], np.ndarray], measure: Callable[[int, int], float]
) -> tuple[int, int]:
    """Find the smallest distance of all pairs in all rows.

    Parameters
    ----------
    travel : array, shape (m, p)
        For each pair, an upper bound of the relative motion of its bodies from the first row to each row [m].
    measure_row : callable
        Returns the distances of all pairs in a row, shape (p,) [m].
    measure : callable
        Returns the distance of one pair in one row [m]: ``measure(row, pair)``.

    Returns
    -------
    row, pair : int
        Where the smallest distance is. No other is smaller by more than `TOLERANCE`.
    """
    rows = np.unique(np.linspace(0, len(travel) - 1, 1 + -(-len(travel) // _STRIDE)).astype(int))
    known = np.array([measure_row(int(row)) for row in rows])
    at, closest = np.unravel_index(np.argmin(known), known.shape)
    best, best_row, best_pair = float(known[at, closest]), int(rows[at]), int(closest)
    # lower bounds of each pair's distance between two measured rows
    bounds = (known[:-1] + known[1:] - np.diff(travel[rows], axis=0)) / 2
    heap = [
        _Gap(bounds[gap, pair], int(rows[gap]), int(rows[gap + 1]), int(pair), known[gap, pair], known[gap + 1, pair])
        for gap, pair in np.argwhere(bounds < best - TOLERANCE)
    ]
    heapq.heapify(heap)
    while heap and heap[0].bound < best - TOLERANCE:
        _, low, high, pair, at_low, at_high = heapq.heappop(heap)
        if high - low < 2:
            continue
        moved = travel[:, pair]
        # the row where the bounds from both ends meet
        meet = (moved[low] + moved[high] + at_low - at_high) / 2
        row = int(np.searchsorted(moved[low + 1 : high - 1], meet)) + low + 1
        distance = measure(row, pair)
        if distance < best:
            best, best_row, best_pair = distance, row, pair
        for start, end, first, second in ((low, row, at_low, distance), (row, high, distance, at_high)):
            bound = (first + second - (moved[end] - moved[start])) / 2
            if bound < best - TOLERANCE:
                heapq.heappush(heap, _Gap(bound, start, end, pair, first, second))
    return best_row, best_pair
