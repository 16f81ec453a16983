"""What every inverse kinematics takes and gives: settings, named configurations, solutions, and the common interface."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NoReturn

import numpy as np

from construction_twin.core.sentences import Quantity, Sentence, join_sentences
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.motion_errors import JointRangeError, KinematicsError


class UnreachableError(KinematicsError):
    """The target is outside of what the arm reaches, whatever its ranges: it has to move by `missing`, at least [m]."""

    def __init__(self, missing: float, too_close: bool = False):
        self.missing, self.too_close = missing, too_close
        mm = missing * 1e3
        super().__init__(
            Sentence("the target is too close to the arm by {mm:g} mm; move it away from the base", mm=mm)
            if too_close
            else Sentence("the target is out of the arm's reach by {mm:g} mm; move it closer to the base", mm=mm)
        )


class PoseRangeError(JointRangeError):
    """The target could be reached, but only with a joint outside its range: of the solution that is out of range by least."""


class PositionRangeError(PoseRangeError):
    """The wrist cannot get where the target needs it within the joint ranges."""

    def _sentence(self, **values: str | Quantity) -> Sentence:
        return Sentence(
            "the target's position needs {joint} at {value}, outside its range {lower} to {upper}; move the target",
            **values,
        )


class OrientationError(PoseRangeError):
    """The target's position can be reached, but not with its orientation within the joint ranges."""

    def _sentence(self, **values: str | Quantity) -> Sentence:
        return Sentence(
            "the target's orientation needs {joint} at {value}, outside its range {lower} to {upper}; turn the target",
            **values,
        )


class BranchError(KinematicsError):
    """A configuration of the arm (shoulder, elbow, wrist) is unknown, or does not exist for this arm or target."""

    def __init__(self, asked: str, available: tuple[str, ...], problem: str):
        self.available = available
        choose = f"choose one of: {', '.join(available)}" if available else "leave the choice open"
        super().__init__(f"configuration {asked!r} {problem}; {choose}")


class UnreachableOrientationError(KinematicsError):
    """The target's position can be reached, but not with its orientation, whatever the joint ranges."""

    def __init__(self) -> None:
        super().__init__(
            Sentence("the target's position can be reached, but not with its orientation: turn the target")
        )


class NotFoundError(KinematicsError):
    """No joint solution was found in time, though one may exist; residuals of the best attempt in range, inf: none."""

    def __init__(self, tried: int, budget_s: float, residual_m: float, residual_rad: float, hint: str = ""):
        self.tried, self.budget_s, self.hint = tried, budget_s, hint
        self.residual_m, self.residual_rad = residual_m, residual_rad
        away, turned, best = Quantity(residual_m, "m"), Quantity(residual_rad, "rad"), ""
        if residual_m < 1e3:
            best = Sentence("the best attempt was {away:.3} and {turned:.4} away", away=away, turned=turned)
        super().__init__(
            Sentence(
                "no joint solution was found in the time given ({budget:.3g} s, {tried} starts); it may still be reachable: {seen}",
                budget=budget_s,
                tried=tried,
                seen=join_sentences(best, hint, Sentence("allow more time or turn the target")),
            )
        )


#: One turn [rad].
TURN = 2.0 * math.pi
#: How far a target's rotation matrix may be from orthonormal; more would not pass as a residual anyway.
_ORTHONORMAL = 5e-7
#: Solutions nearer to each other than this are one [rad].
_SAME = 1e-5
#: Solutions along a self-motion are spaced by this, at least [rad].
_APART = 0.35
#: What almost is a solution misses the pose by less [m], [rad].
_REFINABLE = 1e-3
_WORDS = {
    "front": "shoulder",
    "back": "shoulder",
    "up": "elbow",
    "down": "elbow",
    "positive": "wrist",
    "negative": "wrist",
}


@dataclass(frozen=True)
class Configuration:
    """One of the up to eight configurations with which an arm with a spherical wrist reaches a pose; None: either.

    Attributes:
        shoulder: ``front``: the wrist centre is on axis 2's side of axis 1 (where both meet, on that of the upper arm's plane);
            ``back``: the arm reaches over its own shoulder.
        elbow: ``up`` or ``down``: above or below the line from axis 2 to the wrist centre, seen with that in front.
        wrist: ``positive`` or ``negative``: sign of joint 5, from where axes 4 and 6 are in line.
    """

    shoulder: str | None = None
    elbow: str | None = None
    wrist: str | None = None

    @classmethod
    def parse(cls, text: str) -> Configuration:
        """Read a configuration from words such as ``front up positive``, in any order; a choice that no word names stays open."""
        chosen = {}
        for word in text.split():
            if word not in _WORDS:
                raise BranchError(text, tuple(_WORDS), f"has the unknown word {word!r}")
            if _WORDS[word] in chosen:
                raise BranchError(text, tuple(_WORDS), f"chooses the {_WORDS[word]} twice")
            chosen[_WORDS[word]] = word
        return cls(**chosen)

    def matches(self, wanted: Configuration) -> bool:
        """Return whether this configuration agrees with every choice that `wanted` makes."""
        mine = (self.shoulder, self.elbow, self.wrist)
        return all(want in (None, have) for want, have in zip((wanted.shoulder, wanted.elbow, wanted.wrist), mine))

    def __str__(self) -> str:
        return " ".join(word for word in (self.shoulder, self.elbow, self.wrist) if word) or "any"


@dataclass(frozen=True)
class IkSettings:
    """How inverse kinematics searches; of arms with a closed form only the tolerances apply.

    Attributes:
        seeds: Most starting points: the given seed, home, then random ones.
        budget_s: Time for one target [s]; the first starting point is always tried.
        patience: `nearest` ends after this many solved starting points that brought nothing nearer.
    """

    seeds: int = 400
    iterations: int = 100
    tolerance_m: float = 1e-6
    tolerance_rad: float = 1e-6
    budget_s: float = 0.04
    patience: int = 30


@dataclass(frozen=True, eq=False)
class IkSolution:
    """Joint values within the ranges, confirmed by KDL's forward kinematics; `distance` from the seed over all joints [rad, m]."""

    q: np.ndarray
    residual_m: float
    residual_rad: float
    distance: float
    configuration: Configuration | None


@dataclass(frozen=True)
class ArmKind:
    """How an arm is solved: ``OPW``, ``closed form``, ``OPW on a linear axis`` or ``search``, and why, as part of a sentence."""

    name: str
    why: str


class Ranges:
    """The ranges of n joints, and whole turns, 0 for a prismatic joint: a turn further a joint reaches the same pose."""

    def __init__(self, robot: RobotModel):
        self.lower, self.upper = np.array(robot.lower), np.array(robot.upper)
        self.turns = np.where(robot.linear, 0.0, TURN)
        # plain floats, which a loop over the joints takes
        self._each = list(zip(robot.lower, robot.upper, self.turns.tolist()))

    def into_range(self, q: np.ndarray, seed: np.ndarray, slack: float) -> np.ndarray:
        """Return joint values, shape (..., n), with the turns nearest to a seed, of those in range, to `slack`, if any are."""
        q = q - self.turns * np.rint((q - seed) * (1.0 / TURN))
        q = np.where((q > self.upper + slack) & (q - self.turns >= self.lower - slack), q - self.turns, q)
        return np.where((q < self.lower - slack) & (q + self.turns <= self.upper + slack), q + self.turns, q)

    def excesses(self, q: np.ndarray) -> np.ndarray:
        """Return by how much each joint is out of range, shape (..., n); 0 or less: it is in range."""
        return np.maximum(self.lower - q, q - self.upper)

    def turned(self, q: Sequence[float], slack: float, fixed: Sequence[int] = ()) -> Iterator[tuple[float, ...]]:
        """Return joint values with every choice of whole turns within the ranges, but of joints `fixed` as they are."""
        choices: list[list[float]] = []
        for joint, (value, (lower, upper, turn)) in enumerate(zip(q, self._each)):
            if joint in fixed or not turn:
                choices.append([value])
                continue
            first, last = math.ceil((lower - slack - value) / turn), math.floor((upper + slack - value) / turn)
            choices.append([value + turn * number for number in range(first, last + 1)])
        return product(*choices)


class InverseKinematics(abc.ABC):
    """From a pose of the tip to joint values. `inverse.inverse_kinematics` makes the one that fits the arm."""

    def __init__(self, chain: Chain, settings: IkSettings):
        self.chain = chain
        self.settings = settings
        self.ranges = Ranges(chain.robot)
        self._exact = min(settings.tolerance_m, settings.tolerance_rad)
        self._ends = list(zip(chain.robot.lower, chain.robot.upper))

    @property
    @abc.abstractmethod
    def kind(self) -> ArmKind:
        """How the arm is solved, and why so."""

    @abc.abstractmethod
    def nearest(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> IkSolution:
        """Return the solution nearest to a seed within the ranges, normally the arm's pose; KinematicsError: why there is none.

        Distances are Euclidean over all joints, whole turns included. With a linear axis it is the nearest as far as joints move
        smoothly between the positions of its division, by search the nearest found: `all` may find a nearer one.
        """

    @abc.abstractmethod
    def all(self, pose: Pose, seed: JointValues, configuration: Configuration | None = None) -> list[IkSolution]:
        """Return every solution within the ranges, whole turns of each joint included, nearest first.

        Where a pose leaves joints free, each continuous family is represented by the one nearest to the seed for every choice of
        turns; for an arm with more than six joints also by some spaced along it.
        """

    def configuration(self, q: JointValues) -> Configuration | None:
        """Return in which configuration joint values are [rad]; None: the arm has no named configurations."""
        return None

    def raise_configuration_error(self, configuration: Configuration, pose: Pose, seed: JointValues) -> NoReturn:
        """Raise the error that names the configurations that reach a pose, or the reason if none does."""
        others = {str(solution.configuration) for solution in self.all(pose, seed)}
        raise BranchError(str(configuration), tuple(sorted(others)), "does not exist for this pose within the ranges")

    def is_solved(self, error_m: float, error_rad: float) -> bool:
        """Return whether a residual is within the tolerances."""
        return error_m <= self.settings.tolerance_m and error_rad <= self.settings.tolerance_rad

    def confirmed(
        self, q: JointValues, pose: Pose, seed: JointValues, configuration: Configuration | None = None
    ) -> IkSolution | None:
        """Return joint values as a solution, after Newton steps where they almost reach the pose; None: they do not reach it."""
        # plain floats: in closed form the nearest branch takes as long as this
        q = [
            lower if value < lower else upper if value > upper else value
            for value, (lower, upper) in zip(q, self._ends)
        ]
        error = residual(self.chain, q, pose)
        if max(error) > self._exact:
            if not max(error) < _REFINABLE:
                return None
            q = refine(self.chain, np.array(q), pose).tolist()
            error = residual(self.chain, q, pose)
            if not self.is_solved(*error):
                return None
        return IkSolution(np.array(q), *error, math.dist(q, seed), configuration)

    def turned(
        self,
        q: np.ndarray,
        pose: Pose,
        seed: JointValues,
        configuration: Configuration | None = None,
        fixed: Sequence[int] = (),
    ) -> list[IkSolution]:
        """Return joint values with every choice of whole turns but of the joints `fixed`, where forward kinematics confirms it."""
        if not np.isfinite(q).all():
            return []
        every = self.ranges.turned(q.tolist(), self.settings.tolerance_rad, fixed)
        found = (self.confirmed(each, pose, seed, configuration) for each in every)
        return [solution for solution in found if solution is not None]


def check_pose(pose: Pose) -> None:
    """Check that a target is a position and a rotation."""
    position, rotation = np.asarray(pose.position), np.asarray(pose.rotation)
    if _is_rigid(rotation.tolist()) and all(map(math.isfinite, position.tolist())):
        return
    if not (np.isfinite(position).all() and np.isfinite(rotation).all()):
        found = f"position {position.tolist()}, rotation {rotation.tolist()}"
        raise KinematicsError(f"pose is {found}; expected finite numbers")
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > _ORTHONORMAL or np.linalg.det(rotation) < 0.0:
        found = f"rotation {rotation.tolist()} is {error:.3g} off a rotation"
        raise KinematicsError(f"the pose's {found}; expected orthonormal, right-handed axes")


def _is_rigid(rows: list[list[float]]) -> bool:
    """Return whether a matrix is a rotation within `_ORTHONORMAL`; nan: it is not. In plain floats, quicker for nine numbers."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    errors = (
        a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0,
        a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i,
    )  # fmt: skip
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return all(abs(error) <= _ORTHONORMAL for error in errors) and determinant > 0.0


def residual(chain: Chain, q: JointValues, pose: Pose) -> tuple[float, float]:
    """Return how far KDL's forward kinematics of joint values is from a pose: [m], [rad]."""
    f = chain.frame(q)
    x, y, z = pose.position.tolist()
    (xx, yx, zx), (xy, yy, zy), (xz, yz, zz) = pose.rotation.tolist()
    # The chord between two rotations is exact even for tiny angles. Plain floats take half the time of arrays of this size, a
    # quaternion less than nine calls into KDL, and every solution passes through here.
    i, j, k, w = f.M.GetQuaternion()
    chord = math.sqrt(
        (1.0 - 2.0 * (j * j + k * k) - xx) ** 2 + (2.0 * (i * j - k * w) - yx) ** 2 + (2.0 * (i * k + j * w) - zx) ** 2
        + (2.0 * (i * j + k * w) - xy) ** 2 + (1.0 - 2.0 * (i * i + k * k) - yy) ** 2 + (2.0 * (j * k - i * w) - zy) ** 2
        + (2.0 * (i * k - j * w) - xz) ** 2 + (2.0 * (j * k + i * w) - yz) ** 2 + (1.0 - 2.0 * (i * i + j * j) - zz) ** 2
    )  # fmt: skip
    error_m = math.hypot(f[0, 3] - x, f[1, 3] - y, f[2, 3] - z)
    return error_m, 2.0 * math.asin(min(1.0, chord / math.sqrt(8.0)))


def distinct(solutions: Sequence[IkSolution], same: float = _SAME) -> list[IkSolution]:
    """Return solutions without those that are nearer than `same` to an earlier one [rad], in their order."""
    unique: list[IkSolution] = []
    for solution in solutions:
        if all(math.dist(solution.q, other.q) > same for other in unique):
            unique.append(solution)
    return unique


def spaced(
    q: np.ndarray, existing: Sequence[IkSolution], most: int, confirm: Callable[[int], IkSolution | None]
) -> Iterator[IkSolution]:
    """Yield solutions along the self-motions of a pose, each apart from all others, and from those `existing`, by `_APART`.

    `q`, shape (m, n), samples the self-motions, those first which are wanted most; `confirm` makes a solution of a sample's number.
    """
    apart = np.full(len(q), math.inf)
    for solution in existing:
        np.minimum(apart, np.linalg.norm(q - solution.q, axis=1), out=apart)
    while most > 0 and (apart > _APART).any():
        number = int((apart > _APART).argmax())
        apart[number] = 0.0
        found = confirm(number)
        if found is not None:
            most -= 1
            np.minimum(apart, np.linalg.norm(q - found.q, axis=1), out=apart)
            yield found


def refuse_configuration(configuration: Configuration | None) -> None:
    """Refuse a configuration that makes a choice, for arms that have no named ones."""
    if configuration is not None and configuration != Configuration():
        raise BranchError(str(configuration), (), "has no meaning for an arm without a spherical wrist of the OPW kind")


def refine(chain: Chain, q: np.ndarray, pose: Pose, steps: int = 8) -> np.ndarray:
    """Return joint values, shape (n,), moved by Newton steps within the ranges towards a pose; the caller checks the result."""
    lower, upper = np.array(chain.robot.lower), np.array(chain.robot.upper)
    q = np.clip(q, lower, upper)
    for _ in range(steps):
        error = pose_error(chain.forward(q), pose)
        if np.abs(error).max() < 1e-12:
            break
        # rcond: near a singularity, directions in which the tip hardly moves would need huge steps, and are left out
        jacobian = chain.jacobian(q)
        step = np.linalg.lstsq(jacobian, error, rcond=1e-9)[0]
        # joints that would leave their range stand still, if enough others are left
        stuck = ((q <= lower) & (step < 0.0)) | ((q >= upper) & (step > 0.0))
        if stuck.any() and len(q) - stuck.sum() >= 6:
            step = np.linalg.lstsq(jacobian * ~stuck, error, rcond=1e-9)[0]
        q = np.clip(q + step, lower, upper)
    return q


def pose_error(reached: Pose, target: Pose) -> np.ndarray:
    """Return the twist from one pose to another near it, shape (6,): translation, then rotation vector, to second order."""
    # the sum of the cross products of the axes of both; written out, because numpy's takes ten times as long for single vectors
    turn = target.rotation @ reached.rotation.T
    x, y, z = (target.position - reached.position).tolist()
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = turn.tolist()
    return np.array([x, y, z, 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)])
