"""Runs the whole loop of one robot for an hour and says whether it drifts, grows or loses anything: `make soak`.

The loop is gateway, mock controller, bridge, broker, and a commander on ROS that keeps the arm moving. Every minute it prints a
line: resident memory per process, late replies, lost commands and states, the time from a command to its RSI packet beyond the
playout's delay, how often and for how long the machine itself ran no process (benchmarks/machine.py), how many replies were
held up, and how many of these no pause of 0.25 ms or more explains. `python scripts/soak.py --minutes 5` is a shorter run. The
exit code is 0 if nothing is wrong.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import threading
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

import rospy  # noqa: E402
from link_cell import reply_spread  # noqa: E402
from link_fleet import SETTLE, Fleet, command_to_rsi  # noqa: E402
from link_world import REALTIME, World, end_in_order, environment, resident_mb, wait_for  # noqa: E402
from machine import MachineProbe, Replies  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from construction_twin.core.realtime import release_realtime  # noqa: E402

#: Growth of a process's memory and drift of the distance up to here are noise [MB], [ms].
MAX_GROWTH, MAX_DRIFT = 2.0, 4.0
PROCESSES = ("bridge", "gateway", "mock")
#: Counters of the gateway that say that a cycle went wrong.
CYCLES = (
    "late_replies",
    "telegrams_skipped",
    "ipoc_steps_irregular",
    "sessions_by_ipoc_jump",
    "stops_silence",
    "stops_refused",
)


@dataclass(frozen=True)
class Minute:
    """One interval: memory [MB] per process, counts, number and longest [ms] of the machine's pauses, replies that were held up.

    How many of these are due to us is None where the probe has no priority above ours: its pauses are then also due to us.

    The distance [ms] is None unless the playout's delay was the same at both ends of the interval: an adaptive delay that moves is
    no drift.
    """

    memory: tuple[float, ...]
    late: int
    lost: int
    distance: float | None
    holds: int = 0
    pauses: int = 0
    longest_ms: float = 0.0
    held_up: int = 0
    held_up_by_us: int | None = 0


@dataclass
class Soak:
    """The loop and what was measured on it."""

    fleet: Fleet
    probe: MachineProbe
    minutes: list[Minute] = field(default_factory=list)

    def __post_init__(self):
        self._begin = self._status()
        self._counts = self._counters()
        self._replies = Replies()
        self.fleet.ask("taken")  # what was sent before
        # commands of the second before that had not reached the broker yet: robot, stamp
        self._under_way: set[tuple[str, int]] = set()
        self._reset = rospy.ServiceProxy(f"/{self.fleet.names[0]}/reset", Trigger)
        self.probe.taken()

    def run(self, interval: float) -> Minute:
        """Let the loop run for an interval [s]; return what it showed. When the arm holds, go on as a person would."""
        delay = self._status()["playout"]["delay_ms"]
        distances: list[int] = []
        lost = holds = 0
        for _ in range(max(1, round(interval))):
            lost += self._second(distances)
            status = self._status()
            if status["state"] != "following":
                holds += 1
                print(f"[soak] the gateway is {status['state']}: {status['reason']}", flush=True)
                self._go_on()
        steady = distances and abs(self._status()["playout"]["delay_ms"] - delay) < 1.0
        distance = statistics.median(distances) / 1e6 - delay if steady else None
        before, self._counts = self._counts, self._counters()
        late, missed = (now - then for now, then in zip(self._counts, before))
        memory = tuple(round(resident_mb(pid), 1) for pid in self.fleet.pids)
        machine = self.probe.taken()
        seen = machine["pauses"], machine["longest_ms"], *self._replies.taken(machine)
        self.minutes.append(Minute(memory, late, lost + missed, distance, holds, *seen))
        return self.minutes[-1]

    def _second(self, distances: list[int]) -> int:
        """Stream for a second; return how many commands and states did not reach the broker, and note the distances [ns]."""
        self.fleet.gates.sent.clear()
        self.fleet.gates.received.clear()
        self.fleet.gates.stream(1.0)
        commands, states = self.fleet.ask("taken")
        distances += command_to_rsi(states)
        lost = sum(self._replies.add(number, stamp) for _, number, stamp, _ in states)
        arrived = {(robot, stamp) for robot, stamp, _ in commands}
        if self._status()["state"] == "following":
            # a command that is under way at the end of this second arrives in the next
            lost += len(self._under_way - arrived)
            self._under_way = set(self.fleet.gates.sent) - arrived
        else:
            # nothing is sent to an arm that holds
            self._under_way = set()
        return lost

    def _go_on(self) -> None:
        """Begin the motion again from the pose at which the arm holds: after a silence at once, otherwise by `reset`."""
        # it brakes first
        self.fleet.gates.rest()
        self.fleet.gates.stream(1.0)
        self.fleet.gates.rest()
        asking = threading.Thread()

        def following() -> bool:
            nonlocal asking
            self.fleet.gates.stream(0.5)
            status = self._status()
            if status["fault"] and not asking.is_alive():
                # beside the stream: it is answered once the gateway has been armed for that
                asking = threading.Thread(target=self._reset, daemon=True)
                asking.start()
            return status["state"] == "following"

        wait_for(following, 60.0, "the motion after a hold")
        self.fleet.gates.moves = True
        self.fleet.gates.stream(SETTLE)
        self.fleet.ask("taken")
        self._replies.interrupt()
        self._under_way = set()

    def replies(self) -> dict:
        """Return the spread of the reply time [us] since the begin."""
        return reply_spread(self._begin, self._status())

    def _status(self) -> dict:
        return self.fleet.ask("statuses")[self.fleet.names[0]]

    def _counters(self) -> tuple[int, int]:
        counters = self._status()["counters"]
        return sum(counters.get(name, 0) for name in CYCLES), counters.get("commands_lost", 0)


def verdict(minutes: list[Minute]) -> list[str]:
    """Return what is wrong, one sentence each; nothing: no drift, no growth, no lost cycle.

    Growth and drift compare the medians of the first and the last third. With six minutes or more the first minute, in which every
    process warms up, does not count.
    """
    wrong = []
    late, lost = sum(minute.late for minute in minutes), sum(minute.lost for minute in minutes)
    if late:
        pauses, longest = sum(minute.pauses for minute in minutes), max(minute.longest_ms for minute in minutes)
        held = sum(minute.held_up for minute in minutes)
        by_us = [minute.held_up_by_us for minute in minutes]
        ours = "an unknown number" if None in by_us else sum(by_us)
        machine = (
            f"the machine ran no process on a core {pauses} times for more than 1 ms, at most {longest:.1f} ms; "
            f"of {held} replies held up {ours} beside no pause of 0.25 ms"
        )
        wrong.append(f"{late} cycles late, skipped or irregular ({machine})")
    if lost:
        wrong.append(f"{lost} commands or states lost")
    holds = sum(minute.holds for minute in minutes)
    if holds:
        wrong.append(f"the arm held {holds} times")
    settled = minutes[1:] if len(minutes) >= 6 else minutes
    third = max(1, len(settled) // 3)
    for k, name in enumerate(PROCESSES):
        first, last = (statistics.median(m.memory[k] for m in part) for part in (settled[:third], settled[-third:]))
        if last - first > MAX_GROWTH:
            wrong.append(f"{name} grew from {first:.1f} to {last:.1f} MB")
    distances = [minute.distance for minute in settled if minute.distance is not None]
    if distances:
        first, last = statistics.median(distances[:third]), statistics.median(distances[-third:])
        if abs(last - first) > MAX_DRIFT:
            wrong.append(
                f"from command to RSI packet: {first:+.2f} ms beyond the playout's delay at first, {last:+.2f} at last"
            )
    return wrong


def main(arguments: list[str] | None = None) -> int:
    """Run the loop; return the exit code."""
    parser = argparse.ArgumentParser(description="The loop of one robot for an hour: drift, growth, lost cycles.")
    parser.add_argument("--minutes", type=float, default=60.0, help="[%(default)s]")
    parser.add_argument("--interval", type=float, default=60.0, help="of a line [s] [%(default)s]")
    parser.add_argument("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority; 0: none [%(default)s]")
    options = parser.parse_args(arguments)
    end_in_order()
    with tempfile.TemporaryDirectory() as folder, World(Path(folder)) as world:
        fleet = Fleet(world, 1, options.realtime)
        if not fleet.start(60.0):
            print("[soak] the gateway was not armed within 60 s")
            return 1
        soak = Soak(fleet, world.enter_context(MachineProbe(options.realtime)))
        columns = "".join(f"{name + ' MB':>12s}" for name in PROCESSES)
        print(
            f"{'minute':>7s}{columns}{'late':>6s}{'lost':>6s}{'beyond delay':>14s}{'holds':>6s}{'pauses':>8s}{'longest':>10s}"
            f"{'held up':>9s}{'by us':>7s}",
            flush=True,
        )
        for number in range(max(1, round(options.minutes * 60.0 / options.interval))):
            minute = soak.run(options.interval)
            memory = "".join(f"{value:12.1f}" for value in minute.memory)
            distance = "-" if minute.distance is None else f"{minute.distance:+.2f} ms"
            machine = f"{minute.holds:6d}{minute.pauses:8d}{minute.longest_ms:7.1f} ms{minute.held_up:9d}"
            machine += f"{'-' if minute.held_up_by_us is None else minute.held_up_by_us:>7}"
            print(f"{number + 1:7d}{memory}{minute.late:6d}{minute.lost:6d}{distance:>14s}{machine}", flush=True)
        print(f"the gateway's reply over all of it [us]: {soak.replies()}", flush=True)
        fleet.dismiss()
        rospy.signal_shutdown("done")
        release_realtime()
    wrong = verdict(soak.minutes)
    print(f"load {environment()['load']}")
    print("verdict: " + ("; ".join(wrong) if wrong else "no drift, no growth, no lost cycle"))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
