"""Inverse kinematics of an arm of the OPW kind on a linear axis: closed form at many positions of the carriage.

The seventh joint adds one degree of freedom: the position of the carriage. The axis is divided into evenly spaced positions
("places"), the arm's branches are solved at all of them at once, and the surroundings of the best places are divided again
until the place is exact. Three kinds of place get special treatment:

- Near a singular wrist, joints 4 and 6 turn far within micrometres of travel. `rail_singularities` finds such places, and more
  places are added around them (except within one spacing of a place where the arm is also stretched).
- Where the wrist is exactly singular, and where the carriage stands now, the arm is solved alone.
- If nothing was found at any place, `numeric` searches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from construction_twin.core.motion_errors import BranchError, KinematicsError, UnreachableError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.closed_form import SLOTS, Branches, ClosedFormInverse
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import NotOpw, OpwModel, find_opw
from construction_twin.kinematics.rail_singularities import find_singularities
from construction_twin.kinematics.solution import (
    TURN,
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
_PLACES = 301
#: How often the surroundings of a place are divided, and into how many places: the last are about 1e-7 of the axis apart.
_ZOOMS, _ZOOM_PLACES = 3, 33
#: Near a singular wrist, places are added where joint 4 has turned by these angles [rad].
_WRIST_TURNS = np.linspace(-1.5, 1.5, 25)
#: A wrist that comes closer to singular than this counts as exactly singular: only the sum of joints 4 and 6 is given [rad].
_SINGULAR = 4e-7
#: A solution whose wrist is this close to singular belongs to the family of solutions of a singular place [rad].
_OF_FAMILY = 1e-3
#: Places whose distance from the seed exceeds that of the best solution so far by more than this are not divided [rad].
_PROMISING = 0.3
#: If a branch is out of range by less than this, it may be in range between two places [rad].
_NEARLY = 0.1
#: Cost of a branch out of range: above every squared distance in range; the excess is added to it.
_OUTSIDE = 1e6
#: Out of range by less is rounding [rad].
_ROUNDING = 3e-7
#: Most places whose surroundings are divided for the nearest solution.
_CANDIDATES = 6


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
    """

    places: np.ndarray
    branches: np.ndarray
    singular: list[float]


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
        home = np.array(chain.robot.home)
        home[0] = 0.0
        whole, part = chain.forward(home), arm.chain.forward(home[1:])
        # base_T_carriage with the carriage at zero, and the direction in which it travels
        self._rotation = whole.rotation @ part.rotation.T
        self._origin = whole.position - self._rotation @ part.position
        self._axis = chain.jacobian(home)[:3, 0]

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: over all positions of the carriage."""
        start = self._checked(pose, seed)
        wanted = self._wanted(configuration)
        along = self._solve_along(pose, start)
        found = list(self._best(pose, start, along, wanted, np.zeros(6), _CANDIDATES))
        for place in (float(start[0]), *along.singular):
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
        low, high = self._lower[0], self._upper[0]
        places = np.linspace(low, high, _PLACES)
        branches, wrist, _ = self._branches(pose, places)
        more, singular = [seed[:1]], []
        for found in find_singularities(places, wrist[:, :4], lambda near: self._branches(pose, near).wrist[:, :4]):
            if found.angle > _SINGULAR:
                more.append(found.place + found.width * np.tan(_WRIST_TURNS))
            # a place beyond the end by rounding is at the end
            elif low - _ROUNDING <= found.place <= high + _ROUNDING:
                singular.append(float(min(max(found.place, low), high)))
        extra = np.unique(np.clip(np.concatenate(more), low, high))
        order = np.argsort(np.concatenate([places, extra]), kind="stable")
        return _AlongAxis(
            np.concatenate([places, extra])[order],
            np.concatenate([branches, self._branches(pose, extra).q])[order],
            singular,
        )

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
        _, squares, excess = self._turned(along.branches, seed, places, wanted, turn)
        cost = _cost(squares, excess)
        padded = np.pad(cost, ((1, 1), (0, 0)), constant_values=np.inf)
        valley = (cost <= padded[:-2]) & (cost <= padded[2:]) & (excess < _NEARLY)
        rows, slots = np.nonzero(valley)
        best = math.inf
        for index in squares[rows, slots].argsort():
            row, slot = int(rows[index]), int(slots[index])
            if most is not None and (most == 0 or math.sqrt(squares[row, slot]) > best + _PROMISING):
                return
            between = (
                float(places[max(row - 1, 0)]),
                float(places[row]),
                float(places[min(row + 1, len(places) - 1)]),
            )
            solution = self._zoomed(pose, seed, between, slot, turn)
            if solution is not None:
                best = min(best, solution.distance)
                yield solution
                most = None if most is None else most - 1

    def _zoomed(
        self, pose: Pose, seed: np.ndarray, between: tuple[float, float, float], slot: int, turn: np.ndarray
    ) -> IkSolution | None:
        """Return the nearest solution of one branch around the middle one of three places; None: there is none."""
        only = np.arange(len(SLOTS)) == slot
        best, q = math.inf, np.zeros(0)
        half = (_ZOOM_PLACES + 1) // 2
        for _ in range(_ZOOMS):
            low, place, high = between
            near = np.concatenate([np.linspace(low, place, half), np.linspace(place, high, half)[1:]])
            branches, squares, excess = self._turned(self._branches(pose, near).q, seed, near, only, turn)
            cost = _cost(squares[:, slot], excess[:, slot])
            row = int(cost.argmin())
            if cost[row] < best:
                best, q = cost[row], np.concatenate([[near[row]], branches[row, slot]])
            between = near[max(row - 1, 0)], near[row], near[min(row + 1, len(near) - 1)]
        return None if best >= _OUTSIDE else self._confirmed(q, pose, seed, SLOTS[slot])

    def _confirmed(
        self, q: np.ndarray, pose: Pose, seed: np.ndarray, configuration: Configuration | None
    ) -> IkSolution | None:
        q = np.clip(q, self._lower, self._upper)
        error_m, error_rad = residual(self.chain, q, pose)
        if error_m > self.settings.tolerance_m or error_rad > self.settings.tolerance_rad:
            return None
        return IkSolution(q, error_m, error_rad, math.dist(q, seed), configuration)

    def _nearest_at(
        self, place: float, pose: Pose, seed: np.ndarray, configuration: Configuration | None
    ) -> list[IkSolution]:
        """Return the nearest solution with the carriage at a place, as a list; empty if there is none."""
        of_arm = self._arm.find(self._seen_from(pose, place), seed[1:].tolist(), configuration)
        return [] if of_arm is None else self._lifted(place, of_arm, pose, seed)

    def _lifted(self, place: float, of_arm: IkSolution, pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return the arm's solution at a place as one of the whole chain; empty if forward kinematics does not confirm it."""
        solution = self._confirmed(np.concatenate([[place], of_arm.q]), pose, seed, of_arm.configuration)
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
        self, branches: np.ndarray, seed: np.ndarray, places: np.ndarray, wanted: np.ndarray, turn: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the arm's branches at places of the carriage, their squared distances from the seed, and their range excess.

        Branches, shape (m, 8, 6), are moved by whole turns as near to the seed as the ranges allow, and then by `turn`, shape
        (6,). The excess, shape (m, 8), is how far the worst joint is out of range [rad]; inf for branches that do not exist or
        are not wanted. The squared distances have shape (m, 8).
        """
        lower, upper, near = self._lower[1:], self._upper[1:], seed[1:]
        q = branches - TURN * np.rint((branches - near) / TURN)
        q = np.where(
            (q > upper) & (q - TURN >= lower), q - TURN, np.where((q < lower) & (q + TURN <= upper), q + TURN, q)
        )
        q = q + TURN * turn
        squares = ((q - near) ** 2).sum(axis=2) + ((places - seed[0]) ** 2)[:, None]
        excess = np.maximum(lower - q, q - upper).max(axis=2)
        excess[~(wanted & np.isfinite(excess))] = np.inf
        return q, squares, excess

    def _seen_from(self, pose: Pose, place: float) -> Pose:
        """Return ``carriage_T_tip`` of a target with the carriage at a place."""
        origin = self._origin + place * self._axis
        return Pose(self._rotation.T @ (pose.position - origin), self._rotation.T @ pose.rotation)

    def _branches(self, pose: Pose, places: np.ndarray) -> Branches:
        """Return the arm's branches with the carriage at places, shape (m,); see `ClosedFormInverse.branches`."""
        flanges = np.repeat(self._arm.flange(self._seen_from(pose, 0.0))[None], len(places), axis=0)
        travel = self._arm.model.base_T_opw[:3, :3].T @ (self._rotation.T @ self._axis)
        flanges[:, :3, 3] -= places[:, None] * travel
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
        branches, _, extension = self._branches(pose, places)
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
