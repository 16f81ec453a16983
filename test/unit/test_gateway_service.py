"""The gateway's sockets: real UDP on loopback, a real broker, and no ROS."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import signal
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import ROOT, wait_until
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from construction_twin.errors import TransportError
from construction_twin.mqtt.client import Broker, received_pairs, user_properties
from construction_twin.mqtt.codec import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, Topics, read_state_properties
from construction_twin.rsi.codec import RobotEncoder, parse_sensor
from construction_twin.rsi.config import GatewayConfig
from construction_twin.rsi.gateway import GatewayService, bind, main
from construction_twin.units import CYCLE, CYCLE_NS, format_allowance

AXES = ("A1", "A2")
# a controller that waits longer than a real one, because this machine may be busy
CONFIG = GatewayConfig("arm", AXES, (-0.5, -3.2), (0.5, 3.2), (2.0, 4.5), (2.34, 17.4), timeout=8.0)
#: For tests of a stream whose sender and receiver must wait for the processor now and then.
PATIENT = dataclasses.replace(CONFIG, playout_delay=0.1, silence=8.0, max_age=20.0)
CODEC = JointStringCodec(2)
START = CODEC.quantise((0.1, -1.0))
POSE = ((0.0,) * 3, (0.0,) * 3)
_prefixes = (f"test{number}" for number in itertools.count())


@pytest.fixture
def topics():
    return Topics(next(_prefixes), "arm")


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
            reply = parse_sensor(self.socket.recv(65535), "ImFree", AXES)
        except TimeoutError:
            return None
        assert reply.ipoc == self.ipoc
        return reply.correction

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
        while not self._ended.wait(0.003):
            self.cycle()

    def close(self):
        self._ended.set()
        if self.is_alive():
            self.join(5.0)
        self.socket.close()


@contextmanager
def controller_of(address):
    controller = Controller(address)
    try:
        yield controller
    finally:
        controller.close()


@contextmanager
def serving(port, topics, config=CONFIG, sock=None, **options):
    """A GatewayService in a thread; yields it and its UDP address."""
    sock = sock or bind("127.0.0.1", 0)
    protocol = options.pop("protocol", "5")
    service = GatewayService(config, sock, Broker(port=port, protocol=protocol), topics, **options)
    thread = threading.Thread(target=service.run)
    address = sock.getsockname()
    thread.start()
    try:
        yield service, address
    finally:
        service.stop()
        thread.join(10.0)
        assert not thread.is_alive()


class Client:
    """The other side on MQTT: keeps every message per topic."""

    def __init__(self, port, topics, protocol=MQTTProtocolVersion.MQTTv5):
        self.topics, self.messages = topics, []
        self.seq, self.stamp = 0, 10**18
        self._ids = itertools.count()
        subscribed = threading.Event()
        self.paho = paho.Client(CallbackAPIVersion.VERSION2, protocol=protocol)
        self.paho.on_connect = lambda client, *_: client.subscribe(f"{topics.prefix}/#", 1)
        self.paho.on_subscribe = lambda *_: subscribed.set()
        self.paho.on_message = lambda client, userdata, message: self.messages.append(message)
        self.paho.reconnect_delay_set(1, 1)
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
        control = Control(f"c{next(self._ids)}", session, verb, value)
        self.paho.publish(self.topics.control, control.to_json(), qos=1)

        def answers():
            return [
                a
                for a in map(json.loads, (m.payload for m in self.on(self.topics.control_ack)))
                if a["id"] == control.id
            ]

        return wait_until(answers, what=f"answer to {verb}")[0]

    def command(self, q):
        self.seq += 1
        self.stamp += CYCLE_NS
        beside = user_properties(CommandProperties("s1", self.seq, self.stamp).pairs())
        self.paho.publish(self.topics.command, CODEC.encode(q), properties=beside)


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


# -- RSI -------------------------------------------------------------------------------------------------------------


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_every_telegram_is_answered_without_any_broker(topics):
    with serving(free_port(), topics) as (service, address), controller_of(address) as controller:
        for _ in range(300):
            controller.cycle()
        assert controller.replies == [(0.0, 0.0)] * 300
    assert service.gateway.counters["telegrams"] == 300
    # generous, for a busy machine: half of them far quicker than a cycle
    assert service.reply_time.percentile(0.5) < 2000
    assert sum(service.reply_time.counts) == 300


def test_a_broker_that_accepts_and_then_says_nothing_delays_no_reply(topics):
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        with serving(deaf.getsockname()[1], topics) as (service, address), controller_of(address) as controller:
            connection, _ = deaf.accept()
            with connection:
                for _ in range(200):
                    controller.cycle()
            assert controller.missed == 0
        assert service.reply_time.percentile(0.5) < 2000


GARBAGE = [
    b"",
    b"\x00",
    b"\xff" * 1400,
    b"<Rob",
    b'<Sen Type="ImFree"><AK A1="1.0" A2="1.0"/><IPOC>1</IPOC></Sen>',
    b'<Rob Type="KUKA"><AIPos A1="nan" A2="0.0"/><IPOC>1000008</IPOC></Rob>',
    b'<Rob Type="KUKA"><AIPos A1="0.0" A2="0.0"/></Rob>',
    b'<!DOCTYPE a [<!ENTITY b "c">]><Rob><IPOC>1000008</IPOC></Rob>',
    b"+000.000,+000.000",
]


def test_garbage_datagrams_are_counted_unanswered_and_disturb_no_session(topics):
    with serving(free_port(), topics) as (service, address), controller_of(address) as controller:
        controller.cycle()
        for data in GARBAGE:
            controller.send(data)
        for _ in range(10):
            controller.cycle()
        assert controller.replies == [(0.0, 0.0)] * 11
        counters = service.gateway.counters
        assert sum(count for name, count in counters.items() if name.startswith("telegram_refused_")) == len(GARBAGE)
        assert counters["rsi_sessions"] == 1


def queued(topics, datagrams, config=CONFIG, sock=None):
    """Serve what had arrived before the gateway looked; return its replies' IPOCs and counters."""
    sock = sock or bind("127.0.0.1", 0)
    with controller_of(sock.getsockname()) as controller:
        for data in datagrams(controller):
            controller.send(data)
        controller.ipoc = 1_000_008
        with serving(free_port(), topics, config, sock) as (service, _):
            assert controller.receive() == (0.0, 0.0)
            controller.socket.settimeout(0.05)
            assert controller.receive() is None
    return service.gateway.counters


def test_of_several_waiting_telegrams_only_the_newest_is_answered(topics):
    counters = queued(
        topics, lambda controller: [controller.telegram(ipoc) for ipoc in (1_000_000, 1_000_004, 1_000_008)]
    )
    assert (counters["telegrams"], counters["telegrams_skipped"]) == (1, 2)


def test_garbage_behind_a_telegram_does_not_take_its_place(topics):
    counters = queued(topics, lambda controller: [controller.telegram(1_000_008), *GARBAGE])
    assert counters["telegrams"] == 1
    assert counters["telegrams_skipped"] == 0


class WindowsSocket:
    """A UDP socket as Windows has it: without recvmsg."""

    def __init__(self, sock):
        self._sock = sock
        self.fileno, self.recvfrom, self.sendto = sock.fileno, sock.recvfrom, sock.sendto
        self.getsockname, self.close = sock.getsockname, sock.close


def test_where_sockets_have_no_recvmsg_telegrams_are_answered_too(topics):
    counters = queued(
        topics, lambda controller: [controller.telegram(1_000_008)], sock=WindowsSocket(bind("127.0.0.1", 0))
    )
    assert counters["telegrams"] == 1


def test_datagrams_from_another_address_than_the_controllers_are_counted_only(topics):
    with (
        serving(free_port(), topics, controller="127.0.0.9") as (service, address),
        controller_of(address) as controller,
    ):
        controller.send()
        wait_until(lambda: service.gateway.counters["telegram_refused_address"] == 1)
        controller.socket.settimeout(0.05)
        assert controller.receive() is None
        assert service.gateway.counters["rsi_sessions"] == 0


def test_a_taken_port_is_one_sentence():
    with bind("127.0.0.1", 0) as sock:
        port = sock.getsockname()[1]
        with pytest.raises(
            TransportError, match=rf"cannot listen for RSI on UDP 127\.0\.0\.1:{port}: .*may hold the port"
        ):
            bind("127.0.0.1", port)


def test_an_address_that_is_not_ours_is_the_same_sentence():
    with pytest.raises(TransportError, match="the address is not this machine's"):
        bind("192.0.2.1", 49152)


# -- MQTT ------------------------------------------------------------------------------------------------------------


def test_an_armed_gateway_carries_out_the_stream_and_reports_states(broker, topics):
    with cell(broker, topics, config=PATIENT) as (service, controller, client):
        answer = client.control("arm", PATIENT.hash)
        assert (answer["ok"], answer["verb"], answer["session"]) == (True, "arm", "s1")
        assert client.status()["state"] == "armed"
        stream(client, controller, (motion(k) for k in range(200)))
        last = CODEC.quantise(motion(199))
        stream(client, controller, [last] * 30)
        wait_until(
            lambda: controller.measured == pytest.approx(last, abs=math.radians(1e-6)), what="the end of the motion"
        )
        assert_still(controller)
        assert service.gateway.counters["commands_lost"] == 0
        states = [
            message
            for message in client.on(topics.state)
            if read_state_properties(received_pairs(message)).command_stamp
        ]
        assert CODEC.decode(states[-1].payload) == pytest.approx(last, abs=math.radians(0.0006))
        properties = [read_state_properties(received_pairs(message)) for message in states]
        assert all(later.seq > earlier.seq for earlier, later in itertools.pairwise(properties))
        assert 10**18 < properties[-1].command_stamp <= client.stamp


def test_the_state_after_a_verb_is_told_before_its_answer(broker, topics):
    with cell(broker, topics) as (service, controller, client):
        client.control("arm", CONFIG.hash)
        order = [message.topic for message in client.messages if message.topic in (topics.status, topics.control_ack)]
        payloads = [json.loads(message.payload) for message in client.on(topics.status)]
        before = order[: order.index(topics.control_ack)]
        assert payloads[len(before) - 1]["state"] == "armed"


def test_a_wrong_hash_is_answered_with_the_reason_and_arms_nothing(broker, topics):
    with cell(broker, topics) as (service, controller, client):
        answer = client.control("arm", "0" * 64)
        assert not answer["ok"]
        assert CONFIG.hash in answer["reason"]
        assert service.gateway.status()["state"] == "ready"


def test_garbage_on_mqtt_moves_nothing_and_is_counted(broker, topics):
    with cell(broker, topics) as (service, controller, client):
        client.control("arm", CONFIG.hash)
        garbage = [b"", b"\x00\xff", b"{}", b"nan,nan", b"+010.000,+010.000", b"x" * 5000]
        for payload in garbage:
            client.paho.publish(topics.command, payload)
            client.paho.publish(topics.command, payload, properties=user_properties([("session", "s1"), ("seq", "-1")]))
        controls = [
            b"",
            b"{",
            b"[]",
            b"null",
            b'{"id": 1}',
            b"[" * 5000,
            b"\xff",
            b'{"id": "a", "session": "s", "verb": 5}',
        ]
        for payload in controls:
            client.paho.publish(topics.control, payload, qos=1)
        client.wait_for_counter("refused_control", len(controls))
        client.wait_for_counter("refused_properties", 2 * len(garbage))
        assert_still(controller)
        assert controller.measured == pytest.approx(START)
        assert service.gateway.status()["state"] == "armed"


def test_a_gateway_without_a_stream_brakes_and_keeps_answering(broker, topics):
    with cell(broker, topics) as (service, controller, client):
        client.control("arm", CONFIG.hash)
        stream(client, controller, (motion(k) for k in range(100)))
        client.wait_for_status(state="holding")
        assert_still(controller)
        assert controller.missed == 0
        assert not client.control("arm", CONFIG.hash, "s2")["ok"]
        assert client.control("reset")["ok"]
        assert client.control("arm", CONFIG.hash, "s2")["ok"]


@pytest.mark.parametrize("name", ["command", "control"])
def test_messages_retained_before_the_gateway_came_are_refused(broker, topics, name):
    topic = getattr(topics, name)
    with client_of(broker, topics) as client:
        payload = Control("old", "s1", "stop").to_json() if name == "control" else CODEC.encode(START)
        client.paho.publish(topic, payload, qos=1, retain=True).wait_for_publish(5.0)
        with serving(broker, topics):
            client.wait_for_counter("refused_retained", 1)
        assert not client.on(topics.control_ack)


def test_a_retained_message_is_refused_when_it_comes_live_too(broker, topics):
    with cell(broker, topics) as (service, controller, client):
        arm = Control("live", "s1", "arm", CONFIG.hash)
        client.paho.publish(topics.control, arm.to_json(), qos=1, retain=True)
        client.wait_for_counter("refused_retained", 1)
        assert service.gateway.status()["state"] == "ready"
        client.paho.publish(topics.control, b"", qos=1, retain=True)


def test_the_status_is_there_for_whoever_comes_later(broker, topics):
    with cell(broker, topics):
        with client_of(broker, topics) as late:
            late.wait_for_status(state="ready", hash=CONFIG.hash, decimals=3, properties=True)
            assert late.on(topics.status)[0].retain
            assert {"p50", "p99", "p99_9", "max"} <= set(late.status()["reply_us"])


def test_a_stopped_gateway_says_that_it_is_offline(broker, topics):
    with client_of(broker, topics) as client:
        with serving(broker, topics):
            client.wait_for_status(state="no_controller")
        client.wait_for_status(state="offline", reason="gateway stopped")


def test_when_the_broker_dies_the_arm_brakes_replies_go_on_and_the_gateway_comes_back(broker_process, topics):
    with cell(broker_process.port, topics) as (service, controller, client):
        client.control("arm", CONFIG.hash)
        stream(client, controller, (motion(k) for k in range(100)))
        broker_process.kill()
        wait_until(lambda: service.gateway.status()["state"] == "holding", what="holding")
        assert_still(controller)
        client.messages.clear()
        broker_process.start()
        client.wait_for_status(state="holding")
        assert controller.missed == 0
        assert client.control("reset")["ok"]


def test_with_mqtt_3_1_1_the_string_alone_moves_the_arm(broker, topics):
    config = dataclasses.replace(PATIENT, properties=False)
    with serving(broker, topics, config, protocol="3.1.1") as (service, address), controller_of(address) as controller:
        with client_of(broker, topics, protocol=MQTTProtocolVersion.MQTTv311) as client:
            controller.start()
            client.wait_for_status(state="ready", properties=False)
            assert client.control("arm", config.hash)["ok"]
            begin = len(controller.replies)
            for k in range(150):
                client.paho.publish(topics.command, CODEC.encode(motion(min(k, 100))))
                wait_until(lambda: len(controller.replies) > begin + k, what="the next cycle")
            end = CODEC.quantise(motion(100))
            wait_until(
                lambda: controller.measured == pytest.approx(end, abs=math.radians(1e-6)), what="the end of the motion"
            )
            assert CODEC.decode(client.on(topics.state)[-1].payload)


# -- the program -----------------------------------------------------------------------------------------------------


@pytest.fixture
def config_file(tmp_path):
    path = tmp_path / "arm.json"
    path.write_text(CONFIG.to_json())
    return str(path)


@contextmanager
def program(config_file, port, topics):
    """The gateway as a process of its own; yields it and its UDP address."""
    with bind("127.0.0.1", 0) as sock:
        address = sock.getsockname()
    command = [
        sys.executable,
        "-m",
        "construction_twin.rsi.gateway",
        "--config",
        config_file,
        "--prefix",
        topics.prefix,
    ]
    command += ["--listen", "%s:%d" % address, "--broker", f"127.0.0.1:{port}"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield process, address
    finally:
        process.kill()
        process.communicate(timeout=10.0)


def test_a_killed_gateway_is_declared_offline_by_its_last_will(broker, topics, config_file):
    with client_of(broker, topics) as client, program(config_file, broker, topics) as (process, _):
        client.wait_for_status(state="no_controller")
        process.kill()
        client.wait_for_status(state="offline", reason="connection lost")
    with client_of(broker, topics) as late:
        late.wait_for_status(state="offline")


def test_sigterm_ends_the_program_cleanly(broker, topics, config_file):
    with client_of(broker, topics) as client, program(config_file, broker, topics) as (process, address):
        client.wait_for_status(state="no_controller")
        with controller_of(address) as controller:
            controller.cycle()
            assert controller.replies == [(0.0, 0.0)]
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate(timeout=10.0)
        assert process.returncode == 0
        assert f"configuration {CONFIG.hash[:12]}" in log
        assert "ready: RSI session began" in log
        client.wait_for_status(state="offline", reason="gateway stopped")


def test_ended_in_mid_motion_it_brakes_the_arm_before_it_goes(broker, topics):
    with cell(broker, topics, config=PATIENT) as (service, controller, client):
        assert client.control("arm", PATIENT.hash)["ok"]
        stream(client, controller, (motion(k) for k in range(200)))
        count = len(controller.replies)
        service.stop()
        client.wait_for_status(state="offline", reason="gateway stopped")
        replies = [reply for reply in controller.replies[count:] if reply is not None]
    steps = [b[0] - a[0] for a, b in itertools.pairwise(replies)]
    budget = PATIENT.acceleration[0] * CYCLE**2 + 2 * math.radians(2e-6)
    assert abs(steps[0]) > 5 * budget
    assert steps[-1] == 0.0
    fastest = max(abs(b - a) for a, b in itertools.pairwise(steps[2:]))
    assert fastest <= budget + format_allowance(PATIENT.decimals) * CYCLE**2


def test_a_log_that_nobody_reads_holds_up_no_reply(broker, topics, config_file):
    with program(config_file, broker, topics) as (process, address), client_of(broker, topics) as client:
        client.wait_for_status(state="no_controller")
        # every refused control is a log line; together they are far more than a pipe holds
        for _ in range(1500):
            client.paho.publish(topics.control, b"x" * 100, qos=1)
        client.wait_for_counter("refused_control", 1500, timeout=30.0)
        with controller_of(address) as controller:
            for _ in range(20):
                controller.cycle()
            assert controller.replies == [(0.0, 0.0)] * 20


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--listen", "here"], ("--listen", "'here'", "HOST:PORT")),
        (["--listen", "127.0.0.1:0"], ("--listen", "'127.0.0.1:0'", "HOST:PORT")),
        (["--listen", "127.0.0.1:TAKEN"], ("cannot listen for RSI on UDP 127.0.0.1:TAKEN", "may hold the port")),
        (["--broker", "1883"], ("--broker", "'1883'", "HOST:PORT")),
        (["--prefix", "a/b"], ("prefix", "'a/b'", "letters, digits")),
        (["--config", "/nowhere.json"], ("/nowhere.json", "No such file", "export_gateway_config")),
    ],
)
def test_what_cannot_work_is_one_sentence_and_exit_code_2(config_file, arguments, said):
    with bind("127.0.0.1", 0) as sock:
        taken = str(sock.getsockname()[1])
        arguments = [argument.replace("TAKEN", taken) for argument in arguments]
        command = [sys.executable, "-m", "construction_twin.rsi.gateway", "--config", config_file, *arguments]
        result = subprocess.run(command, capture_output=True, text=True, timeout=60.0)
    assert result.returncode == 2
    for words in said:
        assert words.replace("TAKEN", taken) in result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_without_a_configuration_file_it_does_not_start(capsys):
    with pytest.raises(SystemExit) as caught:
        main([])
    assert caught.value.code == 2
    assert "--config" in capsys.readouterr().err


#: Only the standard library, paho and this package can be imported: what a cell PC has.
_CELL_PC = """
import runpy, sys
class CellPc:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top not in ("paho", "construction_twin"):
            raise ModuleNotFoundError(f"{name} is not on the cell PC")
sys.meta_path.insert(0, CellPc())
sys.path[:0] = sys.argv[1:3]
module, sys.argv = sys.argv[3], sys.argv[3:]
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""


def on_the_cell_pc(module, *arguments):
    site = str(Path(paho.__file__).parents[2])
    command = [sys.executable, "-S", "-E", "-c", _CELL_PC, str(ROOT / "src"), site, module, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, cwd="/")


def test_the_gateway_needs_nothing_but_the_standard_library_and_paho(config_file):
    result = on_the_cell_pc("construction_twin.rsi.gateway", "--help")
    assert result.returncode == 0, result.stderr
    assert "--config" in result.stdout
    # beyond --help: it reads its configuration and gets as far as the socket
    with bind("127.0.0.1", 0) as sock:
        listen = "127.0.0.1:%d" % sock.getsockname()[1]
        result = on_the_cell_pc("construction_twin.rsi.gateway", "--config", config_file, "--listen", listen)
    assert result.returncode == 2
    assert "cannot listen for RSI" in result.stderr


@pytest.mark.parametrize("module", ["numpy", "yaml", "rospy", "construction_twin.robot"])
def test_the_cell_pc_of_this_test_really_lacks_the_rest(module):
    result = on_the_cell_pc(module)
    assert result.returncode != 0
    assert "is not on the cell PC" in result.stderr
