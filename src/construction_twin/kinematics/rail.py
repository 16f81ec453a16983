"""Inverse kinematics of an arm of the OPW kind on a linear axis: closed form at many positions of the carriage.

The carriage adds one degree of freedom: its position. The arm is solved at positions all along the axis, and at the edges of its
reach, which are known in closed form. Around each local minimum of a branch's distance from the seed, and where a joint moves fast,
what lies between two positions is divided, again and again. Where the wrist is exactly singular, and where the carriage stands now,
the arm is solved alone. If nothing was found at any position, `numeric` searches.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from construction_twin.core.motion_errors import BranchError, KinematicsError, UnreachableError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.closed_form import SLOTS, ClosedFormInverse
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import NotOpw, OpwModel, find_opw
from construction_twin.kinematics.solution import (
    TURN,
    ArmKind,
    Configuration,
    IkSolution,
    InverseKinematics,
    check_pose,
    distinct,
    spaced,
)
from construction_twin.robot.description import JointValues
from construction_twin.robot.urdf import chain_joints, parse_urdf

#: Number of evenly spaced positions along the axis, and of parts into which what lies between them is divided.
_POSITIONS, _PARTS = 71, 40
#: Most intervals divided at once; shorter ones are not divided [m].
_INTERVALS, _FINEST = 64, 1e-11
#: A wrist that bends by less may pass its singularity between two even positions; by less than the second, it is there [rad].
_BENT, _PASS = 0.1, 3e-7
#: A joint that moves by more than the first between two positions may turn round between them, by more than the second turn either
#: way. Where all move by less than the last, the nearest of the positions is near enough [rad].
_FAST, _EITHER_WAY, _SMOOTH = 0.2, 1.5, 3e-4
#: Out of range by less is rounding; nearer by less is not looked for [rad].
_ROUNDING, _NEARER = 3e-7, 5e-7
#: An edge of the reach is known this well; a root whose imaginary part is less is one, but for rounding [m].
_AT_EDGE, _TANGENT = 1e-7, 1e-5
#: Where a branch ends, its distance may fall by this times the root of the interval, as the elbow moves [rad/sqrt(m)].
_FALL = 5.0
#: The rank of a solution out of range is this and by how much [rad]; of one in range, its squared distance from the seed.
_OUT = 1e3
#: A solution whose wrist is this close to singular belongs to the family of solutions of a singular position [rad].
_OF_FAMILY = 1e-3
#: Solutions nearer to each other than this are one [rad]: they differ only in how exactly the nearest position was found.
_SAME = 0.01
#: Besides the nearest ones, `all` returns at most so many.
_MOST = 64

#: What a robot's description has for each joint.
_PER_JOINT = ("joint_names", "lower", "upper", "velocity", "acceleration", "jerk", "home", "axes", "linear")


class Carriage:
    """The carriage of an arm, and the arm on it.

    Attributes:
        arm: The six joints on the carriage, which is their base.
        rotation: Shape (3, 3). Of ``base_T_carriage``.
        origin: Shape (3,). The carriage's origin in the base, at position zero [m].
        direction: Shape (3,). In which it travels, in the base.
    """

    def __init__(self, chain: Chain):
        robot = chain.robot
        joints = chain_joints(parse_urdf(robot.urdf), robot.base_link, robot.tip_link)
        link = next(joint.child for joint in joints if joint.name == robot.joint_names[0])
        self.arm = Chain(replace(robot, base_link=link, **{name: getattr(robot, name)[1:] for name in _PER_JOINT}))
        home = np.array(robot.home)
        home[0] = 0.0
        base_T_tip, carriage_T_tip = chain.forward(home), self.arm.forward(home[1:])
        self.rotation = base_T_tip.rotation @ carriage_T_tip.rotation.T
        self.origin = base_T_tip.position - self.rotation @ carriage_T_tip.position
        self.direction = chain.jacobian(home)[:3, 0]

    def seen_from(self, pose: Pose, position: float) -> Pose:
        """Return ``carriage_T_tip`` of a target ``base_T_tip`` with the carriage at a position."""
        origin = self.origin + position * self.direction
        return Pose(self.rotation.T @ (pose.position - origin), self.rotation.T @ pose.rotation)


def find_rail(chain: Chain) -> tuple[Carriage, OpwModel] | NotOpw:
    """Return the carriage of an arm on a linear axis, with the arm's model, or why the chain is not one."""
    if chain.robot.linear != (True,) + (False,) * 6:
        return NotOpw("its joints are neither six revolute ones nor a prismatic one followed by six revolute ones")
    carriage = Carriage(chain)
    model = find_opw(carriage.arm)
    return model if isinstance(model, NotOpw) else (carriage, model)


class _Rows(NamedTuple):
    """Branches at positions, one branch to a row.

    Attributes:
        slots: Shape (r,). Each row's branch, as in `SLOTS`.
        positions: Shape (r, m). Ascending [m].
        joints: Shape (r, m, 6). [rad]; nan: there is no such branch.
        wrist: Shape (r, m). |sin| of the wrist's angle.
    """

    slots: np.ndarray
    positions: np.ndarray
    joints: np.ndarray
    wrist: np.ndarray


class _Ranked(NamedTuple):
    """`_Rows` with respect to a seed.

    Attributes:
        rank: Shape (r, m). The lower the better, see `_OUT`; inf: there is no such branch.
        away: Shape (r, m, 7). Distances of position [m] and joints [rad] from the seed.
    """

    rank: np.ndarray
    away: np.ndarray


class _Found(NamedTuple):
    """What a search found: rank as in `_Ranked`, branch as in `SLOTS`, joint values of shape (7,)."""

    rank: float
    slot: int
    q: np.ndarray


class RailInverse(InverseKinematics):
    """Inverse kinematics of an arm of the OPW kind on a linear axis."""

    def __init__(self, chain: Chain, carriage: Carriage, model: OpwModel, search: NumericInverse):
        super().__init__(chain, search.settings)
        self._carriage = carriage
        self._arm = arm = ClosedFormInverse(carriage.arm, model, search.settings)
        self._search = search
        self._even = np.linspace(*self._ends[0], _POSITIONS)
        # the direction of travel in the directions of the arm's model
        self._travel = arm.model.base_T_opw[:3, :3].T @ (carriage.rotation.T @ carriage.direction)
        # from a target of the whole chain to one of the arm's model, with the carriage at zero
        base_T_carriage = np.eye(4)
        base_T_carriage[:3, :3], base_T_carriage[:3, 3] = carriage.rotation, carriage.origin
        self._opw_T_base = np.linalg.inv(base_T_carriage @ arm.model.base_T_opw)
        self._tip_T_flange = np.linalg.inv(arm.model.flange_T_tip)
        lower, upper = self.ranges.lower[1:], self.ranges.upper[1:]
        self._middle, self._half = 0.5 * (upper + lower), 0.5 * (upper - lower)

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("OPW on a linear axis", f"behind joint 1, which is prismatic, {self._arm.kind.why}")

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: over all positions of the carriage."""
        start = self._checked(pose, seed)
        flange = self._flange(pose)
        rows = self._along(flange, float(start[0]), configuration)
        best, singular = self._divide(flange, rows, start, one=True)
        found = list(self._first_confirmed(best, pose, start))
        for position in (float(start[0]), *singular):
            found += self._nearest_at(position, pose, start, configuration)
        if found:
            return min(found, key=lambda solution: solution.distance)
        return self._search_or_explain(pose, start, configuration)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`: for each branch the nearest position of the carriage.

        With other whole turns the nearest of the evenly spaced positions. Besides, solutions spaced along the branches, for whoever
        cannot use the nearest: who has to avoid contacts takes the first that is free.
        """
        start = self._checked(pose, seed)
        flange = self._flange(pose)
        rows = self._along(flange, float(start[0]), configuration)
        best, singular = self._divide(flange, rows, start, one=False)
        found = self._nearest_at(float(start[0]), pose, start, configuration)
        for slot in rows.slots.tolist():
            found += self._first_confirmed((each for each in best if each.slot == slot), pose, start)
        for turns in self._choices_of_turns(start):
            rank, away = self._rank(rows, start, np.array(turns))
            for row, (at, slot) in enumerate(zip(rank.argmin(axis=1).tolist(), rows.slots.tolist())):
                other = _Found(float(rank[row, at]), slot, start + away[row, at])
                if other.rank < _OUT and not any(_has_turns(each, other) for each in found):
                    found += self._first_confirmed([other], pose, start)
        if singular:
            found = [solution for solution in found if self._wrist_angle(solution.q) > _OF_FAMILY]
            found += self._families(pose, start, configuration, singular)
        if not found:
            return [self._search_or_explain(pose, start, configuration)]
        found = distinct(sorted(found, key=lambda solution: solution.distance), _SAME)
        # others with the whole turns nearest to the seed: with other ones the arm would touch the same things
        others = self._in_range(rows, self._rank(rows, start, None), start)
        joints = np.array([other.q for other in others]).reshape(-1, len(start))
        found += spaced(joints, found, _MOST, lambda number: self._solution(others[number], pose, start))
        return sorted(found, key=lambda solution: solution.distance)

    def configuration(self, q: JointValues) -> Configuration:
        """See `InverseKinematics.configuration`: the arm's."""
        return self._arm.configuration(q[1:])

    def _checked(self, pose: Pose, seed: JointValues) -> np.ndarray:
        self.chain.robot.check_range(seed)
        check_pose(pose)
        return np.array(seed, dtype=float)

    def _flange(self, pose: Pose) -> np.ndarray:
        """Return a target as the arm's model has it with the carriage at zero, see `ClosedFormInverse.flange`."""
        return self._opw_T_base @ pose.matrix() @ self._tip_T_flange

    def _branches(self, flange: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the arm's branches at positions, shape (m, 8, 6), and |sin| of their wrist angles, shape (m, 8)."""
        flanges = np.empty((len(positions), 4, 4))
        flanges[:] = flange
        flanges[:, :3, 3] -= positions[:, None] * self._travel
        joints, wrist, _ = self._arm.branches(flanges)
        return joints, wrist

    def _along(self, flange: np.ndarray, position: float, configuration: Configuration | None) -> _Rows:
        """Return the branches of a configuration all along the axis, at a position, and on both sides of the edges of the reach."""
        low, high = self._ends[0]
        edges = self._edges(flange)
        positions = np.concatenate([self._even, [position], edges - _AT_EDGE, edges + _AT_EDGE])
        positions = np.sort(positions[(positions >= low) & (positions <= high)])
        slots = np.array(
            [slot for slot, have in enumerate(SLOTS) if configuration is None or have.matches(configuration)]
        )
        joints, wrist = self._branches(flange, positions)
        at = np.broadcast_to(positions, (len(slots), len(positions)))
        return _Rows(slots, at, joints.transpose(1, 0, 2)[slots], wrist.T[slots])

    def _between(self, flange: np.ndarray, slots: np.ndarray, low: np.ndarray, high: np.ndarray) -> _Rows:
        """Return a branch at positions that divide an interval, for each of k branches and intervals."""
        positions = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, _PARTS + 1)
        joints, wrist = self._branches(flange, positions.ravel())
        own = np.repeat(slots, _PARTS + 1)[:, None]
        joints = np.take_along_axis(joints, own[..., None], axis=1).reshape(*positions.shape, 6)
        return _Rows(slots, positions, joints, np.take_along_axis(wrist, own, axis=1).reshape(positions.shape))

    def _edges(self, flange: np.ndarray) -> np.ndarray:
        """Return the positions where the wrist centre is at an edge of a shoulder's reach [m].

        There its distance from axis 2 is the stretched or the folded arm's: with the squared distance from axis 1 less b^2, which
        is quadratic in the position, that is a quartic.
        """
        model = self._arm.model
        centre = np.array(model.wrist_centre(flange)) - [0.0, 0.0, model.c1]
        squares = np.array([self._travel**2, -2.0 * centre * self._travel, centre**2])
        across = squares[:, :2].sum(axis=1) - [0.0, 0.0, model.b**2]
        whole = across + squares[:, 2]
        forearm = math.hypot(model.a2, model.c3)
        roots = [np.roots(across)] if model.b else []
        for radius in (model.c2 + forearm, model.c2 - forearm):
            level = whole + [0.0, 0.0, model.a1**2 - radius**2]
            roots.append(np.roots(np.polysub(np.polymul(level, level), 4.0 * model.a1**2 * across)))
        every = np.concatenate(roots)
        return every[np.abs(every.imag) < _TANGENT].real

    def _rank(self, rows: _Rows, seed: np.ndarray, turns: np.ndarray | None) -> _Ranked:
        """Rank branches so many whole turns, shape (6,), further than nearest to the seed; None: nearest within the ranges."""
        joints = rows.joints - TURN * np.rint((rows.joints - seed[1:]) * (1.0 / TURN))
        if turns is not None:
            joints += TURN * turns
        excess = np.abs(joints - self._middle) - self._half
        if turns is None:
            other = joints - TURN * np.sign(joints - self._middle)
            other_excess = np.abs(other - self._middle) - self._half
            better = (excess > _ROUNDING) & (other_excess < excess)
            joints, excess = np.where(better, other, joints), np.where(better, other_excess, excess)
        worst = excess.max(axis=-1)
        away = np.concatenate([rows.positions[..., None] - seed[0], joints - seed[1:]], axis=-1)
        rank = np.where(worst <= _ROUNDING, np.einsum("ijk,ijk->ij", away, away), _OUT + worst)
        rank[np.isnan(worst)] = math.inf
        return _Ranked(rank, away)

    def _in_range(self, rows: _Rows, ranked: _Ranked, seed: np.ndarray) -> list[_Found]:
        """Return what is in range, the nearest first."""
        inside = np.argwhere(ranked.rank < _OUT)
        inside = inside[ranked.rank[tuple(inside.T)].argsort(kind="stable")]
        return [
            _Found(float(ranked.rank[row, at]), int(rows.slots[row]), seed + ranked.away[row, at])
            for row, at in inside.tolist()
        ]

    def _divide(self, flange: np.ndarray, rows: _Rows, seed: np.ndarray, one: bool) -> tuple[list[_Found], list[float]]:
        """Return what of each branch, or of all (`one`), is nearest to the seed, and the positions where the wrist is singular."""
        best = np.full(len(SLOTS), math.inf)
        found: list[_Found] = []
        flips: list[float] = []
        while len(rows.slots):
            ranked = self._rank(rows, seed, None)
            lowest = ranked.rank.argmin(axis=1)
            for row, (at, slot) in enumerate(zip(lowest.tolist(), rows.slots.tolist())):
                rank = float(ranked.rank[row, at])
                if rank < min(best[slot], _OUT):
                    best[slot] = rank
                    found.append(_Found(rank, slot, seed + ranked.away[row, at]))
            if one:
                best[:] = best.min()
            chosen, first, last, flipped = _promising(rows, ranked, best[rows.slots], self._ends[0])
            flips += flipped
            rows = self._between(
                flange, rows.slots[chosen], rows.positions[chosen, first], rows.positions[chosen, last]
            )
        return sorted(found, key=lambda each: each.rank), flips

    def _choices_of_turns(self, seed: np.ndarray) -> Iterator[tuple[int, ...]]:
        """Return by how many whole turns each of the arm's joints may be further than the nearest one, in all combinations."""
        choices = []
        for near, (low, high) in zip(seed[1:].tolist(), self._ends[1:]):
            turns = range(math.ceil((low - near) / TURN - 0.5), math.floor((high - near) / TURN + 0.5) + 1)
            choices.append(turns)
        return product(*choices)

    def _first_confirmed(self, found: Iterable[_Found], pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return the first that forward kinematics confirms, as a list; empty if there is none."""
        solutions = (self._solution(each, pose, seed) for each in found)
        return next(([solution] for solution in solutions if solution is not None), [])

    def _solution(self, found: _Found, pose: Pose, seed: np.ndarray) -> IkSolution | None:
        return self.confirmed(found.q.tolist(), pose, seed, SLOTS[found.slot])

    def _nearest_at(
        self, position: float, pose: Pose, seed: np.ndarray, configuration: Configuration | None
    ) -> list[IkSolution]:
        """Return the nearest solution with the carriage at a position, as a list; empty if there is none."""
        of_arm = self._arm.find(self._carriage.seen_from(pose, position), seed[1:].tolist(), configuration)
        return [] if of_arm is None else self._lifted(position, of_arm, pose, seed)

    def _lifted(self, position: float, of_arm: IkSolution, pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return the arm's solution at a position as one of the whole chain; empty if forward kinematics does not confirm it."""
        solution = self.confirmed([position, *of_arm.q.tolist()], pose, seed, of_arm.configuration)
        return [] if solution is None else [solution]

    def _families(
        self, pose: Pose, seed: np.ndarray, configuration: Configuration | None, singular: Iterable[float]
    ) -> Iterator[IkSolution]:
        """Yield all solutions with a singular wrist, at the positions where it is singular."""
        for position in singular:
            try:
                of_arm = self._arm.all(self._carriage.seen_from(pose, position), seed[1:], configuration)
            except KinematicsError:
                continue  # out of range at this position, or not in this configuration
            for solution in of_arm:
                for lifted in self._lifted(position, solution, pose, seed):
                    if self._wrist_angle(lifted.q) <= _OF_FAMILY:
                        yield lifted

    def _wrist_angle(self, q: np.ndarray) -> float:
        """Return |sin| of the angle between axes 4 and 6."""
        return abs(math.sin(q[5] - self._arm.model.signs[4] * self._arm.model.offsets[4]))

    def _search_or_explain(self, pose: Pose, seed: np.ndarray, configuration: Configuration | None) -> IkSolution:
        """Return the solution that the search finds, or raise the error that says why there is none."""
        if configuration is not None:
            # raises the reason if no configuration reaches the pose
            others = {str(solution.configuration) for solution in self.all(pose, seed)}
            raise BranchError(
                str(configuration), tuple(sorted(others)), "does not exist for this pose within the ranges"
            )
        try:
            found = self._search.nearest(pose, seed)
            return replace(found, configuration=self.configuration(found.q))
        except KinematicsError:
            # the closed form gives a more exact reason
            self._explain(pose)
            raise

    def _explain(self, pose: Pose) -> None:
        """Raise the error that says why there is no solution at any position."""
        targets = [self._arm.flange(self._carriage.seen_from(pose, position)) for position in self._even.tolist()]
        branches, _, extension = self._arm.branches(np.array(targets))
        best = int(extension.argmax())
        if extension[best] < 0.0:
            raise UnreachableError(-float(extension[best]), self._arm.is_too_close(targets[best]))
        rows = branches.reshape(-1, 6)
        self._arm.raise_range_error(rows[np.isfinite(rows).all(axis=1)])


def _has_turns(solution: IkSolution, other: _Found) -> bool:
    """Return whether a solution is of a branch, with the same whole turns."""
    return solution.configuration == SLOTS[other.slot] and bool(np.abs(solution.q - other.q)[1:].max() < 0.5 * TURN)


def _promising(
    rows: _Rows, ranked: _Ranked, best: np.ndarray, axis: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[float]]:
    """Return where something nearer may be than the best of each row.

    Args:
        best: Shape (r,). Squared distance.
        axis: Ends of the linear axis.

    Returns:
        Row, first and last position of k intervals, shape (k,) each; and the positions where a wrist is exactly singular.
    """
    rank, away = ranked
    wide = np.diff(rows.positions, axis=1)
    moved = np.diff(rows.joints, axis=1)
    moved -= TURN * np.rint(moved * (1.0 / TURN))
    fastest = np.abs(moved, out=moved).max(axis=-1)
    # a joint that turns one way comes as near as this; one that moves by much may turn the other way
    square = away * away
    gaps = np.minimum(square[:, 1:], square[:, :-1])
    gaps *= away[:, 1:] * away[:, :-1] > 0.0
    either = fastest > _EITHER_WAY
    gaps[..., [1, 4, 5, 6]] *= ~either[..., None]
    bounds = gaps.sum(axis=-1)
    ends = np.isnan(fastest)
    wrist = np.fmin(rows.wrist[:, 1:], rows.wrist[:, :-1])
    if ends.any():
        # a wrist that passes its singularity turns joints 4 and 6 by anything; else the branch ends as the elbow is stretched
        square[..., [4, 6]] *= (~(rows.wrist < _BENT))[..., None]
        total = square.sum(axis=-1)
        least = np.sqrt(np.fmin(total[:, 1:], total[:, :-1])[ends])
        bounds[ends] = np.maximum(0.0, least - _FALL * np.sqrt(wide[ends])) ** 2
    # a joint out of range at both ends may be within it between them if it moves by as much
    least = np.minimum(rank[:, 1:], rank[:, :-1])
    enters = ~(least - _OUT > fastest + _ROUNDING) | either
    promising = enters & np.isfinite(least) & (bounds < np.maximum(0.0, np.sqrt(best)[:, None] + wide - _NEARER) ** 2)
    wild = promising & ~(fastest <= _FAST)
    passes = wild & ((wrist < _PASS) | ((wrist < _OF_FAMILY) & (wide <= _FINEST)))
    flips = np.unique(
        np.round(np.where(rows.wrist[:, 1:] == wrist, rows.positions[:, 1:], rows.positions[:, :-1])[passes], 8)
    )
    wild &= ~passes
    bounds[~promising | passes | (wide <= _FINEST)] = math.inf
    # beyond the ends of the axis there is nothing, beyond those of an interval something lower
    beyond = np.where(rows.positions[:, [0, -1]] == axis, math.inf, -math.inf)
    padded = np.concatenate([beyond[:, :1], rank, beyond[:, 1:]], axis=1)
    row, at = ((rank < padded[:, :-2]) & (rank <= padded[:, 2:])).nonzero()
    first, last = np.maximum(at - 1, 0), np.minimum(at + 1, rank.shape[1] - 1)
    lowest = np.minimum(bounds[row, first], bounds[row, last - 1])
    in_range = np.maximum(rank[row, first], rank[row, last]) < _OUT
    lowest[in_range & (np.maximum(fastest[row, first], fastest[row, last - 1]) < _SMOOTH)] = math.inf
    wild[row, first] = wild[row, last - 1] = False
    wild_row, wild_at = wild.nonzero()
    every = np.concatenate([lowest, bounds[wild_row, wild_at]])
    order = every.argsort(kind="stable")[: min(_INTERVALS, int(np.isfinite(every).sum()))]
    chosen = np.concatenate([row, wild_row])[order]
    first, last = np.concatenate([first, wild_at])[order], np.concatenate([last, wild_at + 1])[order]
    return chosen, first, last, flips.tolist()
