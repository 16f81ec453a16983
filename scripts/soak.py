"""Runs the whole loop of one robot for an hour and says whether it grows, holds or loses anything: `make soak`.

The loop is gateway, mock controller, bridge, broker, and a commander on ROS that keeps the arm moving. Every minute it prints a
line: resident memory per process, late replies, the 99th percentile of the way out and back, and how often and for how long a core
ran no process (benchmarks/machine.py). It ends where the arm holds. `python scripts/soak.py --minutes 5` is a shorter run.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

import rospy  # noqa: E402
from link_fleet import Fleet  # noqa: E402
from link_world import REALTIME, World, end_in_order, environment, resident_mb  # noqa: E402
from machine import MachineProbe  # noqa: E402

from construction_twin.core.realtime import release_realtime  # noqa: E402

#: Growth of a process's memory up to here is noise [MB].
MAX_GROWTH = 2.0
#: Counters of the gateway that say that a cycle went wrong.
CYCLES = ("telegrams_skipped", "ipoc_steps_irregular", "sessions_by_ipoc_jump", "stops_silence", "stops_refused")


def run(fleet: Fleet, probe: MachineProbe, minutes: float, interval: float) -> list[str]:
    """Let the loop run and print a line per interval [s]; return what is wrong, one sentence each."""
    memory: list[dict[str, float]] = []
    late = 0
    before = fleet.ask("statuses")[fleet.names[0]]["counters"]
    print(f"{'minute':>7}{'bridge':>9}{'gateway':>9}{'mock':>9} MB{'late':>6}{'p99':>7} ms{'pauses':>8}{'longest':>9}")
    for number in range(max(1, round(minutes * 60.0 / interval))):
        probe.taken()
        figures, machine = fleet.measure(interval), probe.taken()
        memory.append({part: round(resident_mb(pids[0]), 1) for part, pids in fleet.pids.items()})
        late += figures["late"]
        sizes = "".join(f"{size:9.1f}" for size in memory[-1].values())
        row = f"{figures['late']:6d}{figures['p99_ms']:7.2f}   {machine['pauses']:8d}{machine['longest_ms']:6.1f} ms"
        print(f"{number + 1:7d}{sizes}   {row}", flush=True)
        if not figures["following"]:
            return [f"the arm held in minute {number + 1}"]
    counters = fleet.ask("statuses")[fleet.names[0]]["counters"]
    counts = {name: counters.get(name, 0) - before.get(name, 0) for name in (*CYCLES, "commands_lost")}
    wrong = [f"{count} {name}" for name, count in ({"late replies": late} | counts).items() if count]
    # in the first minutes every process warms up
    first, last = memory[min(5, len(memory) - 1)], memory[-1]
    return wrong + [
        f"{part} grew by {last[part] - first[part]:.1f} MB" for part in last if last[part] - first[part] > MAX_GROWTH
    ]


def main() -> int:
    """Run the loop; return the exit code."""
    parser = argparse.ArgumentParser(description="The loop of one robot for an hour: growth, holds, lost cycles.")
    parser.add_argument("--minutes", type=float, default=60.0, help="[%(default)s]")
    parser.add_argument("--interval", type=float, default=60.0, help="of a line [s] [%(default)s]")
    parser.add_argument("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority; 0: none [%(default)s]")
    options = parser.parse_args()
    end_in_order()
    with tempfile.TemporaryDirectory() as folder, World(Path(folder)) as world:
        fleet = Fleet(world, 1, options.realtime)
        fleet.start(60.0)
        wrong = run(fleet, world.enter_context(MachineProbe(options.realtime)), options.minutes, options.interval)
        fleet.dismiss()
        rospy.signal_shutdown("done")
        release_realtime()
    print(f"load {environment()['load']}\nverdict: {'; '.join(wrong) or 'no growth, no hold, no lost cycle'}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
