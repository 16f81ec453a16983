"""The way between two points of a joint path, straight or with rounded corners: does the arm touch anything on it?

Joint vectors are in the order of `RobotModel.joint_names`, SI. States are checked at distances that bound how far any
point of the arm moves between two of them; what happens in between is not known. The last word on a motion is `report`.
"""

from __future__ import annotations

from collections import deque
from functools import lru_cache

import numpy as np

from construction_twin.kinematics.chain import Chain
from construction_twin.planning.curves import rounded
from construction_twin.scene.collision_world import CollisionWorld

#: Half the thickness of a link or tool [m]: what turning about its own axis moves.
BODY = 0.3
#: Poses that the levers are taken from.
LEVER_SAMPLES = 500
#: Most points added to a path to keep its rounded corners free.
CORNERS_TIGHTENED = 24


def levers(chain: Chain) -> np.ndarray:
    """Return how far a point of the arm moves at most when a joint does.

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    levers : array, shape (n,)
        [m/rad]; 1 for a linear joint. The tip's largest ones over sampled poses, plus `BODY` for a joint that turns.
    """
    rng = np.random.default_rng(0)
    samples = rng.uniform(chain.robot.lower, chain.robot.upper, (LEVER_SAMPLES, len(chain.robot.joint_names)))
    largest = np.max([np.linalg.norm(chain.jacobian(q)[:3], axis=0) for q in samples], axis=0)
    return largest + np.where(chain.robot.linear, 0.0, BODY)


class MotionValidator:
    """Whether the arm can go straight from one joint vector to another without touching anything.

    Parameters
    ----------
    world : CollisionWorld
    levers : array, shape (n,)
        As from `levers`.
    step : float
        Largest distance that any point of the arm moves between two states that are checked [m].
    """

    def __init__(self, world: CollisionWorld, levers: np.ndarray, step: float):
        self.world = world
        self._states_per_unit = levers / step

    def free(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Return whether nothing touches between `start`, which is not checked, and `end`, which is.

        Parameters
        ----------
        start, end : array, shape (n,)
            [rad] or [m]
        """
        displacement = end - start
        return self.world.all_free(start + _middle_first(self.count(displacement)) * displacement) is None

    def count(self, displacement: np.ndarray) -> int:
        """Return how many states a straight displacement needs, at least 1.

        Parameters
        ----------
        displacement : array, shape (n,)
            Its end minus its start.
        """
        return max(1, int(np.ceil(np.abs(displacement) @ self._states_per_unit)))


@lru_cache(maxsize=1024)
def _middle_first(count: int) -> np.ndarray:
    """Return the fractions of an edge to check, shape (count, 1): the end, the middle, the quarters, ...

    A contact is most likely found early: near the middle, far from the ends that are known to be free.
    """
    order = [count]
    spans = deque([(0, count)])
    while spans:
        first, last = spans.popleft()
        if last - first > 1:
            middle = (first + last) // 2
            order.append(middle)
            spans += [(first, middle), (middle, last)]
    fractions = np.array(order)[:, None] / count
    fractions.flags.writeable = False
    return fractions


class CornerRounding:
    """Adds points to a polyline until the curve that rounds its corners is free.

    Parameters
    ----------
    validator : MotionValidator
    pace : array, shape (n,)
        As for `curves.rounded`.
    """

    def __init__(self, validator: MotionValidator, pace: np.ndarray):
        self._validator = validator
        self._pace = pace

    def tightened(self, path: np.ndarray) -> np.ndarray | None:
        """Return the path with points added where needed; None if the path itself touches something.

        A corner is cut over half the way to the next point: one added halfway on either side makes it half as wide.

        Parameters
        ----------
        path : array, shape (m, n)

        Returns
        -------
        path : array, shape (k, n), or None
        """
        if len(path) == 2:
            return path if self._validator.free(*path) else None
        for _ in range(CORNERS_TIGHTENED):
            curve = rounded(path, self._pace, 1.0)
            count = sum(self._validator.count(displacement) for displacement in np.diff(path, axis=0))
            samples = np.linspace(0.0, curve.length, count + 1)
            row = self._validator.world.all_free(curve(samples))
            if row is None:
                return path
            spans = np.max(np.abs(np.diff(path, axis=0)) / self._pace, axis=1)
            knots = np.concatenate(([0.0], np.cumsum(spans)))
            at = [np.interp(samples[row], knots, column) for column in path.T]
            if not self._validator.world.is_free(np.array(at)):
                return None
            corner = 1 + int(np.argmin(np.abs(knots[1:-1] - samples[row])))
            middles = 0.5 * (path[corner] + path[[corner - 1, corner + 1]])
            path = np.insert(path, [corner, corner + 1], middles, axis=0)
        return None
