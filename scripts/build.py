"""Runs launch/build.launch and ends with its success: `python scripts/build.py [launch arguments]`.

The ledger of such a session begins empty: it lies in a ROS_HOME of its own, which ends with the session.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from demo import launch, launch_arguments, newest_link, results_folder


def main(arguments: list[str]) -> int:
    """Build; return the exit code: 0 when the session left a new ``work.json``, else 1 after a sentence."""
    given = launch_arguments(arguments)
    results = results_folder(given)
    before = newest_link(results, "work.json")
    logs = Path(os.environ.get("ROS_LOG_DIR", Path.home() / ".ros/log"))
    with tempfile.TemporaryDirectory(prefix="construction_twin_build_") as home:
        os.environ.update(ROS_HOME=home, ROS_LOG_DIR=str(logs))
        launch(arguments if "results_dir" in given else [f"results_dir:={results}", *arguments], "build")
    if newest_link(results, "work.json") in (None, before):
        sentence = "the session did not finish; the sentences above say why. Logs of every node"
        print(f"build: {sentence}: {logs / 'latest'}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
