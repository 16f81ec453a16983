"""Joint streams at 250 Hz on ROS topics: tuples of rad and integer stamps inside, `sensor_msgs/JointState` outside."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import genpy
from sensor_msgs.msg import JointState

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.msg import Feedback
from construction_twin.ros.transport.pose_message import PoseMessage
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber

#: Messages a publisher keeps for a subscriber that is busy: one second of stream.
QUEUE = 250


def to_time(stamp: int) -> genpy.Time:
    """Return a ROS time for a stamp in ns."""
    return genpy.Time(*divmod(stamp, NANOSECONDS))


def from_time(time: genpy.Time) -> int:
    """Return the stamp in ns of a ROS time."""
    return time.secs * NANOSECONDS + time.nsecs


def now_ns() -> int:
    """Return ROS time in ns: no node runs on simulated time (`shared.master.expect_wall_clock`)."""
    return time.time_ns()


def joint_values(message: JointState, names: tuple[str, ...]) -> tuple[float, ...]:
    """Return a joint state's positions in the order of `names`.

    Args:
        names: The robot's joint names.

    Returns:
        Shape (n,). [rad]

    Raises:
        PayloadError: ``names`` or ``values``, when it does not hold exactly these joints with finite positions.
    """
    if tuple(message.name) == names and len(message.position) == len(names):
        q = tuple(message.position)
    else:
        if (
            len(message.name) != len(message.position)
            or set(message.name) != set(names)
            or len(message.name) != len(names)
        ):
            found, expected = str(message.name), str(list(names))
            count = len(message.position)
            key = "reason.refused.joint_state_names"
            raise PayloadError("names", Sentence(key, found=found, count=count, expected=expected))
        by_name = dict(zip(message.name, message.position))
        q = tuple(by_name[name] for name in names)
    if not all(map(math.isfinite, q)):
        raise _not_finite(q)
    return q


def _not_finite(q: tuple[float, ...]) -> PayloadError:
    return PayloadError("values", Sentence("reason.refused.joint_state_values", found=str(q)))


class JointPublisher:
    """Publishes poses of one robot on one topic.

    Args:
        names: The robot's joint names.
        kind: `sensor_msgs/JointState` or `construction_twin/Feedback`.
    """

    def __init__(self, topic: str, names: tuple[str, ...], kind: type = JointState):
        self._publisher = Publisher(topic, kind, queue_size=QUEUE, tcp_nodelay=True)
        self._message = PoseMessage(kind, names)

    def publish(self, stamp: int, q: tuple[float, ...], seq: int = 0, command_stamp: int = 0) -> None:
        """Publish a pose [rad] with its stamp [ns]; as feedback also with the gateway's counter and the command's stamp [ns]."""
        self._publisher.publish(self._message.sent(stamp, q, seq, command_stamp))

    @property
    def is_heard(self) -> bool:
        """Whether a subscriber is connected."""
        return self._publisher.is_heard


class JointSubscriber:
    """Hands a topic's poses to a callback, from the topic's own publisher; see `Subscriber`.

    Args:
        callback: Called as ``callback(stamp, q)`` with ns and rad; for feedback as ``callback(stamp, q, seq, command_stamp)``.
        refused: Called as ``refused(reason, sentence)`` for a message that is not used.
        queue_size: Messages kept for a callback that is busy; of more the oldest are dropped.
        kind: `sensor_msgs/JointState` or `construction_twin/Feedback`.
        pause: How long to read nothing after each message [s]. With a `queue_size` of 1 the callback then gets the newest of what
            came in the meantime, and the thread is not woken up for the others.
    """

    def __init__(
        self,
        topic: str,
        names: tuple[str, ...],
        callback: Callable[..., object],
        refused: Callable[[str, str], None],
        queue_size: int = QUEUE,
        kind: type = JointState,
        pause: float = 0.0,
    ):
        self._names = names
        self._pause = pause
        self._callback = callback
        self._refused = refused
        message = PoseMessage(kind, names).received
        self._subscriber = Subscriber(topic, message, self._take, refused, queue_size, tcp_nodelay=True)

    def _take(self, message) -> None:
        try:
            # of another subscriber of this process, which was first, it has the class
            content = getattr(message, "content", None) or self._read(message)
            if not all(map(math.isfinite, content[1])):
                raise _not_finite(content[1])
        except PayloadError as error:
            self._refused(error.reason, str(error))
            return
        self._callback(*content)
        if self._pause:
            # rospy reads on when this returns
            time.sleep(self._pause)

    def _read(self, message: JointState | Feedback) -> tuple:
        content = from_time(message.header.stamp), joint_values(message, self._names)
        if isinstance(message, Feedback):
            return (*content, message.seq, from_time(message.command_stamp))
        return content
