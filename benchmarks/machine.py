"""Whether the machine itself kept anybody waiting: a process per core that only sleeps, at a priority above the 250 Hz path.

When such a process wakes up late, nobody on that core was run: a virtual machine whose host is busy, or the kernel. A late reply during
such a pause says something of the machine; one beside it says something of us.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack

#: Time asleep, short enough to see what holds up a single reply, and lateness from which on a wake-up counts as a pause [ns].
PERIOD, PAUSE = 500_000, 1_000_000
#: A host that gives a processor away in slivers makes pauses that none is long, one after the other: from here on they are part of
#: an explanation [ns]. Awake and left alone a watch is late by 0.1 ms at most.
SLIVER = 250_000
#: The controller's cycle, and from how much more between two replies on one of them was held up [ns].
CYCLE, HELD_UP = 4_000_000, 2_000_000


class MachineProbe(ExitStack):
    """Watches every core until the end of the block.

    Parameters
    ----------
    realtime : int
        SCHED_FIFO priority of the 250 Hz path; the probe's is 20 above it. 0: none, and the probe also sees what that path does.
    period : int, optional
        Time asleep between two looks [ns]: a pause that is shorter may pass unseen, and every look costs.
    """

    def __init__(self, realtime: int, period: int = PERIOD):
        super().__init__()
        priority = realtime + 20 if realtime else 0
        self._watches = [self._start(core, priority, period) for core in sorted(os.sched_getaffinity(0))]

    def _start(self, core: int, priority: int, period: int) -> subprocess.Popen:
        command = [sys.executable, __file__, str(core), str(priority), str(period)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        # it ends with its standard input; leaving the block closes that and waits
        return self.enter_context(subprocess.Popen(command, text=True, bufsize=1, **pipes))

    def taken(self) -> dict:
        """Return what was seen since the last call: number of pauses, the longest and all of them together [ms].

        ``intervals`` are beginnings and ends on the monotonic clock [ns], also of shorter ones: of `SLIVER` and more. ``above`` says
        whether every watch has its priority; else its pauses are also those that other programs made.
        """
        seen = []
        for watch in self._watches:
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
    """When a gateway answered, told by its states; says how many replies were held up, and by whom."""

    def __init__(self):
        # stretches of states without a gap in their numbers: over a gap nobody knows what happened
        self._stretches: list[list[int]] = [[]]
        self._number: int | None = None

    def add(self, number: int, stamp: int) -> int:
        """Note a state; return how many are missing between the last one and this.

        Parameters
        ----------
        number : int
        stamp : int
            Monotonic clock [ns].
        """
        missing = 0 if self._number is None else number - self._number - 1
        if self._number is None or missing:
            self._stretches.append([])
        self._stretches[-1].append(stamp)
        self._number = number
        return missing

    def interrupt(self) -> None:
        """Let the next state follow on nothing."""
        self._number = None

    def taken(self, machine: dict) -> tuple[int, int | None]:
        """Return how many replies were held up since the last call, and how many of these by no pause of the machine: by us.

        The latter is None where the probe had no priority above ours, and so saw what we do.

        Parameters
        ----------
        machine : dict
            Of the same time; see `MachineProbe.taken`.
        """
        held = [held_up(stretch, machine["intervals"]) for stretch in self._stretches]
        self._stretches = [self._stretches[-1][-1:]]
        return sum(late for late, _ in held), sum(ours for _, ours in held) if machine["above"] else None


def held_up(stamps: Sequence[int], intervals: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Return how many replies came late after the one before them, and how many of these no pause of the machine explains.

    A pause explains a reply when it covers at least half of what the distance to the one before is beyond a cycle. Whose core it
    was is not asked: gateway and controller move between cores. Where the kernel throttles real-time tasks that counts as a pause too.

    Parameters
    ----------
    stamps : sequence of int
        Of the replies, rising, on the monotonic clock [ns].
    intervals : sequence of tuple
        Beginnings and ends of pauses, rising, of all cores; see `MachineProbe.taken`.
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
    """Sleep and see how late the wake-ups are; answer each line of the standard input with a line of JSON."""
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
        # also a pause in which somebody asked, or between two looks; the work of an answer is none
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
