"""Forward kinematics, Jacobian and joint axes of any URDF's serial chain, by KDL.

Poses are ``base_T_tip`` [m]; joint values [rad], or [m] for a prismatic joint, in the order of ``robot.joint_names``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import PyKDL
from urdf_parser_py.urdf import Joint

from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.urdf import chain_joints, parse_urdf


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of the tip in the base, ``base_T_tip``: position, shape (3,) [m], and rotation, shape (3, 3)."""

    position: np.ndarray
    rotation: np.ndarray

    def __post_init__(self):
        if not (isinstance(self.position, np.ndarray) and isinstance(self.rotation, np.ndarray)):
            object.__setattr__(self, "position", np.asarray(self.position, dtype=float))
            object.__setattr__(self, "rotation", np.asarray(self.rotation, dtype=float))
        if self.position.shape != (3,) or self.rotation.shape != (3, 3):
            raise ValueError(
                f"a pose is a position of shape (3,) and a rotation of shape (3, 3), found {self.position.shape} and "
                f"{self.rotation.shape}"
            )

    def matrix(self) -> np.ndarray:
        """Return the pose as a homogeneous matrix, shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.position
        return matrix


class Chain:
    """The serial chain from ``robot.base_link`` to ``robot.tip_link``; not for use from several threads at once.

    Attributes:
        kdl: For solvers of KDL.
        reach: Upper bound of the tip's distance from `shoulder` [m].
        arm_length: The same without strokes [m].
        shoulder: Shape (3,). The first revolute joint's origin in the base, with prismatic joints at zero [m].
    """

    def __init__(self, robot: RobotModel):
        self.robot = robot
        joints = chain_joints(parse_urdf(robot.urdf), robot.base_link, robot.tip_link)
        self.kdl = to_kdl(joints)
        self.shoulder, self.arm_length = _reach(joints)
        self.reach = self.arm_length + _strokes(robot)
        self._count = len(robot.joint_names)
        self._fk = PyKDL.ChainFkSolverPos_recursive(self.kdl)
        self._jacobian = PyKDL.ChainJntToJacSolver(self.kdl)
        self._q = PyKDL.JntArray(self._count)
        self._frame = PyKDL.Frame()
        self._columns = PyKDL.Jacobian(self._count)

    def forward(self, q: JointValues) -> Pose:
        """Return the tip's pose; the ranges are not checked."""
        return to_pose(self.frame(q))

    def frame(self, q: JointValues) -> PyKDL.Frame:
        """Return the tip's pose as KDL's frame, which the next call changes: for loops in which every microsecond counts."""
        self._fill(q)
        self._fk.JntToCart(self._q, self._frame)
        return self._frame

    def jacobian(self, q: JointValues) -> np.ndarray:
        """Return how the tip moves with each joint, shape (6, n): velocity, then angular velocity, in the base's directions."""
        self._fill(q)
        self._jacobian.JntToJac(self._q, self._columns)
        columns = self._columns
        return np.array([[columns[row, column] for column in range(self._count)] for row in range(6)])

    def skeleton(self, q: JointValues) -> np.ndarray:
        """Return the line from the base's origin through all link origins to the tip, shape (m, 3) [m], for drawing the arm."""
        return np.array([list(frame.p) for frame in self.frames(q)])

    def frames(self, q: JointValues) -> list[PyKDL.Frame]:
        """Return the frames of the base and of the links from it to the tip."""
        self._fill(q)
        frames = [PyKDL.Frame() for _ in range(self.kdl.getNrOfSegments() + 1)]
        for number, frame in enumerate(frames):
            self._fk.JntToCart(self._q, frame, number)
        return frames

    def _fill(self, q: JointValues) -> None:
        if len(q) != self._count:
            raise ValueError(f"{len(q)} joint values for {self._count} joints of {self.robot.name}")
        buffer = self._q
        for index, value in enumerate(q.tolist() if isinstance(q, np.ndarray) else q):
            buffer[index] = value


def to_kdl(joints: Sequence[Joint]) -> PyKDL.Chain:
    """Convert URDF joints to a KDL chain, a segment per joint, named after its child link: Debian has no kdl_parser_py."""
    chain = PyKDL.Chain()
    for joint in joints:
        parent_T_joint = _origin(joint)
        if joint.joint_type == "fixed":
            kdl_joint = PyKDL.Joint(joint.name, PyKDL.Joint.Fixed)
        else:
            # URDF gives the axis in the joint's frame and defaults to X, KDL wants it in the parent's
            axis = parent_T_joint.M * PyKDL.Vector(*(joint.axis or (1.0, 0.0, 0.0)))
            kind = PyKDL.Joint.TransAxis if joint.joint_type == "prismatic" else PyKDL.Joint.RotAxis
            kdl_joint = PyKDL.Joint(joint.name, parent_T_joint.p, axis, kind)
        chain.addSegment(PyKDL.Segment(joint.child, kdl_joint, parent_T_joint))
    return chain


def pendant_frame(values: Sequence[float]) -> PyKDL.Frame:
    """Return the frame of X, Y, Z [mm] and A, B, C [deg], as KUKA's pendant shows them."""
    turn = PyKDL.Rotation.EulerZYX(*map(math.radians, values[3:]))
    return PyKDL.Frame(turn, PyKDL.Vector(*values[:3]) / 1e3)


def to_frame(pose: Pose) -> PyKDL.Frame:
    """Convert a pose to KDL's frame."""
    rotation = PyKDL.Rotation(*pose.rotation.ravel().tolist())
    return PyKDL.Frame(rotation, PyKDL.Vector(*pose.position.tolist()))


def to_pose(frame: PyKDL.Frame) -> Pose:
    """Convert KDL's frame to a pose."""
    # written out, because each access is a call into KDL, and a loop or a view of the frame's parts would add calls
    f = frame
    rotation = [f[0, 0], f[0, 1], f[0, 2], f[1, 0], f[1, 1], f[1, 2], f[2, 0], f[2, 1], f[2, 2]]
    return Pose(np.array([f[0, 3], f[1, 3], f[2, 3]]), np.array(rotation).reshape(3, 3))


def _origin(joint: Joint) -> PyKDL.Frame:
    if joint.origin is None:
        return PyKDL.Frame()
    roll, pitch, yaw = joint.origin.rpy or (0.0, 0.0, 0.0)
    return PyKDL.Frame(PyKDL.Rotation.RPY(roll, pitch, yaw), PyKDL.Vector(*(joint.origin.xyz or (0.0, 0.0, 0.0))))


def _strokes(robot: RobotModel) -> float:
    ends = zip(robot.linear, robot.lower, robot.upper)
    return sum(max(abs(lower), abs(upper)) for linear, lower, upper in ends if linear)


def _reach(joints: Sequence[Joint]) -> tuple[np.ndarray, float]:
    """Return the first revolute joint's origin and the summed length of the links behind it."""
    fixed = PyKDL.Frame()
    lengths = []
    shoulder = None
    for joint in joints:
        fixed = fixed * _origin(joint)
        if joint.joint_type == "revolute":
            # everything between two movable joints is one rigid link, even if fixed joints divide it
            if shoulder is None:
                shoulder = np.array(list(fixed.p))
            else:
                lengths.append(fixed.p.Norm())
            fixed = PyKDL.Frame()
    return shoulder if shoulder is not None else np.array(list(fixed.p)), sum(lengths) + fixed.p.Norm()


#: Directions whose cross product is shorter are parallel [rad]; lines that miss each other by less meet [m].
AXIS_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Axis:
    """A joint's axis: any point on it, of a prismatic joint its frame's origin, and its direction of turning or travel."""

    point: np.ndarray
    direction: np.ndarray

    def nearest(self, point: np.ndarray) -> np.ndarray:
        """Return the point on the axis that is nearest to `point`, shape (3,) [m]."""
        return self.point + self.direction * ((point - self.point) @ self.direction)


def joint_axes(chain: Chain) -> list[Axis]:
    """Return the axes of the movable joints with all joints at zero, in the order of the chain."""
    axes = []
    base_T_parent = PyKDL.Frame()
    for number in range(chain.kdl.getNrOfSegments()):
        segment = chain.kdl.getSegment(number)
        joint = segment.getJoint()
        if joint.getType() != PyKDL.Joint.Fixed:
            point, direction = base_T_parent * joint.JointOrigin(), base_T_parent.M * joint.JointAxis()
            axes.append(Axis(np.array(list(point)), np.array(list(direction))))
        base_T_parent = base_T_parent * segment.pose(0.0)
    return axes


def intersection(first: Axis, second: Axis) -> np.ndarray | None:
    """Return where two axes meet, shape (3,) [m]; None: they do not, or are parallel."""
    normal = np.cross(first.direction, second.direction)
    if np.linalg.norm(normal) < AXIS_TOLERANCE:
        return None
    # the point on the first line that is nearest to the second one
    along = np.cross(second.point - first.point, second.direction) @ normal / (normal @ normal)
    point = first.point + along * first.direction
    return point if np.linalg.norm(second.nearest(point) - point) < AXIS_TOLERANCE else None
