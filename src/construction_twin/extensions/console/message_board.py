"""The messages for people, in a file: holds of the arm, people's acts, acknowledgements.

Times are in s since 1970, UTC.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file, write_atomically
from construction_twin.core.records import to_json
from construction_twin.core.reports import SpeedChange
from construction_twin.core.sentences import Sentence, templates_of
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.status_line import Level, Line

#: Messages that are kept, the newest; and the largest file that is read [bytes].
MAX_MESSAGES, MAX_BYTES = 100, 4 << 20
#: A line must stand for so long to be a message [s]: a start passes through many.
MIN_DURATION = 1.0
#: Topic of what people did.
PERSON = "person"
#: For these a person is waited for as a matter of course: they are no messages.
ORDINARY = (
    ("execution", "REVIEW"), ("execution", "PAUSED"),
    ("work", "planned"), ("work", "ready"), ("work", "proposed"),
)  # fmt: skip
#: States of lines about what people did, beside the verb of a `SessionRequest`.
APPROVED, REJECTED, RAISED, LOWERED = "approved", "rejected", "raised", "lowered"
#: Who drags the limit down lowers it several times a second: what follows the last step within this time is the same message [s].
DRAGGED = 10.0


@dataclass(frozen=True, kw_only=True)
class Message:
    """One message of <prefix>/<robot>/messages.

    Attributes:
        id: Unique at this robot.
        at: When it began [s since 1970].
        until: When it ended [s since 1970]; null while it lasts. An act of a person ends at once.
        acknowledged_by, acknowledged_at: Account and time; "" and null: nobody yet.
    """

    id: str
    at: float
    line: Line
    until: float | None = None
    acknowledged_by: str = ""
    acknowledged_at: float | None = None


_Messages = pydantic.TypeAdapter(tuple[Message, ...])


class MessageBoard:
    """The newest messages, oldest first, for several threads; `file` None: only in memory.

    `publish` takes them as JSON after each change, `refuse` kind and cause of a file that fails; `clock` is the time of day [s].
    """

    def __init__(
        self,
        publish: Callable[[bytes], object],
        refuse: Callable[[str, str], object],
        file: Path | None,
        clock: Callable[[], float],
    ):
        self._publish, self._refuse, self._file, self._clock = publish, refuse, file, clock
        # held while it publishes: what is retained must be the newest
        self._lock = threading.Lock()
        #: A limit that is dragged down: id of its message, and all its steps as one change.
        self._lowered: tuple[str, SpeedChange | None] = ("", None)
        #: What stands, by what tells it from another: since when, and the id of its message once it is one.
        self._standing: dict[tuple[str, ...], tuple[float, str]] = {}
        #: Another tuple after each change.
        self.messages = self._written = self._saved_messages()
        self._published: tuple[Message, ...] | None = None

    def _saved_messages(self) -> tuple[Message, ...]:
        """Return the messages of the file; those that lasted end with the newest."""
        try:
            found = _Messages.validate_json(read_file(self._file, MAX_BYTES)) if self._file is not None else ()
        except FileNotFoundError:
            return ()
        except (OSError, ConfigurationError, pydantic.ValidationError) as error:
            why = "it is not as console_node wrote it" if isinstance(error, pydantic.ValidationError) else error
            self._refuse("messages", f"{self._file}: {why}; the messages begin anew")
            return ()
        last = max((message.at for message in found), default=0.0)
        return tuple(message if message.until is not None else replace(message, until=last) for message in found)

    @contextmanager
    def _changing(self) -> Iterator[None]:
        with self._lock:
            yield
            if self._published is not self.messages:
                self._published = self.messages
                self._publish(to_json(self.messages))

    def on_lines(self, lines: Sequence[Line]) -> None:
        """Begin and end messages by the present status line."""
        now, urgent = self._clock(), {_identity(line): line for line in lines if _is_message(line)}
        with self._changing():
            for gone in self._standing.keys() - urgent.keys():
                self._replace(self._standing.pop(gone)[1], until=now)
            for key, line in urgent.items():
                since, id_ = self._standing.setdefault(key, (now, ""))
                if not id_ and now - since >= MIN_DURATION:
                    self._standing[key] = since, self._add(line, since)

    def on_act(self, act: str, at: float, sentence: str) -> None:
        """Add a person's act, once."""
        with self._changing():
            self._add_act(act, at, sentence)

    def _add_act(self, act: str, at: float, sentence: str) -> None:
        known = ((message.at, message.line.topic, message.line.state) for message in self.messages)
        if (at, PERSON, act) not in known:
            self._add(_act(act, sentence), at, until=at)

    def on_speed(self, change: SpeedChange) -> None:
        """Add a change of people's speed limit; one drag downwards is one message."""
        at, act = change.stamp / NANOSECONDS, RAISED if change.limit > change.before else LOWERED
        with self._changing():
            id_, last = self._lowered
            if act == LOWERED and last and id_ == self.messages[-1].id and _is_same_drag(last, change):
                change = replace(change, before=last.before)
                self._replace(id_, at=at, until=at, line=_act(act, _speed_words(change)))
            else:
                self._add_act(act, at, _speed_words(change))
            self._lowered = (self.messages[-1].id, change) if act == LOWERED else ("", None)

    def acknowledge(self, id_: str, account: str) -> tuple[bool, Sentence]:
        """Acknowledge a message; return success and a sentence."""
        with self._changing():
            found = next((message for message in self.messages if message.id == id_), None)
            if found is None:
                return False, Sentence("there is no message {id}: it is older than those that are kept", id=repr(id_))
            if found.acknowledged_by:
                return False, Sentence("{account} has acknowledged it already", account=found.acknowledged_by)
            self._replace(id_, acknowledged_by=account, acknowledged_at=self._clock())
            return True, Sentence("acknowledged by {account}", account=account)

    def write(self) -> None:
        """Save changes; for a thread that may wait for a disk."""
        with self._lock:
            if self._file is None or self._written is self.messages:
                return
            self._written = self.messages
        try:
            write_atomically(self._file, to_json(self._written))
        except OSError as error:
            self._refuse("messages", f"{self._file} was not written: {error.strerror or error}")

    def _add(self, line: Line, at: float, until: float | None = None) -> str:
        message = Message(id=uuid.uuid4().hex, at=at, line=line, until=until)
        self.messages = (*self.messages, message)[-MAX_MESSAGES:]
        return message.id

    def _replace(self, id_: str, **changes: Any) -> None:
        if id_:
            self.messages = tuple(
                replace(message, **changes) if message.id == id_ else message for message in self.messages
            )


def _act(act: str, sentence: str) -> Line:
    return Line(topic=PERSON, state=act, sentence=sentence, said=templates_of(sentence))


def _is_same_drag(last: SpeedChange, change: SpeedChange) -> bool:
    return last.person == change.person and last.stamp <= change.stamp < last.stamp + DRAGGED * NANOSECONDS


def _speed_words(change: SpeedChange) -> Sentence:
    values = {"person": change.person, "before": f"{100 * change.before:.4g}", "percent": f"{100 * change.limit:.4g}"}
    if change.limit > change.before:
        return Sentence("{person} raised the speed limit of people from {before}% to {percent}%", **values)
    return Sentence("{person} lowered the speed limit of people from {before}% to {percent}%", **values)


def _is_message(line: Line) -> bool:
    return line.level == Level.PERSON and (line.topic, line.state) not in ORDINARY and line.topic != "startup"


def _identity(line: Line) -> tuple[str, ...]:
    # another cause is another message; figures in the reasons of the others waver
    return (line.topic, line.state, line.sentence if line.topic == "cause" else "")
