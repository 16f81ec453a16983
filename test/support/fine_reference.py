"""The nearest solution of an arm with one redundant joint, by brute force along the joint that is held: slow, and simple."""

from __future__ import annotations

import math

import numpy as np

from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.ranges import TURN
from construction_twin.kinematics.redundant import RedundantInverse

#: Values of the held joint in the first division; then parts of each promising interval, and how many intervals, each time.
_VALUES, _PARTS, _KEPT = 2000, 40, (24, 10, 6)
#: How much nearer than its samples an interval of the first division may come to the seed.
_HOPE = 1.0


def fine_nearest(inverse: RedundantInverse, pose: Pose, seed: np.ndarray) -> float:
    """Return the distance from a seed of the nearest solution within the ranges; inf: none was found.

    Args:
        inverse: Of an exact form. Used for what holds its joint; the choice along the self-motion is made here.
        seed: Shape (7,)
    """
    robot, held = inverse.chain.robot, inverse.held
    low, high = robot.lower[held], robot.upper[held]
    step = (high - low) / _VALUES
    values = np.append(low + step * (np.arange(_VALUES) + 0.5), seed[held])
    best, hope = math.inf, _HOPE
    for kept in (*_KEPT, 0):
        nearest, distances = _at(inverse, pose, np.asarray(seed), values)
        best = min(best, nearest)
        promising = distances.argsort(kind="stable")[:kept]
        promising = promising[distances[promising] < best + hope]
        parts = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        values = np.clip((values[promising, None] + 2.0 * step * parts).ravel(), low, high)
        step *= 2.0 / _PARTS
        hope /= 4.0
    return best


def _at(inverse: RedundantInverse, pose: Pose, seed: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the distance of the nearest solution in range, and for each value that of the nearest one almost in range."""
    robot = inverse.chain.robot
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    found = [inverse.held_at(value, pose) for value in values.tolist()]
    layer = np.repeat(np.arange(len(values)), [len(rows) for rows in found])
    per_value = np.full(len(values), math.inf)
    if not len(layer):
        return math.inf, per_value
    q = np.concatenate([rows for rows in found if len(rows)])
    turns = np.where(robot.linear, 0.0, TURN)
    q = q - turns * np.rint((q - seed) / np.where(robot.linear, np.inf, TURN))
    q = np.where((q > upper) & (q - turns >= lower), q - turns, q)
    q = np.where((q < lower) & (q + turns <= upper), q + turns, q)
    excess = np.maximum(lower - q, q - upper).max(axis=1)
    distance = np.linalg.norm(q - seed, axis=1)
    inside = excess <= 1e-9
    # joints move faster than the held one, so that a range may be reached a few steps away
    np.minimum.at(per_value, layer, distance + 10.0 * np.maximum(excess, 0.0))
    return float(distance[inside].min()) if inside.any() else math.inf, per_value
