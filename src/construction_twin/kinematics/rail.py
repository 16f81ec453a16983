"""Inverse kinematics of an arm of the OPW kind on a linear axis: closed form at many positions of the carriage.

Between the ends of the wrist centre's reach the arm is solved on a grid. What lies beside each local minimum of a branch's distance
from the seed is divided again and again; also where the branch comes into range, and where its wrist is singular. There, and where
the carriage is now, the arm is solved alone. If nothing was found, `numeric` searches.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.closed_form import SLOTS, ClosedFormInverse
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import OpwModel, find_opw
from construction_twin.kinematics.solution import (
    TURN,
    ArmKind,
    Configuration,
    IkSolution,
    InverseKinematics,
    UnreachableError,
    check_pose,
    distinct,
    spaced,
)
from construction_twin.robot.description import JointValues
from construction_twin.robot.motion_errors import KinematicsError
from construction_twin.robot.urdf import chain_joints, parse_urdf

#: Spacing of the grid along the axis [m], its fewest steps between two ends of the reach, and parts of what is divided.
_SPACING, _FEWEST, _PARTS = 0.02, 12, 20
_FRACTIONS = np.linspace(0.0, 1.0, _PARTS + 1)
#: Most intervals divided at once; shorter ones are not divided [m].
_INTERVALS, _FINEST = 64, 1e-9
#: A wrist that bends by less may be singular near by; by less than the second, it is [rad].
_BENT, _SINGULAR = 0.1, 3e-7
#: Where the joints move by less in an interval, the nearest of its positions is near enough [rad].
_SMOOTH = 1e-4
#: A joint that moves by more between two positions of the grid may turn round there [rad].
_FAST = 0.5
#: Out of range by less is rounding [rad].
_ROUNDING = 3e-7
#: An edge of the reach is known this well; a root whose imaginary part is less is one, but for rounding [m].
_AT_EDGE, _TANGENT = 1e-7, 1e-5
#: The rank of a branch out of range is this and by how much [rad]; of one in range, its squared distance from the seed.
_OUT = 1e3
#: Solutions nearer to each other than this are one [rad]: they differ only in how exactly the nearest position was found.
_SAME = 0.01
#: Besides the nearest ones, `all` returns at most so many.
_MOST = 64

#: What a robot's description has for each joint.
_PER_JOINT = ("joint_names", "lower", "upper", "velocity", "acceleration", "jerk", "home", "axes", "linear")


class Carriage:
    """The carriage of an arm: its place in the base at position zero, its direction of travel, and the `arm` on it as its base."""

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

    def target_from_carriage(self, pose: Pose, position: float) -> Pose:
        """Return ``carriage_T_tip`` of a target ``base_T_tip`` with the carriage at a position."""
        origin = self.origin + position * self.direction
        return Pose(self.rotation.T @ (pose.position - origin), self.rotation.T @ pose.rotation)


def find_rail(chain: Chain) -> tuple[Carriage, OpwModel] | str:
    """Return the carriage of an arm on a linear axis, with the arm's model, or why the chain is not one."""
    if chain.robot.linear != (True,) + (False,) * 6:
        return "its joints are neither six revolute ones nor a prismatic one followed by six revolute ones"
    carriage = Carriage(chain)
    model = find_opw(carriage.arm)
    return model if isinstance(model, str) else (carriage, model)


class _Rows(NamedTuple):
    """Branches at positions, one branch to a row.

    Attributes:
        slots: Shape (r,). Each row's branch, as in `SLOTS`.
        positions: Shape (r, m). Ascending [m].
        joints: Shape (6, r, m). [rad]; nan: there is no such branch. Joints first: numpy is quicker along long last axes.
        wrist: Shape (r, m). |sin| of the wrist's angle.
    """

    slots: np.ndarray
    positions: np.ndarray
    joints: np.ndarray
    wrist: np.ndarray


class _Candidate(NamedTuple):
    """Rank, see `_OUT`; branch as in `SLOTS`; joint values of shape (7,)."""

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
        # the direction of travel in the directions of the arm's model
        self._travel = arm.model.base_T_opw[:3, :3].T @ (carriage.rotation.T @ carriage.direction)
        lower, upper = self.ranges.lower[1:], self.ranges.upper[1:]
        self._middle, self._half = 0.5 * (upper + lower), 0.5 * (upper - lower)
        # how far from its middle a range's window of one turn may lie, of which every angle is in range
        self._slack = np.maximum(self._half + _ROUNDING - 0.5 * TURN, 0.0)

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("OPW on a linear axis", f"behind joint 1, which is prismatic, {self._arm.kind.why}")

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: over all positions of the carriage."""
        start, flange = self._checked(pose, seed)
        best, singular = self._divide(flange, self._along(flange, start[0], configuration), start, one=True)
        found = self._first_confirmed(best, pose, start)
        for position in (start[0], *singular):
            of_arm = self._arm.find(
                self._carriage.target_from_carriage(pose, position), start[1:].tolist(), configuration
            )
            found += [] if of_arm is None else self._lifted(position, of_arm, pose, start)
        if found:
            return min(found, key=lambda solution: solution.distance)
        return self._search_or_explain(pose, start, configuration)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`: for each branch the nearest position of the carriage, and others spaced along it."""
        start, flange = self._checked(pose, seed)
        rows = self._along(flange, start[0], configuration)
        best, singular = self._divide(flange, rows, start, one=False)
        found = []
        for slot in rows.slots.tolist():
            for one in self._first_confirmed((each for each in best if each.slot == slot), pose, start):
                found += self.turned(one.q, pose, start, one.configuration)
        for position in (start[0], *singular):
            try:
                of_arm = self._arm.all(self._carriage.target_from_carriage(pose, position), start[1:], configuration)
            except KinematicsError:
                continue  # out of range at this position, or not in this configuration
            found += [lifted for one in of_arm for lifted in self._lifted(position, one, pose, start)]
        if not found:
            return [self._search_or_explain(pose, start, configuration)]
        found = distinct(sorted(found, key=lambda solution: solution.distance), _SAME)
        # others with the whole turns nearest to the seed: with other ones the arm would touch the same things
        rank, away = self._rank(rows, start)
        row, at = (rank < _OUT).nonzero()
        order = rank[row, at].argsort(kind="stable")
        row, q = row[order], start + away[:, row, at].T[order]

        def confirm(number: int) -> IkSolution | None:
            return self.confirmed(q[number].tolist(), pose, start, SLOTS[rows.slots[row[number]]])

        found += spaced(q, found, _MOST, confirm)
        return sorted(found, key=lambda solution: solution.distance)

    def configuration(self, q: JointValues) -> Configuration:
        """See `InverseKinematics.configuration`: the arm's."""
        return self._arm.configuration(q[1:])

    def _checked(self, pose: Pose, seed: JointValues) -> tuple[np.ndarray, np.ndarray]:
        """Return the seed, shape (7,), and a target as the arm's model has it with the carriage at zero, shape (4, 4)."""
        self.chain.robot.check_range(seed)
        check_pose(pose)
        return np.array(seed, dtype=float), self._arm.flange(self._carriage.target_from_carriage(pose, 0.0))

    def _branches(self, flange: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the arm's branches at positions, shape (m, 8, 6), and |sin| of their wrist angles, shape (m, 8)."""
        flanges = np.empty((len(positions), 4, 4))
        flanges[:] = flange
        flanges[:, :3, 3] -= positions[:, None] * self._travel
        joints, wrist, _ = self._arm.branches(flanges)
        return joints, wrist

    def _along(self, flange: np.ndarray, position: float, configuration: Configuration | None) -> _Rows:
        """Return the branches of a configuration on a grid between the ends of the reach, and at a position."""
        low, high = self._ends[0]
        edges = self._edges(flange)
        ends = np.unique(np.clip([low, high, *(edges - _AT_EDGE), *(edges + _AT_EDGE)], low, high)).tolist()
        grids = [
            np.linspace(one, other, max(_FEWEST, math.ceil((other - one) / _SPACING)) + 1)
            for one, other in zip(ends, ends[1:])
            if other - one > 3.0 * _AT_EDGE
        ]
        positions = np.unique(np.concatenate([*grids, ends, [position]]))
        slots = np.array(
            [slot for slot, have in enumerate(SLOTS) if configuration is None or have.matches(configuration)]
        )
        joints, wrist = self._branches(flange, positions)
        at = np.broadcast_to(positions, (len(slots), len(positions)))
        return _Rows(slots, at, np.ascontiguousarray(joints.T[:, slots]), wrist.T[slots])

    def _between(self, flange: np.ndarray, slots: np.ndarray, low: np.ndarray, high: np.ndarray) -> _Rows:
        """Return a branch at positions that divide an interval, for each of k branches and intervals."""
        positions = low[:, None] + (high - low)[:, None] * _FRACTIONS
        joints, wrist = self._branches(flange, positions.ravel())
        own = np.arange(positions.size), np.repeat(slots, _PARTS + 1)
        joints = np.ascontiguousarray(joints[own].T).reshape(6, *positions.shape)
        return _Rows(slots, positions, joints, wrist[own].reshape(positions.shape))

    def _edges(self, flange: np.ndarray) -> np.ndarray:
        """Return the positions where the wrist centre is at an edge of a shoulder's reach [m].

        There its distance from axis 2 is the stretched or folded arm's: a quartic in the position.
        """
        model = self._arm.model
        centre = np.array(model.wrist_centre(flange)) - [0.0, 0.0, model.c1]
        squares = np.array([self._travel**2, -2.0 * centre * self._travel, centre**2])
        across = squares[:, :2].sum(axis=1) - [0.0, 0.0, model.b**2]
        whole = across + squares[:, 2]
        forearm = math.hypot(model.a2, model.c3)
        # the quartics' leading coefficient is 1, as the travel's length: their roots are the eigenvalues of these matrices
        companions = np.zeros((2, 4, 4))
        companions[:, [1, 2, 3], [0, 1, 2]] = 1.0
        for companion, radius in zip(companions, (model.c2 + forearm, model.c2 - forearm)):
            level = whole + [0.0, 0.0, model.a1**2 - radius**2]
            quartic = np.convolve(level, level)
            quartic[2:] -= 4.0 * model.a1**2 * across
            companion[0] = -quartic[1:]
        every = np.linalg.eigvals(companions).ravel()
        if model.b:
            every = np.append(every, np.roots(across))
        return every[np.abs(every.imag) < _TANGENT].real

    def _rank(self, rows: _Rows, seed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ranks (`_OUT`), shape (r, m), and distances from the seed, shape (7, r, m), with the nearest turns in range."""
        middle, half, start = (each[:, None, None] for each in (self._middle, self._half, seed[1:]))
        centre = np.clip(start, middle - self._slack[:, None, None], middle + self._slack[:, None, None])
        joints = rows.joints - TURN * np.rint((rows.joints - centre) * (1.0 / TURN))
        worst = (np.abs(joints - middle) - half).max(axis=0)
        away = np.empty((7, *worst.shape))
        away[0] = rows.positions - seed[0]
        np.subtract(joints, start, out=away[1:])
        rank = np.where(worst <= _ROUNDING, (away * away).sum(axis=0), _OUT + worst)
        # nan becomes inf
        return np.fmin(rank, math.inf), away

    def _divide(
        self, flange: np.ndarray, rows: _Rows, seed: np.ndarray, one: bool
    ) -> tuple[list[_Candidate], list[float]]:
        """Return what of each branch, or of all (`one`), is nearest to the seed, and the positions where the wrist is singular."""
        best = np.full(len(SLOTS), math.inf)
        found: list[_Candidate] = []
        singular: list[float] = []
        coarse = True
        while True:
            rank, away = self._rank(rows, seed)
            lowest = rank.argmin(axis=1)
            for number, (column, slot) in enumerate(zip(lowest.tolist(), rows.slots.tolist())):
                value = float(rank[number, column])
                if value < min(best[slot], _OUT):
                    best[slot] = value
                    found.append(_Candidate(value, slot, seed + away[:, number, column]))
            if one:
                best[:] = best.min()
            row, at, flips = _promising(rows, rank, away, best[rows.slots], coarse)
            singular += flips
            coarse = False
            if not len(row):
                break
            rows = self._between(flange, rows.slots[row], rows.positions[row, at], rows.positions[row, at + 1])
        return sorted(found, key=lambda each: each.rank), np.unique(np.round(singular, 8)).tolist()

    def _first_confirmed(self, found: Iterable[_Candidate], pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return the first that forward kinematics confirms, as a list; empty if there is none."""
        solutions = (self.confirmed(each.q.tolist(), pose, seed, SLOTS[each.slot]) for each in found)
        return next(([solution] for solution in solutions if solution is not None), [])

    def _lifted(self, position: float, of_arm: IkSolution, pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return the arm's solution at a position as one of the whole chain; empty if forward kinematics does not confirm it."""
        solution = self.confirmed([position, *of_arm.q.tolist()], pose, seed, of_arm.configuration)
        return [] if solution is None else [solution]

    def _search_or_explain(self, pose: Pose, seed: np.ndarray, configuration: Configuration | None) -> IkSolution:
        """Return the solution that the search finds, or raise the error that says why there is none."""
        if configuration is not None:
            self.raise_configuration_error(configuration, pose, seed)
        try:
            found = self._search.nearest(pose, seed)
            return replace(found, configuration=self.configuration(found.q))
        except KinematicsError:
            # the closed form gives a more exact reason
            self._explain(pose)
            raise

    def _explain(self, pose: Pose) -> None:
        """Raise the error that says why there is no solution at any position."""
        low, high = self._ends[0]
        positions = np.linspace(low, high, math.ceil((high - low) / _SPACING) + 2).tolist()
        targets = [self._arm.flange(self._carriage.target_from_carriage(pose, position)) for position in positions]
        branches, _, extension = self._arm.branches(np.array(targets))
        best = int(extension.argmax())
        if extension[best] < 0.0:
            raise UnreachableError(-float(extension[best]), self._arm.is_too_close(targets[best]))
        rows = branches.reshape(-1, 6)
        self._arm.raise_range_error(rows[np.isfinite(rows).all(axis=1)])


def _minima(values: np.ndarray) -> np.ndarray:
    """Return the mask of each row's finite local minima, shape (r, m)."""
    falls = np.ones((len(values), values.shape[1] + 1), dtype=bool)
    np.less(values[:, 1:], values[:, :-1], out=falls[:, 1:-1])
    falls[:, -1] = False
    return falls[:, :-1] & ~falls[:, 1:] & (values < math.inf)


def _promising(
    rows: _Rows, rank: np.ndarray, away: np.ndarray, nearest: np.ndarray, coarse: bool
) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return where something nearer may be: row and first column of intervals; and the positions where the wrist is singular.

    `nearest`, shape (r,): squared distance of the best of each row's branch. `coarse`: a branch may also come nearer between two
    positions where it comes into range or moves fast.
    """
    chosen = _either(_minima(rank))
    if coarse:
        inside, fast = rank < _OUT, np.abs(away[:, :, 1:] - away[:, :, :-1]).max(axis=0) > _FAST
        chosen |= fast | (inside[:, 1:] != inside[:, :-1])
    bends = rows.wrist < _BENT
    singular: list[float] = []
    turns_over: np.ndarray | None = None
    if bends.any():
        bends &= _minima(np.fmin(rows.wrist, math.inf))
        singular = rows.positions[bends & (rows.wrist <= _SINGULAR)].tolist()
        turns_over = _either(bends & (rows.wrist > _SINGULAR))
        chosen |= turns_over
    row, at = chosen.nonzero()
    first, second = away[:, row, at], away[:, row, at + 1]
    fastest = np.abs(second - first).max(axis=0)
    # a joint that turns one way between two positions comes no nearer than this; 0 where the branch ends
    gaps = np.where(first * second > 0.0, np.minimum(first * first, second * second), 0.0)
    bound = gaps.sum(axis=0)
    if turns_over is not None:
        # there joints 4 and 6 turn by anything
        bound -= turns_over[row, at] * (gaps[4] + gaps[6])
    ranks = rank[row, at], rank[row, at + 1]
    least = np.minimum(*ranks)
    keep = (bound < nearest[row]) & ~(least - _OUT > fastest) & (second[0] - first[0] > _FINEST)
    keep &= ~((np.maximum(*ranks) < _OUT) & (fastest < _SMOOTH))
    kept = keep.nonzero()[0]
    kept = kept[least[kept].argsort(kind="stable")[:_INTERVALS]]
    return row[kept], at[kept], singular


def _either(columns: np.ndarray) -> np.ndarray:
    """Return the mask of the intervals beside marked columns, shape (r, m - 1)."""
    return columns[:, 1:] | columns[:, :-1]
