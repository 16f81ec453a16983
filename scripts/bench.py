"""Runs the benchmarks: `python scripts/bench.py [NAME] [its options]`; NAME is one of `BENCHMARKS`, without it all of them.

Each writes its figures to results/bench/ and prints them. What they measure against (setup/bench-requirements.txt) is installed
into the project's venv first, because nothing else needs it.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REQUIREMENTS = ROOT / "setup" / "bench-requirements.txt"
BENCHMARKS = ("ik", "planning", "start", "link", "work", "monitor", "console", "stops")
#: What drives a browser is in a venv of its own.
BROWSER_PYTHON = ROOT / ".ws" / "browser" / "bin" / "python"


def missing(requirements: str) -> list[str]:
    """Return the lines ``name==version`` of a requirements file that are not installed in that version."""
    wanted = [line.strip() for line in requirements.splitlines() if line.strip() and not line.startswith("#")]
    return [line for line in wanted if installed(line.partition("==")[0]) != line.partition("==")[2]]


def installed(name: str) -> str | None:
    """Return the installed version of a distribution, None without one."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def main(arguments: list[str]) -> int:
    """Run what was selected; return the exit code of the first benchmark that failed."""
    selected = arguments[:1] if arguments[:1] and arguments[0] in BENCHMARKS else list(BENCHMARKS)
    options = arguments[1:] if arguments[:1] == selected[:1] and len(selected) == 1 else arguments
    wanted = missing(REQUIREMENTS.read_text())
    if wanted:
        print(f"[bench] installing {', '.join(wanted)}", flush=True)
        subprocess.run(
            [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted], check=True
        )
    for name in selected:
        python = str(BROWSER_PYTHON) if name == "console" else sys.executable
        command = [python, str(ROOT / "benchmarks" / f"{name}.py"), *options]
        code = subprocess.run([*command, "--output", str(ROOT / "results" / "bench" / f"{name}.json")]).returncode
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
