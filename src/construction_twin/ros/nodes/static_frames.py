"""static_frames: where the robot stands, the same place for twin, physical arm and preview; and what no joint state moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pydantic
import rospy
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from tf2_msgs.msg import TFMessage

from construction_twin.kinematics.chain import Pose, to_kdl, to_pose
from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.scene_convert import tf_frame
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.ports import Interface, Ports, Publication, SharedParameter
from construction_twin.scene.cell import load_cell


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


class Settings(pydantic.BaseModel):
    """Private parameters, given in the launch file.

    Tf prefixes of the robot's copies. Where it stands in `world`, the parameter ``cell`` says; without one at its origin. Of the
    copies in `chain_only` the joint states hold the joints of the chain alone, so that the frames of the others come from here;
    those of floating joints, which no joint state holds, come from here for every copy. `more` has prefixes of further copies of
    the chain alone, each by the name of its tree.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    prefixes: list[str]
    chain_only: list[str]
    more: dict[str, str] = {}


class StaticFramesNode:
    """Sends the static transforms once; they are latched."""

    def __init__(self, settings: Settings, robot: RobotModel, ports: Ports):
        cell = ports.parameters["cell"]
        place = Pose(np.zeros(3), np.eye(3)) if cell is None else load_cell(cell).world_T_root(robot.name)
        # the URDF's root, which need not be the base of the chain: any other link has a parent already
        base = parse_urdf(robot.urdf).get_root()
        more = list(settings.more.values())
        prefixes, chain_only = settings.prefixes + more, settings.chain_only + more
        transforms = [self._transform("world", tf_frame(prefix, base), place) for prefix in prefixes]
        transforms += [
            self._transform(tf_frame(prefix, frame.parent), tf_frame(prefix, frame.child), frame.pose)
            for prefix in prefixes
            for frame in other_frames(robot)
            if prefix in chain_only or frame.kind == "floating"
        ]
        ports.publishers["/tf_static"].publish(TFMessage(transforms))

    @staticmethod
    def _transform(parent: str, child: str, place: Pose) -> TransformStamped:
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = parent
        message.header.stamp = rospy.Time.now()
        transform = message.transform
        transform.translation = Vector3(*place.position)
        transform.rotation = Quaternion(*rotation_to_quaternion(place.rotation))
        return message


INTERFACE = Interface(
    parameters=(SharedParameter("cell"),),
    publishes=(Publication("/tf_static", TFMessage, queue_size=100, latch=True),),
)
NODE = NodeShell("static_frames", Settings, StaticFramesNode, INTERFACE)


def main() -> None:
    """Run the node."""
    NODE.run()
