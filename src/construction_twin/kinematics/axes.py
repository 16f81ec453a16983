"""Joint axes as lines in space, with all joints at zero, in the chain's base [m]: what the kind of an arm is found from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import PyKDL

from construction_twin.kinematics.chain import Chain

#: Directions whose cross product is shorter are parallel [rad]; lines that miss each other by less meet [m].
TOLERANCE = 1e-9


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
    if np.linalg.norm(normal) < TOLERANCE:
        return None
    # the point on the first line that is nearest to the second one
    along = np.cross(second.point - first.point, second.direction) @ normal / (normal @ normal)
    point = first.point + along * first.direction
    return point if np.linalg.norm(second.nearest(point) - point) < TOLERANCE else None
