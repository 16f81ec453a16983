"""The newest pose on a 250 Hz stream, for nodes that ask for it now and then."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import rospy
from sensor_msgs.msg import JointState

from construction_twin.core.errors import PoseUnknownError
from construction_twin.ros.transport.joint_stream import from_time, joint_values
from construction_twin.ros.transport.subscriber import Subscriber

#: Between two reads of the socket while no pose is asked for [s]: of what has come in the meantime only the newest is kept.
PAUSE = 0.1
#: How long a caller waits for what lies in the socket, or for the stream's next message [s].
NEXT_MESSAGE = 0.01


@dataclass(frozen=True)
class StampedPose:
    """A pose, shape (n,) [rad], [m], the stamp of its header [ns], and the monotonic time at which it was read [s]."""

    positions: tuple[float, ...]
    stamp: int
    received: float


class LatestPose:
    """Listens to a `sensor_msgs/JointState` topic, in bundles: waking up for every message would cost several times as much."""

    def __init__(self, topic: str, names: tuple[str, ...], refused: Callable[[str, str], None]):
        self._names = names
        self._news = threading.Condition()
        self._wanted = threading.Event()
        self._newest: tuple[float, rospy.AnyMsg] | None = None
        self._reads = 0
        self._subscriber = Subscriber(topic, rospy.AnyMsg, self._receive, refused, queue_size=1, tcp_nodelay=True)

    def pose(self, oldest: float, patience: float = 0.0) -> tuple[float, ...]:
        """Return the newest pose; see `newest`."""
        return self.newest(oldest, patience).positions

    def newest(self, oldest: float, patience: float = 0.0) -> StampedPose:
        """Return the newest pose with its times, at most `oldest` [s] since its reception; wait `patience` [s] for one.

        PoseUnknownError where there is none that is young enough, PayloadError where it does not hold exactly these joints.
        """
        with self._news:
            reads = self._reads
            self._wanted.set()
            self._news.wait_for(lambda: self._reads > reads, NEXT_MESSAGE)
            if not self._news.wait_for(lambda: self._age() <= oldest, patience):
                raise PoseUnknownError(self._subscriber.resolved_name, self._age(), oldest)
            newest = self._newest
        assert newest is not None  # its age was finite
        received, message = newest[0], JointState().deserialize(newest[1]._buff)
        return StampedPose(joint_values(message, self._names), from_time(message.header.stamp), received)

    def close(self) -> None:
        """Listen no longer."""
        self._subscriber.unregister()

    def _receive(self, message: rospy.AnyMsg) -> None:
        self._wanted.clear()
        with self._news:
            self._newest = time.monotonic(), message
            self._reads += 1
            self._news.notify_all()
        # rospy reads on when this returns
        self._wanted.wait(PAUSE)

    def _age(self) -> float:
        return math.inf if self._newest is None else time.monotonic() - self._newest[0]
