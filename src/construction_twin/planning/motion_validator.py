"""Checks whether the arm touches anything between two points of a joint path, straight or with rounded corners.

States are checked at distances that bound how far any point of arm, tool and load moves between two of them; `recheck` decides on
the final motion, between its samples too.
"""

from __future__ import annotations

import math
from collections import deque
from functools import lru_cache

import numpy as np

from construction_twin.planning.curves import parameters, rounded
from construction_twin.scene.collision_world import CollisionWorld

#: Most points added to a path to keep its rounded corners free.
CORNERS_TIGHTENED = 24


class MotionValidator:
    """Whether the arm can go straight from one joint vector to another without touching anything.

    `step`: Largest distance that any point of the arm, its tool and what it carries moves between two states [m].
    """

    def __init__(self, world: CollisionWorld, levers: np.ndarray, step: float):
        self.world = world
        self._levers, self._step = levers, step
        self._states_per_unit = levers / step

    def coarser(self, times: float) -> MotionValidator:
        """Return a validator of the same world with a step that is a multiple of this one's."""
        return MotionValidator(self.world, self._levers, times * self._step)

    def free(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Return whether nothing touches between `start`, which is not checked, and `end`, which is; shape (n,) each."""
        return self.world.all_free(self.states(start, end)) is None

    def states(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return the states that `free` checks, in its order, shape (m, n): `end` is the first."""
        displacement = end - start
        return start + _middle_first(self.count(displacement)) * displacement

    def count(self, displacement: np.ndarray) -> int:
        """Return how many states of a straight motion are checked, at least 1; `displacement`: its end minus its start."""
        return max(1, math.ceil(np.abs(displacement) @ self._states_per_unit))


@lru_cache(maxsize=1024)
def _middle_first(count: int) -> np.ndarray:
    """Return the fractions of a motion to check, shape (count, 1): the end, the middle, the quarters, ...

    In this order a contact is found early, because it is most likely near the middle, far from the ends, which are free.
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
    """Adds points to a polyline until the curve that rounds its corners is free; `pace` as for `curves.rounded`.

    Looking at what lies `between` the states, too, costs more, and is worth it where something was missed.
    """

    def __init__(self, validator: MotionValidator, pace: np.ndarray, between: bool = False):
        self._validator = validator
        self._pace = pace
        self._between = between

    def tightened(self, path: np.ndarray) -> np.ndarray | None:
        """Return the path, shape (m, n), with points added where needed; None if the path itself touches something.

        A corner is cut over half the distance to the next point. A point added halfway on either side halves its width.
        """
        if len(path) == 2:
            return path if self._validator.free(*path) else None
        for _ in range(CORNERS_TIGHTENED):
            knots = parameters(path, self._pace)
            count = sum(self._validator.count(displacement) for displacement in np.diff(path, axis=0))
            samples = np.linspace(0.0, knots[-1], count + 1)
            place = self._contact(rounded(path, self._pace, 1.0)(samples))
            if place is None:
                return path
            touching = np.interp(place, np.arange(len(samples)), samples)
            at = [np.interp(touching, knots, column) for column in path.T]
            if not self._validator.world.is_free(np.array(at)):
                return None
            corner = 1 + int(np.argmin(np.abs(knots[1:-1] - touching)))
            middles = 0.5 * (path[corner] + path[[corner - 1, corner + 1]])
            path = np.insert(path, [corner, corner + 1], middles, axis=0)
        return None

    def _contact(self, states: np.ndarray) -> float | None:
        """Return where the curve touches something, in states and parts of them; None: nowhere."""
        if not self._between:
            return self._validator.world.all_free(states)
        found = self._validator.world.first_contact(states)
        return None if found is None else found[0]
