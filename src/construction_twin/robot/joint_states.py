"""Every joint of a URDF with position and velocity, from the poses of the chain: what planners and tf read.

Positions in rad, m for prismatic joints; velocities per s; stamps in ns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from urdf_parser_py.urdf import Joint

from construction_twin.core.units import NANOSECONDS
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf

#: A pose that is further from the last one than the joints' speed limits allow, by this factor, was not moved to: the twin has
#: taken the arm's pose over. Rounding to three decimals of a degree adds a few percent at 20 ms.
_JUMP = 1.1
#: Types whose position is no single number.
_LEFT_OUT = ("fixed", "floating", "planar")


@dataclass(frozen=True)
class _Follows:
    """A joint as a function of one of the chain: ``factor * q + offset``; `leader` is -1 for one that stands still."""

    leader: int
    factor: float
    offset: float


class JointStates:
    """Adds the joints outside of the chain, and velocities as differences of poses.

    Parameters
    ----------
    robot : RobotModel

    Attributes
    ----------
    names : tuple of str
        Joints with one position, in the URDF's order, the order of a stock joint_state_publisher.
    """

    def __init__(self, robot: RobotModel):
        joints = parse_urdf(robot.urdf).joints
        shown = [joint for joint in joints if joint.joint_type not in _LEFT_OUT]
        by_name = {joint.name: joint for joint in joints}
        standing = {other.name: other.position for other in robot.other_joints}
        self.names = tuple(joint.name for joint in shown)
        self._rules = tuple(_rule(joint, robot.joint_names, by_name, standing) for joint in shown)
        self._largest = tuple(_JUMP * velocity for velocity in robot.velocity)
        self._rest = (0.0,) * len(robot.joint_names)
        self._last: tuple[int, tuple[float, ...]] | None = None

    def positions(self, q: Sequence[float]) -> list[float]:
        """Return the positions of `names`, of a pose of the chain, shape (n,)."""
        return [rule.offset + (rule.factor * q[rule.leader] if rule.leader >= 0 else 0.0) for rule in self._rules]

    def velocities(self, stamp: int, q: tuple[float, ...]) -> list[float]:
        """Return the velocities of `names`: the mean since the pose of the last call.

        0 for the first pose, for a stamp that is not newer, and for a pose that no joint could have moved to since: the twin took
        the arm's pose over.

        Parameters
        ----------
        stamp : int
            Of the pose [ns].
        q : tuple, shape (n,)
        """
        before, self._last = self._last, (stamp, q)
        speeds: Sequence[float] = self._rest
        if before is not None and stamp > before[0]:
            period = (stamp - before[0]) / NANOSECONDS
            moved = [(value - was) / period for value, was in zip(q, before[1])]
            if all(abs(speed) <= largest for speed, largest in zip(moved, self._largest)):
                speeds = moved
        return [rule.factor * speeds[rule.leader] if rule.leader >= 0 else 0.0 for rule in self._rules]


def _rule(
    joint: Joint, chain: Sequence[str], joints: Mapping[str, Joint], standing: Mapping[str, float | None]
) -> _Follows:
    position = standing.get(joint.name)
    if position is not None:
        return _Follows(-1, 1.0, position)
    factor, offset = 1.0, 0.0
    # a mimic joint of the chain; that it leads there, `find_other_joints` has checked
    while joint.name not in chain:
        offset += factor * float(joint.mimic.offset or 0.0)
        factor *= 1.0 if joint.mimic.multiplier is None else float(joint.mimic.multiplier)
        joint = joints[joint.mimic.joint]
    return _Follows(list(chain).index(joint.name), factor, offset)
