"""Frames that people name in requests: the robot's links by their URDF names, and every frame that tf knows.

Each frame of tf is believed from one node: those of a robot's trees from the nodes of its bringup, any other one from the first
that publishes it, until it is gone. Nothing is looked up in ``<robot>/simulated``: a simulated pose is never commanded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import rosgraph
import rospy
import tf2_ros
import yaml
from tf2_msgs.msg import TFMessage

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import PlanningError
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.convert import pose_from_transform_msg
from construction_twin.ros.messages.scene_convert import tf_frame
from construction_twin.ros.transport.subscriber import PUBLISHER, Subscriber, caller_of


class FrameError(PlanningError):
    """A frame is unknown; the sentence names known ones, of which tf may have hundreds."""

    def __init__(self, frame: str, base: str, cause: str, known: Sequence[str]):
        listed = ", ".join(known[:40]) + (f" and {len(known) - 40} more" if len(known) > 40 else "")
        super().__init__(f"no transform from frame {frame!r} to {base!r}: {cause}; known are {listed}")


class StampError(PlanningError):
    """A stamp is not of this machine's clock."""

    def __init__(self, frame: str, away: float):
        where = "ahead of" if away > 0.0 else "behind"
        super().__init__(
            f"the stamp of {frame!r} is {abs(away):.1f} s {where} this machine's clock; set the sender's clock by this one's "
            "(chrony), or send stamp 0 for where the frame is now"
        )


#: A stamp that tf has no frames of is called one of another clock from this difference on [s]; a frame is waited for a second.
OTHER_CLOCK = 2.0
#: Who publishes the frames of a robot's trees, by the tree's name, in the robot's namespace.
PUBLISHERS = {"twin": ("robot_state_publisher", "display"), "physical": ("display",), "preview": ("display",)}
#: Trees for people to look at, ignored here: of a simulated pose, and of where the servos should have the arm.
DISPLAY_ONLY = ("simulated", "expected")
#: Messages that are kept for a callback that is busy: about a second of three trees and of other robots'.
_QUEUE = 100
#: Where frames come from, those that move and those that do not.
FRAMES = ("/tf", "/tf_static")


class FrameListener:
    """Fills a buffer with the frames of known publishers; others' are `refused(reason, sentence)`."""

    def __init__(self, refused: Callable[[str, str], None]):
        self.buffer = tf2_ros.Buffer()
        self._refused = refused
        self._lock = threading.Lock()
        self._last = rospy.Time.now()
        self._above = rosgraph.names.namespace(rospy.get_namespace())
        #: Of each frame that is of no robot's tree: the node that publishes it.
        self._owners: dict[str, str] = {}
        callbacks = (
            partial(self._on_transforms, self.buffer.set_transform),
            partial(self._on_transforms, self.buffer.set_transform_static),
        )
        self._subscribers = [
            Subscriber(topic, TFMessage, callback, refused, _QUEUE) for topic, callback in zip(FRAMES, callbacks)
        ]

    def _on_transforms(self, put: Callable, message: TFMessage) -> None:
        caller = caller_of(message)
        # each once per message: a bag holds whole trees
        refusals: dict[str, None] = {}
        with self._lock:
            self._clear_after_clock_reset()
            for transform in message.transforms:
                frame = transform.child_frame_id.lstrip("/")
                if _tree(frame)[1] in DISPLAY_ONLY:
                    continue
                if refusal := self._refusal(frame, caller):
                    refusals[refusal] = None
                else:
                    put(transform, caller)
        for refusal in refusals:
            self._refused(PUBLISHER, refusal)

    def _clear_after_clock_reset(self) -> None:
        """Empty the buffer when the clock was set back: tf takes nothing that is older than what it has."""
        now = rospy.Time.now()
        if now < self._last:
            self.buffer.clear()
        self._last = now

    def _refusal(self, frame: str, caller: str) -> str:
        who = caller or "a node without a name"
        robot, tree = _tree(frame)
        if tree in PUBLISHERS:
            expected = [f"{self._above}{robot}/{name}" for name in PUBLISHERS[tree]]
            if caller in expected:
                return ""
            return f"message from {who}; only {' and '.join(expected)} may publish frames of {robot}/{tree} on /tf"
        owner = self._owners.get(frame)
        if owner == caller:
            return ""
        if owner is None or not any(subscriber.is_connected_to(owner) for subscriber in self._subscribers):
            self._owners[frame] = caller
            return ""
        return f"message from {who}; {owner} publishes the frame {frame} on /tf: end one of the two"


def _tree(frame: str) -> tuple[str, str]:
    """Return robot and tree of a frame ``<robot>/<tree>/<link>``; of any other one the tree is ""."""
    robot, _, rest = frame.partition("/")
    return robot, rest.partition("/")[0] if "/" in rest else ""


class Frames:
    """Where a frame is in the robot's `base`, a tf frame; one is waited for `timeout` [s]."""

    def __init__(self, robot: RobotModel, tf_prefix: str, buffer: tf2_ros.Buffer, timeout: float = 0.0):
        self.base = tf_frame(tf_prefix, robot.base_link)
        self._links = {link: tf_frame(tf_prefix, link) for link in parse_urdf(robot.urdf).link_map}
        self._buffer, self._timeout = buffer, rospy.Duration(timeout)

    def tf_name(self, frame: str) -> str:
        """Return the tf frame that a person means: a link by its URDF name is the twin's, as commanded; empty is the base."""
        frame = frame.removeprefix("/")  # as in the first tf
        return self._links.get(frame, frame) if frame else self.base

    def in_base(self, frame: str, stamp: rospy.Time) -> Pose:
        """Return where a frame is in the base at a stamp (0: the latest); FrameError, with those that are known, else."""
        name = self.tf_name(frame)
        if name == self.base:
            return Pose(np.zeros(3), np.eye(3))
        try:
            found = self._buffer.lookup_transform(self.base, name, stamp, self._timeout)
            return pose_from_transform_msg(found.transform)
        except tf2_ros.TransformException as error:
            if isinstance(error, tf2_ros.ExtrapolationException) and not stamp.is_zero():
                away = (stamp - rospy.Time.now()).to_sec()
                if abs(away) > OTHER_CLOCK:
                    raise StampError(frame, away) from error
            raise FrameError(frame, self.base, str(error), (*self._links, *self._others())) from error

    def _others(self) -> tuple[str, ...]:
        """Return the frames that tf knows, without those of the robot's own links."""
        read = yaml.safe_load(self._buffer.all_frames_as_yaml()) or {}
        # a frame's parents are known too, the root as nothing else
        names = {str(name) for name in read} | {str(each["parent"]) for each in read.values() if "parent" in each}
        return tuple(sorted(names - set(self._links.values())))


def listen_to_frames(robot: RobotModel, tf_prefix: str, timeout: float, refused: Callable[[str, str], None]) -> Frames:
    """Return the frames, listening to tf for as long as they are used; arguments as of `Frames` and `FrameListener`."""
    return Frames(robot, tf_prefix, FrameListener(refused).buffer, timeout)
