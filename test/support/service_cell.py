"""A running gateway for tests: real UDP on loopback, a real broker, and no ROS."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import math
import socket
import threading
import time
from contextlib import contextmanager

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from processes import wait_until

from construction_twin.core.network import bind
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.service import GatewayService
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.fast_client import UserProperties
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, arm_value, reset_value
from construction_twin.rsi.controller_codec import RobotEncoder, SensorDecoder

AXES = ("A1", "A2")
# a controller that waits longer than a real one, because this machine may be busy
CONFIG = GatewayConfig("arm", AXES, (-0.5, -3.2), (0.5, 3.2), (2.0, 4.5), (2.34, 17.4), timeout=8.0)
#: For tests of a stream whose sender and receiver must wait for the processor now and then.
PATIENT = dataclasses.replace(CONFIG, playout_delay=0.1, silence=8.0, max_age=20.0)
CODEC = JointStringCodec(2)
START = CODEC.quantise((0.1, -1.0))
POSE = ((0.0,) * 3, (0.0,) * 3)
#: The gateway's present run.
RUN = "run1"


class Controller(threading.Thread):
    """Sends a telegram every 4 ms, carries out each reply at once, and keeps what it was told."""

    def __init__(self, address):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(3.0)
        self.address = address
        self.ipoc = 1_000_000
        self.measured = START
        self.replies = []
        self.missed = 0
        self._encoder = RobotEncoder(AXES, 6)
        self._ended = threading.Event()

    def telegram(self, ipoc=None):
        poses = [(*place, *turn) for place, turn in (POSE, POSE)]
        return self._encoder.encode(self.ipoc if ipoc is None else ipoc, self.measured, START, *poses, self.missed)

    def send(self, data=None):
        self.socket.sendto(self.telegram() if data is None else data, self.address)

    def receive(self):
        """Return the reply's corrections, or None when none came."""
        try:
            data = self.socket.recv(65535)
        except TimeoutError:
            return None
        if self._ended.is_set():
            return None
        reply = SensorDecoder("ImFree", AXES).parse(data)
        assert reply.controller_ms == self.ipoc
        return reply.target

    def cycle(self):
        self.ipoc += 4
        self.send()
        correction = self.receive()
        self.replies.append(correction)
        if correction is None:
            self.missed += 1
        else:
            self.measured = tuple(start + value for start, value in zip(START, correction))

    def run(self):
        # on a grid of 4 ms: a telegram that is late does not delay the ones behind it
        due = time.monotonic()
        while not self._ended.wait(max(0.0, due - time.monotonic())):
            self.cycle()
            due += CYCLE

    def send_until(self, ended):
        """Send on until a gateway that is ending has ended: one that hears no telegram waits for the end of its braking."""
        self.socket.settimeout(0.02)
        deadline = time.monotonic() + 10.0
        while not ended() and time.monotonic() < deadline:
            if self.is_alive():
                time.sleep(0.002)
            else:
                self.ipoc += 4
                self.send()
                with contextlib.suppress(TimeoutError):
                    self.socket.recv(65535)

    def close(self):
        self._ended.set()
        # a reply that it waits for comes no more
        self.socket.sendto(b"", self.socket.getsockname())
        if self.is_alive():
            self.join(5.0)
        self.socket.close()


#: The services that run, with their threads, by their address: a controller that leaves ends its gateway.
_SERVED = {}


def end_gateway(controller):
    """End the gateway that this controller sends to, while it still hears telegrams; nothing for one of another process."""
    service, thread = _SERVED.get(controller.address, (None, None))
    if service is not None:
        service.stop()
        controller.send_until(lambda: not thread.is_alive())


@contextmanager
def controller_of(address):
    controller = Controller(address)
    try:
        yield controller
    finally:
        end_gateway(controller)
        controller.close()


@contextmanager
def serving(port, topics, config=CONFIG, sock=None, **options):
    """A GatewayService in a thread; yields it and its UDP address."""
    sock = sock or bind("127.0.0.1", 0)
    run = options.pop("run", RUN)
    # the controllers here send when a test tells them to, which is no clock
    measures = options.pop("measures", False)
    service = GatewayService(config, sock, Broker(port=port), topics, run, measures=measures, **options)
    thread = threading.Thread(target=service.run)
    address = sock.getsockname()
    thread.start()
    _SERVED[address] = service, thread
    try:
        yield service, address
    finally:
        del _SERVED[address]
        service.stop()
        thread.join(10.0)
        assert not thread.is_alive()


class Client:
    """The other side on MQTT: keeps every message per topic."""

    def __init__(self, port, topics):
        self.topics, self.messages = topics, []
        self.seq, self.stamp = 0, 10**18
        self.codec, self.session = CODEC, "s1"
        self._ids = itertools.count(1)
        subscribed = threading.Event()
        self.paho = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self.paho.on_connect = lambda client, *_: client.subscribe(f"{topics.prefix}/#", 1)
        self.paho.on_subscribe = lambda *_: subscribed.set()
        self.paho.on_message = lambda client, userdata, message: self.messages.append(message)
        self.paho.reconnect_delay_set(1, 1)
        self.paho.max_inflight_messages_set(1000)
        self.paho.connect("127.0.0.1", port)
        self.paho.loop_start()
        assert subscribed.wait(10.0)

    def close(self):
        self.paho.disconnect()
        self.paho.loop_stop()

    def on(self, topic):
        return [message for message in list(self.messages) if message.topic == topic]

    def status(self):
        found = self.on(self.topics.status)
        return json.loads(found[-1].payload) if found else {}

    def wait_for_status(self, timeout=10.0, **expected):
        return wait_until(lambda: expected.items() <= self.status().items(), timeout, f"status {expected}")

    def wait_for_counter(self, name, value, timeout=10.0):
        wait_until(lambda: self.status().get("counters", {}).get(name, 0) >= value, timeout, f"{name} {value}")
        assert self.status()["counters"][name] == value

    def control(self, verb, value=None, session="s1"):
        """Send a verb and return the answer."""
        if verb == "reset" and value is None:
            value = reset_value(self.status()["run"], self.status()["fault_number"])
        # rising numbers: what `speed_limit` needs
        control = Control(str(next(self._ids)), session, verb, value)
        self.paho.publish(self.topics.control, control.to_json(), qos=1)

        def answers():
            return [
                a
                for a in map(json.loads, (m.payload for m in self.on(self.topics.control_ack)))
                if a["id"] == control.id
            ]

        return wait_until(answers, what=f"answer to {verb}")[0]

    def arm(self, config=CONFIG, session="s1", run=RUN):
        """Arm a gateway with this configuration, in this run, and return the answer."""
        return self.control("arm", arm_value(config.hash, run), session)

    def command(self, q):
        self.seq += 1
        self.stamp += CYCLE_NS
        beside = UserProperties(CommandProperties(self.session, self.seq, self.stamp).pairs())
        self.paho.publish(self.topics.command, self.codec.encode(q), properties=beside)


@contextmanager
def client_of(port, topics, **options):
    client = Client(port, topics, **options)
    try:
        yield client
    finally:
        client.close()


@contextmanager
def cell(port, topics, **options):
    """Everything at once: gateway, running controller, client; the gateway is ready to be armed."""
    with serving(port, topics, **options) as (service, address), controller_of(address) as controller:
        with client_of(port, topics) as client:
            controller.start()
            client.wait_for_status(state="ready")
            yield service, controller, client


def motion(k):
    return (START[0] + 0.05 * (1 - math.cos(2.0 * k * 0.004)), START[1])


def stream(client, controller, poses):
    """One command per controller cycle; a stream that is ahead of the controller waits for it."""
    begin = len(controller.replies)
    for count, q in enumerate(poses):
        client.command(q)
        wait_until(lambda: len(controller.replies) > begin + count, what="the next cycle")


def assert_still(controller, cycles=20):
    before, count = controller.measured, len(controller.replies)
    wait_until(lambda: len(controller.replies) >= count + cycles, what="telegrams")
    assert set(controller.replies[count:]) == {controller.replies[count - 1]}
    assert controller.measured == before
