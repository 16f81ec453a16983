"""The mock's node without ROS around it, on real UDP: what it says of replies that it does not take."""

from __future__ import annotations

import gc
import json
import socket
import sys
import threading
from types import SimpleNamespace

import pytest
import rospy
from processes import ROOT, wait_until

from construction_twin.core.units import CYCLE
from construction_twin.mock.program import MockSettings
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.nodes import mock_rsi as module
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder

pytestmark = pytest.mark.realtime

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
ETHERNET = (ROOT / "krl/ethernet/ctwin_ethernet.xml").read_text()
ZERO = (0.0,) * 6
NO_AK = "the reply has no AK element"


class Pc(threading.Thread):
    """Answers every packet, with the encoder and the correction [rad] that stand here at the moment."""

    def __init__(self):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.05)
        self.encoder = SensorEncoder("ImFree", AXES)
        self.stop = None
        self.correction = ZERO
        self._ended = threading.Event()

    def run(self):
        while not self._ended.is_set():
            try:
                data, source = self.socket.recvfrom(65535)
            except TimeoutError:
                continue
            ipoc = RobotDecoder(AXES).parse(data).controller_ms
            self.socket.sendto(self.encoder.encode(self.correction, ipoc, self.stop), source)

    def close(self):
        self._ended.set()
        self.join(1.0)
        self.socket.close()


class MockNode:
    """A node with its loop, and what it publishes, reports and logs."""

    def __init__(self, monkeypatch, **settings):
        self.pc = Pc()
        self.statuses, self.lines, self.ends, self.poses = [], [], [], []
        #: Whether somebody hears the poses.
        self.has_subscribers = False
        host, port = self.pc.socket.getsockname()
        settings = {"ethernet_xml": ETHERNET, "timeout": 2500} | settings
        chosen = MockSettings(gateway_host=host, gateway_port=port, **settings)
        robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
        patch = monkeypatch.setattr
        patch(rospy, "loginfo", self.lines.append)
        patch(rospy, "on_shutdown", self.ends.append)
        self._interval = sys.getswitchinterval()
        ports = SimpleNamespace(publishers={"~joint_states": self, "~status": self})
        node = module.MockRsiNode(chosen, robot, ports)
        self.diagnose = node.diagnose
        self._loop = threading.Thread(target=node.run, daemon=True)
        self.pc.start()
        self._loop.start()

    def publish(self, content, *pose):
        """Take a status, or the stamp of a pose and the pose."""
        if pose:
            self.poses.append((content, *pose))
        else:
            self.statuses.append(json.loads(content))

    def wait_for_line(self, text):
        """Return the first line of the log that holds a text."""
        return wait_until(lambda: next((line for line in self.lines if text in line), None), 60.0, text)

    def close(self):
        for end in self.ends:
            end()
        self._loop.join(2.0)
        self.pc.close()
        gc.unfreeze()
        sys.setswitchinterval(self._interval)
        assert not self._loop.is_alive()


@pytest.fixture
def start(monkeypatch):
    nodes = []

    def make(**settings):
        nodes.append(MockNode(monkeypatch, **settings))
        return nodes[-1]

    yield make
    for node in nodes:
        node.close()


def test_log_status_and_diagnostics_say_why_replies_are_refused_and_that_they_count_again(start):
    node = start()
    node.pc.encoder = SensorEncoder("ImFree", AXES, tuple(f"AKorr.{axis}" for axis in AXES))
    assert node.wait_for_line("reply refused").endswith(f": reply refused: {NO_AK}")
    # the first status may come after the first line
    wait_until(lambda: node.statuses and node.statuses[-1]["last_refusal"] == NO_AK)
    report = node.diagnose()
    assert (report.level, report.values["last_refusal"]) == (WARN, NO_AK)
    assert report.sentence == f"RSI session 1 running, replies are refused: {NO_AK}"
    assert node.statuses[-1]["state"] == "running"
    node.pc.encoder = SensorEncoder("ImFree", AXES)
    node.wait_for_line("replies count again")
    wait_until(lambda: node.diagnose().level == OK, 60.0)
    # a reply that this machine made late may be refused as well, but nothing is said cycle by cycle
    assert sum(NO_AK in line for line in node.lines) <= 2


def test_a_stop_for_command_velocity_says_value_and_limit_in_log_status_and_diagnostics(start):
    node = start()
    wait_until(lambda: node.statuses and node.statuses[-1]["counters"]["replies"] >= 20)
    node.pc.correction = (0.1, *ZERO[1:])
    line = node.wait_for_line("stopped: ")
    assert line == f"RSI session 1 stopped: {(reason := node.diagnose().sentence.removeprefix('RSI stopped: '))}"
    assert reason == f"command velocity A1: {5.729578 / CYCLE:.6g} deg/s, limit 246 deg/s (2 times 123 deg/s)"
    assert node.diagnose().level == ERROR
    wait_until(lambda: node.statuses[-1]["reason"] == reason)


def test_poses_are_handed_over_while_somebody_hears_them(start):
    node = start()
    wait_until(lambda: node.statuses and node.statuses[-1]["counters"]["replies"] >= 20)
    # with a status that is due there is a pose
    assert len(node.poses) < 20
    node.has_subscribers = True
    wait_until(lambda: len(node.poses) > 100)
    stamps = [stamp for stamp, _ in node.poses[-50:]]
    assert stamps == sorted(stamps) and all(len(q) == 6 for _, q in node.poses)
