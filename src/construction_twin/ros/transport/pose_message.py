"""The messages of one robot's joint streams, each written and read in one step.

genpy goes through a message field by field, and through the joints' names one by one: in a node on the 250 Hz path that is a third
of its work. From one message of a stream to the next only numbers change, so here they are packed between bytes that are made
once. On the wire it is the same message. One of another form (other names or order, velocities, a frame) is left to genpy.
"""

from __future__ import annotations

import struct
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from construction_twin.core.units import NANOSECONDS
from construction_twin.msg import Feedback

#: What stands behind the positions: the numbers of velocities and efforts; the gateway's counter and the command's stamp.
_TAILS = {JointState: "2I", Feedback: "Q2I"}


class PoseMessage:
    """Writes and reads the messages of one type and one robot.

    Args:
        kind: `sensor_msgs/JointState` or `construction_twin/Feedback`.
        names: The robot's joint names.

    Attributes:
        received: Give it to `rospy.Subscriber` in place of `kind`. Its ``content`` is what `read` returns; the fields of `kind` are
            filled in where that is None, or when one is read.
    """

    def __init__(self, kind: type, names: tuple[str, ...]):
        self._kind = kind
        self._names = _between(names)
        self._struct = struct.Struct(f"<3I{len(self._names)}s{len(names)}d{_TAILS[kind]}")
        self._joints = slice(4, 4 + len(names))
        self.received = _received_class(kind, self.read)
        self._sent_class = _sent_class(kind, self.write)

    def sent(self, stamp: int, q: tuple[float, ...], seq: int = 0, command_stamp: int = 0):
        """Return a message to publish; see `write`."""
        return self._sent_class(stamp, q, seq, command_stamp)

    def write(self, number: int, stamp: int, q: tuple[float, ...], seq: int, command_stamp: int) -> bytes:
        """Return a message's bytes.

        Args:
            number: The header's ``seq``: how many messages the topic has seen.
            stamp: The header's stamp [ns].
            q: Shape (n,). [rad], [m] where linear, in the order of the names.
            seq, command_stamp: Of Feedback, the stamp in ns.

        Raises:
            struct.error: When a number is missing, or is none.
        """
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


def _between(names: tuple[str, ...]) -> bytes:
    """Return what stands between a message's stamp and its first position: an empty frame, the names, how many positions."""
    count = struct.pack("<I", len(names))
    encoded = [name.encode() for name in names]
    return bytes(4) + count + b"".join(struct.pack("<I", len(name)) + name for name in encoded) + count


def _received_class(kind: Any, read) -> type:
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


def _sent_class(kind: Any, write) -> type:
    class Sent(kind):
        # rospy writes a message's number here, under its topic's lock, right before it has the message written
        header = Header()

        def __init__(self, *content):
            self._content = content

        def serialize(self, buffer):
            buffer.write(write(self.header.seq, *self._content))

    return Sent
