"""Frames that people name in requests: the robot's links by their URDF names, and every frame that tf knows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rospy
import tf2_ros
import yaml
from geometry_msgs.msg import TransformStamped

from construction_twin.core.motion_errors import FrameError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.convert import pose_from_transform_msg
from construction_twin.ros.messages.scene_convert import tf_frame
from construction_twin.ros.shared.frame_listener import FrameListener


class Frames:
    """Where a frame is in the robot's base.

    Args:
        tf_prefix: Of the twin's tf frames.
        lookup: Takes a tf frame and a stamp; returns where it is in the base; raises tf2_ros.TransformException.
        known: Returns what tf knows, as `tf2_ros.Buffer.all_frames_as_yaml` does.

    Attributes:
        base: tf frame of the robot's base.
    """

    def __init__(
        self,
        robot: RobotModel,
        tf_prefix: str,
        lookup: Callable[[str, rospy.Time], TransformStamped],
        known: Callable[[], str],
    ):
        self.base = tf_frame(tf_prefix, robot.base_link)
        self._links = {link: tf_frame(tf_prefix, link) for link in parse_urdf(robot.urdf).link_map}
        self._lookup = lookup
        self._known = known

    def tf_name(self, frame: str) -> str:
        """Return the tf frame that a person means: a link by its URDF name is the twin's, as commanded; empty is the base."""
        return self._links.get(frame, frame) if frame else self.base

    def transform(self, frame: str, stamp: rospy.Time) -> TransformStamped:
        """Return where a frame is in the base at a stamp (0: the latest).

        Raises:
            FrameError: If it is not known, with the frames that are.
        """
        try:
            return self._lookup(self.tf_name(frame), stamp)
        except tf2_ros.TransformException as error:
            raise FrameError(frame, self.base, str(error), (*self._links, *self._others())) from error

    def in_base(self, frame: str, stamp: rospy.Time) -> Pose:
        """Return the same as a pose; the base itself is known without tf."""
        if self.tf_name(frame) == self.base:
            return Pose(np.zeros(3), np.eye(3))
        return pose_from_transform_msg(self.transform(frame, stamp).transform)

    def _others(self) -> tuple[str, ...]:
        """Return the frames that tf knows, without those of the robot's own links."""
        read = yaml.safe_load(self._known()) or {}
        # a frame's parents are known too, the root as nothing else
        names = {str(name) for name in read} | {str(each["parent"]) for each in read.values() if "parent" in each}
        return tuple(sorted(names - set(self._links.values())))


def listen_to_frames(robot: RobotModel, tf_prefix: str, timeout: float, refused: Callable[[str, str], None]) -> Frames:
    """Return the frames, listening to tf for as long as they are used.

    Args:
        robot, tf_prefix: As of `Frames`.
        timeout: How long a frame is waited for [s].
        refused: As of `FrameListener`.
    """
    listener = FrameListener(refused)
    base, wait = tf_frame(tf_prefix, robot.base_link), rospy.Duration(timeout)

    def lookup(frame: str, stamp: rospy.Time) -> TransformStamped:
        return listener.buffer.lookup_transform(base, frame, stamp, wait)

    return Frames(robot, tf_prefix, lookup, listener.buffer.all_frames_as_yaml)
