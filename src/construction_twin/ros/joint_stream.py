"""Joint streams at 250 Hz on ROS topics: tuples of rad and integer stamps inside, `sensor_msgs/JointState` outside."""

from __future__ import annotations

import math
from collections.abc import Callable

import genpy
import rospy
from sensor_msgs.msg import JointState

from construction_twin.errors import PayloadError
from construction_twin.ros.publisher import Publisher
from construction_twin.units import NANOSECONDS

#: Messages a publisher keeps for a subscriber that is busy: one second of stream.
QUEUE = 250


def to_time(stamp: int) -> genpy.Time:
    """Return a ROS time for a stamp in ns."""
    return genpy.Time(*divmod(stamp, NANOSECONDS))


def from_time(time: genpy.Time) -> int:
    """Return the stamp in ns of a ROS time."""
    return time.secs * NANOSECONDS + time.nsecs


def now_ns() -> int:
    """Return ROS time in ns."""
    return from_time(rospy.Time.now())


def joint_values(message: JointState, names: tuple[str, ...]) -> tuple[float, ...]:
    """Return a joint state's positions in the order of `names`.

    Parameters
    ----------
    message : sensor_msgs/JointState or construction_twin/Feedback
    names : tuple of str
        The robot's joint names.

    Returns
    -------
    q : tuple, shape (n,)
        [rad]

    Raises
    ------
    PayloadError
        ``names`` or ``values``, when it does not hold exactly these joints with finite positions.
    """
    if tuple(message.name) == names and len(message.position) == len(names):
        q = tuple(message.position)
    else:
        if (
            len(message.name) != len(message.position)
            or set(message.name) != set(names)
            or len(message.name) != len(names)
        ):
            found = f"joint state names {message.name}, {len(message.position)} positions"
            raise PayloadError("names", f"{found}; expected {list(names)}")
        by_name = dict(zip(message.name, message.position))
        q = tuple(by_name[name] for name in names)
    if not all(map(math.isfinite, q)):
        raise PayloadError("values", f"joint state with positions {q}; expected finite numbers")
    return q


class JointPublisher:
    """Publishes poses of one robot on one topic."""

    def __init__(self, topic: str, names: tuple[str, ...]):
        self._publisher = Publisher(topic, JointState, queue_size=QUEUE, tcp_nodelay=True)
        self._names = list(names)

    def publish(self, stamp: int, q: tuple[float, ...]) -> None:
        """Publish a pose [rad] with its stamp [ns]."""
        message = JointState(name=self._names, position=q)
        message.header.stamp = to_time(stamp)
        self._publisher.publish(message)


class JointSubscriber:
    """Hands a topic's poses to a callback; counts what is refused.

    Parameters
    ----------
    topic : str
    names : tuple of str
    callback : callable
        Called as ``callback(stamp, q)`` with ns and rad.
    refused : callable
        Called as ``refused(reason, sentence)`` for a message that is not used.
    publisher : str, optional
        Resolved name of the only node whose messages count (design, law 4).
    queue_size : int, optional
        Messages kept for a callback that is busy; of more the oldest are dropped.
    """

    def __init__(
        self,
        topic: str,
        names: tuple[str, ...],
        callback: Callable[[int, tuple[float, ...]], None],
        refused: Callable[[str, str], None],
        publisher: str | None = None,
        queue_size: int = QUEUE,
    ):
        self._names = names
        self._callback = callback
        self._refused = refused
        self._publisher = publisher
        self._subscriber = rospy.Subscriber(topic, JointState, self._receive, queue_size=queue_size, tcp_nodelay=True)

    def _receive(self, message: JointState) -> None:
        caller = message._connection_header["callerid"]
        if self._publisher is not None and caller != self._publisher:
            topic = self._subscriber.resolved_name
            self._refused("publisher", f"message from {caller}; only {self._publisher} may publish {topic}")
            return
        try:
            q = joint_values(message, self._names)
        except PayloadError as error:
            self._refused(error.reason, str(error))
            return
        self._callback(from_time(message.header.stamp), q)
