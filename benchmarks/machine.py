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
from contextlib import ExitStack

#: Time asleep, and lateness from which on a wake-up counts as a pause [ns].
PERIOD, PAUSE = 2_000_000, 1_000_000


class MachineProbe(ExitStack):
    """Watches every core until the end of the block.

    Parameters
    ----------
    realtime : int
        SCHED_FIFO priority of the 250 Hz path; the probe's is 20 above it. 0: none, and the probe also sees what that path does.
    """

    def __init__(self, realtime: int):
        super().__init__()
        priority = realtime + 20 if realtime else 0
        self._watches = [self._start(core, priority) for core in sorted(os.sched_getaffinity(0))]

    def _start(self, core: int, priority: int) -> subprocess.Popen:
        command = [sys.executable, __file__, str(core), str(priority)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        # it ends with its standard input; leaving the block closes that and waits
        return self.enter_context(subprocess.Popen(command, text=True, bufsize=1, **pipes))

    def taken(self) -> dict:
        """Return what was seen since the last call: number of pauses, the longest and all of them together [ms].

        ``above`` says whether every watch has its priority; else its pauses are also those that other programs made.
        """
        seen = []
        for watch in self._watches:
            watch.stdin.write("\n")
            seen.append(json.loads(watch.stdout.readline()))
        return {
            "pauses": sum(one["pauses"] for one in seen),
            "longest_ms": max(one["longest_ms"] for one in seen),
            "stood_ms": round(sum(one["stood_ms"] for one in seen), 1),
            "above": all(one["above"] for one in seen),
        }


def watch(core: int, priority: int) -> None:
    """Sleep and see how late the wake-ups are; answer each line of the standard input with a line of JSON."""
    os.sched_setaffinity(0, {core})
    above = False
    if priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            above = True
        except PermissionError:
            print("machine probe: SCHED_FIFO not permitted", file=sys.stderr)
    late: list[int] = []
    while True:
        due = time.monotonic_ns() + PERIOD
        asked, _, _ = select.select([sys.stdin], [], [], PERIOD / 1e9)
        if asked:
            if not sys.stdin.readline():
                return
            longest, together = max(late, default=0) / 1e6, sum(late) / 1e6
            seen = {"pauses": len(late), "longest_ms": round(longest, 1), "stood_ms": together, "above": above}
            print(json.dumps(seen), flush=True)
            late.clear()
        elif time.monotonic_ns() - due > PAUSE:
            late.append(time.monotonic_ns() - due)


if __name__ == "__main__":
    watch(int(sys.argv[1]), int(sys.argv[2]))
