"""static_frames: where the robot stands; world -> twin and world -> physical base, both the same place."""

from __future__ import annotations

import pydantic
import rospy
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation
from tf2_ros import StaticTransformBroadcaster

from construction_twin.ros.node import run_node
from construction_twin.ros.params import read_parameters


class Settings(pydantic.BaseModel):
    """Private parameters, given in the launch file: frame names, and the base's place in the parent frame [m, rad fixed-axis]."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    parent: str = "world"
    children: list[str]
    xyz: list[float] = [0.0, 0.0, 0.0]
    rpy: list[float] = [0.0, 0.0, 0.0]


class StaticFramesNode:
    """Sends the static transforms once; they are latched."""

    def __init__(self):
        settings = read_parameters(Settings)
        self._broadcaster = StaticTransformBroadcaster()
        self._broadcaster.sendTransform([self._transform(settings, child) for child in settings.children])

    @staticmethod
    def _transform(settings: Settings, child: str) -> TransformStamped:
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = settings.parent
        message.header.stamp = rospy.Time.now()
        translation, rotation = message.transform.translation, message.transform.rotation
        translation.x, translation.y, translation.z = settings.xyz
        rotation.x, rotation.y, rotation.z, rotation.w = Rotation.from_euler("xyz", settings.rpy).as_quat().tolist()
        return message


def main() -> None:
    """Run the node."""
    run_node("static_frames", StaticFramesNode)
