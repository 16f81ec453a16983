"""A ROS publisher for streams: it sends at once, no subscriber can make it wait, and it is quiet while the node shuts down."""

from __future__ import annotations

import socket
import threading
from collections import deque
from typing import Protocol

import rospy
from rospy.exceptions import TransportException, TransportTerminated


class AnyPublisher(Protocol):
    """A publisher as nodes use it."""

    @property
    def has_subscribers(self) -> bool:
        """Whether a subscriber is connected."""

    def publish(self, *content) -> None:
        """Send a message, or what it is made of."""


class Publisher(rospy.Publisher):
    """As `rospy.Publisher`, but in the caller's thread (`DirectConnection`), and dropping messages while the node shuts down."""

    def __init__(self, name: str, data_class: type, queue_size: int, **options):
        super().__init__(name, data_class, queue_size=queue_size, **options)
        # A subscriber that connects before this line gets rospy's own queue: slower, nothing else.
        add_connection = self.impl.add_connection
        self.impl.set_queue_size(None)
        self.impl.add_connection = lambda connection: add_connection(DirectConnection(connection, queue_size))

    @property
    def has_subscribers(self) -> bool:
        """Whether a subscriber is connected."""
        return self.get_num_connections() > 0

    def publish(self, *args, **kwds) -> None:
        """Publish a message; ROSException unless the node is shutting down."""
        try:
            super().publish(*args, **kwds)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise


class DirectConnection:
    """One subscriber's connection, in place of `rospy.impl.tcpros_pubsub.QueuedConnection`.

    rospy's queue hands every message to a thread of the connection: two thread switches per message and subscriber. Here the
    publishing thread sends as long as the socket takes it without waiting; the rest goes to a thread, `catching_up`, until the
    subscriber has. Of more than `queue_size` messages the oldest are dropped.
    """

    def __init__(self, connection, queue_size: int):
        self._connection = connection
        self._lock = threading.Lock()
        self._queue: deque[bytes] = deque(maxlen=queue_size)
        self.catching_up = False
        self._error: TransportException | OSError | None = None

    def __getattr__(self, name: str):
        return getattr(self._connection, name)

    def write_data(self, data: bytes) -> bool:
        """Send a message, or queue it; TransportTerminated when the subscriber is gone: rospy forgets the connection."""
        with self._lock:
            if self._error is not None:
                raise self._error
            if self.catching_up:
                self._queue.append(data)
                return True
            sent = self._send(data)
            if sent < len(data):
                self.catching_up = True
                threading.Thread(target=self._catch_up, args=(data[sent:],), daemon=True).start()
        return True

    def _send(self, data: bytes) -> int:
        if self._connection.done or self._connection.socket is None:
            raise TransportTerminated("connection closed")
        try:
            sent = self._connection.socket.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return 0
        except OSError as error:
            self._connection.close()
            raise TransportTerminated(str(error)) from error
        self._connection.stat_bytes += sent
        self._connection.stat_num_msg += 1
        return sent

    def _catch_up(self, rest: bytes) -> None:
        """Send the rest of a message and what has been queued since, waiting for the subscriber."""
        try:
            while rest:
                self._connection.write_data(rest)
                with self._lock:
                    rest = self._queue.popleft() if self._queue else b""
                    self.catching_up = bool(rest)
        except (TransportException, OSError) as error:
            with self._lock:
                self._error = error
