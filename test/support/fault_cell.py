"""Real processes for the tests of faults: mosquitto, gateway, mock controller, the proxies between them, and a Commander.

::

    Commander -- broker -- TCP proxy -- gateway -- (UDP proxy) -- mock controller
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import yaml
from commander import Commander
from impairment import Network
from impairment_profiles import Profile
from processes import ROOT, BrokerProcess, wait_until

from construction_twin.core.errors import ReviewError
from construction_twin.core.udp import bind
from construction_twin.core.units import CYCLE, radians
from construction_twin.gateway.trace import TraceEntry, read_trace
from construction_twin.link.observations import LinkState
from construction_twin.mqtt.messages import Topics
from construction_twin.planning.timing import time_path
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.rsi.gateway_codec import RobotDecoder
from construction_twin.scenario.judge import trace_excesses

#: Far enough for a motion of seconds [deg].
GOAL = (40.0, -60.0, 75.0, 40.0, 60.0, -60.0)
#: As close as 6 decimals come, with room for the last digit of AIPos [rad].
FINAL_ERROR = 1e-6
#: Room for whatever a busy machine does [s].
PATIENCE = 40.0
#: A stall has struck a motion when the arm was seen to move this shortly before [s].
STRUCK = 0.05


def read_robot():
    """Return this package's robot."""
    return read_robot_files(ROOT / "urdf" / "kr120r2500.urdf.xacro", ROOT / "config" / "kr120.yaml")


def make_config(robot, **changes):
    """Return the shipped configuration of the gateway with 6 decimals and `changes`."""
    settings = yaml.safe_load((ROOT / "config" / "gateway.yaml").read_text())
    ethernet_xml = (ROOT / "krl" / "ethernet" / "ctwin_ethernet.xml").read_text()
    return gateway_config(robot, settings | {"decimals": 6, "ethernet_xml": ethernet_xml} | changes)


def plan(robot, start, goal_deg, fraction):
    """Return a motion on the 4 ms grid, at rest at both ends, shape (m, n) [rad]."""
    trajectory = time_path(
        np.array([start, radians(goal_deg)]), robot, speed_scale=fraction, acceleration_scale=fraction
    )
    times = np.arange(0.0, trajectory.duration + 2 * CYCLE, CYCLE)
    return trajectory.sample_many(np.minimum(times, trajectory.duration))[0]


class Program:
    """A process and every line it writes to stderr."""

    def __init__(self, *command: str):
        self.lines: list[str] = []
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def said(self, words: str) -> list[str]:
        """Return the lines that contain these words."""
        return [line for line in list(self.lines) if words in line]

    def send(self, number: int) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    def kill(self) -> None:
        """End it as a power cut would."""
        self._process.kill()
        self._process.wait(10.0)

    def end(self) -> None:
        """Ask it to end, and wait."""
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(15.0)
        finally:
            self._process.kill()
            self._reader.join(5.0)

    def _read(self) -> None:
        with self._process.stderr as stream:
            for line in stream:
                self.lines.append(line.rstrip())


class FaultCell:
    """Everything at once; entered when the link is armed and the commander's stream is followed.

    Args:
        folder: For configuration and traces.
        udp: Put a proxy between gateway and controller too.
        feedback_timeout: The commander's.
        mock_timeout: Cycles without a reply after which the mock stops.
        fraction: Of the limits that planned motions use.
        changes: Of the gateway's configuration.
    """

    def __init__(
        self,
        folder: Path,
        udp: bool = False,
        feedback_timeout: float | None = None,
        mock_timeout: int = 100,
        fraction: float = 0.6,
        **changes,
    ):
        self.robot = read_robot()
        self.config = make_config(self.robot, **changes)
        self.topics = Topics("faults", self.robot.name)
        self.fraction = fraction
        self.resets = 0
        self.packets: list = []
        self._folder, self._with_udp, self._feedback_timeout = folder, udp, feedback_timeout
        self._mock_options = (
            "--cycle",
            str(self.config.cycle),
            "--timeout",
            str(mock_timeout),
            "--restart-after",
            "1",
            "--realtime",
            "40",
        )
        self._traces: list[Path] = []
        self._decoder = RobotDecoder(self.config.axes, self.config.units)

    def __enter__(self) -> FaultCell:
        with ExitStack() as stack:
            stack.callback(self.__exit__)
            self._start()
            stack.pop_all()
        return self

    def __exit__(self, *_) -> None:
        # the gateway before the mock: one that hears no telegram waits for the end of its braking
        for name, end in (("commander", "close"), ("gateway", "end"), ("mock", "end"), ("broker", "kill")):
            if hasattr(self, name):
                getattr(getattr(self, name), end)()
        self.network.__exit__()

    def _start(self) -> None:
        self.network = Network().__enter__()
        self.broker = BrokerProcess()
        self.broker.start()
        self.tcp = self.network.tcp(("127.0.0.1", self.broker.port))
        with bind("127.0.0.1", 0) as sock:
            self._rsi = sock.getsockname()
        (self._folder / "arm.json").write_text(self.config.to_json())
        self.start_gateway()
        if self._with_udp:
            self.udp = self.network.udp(self._rsi, tap=self._tap)
        port = self.udp.address[1] if self._with_udp else self._rsi[1]
        self.mock = Program(
            *(sys.executable, "-m", "construction_twin.mock", "--gateway", f"127.0.0.1:{port}"),
            *self._mock_options,
        )
        self.commander = Commander(self.broker.port, self.topics, self.config, feedback_timeout=self._feedback_timeout)
        self.commander.start()
        self.wait_until_following()
        assert not self.mock.said("stopped"), self.describe()

    def start_gateway(self) -> None:
        """Start the gateway's program, with a trace of its own."""
        trace = self._folder / f"trace{len(self._traces)}"
        self._traces.append(trace)
        self.gateway = Program(
            *(sys.executable, "-m", "construction_twin.gateway", "--config", str(self._folder / "arm.json")),
            *("--listen", f"127.0.0.1:{self._rsi[1]}", "--broker", f"127.0.0.1:{self.tcp.address[1]}"),
            *("--prefix", self.topics.prefix, "--trace", str(trace), "--realtime", "40"),
        )

    def _tap(self, data: bytes) -> None:
        self.packets.append(self._decoder.parse(data))

    # -- acting

    def impair(self, profile: Profile) -> None:
        """Put a profile on the network between broker and gateway."""
        self.network.apply(self.tcp, profile)

    def impair_rsi(self, profile: Profile) -> None:
        """Put a profile on the network between gateway and controller."""
        self.network.apply(self.udp, profile)

    def move(self, goal_deg=GOAL) -> None:
        """Begin a motion to a pose and wait until the arm moves."""
        before = self.commander.arm
        self.commander.play(plan(self.robot, self.commander.pose, goal_deg, self.fraction))
        self.wait(
            lambda: (
                np.abs(np.subtract(self.commander.arm, before)).max() > np.deg2rad(3.0) or not self.commander.playing
            ),
            "the arm to move",
        )

    def move_into_a_stall(self, goal_deg=GOAL) -> bool:
        """Begin a motion shortly before the network's next stall; return, after the stall, whether it struck the moving arm."""
        tcp, known = self.tcp, len(self.tcp.stalls)
        # what the tests judge is the time from here
        self.commander.longest_pause = 0.0
        self.wait(lambda: 0.35 < tcp.until_stall() < 0.5, "a stall to be near")
        self.move(goal_deg)
        self.wait(lambda: len(tcp.stalls) > known and time.monotonic() > tcp.stalls[-1].end, "the stall")
        stall = tcp.stalls[known]
        # the arm's last states before the stall show it in motion, and commands were on their way in it
        moved = any(stall.begin - STRUCK < at <= stall.begin for at in self.commander.moved_at)
        return moved and stall.down > 0

    def finish(self, goal_deg=GOAL) -> int:
        """Do what a person would until the arm is at the goal: `reset` where the link asks for it, and plan again.

        Returns how often `reset` was called.
        """
        self.resets = 0
        self.wait(lambda: self._at(goal_deg) or self._help(goal_deg), f"the arm at {goal_deg}", 2 * PATIENCE)
        return self.resets

    def _help(self, goal_deg) -> bool:
        commander = self.commander
        if commander.link is LinkState.NEEDS_RESET:
            try:
                commander.reset()
                self.resets += 1
                self.wait(lambda: commander.link is not LinkState.NEEDS_RESET, "the link to take up the reset")
            except ReviewError:
                pass  # still moving: a person would wait too
        elif commander.link is LinkState.ARMED and not commander.playing and not self._commanded(goal_deg):
            commander.play(plan(self.robot, commander.pose, goal_deg, self.fraction))
        return False

    def _commanded(self, goal_deg) -> bool:
        return np.abs(np.subtract(self.commander.pose, radians(goal_deg))).max() <= FINAL_ERROR

    def _at(self, goal_deg) -> bool:
        commander = self.commander
        if commander.link is not LinkState.ARMED or commander.playing or commander.arm is None:
            return False
        return bool(np.abs(np.subtract(commander.arm, radians(goal_deg))).max() <= FINAL_ERROR)

    # -- looking

    def wait(self, condition, what: str, timeout: float = PATIENCE) -> None:
        """Wait for a condition; the error says what every part last did."""
        try:
            wait_until(condition, timeout, what)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.describe()}") from None

    def wait_until_following(self) -> None:
        """Wait until commands reach the gateway and states come back, both of now."""
        commander = self.commander
        sent, states = commander.sent, commander.states
        self.wait(
            lambda: (
                commander.link is LinkState.ARMED
                and commander.sent > sent + 50
                and commander.states > states + 50
                and self.entries()[-1:]
                and self.entries()[-1].stamp > 0
            ),
            "a stream that is followed",
        )

    def describe(self) -> str:
        """Return the state of everything in a few sentences."""
        commander, status = self.commander, self.commander.status
        links = ", ".join(f"{state.name} ({reason})" for state, reason in commander.links[-6:])
        return (
            f"link {links}; gateway {status.get('state')} ({status.get('reason')}), counters {status.get('counters')}; motion "
            f"{commander.outcome}; longest pause of the sender {commander.longest_pause:.3f} s; mock {self.mock.lines[-3:]}"
        )

    def entries(self, run: int = -1) -> list[TraceEntry]:
        """Return what the gateway has sent, of its last run or of another."""
        trace = self._traces[run]
        return read_trace(str(trace)) if trace.exists() and trace.stat().st_size else []

    def assert_within_limits(self) -> None:
        """The corrections of every run of the gateway stayed inside the limits in every cycle."""
        for run in range(len(self._traces)):
            entries = self.entries(run)
            found = trace_excesses(entries, self.config.limits, self.config.decimals, self.config.period)
            assert not found, f"run {run}: {len(found)} of {len(entries)} cycles: {'; '.join(map(str, found[:5]))}"

    def assert_nobody_restarted(self) -> None:
        """Gateway and mock are the processes they were."""
        assert self.gateway.running and self.mock.running
        assert len(self._traces) == 1

    def seen(self, state: LinkState) -> list[str]:
        """Return the reasons with which the link was in a state."""
        return [reason for each, reason in self.commander.links if each is state]

    def gateway_reasons(self, state: str) -> list[str]:
        """Return the reasons with which the gateway was in a state."""
        return [status.get("reason", "") for status in self.commander.statuses if status.get("state") == state]

    def counters(self) -> Counter[str]:
        """Return the gateway's counters, from a status that was made after this call."""
        known, replies = len(self.commander.statuses), len(self.entries())

        def is_later() -> bool:
            # one that counts at least the replies that the trace has now, or the second one
            later = self.commander.statuses[known:]
            return len(later) > 1 or any(each.get("counters", {}).get("telegrams", 0) >= replies > 0 for each in later)

        self.wait(is_later, "a status")
        return Counter(self.commander.status["counters"])
