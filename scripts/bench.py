"""Runs the benchmarks: `python scripts/bench.py [NAME] [its options]`; NAME is one of `BENCHMARKS`, without it all of them.

Each writes its figures to results/bench/ and prints them. What they measure with (setup/bench-requirements.txt) is installed into
the project's venv first, because nothing else needs it.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BENCHMARKS = ("ik", "planning", "start", "link", "work", "monitor", "console", "stops")
#: What drives a browser is in a venv of its own.
BROWSER_PYTHON = ROOT / ".ws" / "browser" / "bin" / "python"
INSTALL = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"]


def main(arguments: list[str]) -> int:
    """Run what was selected; return the exit code of the first benchmark that failed."""
    selected = arguments[:1] if arguments[:1] and arguments[0] in BENCHMARKS else list(BENCHMARKS)
    options = arguments[1:] if arguments[:1] == selected else arguments
    subprocess.run([*INSTALL, ROOT / "setup/bench-requirements.txt"], check=True)
    for name in selected:
        python = BROWSER_PYTHON if name == "console" else sys.executable
        output = ROOT / "results" / "bench" / f"{name}.json"
        code = subprocess.run([python, ROOT / "benchmarks" / f"{name}.py", "--output", output, *options]).returncode
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
