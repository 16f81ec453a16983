"""Runs the whole system with the mock arm for an hour and says whether it grows, holds or loses anything: `make test ARGS=soak`.

The arm moves to and fro. Every minute it prints a line: memory of all processes, late replies, and how often and for how long a
core ran no process (benchmarks/machine.py). It ends where a motion does not. `ARGS="soak --minutes 5"` is a shorter run.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "benchmarks"), str(ROOT / "test/integration")]

from link_world import REALTIME, end_in_order  # noqa: E402
from machine import MachineProbe  # noqa: E402
from start import Launch, launched  # noqa: E402

#: Growth of a program's memory up to here is noise [MB].
MAX_GROWTH = 2.0
#: Counters of the gateway that say that a cycle went wrong.
CYCLES = (
    "late_replies",
    "commands_lost",
    "telegrams_skipped",
    "ipoc_steps_irregular",
    "sessions_by_ipoc_jump",
    "stops_silence",
    "stops_refused",
)


def run(launch: Launch, probe: MachineProbe, minutes: float, interval: float) -> list[str]:
    """Move and print a line per interval [s]; return what is wrong, one sentence each."""
    # the robot's namespace is read on import, and must not be that of the launch
    os.environ |= launch.ros | {"ROS_NAMESPACE": "/kr120"}
    import rospy
    from twin_client import LEFT, RIGHT, TwinClient

    rospy.init_node("soak", disable_signals=True)
    client = TwinClient()

    def counts() -> dict[str, int]:
        counters = client.gateway_counters()
        return {name: int(counters.get(name, 0)) for name in CYCLES}

    memory: list[dict[str, float]] = []
    try:
        client.wait_until_ready()
        before = last = counts()
        print(f"{'minute':>7}{'MB':>7}{'late':>6}{'pauses':>8}{'longest':>10}")
        for number in range(max(1, round(minutes * 60.0 / interval))):
            probe.taken()
            end = time.monotonic() + interval
            while time.monotonic() < end:
                client.go_to(LEFT)
                client.go_to(RIGHT)
            machine, now = probe.taken(), counts()
            memory.append(launch.memory())
            row = f"{number + 1:7d}{sum(memory[-1].values()):7.0f}{now['late_replies'] - last['late_replies']:6d}"
            print(f"{row}{machine['pauses']:8d}{machine['longest_ms']:7.1f} ms", flush=True)
            last = now
    except AssertionError as error:
        return [str(error)]
    finally:
        rospy.signal_shutdown("done")
    # in the first minutes every process warms up
    first, final = memory[min(5, len(memory) - 1)], memory[-1]
    growth = {name: size - first.get(name, 0.0) for name, size in final.items()}
    return [f"{last[name] - before[name]} {name}" for name in CYCLES if last[name] != before[name]] + [
        f"{name} grew by {size:.1f} MB" for name, size in growth.items() if size > MAX_GROWTH
    ]


def main() -> int:
    """Run the system; return the exit code."""
    parser = argparse.ArgumentParser(prog="make test ARGS=soak", description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="[%(default)s]")
    parser.add_argument("--interval", type=float, default=60.0, help="of a line [s] [%(default)s]")
    options = parser.parse_args()
    end_in_order()
    with launched(()) as launch, MachineProbe(REALTIME) as probe:
        launch.await_line("ready; plan with")
        wrong = run(launch, probe, options.minutes, options.interval)
    print(f"verdict: {'; '.join(wrong) or 'no growth, no hold, no lost cycle'}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
