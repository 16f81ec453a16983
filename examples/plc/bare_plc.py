"""A PLC that knows only the joint string: the smallest that is still lawful, for bare mode (docs/broker.md). NOT SAFETY RATED.

Python 3 and paho-mqtt only, nothing of this package: a pattern to copy into a PLC, as `bare_plc.st` is in Structured Text. Its arm
is ideal: it is where the PLC tells it to be. Angles in deg, times in s, speeds in deg per cycle.

Under ``<prefix>/<robot>/`` it reads `command` and writes `state` (one joint string per cycle) and `status` (retained, and its last
will): `ready` while it takes strings, `offline` while it does not.

- The first string must lie within the start tolerance of the pose that it holds; the arm creeps there before it follows.
- Every string must have the format, lie in the range, be no more than one cycle's way from the last one, change the speed by no
  more than one cycle's acceleration, and leave room to brake.
- In motion a string that is missing when due, silence, or a program that stood still: every axis brakes with its own limit.
- Cycles that were missed are left out: run back to back, their setpoints would be one jump.
- After a stop it takes nothing until strings have stopped and the arm rests: strings of a stream that broke must not start another.
- A string with the retain flag is of unknown age: it is refused, and nothing else happens.

It cannot tell two senders apart, nor notice strings that were all delayed, or one that was lost or sent twice at so low a speed
that it looks like acceleration. At any higher speed that is a jump of the speed, and refused.
"""

from __future__ import annotations

import argparse
import math
import re
import signal
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import paho.mqtt.client as paho

CYCLE = 0.004
#: A joint string must follow the last one within this.
SILENCE = 0.1
#: After a stop strings must have been absent, and the arm at rest, for this long.
QUIET = 0.5
#: The first string of a stream lies this close to the held pose.
START_TOLERANCE = 0.05
#: Strings that wait to be played, in cycles: the delay that the network's jitter costs; and how many may, at most.
DELAY, MOST = 6, 75


@dataclass(frozen=True)
class Axis:
    """Limits of one axis: range [deg], speed [deg/s], acceleration [deg/s^2]."""

    lower: float
    upper: float
    speed: float
    acceleration: float


#: KR 120 R2500 pro, A1 to A6: as in the package's URDF and config/kr120.yaml. Enter your own arm's.
AXES = (
    Axis(-185.0, 185.0, 123.0, 155.8),
    Axis(-140.0, -5.0, 115.0, 134.2),
    Axis(-120.0, 155.0, 120.0, 368.7),
    Axis(-350.0, 350.0, 179.0, 998.8),
    Axis(-125.0, 125.0, 172.0, 518.0),
    Axis(-350.0, 350.0, 219.0, 492.1),
)
HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)


class State(Enum):
    """What the PLC does."""

    HOLDING = "at rest, a stream may begin"
    FOLLOWING = "strings are played"
    BRAKING = "on the way to rest"
    STOPPED = "at rest, until strings have stopped"


#: It takes strings in these.
TAKING = (State.HOLDING, State.FOLLOWING)


class BarePlc:
    """The PLC's program without its network: strings in, a pose and a word out; time is an argument.

    Args:
        start: Where the arm stands [deg].
        decimals: Of the joint string.
        delay: How many strings wait to be played, in cycles.

    Attributes:
        reason: Why it stopped last.
        position: [deg]
        counters: Strings that were taken, and refused by reason.
    """

    def __init__(self, axes: Sequence[Axis], start: Sequence[float], decimals: int = 3, delay: int = DELAY):
        self.state, self.reason = State.HOLDING, ""
        self.position = tuple(start)
        self.counters: Counter[str] = Counter()
        self._axes = tuple(axes)
        self._decimals = decimals
        self._delay = delay
        self._field = re.compile(rb"[+-]\d{3}\.\d{%d}" % decimals)
        self._width = 5 + decimals
        self._step = tuple(axis.speed * CYCLE + 1.5 * 10.0**-decimals for axis in axes)
        self._braking = tuple(axis.acceleration * CYCLE**2 for axis in axes)
        # three rounded values make up a change of the speed
        self._change = tuple(braking + 2.0001 * 10.0**-decimals for braking in self._braking)
        self._velocity = (0.0,) * len(self._axes)
        # the last string, its step, and where the stream begins
        self._last = self._first = self.position
        self._last_steps = self._velocity
        self._queue: deque[tuple[float, ...]] = deque()
        self._playing = False
        self._heard = self._rested = 0.0

    @property
    def word(self) -> str:
        """What is said on `status`."""
        return "ready" if self.state in TAKING else "offline"

    @property
    def joint_string(self) -> bytes:
        """What is said on `state`."""
        text = ",".join(f"{value:+0{self._width}.{self._decimals}f}" for value in self.position)
        zero = f"{0.0:0{self._width - 1}.{self._decimals}f}"
        return text.replace(f"-{zero}", f"+{zero}").encode()

    def on_string(self, payload: bytes, retained: bool, now: float) -> None:
        """Take a joint string that came at `now`."""
        if retained:
            self.counters["retained"] += 1
            return
        self._heard = now
        if self.state not in TAKING:
            self.counters["stopped"] += 1
            return
        problem = self._take(payload)
        if problem:
            self.counters[problem] += 1
            self.stop(f"refused: {problem}")
        else:
            self.counters["taken"] += 1

    def _take(self, payload: bytes) -> str:
        """Put a string in the queue; return what is wrong with it, empty when nothing is."""
        fields = payload.split(b",")
        if len(fields) != len(self._axes) or not all(map(self._field.fullmatch, fields)):
            return "format"
        pose = tuple(map(float, fields))
        if not all(axis.lower <= value <= axis.upper for axis, value in zip(self._axes, pose)):
            return "range"
        if self.state is State.HOLDING:
            if any(abs(value - held) > START_TOLERANCE for value, held in zip(pose, self.position)):
                return "start"
            self.state, self._playing, self._last, self._first = State.FOLLOWING, False, pose, pose
            self._last_steps = (0.0,) * len(pose)
        steps = tuple(value - before for value, before in zip(pose, self._last))
        if any(abs(step) > most for step, most in zip(steps, self._step)):
            return "step"
        if any(abs(step - last) > most for step, last, most in zip(steps, self._last_steps, self._change)):
            return "acceleration"
        if not all(map(self._can_brake, self._axes, self._braking, pose, steps)):
            return "braking_room"
        if len(self._queue) >= MOST:
            return "ahead"
        self._queue.append(pose)
        self._last, self._last_steps = pose, steps
        return ""

    def _can_brake(self, axis: Axis, braking: float, value: float, step: float) -> bool:
        # summed over whole cycles the way is half a step shorter; a digit may be rounding
        way = max(step * step / (2.0 * braking) - abs(step) / 2.0, 0.0) - 10.0**-self._decimals
        return axis.lower <= value - way if step < 0.0 else value + way <= axis.upper

    def cycle(self, now: float) -> None:
        """Do what one cycle of 4 ms does."""
        if self.state is State.FOLLOWING:
            self._follow(now)
        # in the same cycle in which a string is missing
        if self.state is State.BRAKING:
            self._brake(now)
        elif self.state is State.STOPPED and now - max(self._heard, self._rested) >= QUIET:
            self.state = State.HOLDING

    def _follow(self, now: float) -> None:
        if now - self._heard > SILENCE:
            self.stop("silence")
            return
        if not self._playing:
            there = self._creep()
            self._playing = there and len(self._queue) >= self._delay
            if not self._playing:
                return
        if not self._queue:
            # at rest the next strings fill the queue again
            self._playing, self._first = False, self.position
            if any(self._velocity):
                self.stop("a string was late")
            return
        target = self._queue.popleft()
        self._velocity = tuple(value - before for value, before in zip(target, self.position))
        self.position = target
        if not any(self._velocity) and len(self._queue) > self._delay and self._queue[0] == target:
            # the sender's clock is faster than ours: made good where nothing moves
            self._queue.popleft()

    def _creep(self) -> bool:
        """Go to where the stream begins, so slowly that each axis could stop within a cycle; return whether the arm was there."""
        ways = tuple(goal - here for goal, here in zip(self._first, self.position))
        self._velocity = tuple(max(-most, min(most, way)) for way, most in zip(ways, self._braking))
        self.position = tuple(
            goal if step == way else here + step
            for goal, here, way, step in zip(self._first, self.position, ways, self._velocity)
        )
        return not any(ways)

    def stop(self, reason: str) -> None:
        """Brake and take no more strings."""
        if self.state in TAKING:
            self.state, self.reason = State.BRAKING, reason
            self._queue.clear()

    def _brake(self, now: float) -> None:
        self._velocity = tuple(
            math.copysign(max(abs(speed) - most, 0.0), speed) for speed, most in zip(self._velocity, self._braking)
        )
        self.position = tuple(value + speed for value, speed in zip(self.position, self._velocity))
        if not any(self._velocity):
            # what is held is what can be said of it
            self.position = tuple(round(value, self._decimals) for value in self.position)
            self.state, self._rested = State.STOPPED, now


class Schedule:
    """When the cycles are due, of a computer that may not run them in time."""

    def __init__(self, now: float):
        self._due = now + CYCLE

    def wait(self, now: float) -> float:
        """Return how long the next cycle is still to wait for [s]."""
        return max(0.0, self._due - now)

    def begin(self, now: float) -> float:
        """Begin the cycle; return by how much it is late [s]. Less than a cycle is made good by the next; more is left out."""
        late = now - self._due
        self._due = (self._due if late < CYCLE else now) + CYCLE
        return late


class Network:
    """The PLC's MQTT: a client that never keeps anything for later.

    Args:
        options: As `arguments` parses them.
    """

    def __init__(self, options: argparse.Namespace, plc: BarePlc):
        self._plc = plc
        self._lock = threading.Lock()
        self._topics = {name: f"{options.topics}/{name}" for name in ("command", "state", "status")}
        protocol = paho.MQTTv5 if options.protocol == "5" else paho.MQTTv311
        self._client = client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=protocol)
        client.will_set(self._topics["status"], "offline", qos=1, retain=True)
        if options.user:
            with open(options.password_file, encoding="utf-8") as file:
                client.username_pw_set(options.user, file.readline().rstrip("\n"))
        if options.ca_file:
            client.tls_set(options.ca_file)
        client.on_socket_open = self._on_socket_open
        client.on_connect = self._on_connect
        client.on_message = self._on_message
        host, _, port = options.broker.rpartition(":")
        client.reconnect_delay_set(1, 2)
        client.connect_async(host, int(port), keepalive=5)
        self._said = ""

    def _on_socket_open(self, _client, _data, sock) -> None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _on_connect(self, client, _data, _flags, reason_code, _properties) -> None:
        if reason_code.is_failure:
            print(f"plc: the broker refused the connection: {reason_code}", flush=True)
            return
        client.subscribe(self._topics["command"], 0)
        # the last will has taken it away
        self._said = ""

    def _on_message(self, _client, _data, message) -> None:
        with self._lock:
            self._plc.on_string(message.payload, message.retain, time.monotonic())

    def run(self, stopping: threading.Event) -> None:
        """Run cycle after cycle until it is stopped; then brake, and say `offline`."""
        client, plc = self._client, self._plc
        client.loop_start()
        schedule, told = Schedule(time.monotonic()), None
        while not (stopping.is_set() and plc.state is State.STOPPED):
            time.sleep(schedule.wait(time.monotonic()))
            late = schedule.begin(time.monotonic())
            with self._lock:
                if late > SILENCE and plc.state is State.FOLLOWING:
                    # the strings that came meanwhile are no stream any more
                    plc.stop("the program stood still")
                if stopping.is_set():
                    plc.stop("the program ends")
                plc.cycle(time.monotonic())
                joints, word, state = plc.joint_string, plc.word, (plc.state, plc.reason)
            if client.is_connected():
                client.publish(self._topics["state"], joints, qos=0)
                if word != self._said:
                    self._said = word
                    client.publish(self._topics["status"], word, qos=1, retain=True)
            if state != told:
                told = state
                print(f"plc: {plc.state.name.lower()}{f' ({plc.reason})' if plc.reason else ''}", flush=True)
        if client.is_connected():
            try:
                client.publish(self._topics["status"], "offline", qos=1, retain=True).wait_for_publish(1.0)
            except RuntimeError:
                print("plc: the connection is lost; the last will says offline", flush=True)
        client.disconnect()
        client.loop_stop()


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command line's options; ROS's remappings are left out."""
    parser = argparse.ArgumentParser(prog="plc", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--broker", default="127.0.0.1:18830", metavar="HOST:PORT")
    parser.add_argument("--topics", default="twin/kr120", metavar="PREFIX/ROBOT")
    parser.add_argument("--protocol", default="3.1.1", choices=["5", "3.1.1"], help="MQTT version [%(default)s]")
    parser.add_argument("--decimals", type=int, default=3, help="of the joint string [%(default)s]")
    parser.add_argument("--delay", type=int, default=DELAY, metavar="CYCLES", help="strings that wait [%(default)s]")
    parser.add_argument("--user", default="", help="MQTT user")
    parser.add_argument("--password-file", default="", help="its first line is the user's password")
    parser.add_argument(
        "--ca-file", default="", help="who signed the broker's certificate; with it the connection is TLS"
    )
    options, _ros = parser.parse_known_args(words)
    return options


def main() -> None:
    """Run the PLC until SIGINT or SIGTERM."""
    options, stopping = arguments(), threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    Network(options, BarePlc(AXES, HOME, options.decimals, options.delay)).run(stopping)


if __name__ == "__main__":
    main()
