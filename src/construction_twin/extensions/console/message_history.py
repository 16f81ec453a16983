"""The messages that a person must not miss: what the arm stood still for and what people did, with who took note of it.

Pure: lines of the status line, acts of people and times come in, messages and their file's text go out. Times are in s since 1970,
UTC.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pydantic

from construction_twin.core.errors import ConfigurationError, RequestRefused
from construction_twin.core.records import dumped
from construction_twin.core.reports import SpeedChange
from construction_twin.core.sentences import Sentence, told
from construction_twin.core.units import NANOSECONDS
from construction_twin.views.status_line import Level, Line

#: Messages that are kept, the newest.
MOST = 100
#: A line must stand for so long to be a message [s]: a start passes through many.
STANDS = 1.0
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
        line: What it says, as in the status line.
        until: When it ended [s since 1970]; null while it lasts. An act of a person ends at once.
        acknowledged_by, acknowledged_at: Who has taken note of it, by account, and when; "" and null: nobody yet.
    """

    id: str
    at: float
    line: Line
    until: float | None = None
    acknowledged_by: str = ""
    acknowledged_at: float | None = None


_Messages = pydantic.TypeAdapter(tuple[Message, ...])


class MessageHistory:
    """The newest messages, oldest first; used by one thread at a time. `messages` is another tuple after each change.

    Args:
        new_id: Returns a new unique id.
        text: Of the file, as `text` gave it to the one before this; empty: there is none.

    Raises:
        ConfigurationError: When the text is none of `text`.
    """

    def __init__(self, new_id: Callable[[], str], text: bytes = b""):
        self._new_id = new_id
        #: The newest message of a lowered speed limit: its id, the change, and what the limit was before the first step of it.
        self._lowered: tuple[str, SpeedChange, float] | None = None
        #: What stands, by what tells it from another: since when, and the id of its message once it is one.
        self._standing: dict[tuple[str, ...], tuple[float, str]] = {}
        try:
            self.messages: tuple[Message, ...] = _Messages.validate_json(text) if text else ()
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            found = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
            raise ConfigurationError(
                "messages", found, "the file as console_node wrote it; remove it, and the messages begin anew"
            ) from error
        # what lasted when the program before ended may have ended since: it is a message anew when it stands
        last = max((message.at for message in self.messages), default=0.0)
        self.messages = tuple(
            message if message.until is not None else replace(message, until=last) for message in self.messages
        )

    @property
    def text(self) -> bytes:
        """The messages as JSON: what is published, and written into the file."""
        return dumped(self.messages)

    def on_lines(self, lines: Sequence[Line], now: float) -> None:
        """Take the status line of `now`."""
        urgent = {_identity(line): line for line in lines if _is_message(line)}
        for gone in self._standing.keys() - urgent.keys():
            self._end(self._standing.pop(gone)[1], now)
        for key, line in urgent.items():
            since, id_ = self._standing.setdefault(key, (now, ""))
            if not id_ and now - since >= STANDS:
                self._standing[key] = since, self._add(line, since)

    def on_act(self, act: str, at: float, sentence: str) -> None:
        """Take what a person did. What is told again is not new."""
        if not any(
            (message.at, message.line.topic, message.line.state) == (at, PERSON, act) for message in self.messages
        ):
            self._add(_act(act, sentence), at, until=at)

    def on_speed(self, change: SpeedChange) -> None:
        """Take that a person has set the speed limit of people; what one person drags it down is one message."""
        at, act = change.stamp / NANOSECONDS, RAISED if change.limit > change.before else LOWERED
        newest = self.messages[-1].id if self.messages else ""
        dragged, self._lowered = self._lowered, None
        if act == LOWERED and dragged is not None and dragged[0] == newest and _goes_on(dragged[1], change):
            self._lowered = newest, change, dragged[2]
            self._replace(newest, at=at, until=at, line=_act(act, _speed_words(change, dragged[2])))
            return
        self.on_act(act, at, _speed_words(change, change.before))
        if act == LOWERED:
            self._lowered = self.messages[-1].id, change, change.before

    def acknowledge(self, id_: str, account: str, now: float) -> Sentence:
        """Take that a person has read a message; return a sentence.

        Raises:
            RequestRefused: There is none of this id, or somebody has read it already.
        """
        found = next((message for message in self.messages if message.id == id_), None)
        if found is None:
            raise RequestRefused(
                Sentence("there is no message {id}: it is older than those that are kept", id=repr(id_))
            )
        if found.acknowledged_by:
            raise RequestRefused(Sentence("{account} has acknowledged it already", account=found.acknowledged_by))
        self._replace(id_, acknowledged_by=account, acknowledged_at=now)
        return Sentence("acknowledged by {account}", account=account)

    def _add(self, line: Line, at: float, until: float | None = None) -> str:
        message = Message(id=self._new_id(), at=at, line=line, until=until)
        self.messages = (*self.messages, message)[-MOST:]
        return message.id

    def _end(self, id_: str, now: float) -> None:
        if id_:
            self._replace(id_, until=now)

    def _replace(self, id_: str, **changes: Any) -> None:
        self.messages = tuple(
            replace(message, **changes) if message.id == id_ else message for message in self.messages
        )


def _act(act: str, sentence: str) -> Line:
    return Line(topic=PERSON, state=act, sentence=sentence, said=told(sentence))


def _goes_on(last: SpeedChange, change: SpeedChange) -> bool:
    return last.person == change.person and last.stamp <= change.stamp < last.stamp + DRAGGED * NANOSECONDS


def _speed_words(change: SpeedChange, before: float) -> Sentence:
    values = {"person": change.person, "before": _percent(before), "percent": _percent(change.limit)}
    if change.limit > change.before:
        return Sentence("{person} raised the speed limit of people from {before}% to {percent}%", **values)
    return Sentence("{person} lowered the speed limit of people from {before}% to {percent}%", **values)


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.4g}"


def _is_message(line: Line) -> bool:
    return line.level == Level.PERSON and (line.topic, line.state) not in ORDINARY and line.topic != "startup"


def _identity(line: Line) -> tuple[str, ...]:
    # another cause is another message; figures in the reasons of the others waver
    return (line.topic, line.state, line.sentence if line.topic == "cause" else "")
