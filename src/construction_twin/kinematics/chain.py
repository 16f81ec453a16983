"""Forward and inverse kinematics of any URDF's serial chain, by KDL.

Poses are ``base_T_tip``: the tip link's pose in the robot's base link [m], joint angles [rad] in the order of
``robot.joint_names``. Knows no tool or workpiece frame beyond the chain, and checks no collisions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import PyKDL
from urdf_parser_py.urdf import Joint

from construction_twin.errors import KinematicsError, NoSolutionError, UnreachableError
from construction_twin.frames import rotation_angle
from construction_twin.robot import RobotModel, chain_joints, parse_urdf

_TURN = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of the tip in the base, ``base_T_tip``.

    Attributes
    ----------
    position : array, shape (3,)
        [m]
    rotation : array, shape (3, 3)
    """

    position: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True)
class IkSettings:
    """How `Chain.inverse` searches.

    Attributes
    ----------
    seeds : int
        Most starting points tried: the given seed, home, then random ones.
    solutions : int
        Enough solutions to choose the nearest from; the search ends there.
    iterations : int
        Most steps of the solver from one starting point.
    tolerance_m, tolerance_rad : float
        What a solution's own forward kinematics may miss the target by.
    """

    seeds: int = 60
    solutions: int = 4
    iterations: int = 200
    tolerance_m: float = 1e-6
    tolerance_rad: float = 1e-6


@dataclass(frozen=True, eq=False)
class IkSolution:
    """A verified solution within the ranges.

    Attributes
    ----------
    q : array, shape (n,)
        [rad]
    residual_m, residual_rad : float
        Distance of its forward kinematics from the target.
    seeds : int
        Number of starting points tried.
    """

    q: np.ndarray
    residual_m: float
    residual_rad: float
    seeds: int


class Chain:
    """The serial chain from ``robot.base_link`` to ``robot.tip_link``. Not for use from several threads at once.

    Parameters
    ----------
    robot : RobotModel
    settings : IkSettings, optional

    Attributes
    ----------
    reach : float
        Upper bound of the tip's distance from `shoulder` [m]: all link lengths in one line.
    shoulder : array, shape (3,)
        The first joint's origin in the base [m].
    """

    def __init__(self, robot: RobotModel, settings: IkSettings = IkSettings()):
        self.robot = robot
        self._settings = settings
        joints = chain_joints(parse_urdf(robot.urdf), robot.base_link, robot.tip_link)
        self._kdl = to_kdl(joints)
        self._lower = np.array(robot.lower)
        self._upper = np.array(robot.upper)
        self._fk = PyKDL.ChainFkSolverPos_recursive(self._kdl)
        # The solver's own precision is far below the tolerance, so that what it calls solved also passes the check.
        self._ik = PyKDL.ChainIkSolverPos_LMA(self._kdl, 1e-10, settings.iterations, 1e-14)
        self.shoulder, self.reach = _reach(joints)

    def forward(self, q: Sequence[float]) -> Pose:
        """Return the tip's pose.

        Parameters
        ----------
        q : sequence of float, length n
            Joint angles [rad]; not checked against the ranges.

        Returns
        -------
        base_T_tip : Pose

        Raises
        ------
        ValueError
            If `q` has another length.
        """
        return _pose(self._frame(q, -1))

    def skeleton(self, q: Sequence[float]) -> np.ndarray:
        """Return the line from the base through all link origins to the tip, for drawing the arm.

        Parameters
        ----------
        q : sequence of float, length n
            [rad]

        Returns
        -------
        points : array, shape (m, 3)
            In the base [m], the base's origin first.
        """
        frames = (self._frame(q, number) for number in range(self._kdl.getNrOfSegments() + 1))
        return np.array([list(frame.p) for frame in frames])

    def inverse(
        self, pose: Pose, seed: Sequence[float], rng: np.random.Generator, budget_s: float, clock: Callable[[], float]
    ) -> IkSolution:
        """Find joint angles for a pose, near a seed.

        Starts the solver from the seed, the home pose and random poses until enough solutions are found or the
        budget is spent, and returns the one nearest to the seed (by its largest joint difference). The seed itself is
        always tried.

        Parameters
        ----------
        pose : Pose
            Target ``base_T_tip``.
        seed : sequence of float, length n
            [rad], within the ranges.
        rng : numpy Generator
            Source of the random starting points.
        budget_s : float
            Time budget [s] on `clock`.
        clock : callable
            Returns the present time [s], e.g. ``time.monotonic``.

        Returns
        -------
        solution : IkSolution

        Raises
        ------
        JointRangeError
            If the seed is out of range, or the pose was solved but only by joint angles out of range.
        UnreachableError
            If the pose is further from the shoulder than the arm is long.
        NoSolutionError
            If no starting point led to a solution.
        KinematicsError
            If the pose is not finite.
        """
        self.robot.check_range(seed)
        self._check_reach(pose)
        return _Search(self, pose, np.array(seed, dtype=float)).run(self._seeds(seed, rng), clock() + budget_s, clock)

    def _check_reach(self, pose: Pose) -> None:
        if not (np.isfinite(pose.position).all() and np.isfinite(pose.rotation).all()):
            found = np.asarray(pose.position).tolist(), np.asarray(pose.rotation).tolist()
            raise KinematicsError(f"pose is position {found[0]}, rotation {found[1]}; expected finite numbers")
        distance = float(np.linalg.norm(pose.position - self.shoulder))
        if distance > self.reach:
            raise UnreachableError(distance, self.reach)

    def _seeds(self, seed: Sequence[float], rng: np.random.Generator) -> Iterator[np.ndarray]:
        yield np.array(seed, dtype=float)
        yield np.array(self.robot.home)
        for _ in range(self._settings.seeds - 2):
            yield rng.uniform(self._lower, self._upper)

    def _frame(self, q: Sequence[float], segments: int) -> PyKDL.Frame:
        if len(q) != len(self._lower):
            raise ValueError(f"{len(q)} joint values for {len(self._lower)} joints of {self.robot.name}")
        frame = PyKDL.Frame()
        self._fk.JntToCart(_to_array(q), frame, segments)
        return frame


class _Search:
    """One `Chain.inverse`: what has been found so far for one target."""

    def __init__(self, chain: Chain, pose: Pose, near: np.ndarray):
        self._chain = chain
        self._settings = chain._settings
        self._pose = pose
        self._near = near
        self._target = _to_frame(pose)
        self._solved: list[IkSolution] = []
        self._outside: list[np.ndarray] = []
        self._residual = (math.inf, math.inf)

    def run(self, seeds: Iterator[np.ndarray], deadline: float, clock: Callable[[], float]) -> IkSolution:
        tried = 0
        for seed in seeds:
            if tried and clock() >= deadline:
                break
            tried += 1
            self._try(seed, tried)
            if len(self._solved) >= self._settings.solutions:
                break
        if self._solved:
            best = min(self._solved, key=lambda solution: np.abs(solution.q - self._near).max())
            return IkSolution(best.q, best.residual_m, best.residual_rad, tried)
        if self._outside:
            self._chain.robot.check_range(min(self._outside, key=self._excess))
        raise NoSolutionError(tried, *self._residual)

    def _try(self, seed: np.ndarray, number: int) -> None:
        found = PyKDL.JntArray(len(seed))
        self._chain._ik.CartToJnt(_to_array(seed), self._target, found)
        q = self._into_range(np.array([found[i] for i in range(len(seed))]))
        # The solver's verdict is not asked: forward kinematics says whether this is the pose.
        reached = self._chain.forward(q)
        residual_m = float(np.linalg.norm(reached.position - self._pose.position))
        residual_rad = rotation_angle(reached.rotation, self._pose.rotation)
        if not (residual_m <= self._settings.tolerance_m and residual_rad <= self._settings.tolerance_rad):
            # on an arm of metres a radian is about a metre
            self._residual = min(self._residual, (residual_m, residual_rad), key=lambda residual: math.hypot(*residual))
        elif self._excess(q) > 0.0:
            self._outside.append(q)
        else:
            self._solved.append(IkSolution(q, residual_m, residual_rad, number))

    def _into_range(self, q: np.ndarray) -> np.ndarray:
        """Return the same pose with each joint turned by whole turns into its range, as near to the seed as possible."""
        lower, upper = self._chain._lower, self._chain._upper
        slack = self._settings.tolerance_rad
        nearest = q + _TURN * np.round((self._near - q) / _TURN)
        # whole turns that bring a joint down below its upper end, then up above its lower end where that went too far
        nearest = nearest - _TURN * np.ceil(np.maximum(nearest - upper - slack, 0.0) / _TURN)
        turned = nearest + _TURN * np.ceil(np.maximum(lower - slack - nearest, 0.0) / _TURN)
        # a target on the very edge of a range comes back a rounding error outside it
        edge = np.clip(turned, lower, upper)
        return np.where(np.abs(edge - turned) <= slack, edge, turned)

    def _excess(self, q: np.ndarray) -> float:
        return float(np.maximum(self._chain._lower - q, q - self._chain._upper).max())


def to_kdl(joints: Sequence[Joint]) -> PyKDL.Chain:
    """Convert URDF joints to a KDL chain (kdl_parser_py, which would do it, is not in Debian).

    Parameters
    ----------
    joints : sequence of Joint
        From base to tip, revolute or fixed.

    Returns
    -------
    chain : PyKDL.Chain
        One segment per joint, named after its child link.
    """
    chain = PyKDL.Chain()
    for joint in joints:
        parent_T_joint = _origin(joint)
        if joint.joint_type == "fixed":
            kdl_joint = PyKDL.Joint(joint.name, PyKDL.Joint.Fixed)
        else:
            # URDF gives the axis in the joint's frame and defaults to X, KDL wants it in the parent's
            axis = PyKDL.Vector(*(joint.axis or (1.0, 0.0, 0.0)))
            kdl_joint = PyKDL.Joint(joint.name, parent_T_joint.p, parent_T_joint.M * axis, PyKDL.Joint.RotAxis)
        chain.addSegment(PyKDL.Segment(joint.child, kdl_joint, parent_T_joint))
    return chain


def _origin(joint: Joint) -> PyKDL.Frame:
    if joint.origin is None:
        return PyKDL.Frame()
    roll, pitch, yaw = joint.origin.rpy or (0.0, 0.0, 0.0)
    return PyKDL.Frame(PyKDL.Rotation.RPY(roll, pitch, yaw), PyKDL.Vector(*(joint.origin.xyz or (0.0, 0.0, 0.0))))


def _reach(joints: Sequence[Joint]) -> tuple[np.ndarray, float]:
    """Return the first joint's origin and the length of everything behind it, stretched out."""
    fixed = PyKDL.Frame()
    lengths = []
    shoulder = None
    for joint in joints:
        fixed = fixed * _origin(joint)
        if joint.joint_type != "fixed":
            # what lies between two joints is one rigid link, however many fixed joints it is made of
            if shoulder is None:
                shoulder = np.array(list(fixed.p))
            else:
                lengths.append(fixed.p.Norm())
            fixed = PyKDL.Frame()
    return shoulder, sum(lengths) + fixed.p.Norm()


def _to_array(q: Sequence[float]) -> PyKDL.JntArray:
    array = PyKDL.JntArray(len(q))
    for index, value in enumerate(q):
        array[index] = float(value)
    return array


def _to_frame(pose: Pose) -> PyKDL.Frame:
    rotation = PyKDL.Rotation(*(float(value) for value in np.asarray(pose.rotation).ravel()))
    return PyKDL.Frame(rotation, PyKDL.Vector(*(float(value) for value in pose.position)))


def _pose(frame: PyKDL.Frame) -> Pose:
    rotation = np.array([[frame.M[row, column] for column in range(3)] for row in range(3)])
    return Pose(np.array(list(frame.p)), rotation)
