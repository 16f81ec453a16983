"""Runs launch/build.launch and ends with its success: `python scripts/build.py [launch arguments]`.

The ledger of such a session begins empty: it lies in a ROS_HOME of its own, which ends with the session.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import demo

if __name__ == "__main__":
    logs = os.environ.get("ROS_LOG_DIR", str(Path.home() / ".ros/log"))
    with tempfile.TemporaryDirectory(prefix="construction_twin_build_") as home:
        os.environ.update(ROS_HOME=home, ROS_LOG_DIR=logs)
        code = demo.main(sys.argv[1:], "build", "work.json")
    sys.exit(code)
