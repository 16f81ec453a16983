"""Runs every shipped scenario three times: `make test ARGS=scenarios`.

`python scripts/scenarios.py --runs 1 stall_replan estop` runs these two once each. Results are in results/scenarios/run_N. The exit
code is 0 if every run passed. Run it on an idle machine: other load changes the figures.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "results" / "scenarios"
#: Longest that one run may take [s].
TIME_LIMIT = 180


def run(name: str, folder: Path, options: argparse.Namespace) -> int:
    """Run a scenario as a user does; return its exit code."""
    folder.mkdir(parents=True, exist_ok=True)
    # a run that ends without a verdict must not be judged by an older one
    (folder / name / "verdict.json").unlink(missing_ok=True)
    launch = subprocess.Popen(
        [
            *("roslaunch", "-p", str(options.master_port), "construction_twin", "scenario.launch"),
            *(f"scenario:={name}", f"results_dir:={folder}", f"gateway_trace:={folder}/gateway.trace"),
            *(f"broker_port:={options.broker_port}", f"rsi_port:={options.rsi_port}"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=os.environ
        | {"ROS_MASTER_URI": f"http://127.0.0.1:{options.master_port}", "ROS_HOME": str(folder / "ros_home")},
    )
    try:
        output, _ = launch.communicate(timeout=TIME_LIMIT)
    except subprocess.TimeoutExpired:
        launch.send_signal(signal.SIGINT)  # lets it end its nodes
        output, _ = launch.communicate()
    (folder / f"{name}.log").write_text(output)
    passed = f"{name}: passed" in output
    print(f"{folder.name} {name}: {'passed' if passed else f'FAILED, see {folder}/{name}.log'}", flush=True)
    return 0 if passed else 1


def main() -> int:
    """Run what the options say; return the exit code."""
    shipped = [path.stem for path in sorted((ROOT / "config" / "scenarios").glob("*.yaml"))]
    parser = argparse.ArgumentParser(description="Run the scenarios.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenarios; default: all")
    parser.add_argument("--runs", type=int, default=3, help="of each [%(default)s]")
    parser.add_argument("--master-port", type=int, default=11611, help="of the ROS master [%(default)s]")
    parser.add_argument("--broker-port", type=int, default=18950, help="[%(default)s]")
    parser.add_argument("--rsi-port", type=int, default=49350, help="[%(default)s]")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(shipped))
    if unknown:
        parser.error(f"no scenario {', '.join(unknown)}; there are {', '.join(shipped)}")
    if not options.names:
        shutil.rmtree(RESULTS, ignore_errors=True)
    folders = [RESULTS / f"run_{number}" for number in range(1, options.runs + 1)]
    failures = sum(run(name, folder, options) for folder in folders for name in options.names or shipped)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
