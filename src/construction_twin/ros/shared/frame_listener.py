"""tf for nodes that act on it: each frame is believed from one node.

Frames of a robot's three trees (``<robot>/twin``, ``physical``, ``preview``) come from the nodes of its bringup. Any other frame,
of a table or a building model, may come from anybody, but from one node at a time: the first one, until it is gone. What a second
one says is refused and counted. So a bag that is played into a live system moves no frame that is there.

Frames of ``<robot>/simulated``, where an arm with mass would be, are for people to look at: nothing is looked up in them, because a
simulated pose is never commanded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

import rosgraph
import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from construction_twin.ros.transport.subscriber import PUBLISHER, Subscriber, caller_of

#: Who publishes the frames of a robot's trees, by the tree's name, in the robot's namespace.
PUBLISHERS = {
    "twin": ("robot_state_publisher", "display"),
    "physical": ("display",),
    "preview": ("display",),
}
#: Trees for people to look at, which nothing here is told of: of a simulated pose, and of where the servos should have the arm.
SHOWN = ("simulated", "expected")
#: Messages that are kept for a callback that is busy: about a second of three trees and of other robots'.
_QUEUE = 100
#: Refused static transforms that are kept; of more the oldest are forgotten.
_KEPT = 1000
#: Nodes of so many frames are remembered before it is looked which of them are gone.
_OWNERS = 1000


#: Where frames come from, those that move and those that do not.
FRAMES = ("/tf", "/tf_static")


class FrameListener:
    """Fills a buffer with what is heard of frames.

    Args:
        refused: Called as ``refused(reason, sentence)`` for a transform of a node that may not publish its frame.

    Attributes:
        buffer: To look up transforms in.
    """

    def __init__(self, refused: Callable[[str, str], None]):
        self.buffer = tf2_ros.Buffer()
        self._refused = refused
        self._lock = threading.Lock()
        self._last = rospy.Time.now()
        self._above = rosgraph.names.namespace(rospy.get_namespace())
        #: Of each frame that is of no robot's tree: the node that publishes it.
        self._owners: dict[str, str] = {}
        self._look_at = _OWNERS
        #: By frame and node: the last static transform that was refused, the oldest first.
        self._kept: dict[tuple[str, str], TransformStamped] = {}
        moving, static = self.buffer.set_transform, self.buffer.set_transform_static
        takers = (partial(self._take, moving, False), partial(self._take, static, True))
        self._subscribers = [Subscriber(topic, TFMessage, take, refused, _QUEUE) for topic, take in zip(FRAMES, takers)]

    def _take(self, put: Callable, static: bool, message: TFMessage) -> None:
        caller = caller_of(message)
        problems = []
        with self._lock:
            self._forget_what_lies_ahead()
            for transform in message.transforms:
                frame = transform.child_frame_id.lstrip("/")
                if _tree(frame)[1] in SHOWN:
                    continue
                problem = self._problem(frame, caller)
                # what it says now is newer
                self._kept.pop((frame, caller), None)
                if not problem:
                    put(transform, caller)
                    continue
                problems.append(problem)
                if static and frame in self._owners:
                    self._kept[frame, caller] = transform
            while len(self._kept) > _KEPT:
                del self._kept[next(iter(self._kept))]
            self._take_what_was_kept()
        # each once per message: a bag holds whole trees
        for problem in dict.fromkeys(problems):
            self._refused(PUBLISHER, problem)

    def _take_what_was_kept(self) -> None:
        """Believe what was refused of frames whose node is gone; forget what nodes said that are gone themselves."""
        if not self._kept:
            return
        nodes = {caller for _, caller in self._kept} | {self._owners.get(frame) for frame, _ in self._kept}
        there = {node for node in nodes if self._is_there(node)}
        for (frame, caller), transform in list(self._kept.items()):
            if caller not in there:
                del self._kept[frame, caller]
            elif self._owners.get(frame) not in there:
                del self._kept[frame, caller]
                self._owners[frame] = caller
                self.buffer.set_transform_static(transform, caller)

    def _is_there(self, node: str | None) -> bool:
        return node is not None and any(subscriber.hears(node) for subscriber in self._subscribers)

    def _own(self, frame: str, caller: str) -> None:
        self._owners[frame] = caller
        if len(self._owners) > self._look_at:
            there = {node: self._is_there(node) for node in set(self._owners.values())}
            self._owners = {name: node for name, node in self._owners.items() if node == caller or there[node]}
            # not at every new frame where all are there
            self._look_at = max(_OWNERS, 2 * len(self._owners))

    def _forget_what_lies_ahead(self) -> None:
        """Empty the buffer when the clock was set back: tf takes nothing that is older than what it has."""
        now = rospy.Time.now()
        if now < self._last:
            self.buffer.clear()
        self._last = now

    def _problem(self, frame: str, caller: str) -> str:
        """Return why a node may not publish a frame; "" when it may."""
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
        if not self._is_there(owner):
            self._own(frame, caller)
            return ""
        return f"message from {who}; {owner} publishes the frame {frame} on /tf: end one of the two"


def _tree(frame: str) -> tuple[str, str]:
    """Return robot and tree of a frame ``<robot>/<tree>/<link>``; of any other one the tree is ""."""
    robot, _, rest = frame.partition("/")
    return robot, rest.partition("/")[0] if "/" in rest else ""
