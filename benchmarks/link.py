"""The link benchmark: routes, reply time, fleet and smoothness; writes results/bench/link.json and link_details.json.

``python benchmarks/link.py`` (`make bench ARGS=link`) takes about ten minutes; every part can be shortened, left out, or made
longer for rare events (``--seconds 20 --reply-seconds 600``). `ours` is the real bridge between a ROS master and mosquitto on
loopback; the `floor` is bare rospy and bare paho that hand each other bytes. Both are measured in turns in the same run. Every
process on the path runs as launch/bringup.launch runs it: with SCHED_FIFO where the system permits it, both ends and the floor
included. The first file has a fixed shape; everything else (end to end, the playout's delay, every round, the floor's highest
rates, 3 decimals, no MQTT 5 properties) is in the second one.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import link_reply
import smoothness
from link_world import REALTIME, ROOT, end_in_order, environment, spread_ms

from construction_twin.core.realtime import release_realtime, request_realtime

ROUTES = ("ros_to_mqtt", "mqtt_to_ros", "round_trip", "duplex")
SUBJECTS = ("ours", "floor")
PARTS = ("routes", "reply", "fleet", "smoothness")
_HERE = Path(__file__).parent
_NEVER = 3600.0
#: Longest time for a number of robots, and more per robot [s]: should the measurement itself get no time to give up.
FLEET_PATIENCE, PER_ROBOT = 60.0, 8.0


def run_worker(script: str, *options: object, timeout: float = _NEVER) -> dict | None:
    """Run a part of the benchmark in a process of its own; return its JSON, None when it had to be ended after `timeout` [s]."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "result.json"
        command = [sys.executable, _HERE / script, *options, "--output", output]
        process = subprocess.Popen([str(part) for part in command])
        try:
            code = process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None
        finally:
            process.terminate()  # it ends what it started
            process.wait()
        if code:
            raise SystemExit(f"{script} ended with code {code}")
        return json.loads(output.read_text())


def measure_routes(rounds: int, seconds: float, rate_seconds: float, realtime: int) -> tuple[dict, dict]:
    """Return the routes' figures over all rounds, and those of each round.

    The subjects take turns, and every other round begins with the floor, so that changes of the machine affect both.
    """
    taken: dict[str, list[dict]] = {subject: [] for subject in SUBJECTS}
    for number in range(rounds):
        for subject in SUBJECTS[:: 1 if number % 2 == 0 else -1]:
            last = number == rounds - 1
            options = ["--subject", subject, "--seconds", seconds, "--realtime", realtime]
            taken[subject].append(
                run_worker("link_routes.py", *options, "--rate-seconds", rate_seconds if last else 0.0)
            )
            print(f"[link] round {number + 1} of {rounds}, {subject}: measured", flush=True)
    result = {
        route: {subject: pooled([one[route] for one in taken[subject]]) for subject in SUBJECTS} for route in ROUTES
    }
    highest = {subject: taken[subject][-1]["max_rate_hz"] for subject in SUBJECTS}
    details = {
        "rounds": [
            {subject: {route: pooled([taken[subject][k][route]]) for route in ROUTES} for subject in SUBJECTS}
            for k in range(rounds)
        ],
        "max_rate_hz_floor": highest["floor"],
    }
    return result | {"max_rate_hz": highest["ours"]}, details


def pooled(outcomes: list[dict]) -> dict:
    """Return the figures of several measurements of one route as one."""
    latencies = [latency for outcome in outcomes for latency in outcome["latencies"]]
    counts = {name: sum(outcome[name] for outcome in outcomes) for name in ("lost", "sent")}
    cpu = sum(outcome["cpu_s_per_1000"] for outcome in outcomes) / len(outcomes)
    return spread_ms(latencies) | counts | {"cpu_s_per_1000": round(cpu, 4)}


def measure_fleet(sizes: Sequence[int], seconds: float, realtime: int) -> tuple[list[dict], dict]:
    """Return a row per number of robots, up to the first that the machine does not carry, and the details."""
    rows, details = [], {"fleet": []}
    for robots in sizes:
        row = run_worker(
            "link_fleet.py",
            "--robots",
            robots,
            "--seconds",
            seconds,
            "--timeout",
            20 + 5 * robots,
            "--realtime",
            realtime,
            timeout=FLEET_PATIENCE + PER_ROBOT * robots + 2 * seconds,
        )
        if row is None:
            rows.append({"robots": robots, "cpu_per_robot": None, "p99_ms": None, "late": None})
            print(f"[link] {robots} robots: more than this machine carries", flush=True)
            break
        details |= {"end_to_end": row.pop("end_to_end")} if "end_to_end" in row else {}
        details["fleet"].append(row)
        rows.append({name: row[name] for name in ("robots", "cpu_per_robot", "p99_ms", "late")})
        print(f"[link] {robots} robots: {row}", flush=True)
        if row["following"] < robots:
            break
    return rows, details


def show(result: dict, details: dict) -> None:
    """Print the tables."""
    columns = ("p50_ms", "p99_ms", "p99_9_ms", "max_ms", "lost", "sent", "cpu_s_per_1000")
    if "duplex" in result:
        print(f"\n{'route':13s}{'':7s}" + "".join(f"{column:>16s}" for column in columns))
    for route in (route for route in ROUTES if route in result):
        for subject in SUBJECTS:
            row = result[route][subject]
            print(f"{route:13s}{subject:7s}" + "".join(f"{row[column]!s:>16s}" for column in columns))
    if "max_rate_hz" in result:
        print(f"highest rate without loss [Hz]: {result['max_rate_hz']}; floor: {details['max_rate_hz_floor']}")
    for load, row in result.get("reply_us", {}).items():
        beside = details["reply"][load]
        print(f"reply time, {load} [us]: {row}; {beside}")
    for name, value in details.get("end_to_end", {}).items():
        print(f"{name}: {value}")
    if "fleet" in result:
        print(f"\n{'robots':>8s}{'cpu per robot':>15s}{'p99 [ms]':>10s}{'late':>6s}")
        for row in result["fleet"]:
            print(f"{row['robots']:8d}{row['cpu_per_robot']!s:>15s}{row['p99_ms']!s:>10s}{row['late']!s:>6s}")
    if "smoothness" in result:
        print()
        smoothness.print_ratios(result["smoothness"])


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    option = parser.add_argument
    option("--output", type=Path, default=ROOT / "results/bench/link.json", help="file of the figures [%(default)s]")
    option("--parts", nargs="+", choices=PARTS, default=PARTS, help="what to measure [all]")
    option("--rounds", type=int, default=3, help="of the routes [%(default)s]")
    option("--seconds", type=float, default=8.0, help="per route [%(default)s]")
    option("--rate-seconds", type=float, default=1.0, help="per rate tried; 0: none [%(default)s]")
    option(
        "--reply-seconds", type=float, default=60.0, help="of the reply time, idle; loaded a fifth of it [%(default)s]"
    )
    option(
        "--fleet",
        type=int,
        nargs="+",
        default=(1, 2, 4, 8, 16),
        help="numbers of robots, to the first not carried [1 2 4 8 16]",
    )
    option("--fleet-seconds", type=float, default=5.0, help="per number of robots [%(default)s]")
    option("--realtime", type=int, default=REALTIME, help="SCHED_FIFO priority where permitted; 0: none [%(default)s]")
    options = parser.parse_args(arguments)
    if options.rounds < 1 or min(options.seconds, options.reply_seconds, options.fleet_seconds) <= 0:
        parser.error("expected at least one round, and times above 0 s")
    return options


def measure(options: argparse.Namespace) -> tuple[dict, dict]:
    """Run the selected parts; return the figures and the details."""
    result: dict = {}
    details: dict = {}
    if "routes" in options.parts:
        result, details = measure_routes(options.rounds, options.seconds, options.rate_seconds, options.realtime)
    if "reply" in options.parts:
        result["reply_us"], details["reply"] = {}, {}
        for name, fraction in (("idle", 1.0), ("loaded", 0.2)):
            reply, beside = link_reply.measure(options.reply_seconds * fraction, name == "loaded", options.realtime)
            result["reply_us"][name], details["reply"][name] = reply, beside
    if "fleet" in options.parts:
        result["fleet"], fleet = measure_fleet(options.fleet, options.fleet_seconds, options.realtime)
        details |= fleet
    if "smoothness" in options.parts:
        result["smoothness"] = smoothness.measure()
        details["smoothness_3_decimals"] = smoothness.measure(3)
        details["smoothness_without_properties"] = smoothness.measure(properties=False)
    return result, details


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, write."""
    options = read_options(arguments)
    end_in_order()
    before = environment()
    before["scheduling"] = request_realtime(options.realtime)
    release_realtime()
    result, details = measure(options)
    after = environment()["load"]
    show(result, details)
    result["environment"] = before | {"load_after": after}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(result, indent=2) + "\n")
    beside = options.output.with_name(f"{options.output.stem}_details.json")
    beside.write_text(json.dumps(details, indent=2) + "\n")
    print(f"written to {options.output} and {beside.name}; load before {before['load']}, after {after}")


if __name__ == "__main__":
    main()
