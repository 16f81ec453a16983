"""Another arm as an obstacle: its shapes where it stands, and along the path that it follows.

A path is represented by copies of each body at selected poses, each with a padding that covers the poses between. Two successive
copies are at most `step` apart, measured as the longest path that any point of the body can have travelled between them; so
every pose between them is within half of that distance of one of the two, and the padded copies contain the whole path.

Metres; poses of obstacles in the root of the URDF of the robot that must not touch them, where Pinocchio has its world. Joint
values in rad (m for prismatic joints), in the order of the other robot's ``joint_names``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import coal
import numpy as np
import pinocchio

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import RobotModel
from construction_twin.scene.collision_bodies import Body, RobotBodies
from construction_twin.scene.distance_bounds import body_levers
from construction_twin.scene.objects import SceneObject

#: Added to every copy's padding [m]: between two 4 ms samples of a path a joint may move back and forth by 2e-5 rad.
ROUNDING = 1e-3
#: Largest difference of a joint between a measured pose and the row of the path that it belongs to [rad] or [m].
ON_PATH = 0.01
#: Rows of a path that are compared at once: the arm is usually near the first of them.
_ROWS = 256


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A copy of a body of the other arm. Compared by identity, not by value.

    Attributes:
        owner: ``<robot>/<link or carried object>``.
        placement: In the root of the URDF of the robot that must not touch it.
        padding: Distance to keep from it [m].
    """

    owner: str
    placement: pinocchio.SE3
    geometry: coal.CollisionGeometry
    padding: float = 0.0

    @cached_property
    def sphere(self) -> tuple[np.ndarray, float]:
        """Centre and radius of a ball around it, without the padding [m]."""
        self.geometry.computeLocalAABB()
        return self.placement.act(np.array(self.geometry.aabb_center)), float(self.geometry.aabb_radius)

    @cached_property
    def distance(self) -> float:
        """Lower bound of its distance from the root of our URDF, without the padding [m]; may be negative."""
        centre, radius = self.sphere
        return float(np.linalg.norm(centre)) - radius

    def padded(self, padding: float) -> Obstacle:
        """Return the same body with a padding that is larger by this [m]."""
        return replace(self, padding=self.padding + padding)


class PathCopy(NamedTuple):
    """A copy of a body along a path. A NamedTuple, because a path of an hour has a million of them.

    Attributes:
        first, last: The rows of the path for which it is needed.
    """

    first: int
    last: int
    obstacle: Obstacle


@dataclass(frozen=True)
class SweptPath:
    """A path of the other arm as obstacles.

    Attributes:
        copies: In the order of their first rows.
    """

    copies: tuple[PathCopy, ...]

    def rest(self, row: int = 0) -> tuple[Obstacle, ...]:
        """Return the space that the arm occupies from a row on; a subset of that from any earlier row."""
        return tuple(copy.obstacle for copy in self.copies if copy.last >= row)


def row_of(rows: np.ndarray, q: Iterable[float], start: int = 0) -> int | None:
    """Return the first row of a path, from `start` on, that is within `ON_PATH` of a pose; None for a pose off the path.

    Args:
        rows: Shape (m, n)
        q: Length n
    """
    q = np.asarray(q)
    for begin in range(start, len(rows), _ROWS):
        near = np.flatnonzero(np.abs(rows[begin : begin + _ROWS] - q).max(axis=1) <= ON_PATH)
        if len(near):
            return begin + int(near[0])
    return None


@dataclass(frozen=True, eq=False)
class _Standing:
    """What an arm occupies that rests, or moves from one pose to another: joint values, shape (n,), and its bodies there."""

    start: np.ndarray
    end: np.ndarray
    obstacles: tuple[Obstacle, ...]


class Neighbour:
    """Another robot, in the frame of ours. The watch (`coordination`) also makes one of our own robot, in its own root.

    Args:
        root_T_root: Of the root of the other robot's URDF in the root of ours; see `cell.Cell`.
        step: Longest path of any point of a body between two copies of it [m].
    """

    def __init__(self, name: str, robot: RobotModel, root_T_root: Pose, step: float):
        self.name = name
        self.step = step
        self._robot_bodies = RobotBodies(robot)
        self._standing: _Standing | None = None
        self._root_T_root = pinocchio.SE3(root_T_root.rotation, root_T_root.position)
        self._use(self._robot_bodies.bodies)

    def carrying(self, items: Iterable[SceneObject]) -> Neighbour:
        """Return the same robot with what its links carry; objects that stand in the world are left out.

        Raises:
            SceneError: If it has no such link, or a mesh cannot be used.
        """
        items = tuple(items)
        names = [item.name for item in items]
        other = object.__new__(Neighbour)
        other.__dict__.update(self.__dict__)
        carried = (body for item in items if item.link for body in self._robot_bodies.place(item, names))
        other._use((*self._robot_bodies.bodies, *carried))
        return other

    def _use(self, bodies: tuple[Body, ...]) -> None:
        self._bodies = bodies
        self._standing = None
        self._levers, reaches = body_levers(self._robot_bodies, bodies, self._robot_bodies.strokes)
        self._pedestal = tuple(
            Obstacle(
                f"{self.name}/{body.owner}",
                self._root_T_root * body.placement,
                body.geometry,
                ROUNDING + _carried_padding(body),
            )
            for body in bodies
            if not body.joint
        )
        ball = coal.Sphere(max(reaches, default=0.0))
        self._anywhere = (Obstacle(f"{self.name}/whole reach", self._root_T_root, ball, ROUNDING),)

    def along(self, path: np.ndarray, standing: bool = True) -> SweptPath:
        """Return the space that the arm occupies on a path.

        Args:
            path: Shape (m, n). Joint values, dense enough that the motion between two rows is covered by `ROUNDING` (every 4 ms).
            standing: Include the bodies that no joint moves: the pedestal.
        """
        path = np.atleast_2d(np.asarray(path, dtype=float))
        rows = self._robot_bodies.rows(path)
        steps = np.abs(np.diff(rows, axis=0)) @ self._levers
        travel = np.vstack([np.zeros(len(self._bodies)), np.cumsum(steps, axis=0)])
        keys = [
            key_rows(column, self.step) if body.joint or standing else []
            for body, column in zip(self._bodies, travel.T)
        ]
        placements = self._placements(rows, keys)
        copies: list[PathCopy] = []
        for index, body in enumerate(self._bodies):
            gaps = np.diff(travel[keys[index], index], prepend=0.0, append=travel[-1, index])
            # a single copy must cover the whole path, not only half of it
            paddings = np.maximum(gaps[:-1], gaps[1:]) / (2.0 if len(keys[index]) > 1 else 1.0) + ROUNDING
            spans = zip([0, *keys[index]], [*keys[index][1:], len(rows) - 1])
            owner = f"{self.name}/{body.owner}"
            carried = _carried_padding(body)
            copies += [
                PathCopy(first, last, Obstacle(owner, placement, body.geometry, float(padding) + carried))
                for (first, last), placement, padding in zip(spans, placements[index], paddings)
            ]
        copies.sort(key=lambda copy: copy.first)
        return SweptPath(tuple(copies))

    def standing(self) -> tuple[Obstacle, ...]:
        """Return the bodies that no joint moves (the pedestal); the same objects at every call."""
        return self._pedestal

    def between(self, start: Iterable[float], end: Iterable[float]) -> tuple[Obstacle, ...]:
        """Return the space that the arm occupies at two poses and on the straight joint motion between them.

        For an arm whose measured pose lags behind its command: it may be anywhere between the two.
        """
        begin, goal = np.array(start, dtype=float), np.array(end, dtype=float)
        if self._standing is not None:
            known = self._standing
            # within noise that the padding covers, the same objects are returned, so that callers need not check them again
            if max(self._displacement(begin - known.start), self._displacement(goal - known.end)) <= ROUNDING / 2.0:
                return known.obstacles
        count = 1 + int(np.ceil(self._displacement(goal - begin) / self.step))
        fractions = np.linspace(0.0, 1.0, count + 1)[:, None]
        obstacles = tuple(item.padded(ROUNDING) for item in self.along(begin + fractions * (goal - begin)).rest())
        self._standing = _Standing(begin, goal, obstacles)
        return obstacles

    def _displacement(self, change: np.ndarray) -> float:
        """Return an upper bound of the motion of any point of any body when the joints change by this much [m]."""
        bodies = self._robot_bodies
        ordered = np.zeros(bodies.size)
        ordered[bodies.order] = np.abs(change)
        for at, leader, factor, _ in bodies.followers:
            ordered[at] = abs(factor) * ordered[leader]
        return float((ordered @ self._levers).max(initial=0.0))

    def anywhere(self) -> tuple[Obstacle, ...]:
        """Return a ball around everything that the arm with its load can reach: for an arm whose pose is unknown."""
        return self._anywhere

    def _placements(self, rows: np.ndarray, keys: list[list[int]]) -> list[list[pinocchio.SE3]]:
        """Return the placements of each body at the rows selected for it."""
        model = self._robot_bodies.model
        data = model.createData()
        wanted: dict[int, list[int]] = {}
        for index, found in enumerate(keys):
            for row in found:
                wanted.setdefault(row, []).append(index)
        placements: list[list[pinocchio.SE3]] = [[] for _ in keys]
        for row in sorted(wanted):
            pinocchio.forwardKinematics(model, data, rows[row])
            for index in wanted[row]:
                body = self._bodies[index]
                placements[index].append(self._root_T_root * data.oMi[body.joint] * body.placement)
        return placements


def _carried_padding(body: Body) -> float:
    return body.item.padding if body.item is not None else 0.0


def key_rows(travel: np.ndarray, step: float) -> list[int]:
    """Return rows of a path that are about a step apart, the first and the last among them.

    Args:
        travel: Shape (m,). Distance travelled from the first row to each; never decreases [m].

    Returns:
        Ascending. Only the first row if the whole distance is at most `ROUNDING`.
    """
    total = float(travel[-1])
    if total <= ROUNDING:
        return [0]
    targets = np.linspace(0.0, total, 1 + int(np.ceil(total / step)))
    rows = np.searchsorted(travel, targets[1:-1] + 1e-12, side="right") - 1
    return np.unique([0, *rows, len(travel) - 1]).tolist()
