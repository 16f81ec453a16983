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
from collections.abc import Iterable
from contextlib import ExitStack

#: Time asleep, short enough to see what delays a single reply; and the delay of a wake-up that counts as a pause [ns].
PERIOD, PAUSE = 500_000, 1_000_000


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

        ``above`` says whether every watch has its priority; without it a pause may also be due to another program.
        """
        seen = []
        for watch in self.watches:
            watch.stdin.write("\n")
            seen.append(json.loads(watch.stdout.readline()))
        return {
            "pauses": sum(one["pauses"] for one in seen),
            "longest_ms": max(one["longest_ms"] for one in seen),
            "stood_ms": round(sum(one["stood_ms"] for one in seen), 1),
            "above": all(one["above"] for one in seen),
        }


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
    late: list[float] = []
    looked, answering = time.monotonic_ns(), 0
    while True:
        asked, _, _ = select.select([sys.stdin], [], [], period / 1e9)
        now = time.monotonic_ns()
        # a pause between two rounds of this loop counts, the work of an answer does not
        due = looked + answering + period
        looked, answering = now, 0
        if now - due > PAUSE:
            late.append((now - due) / 1e6)
        if asked:
            began = time.process_time_ns()
            if not sys.stdin.readline():
                return
            seen = {"pauses": len(late), "longest_ms": round(max(late, default=0.0), 1), "stood_ms": sum(late)}
            print(json.dumps(seen | {"above": above}), flush=True)
            late.clear()
            answering = time.process_time_ns() - began


if __name__ == "__main__":
    watch(*map(int, sys.argv[1:]))
