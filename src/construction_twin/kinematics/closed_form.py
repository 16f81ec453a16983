"""Inverse kinematics in closed form, for arms of the OPW kind (`opw`): every branch, and exactly the nearest.

The branches come from py_opw_kinematics; whole turns, ranges, singular poses and the verdict by KDL's forward kinematics
are added here. What the arm cannot do is told apart exactly: too far, too close, out of a joint's range.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from construction_twin.core.motion_errors import (
    BranchError,
    NoSolutionError,
    OrientationError,
    PositionRangeError,
    UnreachableError,
)
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.opw import OpwModel
from construction_twin.kinematics.singular_wrist import SingularWrist
from construction_twin.kinematics.solution import (
    TURN,
    Configuration,
    IkSettings,
    IkSolution,
    InverseKinematics,
    check_pose,
    distinct,
    refine,
    residual,
)

#: The package's branch slots: 4 * (wrist turned over) + 2 * (shoulder back) + (elbow angle negative). Facing back, a
#: negative elbow angle is the upper elbow.
SLOTS = tuple(
    Configuration(shoulder, elbow, wrist)
    for wrist in ("positive", "negative")
    for shoulder, elbow in (("front", "up"), ("front", "down"), ("back", "down"), ("back", "up"))
)
#: Slots of each shoulder, front and back.
_SIDES = ((0, 1, 4, 5), (2, 3, 6, 7))
#: Joint 5 nearer than this to where axes 4 and 6 are in line: there only the sum of their turns counts [rad].
_WRIST_SINGULAR = 5e-7
#: The package loses the branches of an exactly singular wrist; turned by this much the target has them [rad].
_TILT = 2e-7
#: The wrist centre nearer than this to axis 1, or beyond the edge of the reach by less, is solved for beside it [m].
_EDGE = 1e-7
#: Within the reach by less than this, rounding decides whether the branches exist [m].
_ROUNDING = 1e-12
#: How far within the edge of the reach it is solved instead: the elbow is less than 1e-6 rad from stretched there [m].
_INSIDE = 1e-13
#: How far beside axis 1: well within the tolerance of a solution, well above the rounding of the branches [m].
_NUDGE = 3e-7
#: Limits that no joint angle is within [rad].
_NO_LIMITS = [(9.0, 10.0)] * 6
#: Directions compared where the wrist centre is on axis 1.
_HEADINGS = 72
#: Candidates that miss the pose by less than this are refined, others are no solutions [m], [rad].
_REFINABLE = 1e-3


class ClosedFormInverse(InverseKinematics):
    """Inverse kinematics of an arm of the OPW kind.

    At a singular wrist (axes 4 and 6 in line) joints 4 and 6 share the difference to the seed equally, which is the nearest.
    Where the wrist centre is on axis 1, which leaves joint 1 free, it stays at the seed or goes a multiple of 5 degrees from
    it, whatever is nearest.

    Parameters
    ----------
    chain : Chain
    model : OpwModel
        From `opw.find_opw`.
    settings : IkSettings
        The tolerances count.
    """

    def __init__(self, chain: Chain, model: OpwModel, settings: IkSettings):
        super().__init__(chain, settings)
        self.model = model
        # The package's public entry takes scipy transforms, which take six times as long to build as the branches take
        # to compute; its own core takes matrices. The package is pinned.
        self._solver = model.solver()._robot
        self._lower, self._upper = np.array(chain.robot.lower), np.array(chain.robot.upper)
        slack = settings.tolerance_rad
        self._slack = [(lower - slack, upper + slack) for lower, upper in zip(chain.robot.lower, chain.robot.upper)]
        ranges = [(joint, lower, upper) for joint, (lower, upper) in enumerate(self._slack)]
        self._narrow_first = sorted(ranges, key=lambda bounds: bounds[2] - bounds[1])
        self._opw_T_base = np.linalg.inv(model.base_T_opw)
        self._tip_T_flange = np.linalg.inv(model.flange_T_tip)
        self._target = np.eye(4)
        self._singular_wrist = SingularWrist(chain, model)

    def nearest(self, pose: Pose, seed: Sequence[float], configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`."""
        self.chain.robot.check_range(seed)
        seed = [float(value) for value in seed]
        best = self.find(pose, seed, configuration)
        if best is None:
            self._explain(pose, seed, configuration)
        return best

    def find(self, pose: Pose, seed: Sequence[float], configuration: Configuration | None) -> IkSolution | None:
        """Return what `nearest` does, but None where it would raise an error; the seed is not checked."""
        best = None
        for branches, wrist in self._solve(self.flange(pose), seed):
            found = self._nearest_of(branches, wrist, pose, seed, configuration)
            if found is not None and (best is None or found.distance < best.distance):
                best = found
        return best

    def all(self, pose: Pose, seed: Sequence[float], configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`."""
        self.chain.robot.check_range(seed)
        seed = [float(value) for value in seed]
        found = []
        families = 0
        for branches, wrist in self._solve(self.flange(pose), seed):
            families += 1 + int((wrist < _WRIST_SINGULAR).any())
            for slot, have in enumerate(SLOTS):
                if configuration is None or have.matches(configuration):
                    singular = wrist[slot] < _WRIST_SINGULAR
                    starts = self._singular_wrist.families(branches[slot], pose, seed) if singular else [branches[slot]]
                    for start in starts:
                        found += self._turned(start, singular, pose, seed, have)
        if not found:
            self._explain(pose, seed, configuration)
        found.sort(key=lambda solution: solution.distance)
        # only singular poses and those solved beside themselves find a solution twice
        return distinct(found) if families > 1 else found

    def configuration(self, q: Sequence[float]) -> Configuration:
        """See `InverseKinematics.configuration`."""
        model = self.model
        theta = np.asarray(model.signs) * np.asarray(q) - model.offsets
        bend = theta[2] + math.atan2(model.a2, model.c3)
        ahead = model.a1 + model.c2 * math.sin(theta[1]) + math.hypot(model.a2, model.c3) * math.sin(theta[1] + bend)
        front = ahead >= 0.0
        return Configuration(
            "front" if front else "back",
            "up" if (math.sin(bend) >= 0.0) == front else "down",
            "positive" if math.sin(theta[4]) >= 0.0 else "negative",
        )

    def flange(self, pose: Pose) -> np.ndarray:
        """Return ``opw_T_flange`` of a target, shape (4, 4)."""
        self._target[:3, :3] = pose.rotation
        self._target[:3, 3] = pose.position
        return self._opw_T_base @ self._target @ self._tip_T_flange

    def _solve(self, flange: np.ndarray, seed: Sequence[float]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the branches, shape (8, 6), nan where there is none, and |sin| of each branch's wrist angle, shape (8,).

        Once for the target; where rounding or a singularity loses branches, also for targets a hair beside it, at which
        they exist.
        """
        branches, wrist, _ = self.branches(flange)
        yield branches[0], wrist[0]
        x, y, z = self.model.wrist_centre(flange)
        margins = [min(both) for both in self.model.margins(x, y, z)]
        others = [self._tilted(flange)] if _is_lost(wrist[0], margins) else []
        if math.hypot(x, y) < _EDGE:
            others += self._headings(flange, seed)
        else:
            # each shoulder has its own edge: the other one may reach with ease
            for side, margin in enumerate(margins):
                if -_EDGE < margin < _ROUNDING:
                    others += self._within(flange, side)
        for other in others:
            branches, wrist, _ = self.branches(other)
            yield branches[0], wrist[0]

    def branches(self, flanges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all branches of targets, whatever the ranges.

        Parameters
        ----------
        flanges : array, shape (m, 4, 4)
            ``opw_T_flange``

        Returns
        -------
        q : array, shape (m, 8, 6)
            [rad], order of `SLOTS`; nan where there is no such branch.
        wrist : array, shape (m, 8)
            |sin| of the angle by which axes 4 and 6 are out of line.
        extension : array, shape (m,)
            By how much the wrist centre is within reach [m]; negative: by how much it is not.
        """
        # The package also computes the conditioning of each branch within limits, which takes three times as long as the
        # rest and is not needed; with limits that nothing is within it does not.
        q, _, extension, _, wrist = self._solver.reach(flanges.reshape(-1, 16), _NO_LIMITS, None, 1)
        return q, wrist, extension

    def _within(self, flange: np.ndarray, side: int) -> list[np.ndarray]:
        """Return a target just within a shoulder's edge beside one that is at it; and with the wrist tilted, if singular."""
        centre = self.model.wrist_centre(flange)
        outer, inner = self.model.margins(*centre)[side]
        # away from the edge that is near, out of the outer or into the inner
        length = outer - _INSIDE if outer < inner else _INSIDE - inner
        moved = flange.copy()
        moved[:3, 3] += length * self.model.outwards(*centre)[side]
        lost = _is_lost(self.branches(moved)[1][0], [_INSIDE if other == side else 0.0 for other in (0, 1)])
        return [moved, self._tilted(moved)] if lost else [moved]

    def _headings(self, flange: np.ndarray, seed: Sequence[float]) -> list[np.ndarray]:
        """Return targets beside one with the wrist centre on axis 1, in the directions that the arm may best face.

        Any angle of joint 1 will do; the wrist makes up for it. The seed's own is there, and the best of even steps for each
        shoulder. Each once more with the wrist tilted.
        """
        model = self.model
        start = model.signs[0] * seed[0] - model.offsets[0]
        angles = start + np.linspace(0.0, TURN, _HEADINGS, endpoint=False)
        directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(_HEADINGS)])
        branches, _, _ = self.branches(np.array([_shifted(flange, direction) for direction in directions]))
        best: dict[str, tuple[float, int]] = {}
        for number, slots in enumerate(branches.tolist()):
            for have, branch in zip(SLOTS, slots):
                candidate = self._nearest_turn(branch, seed)
                if candidate is not None:
                    best[have.shoulder] = min(best.get(have.shoulder, (math.inf, 0)), (candidate[0], number))
        chosen = {0, *(number for _, number in best.values())}
        moved = [_shifted(flange, directions[number]) for number in sorted(chosen)]
        return moved + [self._tilted(target) for target in moved]

    def _tilted(self, flange: np.ndarray) -> np.ndarray:
        """Return a target turned by a hair about its X, with the wrist centre in place, so that axes 4 and 6 part."""
        turn = np.array(
            [[1.0, 0.0, 0.0], [0.0, math.cos(_TILT), -math.sin(_TILT)], [0.0, math.sin(_TILT), math.cos(_TILT)]]
        )
        tilted = flange.copy()
        tilted[:3, :3] = flange[:3, :3] @ turn
        tilted[:3, 3] += self.model.c4 * (tilted[:3, 2] - flange[:3, 2])
        return tilted

    def _nearest_of(
        self,
        branches: np.ndarray,
        wrist: np.ndarray,
        pose: Pose,
        seed: Sequence[float],
        configuration: Configuration | None,
    ) -> IkSolution | None:
        """Return the nearest of the branches that forward kinematics confirms, or None."""
        candidates = []
        for slot, branch in enumerate(branches.tolist()):
            if configuration is None or SLOTS[slot].matches(configuration):
                if wrist[slot] < _WRIST_SINGULAR:
                    branch = next(iter(self._singular_wrist.families(np.array(branch), pose, seed)), branch)
                candidate = self._nearest_turn(branch, seed)
                if candidate is not None:
                    candidates.append((*candidate, slot))
        candidates.sort()
        for _, q, slot in candidates:
            solution = self._confirmed(q, pose, seed, SLOTS[slot])
            if solution is not None:
                return solution
        return None

    def _nearest_turn(self, branch: Sequence[float], seed: Sequence[float]) -> tuple[float, list[float]] | None:
        """Return a branch turned as near to the seed as its range allows, behind its squared distance; None if it cannot be.

        Plain floats and the narrowest range first, because most branches are out of range by their first or second joint.
        """
        square = 0.0
        q = [0.0] * len(branch)
        for joint, lower, upper in self._narrow_first:
            value, near = branch[joint], seed[joint]
            if value != value:  # nan: there is no such branch
                return None
            value += TURN * round((near - value) / TURN)
            # the seed is in range, so of the turns beyond the nearest one only the next towards the range can be in it
            if value > upper:
                value -= TURN
            elif value < lower:
                value += TURN
            if not lower <= value <= upper:
                return None
            square += (value - near) ** 2
            q[joint] = value
        return square, q

    def _turned(
        self, branch: np.ndarray, shared: bool, pose: Pose, seed: Sequence[float], configuration: Configuration
    ) -> list[IkSolution]:
        """Return a branch with every choice of whole turns, where forward kinematics confirms it.

        `shared`: joints 4 and 6 are chosen already, turns and all.
        """
        if not np.isfinite(branch).all():
            return []
        choices = []
        for joint, (value, (lower, upper)) in enumerate(zip(branch.tolist(), self._slack)):
            turns = range(math.ceil((lower - value) / TURN), math.floor((upper - value) / TURN) + 1)
            choices.append([value] if shared and joint in (3, 5) else [value + TURN * turn for turn in turns])
        found = (self._confirmed(q, pose, seed, configuration) for q in product(*choices))
        return [solution for solution in found if solution is not None]

    def _confirmed(
        self, q: Sequence[float], pose: Pose, seed: Sequence[float], configuration: Configuration
    ) -> IkSolution | None:
        """Return joint values as a solution if forward kinematics says so, after refining them where they almost are one."""
        robot = self.chain.robot
        q = [min(max(value, lower), upper) for value, lower, upper in zip(q, robot.lower, robot.upper)]
        error_m, error_rad = residual(self.chain, q, pose)
        if not self._is_solved(error_m, error_rad):
            if not max(error_m, error_rad) < _REFINABLE:
                return None
            q = refine(self.chain, q, pose).tolist()
            error_m, error_rad = residual(self.chain, q, pose)
            if not self._is_solved(error_m, error_rad):
                return None
        return IkSolution(np.array(q), error_m, error_rad, math.dist(q, seed), configuration)

    def _is_solved(self, error_m: float, error_rad: float) -> bool:
        return error_m <= self.settings.tolerance_m and error_rad <= self.settings.tolerance_rad

    def _explain(self, pose: Pose, seed: Sequence[float], configuration: Configuration | None) -> None:
        """Raise the error that says why there is no solution."""
        check_pose(pose)
        if configuration is not None:
            # raises the reason if there is none in any configuration
            others = {str(solution.configuration) for solution in self.all(pose, seed)}
            raise BranchError(
                str(configuration), tuple(sorted(others)), "does not exist for this pose within the ranges"
            )
        flange = self.flange(pose)
        branches, _, extension = self.branches(flange)
        if extension[0] < 0.0:
            raise UnreachableError(-float(extension[0]), self.is_too_close(flange))
        self.blame_range(branches[0][np.isfinite(branches[0]).all(axis=1)])
        raise NoSolutionError(len(SLOTS), *self._best_residual(branches[0], pose))

    def blame_range(self, branches: np.ndarray) -> None:
        """Raise the error that names the joint out of range, in the branch that is out of range by least.

        Parameters
        ----------
        branches : array, shape (m, 6)
            All there are for a target [rad].

        Raises
        ------
        OrientationError
            If joints 1 to 3 of some branch are in range: another orientation could be reached.
        PositionRangeError
            If not.
        """
        middle = 0.5 * (self._lower + self._upper)
        q = branches - TURN * np.rint((branches - middle) / TURN)
        excess = np.maximum(self._lower - q, q - self._upper) - self.settings.tolerance_rad
        placed = excess[:, :3].max(axis=1, initial=-math.inf) <= 0.0
        candidates = np.flatnonzero(placed) if placed.any() else np.arange(len(q))
        if not len(candidates):
            return
        row = candidates[excess[candidates].max(axis=1).argmin()]
        joint = int(excess[row].argmax())
        if excess[row, joint] > 0.0:
            kind = OrientationError if placed.any() else PositionRangeError
            robot = self.chain.robot
            raise kind(robot.joint_names[joint], float(q[row, joint]), robot.lower[joint], robot.upper[joint])

    def is_too_close(self, flange: np.ndarray) -> bool:
        """Return whether an unreachable target, shape (4, 4), is inside what the arm can fold to, not beyond its stretch."""
        outer, inner = max(self.model.margins(*self.model.wrist_centre(flange)), key=min)
        return inner < outer

    def _best_residual(self, branches: np.ndarray, pose: Pose) -> tuple[float, float]:
        found = [residual(self.chain, q, pose) for q in branches if np.isfinite(q).all()]
        return min(found, key=max, default=(math.inf, math.inf))


def _is_lost(wrist: np.ndarray, margins: Sequence[float]) -> bool:
    """Return whether branches are missing of a shoulder within whose reach the wrist centre is: the wrist is singular.

    `wrist`, shape (8,), as `ClosedFormInverse.branches` gives it; `margins`: how far within reach it is [m].
    """
    values = wrist.tolist()
    if not math.isnan(sum(values)):
        return False
    for margin, slots in zip(margins, _SIDES):
        if margin > 0.0 and any(values[slot] != values[slot] for slot in slots):
            return True
    return False


def _shifted(flange: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return a target a hair beside another."""
    moved = flange.copy()
    moved[:3, 3] += _NUDGE * direction
    return moved
