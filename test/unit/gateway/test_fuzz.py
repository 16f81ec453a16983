"""Hostile messages and telegrams at a running gateway; `make test ARGS=fuzz` sends a million of each.

The gateway is a process of its own, broker and UDP are real, and no reply may move the arm. What is sent is sent in pieces, and a
marker after each: when the gateway has answered it, everything before was handled, so that UDP and QoS 0 drop nothing and every
single message must be found in a counter.
"""

from __future__ import annotations

import dataclasses
import json
import os
import random
import re
import select
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
import service_cell
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from processes import wait_until
from service_cell import CODEC, START, Client, Controller

from construction_twin.core.network import bind
from construction_twin.core.units import CYCLE
from construction_twin.mqtt.messages import CommandProperties, arm_value
from construction_twin.rsi.controller_codec import SensorDecoder

pytestmark = pytest.mark.realtime
COUNT, SEED = int(os.environ.get("FUZZ_COUNT", "2000")), int(os.environ.get("FUZZ_SEED", "3"))
#: The process may have grown by this much after the first tenth: allocator noise. And the status stays this small [bytes].
GROWTH, STATUS = 8 << 20, 8192
#: A stream that falls silent is not given up within a piece.
CONFIG = dataclasses.replace(service_cell.CONFIG, silence=5.0, playout_delay_max=0.4)
FAR = (-0.3, 1.0)
#: Messages of a piece; datagrams and bytes that wait in the gateway's socket at most, and the largest of UDP.
MESSAGES, DATAGRAMS, BYTES, LARGEST = 500, 40, 60_000, 65_507
#: In place of a property, or its name; of a value of a control message; put into a payload, a telegram, one of its values.
TEXTS = ("", "-1", "1.0", " 1", "9" * 40, "18446744073709551616", "nan", "\u0663", "1_000", "a" * 5000, "session")
VALUES = (None, True, -1, 1e308, 10**30, "x" * 1500, "\ud7ff", [[]], {"a": {"b": 1}})
PARTS = (b"\x00", b"\xff", b"\xc3\x28", b"+", b",", b"nan", b"1e5", b"{", b"[" * 1500, b'"', b"\\ud800", b"9" * 5000)
VERBS = ("arm", "stop", "reset", "end", "speed_limit", "fly", "ARM", "")
TAGS = (
    b"<!DOCTYPE a>",
    b"<!--x-->",
    b"<?x?>",
    b"&lt;",
    b"&a;",
    b"<![CDATA[1]]>",
    b"\0",
    b"\xc3\xa9",
    b"<a>",
    b"</Rob>",
)
NUMBERS = (b"nan", b"inf", b"1e5", b"", b" ", b"1,5", b"0x1", b"9" * 400, b"-", b"1.", b"1_0", b"\xd9\xa1", b"+1.5")


class Arm(Controller):
    """A controller in lock step with the gateway: a packet, its reply, the next packet. No reply may move it."""

    def __init__(self, address):
        super().__init__(address)
        self.sent = 0
        self.stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def cycle(self, patience=0.5):
        """Send a packet; return whether it is answered in time [s]."""
        self.ipoc += 4
        self.packet = self.telegram()
        self.shoot(self.packet)
        deadline = time.monotonic() + patience
        while (left := deadline - time.monotonic()) > 0:
            self.socket.settimeout(left)
            try:
                reply = SensorDecoder("ImFree", service_cell.AXES).parse(self.socket.recv(65535))
            except TimeoutError:
                break
            assert not any(reply.target), f"IPOC {reply.controller_ms} was answered with a motion: {reply.target}"
            if reply.controller_ms == self.ipoc:
                return True
        return False

    def recover(self):
        """Cycle until replies come: a hostile packet may have made the gateway wait for a new session."""
        assert any(self.cycle() for _ in range(20)), "20 packets in a row were not answered"

    def shoot(self, data, sock=None):
        (sock or self.socket).sendto(data, self.address)
        self.sent += 1

    @contextmanager
    def beside(self):
        """Cycle at 250 Hz beside something else; the end of the block raises what went wrong meanwhile."""
        ended = threading.Event()

        def run():
            due = time.monotonic()
            while not ended.wait(max(0.0, due - time.monotonic())):
                due += CYCLE
                # on a busy machine the gateway may have to wait for a processor; nothing here is about speed
                assert self.cycle(15.0), "a packet was not answered within 15 s"

        with ThreadPoolExecutor(1) as pool:
            running = pool.submit(run)
            try:
                yield
            finally:
                ended.set()
            running.result(20.0)


class Sender(Client):
    """The hostile sender, the owner of the stream and the observer of counters, on one connection: so their order is kept."""

    def __init__(self, port, topics):
        super().__init__(port, topics)
        self.sent = self.owners = 0
        self.session = self.ended = ""
        self.arming = {}
        wait_until(self.status, what="the gateway's status")

    def publish(self, topic, payload, pairs=(), retain=False):
        beside = Properties(PacketTypes.PUBLISH) if pairs else None
        if beside is not None:
            beside.UserProperty = list(pairs)
        self.paho.publish(topic, payload, int(topic != self.topics.command), retain, beside)
        self.sent += 1

    def control(self, verb, value=None, session="s1"):
        self.sent += 1
        return super().control(verb, value, session)

    def counters(self):
        """Return the counters after everything that was sent so far, and the number of requests granted."""
        self.control("marker")
        granted = sum(json.loads(message.payload)["ok"] for message in self.on(self.topics.control_ack))
        assert max(len(message.payload) for message in self.on(self.topics.status)) <= STATUS
        # the status came before the answer
        self.messages = self.on(self.topics.status)[-1:]
        return Counter(self.status()["counters"]), granted

    def own(self):
        """Let a new owner arm the gateway; again when the controller's session has just ended for want of a processor."""
        for _ in range(10):
            if self.status()["state"] not in ("ready", "armed"):
                self.control("stop")
                wait_until(lambda: self.status()["state"] in ("holding", "ready"), what="rest")
            self.control("reset")
            self.owners += 1
            self.ended, self.session = self.session, f"owner{self.owners}"
            self.arming = arm_value(CONFIG.hash, self.status()["run"])
            answer = self.control("arm", self.arming, self.session)
            if answer["ok"]:
                return
        raise AssertionError(f"arm was refused: {answer['reason']}")


def hostile(rng, sender):
    """Publish a malformed or hostile message; never a valid command of the armed session, which access rules keep off."""
    session = rng.choice((sender.session, sender.ended, "another", ""))
    pairs, topic = [], sender.topics.control
    if rng.random() < 0.7:
        topic = sender.topics.command
        payload = CODEC.encode(FAR if session == sender.session else rng.choice((FAR, START)))
        seq, stamp = rng.choice((1, 2, 70, 10**6, rng.randrange(10**19))), rng.randrange(10**19)
        pairs = [("session", session), ("seq", str(seq)), ("stamp", str(stamp))]
        for _ in range(rng.choice((0, 0, 1, 3))):
            place = rng.randrange(len(pairs) or 1)
            other = (rng.choice(TEXTS), rng.choice(TEXTS))
            pairs[place : place + 1] = rng.choice(([], [other], [("extra", "1")] * rng.choice((2, 200))))
    else:
        # the right value only from who is armed already, or had its turn: arming anew is the access rules' business
        value = sender.arming if session in (sender.session, sender.ended) else rng.choice((None, "0" * 64, 1.0, []))
        document = {"id": str(rng.randrange(10**6)), "session": session, "verb": rng.choice(VERBS), "value": value}
        for name in rng.sample(list(document), rng.choice((0, 0, 1, 2))):
            document[rng.choice((name, "extra", "x" * 300))] = rng.choice(VALUES)
        payload = json.dumps(document).encode()
    if rng.random() < 0.6:
        payload = bytearray(payload)
        for _ in range(rng.randint(1, 3)):
            place, end = sorted(min(len(payload), rng.randrange(len(payload) + 12)) for _ in range(2))
            payload[place:end] = rng.choice(
                (b"", rng.choice(PARTS), payload[place:end] * 7, rng.randbytes(end - place))
            )
    sender.publish(topic, bytes(payload)[:60_000], pairs, rng.random() < 0.02)


def hostile_telegram(rng, packet):
    """Return a telegram as a faulty or hostile sender makes it: its elements, its attributes, its values, its bytes."""
    if rng.random() < 0.1:
        return rng.randbytes(rng.randrange(300))
    tokens = re.findall(rb"<[^>]*>|[^<>]+", packet)
    for _ in range(rng.randint(1, 3)):
        place, other = rng.randrange(len(tokens)), rng.randrange(len(tokens))
        token = tokens[place]
        value = b'"' + rng.choice(NUMBERS) + b'"'
        tokens[place : place + 1] = rng.choice(
            (
                lambda: [],
                lambda: [token, token],
                lambda: [rng.choice(TAGS), token],
                lambda: [re.sub(rb'"[^"]*"', value, token, count=rng.randint(0, 2))],
                lambda: [rng.choice(NUMBERS)],
                lambda: [tokens[other]],
                lambda: [re.sub(rb' \w+="[^"]*"', b"", token, count=1)],
                lambda: [token[: rng.randrange(len(token) + 1)]],
                lambda: [token * rng.choice((2, 50, 3000))],
            )
        )()
        if not tokens:
            return b""
    return b"".join(tokens)[:LARGEST]


def flood_mqtt(sender, arm, count, seed):
    """Send messages while the arm is armed or its stream runs; return what the gateway counted."""
    rng = random.Random(seed)
    with arm.beside():
        begun, _ = sender.counters()
        sender.sent = granted = 0
        for done in range(0, count, MESSAGES):
            sender.own()
            if rng.random() < 0.7:
                # the first command, at the held pose: the gateway follows, and a hostile command meets a stream
                sender.publish(
                    sender.topics.command, CODEC.encode(START), CommandProperties(sender.session, 1, 10**18).pairs()
                )
            for _ in range(min(MESSAGES, count - done)):
                hostile(rng, sender)
            now, more = sender.counters()
            granted, told = granted + more, now - begun
            counted = granted + told["commands_received"]
            counted += sum(number for name, number in told.items() if name.startswith("refused_"))
            assert counted == sender.sent, f"{sender.sent} messages were sent, {counted} were counted: {dict(told)}"
        for topic in (sender.topics.command, sender.topics.control):
            sender.publish(topic, b"", retain=True)
        return sender.counters()[0] - begun


def flood_rsi(sender, arm, count, seed):
    """Send datagrams from the controller's address, and some from a stranger's; return what the gateway counted."""
    rng = random.Random(seed)
    arm.recover()
    begun, _ = sender.counters()
    arm.sent = done = 0
    while done < count:
        for _ in range(25):
            piece = []
            most = min(DATAGRAMS if rng.random() < 0.5 else 1, count - done)
            while len(piece) < most and sum(map(len, piece)) < BYTES:
                piece.append(hostile_telegram(rng, arm.packet))
            for data in piece:
                arm.shoot(data, arm.stranger if rng.random() < 0.05 else None)
            if len(piece) == 1:
                # of several that wait the gateway answers the newest: a single one is given time to be answered alone
                select.select([arm.socket], [], [], 0.002)
            arm.recover()
            done += len(piece)
            if done >= count:
                break
        told = sender.counters()[0] - begun
        names = ("telegrams", "telegrams_unanswered", "telegrams_repeated", "telegrams_skipped")
        counted = sum(number for name, number in told.items() if name.startswith("telegram_refused_") or name in names)
        assert counted == arm.sent, f"{arm.sent} datagrams were sent, {counted} were counted: {dict(told)}"
    return told


def resident(process):
    """Return a process' resident memory [bytes]."""
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text())[1]) * 1024


@pytest.mark.timeout(0 if COUNT > 10_000 else 300)
def test_a_running_gateway_counts_all_moves_nothing_and_does_not_grow(broker, topics, tmp_path):
    (tmp_path / "fuzz.json").write_text(CONFIG.to_json())
    with bind("127.0.0.1", 0) as sock:
        address = sock.getsockname()
    command = [sys.executable, "-m", "construction_twin.gateway", "--config", str(tmp_path / "fuzz.json")]
    command += ["--listen", f"127.0.0.1:{address[1]}", "--broker", f"127.0.0.1:{broker}", "--prefix", topics.prefix]
    log = tmp_path / "gateway.log"
    with log.open("w") as output:
        gateway = subprocess.Popen(command, stderr=output)
    arm = Arm(address)
    told = []
    try:
        wait_until(arm.cycle, what="a reply of the gateway")
        sender = Sender(broker, topics)
        for flood in (flood_mqtt, flood_rsi):
            flood(sender, arm, COUNT // 10, SEED + 1)
            before = resident(gateway)
            told.append(flood(sender, arm, COUNT, SEED))
            assert resident(gateway) - before <= GROWTH
        sender.close()
        gateway.terminate()
        assert gateway.wait(10.0) == 0
    finally:
        print(f"the gateway, which had ended with {gateway.poll()}, said: {log.read_text(errors='replace')[-2000:]}")
        gateway.kill()
        gateway.wait(10.0)
        arm.close()
        arm.stranger.close()
    assert "Traceback" not in log.read_text(errors="replace")
    messages, telegrams = told
    print(messages, telegrams)
    # the refusals that the mutations are made for
    for name in ("session", "control", "properties", "verb", "retained", "not_armed"):
        assert messages[f"refused_{name}"], name
    for name in ("telegram_refused_xml", "telegram_refused_ipoc", "telegram_refused_source", "telegrams"):
        assert telegrams[name], name
