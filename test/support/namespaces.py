"""Two network namespaces with a line between them. Needs root; for tests only."""

from __future__ import annotations

import ctypes
import os
import secrets
import subprocess
from contextlib import contextmanager

#: Addresses of the two ends: the ROS PC and the cell PC. Nobody but the two namespaces sees them.
ROS_PC, CELL_PC = "10.197.0.1", "10.197.0.2"
_CLONE_NEWNET = 0x40000000


class Namespaces:
    """Two namespaces, `ros` and `cell`, joined by a veth pair; gone when the ``with`` block ends."""

    def __init__(self):
        name = secrets.token_hex(3)
        self.ros, self.cell = f"ctr{name}", f"ctc{name}"

    def __enter__(self) -> Namespaces:
        for space in (self.ros, self.cell):
            run("ip", "netns", "add", space)
            self.inside(space, "ip", "link", "set", "lo", "up")
        self.inside(self.ros, "ip", "link", "add", "line", "type", "veth", "peer", "name", "line", "netns", self.cell)
        for space, address in ((self.ros, ROS_PC), (self.cell, CELL_PC)):
            self.inside(space, "ip", "address", "add", f"{address}/24", "dev", "line")
            # no address of its own that comes seconds later: a browser gives up what it was loading then
            self.inside(space, "ip", "link", "set", "line", "addrgenmode", "none")
            self.inside(space, "ip", "link", "set", "line", "up")
        return self

    def __exit__(self, *_) -> None:
        for space in (self.ros, self.cell):
            subprocess.run(["ip", "netns", "delete", space], capture_output=True)

    @contextmanager
    def entered(self):
        """Let this thread, and what it starts, live on the ROS PC."""
        setns = ctypes.CDLL(None, use_errno=True).setns
        with open("/proc/thread-self/ns/net") as before, open(f"/run/netns/{self.ros}") as inside:
            if setns(inside.fileno(), _CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")
            try:
                yield
            finally:
                setns(before.fileno(), _CLONE_NEWNET)

    @staticmethod
    def prefix(space: str) -> tuple[str, ...]:
        """Return the words that run a program inside."""
        return ("ip", "netns", "exec", space)

    def inside(self, space: str, *command: str) -> None:
        """Run a program inside; CalledProcessError when it fails."""
        run(*self.prefix(space), *command)


def run(*command: str) -> None:
    """Run a program; CalledProcessError, with what it said, when it fails."""
    subprocess.run(command, check=True, capture_output=True, text=True)


def why_no_namespaces() -> str:
    """Return why namespaces cannot be made here; "" when they can."""
    if os.name != "posix" or os.geteuid() != 0:
        return "network namespaces need root"
    try:
        with Namespaces():
            return ""
    except FileNotFoundError as error:
        return f"{error.filename} is not installed"
    except subprocess.CalledProcessError as error:
        return f"`{' '.join(error.cmd)}`: {(error.stderr or '').strip() or error}"
