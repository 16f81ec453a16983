"""Inverse kinematics of an arm of the OPW kind on a linear axis: closed form at many positions of the carriage.

The carriage adds one degree of freedom: its position. `rail_search` finds the position at which a branch of the arm is nearest to
the seed. Three kinds of position get special treatment:

- Where the wrist is exactly singular, and where the carriage stands now if branches may be lost there, the arm is solved alone.
- For `all`, `find_singularities` finds the positions where the wrist is exactly singular: a family of solutions is there.
- If nothing was found at any position, `numeric` searches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from construction_twin.core.motion_errors import BranchError, KinematicsError, UnreachableError
from construction_twin.kinematics import rail_search
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.closed_form import SLOTS, ClosedFormInverse
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.opw import NotOpw, OpwModel, find_opw
from construction_twin.kinematics.rail_intervals import ROUNDING
from construction_twin.kinematics.rail_samples import SINGULAR, RailSampler, Samples
from construction_twin.kinematics.rail_search import Candidate
from construction_twin.kinematics.ranges import TURN
from construction_twin.kinematics.solution import (
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

#: If joint 4 needs more than this many spacings for its turn, the evenly spaced positions resolve it.
_WIDE = 8.0
#: Squared sine of the wrist's angle beyond which no position is sharp.
_SHARP = 0.25
#: From one parabola to the next the spacing shrinks by this factor, down to about this length [m]; below it rounding dominates.
_SHRINK, _FINEST = 20.0, 2e-6


@dataclass(frozen=True, slots=True)
class WristSingularity:
    """A position where the wrist comes closest to its singularity.

    Attributes:
        position: [m]; may lie beyond the ends of the axis by less than the spacing.
        width: Distance from the position at which joint 4 has turned by 45 degrees [m].
        angle: |sin| of the wrist's angle at the position; 0: exactly singular.
    """

    position: float
    width: float
    angle: float


def find_singularities(
    positions: np.ndarray, wrist: np.ndarray, measure: Callable[[np.ndarray], np.ndarray]
) -> list[WristSingularity]:
    """Find the positions where the wrist is closest to singular and joint 4 turns too fast for the given positions to resolve.

    Near such a position p0 the sine of the wrist's angle is sqrt(angle^2 + slope^2 (position - p0)^2), and joint 4 turns by 180
    degrees within a few times angle / slope: for a small angle far less than the spacing of the positions.

    Args:
        positions: Shape (m,). Evenly spaced [m].
        wrist: Shape (m, k). |sin| of the wrist's angle of k branches; nan where a branch does not exist.
        measure: Returns the same for other positions.
    """
    apart = float(positions[1] - positions[0])
    squares = _filled(wrist**2)
    seen = np.where(np.isnan(squares), np.inf, squares)
    lowest = np.ones(seen.shape, dtype=bool)
    lowest[1:] = seen[1:] <= seen[:-1]
    lowest[:-1] &= seen[:-1] <= seen[1:]
    # a wrist that bends by less than this from position to position is resolved by them
    lowest &= seen < _SHARP
    rows, branches = np.nonzero(lowest)
    singularities = []
    for row, branch in zip(rows.tolist(), branches.tolist()):
        row = min(max(row, 1), len(positions) - 2)
        found = _vertex(float(positions[row]), apart, squares[row - 1 : row + 2, branch])
        if found is None or abs(found.position - positions[row]) > 2.0 * apart:
            continue  # there is no minimum here: the wrist is closest to singular at the end of the axis
        if found.width > 4.0 * _WIDE * apart:
            continue  # far from sharp, even if the parabola is rough
        step = apart
        while found is not None and found.width < _WIDE * step and step > _FINEST:
            step = max(step / _SHRINK, 0.5 * _FINEST)
            middle = found.position
            near = _filled(measure(middle + step * np.array([-1.0, 0.0, 1.0])) ** 2)[:, branch]
            found = _vertex(middle, step, near)
        if found is not None and found.width < _WIDE * apart:
            singularities.append(found)
    return singularities


def _filled(squares: np.ndarray) -> np.ndarray:
    """Return squares with 0 where a branch is missing between two positions at which it exists, because the wrist is singular."""
    filled = squares.copy()
    lost = np.isnan(squares[1:-1]) & np.isfinite(squares[:-2]) & np.isfinite(squares[2:])
    filled[1:-1][lost] = 0.0
    return filled


def _vertex(middle: float, apart: float, squares: np.ndarray) -> WristSingularity | None:
    """Return the minimum of the parabola through three positions; None: it has none near them."""
    before, here, after = squares.tolist()
    curvature = (before - 2.0 * here + after) / (2.0 * apart**2)
    if not curvature > 0.0:  # nan, too
        return None
    tilt = (after - before) / (2.0 * apart)
    away = -tilt / (2.0 * curvature)
    if abs(away) > _SHRINK * apart:
        return None
    lowest = max(0.0, here + 0.5 * tilt * away)
    return WristSingularity(middle + away, math.sqrt(lowest / curvature), math.sqrt(lowest))


#: What a robot's description has for each joint.
_PER_JOINT = ("joint_names", "lower", "upper", "velocity", "acceleration", "jerk", "home", "axes", "linear")


class Carriage:
    """The carriage of an arm, and the arm on it.

    Args:
        chain: One prismatic joint followed by six revolute ones.

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
        """Return ``carriage_T_tip`` of a target with the carriage at a position.

        Args:
            pose: ``base_T_tip``
        """
        origin = self.origin + position * self.direction
        return Pose(self.rotation.T @ (pose.position - origin), self.rotation.T @ pose.rotation)


#: Number of evenly spaced positions at which singular wrists, and the reason for no solution, are looked for.
_POSITIONS = 101
#: A solution whose wrist is this close to singular belongs to the family of solutions of a singular position [rad].
_OF_FAMILY = 1e-3
#: A wrist centre that is out of reach by less, or closer to axis 1, may have lost its branches by rounding [m].
_AT_REACH = 1e-6
#: Slots of each shoulder, front and back.
_SIDES = ([0, 1, 4, 5], [2, 3, 6, 7])
#: Solutions nearer to each other than this are one [rad]: they differ only in how exactly the nearest position was found.
_SAME = 0.01
#: Besides the nearest ones, `all` returns at most so many.
_MOST = 64


def find_rail(chain: Chain) -> tuple[Carriage, OpwModel] | NotOpw:
    """Return the carriage of an arm on a linear axis, with the arm's model, or why the chain is not one."""
    if chain.robot.linear != (True,) + (False,) * 6:
        return NotOpw("its joints are neither six revolute ones nor a prismatic one followed by six revolute ones")
    carriage = Carriage(chain)
    model = find_opw(carriage.arm)
    return model if isinstance(model, NotOpw) else (carriage, model)


class RailInverse(InverseKinematics):
    """Inverse kinematics of an arm of the OPW kind on a linear axis.

    Args:
        chain: All seven joints.
        carriage, model: From `find_rail`.
        search: For the whole chain.
    """

    def __init__(self, chain: Chain, carriage: Carriage, model: OpwModel, search: NumericInverse):
        super().__init__(chain, search.settings)
        self._carriage = carriage
        self._arm = arm = ClosedFormInverse(carriage.arm, model, search.settings)
        self._search = search
        self._even = np.linspace(*self._ends[0], _POSITIONS)
        # the direction of travel in the directions of the arm's model
        travel = arm.model.base_T_opw[:3, :3].T @ (carriage.rotation.T @ carriage.direction)
        self._travel = travel
        self._along = RailSampler(arm, travel, *self._ends[0])
        # from a target of the whole chain to one of the arm's model, with the carriage at zero
        base_T_carriage = np.eye(4)
        base_T_carriage[:3, :3], base_T_carriage[:3, 3] = carriage.rotation, carriage.origin
        self._opw_T_base = np.linalg.inv(base_T_carriage @ arm.model.base_T_opw)
        self._tip_T_flange = np.linalg.inv(arm.model.flange_T_tip)

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("OPW on a linear axis", f"behind joint 1, which is prismatic, {self._arm.kind.why}")

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: over all positions of the carriage."""
        start = self._checked(pose, seed)
        flange, here = self._flange(pose), float(start[0])
        found: list[IkSolution] = []

        def at(position: float) -> float:
            """Take the nearest solution with the carriage at a position; return its squared distance."""
            nearest = self._nearest_at(position, pose, start, configuration)
            found.extend(nearest)
            return min((solution.distance**2 for solution in nearest), default=math.inf)

        samples = self._along.sample(flange, here, self._wanted(configuration))
        aim = self._along.aim(start)
        measured = self._along.measure(samples, aim)
        candidates = rail_search.nearest(self._along, samples, measured, aim, at)
        found += self._first_confirmed(candidates, pose, start)
        if not found or self._is_special(flange, here, samples.wrist):
            at(here)
        if found:
            return min(found, key=lambda solution: solution.distance)
        return self._search_or_explain(pose, start, configuration)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`: for each branch and choice of whole turns, the nearest position of the carriage.

        Besides, solutions spaced along the branches, for whoever cannot use the nearest: who has to avoid contacts takes the first
        that is free.
        """
        start = self._checked(pose, seed)
        flange = self._flange(pose)
        found = self._nearest_at(float(start[0]), pose, start, configuration)
        samples = self._along.sample(flange, float(start[0]), self._wanted(configuration))
        for turns in self._choices_of_turns(start):
            aim = self._along.aim(start, turns)
            measured = self._along.measure(samples, aim)
            for slot in range(len(SLOTS)):
                candidates = rail_search.nearest(self._along, samples, measured, aim, lambda position: math.inf, slot)
                found += self._first_confirmed(candidates, pose, start)
        singular = self._singular_positions(flange)
        if singular:
            found = [solution for solution in found if self._wrist_angle(solution.q) > _OF_FAMILY]
            found += self._families(pose, start, configuration, singular)
        if not found:
            return [self._search_or_explain(pose, start, configuration)]
        found = distinct(sorted(found, key=lambda solution: solution.distance), _SAME)
        found += self._spaced(samples, found, pose, start)
        return sorted(found, key=lambda solution: solution.distance)

    def configuration(self, q: JointValues) -> Configuration:
        """See `InverseKinematics.configuration`: the arm's."""
        return self._arm.configuration(q[1:])

    def _checked(self, pose: Pose, seed: JointValues) -> np.ndarray:
        self.chain.robot.check_range(seed)
        check_pose(pose)
        return np.array(seed, dtype=float)

    def _wanted(self, configuration: Configuration | None) -> np.ndarray | None:
        if configuration is None:
            return None
        return np.array([have.matches(configuration) for have in SLOTS])

    def _flange(self, pose: Pose) -> np.ndarray:
        """Return a target as the arm's model has it with the carriage at zero, see `ClosedFormInverse.flange`."""
        return self._opw_T_base @ pose.matrix() @ self._tip_T_flange

    def _choices_of_turns(self, seed: np.ndarray) -> Iterator[tuple[int, ...]]:
        """Return by how many whole turns each of the arm's joints may be further than the nearest one, in all combinations."""
        choices = []
        for near, (low, high) in zip(seed[1:].tolist(), self._ends[1:]):
            turns = range(math.ceil((low - near) / TURN - 0.5), math.floor((high - near) / TURN + 0.5) + 1)
            choices.append(turns if high - low >= TURN else (0,))
        return product(*choices)

    def _first_confirmed(self, candidates: Sequence[Candidate], pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return the first of candidates that forward kinematics confirms, as a list; empty if there is none."""
        for candidate in candidates:
            solution = self._solution(candidate, pose, seed)
            if solution is not None:
                return [solution]
        return []

    def _solution(self, candidate: Candidate, pose: Pose, seed: np.ndarray) -> IkSolution | None:
        """Return a candidate as a solution; None: forward kinematics does not confirm it."""
        return self.confirmed(candidate.q.tolist(), pose, seed, SLOTS[candidate.slot])

    def _spaced(
        self, samples: Samples, found: Sequence[IkSolution], pose: Pose, seed: np.ndarray
    ) -> Iterator[IkSolution]:
        """Return solutions at other positions than the ones found, the nearest first, each apart from all others.

        Whole turns are those nearest to the seed: with other ones the arm would touch the same things.
        """
        aim = self._along.aim(seed)
        candidates = rail_search.within(samples, self._along.measure(samples, aim), aim)
        joints = np.array([candidate.q for candidate in candidates]).reshape(-1, len(seed))
        return spaced(joints, found, _MOST, lambda number: self._solution(candidates[number], pose, seed))

    def _singular_positions(self, flange: np.ndarray) -> list[float]:
        """Return the positions where the wrist of a branch is exactly singular."""
        low, high = self._ends[0]

        def wrist(positions: np.ndarray) -> np.ndarray:
            return self._arm.branches(self._along.flanges(flange, positions)).wrist[:, :4]

        return [
            # a position beyond the end by rounding is at the end
            float(min(max(found.position, low), high))
            for found in find_singularities(self._even, wrist(self._even), wrist)
            if found.angle <= SINGULAR and low - ROUNDING <= found.position <= high + ROUNDING
        ]

    def _is_special(self, flange: np.ndarray, position: float, wrist: list[float]) -> bool:
        """Return whether the wrist is near its singularity, or a branch is missing although it is not out of reach.

        `wrist`, length 8, is |sin| of the branches' wrist angles at the position.
        """
        if any(angle <= _OF_FAMILY for angle in wrist):
            return True
        dx, dy, dz = self._travel.tolist()
        x, y, z = self._arm.model.wrist_centre(flange)
        x, y, z = x - position * dx, y - position * dy, z - position * dz
        if math.hypot(x, y) < _AT_REACH:
            return True
        margins = self._arm.model.margins(x, y, z)
        return any(
            min(margin) > -_AT_REACH and any(math.isnan(wrist[slot]) for slot in slots)
            for margin, slots in zip(margins, _SIDES)
        )

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
        self, pose: Pose, seed: np.ndarray, configuration: Configuration | None, singular: Sequence[float]
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
            raise BranchError(str(configuration), tuple(sorted(others)), "not_here")
        try:
            found = self._search.nearest(pose, seed)
            return replace(found, configuration=self.configuration(found.q))
        except KinematicsError:
            # the closed form gives a more exact reason
            self._explain(pose)
            raise

    def _explain(self, pose: Pose) -> None:
        """Raise the error that says why there is no solution at any position."""
        positions = self._even
        branches, _, extension = self._arm.branches(self._along.flanges(self._flange(pose), positions))
        best = int(extension.argmax())
        if extension[best] < 0.0:
            carriage_T_tip = self._carriage.seen_from(pose, float(positions[best]))
            raise UnreachableError(-float(extension[best]), self._arm.is_too_close(self._arm.flange(carriage_T_tip)))
        rows = branches.reshape(-1, 6)
        self._arm.raise_range_error(rows[np.isfinite(rows).all(axis=1)])
