"""Pauses of the machine itself, seen by a process per core that only sleeps, at a priority above the 250 Hz path.

If such a process wakes up late, its core ran no process at all meanwhile: the host of a virtual machine was busy, or the kernel. A
reply that is late during such a pause is the machine's fault; one that is late at another time is ours.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack

#: Time asleep, short enough to see what delays a single reply; and the delay of a wake-up that counts as a pause [ns].
PERIOD, PAUSE = 500_000, 1_000_000
#: A busy host may take a processor away in many short pieces. Pauses of this length and more help to explain a late reply [ns];
#: on an idle machine a watch wakes up at most 0.1 ms late.
SLIVER = 250_000
#: The controller's cycle, and how much longer the time between two replies is when the later one counts as held up [ns].
CYCLE, HELD_UP = 4_000_000, 2_000_000


class MachineProbe(ExitStack):
    """Watches cores until the end of the block.

    Args:
        realtime: SCHED_FIFO priority of the 250 Hz path; the probe's is 20 above it. 0: none, and the probe also sees what that
            path does.
        period: Time asleep between two wake-ups [ns]: a shorter pause may pass unseen, and every wake-up costs processor time.
        cores: Numbers of those to watch; None: every one that this process may use.

    Attributes:
        watches: One per core.
    """

    def __init__(self, realtime: int, period: int = PERIOD, cores: Iterable[int] | None = None):
        super().__init__()
        priority = realtime + 20 if realtime else 0
        self.watches = [self._start(core, priority, period) for core in cores or sorted(os.sched_getaffinity(0))]

    def _start(self, core: int, priority: int, period: int) -> subprocess.Popen:
        command = [sys.executable, __file__, str(core), str(priority), str(period)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        # it ends with its standard input, which is closed at the end of the block
        return self.enter_context(subprocess.Popen(command, text=True, bufsize=1, **pipes))

    def taken(self) -> dict:
        """Return the pauses since the last call: their number, the longest one and their sum [ms].

        ``intervals`` are the beginnings and ends on the monotonic clock [ns] of all pauses of `SLIVER` and more. ``above`` says
        whether every watch has its priority; without it a pause may also be due to another program.
        """
        seen = []
        for watch in self.watches:
            watch.stdin.write("\n")
            seen.append(json.loads(watch.stdout.readline()))
        return {
            "pauses": sum(one["pauses"] for one in seen),
            "longest_ms": max(one["longest_ms"] for one in seen),
            "stood_ms": round(sum(one["stood_ms"] for one in seen), 1),
            "intervals": sorted(tuple(interval) for one in seen for interval in one["intervals"]),
            "above": all(one["above"] for one in seen),
        }


class Replies:
    """The times of a gateway's replies, taken from its states: how many replies were held up, by the machine or by us."""

    def __init__(self):
        # stretches of states without a gap in their numbers: what happened in a gap is not known
        self._stretches: list[list[int]] = [[]]
        self._number: int | None = None

    def add(self, number: int, stamp: int) -> int:
        """Note a state; return how many are missing between the previous one and this.

        Args:
            stamp: Monotonic clock [ns].
        """
        missing = 0 if self._number is None else number - self._number - 1
        if self._number is None or missing:
            self._stretches.append([])
        self._stretches[-1].append(stamp)
        self._number = number
        return missing

    def interrupt(self) -> None:
        """Begin a new stretch: the next state has no predecessor."""
        self._number = None

    def taken(self, machine: dict) -> tuple[int, int | None]:
        """Return how many replies were held up since the last call, and how many of these no pause of the machine explains.

        The second number is None where the probe had no priority above ours, because its pauses are then also due to us.

        Args:
            machine: Of the same time; see `MachineProbe.taken`.
        """
        held = [held_up(stretch, machine["intervals"]) for stretch in self._stretches]
        self._stretches = [self._stretches[-1][-1:]]
        return sum(late for late, _ in held), sum(ours for _, ours in held) if machine["above"] else None


def held_up(stamps: Sequence[int], intervals: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Return how many replies came late after the one before them, and how many of these no pause of the machine explains.

    Pauses explain a late reply if they cover at least half of the time by which it exceeds a cycle. Pauses of every core count,
    because gateway and controller move between cores. The kernel's throttling of real-time tasks counts as a pause, too.

    Args:
        stamps: Of the replies, rising, on the monotonic clock [ns].
        intervals: Beginnings and ends of pauses, rising, of all cores; see `MachineProbe.taken`.
    """
    late = unexplained = first = 0
    for earlier, later in zip(stamps, stamps[1:]):
        beyond = later - earlier - CYCLE
        if beyond < HELD_UP:
            continue
        late += 1
        covered, at = 0, earlier
        while first < len(intervals) and intervals[first][1] < earlier:
            first += 1
        for begin, end in intervals[first:]:
            if begin >= later:
                break
            # pauses of two cores may overlap, what they share counts once
            covered += max(0, min(end, later) - max(begin, at))
            at = max(at, end)
        unexplained += covered < beyond / 2
    return late, unexplained


def watch(core: int, priority: int, period: int) -> None:
    """Sleep and measure how late each wake-up is; answer each line of the standard input with a line of JSON."""
    os.sched_setaffinity(0, {core})
    above = False
    if priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            above = True
        except PermissionError:
            print("machine probe: SCHED_FIFO not permitted", file=sys.stderr)
    late: list[tuple[int, int]] = []
    looked, answering = time.monotonic_ns(), 0
    while True:
        asked, _, _ = select.select([sys.stdin], [], [], period / 1e9)
        now = time.monotonic_ns()
        # a pause between two rounds of this loop counts, the work of an answer does not
        due = looked + answering + period
        looked, answering = now, 0
        if now - due > SLIVER:
            late.append((due, now))
        if asked:
            began = time.process_time_ns()
            if not sys.stdin.readline():
                return
            lengths = [(end - begin) / 1e6 for begin, end in late if end - begin > PAUSE]
            seen = {"pauses": len(lengths), "longest_ms": round(max(lengths, default=0.0), 1), "stood_ms": sum(lengths)}
            print(json.dumps(seen | {"intervals": late, "above": above}), flush=True)
            late.clear()
            answering = time.process_time_ns() - began


if __name__ == "__main__":
    watch(*map(int, sys.argv[1:]))
