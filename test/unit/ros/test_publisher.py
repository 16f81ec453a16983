"""DirectConnection: a publisher's connection to one subscriber, over a real pair of sockets."""

from __future__ import annotations

import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rospy.exceptions import TransportTerminated
from rospy.impl.tcpros_base import TCPROSTransport, TCPROSTransportProtocol

from construction_twin.ros.transport.publisher import DirectConnection


class Line:
    """A TCPROS connection whose other end is ours."""

    def __init__(self, queue_size: int = 10):
        ours, self.subscriber = socket.socketpair()
        for end in (ours, self.subscriber):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.transport = TCPROSTransport(TCPROSTransportProtocol("test", None), "test")
        self.transport.set_socket(ours, "test")
        self.connection = DirectConnection(self.transport, queue_size)

    def read(self, size: int) -> bytes:
        """Read exactly so many bytes; fewer only at the end."""
        self.subscriber.settimeout(10.0)
        got = b""
        while len(got) < size:
            part = self.subscriber.recv(size - len(got))
            if not part:
                break
            got += part
        return got

    def close(self) -> None:
        self.transport.close()
        self.subscriber.close()


@pytest.fixture
def line():
    line = Line()
    yield line
    line.close()


def message(number: int, size: int) -> bytes:
    return number.to_bytes(4, "big") + size.to_bytes(4, "big") + bytes([number % 256]) * (size - 8)


def fill(line: Line, size: int = 1000) -> int:
    """Publish to a subscriber that does not read, until messages are waiting; return how many were published."""
    number = 0
    while not line.connection.catching_up:
        line.connection.write_data(message(number, size))
        number += 1
    return number


def test_a_message_is_with_the_subscriber_when_the_call_returns_and_no_thread_was_started(line):
    before = set(threading.enumerate())
    assert line.connection.write_data(b"abc")
    line.subscriber.setblocking(False)
    assert line.subscriber.recv(10) == b"abc"
    assert set(threading.enumerate()) <= before


def test_a_subscriber_that_does_not_read_holds_nobody_up_and_later_gets_everything_in_order(line):
    number = fill(line)
    for late in range(number, number + 5):
        line.connection.write_data(message(late, 1000))
    expected = b"".join(message(i, 1000) for i in range(number + 5))
    assert line.read(len(expected)) == expected


def test_of_more_than_the_queue_holds_the_oldest_whole_messages_are_dropped(line):
    number = fill(line)
    for late in range(number, number + 25):
        line.connection.write_data(message(late, 1000))
    got = line.read((number + 10) * 1000)
    numbers = [int.from_bytes(got[i : i + 4], "big") for i in range(0, len(got), 1000)]
    assert numbers == [*range(number), *range(number + 15, number + 25)]


def test_after_catching_up_messages_go_out_directly_again(line):
    before = set(threading.enumerate())
    number = fill(line)
    (sender,) = set(threading.enumerate()) - before
    line.read(number * 1000)
    sender.join(10.0)
    line.connection.write_data(b"next")
    assert set(threading.enumerate()) <= before
    assert line.read(4) == b"next"


def test_a_subscriber_that_is_gone_is_reported_to_rospy(line):
    line.subscriber.close()
    with pytest.raises(TransportTerminated):
        line.connection.write_data(b"abc")
    with pytest.raises(TransportTerminated):
        line.connection.write_data(b"abc")


@given(sizes=st.lists(st.integers(8, 9000), min_size=1, max_size=30), chunk=st.integers(1, 5000))
def test_whatever_the_sizes_and_the_subscribers_pace_messages_stay_whole_and_in_order(sizes, chunk):
    line = Line(queue_size=100)
    try:
        expected = b"".join(message(i, size) for i, size in enumerate(sizes))
        read = bytearray()

        def subscriber() -> None:
            while len(read) < len(expected):
                read.extend(line.subscriber.recv(chunk))

        thread = threading.Thread(target=subscriber)
        thread.start()
        for i, size in enumerate(sizes):
            line.connection.write_data(message(i, size))
        thread.join(20.0)
        assert bytes(read) == expected
    finally:
        line.close()
