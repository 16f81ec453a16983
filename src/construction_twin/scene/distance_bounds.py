"""The smallest of many distances on a motion, and the first contact, found without measuring all of them.

Between two poses the distance of two bodies changes by at most the motion of the bodies, which bounds the distances between two
measured poses: in all rows between them, and in all that lies between two rows. Metres and radians; rows of joint values in
Pinocchio's order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.scene.collision_bodies import Body, RobotBodies

#: Accuracy of a measured distance [m]: Coal's own tolerance.
TOLERANCE = 1e-6
#: A smallest distance may be larger than the smallest there is by so much [m], or by this part of it if that is more: a body that
#: turns beside another at a constant distance would take hundreds of measurements a row.
ACCURACY, ACCURACY_PART = 1e-4, 0.01
#: A contact is sought in ever shorter parts of a motion, until no point of a pair moves further than this [m].
RESOLUTION = 2e-5
#: A stretch between two rows is divided no nearer to its ends than this part of it.
_EDGE = 0.1
#: Every so many rows all pairs are measured before the search begins.
_STRIDE = 256
#: One pose stands for so many rows; the levers are larger by the way to the others.
_GROUP = 8
#: So many stretches are divided together, those first where most is to be expected.
_TOGETHER = 64
#: Accuracy of a distance from an axis, which is computed from a difference of squares [m].
_ROUNDING = 1e-6


class PairLevers:
    """How far the two bodies of each pair can move relative to each other, on any motion.

    Args:
        pairs: Their first two entries are indices into `bodies`.
    """

    def __init__(self, robot: RobotBodies, bodies: Sequence[Body], pairs: Sequence[tuple]):
        model = robot.model
        self._robot = robot
        self._moving = [body for body in bodies if body.joint]
        self._largest, _ = body_levers(robot, self._moving, robot.strokes)
        self._centres = np.array([body.placement.act(np.array(body.geometry.aabb_center)) for body in self._moving])
        self._radii = np.array([body.geometry.aabb_radius for body in self._moving])
        self._joints = np.array([body.joint for body in self._moving], dtype=int)
        self._linear = np.zeros(model.nq, dtype=bool)
        self._axes = np.zeros((model.nq, 3))
        self._of_place = np.zeros(model.nq, dtype=int)
        for joint, axis, linear in robot.joint_axes:
            place = model.joints[joint].idx_q
            self._axes[place], self._linear[place], self._of_place[place] = axis, linear, joint
        # the column after those of the moving bodies is that of all that stands
        columns = np.cumsum([body.joint > 0 for body in bodies]) - 1
        columns[[not body.joint for body in bodies]] = len(self._moving)
        below = np.zeros((len(bodies), model.nq), dtype=bool)
        for index, body in enumerate(bodies):
            below[index, sorted(_joints_below(robot, body))] = True
        first, second = np.array([(pair[0], pair[1]) for pair in pairs], dtype=int).reshape(-1, 2).T
        # a joint that moves both bodies moves them together
        apart = below[first] ^ below[second]
        self._columns = columns[first], columns[second]
        self._moves = apart & below[first], apart & below[second]

    def travel(self, rows: np.ndarray) -> Travel:
        """Return the travel of all pairs on a motion, each joint going evenly from one row to the next.

        Args:
            rows: Shape (m, n). Joint values, Pinocchio's order.
        """
        steps = np.abs(np.diff(rows, axis=0))
        way = np.vstack([np.zeros(rows.shape[1]), np.cumsum(steps, axis=0)])
        first = np.arange(0, max(1, len(rows) - 1), _GROUP)
        # up to the first row of the next group: what lies between the two is covered, too
        last = np.minimum(first + _GROUP, len(rows) - 1)
        middle = (first + last) // 2
        aside = np.maximum(way[middle] - way[first], way[last] - way[middle])
        levers = self._levers(rows[middle], aside)
        moved = np.zeros((len(rows), len(self._moving) + 1, rows.shape[1]))
        group = np.arange(len(rows) - 1) // _GROUP
        np.cumsum(steps[:, None, :] * levers[group], axis=0, out=moved[1:, :-1])
        return Travel(moved, self._columns, self._moves)

    def _levers(self, rows: np.ndarray, aside: np.ndarray) -> np.ndarray:
        """Return how far any point of a moving body moves at most per unit of each joint, near some poses.

        Args:
            rows: Shape (g, n).
            aside: Shape (g, n). So far each joint may be from there.

        Returns:
            Shape (g, b, n). [m/rad], or 1 for prismatic joints.
        """
        rotations, positions = self._robot.joint_places(rows)
        centres = (rotations[:, self._joints] @ self._centres[:, :, None])[..., 0] + positions[:, self._joints]
        axes = (rotations[:, self._of_place] @ self._axes[:, :, None])[..., 0]
        offsets = centres[:, :, None] - positions[:, None, self._of_place]
        along = np.einsum("gbnx,gnx->gbn", offsets, axes)
        squares = np.einsum("gbnx,gbnx->gbn", offsets, offsets) - along**2
        levers = np.sqrt(np.maximum(squares, 0.0)) + (self._radii[:, None] + _ROUNDING)
        # neither the body nor the axis is further from where it is at that pose than the joints can have carried it
        levers += (aside @ self._largest)[:, :, None]
        return np.where(self._linear, 1.0, np.minimum(levers, self._largest.T))


@dataclass(frozen=True, eq=False)
class Travel:
    """For each pair, an upper bound of the relative motion of its bodies from the first row on.

    Attributes:
        moved: Shape (m, b + 1, n). How far a point of each body has been carried by each joint up to each row [m]; the last body
            stands.
        columns: For both bodies of each pair, shape (p,): their place in `moved`.
        moves: For both bodies of each pair, shape (p, n): the joints that move this one and not the other.
    """

    moved: np.ndarray
    columns: tuple[np.ndarray, np.ndarray]
    moves: tuple[np.ndarray, np.ndarray]

    @property
    def rows(self) -> int:
        """Number of rows of the motion."""
        return len(self.moved)

    def at(self, places: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return the travel of some pairs, each up to a place [m], shape (k,).

        Args:
            places, pairs: Shape (k,).
        """
        row = places.astype(int)
        after, part = np.minimum(row + 1, len(self.moved) - 1), (places - row)[:, None]
        total = np.zeros(len(places))
        for columns, moves in zip(self.columns, self.moves):
            column = columns[pairs]
            low, high = self.moved[row, column], self.moved[after, column]
            total += np.einsum("kn,kn->k", low + part * (high - low), moves[pairs])
        return total


def body_levers(robot: RobotBodies, bodies: Sequence[Body], strokes: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Return bounds of the motion of a body's points per unit of each joint, and of their distance from the root.

    Args:
        strokes: Shape (size,). As of `levers`.

    Returns:
        levers: Shape (size, b). [m/rad], or 1 for prismatic joints; Pinocchio's order. 0 for a joint that does not move the body.
        reaches: Length b. Largest distance of any point of it from the root at any joint values [m].
    """
    model = robot.model
    per_body = np.zeros((model.nq, len(bodies)))
    reaches = []
    for column, body in enumerate(bodies):
        body.geometry.computeLocalAABB()
        centre = body.placement.act(np.array(body.geometry.aabb_center))
        distance = float(np.linalg.norm(centre)) + body.geometry.aabb_radius
        joint = body.joint
        while joint:
            index = model.joints[joint].idx_q
            linear = model.joints[joint].shortname().startswith("JointModelP")
            per_body[index, column] = 1.0 if linear else distance
            distance += float(np.linalg.norm(model.jointPlacements[joint].translation)) + linear * strokes[index]
            joint = model.parents[joint]
        reaches.append(distance)
    return per_body, reaches


def _joints_below(robot: RobotBodies, body: Body) -> set[int]:
    """Return the places, in Pinocchio's configuration, of the joints that move a body."""
    model, joint, places = robot.model, body.joint, set()
    while joint:
        places.add(model.joints[joint].idx_q)
        joint = model.parents[joint]
    return places


class Motion:
    """The motion of many pairs through rows of joint values, each joint going evenly from one row to the next.

    A place on it is a number of rows: 3.5 is half way from row 3 to row 4. What was measured for one question serves the next.

    Args:
        pairs: Their number, at least 1.
        measure_row: Returns the distances of all pairs in a row, shape (p,) [m].
        measure: Returns the distances of some pairs, each at a place [m]: ``measure(places, pairs)``, arrays of shape (k,).
    """

    def __init__(
        self,
        travel: Travel,
        pairs: int,
        measure_row: Callable[[int], np.ndarray],
        measure: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ):
        self._travel, self._measure, self._count = travel, measure, pairs
        rows = np.unique(np.linspace(0, travel.rows - 1, 1 + -(-travel.rows // _STRIDE)).astype(int))
        known = np.array([measure_row(int(row)) for row in rows])
        # all that was measured, and the stretches between
        self._places = np.repeat(rows.astype(float), pairs)
        self._pairs = np.tile(np.arange(pairs), len(rows))
        self._distances = known.ravel()
        moved = travel.at(self._places, self._pairs)
        self._gaps = _Gaps(
            self._pairs[pairs:], self._places[:-pairs], self._places[pairs:], known[:-1].ravel(), known[1:].ravel(),
            moved[:-pairs], moved[pairs:],
        )  # fmt: skip

    def smallest(self, without: Sequence[int] = ()) -> tuple[float, int]:
        """Find the smallest distance of all pairs anywhere on the motion.

        Args:
            without: Pairs that are left out; not all of them.

        Returns:
            place
            pair: Where the smallest distance is. No other is smaller by more than `ACCURACY` or `ACCURACY_PART` of it.
        """
        wanted = np.ones(self._count, dtype=bool)
        wanted[list(without)] = False
        while True:
            distances = np.where(wanted[self._pairs], self._distances, math.inf)
            closest = int(np.argmin(distances))
            best, gaps = float(distances[closest]), self._gaps
            below = best - max(ACCURACY, ACCURACY_PART * best)
            chosen = np.flatnonzero((gaps.bounds < below) & wanted[gaps.pairs])
            if not len(chosen):
                return float(self._places[closest]), int(self._pairs[closest])
            self._divide(_first_of(chosen, gaps.bounds[chosen]))

    def first_contact(
        self, margins: np.ndarray, touches: Callable[[float, int], bool]
    ) -> tuple[tuple[float, int] | None, bool]:
        """Find where two bodies first touch.

        Args:
            margins: Shape (p,). At this distance or less two bodies touch [m].
            touches: Whether a pair touches at a place, asked where the distance says so: ``touches(place, pair)``.

        Returns:
            first: Place and pair; None: none do anywhere on the motion. No contact is earlier, except one during which no point
                of a pair moves further than `RESOLUTION`: two bodies then come closer than the margin by no more than half of
                that.
            apart: Nothing touches, and the bounds leave no place for such an exception either.
        """
        first: tuple[float, int] | None = None
        asked, clear = 0, True
        limits = margins + TOLERANCE
        while True:
            within = asked + np.flatnonzero(self._distances[asked:] <= limits[self._pairs[asked:]])
            asked = len(self._distances)
            for index in within[np.argsort(self._places[within], kind="stable")].tolist():
                clear = False
                place, pair = float(self._places[index]), int(self._pairs[index])
                if (first is None or place < first[0]) and touches(place, pair):
                    first = place, pair
            gaps = self._gaps
            open_ = gaps.bounds < limits[gaps.pairs]
            if first is not None:
                open_ &= gaps.lows < first[0]
            chosen = np.flatnonzero(open_ & (gaps.ways > RESOLUTION))
            if not len(chosen):
                return first, clear and not open_.any()
            # earlier ones first: a contact that is found ends the search of all that comes later
            self._divide(_first_of(chosen, gaps.lows[chosen]))

    def _divide(self, chosen: np.ndarray) -> None:
        """Measure somewhere within stretches, and put their two parts in their place."""
        gap = self._gaps.some(chosen)
        places = gap.middles()
        distances, moved = self._measure(places, gap.pairs), self._travel.at(places, gap.pairs)
        self._places = np.concatenate((self._places, places))
        self._pairs = np.concatenate((self._pairs, gap.pairs))
        self._distances = np.concatenate((self._distances, distances))
        self._gaps.replace(
            chosen,
            _Gaps(gap.pairs, gap.lows, places, gap.at_lows, distances, gap.moved_lows, moved),
            _Gaps(gap.pairs, places, gap.highs, distances, gap.at_highs, moved, gap.moved_highs),
        )


class _Gaps:
    """Stretches of a motion between two measured places, each of one pair.

    Attributes, arrays of shape (k,):
        pairs
        lows, highs: The two places.
        at_lows, at_highs: The distances there [m].
        moved_lows, moved_highs: The travel of the pair up to there [m].
        ways: Its travel from one to the other [m].
        bounds: Nowhere on the stretch the distance is smaller [m].
    """

    _NAMES = ("pairs", "lows", "highs", "at_lows", "at_highs", "moved_lows", "moved_highs", "ways", "bounds")

    def __init__(
        self,
        pairs: np.ndarray,
        lows: np.ndarray,
        highs: np.ndarray,
        at_lows: np.ndarray,
        at_highs: np.ndarray,
        moved_lows: np.ndarray,
        moved_highs: np.ndarray,
    ):
        self.pairs, self.lows, self.highs = pairs, lows, highs
        self.at_lows, self.at_highs = at_lows, at_highs
        self.moved_lows, self.moved_highs = moved_lows, moved_highs
        self.ways = moved_highs - moved_lows
        self.bounds = (at_lows + at_highs - self.ways) / 2

    def some(self, which: np.ndarray) -> _Gaps:
        """Return some of the stretches."""
        return _Gaps(*(getattr(self, name)[which] for name in self._NAMES[:7]))

    def replace(self, which: np.ndarray, first: _Gaps, second: _Gaps) -> None:
        """Put two parts in the place of some stretches."""
        for name in self._NAMES:
            values = getattr(self, name)
            values[which] = getattr(first, name)
            setattr(self, name, np.concatenate((values, getattr(second, name))))

    def middles(self) -> np.ndarray:
        """Return about where the bounds from both ends meet: in a row as long as there is one in between, then between two."""
        # not too near an end, or the search would hardly get on
        part = np.clip(0.5 + 0.5 * (self.at_lows - self.at_highs) / np.maximum(self.ways, 1e-300), _EDGE, 1.0 - _EDGE)
        places = self.lows + part * (self.highs - self.lows)
        first, last = np.floor(self.lows) + 1.0, np.ceil(self.highs) - 1.0
        return np.where(first <= last, np.clip(np.round(places), first, last), places)


def _first_of(chosen: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Return at most `_TOGETHER` of them, those of the lowest order."""
    if len(chosen) <= _TOGETHER:
        return chosen
    return chosen[np.argsort(order, kind="stable")[:_TOGETHER]]
