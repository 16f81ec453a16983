"""Inverse kinematics in closed form, for arms of the OPW kind (`opw`): every branch, and exactly the nearest.

The branches come from py_opw_kinematics. This module adds whole turns, ranges, singular poses, and why there is no solution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, NoReturn

import numpy as np

from construction_twin.kinematics.branches import BranchInverse
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.opw import OpwModel
from construction_twin.kinematics.solution import (
    TURN,
    ArmKind,
    Configuration,
    IkSettings,
    IkSolution,
    NotFoundError,
    UnreachableError,
    check_pose,
    distinct,
    residual,
)
from construction_twin.robot.description import JointValues

#: A joint that is out of range by less is at the end of its range but for rounding [rad].
_EDGE_ROUNDING = 1e-7


#: The package's branch slots: 4 * (wrist turned over) + 2 * (shoulder back) + (elbow angle negative). Facing back, a
#: negative elbow angle is the upper elbow.
SLOTS = tuple(
    Configuration(shoulder, elbow, wrist)
    for wrist in ("positive", "negative")
    for shoulder, elbow in (("front", "up"), ("front", "down"), ("back", "down"), ("back", "up"))
)
#: Slots of each shoulder, front and back.
_SIDES = ((0, 1, 4, 5), (2, 3, 6, 7))
#: With joint 5 closer than this to the pose in which axes 4 and 6 are in line, only the sum of joints 4 and 6 counts [rad].
_WRIST_SINGULAR = 5e-7
#: The package finds no branches for an exactly singular wrist; it finds them for the target rotated by this angle [rad].
_TILT = 2e-7
#: A wrist centre closer than this to axis 1, or less than this beyond the edge of the reach, is moved before solving [m].
_EDGE = 1e-7
#: If the wrist centre is within the reach by less than this, rounding decides whether the branches exist [m].
_ROUNDING = 1e-12
#: Such a wrist centre is moved to this far within the edge; the elbow is then less than 1e-6 rad from stretched [m].
_INSIDE = 1e-13
#: A wrist centre on axis 1 is moved by this much: well within a solution's tolerance, well above rounding [m].
_NUDGE = 3e-7
#: Limits that contain no joint angle [rad].
_NO_LIMITS = [(9.0, 10.0)] * 6
#: Number of directions compared where the wrist centre is on axis 1.
_HEADINGS = 72


class Branches(NamedTuple):
    """All branches of m targets, ranges not considered. A NamedTuple, because the 250 Hz paths unpack it.

    Attributes:
        q: Shape (m, 8, 6). Order of `SLOTS`; nan where there is no such branch.
        wrist: Shape (m, 8). |sin| of the angle between axes 4 and 6.
        extension: Shape (m,). Distance of the wrist centre to the edge of the reach [m], positive inside.
    """

    q: np.ndarray
    wrist: np.ndarray
    extension: np.ndarray


class ClosedFormInverse(BranchInverse):
    """Inverse kinematics of an arm of the OPW kind.

    At a singular wrist joints 4 and 6 each take half of the difference to the seed: that is nearest. Where the wrist centre is on
    axis 1, joint 1 is free: the nearest of the seed's angle and every 5 degrees from it is used.
    """

    def __init__(self, chain: Chain, model: OpwModel, settings: IkSettings):
        super().__init__(chain, settings)
        self.model = model
        # The package's public entry takes scipy transforms; building one takes six times as long as computing the branches.
        # Its private core takes matrices. The package's version is pinned.
        self._solver = model.solver()._robot
        # None: the arm's base is the model's
        at_base = bool(np.abs(model.base_T_opw - np.eye(4)).max() < 1e-15)
        self._opw_T_base = None if at_base else np.linalg.inv(model.base_T_opw)
        self._tip_T_flange = np.linalg.inv(model.flange_T_tip)
        self._target = np.eye(4)
        self._elements, self._ones = self._target.reshape(16), np.ones(16)

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind(
            "OPW", "axes 2 and 3 are parallel, axes 4, 5 and 6 meet in a point, and neighbours are perpendicular"
        )

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`."""
        start = seed.tolist() if isinstance(seed, np.ndarray) else [float(value) for value in seed]
        self.chain.robot.check_range(start)
        best = self.find(pose, start, configuration)
        if best is None:
            self._explain(pose, start, configuration)
        return best

    def find(self, pose: Pose, seed: JointValues, configuration: Configuration | None) -> IkSolution | None:
        """Return the solution of `nearest`, or None where `nearest` would raise an error. The seed is not checked."""
        best = None
        for branches, wrist in self._solve(self.flange(pose), seed):
            found = self._nearest_of(branches, wrist, pose, seed, configuration)
            if found is not None and (best is None or found.distance < best.distance):
                best = found
        return best

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`."""
        self.chain.robot.check_range(seed)
        start = [float(value) for value in seed]
        found: list[IkSolution] = []
        families = 0
        for branches, wrist in self._solve(self.flange(pose), start):
            families += 1 + any(angle < _WRIST_SINGULAR for angle in wrist)
            for slot, have in enumerate(SLOTS):
                if configuration is None or have.matches(configuration):
                    singular = wrist[slot] < _WRIST_SINGULAR
                    members = self._families(branches[slot], pose, start) if singular else [branches[slot]]
                    for member in members:
                        # `_families` has chosen the turns of joints 4 and 6 already
                        found += self.turned(member, pose, start, have, (3, 5) if singular else ())
        if not found:
            self._explain(pose, start, configuration)
        found.sort(key=lambda solution: solution.distance)
        # a solution is found twice only at singular poses and at poses that were also solved for a moved target
        return distinct(found) if families > 1 else found

    def configuration(self, q: JointValues) -> Configuration:
        """See `InverseKinematics.configuration`."""
        model = self.model
        theta = np.asarray(model.signs) * np.asarray(q) - model.offsets
        elbow = theta[2] + math.atan2(model.a2, model.c3)
        distance = (
            model.a1 + model.c2 * math.sin(theta[1]) + math.hypot(model.a2, model.c3) * math.sin(theta[1] + elbow)
        )
        front = distance >= 0.0
        return Configuration(
            "front" if front else "back",
            "up" if (math.sin(elbow) >= 0.0) == front else "down",
            "positive" if math.sin(theta[4]) >= 0.0 else "negative",
        )

    def flange(self, pose: Pose) -> np.ndarray:
        """Return ``opw_T_flange`` of a target, shape (4, 4)."""
        self._target[:3, :3] = pose.rotation
        self._target[:3, 3] = pose.position
        # the sum of the elements, as the quickest test; if it is not finite although they are, `check_pose` passes
        if not math.isfinite(self._elements.dot(self._ones)):
            check_pose(pose)
        in_base = self._target.dot(self._tip_T_flange)
        return in_base if self._opw_T_base is None else self._opw_T_base.dot(in_base)

    def _solve(self, flange: np.ndarray, seed: JointValues) -> list[tuple[np.ndarray, list[float]]]:
        """Return the branches, shape (8, 6), nan where there is none, and |sin| of each branch's wrist angle.

        Pairs behind the first are of targets moved by less than the tolerance, where rounding or a singularity makes branches
        vanish.
        """
        q, angles, _ = self.branches(flange)
        wrist = angles[0].tolist()
        x, y, z = self.model.wrist_centre(flange)
        if _EDGE < abs(x) and math.isfinite(sum(wrist)):
            return [(q[0], wrist)]  # no branch is missing
        margins = [min(both) for both in self.model.margins(x, y, z)]
        targets = [self._tilted(flange)] if _lacks_branches(wrist, margins) else []
        if math.hypot(x, y) < _EDGE:
            targets += self._headings(flange, seed)
        else:
            # each shoulder has its own edge of the reach: the target may be well within the other one's
            for side, margin in enumerate(margins):
                if -_EDGE < margin < _ROUNDING:
                    targets += self._within(flange, side)
        others = (self.branches(target) for target in targets)
        return [(q[0], wrist), *((other[0], angle[0].tolist()) for other, angle, _ in others)]

    def branches(self, flanges: np.ndarray) -> Branches:
        """Return all branches of targets ``opw_T_flange``, shape (m, 4, 4), ranges not considered."""
        # For every branch within limits the package also computes the conditioning, which is not needed here and takes three
        # times as long as the rest. Limits that contain no angle switch that off.
        q, _, extension, _, wrist = self._solver.reach(flanges.reshape(-1, 16), _NO_LIMITS, None, 1)
        return Branches(q, wrist, extension)

    def _within(self, flange: np.ndarray, side: int) -> list[np.ndarray]:
        """Return a target at a shoulder's edge moved just within it; if its wrist is singular, also with the wrist tilted."""
        centre = self.model.wrist_centre(flange)
        outer, inner = self.model.margins(*centre)[side]
        # away from the nearer edge: inwards from the outer one, outwards from the inner one
        length = outer - _INSIDE if outer < inner else _INSIDE - inner
        moved = flange.copy()
        moved[:3, 3] += length * self.model.outwards(*centre)[side]
        lost = _lacks_branches(self.branches(moved)[1][0], [_INSIDE if other == side else 0.0 for other in (0, 1)])
        return [moved, self._tilted(moved)] if lost else [moved]

    def _headings(self, flange: np.ndarray, seed: JointValues) -> list[np.ndarray]:
        """Return copies of a target with the wrist centre on axis 1, moved off the axis in the best directions.

        Every angle of joint 1 reaches it, because the wrist compensates: the copies face in the seed's direction and, for each
        shoulder, in the best of evenly spaced ones; each comes once more with the wrist tilted.
        """
        model = self.model
        start = model.signs[0] * seed[0] - model.offsets[0]
        angles = start + np.linspace(0.0, TURN, _HEADINGS, endpoint=False)
        directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(_HEADINGS)])
        branches, _, _ = self.branches(np.array([_shifted(flange, direction) for direction in directions]))
        best: dict[str | None, tuple[float, int]] = {}
        for number, slots in enumerate(branches.tolist()):
            for have, branch in zip(SLOTS, slots):
                nearest = self.nearest_branch([branch], seed)
                if nearest is not None:
                    best[have.shoulder] = min(best.get(have.shoulder, (math.inf, 0)), (nearest[1], number))
        chosen = {0, *(number for _, number in best.values())}
        moved = [_shifted(flange, directions[number]) for number in sorted(chosen)]
        return moved + [self._tilted(target) for target in moved]

    def _tilted(self, flange: np.ndarray) -> np.ndarray:
        """Return a target rotated by `_TILT` about its X axis and the wrist centre, so that axes 4 and 6 are not in line."""
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
        wrist: list[float],
        pose: Pose,
        seed: JointValues,
        configuration: Configuration | None,
    ) -> IkSolution | None:
        """Return the nearest of the branches that forward kinematics confirms, or None."""
        rows = branches.tolist()
        for slot, angle in enumerate(wrist):
            if angle < _WRIST_SINGULAR:
                rows[slot] = next(iter(self._families(branches[slot], pose, seed)), rows[slot])
        if configuration is None:
            return self.nearest_confirmed(rows, pose, seed, SLOTS)
        wanted = [slot for slot, have in enumerate(SLOTS) if have.matches(configuration)]
        return self.nearest_confirmed([rows[slot] for slot in wanted], pose, seed, [SLOTS[slot] for slot in wanted])

    def _families(self, branch: np.ndarray, pose: Pose, seed: JointValues) -> list[np.ndarray]:
        """Return solutions with axes 4 and 6 in line, one for each choice of whole turns, the nearest to the seed first.

        Of the branch, shape (6,), joints 1 to 3 stay, and joint 5 says whether axes 4 and 6 are parallel or opposed.
        """
        signs, offsets = self.model.signs, self.model.offsets
        theta = np.asarray(signs) * branch - offsets
        opposed = math.cos(theta[4]) < 0.0
        q = branch.copy()
        q[4] = signs[4] * ((math.copysign(math.pi, theta[4]) if opposed else 0.0) + offsets[4])
        # the sense in which joints 4 and 6 contribute to the missing angle
        fraction = np.array([signs[3], -signs[5] if opposed else signs[5]], dtype=float)
        missing = self._missing_turn(q, pose, seed, opposed)
        start = np.array([seed[3], seed[5]])
        lower, upper = self.ranges.lower[[3, 5]] - start, self.ranges.upper[[3, 5]] - start
        turns = math.ceil(float((upper - lower).sum()) / TURN) + 1
        found = []
        for total in (missing + TURN * turn for turn in range(-turns, turns + 1)):
            # joint 4 takes t and joint 6 takes total - t; both must stay in range
            ends = np.sort(
                [
                    [lower[0] * fraction[0], upper[0] * fraction[0]],
                    [total - lower[1] * fraction[1], total - upper[1] * fraction[1]],
                ]
            )
            low, high = float(ends[:, 0].max()), float(ends[:, 1].min())
            if low <= high + _EDGE_ROUNDING:
                t = min(max(0.5 * total, low), high)
                solution = q.copy()
                solution[[3, 5]] = start + fraction * (t, total - t)
                found.append(solution)
        return sorted(found, key=lambda solution: math.dist(solution, seed))

    def _missing_turn(self, q: np.ndarray, pose: Pose, seed: JointValues, opposed: bool) -> float:
        """Return the angle about axis 6 from the tip to the target, with joints 4 and 6 at the seed [rad]."""
        tip_R_flange = self._tip_T_flange[:3, :3]
        held = q.copy()
        held[[3, 5]] = seed[3], seed[5]
        reached = self.chain.forward(held).rotation @ tip_R_flange
        target = pose.rotation @ tip_R_flange
        turned = reached.T @ target
        angle = math.atan2(turned[1, 0], turned[0, 0])
        # the angle counts about axis 4, and opposed axes have the opposite sense
        return -angle if opposed else angle

    def _explain(self, pose: Pose, seed: JointValues, configuration: Configuration | None) -> NoReturn:
        """Raise the error that says why there is no solution."""
        check_pose(pose)
        if configuration is not None:
            self.raise_configuration_error(configuration, pose, seed)
        flange = self.flange(pose)
        branches, _, extension = self.branches(flange)
        if extension[0] < 0.0:
            raise UnreachableError(-float(extension[0]), self.is_too_close(flange))
        self.raise_range_error(branches[0][np.isfinite(branches[0]).all(axis=1)])
        raise NotFoundError(len(SLOTS), 0.0, *self._best_residual(branches[0], pose))

    def raise_range_error(self, branches: np.ndarray) -> None:
        """Raise the error of the joint out of range, of the branch, shape (m, 6), that is out of range by the least."""
        q, excess = self.excess(branches)
        excess -= self.settings.tolerance_rad
        placed = excess[:, :3].max(axis=1, initial=-math.inf) <= 0.0
        candidates = np.flatnonzero(placed) if placed.any() else np.arange(len(q))
        if not len(candidates):
            return
        row = candidates[excess[candidates].max(axis=1).argmin()]
        joint = int(excess[row].argmax())
        if excess[row, joint] > 0.0:
            raise self.range_error(joint, float(q[row, joint]), bool(placed.any()))

    def is_too_close(self, flange: np.ndarray) -> bool:
        """Return whether an unreachable target, shape (4, 4), is inside the inner edge of the reach, not beyond the outer one."""
        outer, inner = max(self.model.margins(*self.model.wrist_centre(flange)), key=min)
        return inner < outer

    def _best_residual(self, branches: np.ndarray, pose: Pose) -> tuple[float, float]:
        found = [residual(self.chain, q, pose) for q in branches if np.isfinite(q).all()]
        return min(found, key=max, default=(math.inf, math.inf))


def _lacks_branches(wrist: list[float], margins: Sequence[float]) -> bool:
    """Return whether branches are missing at a shoulder within reach: the wrist is singular."""
    if not math.isnan(sum(wrist)):
        return False
    for margin, slots in zip(margins, _SIDES):
        if margin > 0.0 and any(math.isnan(wrist[slot]) for slot in slots):
            return True
    return False


def _shifted(flange: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return a target moved by `_NUDGE` in a direction."""
    moved = flange.copy()
    moved[:3, 3] += _NUDGE * direction
    return moved
