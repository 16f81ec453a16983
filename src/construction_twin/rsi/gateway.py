"""rsi_gateway: MQTT <-> KUKA RSI on the cell PC. Runs without ROS: ``python -m construction_twin.rsi.gateway --help``.

One thread, one select loop: RSI datagrams first, then MQTT. Standard library and paho-mqtt only.
"""

from __future__ import annotations

import argparse
import gc
import json
import logging
import os
import selectors
import signal
import socket
import struct
import sys
import time
from logging.handlers import QueueHandler, QueueListener
from queue import SimpleQueue

from paho.mqtt import client as paho

from construction_twin.errors import (
    ConfigurationError,
    ConstructionTwinError,
    PayloadError,
    TelegramError,
    TransportError,
)
from construction_twin.mqtt.client import Broker, make_client, received_pairs, subscriptions, user_properties
from construction_twin.mqtt.messages import Topics, parse_control, read_command_properties
from construction_twin.mqtt.polled_client import PolledClient
from construction_twin.realtime import request_realtime
from construction_twin.rsi.codec import RobotTelegram, SensorEncoder, parse_robot
from construction_twin.rsi.config import GatewayConfig, load_config
from construction_twin.rsi.histogram import Histogram
from construction_twin.rsi.session import Gateway, State

log = logging.getLogger("rsi_gateway")

#: Linux: ask the kernel for each datagram's time of arrival, so that the reply time includes waiting for the processor.
_SO_TIMESTAMPNS = 35
_MAX_DATAGRAM = 65535
#: Datagrams read before anything else gets its turn: a flood must not stop the loop.
_DRAIN_LIMIT = 64
_STATUS_PERIOD = 1.0
#: The slowest axis comes to rest from full speed in less than 1 s; a controller that went silent is not waited for [s].
_LONGEST_BRAKING = 3.0


def bind(host: str, port: int) -> socket.socket:
    """Return a UDP socket bound for RSI; TransportError when the port is taken or the address is not ours."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise TransportError(
            f"cannot listen for RSI on UDP {host}:{port}: {error.strerror}; another gateway (or KUKA's TestServer) may hold the "
            "port, or the address is not this machine's"
        ) from error
    sock.setblocking(False)
    if sys.platform == "linux":
        sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return sock


class GatewayService:
    """Sockets around a Gateway.

    Parameters
    ----------
    config : GatewayConfig
    sock : socket.socket
        Bound UDP socket, see `bind`.
    broker : Broker
    topics : Topics
    controller : str or None
        Only datagrams from this address are read; None reads any.
    """

    def __init__(
        self, config: GatewayConfig, sock: socket.socket, broker: Broker, topics: Topics, controller: str | None = None
    ):
        self.gateway = Gateway(config)
        self.reply_time = Histogram.of_microseconds()
        self._sock = sock
        self._topics = topics
        self._controller = controller
        self._encoder = SensorEncoder(config.sentype, config.axes)
        self._selector = selectors.DefaultSelector()
        self._selector.register(sock, selectors.EVENT_READ, None)
        client = make_client(broker, f"{topics.robot}-gateway-{os.getpid()}", topics.status)
        client.on_connect = self._on_connect
        client.on_message = self._on_message
        client.connect_async(broker.host, broker.port, broker.keepalive)
        self._mqtt = PolledClient(client, self._selector)
        self._state_properties = broker.protocol == "5"
        self._status_at = 0.0
        self._running = True

    def run(self) -> None:
        """Serve until `stop` is called; then bring the arm to rest before answering ends, because HOLDON would stop it dead."""
        try:
            while self._running:
                self._turn(self._selector.select(0.05))
            self.gateway.stop("the gateway is ending")
            deadline = time.monotonic() + _LONGEST_BRAKING
            while self.gateway.state is State.BRAKING and time.monotonic() < deadline:
                self._turn(self._selector.select(0.05))
        finally:
            self._publish_status(final=True)
            self._mqtt.close()
            self._sock.close()

    def stop(self) -> None:
        """Make `run` brake and return; safe in a signal handler."""
        self._running = False

    def _turn(self, events) -> None:
        self._serve_controller()
        if any(key.data is self._mqtt and mask & selectors.EVENT_READ for key, mask in events):
            self._mqtt.read()
        now = time.monotonic()
        self._mqtt.service(now)
        self.gateway.poll(time.monotonic_ns())
        if self.gateway.take_change():
            log.info("%s: %s", self.gateway.state.value, self.gateway.reason)
            self._publish_status()
        elif now >= self._status_at:
            self._publish_status()

    # -- RSI

    def _serve_controller(self) -> None:
        newest = self._newest_telegram()
        if newest is None:
            return
        telegram, source, arrived = newest
        correction = self.gateway.on_telegram(telegram, source, time.monotonic_ns())
        if correction is not None:
            self._answer(self._encoder.encode(correction, telegram.ipoc), source)
            self.reply_time.add((time.time_ns() - arrived) / 1e3)
        self._publish_state()

    def _newest_telegram(self) -> tuple[RobotTelegram, tuple, int] | None:
        """Drain the socket; an answer to any but the newest telegram would come too late (rsi.md, section 4).

        Whatever is no telegram is dropped here, so that it cannot take the place of one.
        """
        newest = None
        for _ in range(_DRAIN_LIMIT):
            try:
                data, ancillary, source = self._receive()
            except BlockingIOError:
                break
            except OSError as error:
                # e.g. ICMP "port unreachable" for a reply to a controller that has just gone
                self.gateway.counters[f"udp_receive_{error.errno}"] += 1
                break
            telegram = self._read_telegram(data, source)
            if telegram is None:
                continue
            if newest is not None:
                self.gateway.counters["telegrams_skipped"] += 1
            newest = telegram, source, _arrival(ancillary)
        return newest

    def _read_telegram(self, data: bytes, source: tuple) -> RobotTelegram | None:
        if self._controller is not None and source[0] != self._controller:
            self.gateway.counters["telegram_refused_address"] += 1
            return None
        if not self.gateway.accepts(source, time.monotonic_ns()):
            self.gateway.counters["telegram_refused_source"] += 1
            return None
        try:
            return parse_robot(data, self.gateway.config.axes)
        except TelegramError as error:
            self.gateway.counters[f"telegram_refused_{error.reason}"] += 1
            return None

    def _receive(self) -> tuple[bytes, list, tuple]:
        if not hasattr(self._sock, "recvmsg"):  # Windows
            data, source = self._sock.recvfrom(_MAX_DATAGRAM)
            return data, [], source
        data, ancillary, _, source = self._sock.recvmsg(_MAX_DATAGRAM, 64)
        return data, ancillary, source

    def _answer(self, reply: bytes, source: tuple) -> None:
        try:
            self._sock.sendto(reply, source)
        except OSError as error:
            self.gateway.counters[f"udp_send_{error.errno}"] += 1

    # -- MQTT

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        if reason_code.is_failure:
            log.error("broker refused the connection: %s", reason_code)
            return
        log.info("connected to the broker")
        client.subscribe(subscriptions(client, [(self._topics.command, 0), (self._topics.control, 1)]))
        self._status_at = 0.0

    def _on_message(self, client, userdata, message: paho.MQTTMessage) -> None:
        if message.topic == self._topics.command:
            self._on_command(message)
        elif message.topic == self._topics.control:
            self._on_control(message)

    def _on_command(self, message: paho.MQTTMessage) -> None:
        if message.retain:
            self.gateway.counters["refused_retained"] += 1
            return
        pairs = received_pairs(message)
        try:
            properties = read_command_properties(pairs) if pairs else None
        except PayloadError as error:
            properties = error
        self.gateway.on_command(message.payload, properties, time.monotonic_ns())

    def _on_control(self, message: paho.MQTTMessage) -> None:
        if message.retain:
            self.gateway.counters["refused_retained"] += 1
            return
        try:
            control = parse_control(message.payload)
        except PayloadError as error:
            self.gateway.counters[f"refused_{error.reason}"] += 1
            log.warning("refused on control: %s", error)
            return
        ok, reason = self.gateway.on_control(control)
        log.info("%s from session %s: %s", control.verb, control.session, reason)
        # the state first: whoever reads the answer must not act on an older status
        self._publish_status()
        answer = {"id": control.id, "verb": control.verb, "ok": ok, "reason": reason, "session": control.session}
        self._mqtt.client.publish(self._topics.control_ack, json.dumps(answer), qos=1)

    def _publish_state(self) -> None:
        if not self._mqtt.connected:
            return
        message = self.gateway.state_message(time.monotonic_ns())
        if message is None:
            return
        payload, properties = message
        beside = user_properties(properties.pairs()) if self._state_properties else None
        self._mqtt.client.publish(self._topics.state, payload, properties=beside)

    def _publish_status(self, final: bool = False) -> None:
        self._status_at = time.monotonic() + _STATUS_PERIOD
        if not self._mqtt.connected:
            return
        status = self.gateway.status()
        status["reply_us"] = self.reply_time.summary()
        if final:
            status |= {"state": "offline", "reason": "gateway stopped"}
        self._mqtt.client.publish(self._topics.status, json.dumps(status), qos=1, retain=True)


def _arrival(ancillary) -> int:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
            seconds, nanoseconds = struct.unpack("qq", data[:16])
            return seconds * 1_000_000_000 + nanoseconds
    return time.time_ns()


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="rsi_gateway",
        description="Bridge between MQTT joint strings and KUKA RSI. Needs no ROS. Not safety rated.",
    )
    parser.add_argument(
        "--config", required=True, help="JSON file written by `rosrun construction_twin export_gateway_config`"
    )
    parser.add_argument(
        "--listen", default="127.0.0.1:49152", metavar="HOST:PORT", help="UDP address for RSI [%(default)s]"
    )
    parser.add_argument("--controller", metavar="HOST", help="read telegrams from this address only")
    parser.add_argument("--broker", default="127.0.0.1:1883", metavar="HOST:PORT", help="MQTT broker [%(default)s]")
    parser.add_argument("--protocol", default="5", choices=["5", "3.1.1"], help="MQTT version [%(default)s]")
    parser.add_argument("--prefix", default="twin", help="first level of the MQTT topics [%(default)s]")
    parser.add_argument(
        "--realtime", type=int, default=0, metavar="PRIORITY", help="SCHED_FIFO priority, 0 for none [%(default)s]"
    )
    return parser.parse_args(argv)


def _address(text: str, option: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ConfigurationError(option, text, "HOST:PORT")
    return host, int(port)


def _log_beside_the_loop() -> QueueListener:
    """Write the log from a thread of its own: the loop must not wait for a terminal or a full pipe (design, law 1)."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
    records: SimpleQueue = SimpleQueue()
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[QueueHandler(records)])
    listener = QueueListener(records, handler)
    listener.start()
    return listener


def _run(arguments: argparse.Namespace) -> int:
    try:
        config = load_config(arguments.config)
        broker = Broker(*_address(arguments.broker, "--broker"), protocol=arguments.protocol)
        topics = Topics(arguments.prefix, config.robot)
        service = GatewayService(
            config, bind(*_address(arguments.listen, "--listen")), broker, topics, arguments.controller
        )
    except ConstructionTwinError as error:
        log.error("%s", error)
        return 2
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: service.stop())
    log.info("configuration %s; listening on %s; broker %s", config.hash[:12], arguments.listen, arguments.broker)
    log.info(request_realtime(arguments.realtime))
    # a full collection over everything imported would take longer than the controller waits
    gc.freeze()
    service.run()
    return 0


def main(argv: list[str] | None = None) -> int:
    """Run the gateway until SIGINT or SIGTERM; return the exit code."""
    arguments = _arguments(sys.argv[1:] if argv is None else argv)
    listener = _log_beside_the_loop()
    try:
        return _run(arguments)
    finally:
        listener.stop()


if __name__ == "__main__":
    sys.exit(main())
