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
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from construction_twin.kinematics.axes import joint_axes
from construction_twin.kinematics.carriage import Carriage, carries
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.decomposition import ClosedForm, NoClosedForm, find_closed_form
from construction_twin.kinematics.numeric import NumericInverse
from construction_twin.kinematics.self_motion import SelfMotion
from construction_twin.kinematics.solution import (
    ArmKind,
    Configuration,
    IkSolution,
    InverseKinematics,
    check_pose,
    pose_error,
    refuse_configuration,
    residual,
    spaced,
)
from construction_twin.robot.description import JointValues

#: Joints to hold, those first whose model does not depend on the held value: the last joint, the first, then the others.
_ORDER = (6, 0, 2, 4, 1, 5, 3)
#: Values at which the joint is held, ends of the range included: for `nearest`, for `all`, and where none leads to a solution.
_FEW, _VALUES, _FINER = 40, 56, 321
#: Most steps of a slide, the longest of them, and the one at which it ends [rad].
_STEPS, _LONGEST, _SETTLED = 8, 0.3, 2e-3
#: Where the seed misses the pose by less, first only values within a window around the seed's are tried [m], [rad].
_BESIDE, _WINDOW = 0.5, 1.0
#: `all` returns at most so many, whole turns not counted.
_MOST = 64
#: A sample out of range by less may slide into it [rad]; how many samples are tried, and how far apart they are [rad].
_NEARLY, _SLID, _APART = 0.4, 6, 0.35
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
    """Six joints solved with the linear axis that carries them held at a position."""

    def __init__(self, form: ClosedForm, carriage: Carriage):
        self._solve = form.solver().calculate_IK
        self._direction = carriage.direction
        self._carriage_T_base = carriage.seen_from(Pose(np.zeros(3), np.eye(3)), 0.0).matrix()

    def solver(self, value: float) -> _Solve:
        """Return the same as `_Held.solver`."""
        travel = value * self._direction

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
    carried = carries(chain)
    if not carried and linear != (False,) * 7:
        revolute = linear.count(False)
        return NoClosedForm(
            f"it has {revolute} revolute and {len(linear) - revolute} prismatic joints, not six or seven revolute ones, "
            "or six behind a prismatic one"
        )
    if carried:
        arm = Carriage(chain).arm
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


class RedundantInverse(InverseKinematics):
    """Inverse kinematics of seven joints, one of them held.

    Args:
        form: Of the other six, from `find_redundant`.
        held: The joint to hold, from 0.
        search: Of the same chain.
    """

    def __init__(self, chain: Chain, form: ClosedForm, held: int, search: NumericInverse):
        super().__init__(chain, search.settings, _EXACT, math.inf)
        self.form, self.held = form, held
        self._search = search
        self._motion = SelfMotion(chain, held)
        self._arm = _Carried(form, Carriage(chain)) if carries(chain) else _Held(form)
        self._solvers = {count: self._divided(count) for count in (_FEW, _VALUES, _FINER)}

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("one redundant joint", self.form.why)

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: where the arm slides from the nearest sample; `all` may know a nearer one."""
        start = self._checked(pose, seed, configuration)
        target = pose.matrix()
        return (
            self._beside(target, pose, start) or self._slid(target, pose, start) or self._thorough(target, pose, start)
        )

    def _beside(self, target: np.ndarray, pose: Pose, seed: np.ndarray) -> IkSolution | None:
        """Return the nearest solution of a pose that the seed is almost on; None: it is not, or nothing is near."""
        if max(residual(self.chain, seed, pose)) >= _BESIDE:
            return None
        found = self._along(*self._samples(_VALUES, target, float(seed[self.held])), target, pose, seed, beside=True)
        # what is nearer than this has the held joint within the window
        return found if found is not None and found.distance < _WINDOW else None

    def _slid(self, target: np.ndarray, pose: Pose, seed: np.ndarray) -> IkSolution | None:
        """Return the solution to which the arm slides from the nearest sample within the ranges; None: there is no such sample."""
        samples = self.ranges.into_range(self._samples(_FEW, target)[0], seed)
        samples = samples[self.ranges.excess(samples) <= 0.0]
        if not len(samples):
            return None
        ways = samples - seed
        nearest = samples[np.einsum("mn,mn->m", ways, ways).argmin()]
        slid = self.confirmed(self._slide(nearest, seed, pose).tolist(), pose, seed)
        if slid is not None and slid.distance <= math.dist(nearest, seed):
            return slid
        return self.confirmed(nearest.tolist(), pose, seed) or slid

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
            ends = np.array([(self.ranges.lower - q)[moving], (self.ranges.upper - q)[moving]]) / direction[moving]
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
            if found is not None:
                return found
        for q in self._almost(target, seed)[:_SLID]:
            found = self.confirmed(self._search.towards(q, seed, pose).tolist(), pose, seed)
            if found is not None:
                return found
        return self._search.nearest(pose, seed)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`; besides, solutions spaced along the self-motions, for whoever cannot use the nearest.

        Whoever has to avoid contacts takes the first that is free: the choice of the free joint is his.
        """
        start = self._checked(pose, seed, configuration)
        target = pose.matrix()
        found = [self._thorough(target, pose, start)]
        samples = self.ranges.into_range(self._samples(_VALUES, target)[0], start)
        inside = samples[self.ranges.excess(samples) <= 0.0]
        inside = inside[((inside - start) ** 2).sum(axis=1).argsort()]
        found += spaced(inside, found, _MOST - 1, lambda number: self.confirmed(inside[number].tolist(), pose, start))
        turned = [other for solution in found for other in self._turned(solution, pose, start)]
        return sorted(turned, key=lambda solution: solution.distance)

    def held_at(self, value: float, pose: Pose) -> np.ndarray:
        """Return all postures of the model on a pose with the held joint at a value, shape (m, 7); ranges are ignored.

        Args:
            value: [rad] or [m]
        """
        found = self._arm.solver(value)(pose.matrix())
        return found.Q[~found.is_LS].reshape(-1, len(self.ranges.lower))

    def configuration(self, q: JointValues) -> None:
        """Return None: these arms have no named configurations."""
        return None

    def _checked(self, pose: Pose, seed: JointValues, configuration: Configuration | None) -> np.ndarray:
        self.chain.robot.check_range(seed)
        check_pose(pose)
        refuse_configuration(configuration)
        return np.array(seed, dtype=float)

    def _divided(self, count: int) -> tuple[list[float], list[_Solve]]:
        """Return the values of a division of the held joint's range, and their solvers."""
        values = np.linspace(self.ranges.lower[self.held], self.ranges.upper[self.held], count).tolist()
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
            return np.empty((0, len(self.ranges.lower))), counts
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
    ) -> IkSolution | None:
        """Return the nearest solution along the self-motions; None: there is none."""

        def point(q: np.ndarray) -> np.ndarray | None:
            found = self._arm.solver(float(q[self.held]))(target)
            if not len(found.Q) or found.is_LS.all():
                return None
            ways = self.ranges.wrapped(found.Q - q)
            return found.Q[np.einsum("mn,mn->m", ways, ways).argmin()]

        best = self._motion.nearest(samples, counts, pose, seed, point, beside)
        return None if best is None else self.confirmed(best.tolist(), pose, seed)

    def _almost(self, target: np.ndarray, seed: np.ndarray) -> np.ndarray:
        """Return samples that are almost in range, nearest to the ranges first."""
        q = self.ranges.into_range(self._samples(_FINER, target)[0], seed)
        excess = self.ranges.excess(q)
        order = excess.argsort()
        kept: list[np.ndarray] = []
        for each in q[order[excess[order] < _NEARLY]]:
            if len(kept) < _SLID and all(math.dist(each, other) > _APART for other in kept):
                kept.append(each)
        return np.array(kept).reshape(-1, len(seed))

    def _turned(self, solution: IkSolution, pose: Pose, seed: np.ndarray) -> list[IkSolution]:
        """Return a solution with every choice of whole turns within the ranges."""
        own = tuple(solution.q.tolist())
        others = (q for q in self.ranges.turned(own, self.settings.tolerance_rad) if q != own)
        return [solution, *(other for q in others if (other := self.confirmed(q, pose, seed)) is not None)]
