"""A connection that was lost returns under its id: the real mosquitto ends what it holds of the former one, with its last will."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from paho.mqtt import client as paho
from processes import ROOT, free_port, listens, wait_until
from service_cell import CONFIG
from site_broker import Listener

from construction_twin.core.network import bind
from construction_twin.gateway.service import GatewayService
from construction_twin.mqtt.client import OFFLINE, Broker, ConnectionLog, make_client
from construction_twin.mqtt.messages import Topics

ID = "one-bridge-0123456789abcdef"
WILL_TOPIC = "twin/one/bridge/status"


class Program:
    """A client as the nodes have it, and what it reports."""

    def __init__(self, broker: Broker, client_id: str, direct: bool = False):
        self.said: list[str] = []
        self.welcomes = 0
        self.report = ConnectionLog(broker, self.said.append)
        self.client = make_client(broker, client_id, WILL_TOPIC, direct=direct)
        self.client.on_connect = self._on_connect
        self.client.on_disconnect = lambda c, u, f, code, p: self.report.lost(code)
        self.client.connect_async(broker.host, broker.port, broker.keepalive)
        self.client.loop_start()

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        assert not reason_code.is_failure, str(reason_code)
        self.welcomes += 1
        self.report.connected(client, properties)

    def __enter__(self) -> Program:
        wait_until(lambda: self.welcomes, what="the broker's welcome")
        return self

    def __exit__(self, *_) -> None:
        self.client.disconnect()
        self.client.loop_stop()


class Speaker(Program):
    """One that says after each welcome that it is here."""

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        super()._on_connect(client, userdata, flags, reason_code, properties)
        client.publish(WILL_TOPIC, "here", qos=1, retain=True)


def test_a_connection_that_fell_silent_returns_with_the_id_it_had(tmp_path):
    """So the broker ends what it still holds of the former connection, with its last will, before the new one says anything."""
    with mosquitto((ROOT / "config/mosquitto.conf").read_text(), tmp_path / "log") as port:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            line = Line(listener, port)
            with Program(Broker("127.0.0.1", listener.getsockname()[1], keepalive=1), ID) as program:
                line.cut.set()
                wait_until(lambda: program.welcomes == 2, 20.0, "its return")
                assert "Keep alive timeout" in program.said[0] and program.client._client_id == ID.encode()


def test_what_the_broker_says_of_a_former_connection_of_the_gateway_says_of_which(tmp_path):
    """It may be said late, when another connection of the same run has spoken already; then it must change nothing."""
    said: list[dict] = []
    with mosquitto((ROOT / "config/mosquitto.conf").read_text(), tmp_path / "log") as port:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            line = Line(listener, port)
            broker = Broker("127.0.0.1", listener.getsockname()[1], keepalive=1)
            topics = Topics("twin", "one")
            service = GatewayService(CONFIG, bind("127.0.0.1", 0), broker, topics, "run1", measures=False)
            thread = threading.Thread(target=service.run)
            watcher = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
            watcher.on_message = lambda client, data, message: said.append(json.loads(message.payload))
            watcher.connect("127.0.0.1", port)
            watcher.subscribe(topics.status)
            watcher.loop_start()
            thread.start()
            try:
                wait_until(lambda: any(each["connection"] == 1 for each in said), what="the first status")
                line.reset()
                wait_until(lambda: any(each["connection"] == 2 for each in said), 20.0, "a status of the second one")
                wait_until(lambda: any(each["state"] == "offline" for each in said), 20.0, "the first one's last will")
                will = next(each for each in said if each["state"] == "offline")
                assert (will["run"], will["connection"]) == ("run1", 1)
            finally:
                service.stop()
                thread.join(10.0)
                watcher.disconnect()
                watcher.loop_stop()
    assert (said[-1]["state"], said[-1]["connection"]) == ("offline", 2)


@pytest.mark.parametrize("direct", [True, False])
def test_a_connection_that_the_network_has_reset_is_ended_at_the_broker_before_the_new_one_speaks(direct, tmp_path):
    """Or its last will would come later, behind what the new connection has said, and as if it had been lost again."""
    with (
        mosquitto((ROOT / "config/mosquitto.conf").read_text(), tmp_path / "log") as port,
        contextlib.closing(Listener(Broker("127.0.0.1", port), WILL_TOPIC)) as listener,
        socket.create_server(("127.0.0.1", 0)) as server,
    ):
        line = Line(server, port)
        with Speaker(Broker("127.0.0.1", server.getsockname()[1], keepalive=3), ID, direct) as program:
            wait_until(lambda: len(listener.messages) == 1, what="its first word")
            line.reset()
            # one more where the reset was before the first word's acknowledgement: paho sends that word again
            wait_until(lambda: len(listener.messages) >= 3, 20.0, "its last will, and its word after the return")
        words = [payload for _, payload in listener.messages]
        assert words[:3] == [b"here", OFFLINE.encode(), b"here"]
        assert program.welcomes == 2


class Line:
    """Passes the bytes of connections on to a port, of the first one until it is `cut`: then silently nothing more."""

    def __init__(self, listener: socket.socket, port: int):
        self.cut = threading.Event()
        self._port = port
        self._near: list[socket.socket] = []
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def reset(self) -> None:
        """Cut the first connection, and reset it at the client's end only, as a router does that has forgotten it."""
        self.cut.set()
        near = self._near[0]
        near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        near.shutdown(socket.SHUT_RD)
        near.close()

    def _accept(self, listener: socket.socket) -> None:
        cut = self.cut
        while True:
            try:
                near, _ = listener.accept()
            except OSError:
                # the test is over
                return
            self._near.append(near)
            far = socket.create_connection(("127.0.0.1", self._port))
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._pass, args=(source, sink, cut), daemon=True).start()
            cut = threading.Event()

    @staticmethod
    def _pass(source: socket.socket, sink: socket.socket, cut: threading.Event) -> None:
        try:
            while data := source.recv(4096):
                if not cut.is_set():
                    sink.sendall(data)
        except OSError:
            pass
        if not cut.is_set():
            sink.close()


@contextlib.contextmanager
def mosquitto(config: str, log: Path) -> Iterator[int]:
    """Run the broker on loopback with a configuration; its lines go to a file. Gives the port."""
    port = free_port()
    file = log.with_suffix(".conf")
    file.write_text(f"{config}\nlistener {port} 127.0.0.1\n")
    with open(log, "wb") as lines:
        process = subprocess.Popen(["/usr/sbin/mosquitto", "-c", str(file)], stdout=lines, stderr=lines)
    try:
        wait_until(lambda: listens(port), what="mosquitto listening")
        yield port
    finally:
        process.kill()
        process.wait(5.0)
