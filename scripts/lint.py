"""Checks the sources without running them, and ends with one line per tool: `python scripts/lint.py`.

ruff checks style and format of every file, import-linter the order of the folders (.importlinter), mypy the types of package and
examples, size.py that nothing has grown.
The settings are in pyproject.toml. The tools run beside each other; `make test` counts each of them as one test.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
#: The programs lie beside the interpreter, in the venv.
BIN = Path(sys.executable).parent
#: What each tool is called with; the names are those of the tests.
TOOLS = {
    "ruff check": ("ruff", "check"),
    "ruff format": ("ruff", "format", "--check"),
    "import-linter": ("lint-imports", "--no-logo", "--no-cache"),
    "mypy": ("mypy",),
    "size": ("python", "scripts/size.py", "--check"),
}


@dataclass(frozen=True)
class Finding:
    """What a tool said.

    Attributes:
        name: A key of `TOOLS`.
        output: Everything that it printed.
    """

    name: str
    passed: bool
    output: str


def start() -> dict[str, subprocess.Popen]:
    """Start every tool; `end` waits for them."""
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "NO_COLOR": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return {
        name: subprocess.Popen([BIN / program, *arguments], cwd=ROOT, env=environment, **pipes)
        for name, (program, *arguments) in TOOLS.items()
    }


def end(runs: dict[str, subprocess.Popen]) -> list[Finding]:
    """Wait for the tools that were started; return what each of them found."""
    findings = []
    for name, run in runs.items():
        output, _ = run.communicate()
        findings.append(Finding(name, run.returncode == 0, output))
    return findings


def main() -> int:
    """Run every tool, show what it found, and return the exit code."""
    findings = end(start())
    for finding in findings:
        if not finding.passed:
            print(finding.output, flush=True)
    for finding in findings:
        print(f"{finding.name}: {'passed' if finding.passed else 'failed'}")
    return 0 if all(finding.passed for finding in findings) else 1


if __name__ == "__main__":
    sys.exit(main())
