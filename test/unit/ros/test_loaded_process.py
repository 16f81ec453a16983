"""Nodes as copies of a loaded process, with real processes: a stand-in for roslaunch, and programs that it starts."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from processes import wait_until

#: A module that says who loaded it, and then does what its first word says.
NODE = """
import ctypes, json, os, signal, subprocess, sys

LOADED_BY = os.getpid()

def main():
    what, note = sys.argv[1:3]
    def tell(**more):
        text = json.dumps(dict(more, pid=os.getpid(), loaded_by=LOADED_BY))
        with open(note + ".part", "w") as file:
            file.write(text)
        os.rename(note + ".part", note)
    if what == "tell":
        tell(words=sys.argv[3:], value=os.environ.get("ROS_PROBE"), folder=os.getcwd())
        print("printed", flush=True)
        print(sys.stdin.readline(), end="")
        return 3
    if what == "refuse":
        sys.exit("a sentence")
    if what == "handle":
        def end(number, frame):
            tell(signal=number)
            os._exit(5)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, end)
    if what == "hang":
        tell()
        # Python stays locked
        ctypes.PyDLL(None).sleep(600)
    child = subprocess.Popen(["sleep", "600"]).pid if what == "parent" else 0
    tell(child=child)
    while True:
        signal.pause()
"""

#: Loads the module, and leaves it behind for its parent, as `preflight` does.
PREFLIGHT = """
import os
import probe_node
from construction_twin.ros.shared.loaded_process import leave_behind

leave_behind(os.getppid())
print("left", flush=True)
"""


PROGRAM = """
from construction_twin.ros.shared.loaded_process import run_program

run_program("probe_node")
"""

#: Starts what it is told, as its own children, each in a session of its own, as roslaunch does.
ROSLAUNCH = """
import json, subprocess, sys

started = {}
for line in sys.stdin:
    order = json.loads(line)
    if "wait" in order:
        answer = started[order["wait"]].wait()
    else:
        output = open(order.pop("output"), "wb")
        process = subprocess.Popen(**order, stdout=output, stderr=output, stdin=subprocess.PIPE, start_new_session=True)
        process.stdin.write(b"typed\\n")
        process.stdin.close()
        started[process.pid] = process
        answer = process.pid
    print(json.dumps(answer), flush=True)
"""


class Roslaunch:
    """A stand-in for roslaunch, and what it has started."""

    def __init__(self, folder: Path):
        self.folder = folder
        (folder / "probe_node.py").write_text(NODE)
        for name, text in (("preflight", PREFLIGHT), ("program", PROGRAM), ("roslaunch", ROSLAUNCH)):
            (folder / f"{name}.py").write_text(text)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen([sys.executable, str(folder / "roslaunch.py")], **pipes)

    def order(self, **order: object) -> int:
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def start(self, name: str, *words: str, prefix: Sequence[str] = (), **environment: str) -> int:
        """Start one of the scripts, by a launch-prefix; return its number."""
        output = self.folder / f"{name}.output"
        command = [*prefix, sys.executable, str(self.folder / f"{name}.py"), *words]
        environment = {**os.environ, "PYTHONPATH": f"{self.folder}:{os.environ.get('PYTHONPATH', '')}", **environment}
        return self.order(args=command, env=environment, cwd=str(self.folder), output=str(output))

    def end_of(self, pid: int) -> int:
        """Wait for a program; return its exit code, or minus the signal that ended it."""
        return self.order(wait=pid)

    def load(self) -> int:
        """Have a loaded process left behind; return its number."""
        assert self.end_of(self.start("preflight")) == 0
        # preflight may end before what it has left behind has its title
        wait_until(self.loaded, what="a loaded process")
        (found,) = self.loaded()
        return found

    def loaded(self) -> list[int]:
        """Return the numbers of the loaded processes."""
        return [pid for pid in numbers() if title(pid) == "construction_twin: loaded process" and self.has(pid)]

    def has(self, pid: int) -> bool:
        """Return whether a process was started below this folder."""
        return os.readlink(f"/proc/{pid}/cwd") == str(self.folder)

    def node(self, what: str, prefix: Sequence[str] = (), **environment: str) -> tuple[int, dict]:
        """Start a program whose node does something; return the program's number and what the node told."""
        note = self.folder / f"{what}-{len(list(self.folder.iterdir()))}"
        pid = self.start("program", what, str(note), prefix=prefix, **environment)
        return pid, told(note)


def numbers() -> list[int]:
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]


def title(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().rstrip("\0")
    except OSError:
        return ""


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def told(note: Path) -> dict:
    wait_until(note.exists, what="a node to tell")
    return json.loads(note.read_text())


@contextlib.contextmanager
def ended(stand_in: Roslaunch) -> Iterator[None]:
    """End it and what it has started when the block has ended."""
    try:
        yield
    finally:
        stand_in.process.kill()
        stand_in.process.wait()
        left = [pid for pid in numbers() if runs(pid) and str(stand_in.folder) in title(pid)]
        for pid in left:
            with contextlib.suppress(ProcessLookupError):  # it was about to
                os.kill(pid, signal.SIGKILL)
        wait_until(lambda: not any(runs(pid) for pid in left), what="the end of all")


@pytest.fixture
def roslaunch(tmp_path):
    stand_in = Roslaunch(tmp_path)
    with ended(stand_in):
        yield stand_in


def test_a_copy_has_the_programs_words_environment_folder_and_pipes_and_its_exit_code_is_the_programs(roslaunch):
    loaded = roslaunch.load()
    note = roslaunch.folder / "note"
    program = roslaunch.start("program", "tell", str(note), "__name:=executor", "ein Wort", ROS_PROBE="\udcffvalue")
    assert roslaunch.end_of(program) == 3
    said = told(note)
    assert said["words"] == ["__name:=executor", "ein Wort"] and said["value"] == "\udcffvalue"
    assert said["folder"] == str(roslaunch.folder)
    assert (roslaunch.folder / "program.output").read_text() == "printed\ntyped\n"
    # loaded once, by who left it behind: neither by the program nor by the copy
    assert said["loaded_by"] not in (program, said["pid"], loaded) and said["pid"] != program


def test_without_a_loaded_process_the_program_is_the_node(roslaunch):
    program, said = roslaunch.node("stay")
    assert said["pid"] == said["loaded_by"] == program
    os.kill(program, signal.SIGINT)
    assert roslaunch.end_of(program) == -signal.SIGINT


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_reach_the_node_which_may_end_as_it_likes(roslaunch, number):
    roslaunch.load()
    note = roslaunch.folder / "note"
    program = roslaunch.start("program", "handle", str(note))
    told(note)
    note.unlink()
    os.killpg(program, number)  # as roslaunch does
    assert roslaunch.end_of(program) == 5
    assert told(note)["signal"] == number


def test_a_killed_program_takes_its_node_and_what_that_started_along(roslaunch):
    roslaunch.load()
    program, said = roslaunch.node("parent")
    _, other = roslaunch.node("stay")
    os.killpg(program, signal.SIGKILL)
    assert roslaunch.end_of(program) == -signal.SIGKILL
    wait_until(lambda: not runs(said["pid"]) and not runs(said["child"]), what="the end of the node and its child")
    assert runs(other["pid"])


def test_a_node_outlives_the_loaded_process_and_the_next_loads_its_module_itself(roslaunch):
    loaded = roslaunch.load()
    program, said = roslaunch.node("handle")
    os.kill(loaded, signal.SIGKILL)
    wait_until(lambda: not runs(loaded), what="its end")
    later, own = roslaunch.node("stay")
    assert own["pid"] == own["loaded_by"] == later
    assert runs(said["pid"])
    os.kill(program, signal.SIGTERM)
    wait_until(lambda: not runs(said["pid"]), what="the end of the node")
    # nobody is left who could say how it ended
    assert roslaunch.end_of(program) == 1


def test_it_ends_with_roslaunch_and_the_last_copy(roslaunch):
    loaded = roslaunch.load()
    _, said = roslaunch.node("handle")
    roslaunch.process.kill()
    roslaunch.process.wait()
    os.kill(said["pid"], signal.SIGTERM)
    wait_until(lambda: not runs(loaded), what="the end of the loaded process")


def name_for(pid: int) -> str:
    return f"\0construction_twin/{os.getuid()}/{pid}"


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be somebody else")
def test_another_user_gets_no_copy(roslaunch):
    roslaunch.load()
    name = name_for(roslaunch.process.pid)
    stranger = os.fork()
    if not stranger:
        try:
            os.setuid(65534)
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
                connection.connect(name)
                os._exit(0 if connection.recv(1) == b"" else 1)
        finally:
            os._exit(2)
    assert os.waitpid(stranger, 0)[1] == 0
