"""A persistent connection for a stop: over real sockets, with a service that speaks ROS's protocol."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from io import BytesIO

import pytest
import rosgraph
import rospy
from rosgraph.network import encode_ros_handshake_header
from rospy.impl import tcpros_base
from std_srvs.srv import Trigger, TriggerResponse

from construction_twin.core.errors import RequestRefused, SilenceError
from construction_twin.ros.shared.robot_client import OperatorClient
from construction_twin.ros.transport.persistent_service import PersistentService


def answer(success: bool, sentence: str) -> bytes:
    """Return an answer as it goes over the line."""
    out = BytesIO()
    TriggerResponse(success, sentence).serialize(out)
    return b"\x01" + struct.pack("<I", len(out.getvalue())) + out.getvalue()


class Service:
    """Answers `stop` until it is killed; counts connections and calls."""

    def __init__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.connections: list[socket.socket] = []
        self.calls = 0
        self.ends_before_the_answer = False
        self.answer = answer(True, "braking")
        self.slow: threading.Event | None = None
        self.called = threading.Event()
        threading.Thread(target=self.accept, daemon=True).start()

    @property
    def uri(self) -> str:
        """Where it is."""
        return f"rosrpc://127.0.0.1:{self.listener.getsockname()[1]}"

    def accept(self) -> None:
        """Serve everybody."""
        while True:
            try:
                connection, _ = self.listener.accept()
            except OSError:
                return
            self.connections.append(connection)
            threading.Thread(target=self.serve, args=(connection,), daemon=True).start()

    def serve(self, connection: socket.socket) -> None:
        """Shake hands, then answer."""
        header = {"md5sum": Trigger._md5sum, "type": Trigger._type, "callerid": "/executor"}
        try:
            self.read(connection)
            connection.sendall(encode_ros_handshake_header(header))
            while self.read(connection) is not None:
                self.calls += 1
                self.called.set()
                if self.slow is not None:
                    slow, self.slow = self.slow, None
                    slow.wait(10.0)
                if self.ends_before_the_answer:
                    self.ends_before_the_answer = False
                    break
                connection.sendall(self.answer)
        except OSError:
            pass
        connection.close()

    def read(self, connection: socket.socket) -> bytes | None:
        """Return a message, None at the end."""
        size = connection.recv(4, socket.MSG_WAITALL)
        if len(size) < 4:
            return None
        return connection.recv(struct.unpack("<I", size)[0], socket.MSG_WAITALL)

    def kill(self) -> None:
        """End, as a process does that is killed."""
        self.listener.close()
        for connection in self.connections:
            with contextlib.suppress(OSError):  # ended already
                connection.shutdown(socket.SHUT_RDWR)


class World:
    """A master that counts who asks it."""

    def __init__(self, monkeypatch):
        self.service: Service | None = Service()
        self.asked = 0
        monkeypatch.setattr(rosgraph, "Master", lambda _: self)
        monkeypatch.setattr(tcpros_base, "_is_use_tcp_keepalive", lambda: False)
        monkeypatch.setattr(rospy, "get_name", lambda: "/tool")
        monkeypatch.setattr(rospy.names, "get_caller_id", lambda: "/tool")
        monkeypatch.setattr(rospy.core, "is_shutdown", lambda: False)

    def lookupService(self, name: str) -> str:
        """Return the service's address."""
        self.asked += 1
        if self.service is None:
            raise rosgraph.MasterError(f"no provider of {name}")
        return self.service.uri


@pytest.fixture
def world(monkeypatch):
    world = World(monkeypatch)
    yield world
    if world.service is not None:
        world.service.kill()


def test_a_call_over_an_open_connection_asks_no_master(world):
    stop = PersistentService("/kr120/stop", Trigger)
    assert [stop().message for _ in range(3)] == ["braking"] * 3
    assert (world.asked, len(world.service.connections), world.service.calls) == (1, 1, 3)


def test_a_connection_that_was_opened_before_serves_the_first_call_without_a_master(world):
    stop = PersistentService("/kr120/stop", Trigger)
    stop.open()
    stop.open()
    assert (world.asked, len(world.service.connections), world.service.calls) == (1, 1, 0)
    # the master is gone, and the service lives on
    service, world.service = world.service, None
    assert stop().message == "braking" and world.asked == 1 and service.calls == 1
    service.kill()


def test_what_cannot_be_opened_is_opened_later_and_keeps_no_call_back(world, monkeypatch):
    stop = PersistentService("/kr120/stop", Trigger)
    service, world.service = world.service, None
    stop.open()
    world.service = service
    hangs, asking = threading.Event(), threading.Event()
    lookup = world.lookupService

    def hanging(name):
        asking.set()
        hangs.wait(10.0)
        return lookup(name)

    monkeypatch.setattr(world, "lookupService", hanging)
    opening = threading.Thread(target=stop.open)
    opening.start()
    assert asking.wait(10.0)
    monkeypatch.setattr(world, "lookupService", lookup)
    assert stop().success and opening.is_alive()
    hangs.set()
    opening.join(10.0)
    assert stop().success and service.calls == 2


def test_a_service_that_was_started_anew_is_found(world):
    stop = PersistentService("/kr120/stop", Trigger)
    assert stop().success and world.asked == 1
    for asked in (2, 3):
        world.service.kill()
        world.service = Service()
        assert stop().message == "braking" and world.service.calls == 1 and world.asked == asked


def test_a_connection_that_breaks_before_the_answer_is_made_again(world):
    stop = PersistentService("/kr120/stop", Trigger)
    assert stop().success
    world.service.ends_before_the_answer = True
    assert stop().success and world.service.calls == 3 and len(world.service.connections) == 2


def test_nobody_there_is_no_answer_and_no_harm(world):
    stop = PersistentService("/kr120/stop", Trigger)
    world.service.kill()
    gone, world.service = world.service, None
    with pytest.raises(rospy.ServiceException):
        stop()
    world.service = gone  # its address, with nobody behind it
    with pytest.raises(rospy.ServiceException):
        stop()
    world.service = Service()
    assert stop().success


def test_a_second_stop_does_not_wait_for_the_answer_to_the_first(world):
    stop = PersistentService("/kr120/stop", Trigger)
    assert stop().success
    world.service.called.clear()
    world.service.slow = go_on = threading.Event()
    first = threading.Thread(target=stop)
    first.start()
    assert world.service.called.wait(10.0)
    assert stop().success and first.is_alive()
    go_on.set()
    first.join(10.0)
    assert world.service.calls == 3 and len(world.service.connections) == 2


class TestClient:
    def test_a_stop_is_called_without_a_probe(self, world, monkeypatch):
        monkeypatch.setattr(rospy, "wait_for_service", lambda *_: pytest.fail("probed"))
        assert OperatorClient("/kr120", 5.0, "test").trigger("stop").message == "braking"
        assert (world.asked, len(world.service.connections)) == (1, 1)

    def test_where_there_is_no_answer_it_is_tried_the_ordinary_way(self, world, monkeypatch):
        warned = []
        monkeypatch.setattr(rospy, "logwarn", lambda *words: warned.append(words))

        def nobody(*_):
            raise rospy.ROSException("timeout")

        monkeypatch.setattr(rospy, "wait_for_service", nobody)
        world.service.kill()
        world.service = None
        with pytest.raises(SilenceError, match=r"no node offers this service \(waited 5 s\)"):
            OperatorClient("/kr120", 5.0, "test").trigger("stop")
        assert len(warned) == 1

    def test_a_refusal_is_one(self, world, monkeypatch):
        client = OperatorClient("/kr120", 5.0, "test")
        world.service.answer = answer(False, "no")
        with pytest.raises(RequestRefused, match="no"):
            client.trigger("stop")
