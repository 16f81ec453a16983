"""`answer` and `acknowledge` on MQTT: what a person answers to the work's questions, and which message was read. Pure; standard
library only.

An answer changes what the ledger says of the cell: it repeats the newest moment that its screen had received (`core.freshness`),
and the question as it was shown. What is not exactly so is refused (PayloadError).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment, parse_moment
from construction_twin.core.sentences import Sentence
from construction_twin.mqtt.json_fields import Reader, keys, own_id, read_fields, shown

#: Longest message [bytes], and longest question that it repeats.
MAX_BYTES, MAX_QUESTION = 4096, 2000


@dataclass(frozen=True)
class AnswerRequest:
    """A person's answer to a task's question.

    Attributes:
        task: Its id.
        question: As the screen had shown it.
        answer: One of the task's `answers`.
        moment: The newest that the screen had received.
    """

    id: str
    task: str
    question: str
    answer: str
    moment: Moment


@dataclass(frozen=True)
class Acknowledgement:
    """A person has read a message, whose id `message` is."""

    id: str
    message: str


def parse_answer(document: Mapping[str, Any]) -> AnswerRequest:
    """Return the answer in a document of `read_document`; PayloadError (``format`` or ``moment``)."""
    names = ("id", "task", "question", "answer", "moment")
    keys(document, "answer", names, names)
    readers = dict.fromkeys(("id", "task", "answer"), own_id) | {"question": _question}
    return AnswerRequest(**read_fields(document, readers), moment=parse_moment(document["moment"]))


def parse_acknowledgement(document: Mapping[str, Any]) -> Acknowledgement:
    """Return which message was read; PayloadError (``format``)."""
    keys(document, "acknowledge", ("id", "message"), ("id", "message"))
    readers: Mapping[str, Reader] = dict.fromkeys(("id", "message"), own_id)
    return Acknowledgement(**read_fields(document, readers))


def _question(value: object, key: str) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_QUESTION:
        raise PayloadError("format", Sentence("link.payload.text", key=key, found=shown(value), longest=MAX_QUESTION))
    return value
