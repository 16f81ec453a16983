"""Inverse kinematics of six revolute axes that have a closed form (`decomposition`): every branch, and exactly the nearest.

The branches come from EAIK. This module adds whole turns and ranges, and confirms every solution by KDL's forward kinematics. Two
cases go further:

- **An arm near a closed form** is solved for its nominal model; Newton steps on the true chain remove what that misses. Where no
  branch leads to a solution, the search answers.
- **At a singular pose** in which joints turn against each other without moving the tip, the closed form is not defined. There the
  search (`numeric`) answers, which slides along that motion towards the seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NoReturn, TypeVar

import numpy as np

from construction_twin.core.motion_errors import (
    KinematicsError,
    NotFoundError,
    UnreachableError,
    UnreachableOrientationError,
)
from construction_twin.kinematics.axes import Alignment, alignment
from construction_twin.kinematics.branches import BranchInverse
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.decomposition import ClosedForm
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.solution import (
    ArmKind,
    Configuration,
    IkSolution,
    check_pose,
    distinct,
    refine,
    refuse_configuration,
    residual,
)
from construction_twin.robot.description import JointValues

#: Two axes that are closer to parallel than this turn against each other without moving the tip [rad].
_SINGULAR = 1e-6
#: The same where the branches are those of a nominal model [rad].
_SINGULAR_NEAR = 2e-2
#: Neighbours of a joint that can become parallel: first axis, the joint between, last axis.
_TRIPLES = ((0, 1, 2), (3, 4, 5))
#: Newton steps from the nominal model to the true arm.
_POLISH = 12


_Found = TypeVar("_Found")


class SubproblemInverse(BranchInverse):
    """Inverse kinematics of six revolute joints with a closed form."""

    def __init__(self, chain: Chain, form: ClosedForm, search: NumericInverse):
        super().__init__(chain, search.settings)
        self.form = form
        self._search = search
        self._solver = form.solver()
        self._target = np.eye(4)
        self._elements, self._ones = self._target.reshape(16), np.ones(16)
        self._missed = np.zeros(0, dtype=bool)
        between = ((triple[1], alignment(*form.directions[list(triple)])) for triple in _TRIPLES)
        self._alignments = [
            (joint, axes.constant, axes.cosine, axes.sine) for joint, axes in between if _may_align(axes)
        ]
        near = _SINGULAR if form.exact else _SINGULAR_NEAR
        self._aligned = 1.0 - 0.5 * near * near

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("closed form", self.form.why)

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`."""
        self.chain.robot.check_range(seed)
        refuse_configuration(configuration)
        start = [float(value) for value in seed]
        best, complete = self._nearest_branch(self.branches(pose), pose, start)
        if complete:
            return self._searched(pose, start, self._search.nearest) if best is None else best
        return min(self._of_search(pose, start, best), key=lambda solution: solution.distance)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`."""
        self.chain.robot.check_range(seed)
        refuse_configuration(configuration)
        start = [float(value) for value in seed]
        rows = self.branches(pose)
        polished, lost = (rows, False) if self.form.exact else self._all_polished(rows, pose)
        found = [solution for row in polished for solution in self.turned(np.array(row), pose, start, None)]
        if self.is_singular(rows) or lost:
            try:
                found += self._search.all(pose, start)
            except NotFoundError:
                pass  # then the closed form's are all there are
        if not found:
            return self._searched(pose, start, self._search.all)
        return distinct(sorted(found, key=lambda solution: solution.distance))

    def configuration(self, q: JointValues) -> None:
        """Return None: these arms have no named configurations."""
        return None

    def branches(self, pose: Pose) -> list[list[float]]:
        """Return the model's branches of a target [rad], ranges not considered; where there is none, the nearest miss."""
        self._target[:3, :3] = pose.rotation
        self._target[:3, 3] = pose.position
        if not math.isfinite(self._elements.dot(self._ones)):
            check_pose(pose)
        found = self._solver.calculate_IK(self._target)
        self._missed = found.is_LS
        return found.Q.tolist()

    def is_singular(self, rows: Sequence[Sequence[float]]) -> bool:
        """Return whether a branch has two axes in line, so that it stands for a whole family of joint values."""
        limit = self._aligned
        for joint, constant, cosine, sine in self._alignments:
            for row in rows:
                angle = row[joint]
                if abs(constant + cosine * math.cos(angle) + sine * math.sin(angle)) > limit:
                    return True
        return False

    def _nearest_branch(
        self, rows: Sequence[Sequence[float]], pose: Pose, seed: list[float]
    ) -> tuple[IkSolution | None, bool]:
        """Return the nearest confirmed branch, and whether that is all there is to know about the pose."""
        if not self.form.exact:
            return self._nearest_polished(rows, pose, seed)
        if self.is_singular(rows):
            return None, False
        return self.nearest_confirmed(rows, pose, seed, [None] * len(rows)), True

    def _nearest_polished(
        self, rows: Sequence[Sequence[float]], pose: Pose, seed: list[float]
    ) -> tuple[IkSolution | None, bool]:
        polished, lost = self._all_polished(rows, pose)
        best, complete = None, not (lost or self.is_singular(rows))
        for row in polished:
            nearest = self.nearest_branch([row], seed)
            if nearest is not None and (best is None or nearest[1] < best.distance**2):
                best = self.confirmed(nearest[2], pose, seed) or best
        return best, complete

    def _all_polished(self, rows: Sequence[Sequence[float]], pose: Pose) -> tuple[list[list[float]], bool]:
        """Return the branches of the nominal model moved onto the pose by the true chain, and whether one of them was lost.

        Ranges are ignored. Where the nominal model has no branch but only a nearest miss, the true arm may have one.
        """
        kept, lost = [], False
        for row, missed in zip(rows, self._missed.tolist()):
            q = refine(self.chain, np.array(row), pose, _POLISH, within=False)
            if self.is_solved(*residual(self.chain, q, pose)):
                kept.append(q.tolist())
            elif not missed:
                lost = True
        return kept, lost

    def _of_search(self, pose: Pose, seed: list[float], best: IkSolution | None) -> list[IkSolution]:
        """Return the nearest solution of the search, and `best` if there is one; a typed error without any."""
        try:
            return [self._search.nearest(pose, seed), *([] if best is None else [best])]
        except KinematicsError:
            if best is None:
                raise
            return [best]

    def _searched(self, pose: Pose, seed: list[float], search: Callable[[Pose, JointValues], _Found]) -> _Found:
        """Return what a search finds where no branch leads to a solution; if it finds nothing, raise the error that says why.

        A nominal model proves nothing about the true arm: near the edge of its reach it has no branch, only a nearest miss, from
        which the steps need not lead to the branch that the true arm has there. An exact one is not searched.
        """
        check_pose(pose)
        branches = self.branches(pose)
        rows = [refine(self.chain, np.array(row), pose, _POLISH, within=False) for row in branches]
        reached = np.array([q for q in rows if self.is_solved(*residual(self.chain, q, pose))])
        if not self.form.exact and (self._missed.any() or len(reached) < len(rows)):
            try:
                return search(pose, seed)
            except KinematicsError:
                # of branches that exist but are out of range, more can be said than that nothing was found
                if not len(reached):
                    raise
        self._explain(pose, seed, reached)

    def _explain(self, pose: Pose, seed: list[float], reached: np.ndarray) -> NoReturn:
        """Raise the error that says why there is no solution; `reached` are the branches that exist, ranges ignored."""
        missing = self._search.missing_position(pose, np.array(seed))
        placed = missing <= self.settings.tolerance_m
        if len(reached):
            q, excess = self.excess(reached)
            row = int(excess.max(axis=1).argmin())
            joint = int(excess[row].argmax())
            raise self.range_error(joint, float(q[row, joint]), placed)
        if not placed:
            distance = float(np.linalg.norm(pose.position - self.chain.shoulder))
            bound = distance - self.chain.reach
            raise UnreachableError(bound if bound > 0.0 else missing, distance < 0.5 * self.chain.reach)
        raise UnreachableOrientationError


def _may_align(axes: Alignment) -> bool:
    """Return whether some angle of the joint between two axes brings them in line."""
    return axes.size >= 1e-3 and abs(axes.constant) + axes.size >= 1.0 - 0.5 * _SINGULAR_NEAR**2
