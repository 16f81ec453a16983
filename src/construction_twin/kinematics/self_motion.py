"""The nearest point of self-motions: the curves in joint space along which an arm with one redundant joint leaves its tip alone.

Samples of the curves come in layers, each with another value of one held joint. Neighbours on a curve are joined by links, which
cubics describe that have the curve's directions at both ends. Only links that may lead nearer to the seed than the best point so
far are looked at. Where a cubic is nearest within the ranges, the true point is computed, and the cubic goes through it from then
on. Three kinds of places need more:

- **A link that is long or turns sharply** is divided; Newton steps bring the points between onto the curve.
- **Where branches begin or end between two layers**, a link leads from one branch to the other.
- **Near a hinge**, a posture in which two axes lie in one line, two joints turn by much while the held joint hardly moves. No
  division of its range sees that. So the arm's directions beside the hinge tell where it passes, and it is looked for there.

Joint values [rad], or [m] for a prismatic joint. How samples are computed is the caller's matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.kinematics.axes import Axis, alignment, joint_axes
from construction_twin.kinematics.batch_kinematics import BatchKinematics, tangents
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.ranges import TURN, Ranges
from construction_twin.robot.description import RobotModel

#: A curve is longer than the straight way along a link by no more than this factor, as far as pruning is concerned.
_BULGE = 1.15
#: Samples farther away, or out of range by more, are on no link of use [rad].
_FAR, _OUT = 1.2, 1.8
#: Links are divided if they are longer, or if the curve's directions at their ends have a smaller cosine; shorter ones are not.
_LONG, _ALIKE, _SHORT = 0.7, 0.5, 0.01
#: How often links are divided, and how many of them each time.
_ROUNDS, _CHORDS = 3, 6
#: New points for one link, at most; what a cubic may miss the curve by where its nearest point is at the end of a range [rad];
#: and elsewhere, the square of that as a part of the distance from the seed.
_POINTS, _AT_END, _BETWEEN = 7, 2e-5, 2e-6
#: Where the joint between two axes is nearer to their hinge than this, they are looked at; lines of axes that are one [rad], [m].
_HINGED, _IN_LINE = 0.8, 0.02
#: Sweeps past a hinge that are followed for one pose; what their first guess may be out of range by; how far it may be off [rad].
_SWEEPS, _WIDE, _MOVED = 5, 0.2, 1.0
#: A seed that Newton steps bring onto the pose over no greater distance is almost on it; what is so near to the seed is not
#: compared with anything else [rad].
_BESIDE, _AT_ONCE = 0.1, 0.03
#: What postures out of range count as, beside which every distance is small.
_NEVER = 1e3


@dataclass(frozen=True)
class Hinge:
    """A joint value that brings the axes before and behind into one line, where they turn without moving the tip.

    Attributes:
        joint: From 0.
        angle: [rad]
        sense: 1: the axes are parallel there, -1: they are opposite.
    """

    joint: int
    angle: float
    sense: float


def find_hinges(axes: Sequence[Axis], linear: Sequence[bool]) -> list[Hinge]:
    """Return the hinges of an arm.

    Args:
        linear: Which joints are prismatic.
    """
    found = []
    for joint in range(1, len(axes) - 1):
        if any(linear[joint - 1 : joint + 2]):
            continue
        first, middle, last = axes[joint - 1 : joint + 2]
        axis = middle.direction
        outer = alignment(first.direction, axis, last.direction)
        for sense in (1.0, -1.0):
            if outer.size < 1e-3 or abs(outer.constant + sense * outer.size - sense) > 1e-3:
                continue
            angle = math.atan2(sense * outer.sine, sense * outer.cosine)
            spoke = last.point - middle.point
            across = np.cross(axis, spoke)
            turned = spoke + across * math.sin(angle) + np.cross(axis, across) * (1.0 - math.cos(angle))
            place = middle.point + turned
            if np.linalg.norm(first.nearest(place) - place) < _IN_LINE:
                found.append(Hinge(joint, angle, sense))
    return found


def _can_pass(hinge: Hinge, robot: RobotModel) -> bool:
    """Return whether the ranges let a joint come near its hinge."""
    low, high = robot.lower[hinge.joint], robot.upper[hinge.joint]
    turns = TURN * np.arange(-2, 3)
    return bool(((hinge.angle + turns > low - _HINGED) & (hinge.angle + turns < high + _HINGED)).any())


class SelfMotion:
    """The self-motions of one arm.

    Args:
        chain: With seven joints.
        held: The joint by whose value samples are sorted, from 0.
    """

    def __init__(self, chain: Chain, held: int):
        robot = chain.robot
        self.held = held
        self.batch = BatchKinematics(chain)
        # where the held joint itself sweeps, the samples are dense
        self.hinges = [
            hinge
            for hinge in find_hinges(joint_axes(chain), robot.linear)
            if abs(hinge.joint - held) != 1 and _can_pass(hinge, robot)
        ]
        self.ranges = Ranges(robot)

    def nearest(
        self,
        samples: np.ndarray,
        counts: np.ndarray,
        pose: Pose,
        seed: np.ndarray,
        point: Callable[[np.ndarray], np.ndarray | None],
        beside: bool,
    ) -> np.ndarray | None:
        """Return the nearest point within the ranges.

        Args:
            samples: Shape (m, n). Points of the curves at ascending values of the held joint, those of one value in an order of the
                branches that does not change while none of them begins or ends.
            counts: Integers. How many of them have the first value of the held joint, the second, and so on; 0 where there is no
                point.
            pose: On which the curves are.
            seed: Shape (n,)
            point: Returns the point of the curves that has the held joint's value and is nearest to joint values almost on the
                curve; None: there is none.
            beside: Whether the seed is so near to the pose that a solution may be right beside it.

        Returns:
            Shape (n,). On the pose to about 1e-6, and within the ranges to 1e-4; None: nothing was found.
        """
        if not len(samples):
            return None
        return _Search(self, _Samples(self, samples, counts, seed), pose, point, beside).run()


class _Samples:
    """The samples of one pose and their neighbours on the curves.

    Attributes:
        q, away: Shape (m, n). The samples, and the same from the seed.
        layer: Shape (m,)
        distance, excess: Shape (m,). From the seed, and out of range by.
        aligned: Shape (m, 2). The samples of the same branch at the next smaller and the next greater value of the held joint; -1:
            branches begin or end.
    """

    def __init__(self, motion: SelfMotion, samples: np.ndarray, counts: np.ndarray, seed: np.ndarray):
        self.motion, self.seed = motion, seed
        self.q = motion.ranges.into_range(samples, seed)
        # the first and the last layer are empty, so that every layer has two neighbours
        self._counts = np.concatenate([[0], counts, [0]])
        self.layer = np.repeat(np.arange(len(self._counts)), self._counts)
        self.away = self.q - seed
        self.distance = _size(self.away)
        self.excess = motion.ranges.excess(self.q)
        number = np.arange(len(self.q))
        self._branch = number - (np.cumsum(self._counts) - self._counts)[self.layer]
        self._table = np.full((len(self._counts), int(self._counts.max())), -1)
        self._table[self.layer, self._branch] = number
        towards = self.layer[:, None] + np.array([-1, 1])
        same = self._counts[towards] == self._counts[self.layer, None]
        self.aligned = np.where(same, self._table[towards, self._branch[:, None]], -1)

    def links(
        self, near: np.ndarray, neighbours: np.ndarray, limit: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return links that may lead nearer to the seed than a limit: sample, neighbour, side, the way there, and its length."""
        motion = self.motion
        ways = motion.ranges.wrapped(self.q[neighbours] - self.q[near, None])
        lengths = _size(ways)
        ends = _size(self.away[near, None] + ways)
        bound = 0.5 * (self.distance[near, None] + ends - _BULGE * lengths)
        row, side = np.nonzero((bound < limit) & (neighbours >= 0))
        node, other, ways, lengths = near[row], neighbours[row, side], ways[row, side], lengths[row, side]
        end = self.q[node] + ways
        out = np.maximum(self.excess[node], 0.0) + np.maximum(motion.ranges.excess(end), 0.0)
        # a link is looked at from one end, unless whole turns make it another one when seen from the other end
        turned = np.abs(end - self.q[other]).max(axis=1, initial=0.0) > 1.0
        folded = np.where(self.layer[node] == self.layer[other], side, 2)
        seen: set[tuple[int, int, int]] = set()
        wanted = []
        for index in np.flatnonzero(out <= _BULGE * lengths).tolist():
            one, two = int(node[index]), int(other[index])
            key = (one, two, int(folded[index]))
            if turned[index] or (two, one, key[2]) not in seen:
                seen.add(key)
                wanted.append(index)
        return node[wanted], other[wanted], side[wanted], ways[wanted], lengths[wanted]

    def near(self, limit: float) -> np.ndarray:
        """Return the samples from which links may lead nearer to the seed than a limit."""
        return np.flatnonzero((self.distance < limit + _FAR) & (self.excess < _OUT))

    def neighbours(self, chosen: np.ndarray) -> np.ndarray:
        """Return the neighbours of samples, shape (c, 2): as `aligned`, or else the nearest sample of this or the next layer."""
        layer, counts, table = self.layer[chosen], self._counts, self._table
        found = self.aligned[chosen]
        for side, towards in enumerate((-1, 1)):
            next_layer = layer + towards
            loose = np.flatnonzero((found[:, side] < 0) & (next_layer > 0) & (next_layer < len(counts) - 1))
            if len(loose):
                choices = np.concatenate([table[layer[loose]], table[next_layer[loose]]], axis=1)
                own = chosen[loose, None]
                lengths = _size(self.motion.ranges.wrapped(self.q[choices] - self.q[own]))
                lengths[(choices < 0) | (choices == own)] = math.inf
                best = lengths.argmin(axis=1)
                rows = np.arange(len(loose))
                found[loose, side] = np.where(np.isfinite(lengths[rows, best]), choices[rows, best], -1)
        return found


class _Search:
    """The search along the curves of one pose. A link is an array of shape (4, n): start, its way on, end, its way on."""

    def __init__(
        self,
        motion: SelfMotion,
        samples: _Samples,
        pose: Pose,
        point: Callable[[np.ndarray], np.ndarray | None],
        beside: bool,
    ):
        self._motion, self._samples, self._pose, self._point = motion, samples, pose, point
        self._kept = beside
        self._seed = samples.seed
        self._best: np.ndarray | None = None
        self._distance = _NEVER

    def run(self) -> np.ndarray | None:
        """Return the nearest point; None: none was found."""
        samples, motion = self._samples, self._motion
        inside = np.flatnonzero(samples.excess <= 0.0)
        if len(inside):
            row = inside[samples.distance[inside].argmin()]
            self._best, self._distance = samples.q[row], float(samples.distance[row])
        if self._kept:
            self._beside_seed()
            if self._distance < _AT_ONCE:
                return self._best
        near = samples.near(self._distance)
        neighbours = samples.neighbours(near)
        node, other, side, ways, lengths = samples.links(near, neighbours, self._distance)
        beside = [self._beside(hinge) for hinge in motion.hinges]
        chosen = np.concatenate([node, other, *beside])
        if not len(chosen):
            return self._best
        along = tangents(motion.batch.frames(samples.q[chosen])[1], motion.held)
        count = len(node)
        first, last = along[:count], along[count : 2 * count]
        leave = 2.0 * side - 1.0
        # within a layer the curve turns back
        arrive = np.where(samples.layer[node] == samples.layer[other], -leave, leave)
        first, last = first * leave[:, None], last * arrive[:, None]
        arcs = (lengths * _arc(first, last))[:, None]
        start = samples.q[node]
        long = self._follow(np.stack([start, first * arcs, start + ways, last * arcs], axis=1)) if count else start
        for places, points in self._sweeps(beside, along[2 * count :]):
            self._refine(places, points)
        for _ in range(_ROUNDS):
            if not len(long):
                break
            long = self._follow(self._divided(long[:_CHORDS]))
        return self._best

    def _beside_seed(self) -> None:
        """Look beside the seed, where it is almost on the pose: such a seed is kept, whatever is between the samples."""
        motion = self._motion
        q, arrived, jacobian = motion.batch.projected(self._seed[None], self._pose)
        if not arrived[0] or math.dist(q[0], self._seed) > _BESIDE:
            return
        self._take(q)
        step = max(math.dist(q[0], self._seed), 1e-3)
        places = step * np.array([-3.0, -1.0, 1.0, 3.0])
        start = q + places[:, None] * tangents(jacobian, motion.held)
        points, arrived, _ = motion.batch.projected(start, self._pose)
        if arrived.all():
            self._refine(places, points)

    def _follow(self, links: np.ndarray) -> np.ndarray:
        """Look for the nearest point on links that a cubic describes well; return the others, those that promise most first."""
        lengths = _size(links[:, 2] - links[:, 0])
        cosine = (links[:, 1] * links[:, 3]).sum(axis=1) / (_size(links[:, 1]) * _size(links[:, 3]) + 1e-12)
        long = (lengths > _LONG) | ((cosine < _ALIKE) & (lengths > _SHORT))
        doubt = np.where(long, 0.02 + (0.15 + 0.3 * (cosine < _ALIKE)) * lengths, 1e-3 + 0.02 * lengths)
        q = _CUBIC @ links
        value = self._value(q, doubt[:, None])
        place = value.argmin(axis=1)
        least = value[np.arange(len(links)), place] - doubt
        order = least.argsort()
        order = order[least[order] < self._distance]
        for row in order[~long[order]]:
            if least[row] >= self._distance:
                break
            points = np.concatenate([links[row, :1], _THIRDS @ links[row], links[row, 2:3]])
            self._refine(lengths[row] * np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]), points)
        return links[order[long[order]]]

    def _divided(self, links: np.ndarray) -> np.ndarray:
        """Return links in four parts each, as far as Newton steps lead from between their ends to the curve."""
        motion = self._motion
        inner = _QUARTERS @ links
        shape = inner.shape
        flat, arrived, jacobian = motion.batch.projected(inner.reshape(-1, shape[-1]), self._pose)
        self._take(flat[arrived])
        flat[~arrived] = math.nan
        points = np.concatenate([links[:, :1], flat.reshape(shape), links[:, 2:3]], axis=1)
        ways = points[:, 1:] - points[:, :-1]
        along = tangents(jacobian, motion.held).reshape(shape)
        forward = np.einsum("lpn,lpn->lp", along, points[:, 2:] - points[:, :-2]) > 0.0
        along = np.where(forward[:, :, None], along, -along)
        ends = links[:, 1::2] / _size(links[:, 1::2])[:, :, None]
        along = np.concatenate([ends[:, :1], along, ends[:, 1:]], axis=1)
        arcs = (_size(ways) * _arc(along[:, :-1], along[:, 1:]))[:, :, None]
        parts = np.stack([points[:, :-1], along[:, :-1] * arcs, points[:, 1:], along[:, 1:] * arcs], axis=2)
        parts = parts.reshape(-1, 4, shape[-1])
        return parts[np.isfinite(parts).all(axis=(1, 2))]

    def _beside(self, hinge: Hinge) -> np.ndarray:
        """Return samples beside which the arm may pass a hinge nearer to the seed than the best so far."""
        samples = self._samples
        off = np.abs(_turned(samples.q[:, hinge.joint] - hinge.angle))
        # along each branch, the samples on both sides of where the hinge is nearest
        aside = np.where(samples.aligned >= 0, off[samples.aligned], math.inf)
        chosen = np.flatnonzero((off < _HINGED) & (off <= np.minimum(aside[:, 0], aside[:, 1]) + 1e-9))
        # at the hinge the joints before and behind only have to keep their sum or difference, the others stay
        away = samples.away[chosen]
        before, behind = away[:, hinge.joint - 1], away[:, hinge.joint + 1]
        rest = np.einsum("mn,mn->m", away, away) - before**2 - behind**2
        rest += 0.5 * _turned(before + hinge.sense * behind) ** 2
        return chosen[np.sqrt(np.maximum(rest, 0.0)) - off[chosen] < self._distance]

    def _sweeps(self, beside: Sequence[np.ndarray], along: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return places and points of motions past hinges that may lead nearer, for `_refine`.

        Args:
            beside: Each of shape (any,) each. Samples beside each hinge.
            along: Shape (m, n). The curve's directions at all of these samples.
        """
        found, began = [], 0
        for hinge, chosen in zip(self._motion.hinges, beside):
            if len(chosen):
                found += self._past(hinge, chosen, along[began : began + len(chosen)])
                began += len(chosen)
        found.sort(key=lambda each: each[0])
        kept: list[tuple[float, np.ndarray, Hinge]] = []
        for each in found:
            if len(kept) < _SWEEPS and all(math.dist(each[1], other) > 0.3 for _, other, _ in kept):
                kept.append(each)
        if not kept:
            return []
        points = np.repeat(np.array([q for _, q, _ in kept])[:, None], 4, axis=1)
        for row, (_, _, hinge) in enumerate(kept):
            points[row, :, hinge.joint - 1] += _AROUND
            points[row, :, hinge.joint + 1] -= hinge.sense * _AROUND
        flat, arrived, _ = self._motion.batch.projected(points.reshape(-1, points.shape[-1]), self._pose)
        self._take(flat[arrived])
        reached = flat.reshape(points.shape)
        lengths = _size(reached[:, 1:] - reached[:, :-1])
        fine = arrived.reshape(-1, 4).all(axis=1) & (np.abs(reached - points).max(axis=(1, 2)) < _MOVED)
        fine &= lengths.min(axis=1) > 1e-3
        return [(np.concatenate([[0.0], np.cumsum(lengths[row])]), reached[row]) for row in np.flatnonzero(fine)]

    def _past(self, hinge: Hinge, beside: np.ndarray, along: np.ndarray) -> list[tuple[float, np.ndarray, Hinge]]:
        """Return where the arm may be nearest while it passes one hinge: the expected distance and posture."""
        samples, motion, seed = self._samples, self._motion, self._seed
        one, two = hinge.joint - 1, hinge.joint + 1
        off, speed = _turned(samples.q[beside, hinge.joint] - hinge.angle), along[:, hinge.joint]
        fit = np.abs(off) < 1.5 * _HINGED * np.abs(speed)
        if not fit.any():
            return []
        beside, along, way = beside[fit], along[fit], -off[fit] / speed[fit]
        centre = samples.q[beside] + way[:, None] * along
        first, second = centre[:, one, None], centre[:, two, None] + _TURNS
        turn = 0.5 * (seed[one] - first - hinge.sense * (seed[two] - second))
        ends = np.array([second - motion.ranges.upper[two], second - motion.ranges.lower[two]]) * hinge.sense
        low = np.maximum(motion.ranges.lower[one] - first, ends.min(axis=0))
        high = np.minimum(motion.ranges.upper[one] - first, ends.max(axis=0))
        turn = np.clip(turn, low, np.maximum(low, high))
        q = np.repeat(centre[:, None], len(_TURNS), axis=1)
        q[:, :, one] += turn
        q[:, :, two] = second - hinge.sense * turn
        value = np.where(low <= high, self._value(q, _WIDE), _NEVER)
        # the motion past the hinge is not quite where it would be at the hinge
        rows = np.argwhere(value < self._distance + 0.1)
        return [(float(value[row, turned]), q[row, turned], hinge) for row, turned in rows]

    def _refine(self, places: np.ndarray, points: np.ndarray) -> None:
        """Look for the nearest point on the cubic through four points, shape (4, n), and bring it to the curve."""
        motion = self._motion
        low, high = float(places[0]), float(places[3])
        for _ in range(_POINTS):
            step = (high - low) / (len(_FINE) - 3)
            along = low + step * _FINE
            q = _weights(places, along) @ points
            value = self._value(q, 0.0)
            row = int(value.argmin())
            if self._distance + 0.01 < value[row] < _NEVER:
                return
            here, at_end = self._between(along, q, value, row)
            expected = (_weights(places, np.array([here])) @ points)[0]
            found = self._on_curve(expected, places, points)
            if found is None:
                return
            missed = math.dist(found, expected)
            distance = math.dist(found, self._seed)
            if distance < self._distance and motion.ranges.excess(found) <= 1e-4:
                self._best, self._distance = found, distance
            # beside the foot of a perpendicular of this length the distance hardly changes
            if missed < (_AT_END if at_end else math.sqrt(_BETWEEN * distance)) and step < 0.05:
                return
            # the new point takes the place of one that is in the same place, or of the farthest
            gaps = np.abs(places - here)
            drop = int(gaps.argmin()) if gaps.min() < 1e-7 else int(gaps.argmax())
            places, points = places.copy(), points.copy()
            places[drop], points[drop] = here, found
            order = places.argsort()
            places, points = places[order], points[order]
            trust = max(4.0 * missed, 2.0 * step)
            low, high = here - trust, here + trust

    def _on_curve(self, q: np.ndarray, places: np.ndarray, points: np.ndarray) -> np.ndarray | None:
        """Return the point of the curve beside joint values: by the held joint's value where it changes enough along the curve."""
        motion = self._motion
        if abs(points[2, motion.held] - points[1, motion.held]) > 0.15 * (places[2] - places[1]):
            found = self._point(q)
            if found is not None:
                way = motion.ranges.wrapped(found - q)
                if way @ way < 0.04:
                    return q + way
        flat, arrived, _ = motion.batch.projected(q[None], self._pose)
        return flat[0] if arrived[0] else None

    def _between(self, along: np.ndarray, q: np.ndarray, value: np.ndarray, row: int) -> tuple[float, bool]:
        """Return where between points of a cubic it is nearest, and whether a range ends there."""
        here, step = float(value[row]), float(along[1] - along[0])
        before = float(value[row - 1]) if row else math.inf
        after = float(value[row + 1]) if row < len(along) - 1 else math.inf
        if here < _NEVER and max(before, after) < _NEVER:
            # the square of the distance is a parabola even beside the seed
            before, here, after = before * before, here * here, after * after
            return along[row] + 0.5 * step * (before - after) / max(before - 2.0 * here + after, 1e-15), False
        side = 1 if after > before else -1
        if here >= _NEVER or math.isinf(max(before, after)):
            return along[row], True
        inside, outside = self._motion.ranges.excess(q[[row, row + side]]).tolist()
        return along[row] + side * step * min(max(-inside / (outside - inside + 1e-15), 0.0), 1.0), True

    def _value(self, q: np.ndarray, doubt: np.ndarray | float) -> np.ndarray:
        """Return the distance from the seed; for joint values out of range by more than `doubt`, more than any distance."""
        excess = self._motion.ranges.excess(q)
        return np.where(excess <= doubt, _size(q - self._seed), _NEVER + excess)

    def _take(self, q: np.ndarray) -> None:
        """Keep the nearest of some points if it is the best so far."""
        if len(q):
            value = self._value(q, 0.0)
            row = int(value.argmin())
            if value[row] < self._distance:
                self._best, self._distance = q[row], float(value[row])


def _size(ways: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("...n,...n->...", ways, ways))


def _turned(angles: np.ndarray) -> np.ndarray:
    return angles - TURN * np.rint(angles * (1.0 / TURN))


def _arc(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the length of a circle's arc, by its chord, from the directions at its ends, shape (..., n)."""
    half = 0.5 * np.arccos(np.clip(np.einsum("...n,...n->...", first, last), -1.0, 1.0)) + 1e-6
    return half / np.sin(half)


def _hermite(parts: Iterable[float]) -> np.ndarray:
    """Return the weights of a link's four rows for places on its cubic, as parts of it, shape (places, 4)."""
    u = np.array(list(parts))[:, None]
    v = 1.0 - u
    return np.concatenate([v * v * (1.0 + 2.0 * u), u * v * v, u * u * (1.0 + 2.0 * v), -u * u * v], axis=1)


def _weights(places: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the weights of four points for other points of the cubic through them, shape (len(along), 4)."""
    a, b, c, d = places.tolist()
    w, x, y, z = along - a, along - b, along - c, along - d
    early, late = w * x, y * z
    weights = np.array([x * late, w * late, early * z, early * y])
    scale = [(a - b) * (a - c) * (a - d), (b - a) * (b - c) * (b - d), (c - a) * (c - b) * (c - d)]
    return (weights / np.array([*scale, (d - a) * (d - b) * (d - c)])[:, None]).T


_CUBIC = _hermite(np.linspace(0.0, 1.0, 13))
_THIRDS, _QUARTERS = _hermite([1.0 / 3.0, 2.0 / 3.0]), _hermite([0.25, 0.5, 0.75])
#: One step further than the ends, so that what is nearest at an end has neighbours on both sides.
_FINE = np.arange(-1.0, 24.0)
_AROUND = np.array([-0.21, -0.07, 0.07, 0.21])
_TURNS = TURN * np.arange(-2, 3)
