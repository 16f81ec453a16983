"""PoseMessage and the joint streams made of it: on the wire they are what genpy writes, and whatever genpy writes can be read."""

from __future__ import annotations

import math
from io import BytesIO

import pytest
import rospy
from construction_twin.msg import Feedback
from hypothesis import given
from hypothesis import strategies as st
from rospy.msg import deserialize_messages, serialize_message
from sensor_msgs.msg import JointState

from construction_twin.core.units import NANOSECONDS
from construction_twin.ros.transport.joint_stream import JointSubscriber, PoseMessage, to_time

NAMES = ("joint_a1", "joint_a2", "gelenk_\u00e4")
STAMPS = st.integers(0, 2**32 * NANOSECONDS - 1)
POSES = st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * len(NAMES))
COUNTS = st.integers(0, 2**64 - 1)


def on_wire(message, number: int = 7) -> bytes:
    """Return what rospy sends for a message."""
    buffer = BytesIO()
    serialize_message(buffer, number, message)
    return buffer.getvalue()


def from_wire(data: bytes, kind: type):
    """Return the one message that rospy reads."""
    buffer, found = BytesIO(), []
    buffer.write(data)
    deserialize_messages(buffer, found, kind)
    (message,) = found
    return message


def joint_state(stamp: int, q: tuple[float, ...], **fields) -> JointState:
    message = JointState(**{"name": list(NAMES), "position": q, **fields})
    message.header.stamp = to_time(stamp)
    return message


def feedback(stamp: int, q: tuple[float, ...], seq: int, command_stamp: int) -> Feedback:
    message = Feedback(name=list(NAMES), position=q, seq=seq, command_stamp=to_time(command_stamp))
    message.header.stamp = to_time(stamp)
    return message


class TestWire:
    @given(STAMPS, POSES, st.integers(0, 2**32 - 1))
    def test_a_pose_is_the_message_that_genpy_writes(self, stamp, q, number):
        message = PoseMessage(JointState, NAMES)
        data = on_wire(message.outgoing_message(stamp, q), number)
        assert data == on_wire(joint_state(stamp, q), number)
        assert from_wire(data, message.incoming_class).content == (stamp, q)

    @given(STAMPS, POSES, COUNTS, STAMPS)
    def test_feedback_is_the_message_that_genpy_writes(self, stamp, q, seq, command_stamp):
        message = PoseMessage(Feedback, NAMES)
        data = on_wire(message.outgoing_message(stamp, q, seq, command_stamp))
        assert data == on_wire(feedback(stamp, q, seq, command_stamp))
        assert from_wire(data, message.incoming_class).content == (stamp, q, seq, command_stamp)

    @pytest.mark.parametrize("q", [(1.0, 2.0), (1.0, 2.0, 3.0, 4.0), (1.0, 2.0, None), (1.0, 2.0, "3")])
    def test_a_pose_that_is_none_is_not_sent(self, q):
        with pytest.raises(rospy.ROSSerializationException):
            on_wire(PoseMessage(JointState, NAMES).outgoing_message(1, q))


OTHERS = {
    "another order": {"name": list(NAMES[::-1]), "position": (3.0, 2.0, 1.0)},
    "velocities": {"velocity": (0.0, 0.0, 0.0)},
    "efforts": {"effort": (0.5,)},
    "other names": {"name": ["a", "b", "c"]},
    "names of the same length": {"name": ["joint_a1", "joint_a3", "gelenk_\u00e4"]},
    "fewer": {"name": list(NAMES[:2]), "position": (1.0, 2.0)},
    "as long, of other parts": {"name": [*NAMES[:2], "gelenk\u00e4"], "velocity": (), "effort": ()},
    "none": {"name": [], "position": ()},
}


@pytest.mark.parametrize("fields", OTHERS.values(), ids=OTHERS)
def test_what_looks_different_is_read_by_genpy(fields):
    message = joint_state(10**18, (1.0, 2.0, 3.0), **fields)
    read = from_wire(on_wire(message), PoseMessage(JointState, NAMES).incoming_class)
    assert read.content is None
    assert (read.header, read.name, read.position) == (message.header, message.name, message.position)
    assert (read.velocity, read.effort) == (message.velocity or (), message.effort or ())


def test_a_frame_is_no_reason_to_refuse_a_pose():
    message = joint_state(10**18, (1.0, 2.0, 3.0))
    message.header.frame_id = "base_link"
    read = from_wire(on_wire(message), PoseMessage(JointState, NAMES).incoming_class)
    assert read.content is None and read.header.frame_id == "base_link" and read.position == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("kind", [JointState, Feedback])
def test_who_looks_at_a_field_finds_it(kind):
    """Such as rospy's statistics, or a plain subscriber of the same process, which is given the same objects."""
    message = PoseMessage(kind, NAMES)
    data = on_wire(message.outgoing_message(10**18, (1.0, 2.0, 3.0), 5, 7))
    read, known = from_wire(data, message.incoming_class), from_wire(data, kind)
    assert read.header.stamp == known.header.stamp == to_time(10**18)
    assert all(getattr(read, field) == getattr(known, field) for field in kind.__slots__)
    assert repr(read) == repr(known) and read.content[:2] == (10**18, (1.0, 2.0, 3.0))
    assert not hasattr(read, "colour") and not hasattr(message.incoming_class(), "position")


class Topic:
    """A subscription whose messages come from the test; what it hands on and what it refuses."""

    def __init__(self, monkeypatch, kind: type = JointState, topic: str = "t"):
        self.poses, self.refused = [], []
        monkeypatch.setattr(rospy, "Subscriber", self.subscribe)
        monkeypatch.setattr(rospy, "get_param", lambda _, default: default)
        monkeypatch.setattr(rospy, "resolve_name", lambda name: f"/{name}")
        JointSubscriber(topic, NAMES, lambda *content: self.poses.append(content), self.refuse, kind=kind)

    def subscribe(self, topic, kind, callback, **_):
        self.kind, self.receive = kind, callback
        return self

    resolved_name = "/t"

    def refuse(self, reason: str, sentence: str) -> None:
        self.refused.append(reason)
        self.sentence = sentence

    def deliver(self, message, caller: str = "/executor", kind: type | None = None) -> None:
        """Take a message as rospy hands it on."""
        read = from_wire(on_wire(message), kind or self.kind)
        read._connection_header = {"callerid": caller}
        self.receive(read)


class TestSubscriber:
    def test_hands_on_a_stream(self, monkeypatch):
        topic = Topic(monkeypatch)
        topic.deliver(PoseMessage(JointState, NAMES).outgoing_message(5, (1.0, 2.0, 3.0)))
        topic.deliver(joint_state(6, (1.0, 2.0, 3.0)))
        # of the class of another subscriber of the process, which was there first
        topic.deliver(joint_state(7, (1.0, 2.0, 3.0)), kind=JointState)
        assert topic.poses == [(stamp, (1.0, 2.0, 3.0)) for stamp in (5, 6, 7)] and topic.refused == []

    def test_puts_other_orders_right(self, monkeypatch):
        topic = Topic(monkeypatch)
        topic.deliver(joint_state(5, (3.0, 2.0, 1.0), name=list(NAMES[::-1]), velocity=(0.0,) * 3))
        assert topic.poses == [(5, (1.0, 2.0, 3.0))]

    def test_hands_on_feedback(self, monkeypatch):
        topic = Topic(monkeypatch, Feedback)
        topic.deliver(PoseMessage(Feedback, NAMES).outgoing_message(5, (1.0, 2.0, 3.0), 8, 3 * NANOSECONDS + 1))
        other = feedback(6, (3.0, 2.0, 1.0), 9, 4)
        other.name = list(NAMES[::-1])
        topic.deliver(other)
        assert topic.poses == [(5, (1.0, 2.0, 3.0), 8, 3 * NANOSECONDS + 1), (6, (1.0, 2.0, 3.0), 9, 4)]

    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("velocity", [(), (0.0,) * 3], ids=["stream", "other"])
    def test_refuses_what_is_no_number(self, monkeypatch, bad, velocity):
        topic = Topic(monkeypatch)
        topic.deliver(joint_state(5, (1.0, bad, 3.0), velocity=velocity))
        assert topic.poses == [] and topic.refused == ["values"]

    @pytest.mark.parametrize("case", ["other names", "fewer", "none", "names of the same length"])
    def test_refuses_other_joints(self, monkeypatch, case):
        topic = Topic(monkeypatch)
        topic.deliver(joint_state(5, (1.0, 2.0, 3.0) if "position" not in OTHERS[case] else (), **OTHERS[case]))
        assert topic.poses == [] and topic.refused == ["names"]
