"""Behind `make demo` and `make build`: runs experiment.launch or build.launch and ends with its success.

    python scripts/demo.py {demo,build} [launch arguments]
    python scripts/demo.py demo gazebo [launch arguments]    # with the twin in Gazebo 11
    python scripts/demo.py demo screenshots [SCENE...]       # takes the pictures of docs/images again

A filter drops what roslaunch prints about itself. On a terminal the variable TTY_COMPATIBLE tells rich in the experiment to draw
its progress bar, which passes the filter unchanged. The ledger of `build` begins empty: it lies in a ROS_HOME of its own.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
#: Lines of roslaunch about itself, not about the experiment.
NOISE = re.compile(
    rb"process\[|setting /run_id|started core service|auto-starting|started roslaunch|ROS_MASTER_URI=|logging to|Checking log|"
    rb"Press Ctrl-C|Done checking|killing on exit|shutting down processing monitor|^done$"
)
#: The experiment ends the launch by ending itself; everything after this is roslaunch cleaning up.
END = re.compile(rb"REQUIRED process \[.*/(experiment|build)-")
#: How rich begins to draw a bar, and what it must not leave undone: making the cursor visible again.
BAR = re.compile(rb"\r|\x1b\[\?25l|\x1b\[2K")
CURSOR = b"\x1b[?25h"


class Filter:
    """Drops noise from a byte stream, line by line; a progress bar, which rewrites its line, passes at once."""

    def __init__(self):
        self._tail = b""
        self._bar = False
        self._blank = False
        self._noise = True
        self._ended = False

    def feed(self, data: bytes) -> bytes:
        """Return what is to be shown after `data` came."""
        *lines, self._tail = (self._tail + data).split(b"\n")
        shown = b"".join(self._line(line) for line in lines)
        if not self._ended and (self._bar or BAR.match(self._tail)):
            shown += self._separator() + self._tail
            self._bar = self._bar or bool(self._tail)
            self._tail = b""
        return shown

    def close(self) -> bytes:
        """Return what is left when the stream has ended."""
        return self._line(self._tail) if self._tail else b""

    def _line(self, line: bytes) -> bytes:
        if self._bar:  # its beginning has been shown
            self._bar = False
            return line + b"\n"
        self._ended = self._ended or END.search(line) is not None
        if self._ended:
            return CURSOR if CURSOR in line else b""
        if not line.strip():
            # one blank line between what is shown, none around what is dropped
            self._blank = not self._noise
            return b""
        if NOISE.search(line):
            self._noise, self._blank = True, False
            return CURSOR if CURSOR in line else b""
        return self._separator() + line + b"\n"

    def _separator(self) -> bytes:
        blank, self._blank, self._noise = self._blank, False, False
        return b"\n" if blank else b""


def newest_link(results: Path, file: str) -> str | None:
    """Return the name of the newest run if it left a file, None when there is none."""
    latest = results / "latest"
    return os.readlink(latest) if latest.is_symlink() and (latest / file).is_file() else None


def launch(name: str, arguments: list[str], variables: dict[str, str]) -> None:
    """Run the launch file of a name and show its output."""
    port = os.environ.get("ROS_MASTER_PORT", "11311")
    variables |= {"ROS_MASTER_URI": f"http://localhost:{port}"}
    if sys.stdout.isatty():
        variables |= {"TTY_COMPATIBLE": "1"}
    words = ["-p", port, "--no-summary", "--disable-title", "construction_twin", f"{name}.launch", *arguments]
    run = subprocess.Popen(
        ["roslaunch", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=os.environ | variables
    )
    # Ctrl-C reaches roslaunch as well, which ends its nodes; what they say while ending is still shown.
    signal.signal(signal.SIGINT, lambda *_: None)
    signal.signal(signal.SIGTERM, lambda *_: run.terminate())
    output = Filter()
    while data := os.read(run.stdout.fileno(), 65536):
        _show(output.feed(data))
    _show(output.close())
    run.wait()


def gzserver() -> str:
    """Return the words that start Gazebo's server, in a Debian 11 chroot where it is not installed."""
    if shutil.which("gzserver") is not None:
        return "gzserver"
    chroot = ROOT / "scripts" / "gazebo_chroot.sh"
    subprocess.run([chroot, "make"], check=True)
    return f"{chroot} run gzserver"


def main(target: str, arguments: list[str]) -> int:
    """Run `demo` or `build`; return the exit code: 0 when it left its file, else 1 after a sentence."""
    if target == "demo" and arguments[:1] == ["screenshots"]:
        subprocess.run(["bash", ROOT / "setup/setup.sh", "tests"], check=True)
        browser = ROOT / ".ws/browser/bin/python"
        return subprocess.run([browser, ROOT / "tools/screenshots.py", *arguments[1:]]).returncode
    if target == "demo" and arguments[:1] == ["gazebo"]:
        os.environ["GZSERVER"] = gzserver()
        arguments = ["twin:=gazebo", "servo:=realistic", *arguments[1:]]
    given = dict(argument.split(":=", 1) for argument in arguments if ":=" in argument)
    results = Path(given.get("results_dir", ROOT / "results")).expanduser()
    name, file = {"demo": ("experiment", "summary.json"), "build": ("build", "work.json")}[target]
    before = newest_link(results, file)
    logs = Path(os.environ.get("ROS_LOG_DIR", Path.home() / ".ros/log"))
    with tempfile.TemporaryDirectory(prefix="construction_twin_build_") as home:
        variables = {"ROS_HOME": home, "ROS_LOG_DIR": str(logs)} if target == "build" else {}
        launch(name, [f"results_dir:={results}", *arguments], variables)
    if newest_link(results, file) in (None, before):
        sentence = "it did not finish; the sentences above say why. Logs of every node"
        print(f"{target}: {sentence}: {logs / 'latest'}", file=sys.stderr)
        return 1
    return 0


def _show(text: bytes) -> None:
    sys.stdout.buffer.write(text)
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
