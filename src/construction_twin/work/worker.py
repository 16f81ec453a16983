"""The process that reads models and plans tasks for the work node, so that neither a broken file nor a long search holds it up.

``python -m construction_twin.work.worker``, started by `Worker`; both sides speak pickles over the process's own pipes, which
nobody else can write to. It runs behind everything else on the machine: whatever has a cycle to keep comes first.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.work_errors import WorkError

#: Added to the process's nice value.
NICE = 10
_LENGTH = 8


class WorkerError(WorkError):
    """What was asked of the process failed; the sentence is that of the error there.

    Attributes
    ----------
    kind : str
        Name of the error's class; empty: the process ended.
    """

    def __init__(self, kind: str, sentence: str):
        self.kind = kind
        super().__init__(sentence)


@dataclass(frozen=True)
class _Failure:
    kind: str
    sentence: str


class Worker:
    """The process, as its parent sees it. One question at a time; started at the first one, and again after it has ended.

    Parameters
    ----------
    program : tuple of str, optional
        By default this module.
    """

    def __init__(self, program: tuple[str, ...] = (sys.executable, "-m", "construction_twin.work.worker")):
        self._program = program
        self._busy = threading.Lock()
        self._process: subprocess.Popen | None = None
        self._first: tuple[str, dict[str, Any]] | None = None

    def ask_first(self, name: str, **arguments: Any) -> Any:
        """As `ask`; if the process has to be started anew, it is asked this again before anything else."""
        self._first = None
        answer = self.ask(name, **arguments)
        self._first = name, arguments
        return answer

    def ask(self, name: str, **arguments: Any) -> Any:
        """Have a function of `FUNCTIONS` called there; return its result.

        Raises
        ------
        WorkerError
        """
        with self._busy:
            try:
                answer = self._answer(name, arguments)
            except (OSError, EOFError, pickle.UnpicklingError) as error:
                code = self._end()
                raise WorkerError(
                    "", f"the process that reads and plans has ended ({_how(code)}); ask again"
                ) from error
        if isinstance(answer, _Failure):
            raise WorkerError(answer.kind, answer.sentence)
        return answer

    def close(self) -> None:
        """End the process, whatever it does."""
        self._end()

    def _answer(self, name: str, arguments: dict[str, Any]) -> Any:
        questions = [(name, arguments)]
        if self._process is None or self._process.poll() is not None:
            self._end()
            self._process = subprocess.Popen(self._program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            questions = [*([self._first] if self._first is not None else []), *questions]
        answer = None
        for question in questions:
            _write(self._process.stdin, question)
            answer = _read(self._process.stdout)
            if isinstance(answer, _Failure):
                break
        return answer

    def _end(self) -> int:
        process, self._process = self._process, None
        if process is None:
            return 0
        process.kill()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                try:
                    pipe.close()
                except BrokenPipeError:
                    continue  # what was not sent is not needed any more
        return process.wait()


def serve(questions: BinaryIO, answers: BinaryIO, functions: Mapping[str, Callable]) -> None:
    """Answer until there are no more questions.

    Parameters
    ----------
    questions, answers : binary file
    functions : mapping of str to callable
        Called with the question's arguments.
    """
    while True:
        try:
            name, arguments = _read(questions)
        except EOFError:
            return
        _write(answers, _answer(functions[name], arguments))


def _answer(function: Callable, arguments: dict) -> Any:
    try:
        return function(**arguments)
    except ConstructionTwinError as error:
        return _Failure(type(error).__name__, str(error))
    except (
        ArithmeticError,
        LookupError,
        MemoryError,
        OSError,
        TypeError,
        ValueError,
        AttributeError,
        RuntimeError,
    ) as error:
        # what nobody foresaw must be an answer, too; the trace goes to the node's log
        traceback.print_exc()
        kind = type(error).__name__
        return _Failure(kind, f"it cannot be computed ({kind}: {error}); please report it")


def _write(pipe: Any, content: object) -> None:
    data = pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)
    pipe.write(len(data).to_bytes(_LENGTH, "big") + data)
    pipe.flush()


def _read(pipe: Any) -> Any:
    header = pipe.read(_LENGTH)
    if len(header) < _LENGTH:
        raise EOFError
    length = int.from_bytes(header, "big")
    data = pipe.read(length)
    if len(data) < length:
        raise EOFError
    return pickle.loads(data)


def _how(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def main() -> None:
    """Serve the parent until it closes its pipe."""
    from construction_twin.work.tasks import FUNCTIONS

    # whatever a library prints must not get between the answers
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    os.nice(NICE)
    serve(sys.stdin.buffer, answers, FUNCTIONS)


if __name__ == "__main__":
    main()
