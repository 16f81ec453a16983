"""A robot's links in tf, each in its parent: of the copies that people look at, and what no joint state moves of the twin."""

from __future__ import annotations

from collections.abc import Sequence

import genpy
import PyKDL
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3

from construction_twin.kinematics.chain import Pose, to_frame, to_kdl
from construction_twin.robot.description import RobotModel
from construction_twin.robot.other_joints import Following
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.scene_convert import tf_frame


class RobotFrames:
    """The frames of a robot's copies, below a prefix each.

    Args:
        place: Where the URDF's root stands in ``world``.
    """

    def __init__(self, robot: RobotModel, place: Pose):
        model = parse_urdf(robot.urdf)
        # the URDF's root, which need not be the base of the chain: any other link has a parent already
        self._root, self._place = model.get_root(), to_frame(place)
        moves = {name: Following(name, 1.0, 0.0) for name in robot.joint_names}
        moves |= {other.name: other.following for other in robot.other_joints if other.following is not None}
        stands = {other.name: other.position for other in robot.other_joints if other.position is not None}
        # kept: its segments live in it
        self._segments = to_kdl(model.joints)
        self._still: list[tuple[str, str, PyKDL.Frame]] = []
        self._floating: list[tuple[str, str, PyKDL.Frame]] = []
        self._moving: list[tuple[str, str, PyKDL.Segment, int, Following]] = []
        for number, joint in enumerate(model.joints):
            segment = self._segments.getSegment(number)
            if (following := moves.get(joint.name)) is not None:
                leader = robot.joint_names.index(following.leader)
                self._moving.append((joint.parent, joint.child, segment, leader, following))
                continue
            frames = self._floating if joint.joint_type == "floating" else self._still
            frames.append((joint.parent, joint.child, segment.pose(stands.get(joint.name, 0.0))))

    def of_the_twin(self, prefix: str, stamp: genpy.Time) -> list[TransformStamped]:
        """Return what the stock nodes leave out of the twin: where it stands, and floating joints, which no joint state holds."""
        root = _transform("world", tf_frame(prefix, self._root), self._place, stamp)
        return [root, *(_below(prefix, *frame, stamp) for frame in self._floating)]

    def still(self, prefix: str, stamp: genpy.Time) -> list[TransformStamped]:
        """Return every frame of a copy that does not move with the chain."""
        return [*self.of_the_twin(prefix, stamp), *(_below(prefix, *frame, stamp) for frame in self._still)]

    def moving(self, prefix: str, stamp: genpy.Time, q: Sequence[float]) -> list[TransformStamped]:
        """Return the frames of a copy that move with the chain.

        Args:
            q: Joint values of the chain, length n [rad], [m].
        """
        return [
            _below(prefix, parent, child, segment.pose(following.factor * q[leader] + following.offset), stamp)
            for parent, child, segment, leader, following in self._moving
        ]


def _below(prefix: str, parent: str, child: str, place: PyKDL.Frame, stamp: genpy.Time) -> TransformStamped:
    return _transform(tf_frame(prefix, parent), tf_frame(prefix, child), place, stamp)


def _transform(parent: str, child: str, place: PyKDL.Frame, stamp: genpy.Time) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    message.transform.translation = Vector3(*place.p)
    message.transform.rotation = Quaternion(*place.M.GetQuaternion())
    return message
