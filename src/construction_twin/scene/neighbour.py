"""Another arm as an obstacle: its shapes where it stands, and along the path that it follows.

A path is not kept as a cloud of all its poses, but as copies of each body at some of them, each with a padding that covers what
lies between: two neighbouring copies are `step` apart at most, measured as the longest way that any point of the body can have
gone, so every pose between them lies within half of that of one of the two. Nothing on the path is outside of the padded copies.

Metres; poses of obstacles in the root of the URDF of the robot that must not touch them, where Pinocchio has its world. Joint
values in rad (m for linear joints), in the order of the other robot's ``joint_names``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import coal
import numpy as np
import pinocchio

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import RobotModel
from construction_twin.scene.collision_bodies import Body, RobotBodies
from construction_twin.scene.distance_bounds import body_levers
from construction_twin.scene.objects import SceneObject

#: Added to every copy's padding [m]: between two rows of a path sampled every 4 ms a joint may go back and forth by 2e-5 rad.
ROUNDING = 1e-3
#: Largest difference of a joint between a measured pose and the row of the path that it belongs to [rad] or [m].
ON_PATH = 0.01
#: Rows of a path that are looked at in one go: the arm is mostly near the first.
_ROWS = 256


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A copy of a body of the other arm. Two are the same only if they are one object.

    Attributes
    ----------
    owner : str
        ``<robot>/<link or carried object>``.
    placement : pinocchio.SE3
        In the root of the URDF of the robot that must not touch it.
    geometry : coal.CollisionGeometry
    padding : float
        Distance to keep from it [m].
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
        """Distance from the root of our URDF to its nearest point, at least, without the padding [m]; may be negative."""
        centre, radius = self.sphere
        return float(np.linalg.norm(centre)) - radius

    def padded(self, padding: float) -> Obstacle:
        """Return the same body with so much more distance to keep [m]."""
        return replace(self, padding=self.padding + padding)


@dataclass(frozen=True)
class SweptPath:
    """A path of the other arm as obstacles.

    Attributes
    ----------
    copies : tuple of (int, int, Obstacle)
        Each with the first and the last row that it is needed for, in the order of the first ones.
    """

    copies: tuple[tuple[int, int, Obstacle], ...]

    def rest(self, row: int = 0) -> tuple[Obstacle, ...]:
        """Return what the arm takes up from a row on; a subset of what it takes up from any earlier one."""
        return tuple(obstacle for _, last, obstacle in self.copies if last >= row)


def row_of(rows: np.ndarray, q: Iterable[float], start: int = 0) -> int | None:
    """Return the first row of a path, from `start` on, that a pose belongs to (`ON_PATH`); None for a pose off the path.

    Parameters
    ----------
    rows : array, shape (m, n)
    q : iterable of float, length n
    start : int, optional
    """
    q = np.asarray(q)
    for begin in range(start, len(rows), _ROWS):
        near = np.flatnonzero(np.abs(rows[begin : begin + _ROWS] - q).max(axis=1) <= ON_PATH)
        if len(near):
            return begin + int(near[0])
    return None


class Neighbour:
    """Another robot, seen from where this one stands; or our own, for the watch, seen from its own root.

    Parameters
    ----------
    name : str
    robot : RobotModel
    root_T_root : Pose
        Of the root of the other robot's URDF in the root of ours; see `cell.Cell`.
    step : float
        Largest way of any point of a body between two copies of it [m].

    Raises
    ------
    ConfigurationError
        If its shapes cannot be read.
    """

    def __init__(self, name: str, robot: RobotModel, root_T_root: Pose, step: float):
        self.name = name
        self.step = step
        self._robot_bodies = RobotBodies(robot)
        self._standing: tuple[np.ndarray, np.ndarray, tuple[Obstacle, ...]] | None = None
        self._root_T_root = pinocchio.SE3(root_T_root.rotation, root_T_root.position)
        self._use(self._robot_bodies.bodies)

    def carrying(self, items: Iterable[SceneObject]) -> Neighbour:
        """Return the same robot with what its links carry; objects that stand in the world are left out.

        Raises
        ------
        SceneError
            If it has no such link, or a mesh cannot be used.
        """
        items = tuple(items)
        names = [item.name for item in items]
        other = object.__new__(Neighbour)
        other.__dict__.update(self.__dict__)
        carried = (self._robot_bodies.place(item, names) for item in items if item.link)
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
        """Return everything that the arm takes up on a path.

        Parameters
        ----------
        path : array, shape (m, n)
            Joint values so close to each other that what lies between two rows hardly matters (every 4 ms).
        standing : bool, optional
            With what no joint moves: its pedestal.
        """
        path = np.atleast_2d(np.asarray(path, dtype=float))
        rows = np.empty(path.shape)
        rows[:, self._robot_bodies.order] = path
        steps = np.abs(np.diff(rows, axis=0)) @ self._levers
        travel = np.vstack([np.zeros(len(self._bodies)), np.cumsum(steps, axis=0)])
        keys = [
            key_rows(column, self.step) if body.joint or standing else []
            for body, column in zip(self._bodies, travel.T)
        ]
        placements = self._placements(rows, keys)
        copies = []
        for index, body in enumerate(self._bodies):
            gaps = np.diff(travel[keys[index], index], prepend=0.0, append=travel[-1, index])
            # one copy alone stands for the whole path, whichever end is farther
            paddings = np.maximum(gaps[:-1], gaps[1:]) / (2.0 if len(keys[index]) > 1 else 1.0) + ROUNDING
            spans = zip([0, *keys[index]], [*keys[index][1:], len(rows) - 1])
            owner = f"{self.name}/{body.owner}"
            carried = _carried_padding(body)
            copies += [
                (first, last, Obstacle(owner, placement, body.geometry, float(padding) + carried))
                for (first, last), placement, padding in zip(spans, placements[index], paddings)
            ]
        copies.sort(key=lambda copy: copy[0])
        return SweptPath(tuple(copies))

    def standing(self) -> tuple[Obstacle, ...]:
        """Return what no joint moves: its pedestal; always the same objects."""
        return self._pedestal

    def between(self, start: Iterable[float], end: Iterable[float]) -> tuple[Obstacle, ...]:
        """Return what the arm takes up at two poses and straight (in joint values) between them.

        For an arm whose measured pose trails its command: it may be anywhere on the way.
        """
        start, end = np.array(start, dtype=float), np.array(end, dtype=float)
        if self._standing is not None:
            known_start, known_end, obstacles = self._standing
            # noise within what the padding covers: who has looked at these need not look again
            if max(self._displacement(start - known_start), self._displacement(end - known_end)) <= ROUNDING / 2.0:
                return obstacles
        count = 1 + int(np.ceil(self._displacement(end - start) / self.step))
        fractions = np.linspace(0.0, 1.0, count + 1)[:, None]
        obstacles = tuple(item.padded(ROUNDING) for item in self.along(start + fractions * (end - start)).rest())
        self._standing = start, end, obstacles
        return obstacles

    def _displacement(self, change: np.ndarray) -> float:
        """Return how far any point of any body moves, at most, when the joints change by so much [m]."""
        ordered = np.zeros(len(change))
        ordered[self._robot_bodies.order] = np.abs(change)
        return float((ordered @ self._levers).max(initial=0.0))

    def anywhere(self) -> tuple[Obstacle, ...]:
        """Return all that the arm can reach, with what it carries, as one ball: for an arm of which no pose is known."""
        return self._anywhere

    def _placements(self, rows: np.ndarray, keys: list[list[int]]) -> list[list[pinocchio.SE3]]:
        """Return where each body is at rows of its own."""
        model = self._robot_bodies.model
        data = model.createData()
        wanted: dict[int, list[int]] = {}
        for index, found in enumerate(keys):
            for row in found:
                wanted.setdefault(row, []).append(index)
        placements = [[] for _ in keys]
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

    Parameters
    ----------
    travel : array, shape (m,)
        Way from the first row to each; never falls.
    step : float

    Returns
    -------
    rows : list of int
        Ascending. Just the first where the whole way is shorter than `ROUNDING`.
    """
    total = float(travel[-1])
    if total <= ROUNDING:
        return [0]
    targets = np.linspace(0.0, total, 1 + int(np.ceil(total / step)))
    rows = np.searchsorted(travel, targets[1:-1] + 1e-12, side="right") - 1
    return np.unique([0, *rows, len(travel) - 1]).tolist()
