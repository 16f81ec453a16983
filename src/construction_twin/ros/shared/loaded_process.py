"""Nodes start as copies of one process that has loaded their modules: what each would load alone takes half a start's time.

`preflight` has every node's module loaded when it has checked a start. It leaves a process behind that keeps them, the loaded
process, for the roslaunch that called it. A program of nodes/ that this roslaunch starts asks for a copy of it (fork), which
becomes the node. The program itself stays: it is what roslaunch knows.

=====================================  ==============================================================================
what happens                           what follows
=====================================  ==============================================================================
signals to the program                 SIGINT, SIGTERM and SIGHUP are passed on to the node
the node ends                          the program ends with its exit code, or by the same signal
the program is killed                  the node kills itself; the loaded process kills it, too
the loaded process is killed           nodes go on; programs that start later load their modules themselves
there is none: `rosrun`, a debugger    the program loads the module and is the node
the program has other circumstances    likewise: see below
roslaunch has ended, and every node    the loaded process ends
=====================================  ==============================================================================

It is found by an abstract socket (unix(7)) named by user and roslaunch's number, so nothing of it stays on disk, and it copies
itself for its own user alone. What a node has of the shell comes from its program: words, environment, folder, standard input and
output. What a program has by ``launch-prefix`` (`nice`, `chrt`, `taskset`, `prlimit`, ...) a copy would not have, and variables
that do not begin with ROS it would have too late, as libraries look at them when they are loaded: where these are not the loaded
process's own there is no copy. Only the class of `ionice` is not looked at. Linux only.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import select
import selectors
import signal
import socket
import struct
import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NoReturn, TextIO

import setproctitle

#: Signals that a program passes on to its node.
PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: How long a program may take to say what it wants [s].
PATIENCE = 2.0
#: Where Linux says by what a process is bound, beside its /proc/self/status.
_BOUNDS = ("limits", "cgroup", "oom_score_adj", "timerslack_ns", "personality")
#: The lines of that which say so, too.
_STATUS = (
    "Umask", "Uid", "Gid", "Groups", "SigIgn", "CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb", "NoNewPrivs", "Seccomp",
    "Cpus_allowed", "Mems_allowed",
)  # fmt: skip
#: With what the loaded process has loaded numpy: see nodes/preflight.
_LOADED_WITH = {"OPENBLAS_NUM_THREADS": "1"}
#: Exit code when nobody can say how the node ended.
UNKNOWN = 1
_FORK = get_context("fork")
_NUMBER = struct.Struct("=i")
_PEER = struct.Struct("=iII")


def run_program(module: str) -> NoReturn:
    """Run the function `main` of a module as this program: in a copy of roslaunch's loaded process, else here. Does not return."""
    code = _run_as_copy(module, _name_for(os.getppid()))
    if code is None:
        _run_here(module)
    if code < 0:
        # roslaunch is told by what it has ended
        with contextlib.suppress(OSError):  # SIGKILL has no handler
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    sys.exit(code)


def _run_here(module: str) -> NoReturn:
    sys.exit(import_module(module).main())


def _name_for(pid: int) -> str:
    """Return the name of the socket of a roslaunch's loaded process, in Linux' abstract name space."""
    return f"\0construction_twin/{os.getuid()}/{pid}"


# -- the program


def _run_as_copy(module: str, name: str) -> int | None:
    """Return the exit code of a copy, when it has ended; None when there is none to be had."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        try:
            connection.connect(name)
            if _user_of(connection) != os.getuid():
                return None
            _send_request(connection, module)
            copy = _receive_number(connection)
        except OSError:
            return None
        if copy is None:
            return None
        with _signals_passed_on(copy) as came:
            # a signal that comes just before this process sleeps would be kept until the node ends
            while connection.fileno() not in select.select([connection.fileno(), came], [], [])[0]:
                os.read(came, 1)
            code = _receive_number(connection)
        return UNKNOWN if code is None else code


def _user_of(connection: socket.socket) -> int:
    return _PEER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))[1]


def _send_request(connection: socket.socket, module: str) -> None:
    request = json.dumps(
        {
            "module": module,
            "words": sys.argv,
            "title": " ".join(_own_words()),
            "environment": dict(os.environ),
            "folder": os.getcwd(),
            "circumstances": _circumstances(),
        }
    ).encode()
    socket.send_fds(connection, [_NUMBER.pack(len(request))], [0, 1, 2])
    connection.sendall(request)


def _circumstances() -> dict[str, str]:
    """Return what a copy has from the loaded process, and a program from whoever started it: equal where a copy will do."""
    own = Path("/proc/self")
    found = {}
    for line in (own / "status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name in _STATUS:
            found[name] = value
    for name in _BOUNDS:
        # not every kernel has each, nor may each be read: then neither of the two can
        with contextlib.suppress(OSError):
            found[name] = (own / name).read_text()
    for space in sorted((own / "ns").iterdir()):
        found[space.name] = os.readlink(space)
    found["root"] = os.readlink(own / "root")
    found["schedule"] = f"{os.sched_getscheduler(0)} {os.sched_getparam(0).sched_priority}"
    found["nice"] = str(os.getpriority(os.PRIO_PROCESS, 0))
    return found


def _loaded_with(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that libraries may have looked at when they were loaded: equal where a copy will do."""
    return {name: value for name, value in (_LOADED_WITH | dict(environment)).items() if name[:3] != "ROS"}


def _own_words() -> list[str]:
    """Return this process's command line, with its interpreter."""
    return [word.decode(errors="replace") for word in Path("/proc/self/cmdline").read_bytes().split(b"\0")[:-1]]


def _receive_number(connection: socket.socket) -> int | None:
    """Return the next number; None when the connection has ended."""
    received = connection.recv(_NUMBER.size, socket.MSG_WAITALL)
    return _NUMBER.unpack(received)[0] if len(received) == _NUMBER.size else None


@contextlib.contextmanager
def _signals_passed_on(group: int) -> Iterator[int]:
    """Pass signals on to a process group while the block runs, as roslaunch signals to groups; ignore them afterwards.

    Yields a file that can be read when one has come.
    """

    def pass_on(number: int, _frame: object) -> None:
        with contextlib.suppress(ProcessLookupError):  # it has ended, and its exit code is on its way
            os.killpg(group, number)

    heard, (came, comes) = _heard(), os.pipe()
    os.set_blocking(comes, False)
    signal.set_wakeup_fd(comes)
    for number in heard:
        signal.signal(number, pass_on)
    try:
        yield came
    finally:
        for number in heard:
            signal.signal(number, signal.SIG_IGN)


def _heard() -> list[signal.Signals]:
    """Return the signals to be passed on: not what this process was told to ignore, as SIGHUP by `nohup`."""
    return [number for number in PASSED_ON if signal.getsignal(number) is not signal.SIG_IGN]


# -- the loaded process


def leave_behind(pid: int) -> None:
    """Leave a copy of this process behind, as the loaded process of a roslaunch, unless that has one already; return at once.

    Does nothing in a process of several threads: what others hold locked would stay so in every copy.

    Args:
        pid: Of the roslaunch, this process's parent.
    """
    if len(os.listdir("/proc/self/task")) > 1:
        return
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(_name_for(pid))
        listener.listen()
        roslaunch = os.pidfd_open(pid)
    except OSError:
        # another robot's start in the same roslaunch has left one behind, or roslaunch has ended
        listener.close()
        return
    if os.fork():
        listener.close()
        os.close(roslaunch)
        return
    os.setsid()
    # blocked, not ignored: one that reaches a copy before it is ready waits for it
    signal.pthread_sigmask(signal.SIG_BLOCK, PASSED_ON)
    # roslaunch reads standard output to its end
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    os.close(nothing)
    _Loaded(listener, roslaunch).serve()


class _Loaded:
    """The loaded process: one thread, and nothing that a copy would have to undo but open files."""

    def __init__(self, listener: socket.socket, roslaunch: int):
        self._listener = listener
        self._roslaunch = roslaunch
        self._selector = selectors.DefaultSelector()
        #: Each copy and the connection to its program, by the copy's pidfd.
        self._copies: dict[int, tuple[BaseProcess, socket.socket]] = {}
        #: Those whose program has not ended, either.
        self._watched: set[BaseProcess] = set()

    def serve(self) -> NoReturn:
        """Serve until roslaunch and every copy have ended; in a copy, run the program to its end."""
        setproctitle.setproctitle("construction_twin: loaded process")
        # what is loaded is never looked through for rubbish, so that copies share it
        gc.collect()
        gc.freeze()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._roslaunch, selectors.EVENT_READ, self._end_of_roslaunch)
        while self._roslaunch >= 0 or self._copies:
            for key, _ in self._selector.select():
                key.data(key.fd)
        os._exit(0)

    def _end_of_roslaunch(self, process: int) -> None:
        self._selector.unregister(process)
        os.close(process)
        self._roslaunch = -1

    def _accept(self, _listener: int) -> None:
        connection, _ = self._listener.accept()
        request: _Request | None = None
        files: list[int] = []
        if _user_of(connection) == os.getuid():
            connection.settimeout(PATIENCE)
            # a program that was killed meanwhile wants nothing
            with contextlib.suppress(OSError, ValueError, TypeError):
                request, files = _receive_request(connection)
            connection.settimeout(None)
        if request is None or not request.fits_here() or not self._copy(connection, request, files):
            connection.close()
        for file in files:
            os.close(file)

    def _copy(self, connection: socket.socket, request: _Request, files: list[int]) -> bool:
        """Make a copy; return whether there is one: not where the user may have no more processes, or no memory is left."""
        # it ends a copy without taking apart every module that was ever loaded, which takes longer than a node's start
        process = _FORK.Process(target=self._become, args=(connection, request, files))
        try:
            process.start()
        except OSError:
            return False
        assert process.pid is not None  # it has been started
        _lead_group(process.pid)
        copy = os.pidfd_open(process.pid)
        self._copies[copy] = (process, connection)
        self._selector.register(copy, selectors.EVENT_READ, self._end_of_copy)
        self._watched.add(process)
        self._selector.register(connection, selectors.EVENT_READ, lambda _: self._end_of_program(process, connection))
        with contextlib.suppress(OSError):  # a program that was killed meanwhile: the copy notices, too
            connection.sendall(_NUMBER.pack(process.pid))
        return True

    def _end_of_program(self, process: BaseProcess, connection: socket.socket) -> None:
        if process not in self._watched:
            # it has ended at the same time
            return
        self._watched.remove(process)
        self._selector.unregister(connection)
        assert process.pid is not None  # it has been started
        # not left to the copy alone: a node that hangs in a library, with Python locked, is what programs are killed for
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    def _end_of_copy(self, copy: int) -> None:
        self._selector.unregister(copy)
        process, connection = self._copies.pop(copy)
        if process in self._watched:
            self._watched.remove(process)
            self._selector.unregister(connection)
        process.join()
        with contextlib.suppress(OSError):
            connection.sendall(_NUMBER.pack(process.exitcode))
        connection.close()
        os.close(copy)

    def _become(self, connection: socket.socket, request: _Request, files: list[int]) -> None:
        """Become a program's node, in a copy."""
        self._close()
        _lead_group(os.getpid())
        for number, file in enumerate(files):
            os.dup2(file, number)
            os.close(file)
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
        _buffer_as_asked(sys.stdout, request.environment)
        for number in _heard():
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, PASSED_ON)
        os.chdir(request.folder)
        os.environ.clear()
        os.environ.update(request.environment)
        sys.argv[:] = request.words
        setproctitle.setproctitle(request.title)
        threading.Thread(target=_die_with, args=(connection,), name="program", daemon=True).start()
        _run_here(request.module)

    def _close(self) -> None:
        """Close in a copy what is the loaded process's."""
        self._selector.close()
        self._listener.close()
        if self._roslaunch >= 0:
            os.close(self._roslaunch)
        for copy, (_, connection) in self._copies.items():
            os.close(copy)
            connection.close()


@dataclass(frozen=True)
class _Request:
    """What a program wants to be.

    Attributes:
        module: Whose `main` is run.
        words: `sys.argv`.
        title: Its command line, as `ps` shows it.
        environment, folder: Its own.
        circumstances: See `_circumstances`.
    """

    module: str
    words: list[str]
    title: str
    environment: dict[str, str]
    folder: str
    circumstances: dict[str, str]

    def fits_here(self) -> bool:
        """Return whether a copy of this process is what the program would be."""
        return self.circumstances == _circumstances() and _loaded_with(self.environment) == _loaded_with(os.environ)


def _receive_request(connection: socket.socket) -> tuple[_Request, list[int]]:
    """Return a request and the program's standard input, output and error.

    Raises:
        OSError: The connection has ended, or nothing came in time.
        ValueError, TypeError: It is no request.
    """
    size, files, _, _ = socket.recv_fds(connection, _NUMBER.size, 3)
    with connection.makefile("rb") as stream:
        text = stream.read(_NUMBER.unpack(size)[0] if len(size) == _NUMBER.size else 0)
    return _Request(**json.loads(text)), files


def _lead_group(pid: int) -> None:
    """Make a copy the leader of a group of its own; loaded process and copy both do, as neither knows who comes first."""
    with contextlib.suppress(OSError):  # the other came first, or it has ended
        os.setpgid(pid, pid)


def _buffer_as_asked(stream: TextIO, environment: Mapping[str, str]) -> None:
    """Have a stream written as Python would have it for a program of its own."""
    if isinstance(stream, io.TextIOWrapper):
        unbuffered = bool(environment.get("PYTHONUNBUFFERED"))
        stream.reconfigure(line_buffering=stream.isatty(), write_through=unbuffered)


def _die_with(connection: socket.socket) -> None:
    """End this process, and what it has started, when its program was killed: nothing else ends the connection."""
    with contextlib.suppress(ConnectionError):
        connection.recv(1)
    os.killpg(os.getpgid(0), signal.SIGKILL)
