"""Latency of the routes through the bridge, then of the floor: the near side of the measurement, run once per round by `link.py`.

The bridge is a process of its own, with its own processor time; both ends stamp with the same monotonic clock. The ROS side has
the name of the gate, the node that the bridge takes commands from; the MQTT side (`link_peer.py`) plays the gateway. A state has
arrived when `physical/feedback` has: the gate compares by it, and it leaves the bridge after `physical/joint_states`. The floor is
the same messages between two plain MQTT clients, without bridge and ROS; its processor time is the broker's.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import rospy
import yaml
from construction_twin.msg import Feedback
from link_cell import gateway_settings
from link_mqtt import MqttEnd, publish_packet, read_publish
from link_peer import Heard, Task, serve
from link_world import REALTIME, ROBOT_YAML, ROOT, XACRO, World, cpu_seconds, end, end_in_order, wait_for

from construction_twin.core.realtime import release_realtime, request_realtime
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Topics, read_state_properties
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.ros.transport.joint_stream import QUEUE, JointPublisher, from_time

#: Of the routes [Hz].
RATE = 250.0
#: Tried for the highest sustained rate, until one fails [Hz].
RATES = (500, 1000, 1500, 2000, 2500, 3000, 4000, 5000)
#: The second sender of a duplex route is slower by this fraction: within 20 s the phase between the two takes every value four
#: times.
SLIDE = 1 / 1250
#: A message that arrives this long after the last one was sent shows a backlog [s].
BACKLOG = 0.1
NAMESPACE = "kr120"
ROUTES = ("ros_to_mqtt", "mqtt_to_ros", "round_trip", "duplex")


@dataclass
class Outcome:
    """One measurement: latencies of what arrived [ns], counts, and the bridge's processor time [s] per 1000 messages."""

    latencies: list[int]
    sent: int
    lost: int
    cpu_s_per_1000: float


class RosEnd:
    """Publishes commands and receives feedback, as the gate does."""

    def __init__(self, names: tuple[str, ...], pose: tuple[float, ...]):
        rospy.init_node("pca_monitor", disable_signals=True, disable_rosout=True)
        publisher = JointPublisher(f"/{NAMESPACE}/command/joint_states", names)
        self._publish = lambda now: publisher.publish(now, pose)
        self.heard = Heard()
        topic = f"/{NAMESPACE}/physical/feedback"
        rospy.Subscriber(topic, Feedback, self._receive, queue_size=QUEUE, tcp_nodelay=True)

    def _receive(self, message: Feedback) -> None:
        self.heard.arrivals.append((from_time(message.command_stamp), time.monotonic_ns()))

    def send(self, rate: float, count: int) -> None:
        """Send commands on a grid; one that is late is sent at once."""
        due = time.monotonic_ns()
        for _ in range(count):
            time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
            now = time.monotonic_ns()
            self._publish(now)
            self.heard.sent.append(now)
            due += round(1e9 / rate)


class PlainEnd(RosEnd):
    """The floor's near end: a plain MQTT client that sends commands and receives states."""

    def __init__(self, port: int, topics: Topics, payload: bytes):
        self.heard = Heard()
        self._end = MqttEnd(port, "link-floor", [topics.state])
        numbers = itertools.count(1)
        self._publish = lambda now: self._end.publish(
            publish_packet(topics.command, payload, CommandProperties("floor", next(numbers), now).pairs())
        )
        threading.Thread(target=self._receive_all, daemon=True).start()

    def _receive_all(self) -> None:
        # the broker ends before this process
        with suppress(ConnectionError):
            while True:
                for body in self._end.receive():
                    stamp = read_state_properties(read_publish(body)[2]).command_stamp
                    self.heard.arrivals.append((stamp, time.monotonic_ns()))


class Bench:
    """Both ends and what is between them.

    Args:
        pipe: Connection. To the peer.
        pid: The process between the ends.
    """

    def __init__(self, end: RosEnd, pipe, pid: int):
        self._end, self._pipe, self._pid = end, pipe, pid

    def warm_up(self, count: int = 100) -> None:
        """Run both directions until everything is connected and armed."""
        self._begin(Task(250.0, 10_000_000))

        def flows() -> bool:
            self._end.send(250.0, 50)
            return self._peer_count() >= count and len(self._end.heard.arrivals) >= count

        wait_for(flows, 30.0, "messages in both directions")
        self._ask("result")
        # a message that is still under way would count for the first route, which would then end before its own last message
        settle(lambda: self._peer_count() + len(self._end.heard.arrivals), sys.maxsize, 0.3)

    def measure(self, route: str, count: int, rate: float = RATE) -> Outcome:
        """Run one route with `count` messages in each direction."""
        out, back = route != "mqtt_to_ros", route in ("mqtt_to_ros", "duplex")
        slower = rate * (1 - SLIDE) if route == "duplex" else rate
        cpu = cpu_seconds(self._pid)
        self._begin(Task(slower, count if back else 0, route == "round_trip"))
        begin = time.monotonic()
        if out:
            self._end.send(rate, count)
        if back:
            time.sleep(max(0.0, begin + count / slower - time.monotonic()))
        expected = count * (out + back)
        peer_counts, ros_counts = out and route != "round_trip", back or route == "round_trip"

        def arrived() -> int:
            return (self._peer_count() if peer_counts else 0) + (len(self._end.heard.arrivals) if ros_counts else 0)

        settle(arrived, expected)
        cpu = cpu_seconds(self._pid) - cpu
        peer, ros = self._ask("result"), self._end.heard
        # a round trip is sent and comes back here
        pairs = [(ros, peer.arrivals)] if peer_counts else []
        pairs += [(ros if route == "round_trip" else peer, ros.arrivals)] if ros_counts else []
        messages = expected * (2 if route == "round_trip" else 1)
        return outcome(pairs, cpu / messages * 1000)

    def sustains(self, route: str, rate: float, seconds: float) -> bool:
        """Return whether this rate [Hz] passes without loss and without a backlog, sent at no less than 99 % of it."""
        begin = time.monotonic()
        outcome = self.measure(route, round(rate * seconds), rate)
        took = time.monotonic() - begin
        return not outcome.lost and outcome.latencies[-1] <= BACKLOG * 1e9 and took <= seconds * 1.01 + BACKLOG

    def _begin(self, task: Task) -> None:
        self._end.heard = Heard()
        self._ask(task)

    def _peer_count(self) -> int:
        return self._ask("count")

    def _ask(self, order: object):
        self._pipe.send(order)
        return self._pipe.recv()


def settle(arrived, expected: int, quiet: float = 1.0) -> None:
    """Wait until `expected` messages have arrived, or none for `quiet` [s]."""
    last, at = -1, time.monotonic()
    while (count := arrived()) < expected and time.monotonic() < at + quiet:
        if count != last:
            last, at = count, time.monotonic()
        time.sleep(0.02)


def outcome(pairs: list, cpu: float) -> Outcome:
    latencies, sent, lost = [], 0, 0
    for sender, arrivals in pairs:
        stamps = set(sender.sent)
        known = {stamp: at for stamp, at in reversed(arrivals) if stamp in stamps}
        latencies += [known[stamp] - stamp for stamp in sender.sent if stamp in known]
        sent, lost = sent + len(sender.sent), lost + len(sender.sent) - len(known)
    return Outcome(latencies, sent, lost, cpu)


def bridge_parameters(port: int, realtime: int) -> dict:
    """Return the parameters of a bridge in its robot's namespace, as launch/bringup.launch loads them."""
    bridge = yaml.safe_load((ROOT / "config" / "mqtt_bridge.yaml").read_text())
    bridge |= {"host": "127.0.0.1", "port": port, "prefix": "twin", "account": "", "arm": "mock"}
    return {
        "robot_description": expand_xacro(XACRO),
        "robot": yaml.safe_load(ROBOT_YAML.read_text()),
        "gateway": gateway_settings(),
        "mqtt_bridge": bridge | {"realtime_priority": realtime},
    }


def run(seconds: float, rate_seconds: float, realtime: int) -> dict:
    """Return the outcomes by route of bridge and floor, and the bridge's highest rates when `rate_seconds` is not 0."""
    robot = read_robot_files(XACRO, ROBOT_YAML)
    topics = Topics("twin", robot.name)
    with tempfile.TemporaryDirectory() as folder, World(Path(folder)) as world:
        port = world.start_broker(realtime)
        os.environ |= {"ROS_MASTER_URI": world.start_master(), "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": folder}
        parameters = bridge_parameters(port, realtime)
        config = gateway_config(robot, parameters["gateway"])
        parameters["publishers"] = {"command/joint_states": "/pca_monitor"}  # this process, outside of the namespace
        rospy.set_param(f"/{NAMESPACE}", parameters)
        bridge = [sys.executable, ROOT / "nodes/mqtt_bridge", "__name:=mqtt_bridge"]
        process = world.start("bridge", bridge, ROS_NAMESPACE=NAMESPACE)
        request_realtime(realtime)  # both ends; after the master, which has no part in the path
        near, far = multiprocessing.Pipe()
        context = multiprocessing.get_context("fork")  # rospy has no thread in here yet
        peer = context.Process(target=serve, args=(far, port, topics, robot, config), daemon=True)
        peer.start()
        far.close()  # so that waiting for the peer ends when the peer does
        bench = Bench(RosEnd(robot.joint_names, tuple(robot.home)), near, process.pid)
        result: dict = {"ours": measured(bench, seconds, lambda: world.last_lines("bridge"))}
        result["max_rate_hz"] = {route: highest(bench, route, rate_seconds) for route in ROUTES[:2] if rate_seconds}
        end([process])
        payload = JointStringCodec(len(robot.home), config.decimals).encode(tuple(robot.home))
        floor = Bench(PlainEnd(port, topics, payload), near, world.broker.pid)
        result["floor"] = measured(floor, seconds, lambda: world.last_lines("mosquitto"))
        near.send(None)
        peer.join(5.0)
        rospy.signal_shutdown("measured")
        release_realtime()
        return result


def measured(bench: Bench, seconds: float, last_lines: Callable[[], str]) -> dict[str, dict]:
    """Return the outcome of each route."""
    try:
        bench.warm_up()
    except TimeoutError as error:
        raise SystemExit(f"{error}\n{last_lines()}") from error
    return {route: asdict(bench.measure(route, round(RATE * seconds))) for route in ROUTES}


def highest(bench: Bench, route: str, seconds: float) -> float:
    """Return the highest of RATES that passes [Hz]; 0 for none. One failure may be due to the machine, two in a row are not."""
    best = 0.0
    for rate in RATES:
        if not any(bench.sustains(route, rate, seconds) for _ in range(2)):
            return best
        best = float(rate)
    return best


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description="Routes through the bridge, and the floor, at 250 Hz.")
    parser.add_argument("--seconds", type=float, required=True, help="per route")
    parser.add_argument("--rate-seconds", type=float, required=True, help="per rate tried for the highest; 0: none")
    parser.add_argument("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority; 0: none [%(default)s]")
    parser.add_argument("--output", type=Path, required=True, help="JSON with every latency [ns]")
    options = parser.parse_args()
    end_in_order()
    options.output.write_text(json.dumps(run(options.seconds, options.rate_seconds, options.realtime)))


if __name__ == "__main__":
    main()
