"""Inverse kinematics of six revolute axes that have a closed form, some being parallel or meeting in a point (`KINDS`).

The package EAIK (Ostermeier, "Automatic geometric decomposition for analytical inverse kinematics", 2024) splits a pose into
geometric subproblems. At a singular pose with joints that turn against each other the search (`numeric`) answers as well. Lengths
[m], angles [rad].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from eaik.pybindings.EAIK import Robot as Solver

from construction_twin.kinematics.branches import BranchInverse
from construction_twin.kinematics.chain import Axis, Chain, Pose, joint_axes
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.solution import (
    ArmKind,
    Configuration,
    IkSolution,
    UnreachableError,
    UnreachableOrientationError,
    check_pose,
    distinct,
    refuse_configuration,
    residual,
)
from construction_twin.robot.description import JointValues
from construction_twin.robot.motion_errors import KinematicsError

#: Axes that meet are at least this far from parallel: otherwise where they meet is not defined well [rad].
_CROSSED = 0.02
#: Axes whose directions have a smaller cosine are not taken for parallel ones.
_ALIKE = 0.5
#: An arm may miss its properties by this, as with angles of five digits in its URDF; every solution is refined [m], [rad].
_NEAR = 1e-5
#: Poses on which a model is tried, and how well its forward kinematics must agree with KDL's [m], [rad].
_TRIALS, _TRIAL_SEED = 20, 2024
_AGREES = 1e-4
#: Two axes that are closer to parallel than this turn against each other without moving the tip [rad].
_SINGULAR = 1e-4

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
    """An arm that has a closed form, and `properties`: why, as part of a sentence.

    Attributes:
        directions, points: Shape (6, 3). Of the axes in the base, with all joints at zero, as is `tip`; with the properties to the
            last digits, which EAIK wants.
    """

    properties: str
    directions: np.ndarray
    points: np.ndarray
    tip: Pose

    def solver(self) -> Solver:
        """Return EAIK's solver for this model."""
        places = np.vstack([self.points, self.tip.position])
        offsets = np.diff(places, axis=0, prepend=np.zeros((1, 3)))
        return Solver(self.directions.T, offsets.T, self.tip.rotation, [], True)


def find_closed_form(chain: Chain) -> ClosedForm | str:
    """Return the closed form of six revolute joints, or why there is none."""
    axes, tip = joint_axes(chain), chain.forward([0.0] * 6)
    forms = (form for kind in KINDS if (form := _model(kind, axes, tip)) is not None)
    return next(
        (form for form in forms if _is_solvable(form, chain)),
        "it has no closed form: no three neighbouring axes are parallel or meet in a point, to 0.01 mm and 1e-5 rad",
    )


def _model(kind: tuple[_Property, ...], axes: Sequence[Axis], tip: Pose) -> ClosedForm | None:
    """Return the axes with given properties; None: they have others."""
    directions, points = np.array([axis.direction for axis in axes]), np.array([axis.point for axis in axes])
    words = []
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
        if max(float(np.linalg.norm(axes[axis].nearest(place) - place)) for axis in group) > _NEAR:
            return None
        points[group] = place
    turned = np.linalg.norm(np.cross(directions, [axis.direction for axis in axes]), axis=1)
    return None if turned.max() > _NEAR else ClosedForm(" and ".join(words), directions, points, tip)


def _is_solvable(form: ClosedForm, chain: Chain) -> bool:
    """Return whether EAIK solves an arm, and by the same forward kinematics as KDL."""
    robot = chain.robot
    solver = form.solver()
    if not solver.has_known_decomposition():
        return False
    rng = np.random.default_rng(_TRIAL_SEED)
    for q in rng.uniform(robot.lower, robot.upper, (_TRIALS, len(robot.lower))):
        reached = solver.fwdkin(q)
        found = np.asarray(solver.calculate_IK(reached).Q)
        if np.abs(reached - chain.forward(q).matrix()).max() > _AGREES or not len(found):
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
        # joints between two axes that can line up; cosine of the angle between those: constant + cosine cos(q) + sine sin(q)
        self._alignments = []
        for joint in (1, 4):
            first, turning, last = form.directions[joint - 1 : joint + 2].tolist()
            constant = float(np.dot(first, turning) * np.dot(turning, last))
            cosine, sine = float(np.dot(first, last)) - constant, float(np.dot(first, np.cross(turning, last)))
            if math.hypot(cosine, sine) >= 1e-3:
                self._alignments.append((joint, constant, cosine, sine))
        self._aligned = 1.0 - 0.5 * _SINGULAR * _SINGULAR

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("closed form", self.form.properties)

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`."""
        start = self._start(seed, configuration)
        rows = self.branches(pose)
        best = self.nearest_confirmed(rows, pose, start, [None] * len(rows))
        found = [] if best is None else [best]
        found = self._with_search(found, rows, pose, start, lambda: [self._search.nearest(pose, start)])
        return min(found, key=lambda solution: solution.distance)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`."""
        start = self._start(seed, configuration)
        rows = self.branches(pose)
        found = [solution for row in rows for solution in self.turned(np.array(row), pose, start, None)]
        found = self._with_search(found, rows, pose, start, lambda: self._search.all(pose, start))
        return distinct(sorted(found, key=lambda solution: solution.distance))

    def _start(self, seed: JointValues, configuration: Configuration | None) -> list[float]:
        self.chain.robot.check_range(seed)
        refuse_configuration(configuration)
        return [float(value) for value in seed]

    def branches(self, pose: Pose) -> list[list[float]]:
        """Return the branches of a target [rad], ranges not considered; also some that only come near it."""
        self._target[:3, :3] = pose.rotation
        self._target[:3, 3] = pose.position
        if not math.isfinite(self._elements.dot(self._ones)):
            check_pose(pose)
        return self._solver.calculate_IK(self._target).Q.tolist()

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
        rows: Sequence[Sequence[float]],
        pose: Pose,
        seed: list[float],
        search: Callable[[], list[IkSolution]],
    ) -> list[IkSolution]:
        """Add what the search finds where a branch is singular, or there is none; raise the error that says why not."""
        singular = self._is_singular(rows)
        if singular or not found:
            try:
                found = found + search()
            except KinematicsError:
                # of branches that are out of range, or of none, more can be said
                if singular and not found:
                    raise
        if not found:
            self._explain(pose, seed)
        return found

    def _explain(self, pose: Pose, seed: list[float]) -> NoReturn:
        """Raise the error that says why there is no solution."""
        check_pose(pose)
        reached = np.array([q for q in self.branches(pose) if self.is_solved(*residual(self.chain, q, pose))])
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
