"""Which closed form solves an arm of six revolute axes: found from the axes as lines in space.

Six revolute axes have a closed form if some of them are parallel or meet in one point (`KINDS`). The package EAIK (Ostermeier,
"Automatic geometric decomposition for analytical inverse kinematics", 2024) then splits a pose into geometric subproblems, each
of which has a formula. It wants these properties to the last digits, which no measured arm has. So an arm that misses them by
little gets a nominal model, in which they hold; what the nominal model's solutions miss on the true arm is for the caller to
remove. Lengths [m], angles [rad].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eaik.pybindings.EAIK import Robot as Solver

from construction_twin.kinematics.axes import TOLERANCE, Axis
from construction_twin.kinematics.chain import Chain, Pose

#: An arm that misses the properties of a kind by no more than this gets a nominal model of that kind.
NEAR_M, NEAR_RAD = 5e-3, math.radians(0.3)
#: Axes that meet are at least this far from parallel: otherwise where they meet is not defined well [rad].
_CROSSED = 0.02
#: Axes whose directions have a smaller cosine are not taken for parallel ones.
_ALIKE = 0.5
#: Poses on which a model is tried, and how well its forward kinematics must agree with KDL's where it is exact [m], [rad].
_TRIALS, _TRIAL_SEED = 20, 2024
_AGREES = 1e-8


@dataclass(frozen=True)
class Property:
    """Axes that are parallel, or meet in one point.

    Attributes:
        parallel: False: they meet.
        axes: From 0, ascending.
    """

    parallel: bool
    axes: tuple[int, ...]

    def __str__(self) -> str:
        numbers = [str(axis + 1) for axis in self.axes]
        return (
            f"axes {', '.join(numbers[:-1])} and {numbers[-1]} {'are parallel' if self.parallel else 'meet in a point'}"
        )


def _parallel(*axes: int) -> Property:
    return Property(True, axes)


def _meeting(*axes: int) -> Property:
    return Property(False, axes)


#: Sets of properties that give six axes a closed form; those with the quickest formulas first.
KINDS: tuple[tuple[Property, ...], ...] = (
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


@dataclass(frozen=True)
class NoClosedForm:
    """Why axes have no closed form: part of a sentence that states what was found."""

    reason: str


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """A model of an arm that has a closed form.

    Attributes:
        properties: Why it has one.
        off_m, off_rad: By how much the true axes miss them.
        directions, points: Shape (6, 3). Of the model's axes, in the base.
        tip: ``base_T_tip`` with all joints at zero.
    """

    properties: tuple[Property, ...]
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
    def misses(self) -> float:
        """By how much the arm misses the model, as a fraction of what is allowed; 0: it is exact."""
        return 0.0 if self.exact else max(self.off_m / NEAR_M, self.off_rad / NEAR_RAD)

    @property
    def why(self) -> str:
        """Why the arm has a closed form: part of a sentence."""
        words = " and ".join(str(each) for each in self.properties)
        near = "" if self.exact else f", to within {self.off_m * 1e3:.2g} mm and {math.degrees(self.off_rad):.2g} deg"
        return f"{words}{near}"

    def solver(self) -> Solver:
        """Return EAIK's solver for this model."""
        places = np.vstack([self.points, self.tip.position])
        offsets = np.diff(places, axis=0, prepend=np.zeros((1, 3)))
        return Solver(self.directions.T, offsets.T, self.tip.rotation, [], True)


def find_closed_form(chain: Chain, axes: Sequence[Axis]) -> ClosedForm | NoClosedForm:
    """Return the model that solves an arm in closed form.

    Returns:
        An exact model if there is one, otherwise the one that the arm is nearest to.
    """
    tip = chain.forward([0.0] * len(axes))
    found = []
    for order, kind in enumerate(KINDS):
        form = _model(kind, axes, tip)
        if form is not None:
            found.append((form.misses, order, form))
    found.sort(key=lambda each: each[:2])
    for misses, _, form in found:
        if misses <= 1.0 and _works(form, chain):
            return form
    return NoClosedForm(_what_is_missing([form for _, _, form in found]))


def _model(properties: tuple[Property, ...], axes: Sequence[Axis], tip: Pose) -> ClosedForm | None:
    """Return the model with given properties that is near the axes; None: axes that should meet are parallel."""
    directions, points = np.array([axis.direction for axis in axes]), np.array([axis.point for axis in axes])
    off_m = 0.0
    for each in properties:
        group = list(each.axes)
        if each.parallel:
            alike = directions[group] @ directions[group[0]]
            if np.abs(alike).min() < _ALIKE:
                return None
            mean = np.sign(alike) @ directions[group]
            directions[group] = np.sign(alike)[:, None] * (mean / np.linalg.norm(mean))
    for each in properties:
        group = list(each.axes)
        if not each.parallel:
            crossed = np.linalg.norm(np.cross(directions[group[:-1]], directions[group[1:]]), axis=1)
            if crossed.min() < _CROSSED:
                return None
            across = np.eye(3) - directions[group][:, :, None] * directions[group][:, None, :]
            place = np.linalg.solve(across.sum(axis=0), np.einsum("aij,aj->i", across, points[group]))
            off_m = max(off_m, *(float(np.linalg.norm(axes[axis].nearest(place) - place)) for axis in group))
            points[group] = place
    turned = np.linalg.norm(np.cross(directions, [axis.direction for axis in axes]), axis=1)
    return ClosedForm(properties, off_m, float(turned.max()), directions, points, tip)


def _works(form: ClosedForm, chain: Chain) -> bool:
    """Return whether EAIK solves a model, and whether the model is the chain as far as it should be."""
    robot = chain.robot
    allowed = _AGREES if form.exact else 10.0 * (form.off_m + form.off_rad)
    solver = form.solver()
    if not solver.has_known_decomposition():
        return False
    rng = np.random.default_rng(_TRIAL_SEED)
    for q in rng.uniform(robot.lower, robot.upper, (_TRIALS, len(robot.lower))):
        reached = solver.fwdkin(q)
        pose = chain.forward(q)
        gap = max(np.abs(reached[:3, 3] - pose.position).max(), np.abs(reached[:3, :3] - pose.rotation).max())
        found = np.asarray(solver.calculate_IK(reached).Q)
        if gap > allowed or not len(found):
            return False
        apart = np.abs(np.exp(1j * found) - np.exp(1j * q)).max(axis=1)
        if apart.min() > 1e-4:
            return False
    return True


def _what_is_missing(forms: Sequence[ClosedForm]) -> str:
    """Return by how much axes miss the kind that they are nearest to: part of a sentence."""
    if not forms:
        return "no two of its neighbouring axes meet"
    nearest = min(forms, key=lambda form: form.misses)
    words = " and ".join(str(each) for each in nearest.properties)
    return (
        f"no closed form is near: the nearest one needs that {words}, which they miss by {nearest.off_m * 1e3:.3g} mm and "
        f"{math.degrees(nearest.off_rad):.3g} deg (allowed: {NEAR_M * 1e3:g} mm and {math.degrees(NEAR_RAD):.1g} deg)"
    )
