"""The child process of the work node: errors are answers, an end is a sentence, and what it was told first is told again."""

from __future__ import annotations

import sys
import textwrap

import pytest

from construction_twin.core.worker import Worker, WorkerError
from construction_twin.extensions.work.loaded_model import WORKER

#: A process with functions of its own.
PROGRAM = """
    import sys, threading, types
    from construction_twin.core.errors import ConfigurationError
    from construction_twin.core.worker import serve_parent

    told = []

    def first(word):
        told.append(word)
        return word

    def known():
        return list(told)

    def wrong():
        raise ConfigurationError("file", 3, "4")

    def unforeseen():
        return 1 / 0

    def untold():
        return threading.Lock()

    def strange():
        return ReadAsAnError()

    class ReadAsAnError:
        def __reduce__(self):
            return getattr, (0, "nothing_of_this_name")

    def end():
        sys.exit(3)

    serve_parent({name: one for name, one in globals().items() if isinstance(one, types.FunctionType)})
"""


@pytest.fixture
def worker():
    one = Worker((sys.executable, "-c", textwrap.dedent(PROGRAM)))
    yield one
    one.close()


@pytest.fixture(scope="module")
def shipped():
    """The worker as the node starts it."""
    one = Worker(WORKER)
    yield one
    one.close()


def test_answers_errors_and_ends(worker):
    assert worker.ask_first("first", word="model") == "model"
    assert worker.ask("known") == ["model"]
    with pytest.raises(WorkerError, match="file: found 3, expected 4") as caught:
        worker.ask("wrong")
    assert caught.value.kind == "ConfigurationError"
    with pytest.raises(WorkerError, match="ZeroDivisionError.*please report it"):
        worker.ask("unforeseen")
    assert worker.ask("known") == ["model"], "an error does not end it"
    with pytest.raises(WorkerError, match="has ended \\(exit code 3\\)"):
        worker.ask("end")
    assert worker.ask("known") == ["model"], "the new process knows what the first was told"
    worker.close()
    assert worker.ask("known") == ["model"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("untold", "lock.*please report it"),
        ("no_such", "KeyError.*please report it"),
        ("strange", "nothing_of_this_name"),
    ],
)
def test_what_cannot_be_asked_told_or_understood_is_a_sentence(worker, name, said):
    with pytest.raises(WorkerError, match=said):
        worker.ask(name)
    assert worker.ask("first", word="again") == "again"


def test_the_worker_that_ships_says_what_it_cannot_plan_and_lives(shipped):
    with pytest.raises(WorkerError, match="T1: the model has not been read in this process yet") as caught:
        shipped.ask("plan", task="T1", element="E1", start=(), scene=None)
    assert caught.value.kind == "TaskPlanningError"
    with pytest.raises(WorkerError, match="TypeError.*please report it"):
        shipped.ask("plan")
