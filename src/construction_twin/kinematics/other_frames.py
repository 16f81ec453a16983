"""Where the links behind joints outside of the chain stand, in their parent links. Metres."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.kinematics.chain import Pose, to_kdl, to_pose
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf


@dataclass(frozen=True, eq=False)
class LinkFrame:
    """A link in another one.

    Attributes:
        parent, child: Names of links.
        pose: ``parent_T_child``
        kind: The URDF's type of the joint between them.
    """

    parent: str
    child: str
    pose: Pose
    kind: str


def other_frames(robot: RobotModel) -> list[LinkFrame]:
    """Return the frames of the joints outside of the chain, without those that move with a joint of the chain.

    Those move in tf by themselves: robot_state_publisher computes mimic joints from their leaders.
    """
    joints = parse_urdf(robot.urdf).joint_map
    frames = []
    for other in robot.other_joints:
        if other.position is not None:
            joint = joints[other.name]
            pose = to_pose(to_kdl([joint]).getSegment(0).pose(other.position))
            frames.append(LinkFrame(joint.parent, joint.child, pose, other.kind))
    return frames
