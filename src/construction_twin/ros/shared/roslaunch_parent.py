"""The roslaunch that started this process: how it was called, and a message printed after its last line. Linux only.

roslaunch ends a refused start with lines of its own, and a required node that ended with the lines of everything it stops. What a
person has to read would stand above all that, so it is said again below it: a child process waits until roslaunch has ended.
"""

from __future__ import annotations

import os
import select
import signal
from pathlib import Path

from construction_twin.views.roslaunch_call import RoslaunchCall, roslaunch_call

#: How many processes above this one are looked at: rosrun, a launch-prefix.
_GENERATIONS = 4
#: How long the end of roslaunch is waited for [s]: it gives each node 15 s to stop, and then 2 s more.
PATIENCE = 60.0
#: The first file descriptor after standard input, output and error.
_KEPT = 3


def command_lines() -> list[tuple[int, list[str]]]:
    """Return number and command line of the processes above this one, the nearest first."""
    found: list[tuple[int, list[str]]] = []
    pid = os.getppid()
    while pid > 1 and len(found) < _GENERATIONS:
        try:
            words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")[:-1]
            # the name, in brackets, may hold anything; state and parent follow
            parent = int(Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[1])
        except (OSError, ValueError, IndexError):
            break
        found.append((pid, words))
        pid = parent
    return found


def roslaunch_parent() -> tuple[int, RoslaunchCall] | None:
    """Return number and call of the roslaunch that started this process; None when none did."""
    for pid, words in command_lines():
        call = roslaunch_call(words)
        if call is not None:
            return pid, call
    return None


def print_after(sentence: str, pid: int | None, patience: float = PATIENCE) -> None:
    """Have a sentence printed on standard error when another process has ended.

    Args:
        pid: The process below whose last line the sentence is to stand; None: there is no such process.
        patience: Nothing is printed when the process has not ended by then [s].
    """
    if pid is None:
        return
    try:
        process = os.pidfd_open(pid)
    except OSError:
        return  # it has ended already: nothing of it can follow
    if os.fork():
        os.close(process)
        return
    # the child; roslaunch reads standard output to its end, and ends what it started by signals
    try:
        os.setsid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        nothing = os.open(os.devnull, os.O_RDWR)
        os.dup2(nothing, 0)
        os.dup2(nothing, 1)
        # of everything else, such as a node's sockets that peers would connect to, only the process is kept
        os.dup2(process, _KEPT)
        os.closerange(_KEPT + 1, os.sysconf("SC_OPEN_MAX"))
        if select.select([_KEPT], [], [], patience)[0]:
            os.write(2, f"{sentence}\n".encode())
    finally:
        os._exit(0)
