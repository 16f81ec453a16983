"""Who starts a robot: so that of two starts in one second only one goes on, before any node of it can be found on the master.

A start claims its robot twice: in a file of this machine, which needs no master yet, and on the parameter server, which other
machines see. A claim is as good as the process that made it: it ends with it, and nothing has to be taken back. Linux only.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from construction_twin.core.sentences import Sentence
from construction_twin.ros.shared.master import FAILURES, TIMEOUT, ask

#: Where the parameters of the claims are, one for each start.
PARAMETERS = "/construction_twin/starts"
#: Another machine's processes cannot be looked at: its claim counts for so long, by then its nodes are found on the master [s].
REMOTE = 30.0


@dataclass(frozen=True)
class Claim:
    """A roslaunch that starts a robot.

    Attributes:
        pid, began: Its number, and when it began in the kernel's clock ticks: numbers are used again.
        at: When it claimed the robot, on the wall clock [s].
    """

    host: str
    pid: int
    began: int
    at: float

    @classmethod
    def of(cls, pid: int, at: float) -> Claim:
        """Return the claim of a process of this machine."""
        return cls(socket.gethostname(), pid, _began(pid), at)

    def same_process(self, other: Claim) -> bool:
        """Return whether two claims are of one process."""
        return (self.host, self.pid, self.began) == (other.host, other.pid, other.began)

    def stands(self, now: float) -> bool:
        """Return whether the process that made it still runs, as far as this machine can tell."""
        if self.host != socket.gethostname():
            return abs(now - self.at) < REMOTE
        return self.began > 0 and _began(self.pid) == self.began


def claim(robot: str, uri: str, pid: int, folder: Path | None = None, clock: Callable[[], float] = time.time) -> str:
    """Claim a robot on a master for a process; return why another has it, as the rest of a sentence; empty when it is claimed.

    Two that ask at the very same moment may both be refused, never both be let through.

    Args:
        uri: Of the master, which need not run yet.
        pid: Of the roslaunch that starts the robot.
        folder: For this user's claims on this machine.
        clock: Returns the wall clock's time [s].
    """
    own = Claim.of(pid, clock())
    other = _claim_in_file(own, robot, uri, folder or Path(tempfile.gettempdir(), f"construction_twin_{os.getuid()}"))
    other = other or _claim_on_master(own, robot, uri)
    return "" if other is None else Sentence("preflight.begun", pid=other.pid, host=other.host, uri=uri)


def _claim_in_file(own: Claim, robot: str, uri: str, folder: Path) -> Claim | None:
    """Return who has it; None when it is ours now, or no file can be written."""
    name = hashlib.sha256(f"{robot} {uri}".encode()).hexdigest()[:16]
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with (folder / name).open("a+", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            other = _read(file.read())
            if other is not None and other.stands(own.at) and not other.same_process(own):
                return other
            file.truncate(0)
            file.write(json.dumps(asdict(own)))
    except OSError:
        # a machine without room for a file has no other protection than the master's
        return None
    return None


def _claim_on_master(own: Claim, robot: str, uri: str) -> Claim | None:
    """Write ours, then look: whoever looks later sees the one before. None too while no master runs."""
    key = f"{PARAMETERS}/{robot}"
    mine = f"p{own.pid}_{hashlib.sha256(own.host.encode()).hexdigest()[:8]}"
    try:
        ask(uri, TIMEOUT, "setParam", f"{key}/{mine}", json.dumps(asdict(own)))
        code, there = ask(uri, TIMEOUT, "getParam", key)
        found = {name: _read(text) for name, text in there.items()} if code == 1 else {}
        others = [one for one in found.values() if one and one.stands(own.at) and not one.same_process(own)]
        for name, one in found.items():
            if one is None or not one.stands(own.at) or (others and name == mine):
                ask(uri, TIMEOUT, "deleteParam", f"{key}/{name}")
        return others[0] if others else None
    except FAILURES:
        return None


def _read(text: object) -> Claim | None:
    """Return the claim in a text; None when it holds none."""
    try:
        return Claim(**json.loads(str(text)))
    except (ValueError, TypeError):
        return None


def _began(pid: int) -> int:
    """Return when a process of this machine began [clock ticks]; 0 when there is none."""
    try:
        # the name, in brackets, may hold anything
        fields = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
        return 0 if fields[0] == "Z" else int(fields[19])
    except (OSError, ValueError, IndexError):
        return 0
