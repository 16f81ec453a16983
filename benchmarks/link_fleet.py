"""Several robots on one machine, each with bridge, gateway and mock controller: processor time, latency, late replies.

``python benchmarks/link_fleet.py --robots 4 --output FILE`` measures one number of robots; one that the machine does not carry is
null in the file: not all were armed in time, or the gates fell behind. One process plays the gates of all of
them; another process subscribes on the broker and sees what passes there. All processes stamp with the same monotonic clock. The
latency covers both directions together: a command from its publication on ROS to a subscriber on the broker, and a state from the
gateway's reply to `physical/feedback`. With one robot the file also holds the times from a command to the RSI packet and from there
to ROS.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import multiprocessing
import os
import select
import sys
import tempfile
import time
from pathlib import Path

import rospy
from construction_twin.msg import Feedback
from link_cell import Cell, pose_at, reply_spread
from link_mqtt import MqttEnd, read_publish
from link_routes import bridge_parameters
from link_world import REALTIME, ROBOT_YAML, ROOT, XACRO, World, cpu_seconds, end_in_order, spread_ms, wait_for

from construction_twin.core.realtime import release_realtime, request_realtime
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.mqtt.messages import read_command_properties, read_state_properties
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.ros.transport.joint_stream import QUEUE, JointPublisher

PREFIX = "fleet"
#: Between the first command and the measurement [s].
SETTLE = 2.0
#: How late a command may be published before the number of robots is more than the machine carries [ns].
BEHIND = NANOSECONDS
#: What each robot has a process of; the bridges may share one.
PARTS = ("bridge", "gateway", "mock")


class Observer:
    """Sees commands, states and statuses of all robots on the broker; the target of a process."""

    def __init__(self, port: int):
        self._end = MqttEnd(port, "link-observer", [f"{PREFIX}/+/{name}" for name in ("command", "state", "status")])
        self.statuses: dict[str, dict] = {}
        self.commands: list[tuple[str, int, int]] = []
        self.states: list[tuple[str, int, int, int]] = []

    def serve(self, pipe) -> None:
        """Listen; answer ``"statuses"`` with the newest, ``"taken"`` with all since the last time, None ends."""
        while True:
            ready, _, _ = select.select([self._end.socket, pipe], [], [])
            if self._end.socket in ready:
                self._receive()
            if pipe not in ready:
                continue
            order = pipe.recv()
            if order is None:
                return
            if order == "taken":
                pipe.send((self.commands, self.states))
                self.commands, self.states = [], []
            else:
                pipe.send(self.statuses)

    def _receive(self) -> None:
        for body in self._end.receive():
            topic, payload, pairs = read_publish(body)
            _, robot, kind = topic.split("/")
            now = time.monotonic_ns()
            if kind == "command":
                self.commands.append((robot, read_command_properties(pairs).stamp, now))
            elif kind == "state":
                state = read_state_properties(pairs)
                self.states.append((robot, state.seq, state.stamp, state.command_stamp))
            else:
                self.statuses[robot] = json.loads(payload)


def observe(pipe, port: int) -> None:
    """Run an observer."""
    Observer(port).serve(pipe)


class Gates:
    """Publishes every robot's command on one grid, and receives every robot's feedback."""

    def __init__(self, robots: list[str], joint_names: tuple[str, ...], home: tuple[float, ...]):
        rospy.init_node("link_gates", disable_signals=True, disable_rosout=True)
        self._home, self.moves = home, False
        self._newest = home
        self._publishers = {name: JointPublisher(f"/{name}/command/joint_states", joint_names) for name in robots}
        self._cycle, self._due = 0, time.monotonic_ns()
        self.sent: dict[tuple[str, int], int] = {}
        self.received: dict[tuple[str, int], int] = {}
        for name in robots:
            rospy.Subscriber(
                f"/{name}/physical/feedback", Feedback, self._receive, name, queue_size=QUEUE, tcp_nodelay=True
            )

    def _receive(self, message: Feedback, robot: str) -> None:
        self.received[robot, message.seq] = time.monotonic_ns()
        self._newest = tuple(message.position)

    def rest(self) -> None:
        """Take the pose of the last feedback; for one robot."""
        self._home, self._cycle, self.moves = self._newest, 0, False
        self._due = time.monotonic_ns()

    def stream(self, seconds: float) -> None:
        """Publish for a time [s]; a command that cannot be published in time is published late, not left out.

        Raises:
            TimeoutError: In motion, when they are late by more than `BEHIND`.
        """
        for _ in range(round(seconds / CYCLE)):
            ahead = self._due - time.monotonic_ns()
            if self.moves and ahead < -BEHIND:
                raise TimeoutError(f"commands are published {-ahead / NANOSECONDS:.1f} s late")
            time.sleep(max(0, ahead) / NANOSECONDS)
            pose = pose_at(self._home, self._cycle)
            self._cycle += self.moves
            for name, publisher in self._publishers.items():
                self.sent[name, self._due] = time.monotonic_ns()
                publisher.publish(self._due, pose)
            self._due += CYCLE_NS


class Fleet:
    """A number of robots, and the observer on their broker."""

    def __init__(self, world: World, count: int, realtime: int):
        self._world = world
        model = read_robot_files(XACRO, ROBOT_YAML)
        self.names = [f"robot{k}" for k in range(1, count + 1)]
        port = world.start_broker(realtime)
        self._broker_pid = world.broker_pid
        os.environ |= {"ROS_MASTER_URI": world.start_master(), "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(world.folder)}
        self._pipe, far = multiprocessing.Pipe()
        context = multiprocessing.get_context("fork")  # rospy has no thread in here yet
        self._observer = context.Process(target=observe, args=(far, port), daemon=True)
        self._observer.start()
        self.pids: dict[str, list[int]] = {part: [] for part in PARTS}
        shared = bridge_parameters(port, realtime, PREFIX)
        shared["publishers"] = {"command/joint_states": "/link_gates"}
        for name in self.names:
            parameters = shared | {"robot": shared["robot"] | {"name": name}}
            rospy.set_param(f"/{name}", parameters)
            config = gateway_config(dataclasses.replace(model, name=name), parameters["gateway"])
            bridge = [sys.executable, ROOT / "nodes/mqtt_bridge", "__name:=mqtt_bridge"]
            self.pids["bridge"].append(world.start(f"{name}-bridge", bridge, ROS_NAMESPACE=name).pid)
            cell = Cell(world, config, realtime, PREFIX)
            self.pids["gateway"].append(cell.gateway.pid)
            self.pids["mock"].append(cell.mock.pid)
        request_realtime(realtime)
        self.gates = Gates(self.names, model.joint_names, tuple(model.home))

    def start(self, timeout: float) -> None:
        """Arm all robots and begin to move; TimeoutError if not all were armed in time."""

        def following() -> bool:
            self.gates.stream(0.2)
            states = [status["state"] for status in self.ask("statuses").values()]
            return states.count("following") == len(self.names)

        wait_for(following, timeout, "a fleet that follows")
        self.gates.moves = True
        self.gates.stream(SETTLE)

    def ask(self, order: str):
        """Ask the observer."""
        self._pipe.send(order)
        return self._pipe.recv()

    def dismiss(self) -> None:
        """End the observer, before the broker ends."""
        self._pipe.send(None)
        self._observer.join(5.0)

    def cpu(self) -> dict[str, float]:
        """Return the processor time used so far [s], of the robots' processes and of what measures them."""
        measured = {part: sum(map(cpu_seconds, pids)) for part, pids in self.pids.items()}
        beside = {"gates": os.getpid(), "observer": self._observer.pid, "broker": self._broker_pid}
        return measured | {part: cpu_seconds(pid) for part, pid in beside.items()}

    def measure(self, seconds: float) -> dict:
        """Measure for a time [s] and return the figures."""
        self.ask("taken")
        self.gates.sent.clear()
        self.gates.received.clear()
        before, cpu, idle, begin = self.ask("statuses"), self.cpu(), idle_seconds(), time.monotonic()
        self.gates.stream(seconds)
        took = time.monotonic() - begin
        used = {part: after - cpu[part] for part, after in self.cpu().items()}
        idle = idle_seconds() - idle
        self.gates.stream(1.2)  # a status later
        after = self.ask("statuses")
        commands, states = self.ask("taken")
        sent, received = self.gates.sent, self.gates.received
        out = [at - sent[robot, stamp] for robot, stamp, at in commands if (robot, stamp) in sent]
        back = [received[state[:2]] - state[2] for state in states if state[:2] in received]
        heard = [name for name in self.names if name in before]
        replies = [reply_spread(before[name], after[name]) for name in heard]
        return {
            "robots": len(self.names),
            "cpu_per_robot": round(sum(used[part] for part in self.pids) / took / len(self.names), 4),
            "cores": {part: round(seconds / took, 4) for part, seconds in used.items()}
            | {"idle": round(idle / took, 4)},
            "p99_ms": spread_ms(out + back)["p99_ms"],
            "late": sum(reply["late"] for reply in replies),
            "reply_p99_us": max((reply["p99"] or 0 for reply in replies), default=None),
            "following": sum(after[name]["state"] == "following" for name in heard),
        } | (
            {"end_to_end": end_to_end(out, back, states, after[self.names[0]], replies[0])} if len(replies) == 1 else {}
        )


def idle_seconds() -> float:
    """Return how long the processors had nothing to do since the machine began, all of them together [s]."""
    return int(Path("/proc/stat").read_text().split()[4]) / os.sysconf("SC_CLK_TCK")


def command_to_rsi(states: list) -> list[int]:
    """Return the times from a command's stamp to the reply that carried its target, for the states of one robot [ns].

    A state carries the playout time of the reply before the one it was sent with. That reply went out together with the state
    before.
    """
    return [
        earlier[2] - later[3] for earlier, later in zip(states, states[1:]) if later[1] == earlier[1] + 1 and later[3]
    ]


def end_to_end(out: list[int], back: list[int], states: list, status: dict, reply: dict) -> dict:
    """Return the times from a command to the RSI packet, and from there to ROS, of one robot."""
    return {
        "command_to_rsi_packet": spread_ms(command_to_rsi(states)),
        "playout": status["playout"],
        "command_to_broker": spread_ms(out),
        "rsi_packet_to_reply_us": reply,
        "rsi_reply_to_ros": spread_ms(back),
    }


def main() -> None:
    """Measure one number of robots."""
    parser = argparse.ArgumentParser(description="Several robots on one machine.")
    parser.add_argument("--robots", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0, help="[%(default)s]")
    parser.add_argument("--timeout", type=float, default=60.0, help="to start and arm all [s] [%(default)s]")
    parser.add_argument("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority; 0: none [%(default)s]")
    parser.add_argument("--output", type=Path, required=True, help="JSON")
    options = parser.parse_args()
    end_in_order()
    with tempfile.TemporaryDirectory() as folder, World(Path(folder)) as world:
        fleet = Fleet(world, options.robots, options.realtime)
        result = None
        try:
            fleet.start(options.timeout)
            result = fleet.measure(options.seconds)
        except TimeoutError as error:
            print(f"[fleet] {options.robots} robots are not carried: {error}", file=sys.stderr)
        options.output.write_text(json.dumps(result))
        fleet.dismiss()
        rospy.signal_shutdown("measured")
        release_realtime()


if __name__ == "__main__":
    main()
