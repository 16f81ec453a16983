"""The link benchmark: routes, reply time and smoothness; writes results/bench/link.json.

``python benchmarks/link.py`` (`make bench ARGS=link`) takes about six minutes; every part can be shortened, left out, or made
longer for rare events (``--seconds 20 --reply-seconds 600``). The routes lead through the real bridge between a ROS master and
mosquitto on loopback; the `floor` is the same messages between two plain MQTT clients in the same round. Every process on the path
runs as launch/bringup.launch runs it: with SCHED_FIFO where the system permits it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import smoothness
from link_cell import Cell, Commander, reply_spread, shipped_config
from link_world import REALTIME, ROOT, World, end_in_order, environment, spread_ms, write_figures
from machine import MachineProbe

from construction_twin.core.realtime import release_realtime, request_realtime

ROUTES = ("ros_to_mqtt", "mqtt_to_ros", "round_trip", "duplex")
SUBJECTS = ("ours", "floor")
PARTS = ("routes", "reply", "smoothness")
#: Time from arming to the beginning of the measurement of replies [s].
SETTLE = 2.0


def measure_routes(rounds: int, seconds: float, rate_seconds: float, realtime: int) -> dict:
    """Return the figures of each route over all rounds; the highest rates are those of the last one."""
    taken: list[dict] = []
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "result.json"
        for number in range(rounds):
            tried = rate_seconds if number == rounds - 1 else 0.0
            options = {"--seconds": seconds, "--realtime": realtime, "--rate-seconds": tried, "--output": output}
            words = [str(word) for option in options.items() for word in option]
            # ROS nodes of a process are made once
            subprocess.run([sys.executable, Path(__file__).parent / "link_routes.py", *words], check=True)
            taken.append(json.loads(output.read_text()))
            print(f"[link] round {number + 1} of {rounds}: measured", flush=True)
    result = {
        route: {subject: pooled([one[subject][route] for one in taken]) for subject in SUBJECTS} for route in ROUTES
    }
    return result | {"max_rate_hz": taken[-1]["max_rate_hz"]}


def pooled(outcomes: list[dict]) -> dict:
    """Return the figures of several measurements of one route as one."""
    latencies = [latency for outcome in outcomes for latency in outcome["latencies"]]
    counts = {name: sum(outcome[name] for outcome in outcomes) for name in ("lost", "sent")}
    cpu = sum(outcome["cpu_s_per_1000"] for outcome in outcomes) / len(outcomes)
    return spread_ms(latencies) | counts | {"cpu_s_per_1000": round(cpu, 4)}


def measure_reply(seconds: float, loaded: bool, realtime: int) -> dict:
    """Return the spread of the gateway's reply time [us], late replies and cycles while a motion is streamed.

    From the kernel's time of arrival to the reply; beside it the gateway's ``state`` at the end and the ``machine``'s own pauses.
    Where the machine runs the mock controller late, the stream gets ahead of it and the gateway brakes, but goes on answering.

    Args:
        loaded: With one busy loop per core beside it, at normal priority.
    """
    config, home = shipped_config()
    with tempfile.TemporaryDirectory() as folder, World(Path(folder)) as world:
        world.start_broker(realtime)
        Cell(world, config, realtime)
        commander = Commander(world.broker_port, config, home)
        commander.arm()
        commander.stream(SETTLE)
        if loaded:
            for core in range(os.cpu_count() or 1):
                world.start(f"busy{core}", [sys.executable, "-c", "while True: pass"])
            commander.stream(SETTLE)
        probe = world.enter_context(MachineProbe(realtime))
        before = commander.next_status()
        probe.taken()
        commander.stream(seconds)
        machine = probe.taken()
        result = reply_spread(before, commander.next_status())
        commander.close()
        return result | {"state": commander.status["state"], "machine": machine}


def read_options() -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    option = parser.add_argument
    option("--output", type=Path, default=ROOT / "results/bench/link.json", help="file of the figures [%(default)s]")
    option("--parts", nargs="+", choices=PARTS, default=PARTS, help="what to measure [all]")
    option("--rounds", type=int, default=3, help="of the routes [%(default)s]")
    option("--seconds", type=float, default=8.0, help="per route [%(default)s]")
    option("--rate-seconds", type=float, default=1.0, help="per rate tried; 0: none [%(default)s]")
    option("--reply-seconds", type=float, default=60.0, help="of the reply time, idle; loaded a fifth [%(default)s]")
    option("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority where permitted; 0: none [%(default)s]")
    options = parser.parse_args()
    if options.rounds < 1 or min(options.seconds, options.reply_seconds) <= 0:
        parser.error("expected at least one round, and times above 0 s")
    return options


def main() -> None:
    """Measure, print, write."""
    options = read_options()
    end_in_order()
    before = environment()
    before["scheduling"] = request_realtime(options.realtime)
    release_realtime()
    result: dict = {}
    if "routes" in options.parts:
        result |= measure_routes(options.rounds, options.seconds, options.rate_seconds, options.realtime)
    if "reply" in options.parts:
        result["reply_us"] = {
            "idle": measure_reply(options.reply_seconds, False, options.realtime),
            "loaded": measure_reply(options.reply_seconds / 5.0, True, options.realtime),
        }
    if "smoothness" in options.parts:
        result["smoothness"] = smoothness.measure()
        result["smoothness_3_decimals"] = smoothness.measure(3)
    write_figures(options.output, result | {"environment": before | {"load_after": environment()["load"]}})


if __name__ == "__main__":
    main()
