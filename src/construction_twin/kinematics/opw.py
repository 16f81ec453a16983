"""Whether a chain is of the OPW kind (ortho-parallel basis, spherical wrist), and with which parameters.

Found from the joint axes as lines in space. Parameters are those of Brandstoetter, Angerer, Hofbaur, "An Analytical Solution of the
Inverse Kinematics Problem of Industrial Serial Manipulators with an Ortho-parallel Basis and a Spherical Wrist" (2014).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from construction_twin.kinematics.chain import AXIS_TOLERANCE, Axis, Chain, Pose, intersection, joint_axes, to_pose

if TYPE_CHECKING:
    import py_opw_kinematics

#: Poses on which the parameters are checked against KDL.
_CHECKS = 50
_CHECK_SEED = 2014


class Margins(NamedTuple):
    """How far a wrist centre is inside a shoulder's reach, where the arm is stretched and where it is folded [m]; < 0: outside."""

    outer: float
    inner: float


@dataclass(frozen=True, eq=False)
class OpwModel:
    """A chain in OPW parameters: ``base_T_tip = base_T_opw * opw_T_flange(theta) * flange_T_tip``, theta = signs q - offsets.

    The OPW base is on axis 1 level with the base link's origin, Z towards axis 2; the flange on axis 6 level with the tip.
    """

    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float
    offsets: tuple[float, float, float, float, float, float]
    signs: tuple[int, ...]
    base_T_opw: np.ndarray
    flange_T_tip: np.ndarray

    def solver(self) -> py_opw_kinematics.Robot:
        """Return the package's solver for these parameters, in radians."""
        import py_opw_kinematics  # with scipy.spatial: a start checks the nodes' settings without either

        lengths = {name: getattr(self, name) for name in ("a1", "a2", "b", "c1", "c2", "c3", "c4")}
        a1, a2, a3, a4, a5, a6 = (sign < 0 for sign in self.signs)
        model = py_opw_kinematics.KinematicModel(**lengths, offsets=self.offsets, flip_axes=(a1, a2, a3, a4, a5, a6))
        return py_opw_kinematics.Robot(model, degrees=False)

    def wrist_centre(self, flange: np.ndarray) -> tuple[float, float, float]:
        """Return the wrist centre of a target ``opw_T_flange``, shape (4, 4), in the OPW base [m]."""
        (_, _, gx, x), (_, _, gy, y), (_, _, gz, z), _ = flange.tolist()
        c4 = self.c4
        return x - c4 * gx, y - c4 * gy, z - c4 * gz

    def margins(self, x: float, y: float, z: float) -> list[Margins]:
        """Return the distances of a wrist centre to the edges of the reach, for each shoulder, front and back."""
        square = x * x + y * y - self.b**2
        if square < 0.0:
            return [Margins(math.inf, -math.inf)] * 2
        forearm = math.hypot(self.a2, self.c3)
        distances = (math.hypot(math.sqrt(square) - side * self.a1, z - self.c1) for side in (1, -1))
        return [Margins(self.c2 + forearm - distance, distance - abs(self.c2 - forearm)) for distance in distances]

    def outwards(self, x: float, y: float, z: float) -> list[np.ndarray]:
        """Return for each shoulder, front and back, the unit vector from axis 2 to a wrist centre off axis 1, shape (3,)."""
        across = math.sqrt(x * x + y * y - self.b**2)
        directions = (
            np.array([x * (1.0 - side * self.a1 / across), y * (1.0 - side * self.a1 / across), z - self.c1])
            for side in (1, -1)
        )
        return [direction / np.linalg.norm(direction) for direction in directions]


def find_opw(chain: Chain) -> OpwModel | str:
    """Return the model of a chain of the OPW kind, or why it is not one: part of a sentence."""
    if any(chain.robot.linear) or len(chain.robot.linear) != 6:
        revolute = chain.robot.linear.count(False)
        return f"it has {revolute} revolute and {len(chain.robot.linear) - revolute} prismatic joints, not six revolute ones"
    axes = joint_axes(chain)
    wrist = intersection(axes[3], axes[4])
    reason = _difference(axes, wrist)
    if reason or wrist is None:
        return reason
    model = _measure(axes, wrist, chain)
    gap = _largest_gap(model, chain)
    if gap > AXIS_TOLERANCE:
        return f"its forward kinematics differs from the OPW model's by {gap:.3g}"
    return model


def _difference(axes: list[Axis], wrist: np.ndarray | None) -> str:
    """Return the first property in which an arm differs from the OPW kind, or "" if there is none."""
    d = [axis.direction for axis in axes]
    if wrist is None:
        return "its axes 4 and 5 do not meet in one point"
    miss = float(np.linalg.norm(axes[5].nearest(wrist) - wrist))
    if miss > AXIS_TOLERANCE:
        return f"axis 6 passes {miss:.3g} m beside the point where axes 4 and 5 meet, so its wrist is not spherical"
    tilt = float(np.linalg.norm(np.cross(d[1], d[2])))
    if tilt > AXIS_TOLERANCE:
        return f"its axes 2 and 3 are {math.asin(min(1.0, tilt)):.3g} rad from parallel"
    for first, second in ((0, 1), (2, 3), (3, 4), (4, 5)):
        off = abs(float(d[first] @ d[second]))
        if off > AXIS_TOLERANCE:
            return f"its axes {first + 1} and {second + 1} are {math.asin(min(1.0, off)):.3g} rad from perpendicular"
    between = axes[2].point - axes[1].nearest(axes[2].point)
    if np.linalg.norm(between) < AXIS_TOLERANCE:
        return "its axes 2 and 3 are the same line"
    return ""


def _measure(axes: list[Axis], wrist: np.ndarray, chain: Chain) -> OpwModel:
    """Return the model with the lengths, signs and offsets of the axes at zero pose. x, y, z are the OPW base's directions."""
    d = [axis.direction for axis in axes]
    tip = to_pose(chain.frame([0.0] * 6))
    origin = axes[0].nearest(np.zeros(3))
    rise = (axes[1].nearest(origin) - origin) @ d[0]
    z = d[0] if rise >= -AXIS_TOLERANCE else -d[0]
    y = d[1] if (axes[1].nearest(origin) - origin) @ np.cross(d[1], z) >= -AXIS_TOLERANCE else -d[1]
    x = np.cross(y, z)
    shoulder = axes[1].nearest(origin) - origin

    def in_plane(vector: np.ndarray) -> np.ndarray:
        return vector - y * (vector @ y)

    upper_arm = in_plane(axes[2].nearest(wrist) - axes[1].nearest(wrist))
    forearm = in_plane(wrist - axes[2].nearest(wrist))
    f = d[3] if forearm @ d[3] >= -AXIS_TOLERANCE else -d[3]
    side = d[4] if y @ d[4] >= -AXIS_TOLERANCE else -d[4]
    g = d[5] if (tip.position - wrist) @ d[5] >= -AXIS_TOLERANCE else -d[5]
    theta2 = math.atan2(upper_arm @ x, upper_arm @ z)
    theta4 = math.atan2(np.cross(y, side) @ f, y @ side)
    theta5 = math.atan2(g @ np.cross(side, f), g @ f)
    references = (z, y, y, f, side, g)
    flange = Pose(wrist + g * ((tip.position - wrist) @ g), np.column_stack([np.cross(side, g), side, g])).matrix()
    return OpwModel(
        a1=float(shoulder @ x),
        a2=float(forearm @ np.cross(y, f)),
        b=float((wrist - origin) @ y),
        c1=float(shoulder @ z),
        c2=float(np.linalg.norm(upper_arm)),
        c3=float(forearm @ f),
        c4=float((tip.position - wrist) @ g),
        offsets=(0.0, -theta2, _half_open(theta2 - math.atan2(f @ x, f @ z)), -theta4, -theta5, 0.0),
        signs=tuple(1 if axis @ reference > 0.0 else -1 for axis, reference in zip(d, references)),
        base_T_opw=Pose(origin, np.column_stack([x, y, z])).matrix(),
        flange_T_tip=np.linalg.inv(flange) @ tip.matrix(),
    )


def _half_open(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def _largest_gap(model: OpwModel, chain: Chain) -> float:
    """Return the largest difference of any matrix element between both forward kinematics, over random poses."""
    solver = model.solver()
    rng = np.random.default_rng(_CHECK_SEED)
    worst = 0.0
    for q in rng.uniform(chain.robot.lower, chain.robot.upper, (_CHECKS, 6)):
        found = model.base_T_opw @ solver.forward(tuple(q.tolist())).as_matrix() @ model.flange_T_tip
        pose = chain.forward(q)
        worst = max(worst, float(np.abs(found - pose.matrix()).max()))
    return worst
