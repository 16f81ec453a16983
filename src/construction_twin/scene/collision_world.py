"""Contacts and distances of the arm with itself and with a scene, by Pinocchio and Coal.

Joint values in rad, m for prismatic joints, in the order of ``robot.joint_names``; points in the robot's base_link [m].
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import coal
import numpy as np
import pinocchio

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.plan import Clearance
from construction_twin.scene.collision_bodies import Body, RobotBodies, measured
from construction_twin.scene.distance_bounds import body_levers
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.pair_checks import Contact, PairChecks, PairDistance, checked_pairs, touching_pairs
from construction_twin.scene.self_collision import SelfCollision

#: With more bodies only those are checked that the arm can reach, and of a motion only those that it comes near.
MANY_BODIES = 128
#: So far around the arm bodies are looked for first when a motion's clearance is measured among many [m].
_NEAR = 0.1
#: Worlds of single motions that are kept.
_MOST_WORLDS = 8
#: Poses that differ by no more than this in any joint follow each other as samples of one motion do [rad, m].
_CLOSE = 0.03
#: One pose stands for so many rows; the boxes are larger by the way to the others.
_GROUP = 8


class CollisionWorld:
    """A robot among the objects of a scene; not for use from several threads at once.

    Checked are: links against links, without the pairs of `self_collision` (contact: distance 0 or less); moving links against
    objects, and carried objects against standing ones (contact: within the scene's padding plus the larger padding of the objects);
    carried objects against links that do not move with them. Not checked: an object and what it names in `touch`, and what stands
    against what stands. With more than `MANY_BODIES` bodies those out of the arm's reach are left out, and of a motion those that
    it does not come near.

    `own`: all bodies of robot and scene, or some of them. `only`: nothing but these pairs is checked.
    """

    def __init__(
        self,
        robot: RobotModel | RobotBodies,
        scene: Scene,
        self_collision: SelfCollision,
        own: tuple[Body, ...] | None = None,
        obstacles: tuple[Obstacle, ...] = (),
        only: list[tuple[int, int, float]] | None = None,
    ):
        self._robot_bodies = robot_bodies = robot if isinstance(robot, RobotBodies) else RobotBodies(robot)
        self.robot = robot_bodies.robot
        self.scene = scene
        self.self_collision = self_collision
        if own is None:
            own = (*robot_bodies.bodies, *robot_bodies.place_all(scene))
        self._own, self._obstacles, self._only = own, obstacles, only
        self._nearby_worlds: dict[tuple[float, bytes], CollisionWorld] = {}

    def with_scene(self, scene: Scene) -> CollisionWorld:
        """Return a world with the same robot, and the same other arm, in another scene; faster than building it from the robot."""
        return CollisionWorld(self._robot_bodies, scene, self.self_collision, obstacles=self._obstacles)

    def touching_world(self) -> CollisionWorld | None:
        """Return a world in which only the pairs are checked that `touch` leaves out here, without padding; None: there are none.

        Its `clearance_of` tells how deep bodies are in each other that touch on purpose.
        """
        pairs = touching_pairs(self._own)
        if not pairs:
            return None
        used = sorted({index for pair in pairs for index in pair[:2]})
        number = {index: place for place, index in enumerate(used)}
        pairs = [(number[first], number[second], margin) for first, second, margin in pairs]
        own = tuple(self._own[index] for index in used)
        return CollisionWorld(self._robot_bodies, self.scene, self.self_collision, own, (), pairs)

    def with_neighbour(self, obstacles: Iterable[Obstacle], alone: bool = False) -> CollisionWorld:
        """Return a world with the same robot and scene, and another arm in it; the scene's version stays the same.

        Its bodies are checked against moving links and carried objects (contact: within the scene's padding plus the obstacle's).
        `alone`: nothing but that is checked.
        """
        only: list[tuple[int, int, float]] | None = [] if alone else None
        return CollisionWorld(self._robot_bodies, self.scene, self.self_collision, self._own, tuple(obstacles), only)

    @cached_property
    def _near(self) -> tuple[Body, ...]:
        """The bodies that are checked at all."""
        few = self._only is not None or len(self._own) <= MANY_BODIES
        return self._own if few else self._within_reach(self._own)

    @cached_property
    def _boxes(self) -> NearBodies:
        return NearBodies(self._robot_bodies, self._near)

    @cached_property
    def _checks(self) -> PairChecks:
        """All pairs that are checked; made at the first question, because with many bodies it takes long."""
        own = self._near
        reached, reached_pairs = self._neighbour_pairs(own, self._obstacles)
        bodies = own + tuple(Body(item.owner, "", 0, item.placement, item.geometry) for item in reached)
        only = checked_pairs(own, self.scene.padding, self.self_collision) if self._only is None else self._only
        few = bool(reached) or len(bodies) <= MANY_BODIES
        return PairChecks(self._robot_bodies, bodies, only + reached_pairs, few)

    def _near_motion(self, qs: np.ndarray, gap: float) -> CollisionWorld:
        """Return this world; of many bodies one without what is further than `gap` [m] and paddings from the arm in all rows."""
        if self._only is not None or len(self._near) <= MANY_BODIES:
            return self
        # the same motion is asked about more than once: for contacts, for its clearance
        gap = max(gap, _NEAR)
        key = (gap, np.asarray(qs).tobytes())
        if key in self._nearby_worlds:
            return self._nearby_worlds[key]
        paddings = [body.item.padding for body in self._near if body.item is not None]
        around = gap + self.scene.padding + max(paddings, default=0.0)
        own = tuple(self._near[index] for index in self._boxes.near(self._robot_bodies.rows(qs), around))
        only = checked_pairs(own, self.scene.padding, self.self_collision)
        world = CollisionWorld(self._robot_bodies, self.scene, self.self_collision, own, self._obstacles, only)
        if len(self._nearby_worlds) >= _MOST_WORLDS:
            self._nearby_worlds.clear()
        self._nearby_worlds[key] = world
        return world

    def _within_reach(self, own: tuple[Body, ...]) -> tuple[Body, ...]:
        """Return the bodies, of standing objects those that a moving body may reach at some joint values, by a bound."""
        _, reaches = body_levers(self._robot_bodies, own, self._robot_bodies.strokes)
        paddings = [body.item.padding if body.item is not None else 0.0 for body in own]
        farthest = max((reach for body, reach in zip(own, reaches) if body.joint), default=0.0)
        farthest += self.scene.padding + max(paddings, default=0.0)
        return tuple(
            body
            for body in own
            if body.item is None
            or body.joint
            or np.linalg.norm(body.placement.act(np.array(body.geometry.aabb_center))) - body.geometry.aabb_radius
            <= farthest
        )

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

    @cached_property
    def levers(self) -> np.ndarray:
        """How far any point of the arm, its tool and what it carries moves at most when a joint does, shape (n,) [m/rad], or 1."""
        robot = self._robot_bodies
        moving = [body for body in self._own if body.joint]
        per_body, _ = body_levers(robot, moving, robot.strokes)
        # the last ones first: one that follows may lead another
        for at, leader, factor, _ in reversed(robot.followers):
            per_body[leader] += abs(factor) * per_body[at]
        return per_body.max(axis=1, initial=0.0)[robot.order]

    def is_free(self, q: JointValues) -> bool:
        """Return whether `q`, of any range, is free of contact: the fastest check, it ends at the first one."""
        return self._checks.is_free(q)

    def contact(self, q: JointValues) -> Contact | None:
        """Return a pair that touches, or None where `is_free`."""
        return self._near_motion(np.array([q]), 0.0)._checks.contact(q)

    def contacts(self, q: JointValues) -> list[Contact]:
        """Return every pair of names that touches; slower than `contact`."""
        return self._checks.contacts(q)

    def unchecked_pairs(self) -> list[tuple[SceneObject, str]]:
        """Return the standing objects, each with every link that no joint moves, unless it may touch it."""
        links = dict.fromkeys(body.link for body in self._own if body.item is None and not body.joint)
        standing = (item for item in self.scene.objects if not item.link)
        return [(item, link) for item in standing for link in links if link not in item.touch]

    def distance(self, q: JointValues, first: str, second: str) -> float:
        """Return the smallest distance between the shapes of two links or objects [m], whether the pair is checked or not.

        Negative: how deep one is in the other; inf if one of them has no shape.
        """
        data = self._robot_bodies.model.createData()
        pinocchio.forwardKinematics(self._robot_bodies.model, data, self._robot_bodies.rows(np.array([q]))[0])
        placed: dict[str, list[tuple[coal.CollisionGeometry, coal.Transform3s]]] = {first: [], second: []}
        for body in self._own:
            if body.owner in placed:
                place = data.oMi[body.joint] * body.placement
                placed[body.owner].append((body.geometry, coal.Transform3s(place.rotation, place.translation)))
        found = (measured(*one, *other).min_distance for one in placed[first] for other in placed[second])
        return min(found, default=np.inf)

    def object_pose(self, q: JointValues, name: str) -> Pose:
        """Return an object's pose in the base_link, at joint values `q` when a link carries it; SceneError: there is none."""
        item = self.scene.get(name)
        return product(self.link_pose(q, item.link), item.pose) if item.link else item.pose

    def link_pose(self, q: JointValues, link: str) -> Pose:
        """Return a link's pose in the base_link; see `RobotBodies.link_pose`."""
        return self._robot_bodies.link_pose(q, link)

    def all_free(self, qs: np.ndarray) -> int | None:
        """Return the first row of joint values, shape (m, n), that is in contact, None when none is."""
        world = self
        # poses far from each other come near most objects: all are checked
        if len(self._near) > MANY_BODIES and len(qs) > 1 and float(np.abs(np.diff(qs, axis=0)).max()) <= _CLOSE:
            world = self._near_motion(qs, 0.0)
        return world._checks.first_blocked(qs)

    def clearance(self, q: JointValues, changing: bool = False) -> Clearance:
        """Return the smallest distance of a checked pair, padding not subtracted; inf if no pair is checked.

        `changing`: Only of pairs whose distance some joint changes: the others tell nothing of a pose or a plan.
        """
        return self._checks.clearance(q, changing)

    def first_contact(self, qs: np.ndarray) -> tuple[float, Contact] | None:
        """Return where a motion through rows, shape (m, n), first touches something, and what; None: it does not, anywhere.

        Each joint goes evenly from one row to the next; 3.5 is half way from row 3 to row 4. Free is free by a bound of how far the
        bodies move, not by samples: nothing comes closer than its margin by more than half of `distance_bounds.RESOLUTION` (0.01
        mm).
        """
        world = self._near_motion(qs, 0.0)
        found, doubtful = world._checks.first_contact(self._robot_bodies.rows(qs))
        # what is not in `world` is far from all of the motion
        index = world._checks.first_blocked(qs[doubtful])
        if index is None:
            return found
        contact = world._checks.contact(qs[doubtful[index]])
        assert contact is not None, "first_blocked and contact disagree"
        return float(doubtful[index]), contact

    def clearance_of(self, qs: np.ndarray, changing: bool = False) -> tuple[Clearance, float]:
        """Return the smallest distance over a motion, also between its rows, and its place as of `first_contact`.

        As `clearance` within 1e-4 m or a hundredth of it, whichever is more; its time is 0. Close rows need few measurements.
        """
        gap = _NEAR
        while True:
            world = self._near_motion(qs, gap)
            clearance, place = world._checks.clearance_of(self._robot_bodies.rows(qs), changing)
            # all that was left out is further away than this
            if world is self or clearance.distance <= gap:
                return clearance, place
            gap = clearance.distance

    def distances(self, q: JointValues) -> list[PairDistance]:
        """Return every checked pair, measured one by one; far slower than `is_free` and `clearance`."""
        return self._checks.distances(q)


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
