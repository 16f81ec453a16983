"""Joint streams at 250 Hz on ROS topics (rad and integer stamps inside, `sensor_msgs/JointState` outside), and their grid."""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import genpy
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.msg import Feedback
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber

#: What stands behind the positions: the numbers of velocities and efforts; the gateway's counter and the command's stamp.
_TAILS = {JointState: "2I", Feedback: "Q2I"}


class PoseMessage:
    """Writes and reads the messages of one type, JointState or Feedback, and one robot, each in one step.

    genpy goes through a message field by field: on the 250 Hz path a third of a node's work. Only numbers change from one message
    of a stream to the next; they are packed between bytes that are made once. `incoming_class` is for `rospy.Subscriber`, with the
    ``content`` that `read` returns; genpy fills the fields in where that is None, or when one is read.
    """

    def __init__(self, kind: type, names: tuple[str, ...]):
        self._kind = kind
        self._names = _names_section(names)
        self._struct = struct.Struct(f"<3I{len(self._names)}s{len(names)}d{_TAILS[kind]}")
        self._joints = slice(4, 4 + len(names))
        self.incoming_class = _incoming_class(kind, self.read)
        self._outgoing_class = _outgoing_class(kind, self.write)

    def outgoing_message(self, stamp: int, q: tuple[float, ...], seq: int = 0, command_stamp: int = 0):
        """Return a message to publish; see `write`."""
        return self._outgoing_class(stamp, q, seq, command_stamp)

    def write(self, number: int, stamp: int, q: tuple[float, ...], seq: int, command_stamp: int) -> bytes:
        """Return a message's bytes; `number`: the header's ``seq``, stamps in ns, `q` [rad], [m] in the order of the names."""
        tail = (0, 0) if self._kind is JointState else (seq, *divmod(command_stamp, NANOSECONDS))
        return self._struct.pack(number, *divmod(stamp, NANOSECONDS), self._names, *q, *tail)

    def read(self, data: bytes) -> tuple | None:
        """Return what a message's bytes say, if `write` makes such bytes: ``stamp, q``, and of Feedback ``seq, command_stamp``."""
        if len(data) != self._struct.size:
            return None
        fields = self._struct.unpack(data)
        if fields[3] != self._names:
            return None
        content = fields[1] * NANOSECONDS + fields[2], fields[self._joints]
        tail = fields[self._joints.stop :]
        if self._kind is JointState:
            return None if any(tail) else content
        return (*content, tail[0], tail[1] * NANOSECONDS + tail[2])


def _names_section(names: tuple[str, ...]) -> bytes:
    """Return what stands between a message's stamp and its first position: an empty frame, the names, how many positions."""
    count = struct.pack("<I", len(names))
    encoded = [name.encode() for name in names]
    return bytes(4) + count + b"".join(struct.pack("<I", len(name)) + name for name in encoded) + count


def _incoming_class(kind: Any, read) -> type:
    class Received(kind):
        def __init__(self):
            self.content = self._data = None

        def deserialize(self, data):
            self._data = data
            self.content = read(data)
            if self.content is None:
                self._fill()
            return self

        def _fill(self):
            # a field is there only once it is right: another thread may read it
            filled = kind().deserialize(self._data)
            for field in kind.__slots__:
                setattr(self, field, getattr(filled, field))

        def __getattr__(self, name):
            # a field that was not filled in yet: rospy's statistics ask for the header, and another subscriber of this
            # process is given the same object
            if name not in kind.__slots__ or self._data is None:
                raise AttributeError(name)
            self._fill()
            return getattr(self, name)

    return Received


def _outgoing_class(kind: Any, write) -> type:
    class Sent(kind):
        # rospy writes a message's number here, under its topic's lock, right before it has the message written
        header = Header()

        def __init__(self, *content):
            self._content = content

        def serialize(self, buffer):
            buffer.write(write(self.header.seq, *self._content))

    return Sent


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
    """Return positions in the order of `names`; PayloadError ``names`` or ``values`` for other joints, and what is not finite."""
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
        raise _not_finite(q)
    return q


def _not_finite(q: tuple[float, ...]) -> PayloadError:
    return PayloadError("values", f"joint state with positions {q}; expected finite numbers")


class JointPublisher:
    """Publishes poses of one robot on one topic."""

    def __init__(self, topic: str, names: tuple[str, ...], kind: type = JointState):
        self._publisher = Publisher(topic, kind, queue_size=QUEUE, tcp_nodelay=True)
        self._message = PoseMessage(kind, names)

    def publish(self, stamp: int, q: tuple[float, ...], seq: int = 0, command_stamp: int = 0) -> None:
        """Publish a pose [rad] with its stamp [ns]; as feedback also with the gateway's counter and the command's stamp [ns]."""
        self._publisher.publish(self._message.outgoing_message(stamp, q, seq, command_stamp))

    @property
    def has_subscribers(self) -> bool:
        """Whether a subscriber is connected."""
        return self._publisher.has_subscribers


class JointSubscriber:
    """Hands a topic's poses to ``callback(stamp, q)`` in ns and rad, feedback's with ``seq, command_stamp``; see `Subscriber`.

    `pause`: how long to read nothing after each message [s]; with a `queue_size` of 1 the callback gets the newest after it.
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
        message = PoseMessage(kind, names).incoming_class
        self._subscriber = Subscriber(topic, message, self._on_message, refused, queue_size, tcp_nodelay=True)

    def _on_message(self, message) -> None:
        # of another subscriber of this process, which was first, it has the class
        content = getattr(message, "content", None) or self._read(message)
        if not all(map(math.isfinite, content[1])):
            raise _not_finite(content[1])
        self._callback(*content)
        if self._pause:
            # rospy reads on when this returns
            time.sleep(self._pause)

    def _read(self, message: JointState | Feedback) -> tuple:
        content = from_time(message.header.stamp), joint_values(message, self._names)
        if isinstance(message, Feedback):
            return (*content, message.seq, from_time(message.command_stamp))
        return content


#: Setpoints that are late by no more than this are sent one after the other, so that none is missing [ns]. Below the gateway's
#: `silence` of 0.1 s: what the gateway bridges need not end a plan.
CATCH_UP = 80_000_000


class Cycles:
    """A grid from ROS time on, by the monotonic clock. One thread takes the cycles; others may ask and set its time."""

    def __init__(self):
        self._lock = threading.Lock()
        self._stamp = now_ns() // CYCLE_NS * CYCLE_NS
        self._offset = now_ns() - time.monotonic_ns()

    def now(self) -> int:
        """Return the grid's time [ns]."""
        return time.monotonic_ns() + self._offset

    def reach(self, stamp: int) -> int:
        """Advance to a stamp that another node's grid has reached [ns]; return `now`."""
        with self._lock:
            self._offset = max(self._offset, stamp - time.monotonic_ns())
            return self.now()

    def begin_at(self, stamp: int) -> None:
        """Restart at a stamp [ns], also an earlier one, of another node's grid."""
        with self._lock:
            self._stamp, self._offset = stamp // CYCLE_NS * CYCLE_NS, stamp - time.monotonic_ns()

    def skip(self) -> None:
        """Leave out the cycles that have passed."""
        with self._lock:
            self._stamp = max(self._stamp, self.now() // CYCLE_NS * CYCLE_NS)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Wait for one cycle after the other; yield its stamp, and how long the grid stood, this process not being run [ns]."""
        while not rospy.is_shutdown():
            with self._lock:
                self._stamp += CYCLE_NS
                remaining = self._stamp - self.now()
            stalled = 0
            if remaining > 0:
                time.sleep(remaining / 1e9)
            elif -remaining > CATCH_UP:
                stalled = -remaining
                # never back: on a clock that was set back meanwhile the grid would stand still until the clock has caught up
                self.reach(now_ns())
                self.skip()
            yield self._stamp, stalled
