"""Worker processes of lower priority, for broken files and long searches."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import resource
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

from construction_twin.core.errors import ConstructionTwinError

#: Added to the process's nice value.
NICE = 10
#: Unforeseen errors of a function, its answer, or the reading of it; others end the process.
UNFORESEEN = (
    ArithmeticError, AssertionError, AttributeError, EOFError, ImportError, LookupError, MemoryError, OSError, RuntimeError,
    TypeError, ValueError, pickle.PickleError,
)  # fmt: skip
#: A process whose pipe has closed is given so long to end [s].
_ENDING = 5.0


class WorkerError(ConstructionTwinError):
    """A call in the worker failed: the error's class, "" where the process ended, and its sentence."""

    def __init__(self, kind: str, sentence: str):
        self.kind = kind
        super().__init__(sentence)


class Worker:
    """The process, as its parent sees it. One question at a time; started at the first one, and again after it has ended."""

    def __init__(self, program: tuple[str, ...]):
        self._program = program
        self._busy = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._pipe: Connection | None = None
        self._first: tuple[str, dict[str, Any]] | None = None

    def ask_first(self, name: str, **arguments: Any) -> Any:
        """As `ask`; asked again first after each restart of the process."""
        self._first = None
        answer = self.ask(name, **arguments)
        self._first = name, arguments
        return answer

    def ask(self, name: str, **arguments: Any) -> Any:
        """Call a function in the worker; return its result."""
        with self._busy:
            try:
                answer = self._answer(name, arguments)
            except (OSError, EOFError) as error:
                code = self._end(_ENDING)
                how = f"signal {-code}" if code < 0 else f"exit code {code}"
                raise WorkerError("", f"the process that reads and plans has ended ({how}); ask again") from error
        if "failure" in answer:
            raise WorkerError(*answer["failure"])
        return answer["result"]

    def interrupt(self) -> None:
        """End the process during another thread's question, which gets a WorkerError; `close` it before the next one."""
        process = self._process
        if process is not None:
            process.kill()

    def close(self) -> None:
        """End the process at once."""
        self._end()

    def _answer(self, name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        questions = [(name, arguments)]
        if self._process is None or self._process.poll() is not None:
            self._end()
            self._pipe, theirs = multiprocessing.Pipe()
            with theirs:
                end = theirs.fileno()
                self._process = subprocess.Popen([*self._program, str(end)], stdin=subprocess.DEVNULL, pass_fds=[end])
            questions = [*([self._first] if self._first is not None else []), *questions]
        assert self._pipe is not None
        answer: dict[str, Any] = {}
        for question in questions:
            self._pipe.send(question)
            received = self._pipe.recv_bytes()
            try:
                answer = dict(pickle.loads(received))
            except UNFORESEEN as error:
                # what cannot be read here is a failure as any other, and the process goes on
                answer = {"failure": _unforeseen(error)}
            if "failure" in answer:
                break
        return answer

    def _end(self, patience: float = 0.0) -> int:
        """End the process, after `patience` [s] for an end of its own; return the exit code."""
        process, self._process = self._process, None
        if process is None:
            return 0
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
        if self._pipe is not None:
            self._pipe.close()
        return process.wait()


def serve_parent(functions: Mapping[str, Callable]) -> None:
    """Answer the parent, at the pipe that the program's last argument names, until it closes that or ends."""
    os.nice(NICE)
    with Connection(int(sys.argv[-1])) as pipe:
        while True:
            try:
                pipe.send_bytes(_answered(pipe.recv_bytes(), functions))
            except (EOFError, ConnectionError):
                return  # nobody is there any more to be told


def _answered(question: bytes, functions: Mapping[str, Callable]) -> bytes:
    """Return the answer in built-in types, which a process can read to which this module is not `__main__`."""
    try:
        name, arguments = pickle.loads(question)
        return pickle.dumps({"result": functions[name](**arguments)})
    except ConstructionTwinError as error:
        failure = type(error).__name__, str(error)
    except UNFORESEEN as error:
        # an unforeseen error must be an answer, too; the trace goes to the node's log
        traceback.print_exc()
        failure = _unforeseen(error)
    return pickle.dumps({"failure": failure})


def _unforeseen(error: Exception) -> tuple[str, str]:
    kind = type(error).__name__
    return kind, f"it cannot be computed ({kind}: {error}); please report it"


def rss_mb() -> float:
    """Return the largest resident memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
