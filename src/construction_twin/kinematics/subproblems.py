"""Inverse kinematics of six revolute axes that have a closed form, some being parallel or meeting in a point (`KINDS`).

The package EAIK (Ostermeier, "Automatic geometric decomposition for analytical inverse kinematics", 2024) splits a pose into
geometric subproblems. It wants these properties to the last digits: a measured arm is solved for a nominal model in which they
hold, and Newton steps on the true chain remove what that misses. Where they lead to no solution, and at a singular pose with joints
that turn against each other, the search (`numeric`) answers as well. Lengths [m], angles [rad].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from eaik.pybindings.EAIK import Robot as Solver

from construction_twin.kinematics.axes import TOLERANCE, Axis, joint_axes
from construction_twin.kinematics.branches import BranchInverse
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.solution import (
    ArmKind,
    Configuration,
    IkSolution,
    UnreachableError,
    UnreachableOrientationError,
    check_pose,
    distinct,
    refine,
    refuse_configuration,
    residual,
)
from construction_twin.robot.description import JointValues
from construction_twin.robot.motion_errors import KinematicsError

#: An arm that misses the properties of a kind by no more than this gets a nominal model of that kind.
NEAR_M, NEAR_RAD = 5e-3, math.radians(0.3)
#: Axes that meet are at least this far from parallel: otherwise where they meet is not defined well [rad].
_CROSSED = 0.02
#: Axes whose directions have a smaller cosine are not taken for parallel ones.
_ALIKE = 0.5
#: Poses on which a model is tried, and how well its forward kinematics must agree with KDL's where it is exact [m], [rad].
_TRIALS, _TRIAL_SEED = 20, 2024
_AGREES = 1e-8
#: Two axes that are closer to parallel than this turn against each other without moving the tip [rad]; of a nominal model.
_SINGULAR, _SINGULAR_NEAR = 1e-6, 2e-2
#: Newton steps from the nominal model to the true arm.
_POLISH = 12

#: Axes, from 0, and whether they are parallel; otherwise they meet in a point.
_Property = tuple[bool, tuple[int, ...]]


def _parallel(*axes: int) -> _Property:
    return True, axes


def _meeting(*axes: int) -> _Property:
    return False, axes


#: Sets of properties that give six axes a closed form; those with the quickest formulas first.
KINDS: tuple[tuple[_Property, ...], ...] = (
    (_parallel(1, 2, 3), _meeting(4, 5)),
    (_parallel(2, 3, 4), _meeting(0, 1)),
    (_meeting(3, 4, 5), _parallel(1, 2)),
    (_meeting(0, 1, 2), _parallel(3, 4)),
    (_meeting(3, 4, 5), _parallel(0, 1)),
    (_meeting(0, 1, 2), _parallel(4, 5)),
    (_meeting(3, 4, 5), _meeting(0, 1)),
    (_meeting(0, 1, 2), _meeting(4, 5)),
    (_meeting(3, 4, 5), _meeting(1, 2)),
    (_meeting(0, 1, 2), _meeting(3, 4)),
    (_parallel(0, 1, 2), _meeting(4, 5)),
    (_parallel(3, 4, 5), _meeting(0, 1)),
    (_parallel(1, 2, 3),),
    (_parallel(2, 3, 4),),
    (_meeting(3, 4, 5),),
    (_meeting(0, 1, 2),),
)


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """A model of an arm that has a closed form.

    Attributes:
        properties: Why it has one, as part of a sentence.
        off_m, off_rad: By how much the true axes miss them.
        directions, points: Shape (6, 3). Of the axes in the base, with all joints at zero, as is `tip`.
    """

    properties: str
    off_m: float
    off_rad: float
    directions: np.ndarray
    points: np.ndarray
    tip: Pose

    @property
    def exact(self) -> bool:
        """Whether the model is the arm itself, but for rounding."""
        return max(self.off_m, self.off_rad) <= TOLERANCE

    @property
    def relative_error(self) -> float:
        """Deviation of the arm from the model, as a fraction of what is allowed; 0: it is exact."""
        return 0.0 if self.exact else max(self.off_m / NEAR_M, self.off_rad / NEAR_RAD)

    def solver(self) -> Solver:
        """Return EAIK's solver for this model."""
        places = np.vstack([self.points, self.tip.position])
        offsets = np.diff(places, axis=0, prepend=np.zeros((1, 3)))
        return Solver(self.directions.T, offsets.T, self.tip.rotation, [], True)


def find_closed_form(chain: Chain) -> ClosedForm | str:
    """Return the model that solves six revolute joints, the exact one if there is one, else the nearest; or why there is none."""
    axes, tip = joint_axes(chain), chain.forward([0.0] * 6)
    forms = [form for form in (_model(kind, axes, tip) for kind in KINDS) if form is not None]
    forms.sort(key=lambda form: form.relative_error)
    for form in forms:
        if form.relative_error <= 1.0 and _is_solvable(form, chain):
            return form
    if not forms:
        return "no two of its neighbouring axes meet"
    return (
        f"no closed form is near: the nearest one needs that {forms[0].properties}, which they miss by "
        f"{forms[0].off_m * 1e3:.3g} mm and {math.degrees(forms[0].off_rad):.3g} deg (allowed: {NEAR_M * 1e3:g} mm and "
        f"{math.degrees(NEAR_RAD):.1g} deg)"
    )


def _model(kind: tuple[_Property, ...], axes: Sequence[Axis], tip: Pose) -> ClosedForm | None:
    """Return the model with given properties that is near the axes; None: axes that should meet are parallel."""
    directions, points = np.array([axis.direction for axis in axes]), np.array([axis.point for axis in axes])
    off_m, words = 0.0, []
    for parallel, numbers in kind:
        group = list(numbers)
        names = [str(axis + 1) for axis in group]
        words.append(
            f"axes {', '.join(names[:-1])} and {names[-1]} {'are parallel' if parallel else 'meet in a point'}"
        )
        if parallel:
            alike = directions[group] @ directions[group[0]]
            if np.abs(alike).min() < _ALIKE:
                return None
            mean = np.sign(alike) @ directions[group]
            directions[group] = np.sign(alike)[:, None] * (mean / np.linalg.norm(mean))
    for group in (list(numbers) for parallel, numbers in kind if not parallel):
        crossed = np.linalg.norm(np.cross(directions[group[:-1]], directions[group[1:]]), axis=1)
        if crossed.min() < _CROSSED:
            return None
        across = np.eye(3) - directions[group][:, :, None] * directions[group][:, None, :]
        place = np.linalg.solve(across.sum(axis=0), np.einsum("aij,aj->i", across, points[group]))
        off_m = max(off_m, *(float(np.linalg.norm(axes[axis].nearest(place) - place)) for axis in group))
        points[group] = place
    turned = np.linalg.norm(np.cross(directions, [axis.direction for axis in axes]), axis=1)
    return ClosedForm(" and ".join(words), off_m, float(turned.max()), directions, points, tip)


def _is_solvable(form: ClosedForm, chain: Chain) -> bool:
    """Return whether EAIK solves a model, and whether the model is the chain as far as it should be."""
    robot = chain.robot
    allowed = _AGREES if form.exact else 10.0 * (form.off_m + form.off_rad)
    solver = form.solver()
    if not solver.has_known_decomposition():
        return False
    rng = np.random.default_rng(_TRIAL_SEED)
    for q in rng.uniform(robot.lower, robot.upper, (_TRIALS, len(robot.lower))):
        reached = solver.fwdkin(q)
        found = np.asarray(solver.calculate_IK(reached).Q)
        if np.abs(reached - chain.forward(q).matrix()).max() > allowed or not len(found):
            return False
        if np.abs(np.exp(1j * found) - np.exp(1j * q)).max(axis=1).min() > 1e-4:
            return False
    return True


class SubproblemInverse(BranchInverse):
    """Inverse kinematics of six revolute joints with a closed form."""

    def __init__(self, chain: Chain, form: ClosedForm, search: NumericInverse):
        super().__init__(chain, search.settings)
        self.form = form
        self._search = search
        self._solver = form.solver()
        self._target = np.eye(4)
        self._elements, self._ones = self._target.reshape(16), np.ones(16)
        # of joints whose neighbours can come in line: the cosine between these is constant + cosine cos(q) + sine sin(q)
        self._alignments = []
        for joint in (1, 4):
            first, turning, last = form.directions[joint - 1 : joint + 2].tolist()
            constant = float(np.dot(first, turning) * np.dot(turning, last))
            cosine, sine = float(np.dot(first, last)) - constant, float(np.dot(first, np.cross(turning, last)))
            if math.hypot(cosine, sine) >= 1e-3:
                self._alignments.append((joint, constant, cosine, sine))
        near = _SINGULAR if form.exact else _SINGULAR_NEAR
        self._aligned = 1.0 - 0.5 * near * near

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        form = self.form
        near = "" if form.exact else f", to within {form.off_m * 1e3:.2g} mm and {math.degrees(form.off_rad):.2g} deg"
        return ArmKind("closed form", f"{form.properties}{near}")

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`."""
        start = self._start(seed, configuration)
        rows, complete = self._solve(pose)
        best = self.nearest_confirmed(rows, pose, start, [None] * len(rows))
        if best is not None and complete:
            return best
        found = [] if best is None else [best]
        found = self._with_search(found, complete, pose, start, lambda: [self._search.nearest(pose, start)])
        return min(found, key=lambda solution: solution.distance)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`."""
        start = self._start(seed, configuration)
        rows, complete = self._solve(pose)
        found = [solution for row in rows for solution in self.turned(np.array(row), pose, start, None)]
        found = self._with_search(found, complete, pose, start, lambda: self._search.all(pose, start))
        return distinct(sorted(found, key=lambda solution: solution.distance))

    def _start(self, seed: JointValues, configuration: Configuration | None) -> list[float]:
        self.chain.robot.check_range(seed)
        refuse_configuration(configuration)
        return [float(value) for value in seed]

    def branches(self, pose: Pose) -> tuple[list[list[float]], Sequence[bool]]:
        """Return the model's branches of a target [rad], ranges not considered, and which of them are only the nearest miss."""
        self._target[:3, :3] = pose.rotation
        self._target[:3, 3] = pose.position
        if not math.isfinite(self._elements.dot(self._ones)):
            check_pose(pose)
        found = self._solver.calculate_IK(self._target)
        return found.Q.tolist(), found.is_LS

    def _solve(self, pose: Pose) -> tuple[list[list[float]], bool]:
        """Return the branches of a target, ranges not considered, and whether there is nothing besides them."""
        rows, missed = self.branches(pose)
        singular = self._is_singular(rows)
        if self.form.exact:
            return rows, not singular
        polished = [refine(self.chain, np.array(row), pose, _POLISH, within=False) for row in rows]
        solved = [self.is_solved(*residual(self.chain, q, pose)) for q in polished]
        # where the nominal model has no branch but only a nearest miss, the true arm need not have one
        lost = any(not reached and not miss for reached, miss in zip(solved, missed))
        return [q.tolist() for q, reached in zip(polished, solved) if reached], not (singular or lost)

    def _is_singular(self, rows: Sequence[Sequence[float]]) -> bool:
        """Return whether a branch has two axes in line, so that it stands for a whole family of joint values."""
        limit = self._aligned
        for joint, constant, cosine, sine in self._alignments:
            for row in rows:
                angle = row[joint]
                if abs(constant + cosine * math.cos(angle) + sine * math.sin(angle)) > limit:
                    return True
        return False

    def _with_search(
        self,
        found: list[IkSolution],
        complete: bool,
        pose: Pose,
        seed: list[float],
        search: Callable[[], list[IkSolution]],
    ) -> list[IkSolution]:
        """Add what the search finds where the branches may not be all; if there is nothing, raise the error that says why.

        A nominal model proves nothing about the true arm: near the edge of its reach it may have no branch where that has one.
        """
        if not complete or not (found or self.form.exact):
            try:
                found = found + search()
            except KinematicsError:
                # of branches that exist but are out of range, more can be said than that nothing was found
                if not found and (self.form.exact or not self._solve(pose)[0]):
                    raise
        if not found:
            self._explain(pose, seed)
        return found

    def _explain(self, pose: Pose, seed: list[float]) -> NoReturn:
        """Raise the error that says why there is no solution."""
        check_pose(pose)
        rows = [refine(self.chain, np.array(row), pose, _POLISH, within=False) for row in self.branches(pose)[0]]
        reached = np.array([q for q in rows if self.is_solved(*residual(self.chain, q, pose))])
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
