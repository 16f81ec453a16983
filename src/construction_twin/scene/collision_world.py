"""Contacts and distances of the arm with itself and with everything in the scene, by Pinocchio and Coal.

Joint values in rad (m for prismatic joints), in the order of ``robot.joint_names``; points in the robot's base_link [m].
A world belongs to one scene; a changed scene needs a new world (`CollisionWorld.with_scene`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np
import pinocchio

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.plan import Clearance
from construction_twin.scene.collision_bodies import UNKNOWN, Body, RobotBodies, make_reliable, measured
from construction_twin.scene.distance_bounds import Motion, Travel, body_levers, pair_levers
from construction_twin.scene.near_bodies import NearBodies
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.self_collision import SelfCollision

#: Pinocchio's broad phases: for few bodies, comparing one box around each group of bodies that move together, then every box with
#: every box, is fastest; for many bodies, a tree.
_FEW = pinocchio.TreeBroadPhaseManager_NaiveCollisionManager
_MANY = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager
MANY_BODIES = 128
#: So far around the arm bodies are looked for first when a motion's clearance is measured among many [m].
_NEAR = 0.1
#: Worlds of single motions that are kept.
_KEPT = 8
#: Poses that differ by no more than this in any joint follow each other as samples of one motion do [rad, m].
_CLOSE = 0.03
#: At so many poses a pair is measured before its distance counts as one that no joint changes, and what is a change [m].
_POSES, _CHANGE = 64, 1e-3


@dataclass(frozen=True)
class Contact:
    """Two bodies that touch, or are closer than the padding.

    `between`: Length 2. A link or a carried object first, then a link or an object.
    """

    between: tuple[str, str]


@dataclass(frozen=True)
class PairDistance:
    """How far two bodies are from each other [m]; at the margin or less they are in contact."""

    between: tuple[str, str]
    distance: float
    margin: float


class CollisionWorld:
    """A robot among the objects of a scene.

    Checked are: links against links, without the pairs that `self_collision` leaves out (contact: distance 0 or less);
    moving links against objects, and carried objects against standing ones (contact: distance within the scene's padding
    plus the larger padding of the objects); carried objects against links, without those that move with them. Not
    checked are an object and what it names in `touch`. Links and objects that do not move are not checked against each
    other: the pedestal stands on the floor. With more than `MANY_BODIES` bodies, standing objects that the arm cannot reach are
    left out of all checks and clearances: a building beyond it costs nothing. A motion among so many is checked against the
    standing objects whose boxes it comes near; the others cannot touch it.

    Not for use from several threads at once: it works in buffers of its own.
    """

    def __init__(self, robot: RobotModel, scene: Scene, self_collision: SelfCollision):
        self._build(RobotBodies(robot), scene, self_collision)

    def with_scene(self, scene: Scene) -> CollisionWorld:
        """Return a world with the same robot, and the same other arm, in another scene; faster than building it from the robot."""
        world = object.__new__(CollisionWorld)
        world._build(self._robot_bodies, scene, self.self_collision, obstacles=self._obstacles)
        return world

    def of_touching(self) -> CollisionWorld | None:
        """Return a world in which only the pairs are checked that `touch` leaves out here; None: there are none.

        Its padding is nothing: two bodies are in contact when one is in the other, and `clearance_of` tells how deep. For whoever
        lets bodies touch on purpose, and wants to know that they do no more than that.
        """
        pairs = touching_pairs(self._own)
        if not pairs:
            return None
        used = sorted({index for pair in pairs for index in pair[:2]})
        number = {index: place for place, index in enumerate(used)}
        pairs = [(number[first], number[second], margin) for first, second, margin in pairs]
        world = object.__new__(CollisionWorld)
        world._build(
            self._robot_bodies, self.scene, self.self_collision, tuple(self._own[index] for index in used), (), pairs
        )
        return world

    def with_neighbour(self, obstacles: Iterable[Obstacle], alone: bool = False) -> CollisionWorld:
        """Return a world with the same robot and scene, and another arm in it; the scene's version stays the same.

        Moving links and carried objects are checked against its bodies (contact: distance within the scene's padding plus the
        obstacle's). Bodies that do not move are not checked. `alone`: Check nothing but that.
        """
        world = object.__new__(CollisionWorld)
        only: list[tuple[int, int, float]] | None = [] if alone else None
        world._build(self._robot_bodies, self.scene, self.self_collision, self._own, tuple(obstacles), only)
        return world

    def _build(
        self,
        robot_bodies: RobotBodies,
        scene: Scene,
        self_collision: SelfCollision,
        own: tuple[Body, ...] | None = None,
        obstacles: tuple[Obstacle, ...] = (),
        only: list[tuple[int, int, float]] | None = None,
    ) -> None:
        self.robot = robot_bodies.robot
        self.scene = scene
        self.self_collision = self_collision
        self._robot_bodies = robot_bodies
        if own is None:
            own = (*robot_bodies.bodies, *robot_bodies.place_all(scene))
        self._own, self._obstacles, self._only = own, obstacles, only
        self._kept: dict[tuple[float, bytes], CollisionWorld] = {}

    @cached_property
    def _near(self) -> tuple[Body, ...]:
        """The bodies that are checked at all."""
        few = self._only is not None or len(self._own) <= MANY_BODIES
        return self._own if few else self._within_reach(self._own)

    @cached_property
    def _boxes(self) -> NearBodies:
        return NearBodies(self._robot_bodies, self._near)

    @cached_property
    def _checks(self) -> _Checks:
        """All pairs that are checked; made at the first question, because with many bodies it takes long."""
        own = self._near
        reached, reached_pairs = self._neighbour_pairs(own, self._obstacles)
        bodies = own + tuple(Body(item.owner, "", 0, item.placement, item.geometry) for item in reached)
        only = checked_pairs(own, self.scene.padding, self.self_collision) if self._only is None else self._only
        return _Checks(self._robot_bodies, bodies, only + reached_pairs, bool(reached))

    def _beside(self, qs: np.ndarray, gap: float) -> CollisionWorld:
        """Return a world without the standing objects that stay further than `gap` [m] and the paddings from the arm in all rows.

        With few bodies it is this one.
        """
        if self._only is not None or len(self._near) <= MANY_BODIES:
            return self
        # the same motion is asked about more than once: for contacts, for its clearance
        gap = max(gap, _NEAR)
        key = (gap, np.asarray(qs).tobytes())
        if key in self._kept:
            return self._kept[key]
        paddings = [body.item.padding for body in self._near if body.item is not None]
        around = gap + self.scene.padding + max(paddings, default=0.0)
        own = tuple(self._near[index] for index in self._boxes.near(self._rows(qs), around))
        only = checked_pairs(own, self.scene.padding, self.self_collision)
        world = object.__new__(CollisionWorld)
        world._build(self._robot_bodies, self.scene, self.self_collision, own, self._obstacles, only)
        if len(self._kept) >= _KEPT:
            self._kept.clear()
        self._kept[key] = world
        return world

    def _rows(self, qs: np.ndarray) -> np.ndarray:
        """Return rows of joint values in Pinocchio's order."""
        return self._robot_bodies.rows(qs)

    def _within_reach(self, own: tuple[Body, ...]) -> tuple[Body, ...]:
        """Return the bodies without the standing objects that no moving body reaches at any joint values, by a bound."""
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
        """How far any point of the arm, its tool and what it carries moves at most when a joint does, shape (n,).

        [m/rad] for a revolute joint, 1 for a prismatic one; an upper bound at any joint values, from the lengths of the chain. A
        joint that others follow moves what they move, too.
        """
        robot = self._robot_bodies
        moving = [body for body in self._own if body.joint]
        per_body, _ = body_levers(robot, moving, robot.strokes)
        # the last ones first: one that follows may lead another
        for at, leader, factor, _ in reversed(robot.followers):
            per_body[leader] += abs(factor) * per_body[at]
        return per_body.max(axis=1, initial=0.0)[robot.order]

    def is_free(self, q: JointValues) -> bool:
        """Return whether nothing touches; `q` is not checked against the ranges. The fastest check: it ends at the first one."""
        return self._checks.is_free(q)

    def contact(self, q: JointValues) -> Contact | None:
        """Return a pair that touches, or None where `is_free`."""
        return self._beside(np.array([q]), 0.0)._checks.contact(q)

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
        pinocchio.forwardKinematics(self._robot_bodies.model, data, self._rows(np.array([q]))[0])
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
            world = self._beside(qs, 0.0)
        return world._checks.first_blocked(qs)

    def clearance(self, q: JointValues, changing: bool = False) -> Clearance:
        """Return the smallest distance of a checked pair; the padding is not subtracted; inf if no pair is checked.

        Args:
            changing: Only of pairs whose distance some joint changes. A link that turns about an upright axis stays as far from the
                floor as it is: that tells nothing of a pose or a plan.
        """
        return self._checks.clearance(q, changing)

    def first_contact(self, qs: np.ndarray) -> tuple[float, Contact] | None:
        """Return where a motion through rows, shape (m, n), first touches something, and what; None: it does not, anywhere.

        Each joint goes evenly from one row to the next; 3.5 is half way from row 3 to row 4. What is found free is free by a bound
        of how far the bodies move, not by samples: nothing comes closer than its margin by more than half of
        `distance_bounds.RESOLUTION` (0.01 mm).
        """
        world = self._beside(qs, 0.0)
        found, doubtful = world._checks.first_contact(self._rows(qs))
        # what is not in `world` is far from all of the motion
        index = world._checks.first_blocked(qs[doubtful])
        if index is None:
            return found
        contact = world._checks.contact(qs[doubtful[index]])
        assert contact is not None, "first_blocked and contact disagree"
        return float(doubtful[index]), contact

    def clearance_of(self, qs: np.ndarray, changing: bool = False) -> tuple[Clearance, float]:
        """Return the smallest distance over a motion, also between its rows, and its place as of `first_contact`.

        It is as from `clearance`, within 1e-4 m or a hundredth of it, whichever is more; its time is 0. Successive rows should be
        close to each other: then only few distances need to be measured, see `distance_bounds`.
        """
        gap = _NEAR
        while True:
            world = self._beside(qs, gap)
            clearance, place = world._checks.clearance_of(self._rows(qs), changing)
            # all that was left out is further away than this
            if world is self or clearance.distance <= gap:
                return clearance, place
            gap = clearance.distance

    def distances(self, q: JointValues) -> list[PairDistance]:
        """Return every checked pair, measured one by one; far slower than `is_free` and `clearance`."""
        return self._checks.distances(q)


class _Checks:
    """Pinocchio's model of the pairs that are checked, and the questions to it; arguments as those of `CollisionWorld`."""

    def __init__(
        self, robot: RobotBodies, bodies: tuple[Body, ...], pairs: list[tuple[int, int, float]], neighbour: bool
    ):
        self._robot, self._bodies, self._pairs = robot, bodies, pairs
        self._names = [(bodies[first].owner, bodies[second].owner) for first, second, _ in pairs]
        self._model = robot.model
        self._geometry = pinocchio.GeometryModel()
        for index, body in enumerate(bodies):
            shape = pinocchio.GeometryObject(f"{index}", body.joint, body.placement, body.geometry)
            self._geometry.addGeometryObject(shape)
        for first, second, _ in pairs:
            self._geometry.addCollisionPair(pinocchio.CollisionPair(first, second))
        self._data = self._model.createData()
        self._geometry_data = self._geometry.createData()
        make_reliable(self._geometry_data, [margin for _, _, margin in pairs])
        self._margins = np.array([margin for _, _, margin in pairs])
        self._q = np.zeros(robot.size)
        self._last: tuple[bytes, Motion] | None = None
        self._steady: dict[int, bool] = {}
        # for the usual order a slice suffices; an index list would cost as much as the check of a few pairs
        self._order = slice(None) if np.array_equal(robot.order, np.arange(robot.size)) else robot.order
        self._follow = robot.follow if robot.followers else None
        self._as_given = isinstance(self._order, slice) and self._follow is None
        # one call per question: boxes around the bodies first, shapes only where the boxes overlap
        manager = _FEW if neighbour or len(bodies) <= MANY_BODIES else _MANY
        self._broad_phase = manager(self._model, self._geometry, self._geometry_data)

    def is_free(self, q: JointValues) -> bool:
        """Return whether nothing touches."""
        self._take(q)
        return not pinocchio.computeCollisions(self._model, self._data, self._broad_phase, self._q, True)

    def first_blocked(self, qs: np.ndarray) -> int | None:
        """Return the first row in which something touches, None when nothing does."""
        rows = np.ascontiguousarray(qs, dtype=np.float64) if self._as_given else self._robot.rows(qs)
        collides, checked = pinocchio.computeCollisions, (self._model, self._data, self._broad_phase)
        for row, q in enumerate(rows):
            if collides(*checked, q, True):
                return row
        return None

    def contact(self, q: JointValues) -> Contact | None:
        """Return a pair that touches, or None."""
        if self.is_free(q):
            return None
        # once more, from results of which none is an earlier pose's
        for result in self._geometry_data.collisionResults:
            result.clear()
        self.is_free(q)
        for names, result in zip(self._names, self._geometry_data.collisionResults):
            if result.isCollision():
                return Contact(names)
        raise AssertionError("a contact without a pair")

    def contacts(self, q: JointValues) -> list[Contact]:
        """Return every pair of names that touches."""
        self._take(q)
        pinocchio.computeCollisions(self._model, self._data, self._geometry, self._geometry_data, self._q, False)
        results = zip(self._names, self._geometry_data.collisionResults)
        return [Contact(names) for names in dict.fromkeys(names for names, result in results if result.isCollision())]

    def clearance(self, q: JointValues, changing: bool) -> Clearance:
        """Return the smallest distance of a pair."""
        self._take(q)
        row = self._q.copy()
        for pair in np.argsort(self._distances(row), kind="stable").tolist():
            if not changing:
                return self._clearance(pair)
            if not self._is_steady(pair):
                # that question may have moved the bodies
                self._measure_pair(row[None], 0.0, pair)
                return self._clearance(pair)
        return Clearance(np.inf)

    def first_contact(self, rows: np.ndarray) -> tuple[tuple[float, Contact] | None, np.ndarray]:
        """Return where two bodies first touch on a motion, rows in Pinocchio's order, and which; also what `Motion` leaves open."""
        if not self._pairs:
            return None, np.empty(0, dtype=int)
        found, doubtful = self._motion(rows).first_contact(
            self._margins, lambda place, pair: self._touches(rows, place, pair)
        )
        return None if found is None else (found[0], Contact(self._names[found[1]])), doubtful

    def clearance_of(self, rows: np.ndarray, changing: bool) -> tuple[Clearance, float]:
        """Return the smallest distance of a pair on a motion through rows in Pinocchio's order, and its place."""
        steady = [pair for pair, known in self._steady.items() if known] if changing else []
        while len(steady) < len(self._pairs):
            place, pair = self._motion(rows).smallest(steady)
            if changing and self._is_steady(pair):
                steady.append(pair)
                continue
            self._measure_pair(rows, place, pair)
            return self._clearance(pair), place
        return Clearance(np.inf), 0.0

    def _is_steady(self, pair: int) -> bool:
        """Return whether a pair is as far from each other at all joint values; kept, because it costs many measurements."""
        if pair not in self._steady:
            robot = self._robot.robot
            # the same poses each time; joints without an end have turned once
            samples = np.random.default_rng(0).uniform(robot.lower, robot.upper, (_POSES, len(robot.lower)))
            rows = self._robot.rows(samples)
            first = self._measure_pair(rows, 0.0, pair)
            self._steady[pair] = all(
                abs(self._measure_pair(rows, float(row), pair) - first) <= _CHANGE for row in range(1, _POSES)
            )
        return self._steady[pair]

    def _motion(self, rows: np.ndarray) -> Motion:
        """Return a motion's bounds; the last one is kept, because it is asked for its contacts, then for its clearance."""
        key = rows.tobytes()
        if self._last is None or self._last[0] != key:
            motion = Motion(
                Travel(rows, self._levers),
                len(rows) - 1,
                len(self._pairs),
                lambda places, pairs: self._measure(rows, places, pairs),
            )
            self._last = key, motion
        return self._last[1]

    @cached_property
    def _levers(self) -> np.ndarray:
        return pair_levers(self._robot, self._bodies, self._pairs)

    def _measure(self, rows: np.ndarray, places: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return the distances of some pairs, each at a place on a motion [m]."""
        distances, placed = np.empty(len(places)), -1.0
        for index in np.argsort(places, kind="stable").tolist():
            place, pair = float(places[index]), int(pairs[index])
            if place != placed:
                self._place(rows, place)
                placed = place
            distances[index] = self._measure_placed(pair)
        return distances

    def _place(self, rows: np.ndarray, place: float) -> None:
        """Move the bodies to a place on a motion."""
        row = int(place)
        q = rows[row] if row == place else rows[row] + (place - row) * (rows[row + 1] - rows[row])
        pinocchio.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)

    def _measure_pair(self, rows: np.ndarray, place: float, pair: int) -> float:
        self._place(rows, place)
        return self._measure_placed(pair)

    def _measure_placed(self, pair: int) -> float:
        """Return the distance of a pair where the bodies are now [m]."""
        distance = pinocchio.computeDistance(self._geometry, self._geometry_data, pair).min_distance
        return distance if distance > UNKNOWN else self._known(pair)

    def _touches(self, rows: np.ndarray, place: float, pair: int) -> bool:
        self._place(rows, place)
        return pinocchio.computeCollision(self._geometry, self._geometry_data, pair)

    def distances(self, q: JointValues) -> list[PairDistance]:
        """Return every pair, measured."""
        self._take(q)
        found = zip(self._names, self._distances(self._q), self._pairs)
        return [PairDistance(names, float(distance), margin) for names, distance, (_, _, margin) in found]

    def _take(self, q: JointValues) -> None:
        self._q[self._order] = q
        if self._follow is not None:
            self._follow(self._q)

    def _distances(self, row: np.ndarray) -> np.ndarray:
        pinocchio.computeDistances(self._model, self._data, self._geometry, self._geometry_data, row)
        found = np.array([result.min_distance for result in self._geometry_data.distanceResults])
        for pair in np.flatnonzero(found <= UNKNOWN):
            found[pair] = self._known(int(pair))
        return found

    def _known(self, pair: int) -> float:
        """Return the last measurement of a pair; one that Coal could not make is made beside there, and kept."""
        result = self._geometry_data.distanceResults[pair]
        if result.min_distance <= UNKNOWN:
            first, second, _ = self._pairs[pair]
            one, other = (
                (self._bodies[body].geometry, coal.Transform3s(place.rotation, place.translation))
                for body, place in ((index, self._geometry_data.oMg[index]) for index in (first, second))
            )
            self._geometry_data.distanceResults[pair] = measured(*one, *other)
        return self._geometry_data.distanceResults[pair].min_distance

    def _clearance(self, pair: int) -> Clearance:
        """Return the last measurement of a pair."""
        result = self._geometry_data.distanceResults[pair]
        point = self._robot.root_T_base.actInv(result.getNearestPoint1())
        return Clearance(
            float(result.min_distance), self._names[pair], (float(point[0]), float(point[1]), float(point[2]))
        )


def checked_pairs(
    bodies: Sequence[Body], padding: float, self_collision: SelfCollision
) -> list[tuple[int, int, float]]:
    """Return the pairs of bodies that must not touch: indices, in the order in which reports name them, and the margin [m]."""
    pairs: list[tuple[int, int, float]] = []
    for first, second in _moving_pairs(bodies):
        one, other = bodies[first], bodies[second]
        if other.item is None:
            if not self_collision.ignores(one.owner, other.owner):
                pairs.append((first, second, 0.0))
        elif not _may_touch(one, other):
            pair = (second, first) if _carried_first(one, other) else (first, second)
            own = one.item.padding if one.item is not None else 0.0
            pairs.append((*pair, padding + max(own, other.item.padding)))
    return pairs


def touching_pairs(bodies: Sequence[Body]) -> list[tuple[int, int, float]]:
    """Return the pairs that `checked_pairs` leaves out because one of two names the other in `touch`; same form, margin 0."""
    return [
        (second, first, 0.0) if _carried_first(bodies[first], bodies[second]) else (first, second, 0.0)
        for first, second in _moving_pairs(bodies)
        if bodies[second].item is not None and _may_touch(bodies[first], bodies[second])
    ]


def _moving_pairs(bodies: Sequence[Body]) -> Iterator[tuple[int, int]]:
    """Yield the pairs of bodies that can move relative to each other, robot first, in the order of the second, then the first."""
    moving: list[int] = []
    for second, other in enumerate(bodies):
        # what stands is only near to what moves: with many objects this is a small part of all pairs
        for first in range(second) if other.joint else moving:
            if bodies[first].joint != other.joint:
                yield first, second
        if other.joint:
            moving.append(second)


def _may_touch(one: Body, other: Body) -> bool:
    """Return whether `touch` of one names the other; `other` is an object."""
    assert other.item is not None
    if one.item is None:
        return one.owner in other.item.touch
    return bool({other.owner, other.link} & set(one.item.touch) or {one.owner, one.link} & set(other.item.touch))


def _carried_first(one: Body, other: Body) -> bool:
    """Return whether reports name the second body of a pair first: what is carried before what it could touch."""
    return bool(other.link) if one.item is None else not one.link
