"""Which standing bodies the arm comes near on a motion, by boxes around them: what is far from all of it needs no check.

Metres and radians; rows of joint values in Pinocchio's order; boxes along the axes of Pinocchio's world.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from construction_twin.scene.collision_bodies import Body, RobotBodies
from construction_twin.scene.distance_bounds import body_levers

#: One pose stands for so many rows; the boxes are larger by the way to the others.
_GROUP = 8


class NearBodies:
    """Finds the standing bodies that moving ones come near."""

    def __init__(self, robot: RobotBodies, bodies: Sequence[Body]):
        self._robot = robot
        self._moving = [index for index, body in enumerate(bodies) if body.joint]
        self._standing = np.array([index for index, body in enumerate(bodies) if not body.joint], dtype=int)
        self._parts = [(bodies[index], *_local_box(bodies[index])) for index in self._moving]
        boxes = [_standing_box(bodies[index]) for index in self._standing]
        self._middles = np.array([middle for middle, _ in boxes]).reshape(-1, 3)
        self._halves = np.array([half for _, half in boxes]).reshape(-1, 3)

    def near(self, rows: np.ndarray, gap: float) -> list[int]:
        """Return the bodies that move, and the standing ones that a moving one may come near: into `bodies`, ascending.

        `gap`: Of every body that is left out, the distance from every moving one is larger in each row and between them [m].
        """
        near = np.zeros(len(self._standing), dtype=bool)
        if not len(near) or not self._moving:
            return sorted([*self._moving, *self._standing.tolist()])
        chosen, travel = self._groups(rows)
        rotations, positions = self._robot.joint_places(chosen)
        for column, (body, middle, half) in enumerate(self._parts):
            rotation = rotations[:, body.joint]
            half = np.abs(rotation @ body.placement.rotation) @ half + travel[:, column, None]
            middle = rotation @ body.placement.act(middle) + positions[:, body.joint]
            # one box around all rows leaves few bodies to be compared row by row
            low, high = (middle - half).min(axis=0), (middle + half).max(axis=0)
            apart = np.maximum(np.abs(self._middles - 0.5 * (low + high)) - self._halves - 0.5 * (high - low), 0.0)
            left = np.flatnonzero((np.linalg.norm(apart, axis=1) <= gap) & ~near)
            apart = np.maximum(np.abs(middle[:, None] - self._middles[left]) - half[:, None] - self._halves[left], 0.0)
            near[left] = (np.linalg.norm(apart, axis=2) <= gap).any(axis=0)
        return sorted([*self._moving, *self._standing[near].tolist()])

    def _groups(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return one row of each group, shape (g, n), and how far each moving body goes from there to the others, shape (g, k)."""
        way = np.vstack([np.zeros(rows.shape[1]), np.cumsum(np.abs(np.diff(rows, axis=0)), axis=0)])
        first = np.arange(0, len(rows), _GROUP)
        # up to the first row of the next group: what lies between the two is covered, too
        last = np.minimum(first + _GROUP, len(rows) - 1)
        middle = (first + last) // 2
        factors, _ = body_levers(self._robot, [body for body, _, _ in self._parts], np.abs(rows).max(axis=0))
        return rows[middle], np.maximum(way[middle] - way[first], way[last] - way[middle]) @ factors


def _local_box(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle and half the size of the box around a shape, in the shape's frame."""
    body.geometry.computeLocalAABB()
    box = body.geometry.aabb_local
    low, high = np.array(box.min_), np.array(box.max_)
    return 0.5 * (low + high), 0.5 * (high - low)


def _standing_box(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle and half the size of the box around a standing body, each of shape (3,)."""
    middle, half = _local_box(body)
    return body.placement.act(middle), np.abs(body.placement.rotation) @ half
