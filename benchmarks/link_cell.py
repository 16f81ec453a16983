"""Gateways and mock controllers for the link benchmark, and a commander that speaks MQTT only."""

from __future__ import annotations

import json
import math
import select
import socket
import sys
import time

import yaml
from link_mqtt import MqttEnd, publish_packet, read_publish
from link_world import ROBOT_YAML, ROOT, XACRO, World, free_port

from construction_twin.core.histogram import percentile
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, Topics, arm_value
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.nodes.rsi_gateway import gateway_config

PREFIX = "twin"


def gateway_settings() -> dict:
    """Return config/gateway.yaml with what the launch files add."""
    settings = yaml.safe_load((ROOT / "config" / "gateway.yaml").read_text())
    return settings | {"decimals": 3, "ethernet_xml": (ROOT / "krl/ethernet/ctwin_ethernet.xml").read_text()}


def shipped_config() -> tuple[GatewayConfig, tuple[float, ...]]:
    """Return the gateway configuration of this package's robot, and its home [rad]."""
    robot = read_robot_files(XACRO, ROBOT_YAML)
    return gateway_config(robot, gateway_settings()), tuple(robot.home)


def pose_at(home: tuple[float, ...], cycle: int) -> tuple[float, ...]:
    """Return the pose of a slow motion of A1, from rest at `home`, well inside the limits [rad]."""
    return (home[0] + 0.1 * (1.0 - math.cos(1.5 * cycle * CYCLE)), *home[1:])


class Cell:
    """A gateway and a mock controller, each a process.

    Args:
        world: With a broker.
        realtime: SCHED_FIFO priority of the 250 Hz path; these two get 10 more, as in launch/bringup.launch.
    """

    def __init__(self, world: World, config: GatewayConfig, realtime: int):
        path = world.folder / "gateway.json"
        path.write_text(config.to_json())
        listen = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
        broker, priority = f"127.0.0.1:{world.broker_port}", realtime and realtime + 10
        options: dict[str, dict[str, object]] = {
            "gateway": {"--config": path, "--listen": listen, "--broker": broker, "--prefix": PREFIX},
            "mock": {"--gateway": listen, "--restart-after": 1.0},
        }
        for program, given in options.items():
            words = [word for option in (given | {"--realtime": priority}).items() for word in option]
            world.start(program, [sys.executable, "-m", f"construction_twin.{program}", *words])


class Commander:
    """Arms one gateway over MQTT and streams a motion to it: what the bridge sends, without ROS."""

    def __init__(self, port: int, config: GatewayConfig, home: tuple[float, ...]):
        self._topics = Topics(PREFIX, config.robot)
        self._config, self._home = config, home
        self._codec = JointStringCodec(len(home), config.decimals)
        self._end = MqttEnd(port, "link-commander", [self._topics.status])
        self.status: dict = {}
        self.cycle = 0
        self._due = 0

    def wait_for(self, state: str, timeout: float = 30.0) -> dict:
        """Return the first status with this state; TimeoutError after `timeout` [s]."""
        deadline = time.monotonic() + timeout
        while self.status.get("state") != state:
            if time.monotonic() > deadline:
                raise TimeoutError(
                    f"gateway is {self.status.get('state')}: {self.status.get('reason')}; expected {state}"
                )
            self._listen(0.1)
        return self.status

    def arm(self) -> None:
        """Arm the gateway and begin the stream."""
        self.wait_for("ready")
        control = Control("1", "bench", "arm", arm_value(self._config.hash, self.status["run"]))
        self._end.publish(publish_packet(self._topics.control, control.to_json()))
        self.wait_for("armed")
        self._due = time.monotonic_ns()

    def stream(self, seconds: float) -> None:
        """Send the motion at 250 Hz for a time [s]."""
        for _ in range(round(seconds / CYCLE)):
            while (wait := self._due - time.monotonic_ns()) > 0:
                self._listen(wait / 1e9)
            self.cycle += 1
            pairs = CommandProperties("bench", self.cycle, self._due).pairs()
            payload = self._codec.encode(pose_at(self._home, self.cycle))
            self._end.publish(publish_packet(self._topics.command, payload, pairs))
            self._due += CYCLE_NS

    def next_status(self, timeout: float = 5.0) -> dict:
        """Return the next status; goes on streaming meanwhile."""
        before = self.status
        deadline = time.monotonic() + timeout
        while self.status is before and time.monotonic() < deadline:
            self.stream(5 * CYCLE)
        return self.status

    def close(self) -> None:
        """Leave the broker."""
        self._end.close()

    def _listen(self, seconds: float) -> None:
        if select.select([self._end.socket], [], [], seconds)[0]:
            for body in self._end.receive():
                self.status = json.loads(read_publish(body)[1])


def reply_spread(before: dict, after: dict) -> dict:
    """Return what the gateway's histogram gained between two statuses: percentiles as upper edges of 10 % wide bins [us]."""
    reply = after["reply_us"]
    gained = [new - old for new, old in zip(reply["counts"], before["reply_us"]["counts"])]
    top = max((k for k, count in enumerate(gained) if count), default=0)
    edge = reply["bins"][top] if top < len(reply["bins"]) else None
    counts = [status["counters"].get("late_replies", 0) for status in (before, after)]
    fractions = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
    result: dict = {name: percentile(reply["bins"], gained, fraction) for name, fraction in fractions.items()}
    return result | {"max": reply["max"] if edge is None else min(edge, reply["max"]), "late": counts[1] - counts[0],
                     "cycles": sum(gained)}  # fmt: skip
