"""Inverse kinematics of seven joints of which one can be held so that the other six have a closed form (`decomposition`).

A pose leaves such an arm one degree of freedom: it can move along a line in joint space, its self-motion, without moving the tip.
The held joint's range is divided evenly. With the joint held at each value in turn the closed form gives every branch, which
together are samples of all self-motions. `nearest`, which must be quick, slides from the nearest sample within the ranges along its
self-motion towards the seed. `all`, which plans ask, has `self_motion` find the nearest point of all of them. Where no sample
leads to a solution, the division becomes finer; then the arm slides into the ranges from samples almost within them, and at last
`numeric` searches. SI; the held joint may be a linear axis that carries the arm.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from construction_twin.core.motion_errors import BranchError
from construction_twin.kinematics.axes import joint_axes
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.decomposition import ClosedForm, NoClosedForm, find_closed_form
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.self_motion import SelfMotion
from construction_twin.kinematics.solution import (
    TURN,
    ArmKind,
    Configuration,
    IkSolution,
    InverseKinematics,
    check_pose,
    pose_error,
    refine,
    residual,
)
from construction_twin.robot.description import JointValues
from construction_twin.robot.urdf import chain_joints, parse_urdf

#: Joints to hold, those first whose model does not depend on the held value: the last joint, the first, then the others.
_ORDER = (6, 0, 2, 4, 1, 5, 3)
#: Values at which the joint is held, ends of the range included: for `nearest`, for `all`, and where none leads to a solution.
_FEW, _VALUES, _FINER = 40, 56, 321
#: Most steps of a slide, the longest of them, and the one at which it ends [rad].
_STEPS, _LONGEST, _SETTLED = 8, 0.3, 2e-3
#: Where the seed misses the pose by less, first only values within a window around the seed's are tried [m], [rad].
_BESIDE, _WINDOW = 0.5, 1.0
#: Samples that `all` returns are farther apart than this [rad]; and how many of them, at most.
_APART, _MOST = 0.35, 64
#: A sample out of range by less may slide into it [rad]; and how many samples are tried.
_NEARLY, _SLID = 0.4, 6
#: A solution that misses the pose by more is improved by Newton steps [m], [rad].
_EXACT = 1e-8


class _Found(Protocol):
    """What EAIK's solver returns."""

    @property
    def Q(self) -> np.ndarray:
        """Postures, shape (m, 7)."""

    @property
    def is_LS(self) -> np.ndarray:
        """Which of them only come nearest to the pose, shape (m,)."""


_Solve = Callable[[np.ndarray], _Found]


@dataclass(frozen=True, eq=False, slots=True)
class _OnCarriage:
    """The same as `_Found` for an arm with the linear axis that carries it."""

    Q: np.ndarray
    is_LS: np.ndarray


class _Held:
    """Six joints solved with the seventh held at values of a revolute joint."""

    def __init__(self, form: ClosedForm):
        self._form = form

    def solver(self, value: float) -> _Solve:
        """Return what solves a target, shape (4, 4), with the joint held at a value."""
        return self._form.solver(value).calculate_IK


class _Carried:
    """Six joints solved with the linear axis that carries them held at a place."""

    def __init__(self, form: ClosedForm, whole: Chain, arm: Chain):
        self._solve = form.solver().calculate_IK
        home = np.array(whole.robot.home)
        home[0] = 0.0
        base, part = whole.forward(home), arm.forward(home[1:])
        self._axis = whole.jacobian(home)[:3, 0]
        rotation = base.rotation @ part.rotation.T
        self._carriage_T_base = np.eye(4)
        self._carriage_T_base[:3, :3] = rotation.T
        self._carriage_T_base[:3, 3] = -rotation.T @ (base.position - rotation @ part.position)

    def solver(self, value: float) -> _Solve:
        """Return the same as `_Held.solver`."""
        travel = value * self._axis

        def solve(target: np.ndarray) -> _OnCarriage:
            moved = target.copy()
            moved[:3, 3] -= travel
            found = self._solve(self._carriage_T_base @ moved)
            q = found.Q
            return _OnCarriage(
                np.column_stack([np.full(len(q), value), q]) if len(q) else np.empty((0, 7)), found.is_LS
            )

        return solve


def find_redundant(chain: Chain) -> tuple[ClosedForm, int] | NoClosedForm:
    """Return the closed form of seven joints with one held, and which one from 0, or why there is none."""
    linear = chain.robot.linear
    if len(linear) != 7 or any(linear[1:]):
        revolute = linear.count(False)
        return NoClosedForm(
            f"it has {revolute} revolute and {len(linear) - revolute} prismatic joints, not six or seven revolute ones, "
            "or six behind a prismatic one"
        )
    if linear[0]:
        arm = arm_on_carriage(chain)
        form = find_closed_form(arm, joint_axes(arm))
        return form if isinstance(form, NoClosedForm) else (form, 0)
    axes = joint_axes(chain)
    found = [(joint, find_closed_form(chain, axes, joint)) for joint in _ORDER]
    forms = [
        (form.misses, order, form, joint) for order, (joint, form) in enumerate(found) if isinstance(form, ClosedForm)
    ]
    if forms:
        _, _, form, joint = min(forms, key=lambda each: each[:2])
        return form, joint
    reason = next(form.reason for _, form in found if isinstance(form, NoClosedForm))
    return NoClosedForm(f"with none of its joints held the others have a closed form; with joint 7 held {reason}")


def arm_on_carriage(chain: Chain) -> Chain:
    """Return the six joints behind a prismatic one; the carriage is their base."""
    robot = chain.robot
    joints = chain_joints(parse_urdf(robot.urdf), robot.base_link, robot.tip_link)
    carriage = next(joint.child for joint in joints if joint.name == robot.joint_names[0])
    lists = ("joint_names", "lower", "upper", "velocity", "acceleration", "jerk", "home", "axes", "linear")
    return Chain(replace(robot, base_link=carriage, **{name: getattr(robot, name)[1:] for name in lists}))


class RedundantInverse(InverseKinematics):
    """Inverse kinematics of seven joints, one of them held.

    Args:
        form: Of the other six, from `find_redundant`.
        held: The joint to hold, from 0.
        search: Of the same chain.
    """

    def __init__(self, chain: Chain, form: ClosedForm, held: int, search: NumericInverse):
        super().__init__(chain, search.settings)
        self.form, self.held = form, held
        self._search = search
        robot = chain.robot
        self._lower, self._upper = np.array(robot.lower), np.array(robot.upper)
        self._turns = np.where(robot.linear, 0.0, TURN)
        self._motion = SelfMotion(chain, held)
        self._arm = _Carried(form, chain, arm_on_carriage(chain)) if robot.linear[held] else _Held(form)
        self._solvers = {count: self._divided(count) for count in (_FEW, _VALUES, _FINER)}

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("one redundant joint", self.form.why)

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: where the arm slides from the nearest sample; `all` may know a nearer one."""
        start = self._checked(pose, seed, configuration)
        target = _matrix(pose)
        return (
            self._beside(target, pose, start) or self._slid(target, pose, start) or self._thorough(target, pose, start)
        )

    def _beside(self, target: np.ndarray, pose: Pose, seed: np.ndarray) -> IkSolution | None:
        """Return the nearest solution of a pose that the seed is almost on; None: it is not, or nothing is near."""
        if max(residual(self.chain, seed, pose)) >= _BESIDE:
            return None
        found = self._along(*self._samples(_VALUES, target, float(seed[self.held])), target, pose, seed, beside=True)
        # what is nearer than this has the held joint within the window
        return found[0] if found and found[0].distance < _WINDOW else None

    def _slid(self, target: np.ndarray, pose: Pose, seed: np.ndarray) -> IkSolution | None:
        """Return the solution to which the arm slides from the nearest sample within the ranges; None: there is no such sample."""
        samples = self._motion.into_range(self._samples(_FEW, target)[0], seed)
        samples = samples[self._motion.excess(samples) <= 0.0]
        if not len(samples):
            return None
        ways = samples - seed
        nearest = samples[np.einsum("mn,mn->m", ways, ways).argmin()]
        slid = self._confirmed(self._slide(nearest, seed, pose), pose, seed)
        if slid and slid[0].distance <= math.dist(nearest, seed):
            return slid[0]
        return next(iter(self._confirmed(nearest, pose, seed) + slid), None)

    def _slide(self, q: np.ndarray, seed: np.ndarray, pose: Pose) -> np.ndarray:
        """Return where along the self-motion the distance from the seed is least: Newton's method, derivatives by differences."""
        curvature, before = 1.0, None
        step = 0.0
        along = np.zeros(len(q))
        for _ in range(_STEPS):
            error = pose_error(self.chain.forward(q), pose)
            left, sizes, right = np.linalg.svd(self.chain.jacobian(q))
            direction = right[6] if right[6] @ along >= 0.0 else -right[6]
            slope = float((q - seed) @ direction)
            if before is not None and abs(step) > 1e-6:
                curvature = max((slope - before) / step, 0.2)
            before, along = slope, direction
            step = min(max(-slope / curvature, -_LONGEST), _LONGEST)
            # the interval of steps that leave every joint in its range; joints that hardly move do not count
            moving = np.abs(direction) > 1e-9
            ends = np.array([(self._lower - q)[moving], (self._upper - q)[moving]]) / direction[moving]
            low, high = float(ends.min(axis=0).max()), float(ends.max(axis=0).min())
            step = min(max(step, low), high) if low <= high else 0.5 * (low + high)
            q = q + step * direction + right[:6].T @ ((left.T @ error) / np.maximum(sizes, 1e-6))
            if abs(step) < _SETTLED:
                break
        return q

    def _thorough(self, target: np.ndarray, pose: Pose, seed: np.ndarray) -> IkSolution:
        """Return the nearest point of all self-motions that samples were found of; not proven."""
        beside = max(residual(self.chain, seed, pose)) < _BESIDE
        for count in (_VALUES, _FINER):
            found = self._along(*self._samples(count, target), target, pose, seed, beside)
            if found:
                return found[0]
        for q in self._almost(target, seed)[:_SLID]:
            found = self._confirmed(self._search.towards(q, seed, pose), pose, seed)
            if found:
                return found[0]
        return self._search.nearest(pose, seed)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`; besides, solutions spaced along the self-motions, for whoever cannot use the nearest.

        Whoever has to avoid contacts takes the first that is free: the choice of the free joint is his.
        """
        start = self._checked(pose, seed, configuration)
        target = _matrix(pose)
        found = [self._thorough(target, pose, start)]
        samples = self._motion.into_range(self._samples(_VALUES, target)[0], start)
        inside = samples[self._motion.excess(samples) <= 0.0]
        for q in inside[((inside - start) ** 2).sum(axis=1).argsort()]:
            if len(found) < _MOST and all(math.dist(q, other.q) > _APART for other in found):
                found += self._confirmed(q, pose, start)
        turned = [other for solution in found for other in self._turned(solution, pose, start)]
        return sorted(turned, key=lambda solution: solution.distance)

    def held_at(self, value: float, pose: Pose) -> np.ndarray:
        """Return all postures of the model on a pose with the held joint at a value, shape (m, 7); ranges are ignored.

        Args:
            value: [rad] or [m]
        """
        found = self._arm.solver(value)(_matrix(pose))
        return found.Q[~found.is_LS].reshape(-1, len(self._lower))

    def configuration(self, q: JointValues) -> None:
        """Return None: these arms have no named configurations."""
        return None

    def _checked(self, pose: Pose, seed: JointValues, configuration: Configuration | None) -> np.ndarray:
        self.chain.robot.check_range(seed)
        check_pose(pose)
        if configuration is not None and configuration != Configuration():
            raise BranchError(
                str(configuration), (), "has no meaning for an arm without a spherical wrist of the OPW kind"
            )
        return np.array(seed, dtype=float)

    def _divided(self, count: int) -> tuple[list[float], list[_Solve]]:
        """Return the values of a division of the held joint's range, and their solvers."""
        values = np.linspace(self._lower[self.held], self._upper[self.held], count).tolist()
        return values, [self._arm.solver(value) for value in values]

    def _samples(self, count: int, target: np.ndarray, around: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the samples of a division, in the order of the held joint, and how many each value has.

        Args:
            count: Which division.
            target: Shape (4, 4)
            around: Only the values near this one.
        """
        values, solvers = self._solvers[count]
        if around is not None:
            solvers = solvers[bisect.bisect(values, around - _WINDOW) : bisect.bisect(values, around + _WINDOW)]
        found = [solve(target) for solve in solvers]
        q = [each.Q for each in found]
        counts = np.array([len(rows) for rows in q])
        if not counts.any():
            return np.empty((0, len(self._lower))), counts
        samples = np.concatenate([rows for rows in q if len(rows)])
        if self.form.exact:
            solved = ~np.concatenate([each.is_LS for each in found])
            # where all only miss the pose, the arm may be stretched to the edge of its reach, which rounding decides
            if not solved.all() and solved.any():
                return samples[solved], np.bincount(np.repeat(np.arange(len(q)), counts)[solved], minlength=len(q))
        return samples, counts

    def _along(
        self,
        samples: np.ndarray,
        counts: np.ndarray,
        target: np.ndarray,
        pose: Pose,
        seed: np.ndarray,
        beside: bool,
    ) -> list[IkSolution]:
        """Return the nearest solution along the self-motions, as a list."""

        def point(q: np.ndarray) -> np.ndarray | None:
            found = self._arm.solver(float(q[self.held]))(target)
            if not len(found.Q) or found.is_LS.all():
                return None
            ways = self._motion.wrapped(found.Q - q)
            return found.Q[np.einsum("mn,mn->m", ways, ways).argmin()]

        best = self._motion.nearest(samples, counts, pose, seed, point, beside)
        return [] if best is None else self._confirmed(best, pose, seed)

    def _almost(self, target: np.ndarray, seed: np.ndarray) -> np.ndarray:
        """Return samples that are almost in range, nearest to the ranges first."""
        q = self._motion.into_range(self._samples(_FINER, target)[0], seed)
        excess = self._motion.excess(q)
        order = excess.argsort()
        kept: list[np.ndarray] = []
        for each in q[order[excess[order] < _NEARLY]]:
            if len(kept) < _SLID and all(math.dist(each, other) > _APART for other in kept):
                kept.append(each)
        return np.array(kept).reshape(-1, len(seed))

    def _confirmed(self, q: np.ndarray, pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return joint values as a solution if forward kinematics confirms them, after Newton steps where needed; as a list."""
        q = np.clip(q, self._lower, self._upper)
        error = residual(self.chain, q, pose)
        if max(error) > _EXACT:
            q = refine(self.chain, q, pose)
            error = residual(self.chain, q, pose)
            if not self._is_solved(error):
                return []
        return [IkSolution(q, *error, math.dist(q, seed), None)]

    def _turned(self, solution: IkSolution, pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return a solution with every choice of whole turns within the ranges."""
        found = [solution]
        for joint, turn in enumerate(self._turns):
            if turn and self._upper[joint] - self._lower[joint] >= turn:
                for one in list(found):
                    for q in (
                        np.arange(one.q[joint] - turn, self._lower[joint] - 1e-9, -turn).tolist()
                        + np.arange(one.q[joint] + turn, self._upper[joint] + 1e-9, turn).tolist()
                    ):
                        other = one.q.copy()
                        other[joint] = q
                        found += self._confirmed(other, pose, seed)
        return found

    def _is_solved(self, error: tuple[float, float]) -> bool:
        return error[0] <= self.settings.tolerance_m and error[1] <= self.settings.tolerance_rad


def _matrix(pose: Pose) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    return matrix
