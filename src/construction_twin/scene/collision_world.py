"""Contacts and distances of the arm with itself and with everything in the scene, by Pinocchio and Coal.

Joint values in rad (m for prismatic joints), in the order of ``robot.joint_names``; points in the robot's base_link [m].
A world belongs to one scene; a changed scene needs a new world (`CollisionWorld.with_scene`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.plan import Clearance
from construction_twin.scene.collision_bodies import Body, RobotBodies, make_reliable
from construction_twin.scene.distance_bounds import body_levers, levers, smallest
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.self_collision import SelfCollision

#: Pinocchio's broad phases: for few bodies, comparing every box with every box is fastest; for many bodies, a tree.
_FEW = pinocchio.BroadPhaseManager_NaiveCollisionManager
_MANY = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager
MANY_BODIES = 128
#: With another arm in the world most bodies stand still; this broad phase first compares one box around each group of bodies
#: that move together.
_WITH_NEIGHBOUR = pinocchio.TreeBroadPhaseManager_NaiveCollisionManager


@dataclass(frozen=True)
class Contact:
    """Two bodies that touch, or are closer than the padding.

    Attributes
    ----------
    between : tuple of str, length 2
        A link or a carried object first, then a link or an object.
    """

    between: tuple[str, str]


@dataclass(frozen=True)
class PairDistance:
    """How far two bodies are from each other.

    Attributes
    ----------
    between : tuple of str, length 2
        As in `Contact`.
    distance : float
        Negative for two bodies that penetrate each other [m].
    margin : float
        At this distance or less they are in contact [m].
    """

    between: tuple[str, str]
    distance: float
    margin: float


class CollisionWorld:
    """A robot among the objects of a scene.

    Checked are: links against links, without the pairs that `self_collision` leaves out (contact: distance 0 or less);
    moving links against objects, and carried objects against standing ones (contact: distance within the scene's padding
    plus the larger padding of the objects); carried objects against links, without those that move with them. Not
    checked are an object and what it names in `touch`. Links and objects that do not move are not checked against each
    other: the pedestal stands on the floor.

    Not for use from several threads at once: it works in buffers of its own.

    Parameters
    ----------
    robot : RobotModel
    scene : Scene
    self_collision : SelfCollision
        The pairs of links that are not checked.

    Attributes
    ----------
    robot : RobotModel
    scene : Scene
    self_collision : SelfCollision

    Raises
    ------
    ConfigurationError
        If the robot's shapes cannot be read.
    SceneError
        If the scene names links or objects that do not exist, or a mesh cannot be used.
    """

    def __init__(self, robot: RobotModel, scene: Scene, self_collision: SelfCollision):
        self._build(RobotBodies(robot), scene, self_collision)

    def with_scene(self, scene: Scene) -> CollisionWorld:
        """Return a world with the same robot in another scene; faster than building it from the robot."""
        world = object.__new__(CollisionWorld)
        world._build(self._robot_bodies, scene, self.self_collision)
        return world

    def with_neighbour(self, obstacles: Iterable[Obstacle]) -> CollisionWorld:
        """Return a world with the same robot and scene, and another arm in it; the scene's version stays the same.

        Moving links and carried objects are checked against its bodies (contact: distance within the scene's padding plus the
        obstacle's). Bodies that do not move are not checked.

        Parameters
        ----------
        obstacles : iterable of Obstacle
            They replace the present ones.
        """
        world = object.__new__(CollisionWorld)
        world._build(self._robot_bodies, self.scene, self.self_collision, self._own, tuple(obstacles))
        return world

    def _build(
        self,
        robot_bodies: RobotBodies,
        scene: Scene,
        self_collision: SelfCollision,
        own: tuple[Body, ...] | None = None,
        obstacles: tuple[Obstacle, ...] = (),
    ) -> None:
        self.robot = robot_bodies.robot
        self.scene = scene
        self.self_collision = self_collision
        self._robot_bodies = robot_bodies
        if own is None:
            own = (*robot_bodies.bodies, *(robot_bodies.place(item, scene.names) for item in scene.objects))
        self._own = own
        reached, reached_pairs = self._neighbour_pairs(own, obstacles)
        self._bodies = own + tuple(Body(item.owner, "", 0, item.placement, item.geometry) for item in reached)
        self._pairs = pairs = checked_pairs(own, scene.padding, self_collision) + reached_pairs
        self._names = [(self._bodies[first].owner, self._bodies[second].owner) for first, second, _ in pairs]
        self._model = robot_bodies.model
        self._geometry = pinocchio.GeometryModel()
        for index, body in enumerate(self._bodies):
            shape = pinocchio.GeometryObject(f"{index}", body.joint, body.placement, body.geometry)
            self._geometry.addGeometryObject(shape)
        for first, second, _ in pairs:
            self._geometry.addCollisionPair(pinocchio.CollisionPair(first, second))
        self._data = self._model.createData()
        self._geometry_data = self._geometry.createData()
        make_reliable(self._geometry_data)
        for request, (_, _, margin) in zip(self._geometry_data.collisionRequests, pairs):
            request.security_margin = margin
        order = robot_bodies.order
        self._q = np.zeros(len(order))
        # for the usual order a slice suffices; an index list would cost as much as the check of a few pairs
        self._order = slice(None) if (order == np.arange(len(order))).all() else order
        # one call per question: boxes around the bodies first, shapes only where the boxes overlap
        manager = _WITH_NEIGHBOUR if reached else _FEW if len(self._bodies) <= MANY_BODIES else _MANY
        self._broad_phase = manager(self._model, self._geometry, self._geometry_data)

    def _neighbour_pairs(
        self, own: tuple[Body, ...], obstacles: tuple[Obstacle, ...]
    ) -> tuple[list[Obstacle], list[tuple[int, int, float]]]:
        """Return the obstacles that a moving body can reach, and the pairs that can touch, in the form of `checked_pairs`."""
        if not obstacles:
            return [], []
        _, reaches = body_levers(self._robot_bodies, own, self._robot_bodies.strokes)
        moving = np.array([body.joint > 0 for body in own])
        paddings = self.scene.padding + np.array([body.item.padding if body.item is not None else 0.0 for body in own])
        reached: list[Obstacle] = []
        pairs: list[tuple[int, int, float]] = []
        for item in obstacles:
            margins = paddings + item.padding
            near = np.flatnonzero(moving & (item.distance <= np.array(reaches) + margins))
            pairs += [(int(first), len(own) + len(reached), float(margins[first])) for first in near]
            reached += [item] if len(near) else []
        return reached, pairs

    def is_free(self, q: JointValues) -> bool:
        """Return whether nothing touches. The fastest check: it ends at the first contact.

        Parameters
        ----------
        q : sequence of float, length n
            [rad] or [m]; an array is the fastest. Not checked against the ranges.
        """
        self._q[self._order] = q
        return not pinocchio.computeCollisions(self._model, self._data, self._broad_phase, self._q, True)

    def contact(self, q: JointValues) -> Contact | None:
        """Return a pair that touches, or None where `is_free`; parameters as there."""
        for result in self._geometry_data.collisionResults:
            result.clear()
        if self.is_free(q):
            return None
        for names, result in zip(self._names, self._geometry_data.collisionResults):
            if result.isCollision():
                return Contact(names)
        raise AssertionError("a contact without a pair")

    def contacts(self, q: JointValues) -> list[Contact]:
        """Return every pair of names that touches; slower than `contact`; parameters as there."""
        self._q[self._order] = q
        pinocchio.computeCollisions(self._model, self._data, self._geometry, self._geometry_data, self._q, False)
        results = zip(self._names, self._geometry_data.collisionResults)
        return [Contact(names) for names in dict.fromkeys(names for names, result in results if result.isCollision())]

    def unchecked_pairs(self) -> list[tuple[SceneObject, str]]:
        """Return the standing objects, each with every link that no joint moves, unless it may touch it."""
        links = dict.fromkeys(body.link for body in self._own if body.item is None and not body.joint)
        standing = (item for item in self.scene.objects if not item.link)
        return [(item, link) for item in standing for link in links if link not in item.touch]

    def distance(self, q: JointValues, first: str, second: str) -> float:
        """Return the smallest distance between the shapes of two links or objects, whether the pair is checked or not.

        Parameters
        ----------
        q : sequence of float, length n
            [rad] or [m]
        first, second : str
            Names.

        Returns
        -------
        distance : float
            [m]; negative: how deep one is in the other; inf if one of them has no shape.
        """
        self._q[self._order] = q
        pinocchio.forwardKinematics(self._model, self._data, self._q)
        request = coal.DistanceRequest()
        placed: dict[str, list[tuple[coal.CollisionGeometry, coal.Transform3s]]] = {first: [], second: []}
        for body in self._own:
            if body.owner in placed:
                place = self._data.oMi[body.joint] * body.placement
                placed[body.owner].append((body.geometry, coal.Transform3s(place.rotation, place.translation)))
        return min(
            (
                coal.distance(*one, *other, request, coal.DistanceResult())
                for one in placed[first]
                for other in placed[second]
            ),
            default=np.inf,
        )

    def object_pose(self, q: JointValues, name: str) -> Pose:
        """Return an object's pose in the base_link, at joint values `q` when a link carries it.

        Raises
        ------
        SceneError
            If the scene has no such object.
        """
        item = self.scene.get(name)
        return product(self.link_pose(q, item.link), item.pose) if item.link else item.pose

    def link_pose(self, q: JointValues, link: str) -> Pose:
        """Return a link's pose in the base_link; see `RobotBodies.link_pose`."""
        return self._robot_bodies.link_pose(q, link)

    def all_free(self, qs: np.ndarray) -> int | None:
        """Return the first row that is in contact, None when none is.

        Parameters
        ----------
        qs : array, shape (m, n)
            [rad] or [m]
        """
        for row, q in enumerate(qs):
            if not self.is_free(q):
                return row
        return None

    def clearance(self, q: JointValues) -> Clearance:
        """Return the smallest distance of a checked pair; the padding is not subtracted.

        Parameters
        ----------
        q : sequence of float, length n
            [rad] or [m]

        Returns
        -------
        clearance : Clearance
            Negative for two bodies that penetrate each other; inf if no pair is checked.
        """
        if not self._pairs:
            return Clearance(np.inf)
        return self._clearance(self._measure(q))

    def clearance_of(self, qs: np.ndarray) -> tuple[Clearance, int]:
        """Return the smallest distance over many poses, and the row where it is.

        Successive rows should be close to each other: then only few distances need to be measured, see `distance_bounds`.

        Parameters
        ----------
        qs : array, shape (m, n)
            m >= 1; [rad] or [m]

        Returns
        -------
        clearance : Clearance
            As from `clearance`, within 1e-6 m; its time is 0.
        row : int
        """
        if not self._pairs:
            return Clearance(np.inf), 0
        rows = np.empty(np.shape(qs))
        rows[:, self._order] = qs
        factors = levers(self._robot_bodies, self._bodies, self._pairs, np.abs(rows).max(axis=0))
        steps = np.abs(np.diff(rows, axis=0)) @ factors
        travel = np.vstack([np.zeros(len(self._pairs)), np.cumsum(steps, axis=0)])

        def measure(row: int, pair: int) -> float:
            pinocchio.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, rows[row])
            return pinocchio.computeDistance(self._geometry, self._geometry_data, pair).min_distance

        row, pair = smallest(travel, lambda row: self._distances(qs[row]), measure)
        measure(row, pair)
        return self._clearance(pair), row

    def distances(self, q: JointValues) -> list[PairDistance]:
        """Return every checked pair, measured one by one; far slower than `is_free` and `clearance`; parameters as there."""
        found = zip(self._names, self._distances(q), self._pairs)
        return [PairDistance(names, float(distance), margin) for names, distance, (_, _, margin) in found]

    def _measure(self, q: JointValues) -> int:
        """Measure every pair; return the closest one."""
        self._q[self._order] = q
        return pinocchio.computeDistances(self._model, self._data, self._geometry, self._geometry_data, self._q)

    def _distances(self, q: JointValues) -> np.ndarray:
        self._measure(q)
        return np.array([result.min_distance for result in self._geometry_data.distanceResults])

    def _clearance(self, pair: int) -> Clearance:
        """Return the last measurement of a pair."""
        result = self._geometry_data.distanceResults[pair]
        point = self._robot_bodies.root_T_base.actInv(result.getNearestPoint1())
        return Clearance(
            float(result.min_distance), self._names[pair], (float(point[0]), float(point[1]), float(point[2]))
        )


def checked_pairs(
    bodies: Sequence[Body], padding: float, self_collision: SelfCollision
) -> list[tuple[int, int, float]]:
    """Return the pairs of bodies that must not touch, and the distance below which they do.

    Parameters
    ----------
    bodies : sequence of Body
        A robot's, then a scene's.
    padding : float
        The scene's [m].
    self_collision : SelfCollision

    Returns
    -------
    pairs : list of (int, int, float)
        Indices into `bodies`, in the order in which reports name them, and the margin [m].
    """
    pairs: list[tuple[int, int, float]] = []
    for second, other in enumerate(bodies):
        for first, one in enumerate(bodies[:second]):
            if one.joint == other.joint:
                continue
            if other.item is None:
                if not self_collision.ignores(one.owner, other.owner):
                    pairs.append((first, second, 0.0))
            elif one.item is None:
                if one.owner not in other.item.touch:
                    pair = (second, first) if other.link else (first, second)
                    pairs.append((*pair, padding + other.item.padding))
            elif not ({other.owner, other.link} & set(one.item.touch) or {one.owner, one.link} & set(other.item.touch)):
                pair = (first, second) if one.link else (second, first)
                pairs.append((*pair, padding + max(one.item.padding, other.item.padding)))
    return pairs
