"""The running gateway under fire: its own process, a real mosquitto, real UDP, and a mock controller whose arm must not move.

What is sent is sent in pieces, and a marker after each: when the gateway has answered it, everything before has been handled, so
that UDP and QoS 0 drop nothing and every single message must be found in a counter.
"""

from __future__ import annotations

import itertools
import json
import random
import select
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from rsi_mutations import mutate as mutate_telegram

from construction_twin.core.units import CYCLE, radians
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mock.config import MockConfig
from construction_twin.mock.controller import MockController
from construction_twin.mock.servo import IdealServo
from construction_twin.mqtt.client import subscriptions
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, Topics, arm_value, reset_value
from construction_twin.rsi.controller_codec import SensorDecoder

HOME = radians((0.0, -90.0, 90.0, 0.0, 90.0, 0.0))
FAR = radians((30.0, -60.0, 110.0, 40.0, 60.0, -50.0))
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
_PI6 = (3.2,) * 6
#: A stream that falls silent is not given up within a piece.
CONFIG = GatewayConfig("fuzz", AXES, (-3.2,) * 6, _PI6, (2.0,) * 6, (3.0,) * 6, silence=5.0, playout_delay_max=0.4)
MOCK = MockConfig(AXES, HOME, (-3.2,) * 6, _PI6, (2.0,) * 6, (3.0,) * 6)
#: Largest datagram of UDP.
LARGEST = 65_507
#: Datagrams and bytes that wait in the gateway's socket at most; the kernel keeps about 200 kB, with its own bookkeeping.
DATAGRAMS, BYTES = 40, 60_000
MESSAGES = 500
#: A single packet is given this long to be answered [s].
ALONE = 0.002


#: In place of a property, or its name; of a value of a control message; put into a payload.
TEXTS = (
    "",
    "-1",
    "1.0",
    " 1",
    "9" * 40,
    "18446744073709551616",
    "nan",
    "\u0663",
    "1_000",
    "0x10",
    "a" * 5000,
    "session",
)
VALUES = (None, True, -1, 1e308, 10**30, "x" * 1500, "\ud7ff", [[]], {"a": {"b": 1}})
PARTS = (
    b"\x00",
    b"\xff",
    b"\xc3\x28",
    b"+",
    b",",
    b"nan",
    b"1e5",
    b"{",
    b"[" * 1500,
    b'"',
    b"\\ud800",
    b"NaN",
    b"9" * 5000,
)
VERBS = ("arm", "stop", "reset", "end", "speed_limit", "fly", "ARM", "")


@dataclass
class Message:
    """One publish."""

    topic: str
    payload: bytes
    pairs: list[tuple[str, str]] = field(default_factory=list)
    retain: bool = False


@dataclass
class Target:
    """What a hostile sender knows of the cell.

    Attributes:
        session, ended: Owner of the stream, and one that had its turn.
        arming: Value of an `arm`: configuration and run; anybody can read both in the status.
        far, held: Joint strings: degrees away from the arm on every joint, and where it stands.
    """

    session: str
    ended: str
    arming: dict
    far: bytes
    held: bytes


def message(rng: random.Random, target: Target) -> Message:
    """Return a malformed or hostile message; never a complete valid command of the armed session, which access rules keep off."""
    session = rng.choice((target.session, target.ended, "another", ""))
    made = _command(rng, target, session) if rng.random() < 0.7 else Message("control", _control(rng, target, session))
    if rng.random() < 0.6:
        made.payload = mutate(rng, made.payload)[:60_000]
    made.retain = rng.random() < 0.02
    return made


def _command(rng: random.Random, target: Target, session: str) -> Message:
    payload = target.far if session == target.session else rng.choice((target.far, target.held))
    seq, stamp = rng.choice((1, 2, 70, 10**6, rng.randrange(10**19))), rng.randrange(10**19)
    pairs = [("session", session), ("seq", str(seq)), ("stamp", str(stamp))]
    for _ in range(rng.choice((0, 0, 1, 3))):
        place = rng.randrange(len(pairs) or 1)
        other = rng.choice((*pairs, ("extra", "1"))), (rng.choice(TEXTS), rng.choice(TEXTS))
        pairs[place : place + 1] = rng.choice(([], [other[1]], [other[0]] * rng.choice((2, 200))))
    return Message("command", payload, pairs)


def _control(rng: random.Random, target: Target, session: str) -> bytes:
    # the right value only from who is armed already, or had its turn: arming anew is the access rules' business
    value = target.arming if session in (target.session, target.ended) else rng.choice((None, "0" * 64, 1.0, []))
    document = {"id": str(rng.randrange(10**6)), "session": session, "verb": rng.choice(VERBS), "value": value}
    for name in rng.sample(list(document), rng.choice((0, 0, 1, 2))):
        document[rng.choice((name, "extra", "x" * 300))] = rng.choice(VALUES)
    return json.dumps(document).encode()


def mutate(rng: random.Random, data: bytes) -> bytes:
    """Change a payload's bytes: flipped, cut, repeated, replaced, put in."""
    data = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        place, end = (min(len(data), rng.randrange(len(data) + 1) + more) for more in (0, rng.randint(1, 12)))
        place, end = min(place, end), max(place, end)
        data[place:end] = rng.choice((b"", rng.choice(PARTS), data[place:end] * 7, rng.randbytes(end - place)))
    return bytes(data)


class GatewayProcess:
    """The gateway as a process of its own; its log goes to a file."""

    def __init__(self, folder: Path, broker_port: int):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = probe.getsockname()
        (folder / "fuzz.json").write_text(CONFIG.to_json())
        self.log = folder / "gateway.log"
        listen, broker = f"127.0.0.1:{self.address[1]}", f"127.0.0.1:{broker_port}"
        command = [sys.executable, "-m", "construction_twin.gateway", "--config", str(folder / "fuzz.json")]
        with self.log.open("w") as log:
            self._process = subprocess.Popen([*command, "--listen", listen, "--broker", broker], stderr=log)

    @property
    def alive(self) -> bool:
        """True while the process runs."""
        return self._process.poll() is None

    def resident(self) -> int:
        """Return the process' resident memory [bytes]."""
        for line in Path(f"/proc/{self._process.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) * 1024
        raise AssertionError("the gateway has no memory: it has ended")

    def end(self) -> None:
        """End it as a user would; it must end cleanly and have reported no crash."""
        self._process.terminate()
        try:
            code = self._process.wait(10.0)
        finally:
            self.kill()
        assert code == 0, f"the gateway ended with {code}"
        assert "Traceback" not in self.log.read_text(errors="replace"), f"an exception in {self.log}"

    def kill(self) -> None:
        """Make sure that it is gone."""
        if self.alive:
            self._process.kill()
            self._process.wait(10.0)


class Arm:
    """A mock controller in lock step with the gateway: a packet, its reply, the next packet. No reply may move it."""

    def __init__(self, gateway: tuple[str, int]):
        self.controller = MockController(MOCK, IdealServo(3), lambda angles: ((0.0,) * 3, (0.0,) * 3))
        self.home, self.sent = HOME, 0
        self._gateway = gateway
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._last = b""

    def cycle(self, patience: float = 0.5) -> bool:
        """Send a packet and wait for its reply [s]; return whether one came."""
        packet = self.controller.begin_cycle()
        assert packet is not None, f"the mock controller stopped: {self.controller.reason}"
        self._last = packet
        self.send(packet)
        deadline = time.monotonic() + patience
        while (remaining := deadline - time.monotonic()) > 0:
            self._socket.settimeout(remaining)
            try:
                reply = self._socket.recv(65535)
            except TimeoutError:
                break
            read = SensorDecoder("ImFree", AXES).parse(reply)
            assert not any(read.target), f"IPOC {read.controller_ms} was answered with a motion: {read.target}"
            if read.controller_ms == self.controller.stamp:
                self.controller.receive(reply)
                return True
        return False

    def recover(self) -> None:
        """Cycle until replies come: a hostile packet may have made the gateway wait for a new session."""
        for _ in range(20):
            if self.cycle():
                return
        raise AssertionError("20 packets in a row were not answered")

    def hostile(self, packets: Sequence[tuple[bytes, bool]]) -> None:
        """Send packets, from this controller's address or (True) from a stranger's, then a good one.

        Of several that wait the gateway answers the newest. So a single one is given time to be answered alone.
        """
        for data, strange in packets:
            self.send(data, self._stranger if strange else None)
        if len(packets) == 1:
            select.select([self._socket], [], [], ALONE)
        if not self.cycle():
            self.recover()

    def send(self, data: bytes, sock: socket.socket | None = None) -> None:
        """Send a datagram and count it."""
        (sock or self._socket).sendto(data, self._gateway)
        self.sent += 1

    @property
    def packet(self) -> bytes:
        """The last good packet."""
        return self._last

    def close(self) -> None:
        """Close both sockets."""
        self._socket.close()
        self._stranger.close()


class Mqtt:
    """The hostile sender, the owner of the stream, and the observer of counters, on one connection: so their order is kept."""

    def __init__(self, port: int):
        self.topics, self.codec = Topics("twin", CONFIG.robot), JointStringCodec(len(AXES))
        self.sent = self.granted = 0
        self.status: dict = {}
        self.largest_status = 0
        self._sessions = (f"owner{number}" for number in itertools.count())
        self._answers: dict[str, dict] = {}
        self._news = threading.Condition()
        self._client = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.max_inflight_messages_set(1000)
        # or every question would wait for a delayed acknowledgement
        self._client.on_socket_open = lambda client, userdata, sock: sock.setsockopt(
            socket.IPPROTO_TCP, socket.TCP_NODELAY, 1
        )
        subscribed = threading.Event()
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", port)
        topics = [(self.topics.status, 1), (self.topics.control_ack, 1)]
        self._client.on_connect = lambda client, *_: client.subscribe(subscriptions(client, topics))
        self._client.loop_start()
        assert subscribed.wait(10.0), "the broker does not answer"
        self.wait(lambda: bool(self.status), "the gateway's status")
        self.target = Target("", "", {}, self.codec.encode(FAR), self.codec.encode(HOME))

    def _on_message(self, client, userdata, received) -> None:
        document = json.loads(received.payload)
        with self._news:
            if received.topic == self.topics.status:
                self.status, self.largest_status = document, max(self.largest_status, len(received.payload))
            else:
                self.granted += bool(document["ok"])
                self._answers[document["id"]] = document
            self._news.notify_all()

    def wait(self, condition: Callable[[], bool], what: str, timeout: float = 20.0) -> None:
        """Wait until `condition` holds."""
        with self._news:
            assert self._news.wait_for(condition, timeout), f"{what} did not come within {timeout:g} s"

    def publish(self, made: Message) -> None:
        """Publish a message and count it."""
        # paho's own: what is under test must not write the hostile messages
        beside = Properties(PacketTypes.PUBLISH) if made.pairs else None
        if beside is not None:
            beside.UserProperty = made.pairs
        topic = getattr(self.topics, made.topic)
        self._client.publish(topic, made.payload, int(made.topic != "command"), made.retain, beside)
        self.sent += 1

    def ask(self, verb: str, session: str = "", value: object = None) -> dict:
        """Send a control message and return its answer: then everything sent before it has been handled."""
        control = Control(f"marker-{self.sent}", session, verb, value)
        self.publish(Message("control", control.to_json()))
        self.wait(lambda: control.id in self._answers, f"the answer to {verb}")
        with self._news:
            return self._answers.pop(control.id)

    def marker(self) -> dict[str, int]:
        """Return the counters after everything that was sent so far."""
        self.ask("marker")
        with self._news:
            # the status came before the answer; answers to hostile ids are not kept
            self._answers.clear()
            return dict(self.status["counters"])

    def own(self) -> None:
        """Let a new owner arm the gateway; again when the controller's session has just ended for want of a processor."""
        for _ in range(10):
            if self.status["state"] not in ("ready", "armed"):
                self.ask("stop")
                self.wait(lambda: self.status["state"] in ("holding", "ready"), "rest")
            self.ask("reset", value=reset_value(self.status["run"], self.status["fault_number"]))
            ended, session = self.target.session, next(self._sessions)
            arming = arm_value(self.status["hash"], self.status["run"])
            answer = self.ask("arm", session, arming)
            if answer["ok"]:
                self.target = Target(session, ended, arming, self.target.far, self.target.held)
                return
        raise AssertionError(f"arm was refused: {answer['reason']}")

    def begin_stream(self) -> None:
        """Send the first command, at the held pose: the gateway follows, and a hostile command meets a stream."""
        properties = CommandProperties(self.target.session, 1, 10**18)
        self.publish(Message("command", self.target.held, properties.pairs()))

    def clean(self) -> None:
        """Take retained messages away."""
        for topic in ("command", "control"):
            self.publish(Message(topic, b"", retain=True))
        self.marker()

    def close(self) -> None:
        """End the connection."""
        self._client.disconnect()
        self._client.loop_stop()


def flood_mqtt(mqtt: Mqtt, count: int, seed: int) -> Counter:
    """Send `count` messages while the arm is armed or its stream runs; return what the gateway counted."""
    rng, before = random.Random(seed), Counter(mqtt.marker())
    mqtt.sent = mqtt.granted = 0
    done = 0
    while done < count:
        mqtt.own()
        if rng.random() < 0.7:
            mqtt.begin_stream()
        piece = min(MESSAGES, count - done)
        for _ in range(piece):
            mqtt.publish(message(rng, mqtt.target))
        difference = Counter(mqtt.marker()) - before
        counted = difference["commands_received"] + mqtt.granted
        counted += sum(number for name, number in difference.items() if name.startswith("refused_"))
        assert counted == mqtt.sent, f"{mqtt.sent} messages were sent, {counted} were counted: {dict(difference)}"
        done += piece
    mqtt.clean()
    return Counter(mqtt.marker()) - before


def flood_rsi(arm: Arm, mqtt: Mqtt, count: int, seed: int) -> Counter:
    """Send `count` datagrams from the controller's address, and some from a stranger's; return what the gateway counted."""
    rng, before = random.Random(seed), Counter(mqtt.marker())
    arm.recover()
    arm.sent -= 1
    begin, done = arm.sent, 0
    before["telegrams"] += 1
    while done < count:
        for _ in range(25):
            most = DATAGRAMS if rng.random() < 0.5 else 1
            piece = _packets(rng, arm.packet, min(most, count - done))
            arm.hostile(piece)
            done += len(piece)
            if done >= count:
                break
        counted = _telegrams(Counter(mqtt.marker()) - before)
        sent = arm.sent - begin
        assert counted == sent, f"{sent} datagrams were sent, {counted} were counted"
    return Counter(mqtt.marker()) - before


def _packets(rng: random.Random, packet: bytes, most: int) -> list[tuple[bytes, bool]]:
    packets, size = [], 0
    while len(packets) < most and size < BYTES:
        data = rng.randbytes(rng.randrange(300)) if rng.random() < 0.1 else mutate_telegram(packet, rng.getrandbits(62))
        packets.append((data[:LARGEST], rng.random() < 0.05))
        size += len(data[:LARGEST])
    return packets


def _telegrams(counters: Counter) -> int:
    names = ("telegrams", "telegrams_unanswered", "telegrams_repeated", "telegrams_skipped")
    refused = sum(number for name, number in counters.items() if name.startswith("telegram_refused_"))
    return refused + sum(counters[name] for name in names)


class Cycling:
    """Runs the arm at 250 Hz beside something else; the end of the block raises what went wrong meanwhile."""

    def __init__(self, arm: Arm):
        self._arm = arm
        self._ended = threading.Event()
        self._pool = ThreadPoolExecutor(1)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._ended.wait(max(0.0, due - time.monotonic())):
            due += CYCLE
            # on a busy machine the gateway may have to wait for a processor; nothing here is about speed
            assert self._arm.cycle(15.0), "a packet was not answered within 15 s"

    def __enter__(self) -> Cycling:
        self._running = self._pool.submit(self._run)
        return self

    def __exit__(self, *_) -> None:
        self._ended.set()
        with self._pool:
            self._running.result(20.0)
