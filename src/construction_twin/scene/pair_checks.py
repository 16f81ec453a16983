"""The pairs of bodies that must not touch, and the questions to Pinocchio and Coal about them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np
import pinocchio

from construction_twin.robot.description import JointValues
from construction_twin.robot.plan import Clearance
from construction_twin.scene.collision_bodies import UNKNOWN, Body, RobotBodies, configure_coal, measured
from construction_twin.scene.distance_bounds import Motion, Travel, pair_levers
from construction_twin.scene.self_collision import SelfCollision

#: Pinocchio's broad phases: for few bodies, comparing one box around each group of bodies that move together, then every box with
#: every box, is fastest; for many bodies, a tree.
_FEW = pinocchio.TreeBroadPhaseManager_NaiveCollisionManager
_MANY = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager
#: At so many poses a pair is measured before its distance counts as one that no joint changes, and what is a change [m].
_POSES, _CHANGE = 64, 1e-3


@dataclass(frozen=True)
class Contact:
    """Two bodies that touch, or are closer than the padding: a link or a carried object first, then a link or an object."""

    between: tuple[str, str]


@dataclass(frozen=True)
class PairDistance:
    """How far two bodies are from each other [m]; at the margin or less they are in contact."""

    between: tuple[str, str]
    distance: float
    margin: float


class PairChecks:
    """Pinocchio's model of the pairs that are checked, and the questions to it; arguments as those of `CollisionWorld`."""

    def __init__(self, robot: RobotBodies, bodies: tuple[Body, ...], pairs: list[tuple[int, int, float]], few: bool):
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
        configure_coal(self._geometry_data, [margin for _, _, margin in pairs])
        self._margins = np.array([margin for _, _, margin in pairs])
        self._q = np.zeros(robot.size)
        self._last: tuple[bytes, Motion] | None = None
        self._steady: dict[int, bool] = {}
        # for the usual order a slice suffices; an index list would cost as much as the check of a few pairs
        self._order = slice(None) if np.array_equal(robot.order, np.arange(robot.size)) else robot.order
        self._follow = robot.follow if robot.followers else None
        self._as_given = isinstance(self._order, slice) and self._follow is None
        # one call per question: boxes around the bodies first, shapes only where the boxes overlap
        manager = _FEW if few else _MANY
        self._broad_phase = manager(self._model, self._geometry, self._geometry_data)

    def is_free(self, q: JointValues) -> bool:
        """Return whether nothing touches."""
        self._place_bodies(q)
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
        self._place_bodies(q)
        pinocchio.computeCollisions(self._model, self._data, self._geometry, self._geometry_data, self._q, False)
        results = zip(self._names, self._geometry_data.collisionResults)
        return [Contact(names) for names in dict.fromkeys(names for names, result in results if result.isCollision())]

    def clearance(self, q: JointValues, changing: bool) -> Clearance:
        """Return the smallest distance of a pair."""
        self._place_bodies(q)
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
        return distance if distance > UNKNOWN else self._reliable_distance(pair)

    def _touches(self, rows: np.ndarray, place: float, pair: int) -> bool:
        self._place(rows, place)
        return pinocchio.computeCollision(self._geometry, self._geometry_data, pair)

    def distances(self, q: JointValues) -> list[PairDistance]:
        """Return every pair, measured."""
        self._place_bodies(q)
        found = zip(self._names, self._distances(self._q), self._pairs)
        return [PairDistance(names, float(distance), margin) for names, distance, (_, _, margin) in found]

    def _place_bodies(self, q: JointValues) -> None:
        self._q[self._order] = q
        if self._follow is not None:
            self._follow(self._q)

    def _distances(self, row: np.ndarray) -> np.ndarray:
        pinocchio.computeDistances(self._model, self._data, self._geometry, self._geometry_data, row)
        found = np.array([result.min_distance for result in self._geometry_data.distanceResults])
        for pair in np.flatnonzero(found <= UNKNOWN):
            found[pair] = self._reliable_distance(int(pair))
        return found

    def _reliable_distance(self, pair: int) -> float:
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
