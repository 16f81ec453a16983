"""Inverse kinematics of an arm of the OPW kind on a linear axis: closed form at many positions of the carriage.

The seventh joint adds one degree of freedom: the position of the carriage. The axis is divided into evenly spaced positions
("places"), the arm's branches are solved at all of them at once, and the surroundings of the best places are divided again
until the place is exact. Four kinds of place get special treatment:

- Near a singular wrist, joints 4 and 6 turn far within micrometres of travel. `rail_singularities` finds such places, and more
  places are added around them (except within one spacing of a place where the arm is also stretched).
- Where the wrist is exactly singular, and where the carriage stands now if branches may be lost there, the arm is solved alone.
- Where a shoulder's reach begins or ends along a level axis, the place is calculated, and places are added behind it.
- If nothing was found at any place, `numeric` searches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from construction_twin.core.motion_errors import BranchError, KinematicsError, UnreachableError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.closed_form import SLOTS, Branches, ClosedFormInverse
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import NotOpw, OpwModel, find_opw
from construction_twin.kinematics.rail_singularities import find_singularities
from construction_twin.kinematics.solution import (
    TURN,
    ArmKind,
    Configuration,
    IkSolution,
    InverseKinematics,
    check_pose,
    distinct,
    residual,
)
from construction_twin.robot.description import JointValues
from construction_twin.robot.urdf import chain_joints, parse_urdf

#: Number of evenly spaced places along the axis.
_PLACES = 101
#: How often the surroundings of a place are narrowed, at most; and the fraction of them that is left, where they are smooth.
_NARROWINGS, _LEFT = 9, (0.03, 0.004)
#: Where the distance changes by more from one place to the next, a branch ends between them or goes on with another whole turn;
#: nothing can be interpolated there, and what is between them is divided into this many parts [rad].
_JUMP, _DIVIDED = 0.7, 8
#: Surroundings in which the distance from the seed differs by less are not narrowed any further [rad]; nor are shorter ones
#: in which a branch ends [m].
_FLAT, _NARROW = 5e-6, 2e-6
#: Nor are surroundings in which it differs by less than the first, if a parabola falls by less than the second [rad].
_SMOOTH, _FALL = 1e-3, 1e-7
#: Surroundings at an end of the axis are divided at these fractions from the end, until they are this short [m].
_FROM_END, _SHORT = (0.003, 0.06, 0.4), 1e-4
#: Near a singular wrist, places are added where joint 4 has turned by these angles [rad].
_WRIST_TURNS = np.linspace(-1.5, 1.5, 25)
#: A wrist that comes closer to singular than this counts as exactly singular: only the sum of joints 4 and 6 is given [rad].
_SINGULAR = 4e-7
#: A solution whose wrist is this close to singular belongs to the family of solutions of a singular place [rad].
_OF_FAMILY = 1e-3
#: Places whose distance from the seed exceeds that of the best solution so far by more than this are not narrowed; and the same
#: where the distance jumps from one place to the next [rad].
_PROMISING, _ROUGH = 0.15, 1.3
#: How much below the parabola through three places the distance may be, where it does not jump [rad].
_CLOSE = 0.08
#: At an edge of the reach the arm is solved this far within it, where the elbow is almost stretched or folded [m], and at these
#: fractions of the spacing from there: the elbow moves with the root of the distance. An axis this level is horizontal.
_AT_EDGE, _FROM_EDGE, _LEVEL = 1e-11, np.array([0.0, 0.003, 0.03, 0.15, 0.45]), 1e-9
#: A wrist centre that is out of reach by less, or closer to axis 1, may have lost its branches by rounding [m].
_AT_REACH = 1e-6
#: Slots of each shoulder, front and back.
_SIDES = ([0, 1, 4, 5], [2, 3, 6, 7])
#: Joints 2 and 3 further out of range are not looked at [rad].
_FAR = 0.6
#: Of each branch, the one with the other elbow.
_PARTNERS = np.arange(len(SLOTS)) ^ 1
#: If a branch is out of range by less than this, it may be in range between two places [rad].
_NEARLY = 0.1
#: Cost of a branch out of range: above every squared distance in range; the excess is added to it.
_OUTSIDE = 1e6
#: Out of range by less is rounding [rad].
_ROUNDING = 3e-7
#: Most places whose surroundings are divided for the nearest solution.
_CANDIDATES = 8


def find_rail(chain: Chain) -> tuple[Chain, OpwModel] | NotOpw:
    """Return the arm on a linear axis, with its model, or why the chain is not one.

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    arm, model : Chain, OpwModel
        The six joints behind the first one; the carriage is their base.
    """
    robot = chain.robot
    if robot.linear != (True,) + (False,) * 6:
        return NotOpw("it is not one prismatic joint followed by six revolute ones")
    joints = chain_joints(parse_urdf(robot.urdf), robot.base_link, robot.tip_link)
    carriage = next(joint.child for joint in joints if joint.name == robot.joint_names[0])
    lists = ("joint_names", "lower", "upper", "velocity", "acceleration", "jerk", "home", "axes", "linear")
    arm = Chain(replace(robot, base_link=carriage, **{name: getattr(robot, name)[1:] for name in lists}))
    model = find_opw(arm)
    return model if isinstance(model, NotOpw) else (arm, model)


@dataclass(frozen=True, eq=False)
class _AlongAxis:
    """The arm's branches at places along the axis.

    Attributes
    ----------
    places : array, shape (m,)
        Ascending [m].
    branches : array, shape (m, 8, 6)
        [rad]
    singular : list of float
        Places where the wrist is exactly singular [m].
    special : bool
        Whether at the seed's place the wrist is near its singularity, or branches are missing that are not out of reach.
    flange : array, shape (4, 4)
        The target as `ClosedFormInverse.flange` gives it, with the carriage at zero.
    edge : array, shape (m, 8)
        Whether the place is at the edge of the branch's reach, within `_AT_EDGE`.
    """

    places: np.ndarray
    branches: np.ndarray
    singular: list[float]
    special: bool
    flange: np.ndarray
    edge: np.ndarray


class _Edge(NamedTuple):
    """A place where a shoulder's reach begins or ends.

    Attributes
    ----------
    place : float
        [m]
    inwards : float
        1 if the reach begins there, -1 if it ends.
    side : int
        0: shoulder in front, 1: back.
    """

    place: float
    inwards: float
    side: int


class RailInverse(InverseKinematics):
    """Inverse kinematics of an arm of the OPW kind on a linear axis.

    Parameters
    ----------
    chain : Chain
        All seven joints.
    arm : ClosedFormInverse
        The six on the carriage.
    search : NumericInverse
        For the whole chain.
    """

    def __init__(self, chain: Chain, arm: ClosedFormInverse, search: NumericInverse):
        super().__init__(chain, arm.settings)
        self._arm = arm
        self._search = search
        self._lower, self._upper = np.array(chain.robot.lower), np.array(chain.robot.upper)
        self._even = np.linspace(chain.robot.lower[0], chain.robot.upper[0], _PLACES)
        self._ranges = list(zip(chain.robot.lower, chain.robot.upper))
        home = np.array(chain.robot.home)
        home[0] = 0.0
        whole, part = chain.forward(home), arm.chain.forward(home[1:])
        # base_T_carriage with the carriage at zero, and the direction in which it travels
        self._rotation = whole.rotation @ part.rotation.T
        self._origin = whole.position - self._rotation @ part.position
        self._axis = chain.jacobian(home)[:3, 0]
        # of joints 2 and 3 of the arm: middle of the range, and half of it with a margin, at most everything
        self._middle = 0.5 * (self._lower + self._upper)[2:4]
        self._half = 0.5 * (self._upper - self._lower)[2:4] + _FAR
        # ... and the same in the directions of the arm's model
        self._travel = arm.model.base_T_opw[:3, :3].T @ (self._rotation.T @ self._axis)

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("OPW on a linear axis", f"behind joint 1, which is prismatic, {self._arm.kind.why}")

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: over all positions of the carriage."""
        start = self._checked(pose, seed)
        wanted = self._wanted(configuration)
        along = self._solve_along(pose, start)
        found = list(self._best(pose, start, along, wanted, np.zeros(6), _CANDIDATES))
        for place in [*along.singular, *([float(start[0])] if along.special or not found else [])]:
            found += self._nearest_at(place, pose, start, configuration)
        if found:
            return min(found, key=lambda solution: solution.distance)
        return self._search_or_explain(pose, start, configuration)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`: for each branch and choice of whole turns, the nearest position of the carriage."""
        start = self._checked(pose, seed)
        wanted = self._wanted(configuration)
        robot = self.chain.robot
        turns = [(-1, 0, 1) if high - low > TURN else (0,) for low, high in zip(robot.lower[1:], robot.upper[1:])]
        along = self._solve_along(pose, start)
        none = (0,) * 6
        here = self._nearest_at(float(start[0]), pose, start, configuration)
        nearest: dict[tuple, IkSolution] = {(solution.configuration, none): solution for solution in here}
        for turn in product(*turns):
            for solution in self._best(pose, start, along, wanted, np.array(turn, dtype=float), None):
                family = (solution.configuration, turn)
                if family not in nearest or solution.distance < nearest[family].distance:
                    nearest[family] = solution
        found = list(nearest.values())
        if along.singular:
            found = [solution for solution in found if self._wrist_angle(solution.q) > _OF_FAMILY]
            found += self._families(pose, start, configuration, along.singular)
        if found:
            return distinct(sorted(found, key=lambda solution: solution.distance))
        return [self._search_or_explain(pose, start, configuration)]

    def configuration(self, q: JointValues) -> Configuration:
        """See `InverseKinematics.configuration`: the arm's."""
        return self._arm.configuration(q[1:])

    def _checked(self, pose: Pose, seed: JointValues) -> np.ndarray:
        self.chain.robot.check_range(seed)
        check_pose(pose)
        return np.array(seed, dtype=float)

    def _wanted(self, configuration: Configuration | None) -> np.ndarray:
        return np.array([configuration is None or have.matches(configuration) for have in SLOTS])

    def _solve_along(self, pose: Pose, seed: np.ndarray) -> _AlongAxis:
        """Solve the arm at places all along the axis."""
        low, high = self._ranges[0]
        flange = self._arm.flange(self._seen_from(pose, 0.0))
        even = self._even
        places = np.append(even, seed[0])
        q, wrist, _ = self._branches(flange, places)
        wrist_here = wrist[-1].tolist()
        more, singular = [], []
        for found in find_singularities(even, wrist[:-1, :4], lambda near: self._branches(flange, near).wrist[:, :4]):
            if found.angle > _SINGULAR:
                more.append(found.place + found.width * np.tan(_WRIST_TURNS))
            # a place beyond the end by rounding is at the end
            elif low - _ROUNDING <= found.place <= high + _ROUNDING:
                singular.append(float(min(max(found.place, low), high)))
        apart = float(even[1] - even[0])
        edges = [edge for edge in self._edges(flange) if low < edge.place < high]
        more += [edge.place + edge.inwards * (_AT_EDGE + apart * _FROM_EDGE) for edge in edges]
        if more:
            extra = np.minimum(np.maximum(np.concatenate(more), low), high)
            places = np.concatenate([places, extra])
            q = np.concatenate([q, self._branches(flange, extra).q])
        order = places.argsort(kind="stable")
        places, q = places[order], q[order]
        at_edge = np.zeros((len(places), len(SLOTS)), dtype=bool)
        for edge in edges:
            at_edge[places.searchsorted(edge.place + edge.inwards * _AT_EDGE), _SIDES[edge.side]] = True
        return _AlongAxis(places, q, singular, self._is_special(flange, float(seed[0]), wrist_here), flange, at_edge)

    def _is_special(self, flange: np.ndarray, place: float, wrist: list[float]) -> bool:
        """Return whether the wrist is near its singularity, or a branch is missing although it is not out of reach.

        `wrist`, length 8, is a row of `Branches.wrist` at the place.
        """
        if any(angle <= _OF_FAMILY for angle in wrist):
            return True
        dx, dy, dz = self._travel.tolist()
        x, y, z = self._arm.model.wrist_centre(flange)
        x, y, z = x - place * dx, y - place * dy, z - place * dz
        if math.hypot(x, y) < _AT_REACH:
            return True
        margins = self._arm.model.margins(x, y, z)
        return any(
            min(margin) > -_AT_REACH and any(math.isnan(wrist[slot]) for slot in slots)
            for margin, slots in zip(margins, _SIDES)
        )

    def _edges(self, flange: np.ndarray) -> list[_Edge]:
        """Return the places at which a shoulder's reach begins or ends; empty for an axis that is not level."""
        model = self._arm.model
        (x, y, z), (dx, dy, dz) = model.wrist_centre(flange), self._travel.tolist()
        square = dx * dx + dy * dy
        if abs(dz) > _LEVEL or square < 0.5:
            return []
        forearm = math.hypot(model.a2, model.c3)
        along, beside = (x * dx + y * dy) / square, (x * dy - y * dx) ** 2 / square
        edges = []
        for side, offset in enumerate((model.a1, -model.a1)):
            for sense, radius in ((1.0, model.c2 + forearm), (-1.0, abs(model.c2 - forearm))):
                level = radius**2 - (z - model.c1) ** 2
                if level < 0.0:
                    continue
                for root in (math.sqrt(level), -math.sqrt(level)):
                    # horizontal distance of the wrist centre to axis 1, without b
                    distance = offset + root
                    half = (distance**2 + model.b**2 - beside) / square
                    if distance < 0.0 or half <= 0.0:
                        continue
                    half = math.sqrt(half)
                    # with growing distance from axis 1 the wrist centre leaves the outer edge if it is on its far side
                    outwards = sense * (1.0 if root > 0.0 else -1.0)
                    edges += [_Edge(along + half, -outwards, side), _Edge(along - half, outwards, side)]
        return edges

    def _best(
        self,
        pose: Pose,
        seed: np.ndarray,
        along: _AlongAxis,
        wanted: np.ndarray,
        turn: np.ndarray,
        most: int | None,
    ) -> Iterator[IkSolution]:
        """Yield the nearest solutions around the `most` best places, best first; None: around every local minimum."""
        places = along.places
        squares, excess = self._turned_where_near(along.branches, seed, places, turn, wanted)
        cost = _cost(squares, excess)
        valley = excess < _NEARLY
        valley[1:] &= cost[1:] <= cost[:-1]
        valley[:-1] &= cost[:-1] <= cost[1:]
        distances = np.sqrt(squares)
        # next to a rough stretch the distance may fall far below what is seen at the places
        rough = np.zeros((len(places) + 1, len(SLOTS)), dtype=bool)
        rough[1:-1] = ~(np.abs(np.diff(distances, axis=0)) < _JUMP)
        # where a branch ends, its partner with the other elbow begins
        missing = np.isnan(squares)
        ends = np.zeros_like(valley)
        ends[:-1] = missing[1:]
        ends[1:] |= missing[:-1]
        for row, slot in zip(*(part.tolist() for part in np.nonzero(along.edge & ends & ~missing))):
            # at the edge itself nothing jumps: if the partner goes on downwards, the lowest place is not here
            ends[row, slot] = False
            inner = row + 1 if row == 0 or missing[row - 1, slot] else row - 1
            rough[row if inner > row else row + 1, slot] = False
            if inner < len(places) and cost[inner, slot ^ 1] < cost[row, slot ^ 1]:
                valley[row, slot] = False
        valley |= (valley & ends)[:, _PARTNERS] & wanted & np.isfinite(squares)
        rows, slots = np.nonzero(valley)
        hopeful = distances[rows, slots] - np.where((rough[:-1] | rough[1:])[rows, slots], _ROUGH, _PROMISING)
        inner = (rows > 0) & (rows < len(places) - 1)
        # at the ends the place itself takes the part of its neighbour; `inner` says that it does not count there
        before, here, after = (distances[rows + step * inner, slots] for step in (-1, 0, 1))
        # ... elsewhere it falls hardly below the parabola through the places
        second_difference = np.maximum(before + after - 2.0 * here, 1e-12)
        fall = np.minimum((after - before) ** 2 / (8.0 * second_difference), _PROMISING)
        hopeful = np.where(inner & (hopeful == here - _PROMISING), here - fall - _CLOSE, hopeful)
        best = math.inf
        for index in squares[rows, slots].argsort():
            if most == 0:
                return
            if most is not None and hopeful[index] > best:
                continue
            row, slot = int(rows[index]), int(slots[index])
            valley_here = _Valley(*_around(along, squares, excess, row, slot))
            solution = self._narrowed(pose, seed, along.flange, slot, turn, valley_here)
            if solution is not None:
                best = min(best, solution.distance)
                yield solution
                most = None if most is None else most - 1

    def _narrowed(
        self, pose: Pose, seed: np.ndarray, flange: np.ndarray, slot: int, turn: np.ndarray, valley: _Valley
    ) -> IkSolution | None:
        """Return the nearest solution of one branch around the best of two or three places; None: there is none."""
        q: list[float] = []
        start, turns = seed.tolist(), turn.tolist()
        for number in range(_NARROWINGS):
            near = valley.promising(number)
            if not near:
                break
            branches = self._branches(flange, np.array(near)).q[:, slot].tolist()
            found = [self._turned_one([place, *branch], start, turns) for place, branch in zip(near, branches)]
            row = valley.take(near, [each[1] for each in found], [each[2] for each in found])
            if row >= 0:
                q = found[row][0]
            if valley.done:
                break
        return None if valley.best >= _OUTSIDE else self._confirmed(q, pose, seed, SLOTS[slot])

    def _confirmed(
        self, q: list[float], pose: Pose, seed: np.ndarray, configuration: Configuration | None
    ) -> IkSolution | None:
        q = [min(max(value, lower), upper) for value, (lower, upper) in zip(q, self._ranges)]
        error_m, error_rad = residual(self.chain, q, pose)
        if error_m > self.settings.tolerance_m or error_rad > self.settings.tolerance_rad:
            return None
        return IkSolution(np.array(q), error_m, error_rad, math.dist(q, seed), configuration)

    def _nearest_at(
        self, place: float, pose: Pose, seed: np.ndarray, configuration: Configuration | None
    ) -> list[IkSolution]:
        """Return the nearest solution with the carriage at a place, as a list; empty if there is none."""
        of_arm = self._arm.find(self._seen_from(pose, place), seed[1:].tolist(), configuration)
        return [] if of_arm is None else self._lifted(place, of_arm, pose, seed)

    def _lifted(self, place: float, of_arm: IkSolution, pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return the arm's solution at a place as one of the whole chain; empty if forward kinematics does not confirm it."""
        solution = self._confirmed([place, *of_arm.q.tolist()], pose, seed, of_arm.configuration)
        return [] if solution is None else [solution]

    def _families(
        self, pose: Pose, seed: np.ndarray, configuration: Configuration | None, singular: Sequence[float]
    ) -> Iterator[IkSolution]:
        """Yield all solutions with a singular wrist, at the places where it is singular."""
        for place in singular:
            try:
                of_arm = self._arm.all(self._seen_from(pose, place), seed[1:], configuration)
            except KinematicsError:
                continue  # out of range at this place, or not in this configuration
            for solution in of_arm:
                for lifted in self._lifted(place, solution, pose, seed):
                    if self._wrist_angle(lifted.q) <= _OF_FAMILY:
                        yield lifted

    def _wrist_angle(self, q: np.ndarray) -> float:
        """Return |sin| of the angle between axes 4 and 6."""
        return abs(math.sin(q[5] - self._arm.model.signs[4] * self._arm.model.offsets[4]))

    def _turned(
        self, branches: np.ndarray, seed: np.ndarray, travel: np.ndarray, turn: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return squared distances of branches from the seed, and their range excess, each shape (m,).

        Branches, shape (m, 6), are moved by whole turns as near to the seed as the ranges allow, and then by `turn`, shape
        (6,). The excess is how far the worst joint is out of range [rad]; inf for branches that do not exist. `travel`, shape
        (m,), is how far the carriage is from the seed's place [m].
        """
        near = seed[1:]
        # one row for each joint: numpy is quickest along the long side
        away = np.subtract(branches.T, near[:, None], order="C")
        away -= TURN * np.rint(away * (1.0 / TURN))
        low, high = self._lower[1:] - near, self._upper[1:] - near
        # the seed is in range, so besides the nearest turn only the next one towards the range can be in it; out of range, the
        # one that is out by less, so that nothing jumps where the range ends
        for joint, (below, above) in enumerate(zip(low.tolist(), high.tolist())):
            row, both = away[joint], below + above
            if above < 0.5 * TURN and both < 0.0:
                row -= TURN * (row > max(above, 0.5 * (both + TURN)))
            elif -below < 0.5 * TURN and both > 0.0:
                row += TURN * (row < min(below, 0.5 * (both - TURN)))
        if turn.any():
            away += TURN * turn[:, None]
        squares = np.einsum("ij,ij->j", away, away) + travel * travel
        away -= (0.5 * (low + high))[:, None]
        np.abs(away, out=away)
        away -= (0.5 * (high - low))[:, None]
        excess = away.max(axis=0)
        excess[np.isnan(excess)] = np.inf
        return squares, excess

    def _turned_one(
        self, q: list[float], seed: Sequence[float], turn: Sequence[float]
    ) -> tuple[list[float], float, float]:
        """Return one branch with the carriage's place, turned as by `_turned`, its squared distance and excess.

        In plain floats, which is quicker for few places.
        """
        away = q[0] - seed[0]
        square, worst = away * away, -math.inf
        for joint in range(1, 7):
            near = seed[joint]
            away = q[joint] - near
            if away != away:  # nan: there is no such branch
                return q, math.nan, math.inf
            lower, upper = self._ranges[joint]
            low, high = lower - near, upper - near
            away -= TURN * round(away / TURN)
            if away > high:
                if low + TURN - away < away - high:
                    away -= TURN
            elif away < low and away + TURN - high < low - away:
                away += TURN
            away += TURN * turn[joint - 1]
            square += away * away
            excess = max(low - away, away - high)
            if excess > worst:
                worst = excess
            q[joint] = near + away
        return q, square, worst

    def _turned_where_near(
        self, branches: np.ndarray, seed: np.ndarray, places: np.ndarray, turn: np.ndarray, wanted: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return squared distances, nan where there is no branch, and excess as `_turned`, shape (m, 8), of wanted branches.

        Left out, as if there was no branch, is what is far out of range with joints 2 and 3, which hold most branches back.
        """
        squares, excess = np.full(branches.shape[:2], np.nan), np.full(branches.shape[:2], np.inf)
        # these two joints have less than one turn, so there is one value to look at
        two = branches[:, :, 1:3] - self._middle
        two -= TURN * np.rint(two * (1.0 / TURN))
        rows, slots = np.nonzero((np.abs(two) < self._half).all(axis=2) & wanted)
        squares[rows, slots], excess[rows, slots] = self._turned(
            branches[rows, slots], seed, places[rows] - seed[0], turn
        )
        return squares, excess

    def _seen_from(self, pose: Pose, place: float) -> Pose:
        """Return ``carriage_T_tip`` of a target with the carriage at a place."""
        origin = self._origin + place * self._axis
        return Pose(self._rotation.T @ (pose.position - origin), self._rotation.T @ pose.rotation)

    def _branches(self, flange: np.ndarray, places: np.ndarray) -> Branches:
        """Return the arm's branches with the carriage at places, shape (m,); see `ClosedFormInverse.branches`.

        `flange`, shape (4, 4), is the target with the carriage at zero.
        """
        flanges = np.empty((len(places), 4, 4))
        flanges[:] = flange
        flanges[:, :3, 3] -= places[:, None] * self._travel
        return self._arm.branches(flanges)

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
        """Raise the error that says why there is no solution at any place."""
        places = np.linspace(self._lower[0], self._upper[0], _PLACES)
        branches, _, extension = self._branches(self._arm.flange(self._seen_from(pose, 0.0)), places)
        best = int(extension.argmax())
        if extension[best] < 0.0:
            carriage_T_tip = self._seen_from(pose, float(places[best]))
            raise UnreachableError(-float(extension[best]), self._arm.is_too_close(self._arm.flange(carriage_T_tip)))
        rows = branches.reshape(-1, 6)
        self._arm.raise_range_error(rows[np.isfinite(rows).all(axis=1)])


def _cost(squares: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the cost to minimise: the squared distance in range, a larger cost out of range; rounding counts as in range."""
    inside = excess <= _ROUNDING
    return np.where(inside, squares, _OUTSIDE + np.where(np.isfinite(excess), excess, np.inf))


def _around(
    along: _AlongAxis, squares: np.ndarray, excess: np.ndarray, row: int, slot: int
) -> tuple[list[float], list[float], list[float]]:
    """Return what is known of a branch at a place and its neighbours: places, squared distances, excesses."""
    first, last = max(row - 1, 0), min(row + 1, len(along.places) - 1)
    # beyond the edge of the reach there is nothing to look for
    if along.edge[row, slot]:
        first = row if math.isnan(squares[first, slot]) else first
        last = row if math.isnan(squares[last, slot]) else last
    around = slice(first, last + 1)
    return along.places[around].tolist(), squares[around, slot].tolist(), excess[around, slot].tolist()


class _Valley:
    """The surroundings of a place that may hold the nearest solution of a branch, in plain floats, because they are few.

    Attributes
    ----------
    best : float
        Least cost so far, see `_costs`.
    done : bool
        Nothing is left to narrow.
    """

    def __init__(self, places: list[float], squares: list[float], excess: list[float]):
        self.best, self.done = math.inf, False
        self._x, self._f, self._e = places, squares, excess

    def promising(self, number: int) -> list[float]:
        """Return places around which the best one lies: minima, and where a branch ends or leaves the ranges."""
        x, f, e = self._x, self._f, self._e
        left_over = _LEFT[min(number, 1)]
        found: list[float] = []
        broken = False
        for left in range(len(x) - 1):
            x0, wide = x[left], x[left + 1] - x[left]
            e0, e1 = e[left], e[left + 1]
            # the branch ends between the two, or goes on with another whole turn
            if not abs(math.sqrt(f[left + 1]) - math.sqrt(f[left])) < _JUMP:
                broken = True
                found += [x0 + wide * part / _DIVIDED for part in range(1, _DIVIDED)]
            elif (e0 <= _ROUNDING) != (e1 <= _ROUNDING):
                root = x0 + wide * e0 / (e0 - e1)
                found += [root - left_over * wide, root, root + left_over * wide]
        if len(x) == 3 and not broken:
            wide = x[2] - x[0]
            for values in [f] if min(e) <= _ROUNDING else [e, f]:
                middle = _vertex(x, values)
                if middle is not None:
                    found += [middle - left_over * wide, middle, middle + left_over * wide]
        if not found and len(x) == 2:
            # the best place is the end: of the axis, where it mostly remains the best, or of the reach
            wide = x[1] - x[0]
            first = _costs(f[0], e[0]) <= _costs(f[1], e[1])
            found = [x[0] + part * wide if first else x[1] - part * wide for part in _FROM_END]
        found = [place for place in found if x[0] < place < x[-1] and place not in x]
        if number == 0:
            costs = [_costs(*each) for each in zip(f, e)]
            found.append(x[costs.index(min(costs))])  # its joint values are not known yet
        return found

    def take(self, places: list[float], squares: list[float], excess: list[float]) -> int:
        """Take what was found at the promising places; return the number of the best of them, -1 if none is better than before."""
        costs = [_costs(*each) for each in zip(squares, excess)]
        row = costs.index(min(costs))
        better = costs[row] < self.best
        if better:
            self.best = costs[row]
        known = dict(zip(self._x, zip(self._f, self._e))) | dict(zip(places, zip(squares, excess)))
        x = sorted(known)
        every = [_costs(*known[place]) for place in x]
        middle = every.index(min(every))
        self._x = x[max(middle - 1, 0) : middle + 2]
        self._f, self._e = ([known[place][part] for place in self._x] for part in (0, 1))
        spread = math.nan if any(map(math.isnan, self._f)) else math.sqrt(max(self._f)) - math.sqrt(min(self._f))
        wide = self._x[-1] - self._x[0]
        self.done = spread < _FLAT or (not spread < _JUMP and wide < _NARROW) or self._is_lowest(spread)
        # from the end of the axis the distance rises right away
        self.done |= len(self._x) == 2 and spread < _SMOOTH and wide < _SHORT and max(self._e) <= _ROUNDING
        return row if better else -1

    def _is_lowest(self, spread: float) -> bool:
        """Return whether the parabola through three places in range is hardly below the best of them."""
        if not (spread < _SMOOTH and len(self._x) == 3 and max(self._e) <= _ROUNDING):
            return False
        (x0, x1, x2), (f0, f1, f2) = self._x, self._f
        falling, rising = (f1 - f0) / (x1 - x0), (f2 - f1) / (x2 - x1)
        second = (rising - falling) / (x2 - x0)
        if not second > 0.0:
            return False
        slope = falling + second * (x1 - x0)
        return slope * slope / (4.0 * second) < _FALL * 2.0 * math.sqrt(f1)


def _costs(square: float, excess: float) -> float:
    """Return the cost to minimise: the squared distance in range, a larger cost out of range; rounding counts as in range."""
    if excess <= _ROUNDING:
        return square
    return _OUTSIDE + excess


def _vertex(x: list[float], f: list[float]) -> float | None:
    """Return where the parabola through three points is lowest, between them; None: it has no minimum there."""
    left, right = x[1] - x[0], x[2] - x[1]
    if not (left > 0.0 and right > 0.0):
        return None
    falling, rising = (f[1] - f[0]) / left, (f[2] - f[1]) / right
    second_difference = rising - falling
    if not second_difference > 0.0:
        return None
    place = 0.5 * (x[0] + x[1]) - falling * 0.5 * (left + right) / second_difference
    return min(max(place, x[0]), x[2])
