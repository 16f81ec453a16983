"""Inverse kinematics of seven joints of which one can be held so that the other six have a closed form (`decomposition`).

A pose leaves such an arm one degree of freedom: it can move along a line in joint space, its self-motion, without moving the tip.
The held joint's range is divided evenly. With the joint held at each value in turn the closed form gives every branch, which
together are samples of all self-motions. From the nearest samples within the ranges the arm slides along the self-motion towards
the seed, until no motion brings it nearer or a joint's range ends. Where no sample is within the ranges, the division becomes
finer, and at last `numeric` searches. SI; the held joint may be a linear axis that carries the arm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from eaik.pybindings.EAIK import Robot as Solver

from construction_twin.core.motion_errors import BranchError
from construction_twin.kinematics.axes import joint_axes
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.decomposition import ClosedForm, NoClosedForm, find_closed_form
from construction_twin.kinematics.numeric import NumericInverse
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
#: Values at which the joint is held, and how many times finer the division becomes where none of them leads to a solution.
_VALUES, _FINER = 40, (4, 16)
#: Samples from which the arm slides towards the seed: for the nearest solution, and for all.
_SLID, _SLID_ALL = 1, 6
#: Samples that are nearer to each other than this are one [rad].
_APART = 0.35
#: Most samples that `all` returns.
_MOST = 64
#: A sample out of range by less may slide into it [rad].
_NEARLY = 0.4
#: A solution that misses the pose by more is improved by Newton steps [m], [rad].
_EXACT = 1e-8
#: Most steps of a slide, the longest of them, and the one at which it ends [rad].
_STEPS, _LONGEST, _SETTLED = 8, 0.3, 2e-3


class _Held:
    """Six joints solved with the seventh held at values of a revolute joint."""

    def __init__(self, form: ClosedForm):
        self._form = form

    def solver(self, value: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Return what gives the joint values, shape (m, 7), that reach a target with the joint held, and which are no solutions."""
        return _of_solver(self._form.solver(value))


class _Carried:
    """Six joints solved with the linear axis that carries them held at a place."""

    def __init__(self, form: ClosedForm, whole: Chain, arm: Chain):
        self._solver = form.solver()
        home = np.array(whole.robot.home)
        home[0] = 0.0
        base, part = whole.forward(home), arm.forward(home[1:])
        self._axis = whole.jacobian(home)[:3, 0]
        rotation = base.rotation @ part.rotation.T
        self._carriage_T_base = np.eye(4)
        self._carriage_T_base[:3, :3] = rotation.T
        self._carriage_T_base[:3, 3] = -rotation.T @ (base.position - rotation @ part.position)

    def solver(self, value: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Return the same as `_Held.solver`."""
        solve = _of_solver(self._solver)
        travel = value * self._axis

        def rows(target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            moved = target.copy()
            moved[:3, 3] -= travel
            q, missed = solve(self._carriage_T_base @ moved)
            return np.column_stack([np.full(len(q), value), q]) if len(q) else np.empty((0, 7)), missed

        return rows


def _of_solver(solver: Solver) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    def rows(target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = solver.calculate_IK(target)
        return found.Q, found.is_LS

    return rows


def find_redundant(chain: Chain) -> tuple[ClosedForm, int] | NoClosedForm:
    """Return the closed form of seven joints with one held, and which one from 0, or why there is none.

    Parameters
    ----------
    chain : Chain
    """
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

    Parameters
    ----------
    chain : Chain
    form : ClosedForm
        Of the other six, from `find_redundant`.
    held : int
        The joint to hold, from 0.
    search : NumericInverse
        Of the same chain.
    """

    def __init__(self, chain: Chain, form: ClosedForm, held: int, search: NumericInverse):
        super().__init__(chain, search.settings)
        self.form, self.held = form, held
        self._search = search
        robot = chain.robot
        self._lower, self._upper = np.array(robot.lower), np.array(robot.upper)
        self._turns = np.where(robot.linear, 0.0, TURN)
        self._per_turn = np.where(robot.linear, np.inf, TURN)
        self._arm = _Carried(form, chain, arm_on_carriage(chain)) if robot.linear[held] else _Held(form)
        self._solvers = [self._arm.solver(value) for value in self._values(_VALUES)]

    @property
    def kind(self) -> ArmKind:
        """See `InverseKinematics.kind`."""
        return ArmKind("one redundant joint", self.form.why)

    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """See `InverseKinematics.nearest`: the nearest to which the arm slides from the nearest samples; not proven."""
        start = self._checked(pose, seed, configuration)
        for solvers in self._divisions(float(start[self.held])):
            samples, excess = self._samples(solvers, pose, start)
            found = list(self._slid(samples, excess, pose, start, _SLID))
            if found:
                return min(found, key=lambda solution: solution.distance)
        return self._search.nearest(pose, start)

    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """See `InverseKinematics.all`; besides, solutions spaced along the self-motions, for whoever cannot use the nearest.

        Whoever has to avoid contacts takes the first that is free: the choice of the free joint is his.
        """
        start = self._checked(pose, seed, configuration)
        found: list[IkSolution] = []
        for solvers in self._divisions(float(start[self.held])):
            samples, excess = self._samples(solvers, pose, start)
            found += self._slid(samples, excess, pose, start, _SLID_ALL)
            inside = samples[excess <= 0.0]
            for q in inside:
                if len(found) < _MOST and all(math.dist(q, other.q) > _APART for other in found):
                    found += self._confirmed(q, pose, start)
            if found:
                break
        if not found:
            found = self._search.all(pose, start)
        turned = [other for solution in found for other in self._turned(solution, pose, start)]
        return sorted(turned, key=lambda solution: solution.distance)

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

    def _values(self, count: int) -> np.ndarray:
        low, high = self._lower[self.held], self._upper[self.held]
        return low + (high - low) * (np.arange(count) + 0.5) / count

    def _divisions(self, here: float) -> Iterator[list[Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]]]:
        """Yield the solvers for ever finer divisions of the held joint's range; the first also has the seed's value."""
        yield [self._arm.solver(here), *self._solvers]
        for finer in _FINER:
            yield [self._arm.solver(value) for value in self._values(_VALUES * finer)]

    def _samples(
        self, solvers: Sequence[Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]], pose: Pose, seed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return joint values on the pose, shape (m, 7), nearest to the seed first, and by how much they are out of range."""
        target = np.eye(4)
        target[:3, :3], target[:3, 3] = pose.rotation, pose.position
        found = [solve(target) for solve in solvers]
        rows = [q for q, _ in found if len(q)]
        if not rows:
            return np.empty((0, len(seed))), np.empty(0)
        q, missed = np.concatenate(rows), np.concatenate([each for q, each in found if len(q)])
        # where all only miss the pose, the arm may be stretched to the edge of its reach, which rounding decides
        if self.form.exact and not missed.all():
            q = q[~missed]
        q = q - self._turns * np.rint((q - seed) / self._per_turn)
        q = np.where((q > self._upper) & (q - self._turns >= self._lower), q - self._turns, q)
        q = np.where((q < self._lower) & (q + self._turns <= self._upper), q + self._turns, q)
        excess = np.maximum(self._lower - q, q - self._upper).max(axis=1)
        order = ((q - seed) ** 2).sum(axis=1).argsort()
        order = order[excess[order] < _NEARLY]
        return q[order], excess[order]

    def _slid(
        self, samples: np.ndarray, excess: np.ndarray, pose: Pose, seed: np.ndarray, most: int
    ) -> Iterator[IkSolution]:
        """Yield solutions to which the arm slides from the nearest samples: first from those in range, else from those near it."""
        tried: list[np.ndarray] = []
        for allowed in (0.0, _NEARLY):
            count = 0
            for q in samples[(excess <= allowed) & (excess > allowed - _NEARLY - 10.0 * (allowed == 0.0))]:
                if any(math.dist(q, other) < _APART for other in tried):
                    continue
                tried.append(q)
                solutions = self._towards(q, seed, pose)
                yield from solutions
                count += len(solutions)
                if count >= most:
                    break
            if count:
                return

    def _towards(self, q: np.ndarray, seed: np.ndarray, pose: Pose) -> list[IkSolution]:
        """Return the solution to which the arm slides from a sample; if that fails, the sample; as a list."""
        if (q < self._lower).any() or (q > self._upper).any():
            return self._confirmed(self._search.towards(q, seed, pose), pose, seed)
        slid = self._confirmed(self._slide(q, seed, pose), pose, seed)
        here = math.dist(q, seed)
        return slid if slid and slid[0].distance <= here else self._confirmed(q, pose, seed) or slid

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
