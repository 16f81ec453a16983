"""Bare mode over a real broker: the bridge, and the PLC of examples/plc as a process of its own."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import threading
import time
from collections import deque

import pytest
import rospy
from bridge_bench import Refusals, open_node_io
from construction_twin.srv import ActAsSeenRequest
from processes import ROOT, BrokerProcess, wait_until
from site_broker import Listener, SiteBroker
from unplugged import ask

from construction_twin.core.units import CYCLE
from construction_twin.link.observations import LinkState
from construction_twin.mqtt.client import Broker, make_client, unique_id
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import Topics
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.nodes.mqtt_bridge import NODE, MqttBridge, Settings
from construction_twin.ros.nodes.rsi_gateway import gateway_config

ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
CODEC = JointStringCodec.of(ROBOT, 3)
HOME = CODEC.quantise(ROBOT.home)
#: Cycles that the PLC keeps strings for: this machine may be busy.
DELAY = 15
#: Change of the speed per cycle while it turns: 72 deg/s^2 [rad].
CHANGE = 2e-5


class Cell:
    """A bridge whose twin is where it is told to be, and a PLC process, on one broker."""

    def __init__(self, port: int, prefix: str):
        self.topics, self.broker = Topics(prefix, "kr120"), Broker(port=port)
        settings = Settings(
            arm="mock", host="127.0.0.1", port=port, prefix=prefix, gateway_kind="plc", reset_timeout=5.0,
            max_state_age=0.1,
        )  # fmt: skip
        self.client = make_client(self.broker, unique_id("kr120", "bridge"), self.topics.bridge_status, direct=True)
        self.refusals = Refusals(None)
        ports = open_node_io(self.refusals)
        self.physical, self.links = ports.publishers["physical/joint_states"], ports.publishers["link"]
        self.bridge = MqttBridge(
            settings, self.topics, gateway_config(ROBOT, {}), CODEC, self.broker, self.client, ports
        )
        self.target = HOME
        # what is sent next, a pose per string
        self._path: deque[tuple[float, ...]] = deque()
        self.plc: subprocess.Popen | None = None
        self._running = True
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._poll, self._command)]

    def __enter__(self) -> Cell:
        self.bridge.connect()
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._running = False
        for thread in self._threads:
            thread.join(5.0)
        self.client.disconnect()
        self.client.loop_stop()
        self.end_plc(signal.SIGKILL)

    def start_plc(self) -> None:
        command = [sys.executable, str(ROOT / "examples/plc/bare_plc.py"), "--broker", f"127.0.0.1:{self.broker.port}"]
        command += ["--topics", f"{self.topics.prefix}/kr120", "--delay", str(DELAY)]
        self.plc = subprocess.Popen(command, stdout=subprocess.DEVNULL)

    def end_plc(self, number: int) -> None:
        if self.plc is not None:
            self.plc.send_signal(number)
            self.plc.wait(10.0)
            self.plc = None

    def _poll(self) -> None:
        while self._running:
            self.bridge.poll()
            time.sleep(0.02)

    def _command(self) -> None:
        due = time.monotonic()
        while self._running:
            try:
                self.target = self._path.popleft()
            except IndexError:
                pass  # it rests
            self.bridge.on_command(time.time_ns(), self.target)
            due = max(due + CYCLE, time.monotonic() - 0.05)
            time.sleep(max(0.0, due - time.monotonic()))

    @property
    def pose(self) -> tuple[float, ...]:
        """The arm's pose as the bridge heard it last."""
        return self.physical[-1][1]

    @property
    def link(self):
        """The last report."""
        return self.links[-1][0]

    def wait_for(self, state: LinkState) -> None:
        wait_until(lambda: self.bridge.link is state, 20.0, f"{state}; it is {self.bridge.link}")

    def arm(self) -> str:
        """Take the pose of the arm, and arm as soon as it rests; again when this machine did not run one of the two in time."""
        answers = []

        def is_armed() -> bool:
            self.wait_for(LinkState.NEEDS_RESET)
            self.target = self.pose
            answers.append(ask(NODE, self.bridge, "~act_as_seen", ActAsSeenRequest(act="arm", person="Ada")))
            return answers[-1].success

        wait_until(is_armed, 30.0, "an armed PLC")
        return answers[-1].message

    def turn(self, degrees: float) -> None:
        """Move A1 by an angle at a tenth of its speed, beginning again where the machine's pauses stop it; wait for the end."""
        goal = CODEC.quantise((self.target[0] + math.radians(degrees), *self.target[1:]))
        deadline = time.monotonic() + 30.0
        self._path.extend(self._way_to(goal))
        while self.pose != goal:
            assert time.monotonic() < deadline, f"at {self.pose}, target {self.target}, {self.link.reason}"
            if self.bridge.link is not LinkState.ARMED:
                self._path.clear()
                self.arm()
                self._path.extend(self._way_to(goal))
            time.sleep(CYCLE)

    def _way_to(self, goal):
        """Return the strings' poses from here to there: it stops in steps that shrink by as much as they grew."""
        at, speed, poses = self.target[0], 0.0, []
        while abs(goal[0] - at) > 1e-9:
            way = goal[0] - at
            most = max(math.sqrt(2.0 * CHANGE * abs(way)) - CHANGE, CHANGE)
            speed = math.copysign(min(abs(speed) + CHANGE, math.radians(0.02), most, abs(way)), way)
            at += speed
            poses.append(CODEC.quantise((at, *goal[1:])))
        return poses


@pytest.fixture(scope="module")
def mosquitto():
    broker = BrokerProcess()
    broker.start()
    yield broker.port
    broker.kill()


@pytest.fixture
def cell(mosquitto, topics, monkeypatch):
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(1))
    with Cell(mosquitto, topics.prefix) as cell:
        yield cell


def test_a_person_arms_the_plc_it_follows_and_stops_on_silence(cell):
    # an old string that the broker kept must not move it
    far = CODEC.encode((HOME[0] + 0.5, *HOME[1:]))
    wait_until(cell.client.is_connected, what="a connection")
    cell.client.publish(cell.topics.command, far, 1, True).wait_for_publish(5.0)
    cell.wait_for(LinkState.GATEWAY_OFFLINE)
    cell.start_plc()
    cell.wait_for(LinkState.NEEDS_RESET)
    assert cell.pose == HOME
    refused = ask(NODE, cell.bridge, "~act_as_seen", ActAsSeenRequest(act="arm", person=""), cell.refusals.refuse)
    assert not refused.success and "--responsible NAME" in refused.message
    assert "Ada is responsible for what is not checked: " in cell.arm()
    cell.turn(4.0)
    assert cell.pose == cell.target != HOME
    # in mid-motion the strings end
    mover = threading.Thread(target=cell.turn, args=(-3.0,))
    start = cell.pose
    mover.start()
    wait_until(lambda: abs(cell.pose[0] - start[0]) > math.radians(0.5), 20.0, "a motion")
    assert "brakes on silence" in cell.bridge.on_halt(None).message
    # `turn` arms again by itself, as Ada would
    mover.join(60.0)
    assert not mover.is_alive() and cell.pose == cell.target
    assert cell.refusals.refused == {"ReviewError": 1}


def test_a_plc_that_dies_or_ends_is_offline_by_its_word(cell):
    cell.start_plc()
    cell.arm()
    cell.end_plc(signal.SIGKILL)
    cell.wait_for(LinkState.GATEWAY_OFFLINE)
    wait_until(lambda: cell.link.text == "GATEWAY_OFFLINE", what="a report")
    assert "offline" in cell.link.reason and cell.link.responsible == ""
    cell.start_plc()
    cell.arm()
    cell.end_plc(signal.SIGTERM)
    cell.wait_for(LinkState.GATEWAY_OFFLINE)


def test_with_a_site_s_gateway_account_it_says_its_word_and_its_pose(tmp_path):
    site = SiteBroker(tmp_path)
    site.start()
    account = site.account("one-gateway")
    command = [sys.executable, str(ROOT / "examples/plc/bare_plc.py"), "--broker", f"localhost:{site.site.port}"]
    command += ["--topics", "twin/one", "--user", account.user, "--password-file", account.password_file]
    plc = subprocess.Popen([*command, "--ca-file", account.ca_file], stdout=subprocess.DEVNULL)
    try:
        viewer = Listener(site.broker(site.account("vic")), "twin/one/#")
        wait_until(lambda: ("twin/one/status", b"ready") in viewer.messages, 20.0, "`ready`")
        wait_until(lambda: ("twin/one/state", CODEC.encode(HOME)) in viewer.messages, what="a pose")
        plc.send_signal(signal.SIGTERM)
        wait_until(lambda: ("twin/one/status", b"offline") in viewer.messages, what="`offline`")
        assert plc.wait(10.0) == 0
        viewer.close()
    finally:
        plc.kill()
        plc.wait(5.0)
        site.stop()
