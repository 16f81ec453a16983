"""The child process of the work node: errors are answers, an end is a sentence, and what it was told first is told again."""

from __future__ import annotations

import io
import sys
import textwrap

import pytest

from construction_twin.core.errors import ConfigurationError
from construction_twin.work.worker import Worker, WorkerError, serve

PROGRAM = """
    import os, sys
    from construction_twin.work.worker import serve
    from construction_twin.core.errors import ConfigurationError

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

    def end():
        sys.exit(3)

    serve(sys.stdin.buffer, sys.stdout.buffer, dict(first=first, known=known, wrong=wrong, unforeseen=unforeseen, end=end))
"""


@pytest.fixture
def worker():
    one = Worker((sys.executable, "-c", textwrap.dedent(PROGRAM)))
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


def test_half_a_question_is_the_end_of_questions():
    answers = io.BytesIO()
    serve(io.BytesIO(b"\x00\x00"), answers, {})
    assert answers.getvalue() == b""


def test_errors_carry_their_sentence():
    assert "expected 4" in str(ConfigurationError("file", 3, "4"))
