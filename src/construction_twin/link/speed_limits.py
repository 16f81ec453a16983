"""The speed limit in force: the lowest of what a program and people have set. Pure: times are arguments. Not safety rated.

A program is one source of `speed_limit`, with the deadline that it had when executor and bridge heard it themselves: its silence
never speeds up. People have one limit in common, whoever of them set it: it stands until a person sets another one, whatever
becomes of tablet, broker and node. Lowering it acts at once. Raising it is void when what the screen had shown is too old, or of
before somebody lowered it: nobody raises a limit unseen.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from construction_twin.core.errors import ConfigurationError, ExpiredError, PayloadError
from construction_twin.core.freshness import Moment, is_newer, parse_moment, staleness
from construction_twin.core.reports import SpeedReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.speed_limit import LimitState, SpeedLimit
from construction_twin.core.units import NANOSECONDS
from construction_twin.mqtt.json_fields import MAX_TEXT, keys, number, own_id

#: From the moment when a stop is known to the moment of the first `view` that surely shows it [ns]: the bridge's poll and `link`.
SHOWN_AFTER = NANOSECONDS // 4


class SeenStops:
    """When the last stop became known; it has to be noted at least as often as it is asked for."""

    def __init__(self) -> None:
        self._stop: object = None
        self._shown_from: Moment | None = None

    def note(self, stop: object, now: Moment) -> None:
        """Take which stop is the last one that is known, by anything that another one differs in."""
        if stop != self._stop:
            self._stop, self._shown_from = stop, replace(now, at=now.at + SHOWN_AFTER)

    def was_seen(self, seen: Moment) -> bool:
        """Return whether a view of this moment has shown the last stop."""
        return is_newer(seen, self._shown_from)


#: An unchanged limit is repeated no faster than this [ns].
PERIOD = NANOSECONDS // 5


class SpeedForwarder:
    """Forwards what the source of `speed_limit` says, and nothing that it does not say.

    A message is forwarded at most once, except to a session that began after it: the receiver's deadline then runs from
    where the source's own silence began.

    Args:
        deadline: A source that was heard this recently is the only one [s]. A message older than this is not sent any more: its
            source has fallen silent.
    """

    def __init__(self, deadline: float):
        self._source = SpeedLimit(deadline)
        #: The last limit heard; None before the first one.
        self.limit: float | None = None
        #: How many were sent: the last message's id, because the gateway takes none that is not newer than all before.
        self.number = 0
        self._unsent = False
        # what was sent last, and to which session
        self._sent_limit = 1.0
        self._sent_session = ""
        self._sent_at = 0

    def on_limit(self, limit: float, source: str, now: int) -> None:
        """Take a message [fraction, 0 to 1] that `source` sent and that came at `now` [ns].

        Raises:
            PayloadError: ``speed_limit``, or ``speed_limit_source`` while another source is heard: the executor refuses it too.
        """
        self._source.accept(limit, source, now)
        self.limit, self._unsent = limit, True

    def poll(self, session: str, now: int) -> float | None:
        """Return the limit to send now to the armed session `session` ("" for none), or None."""
        if not session or self.limit is None:
            return None
        if self._source.is_silent(now):
            # nothing is sent for a silent source, also to a session that begins meanwhile
            self._unsent = False
            return None
        is_new = self._sent_session != session
        self._unsent |= is_new
        due = is_new or self.limit != self._sent_limit or now - self._sent_at >= PERIOD
        if not (self._unsent and due):
            return None
        self._unsent, self._sent_limit, self._sent_session, self._sent_at = False, self.limit, session, now
        self.number += 1
        return self.limit


#: The least that people may set, a fraction of the planned speed: 0 would be a pause, which has a name and an end of its own.
LEAST = 0.05
#: Whose limit is in force; "": nobody limits.
PEOPLE, PROGRAM, NOBODY = "people", "program", ""


@dataclass(frozen=True)
class PeopleLimit:
    """The limit of all people.

    Attributes:
        limit: Fraction of the planned speed, `LEAST` to 1.
        person: Who set it; "": nobody has yet, or it is not known.
        since: ROS time at which it was set [ns].
        replaced, replaced_person: What it was before, and whose that was.
        problem: Why it is not what people had set, as a clause; "": it is.
    """

    limit: float = 1.0
    person: str = ""
    since: int = 0
    replaced: float = 1.0
    replaced_person: str = ""
    problem: str = ""

    def to_text(self) -> str:
        """Return what `kept` reads."""
        return json.dumps({key: value for key, value in asdict(self).items() if key != "problem"}) + "\n"

    @property
    def reason(self) -> str:
        """Who limits, as one sentence."""
        if self.problem:
            return Sentence("link.speed.unreadable", percent=100 * self.limit, problem=self.problem)
        return Sentence("link.speed.people", percent=100 * self.limit, person=self.person)


def kept(path: str, text: str) -> PeopleLimit:
    """Return what people had set, from the text of a file.

    Raises:
        ConfigurationError: It is none of ours.
    """
    try:
        found: Any = json.loads(text)
        made = PeopleLimit(**found)
        numbers = (made.limit, made.replaced)
        wrong = made.problem or any(type(each) not in (int, float) or not LEAST <= each <= 1.0 for each in numbers)
        names = (made.person, made.replaced_person)
        if wrong or type(made.since) is not int or not all(isinstance(each, str) for each in names):
            raise ValueError(found)
    except (ValueError, TypeError) as error:
        raise ConfigurationError(path, str(error)[:200], Sentence("expected.speed_file", least=LEAST)) from error
    return made


def unreadable(problem: str) -> PeopleLimit:
    """Return what counts in place of a limit that was kept and cannot be read: the least, because a restart raises nothing."""
    return PeopleLimit(LEAST, problem=problem)


def program_text(program: SpeedLimit) -> str:
    """Return what a node that is started again must know of the program that was heard; "" without one.

    It changes seldom, however often the limit does: of a program that is silent only that counts which is below the fraction for
    silence.
    """
    if not program.name:
        return ""
    return f"{int(100 * program.fraction_when_silent) / 100:g} {program.name}"


def remembered(program: SpeedLimit, text: str, now: int) -> None:
    """Let a program count as silent that a node before this one had heard; `text` is of `program_text`, `now` in ns."""
    fraction, _, name = text.partition(" ")
    if name:
        # longer ago than its deadline
        program.hear(float(fraction), name, now - round(2e9 * program.deadline) - 1)
        program.update(now)


class SpeedLimits:
    """Merges one program's limit and that of people; the lowest is in force. Not for use from several threads.

    Args:
        program: What a program says; `remembered` may have told it who was heard before.
        people: What people had set.
        started: Of this process: what a screen had shown before raises nothing.
    """

    def __init__(self, program: SpeedLimit, people: PeopleLimit, started: Moment):
        self._program = program
        self._people = people
        self._lowered = started

    @property
    def people(self) -> PeopleLimit:
        """The limit of people."""
        return self._people

    @property
    def program(self) -> SpeedLimit:
        """What a program says, as of the last `report`."""
        return self._program

    def set(self, limit: float, person: str, moment: str, now: Moment, at: int) -> str:
        """Take the limit that a person sets; return the sentence of the answer.

        Args:
            limit: Fraction of the planned speed.
            moment: The newest that the person's screen had received; needed only to raise the limit.
            at: ROS time [ns].

        Raises:
            PayloadError: ``values``, ``person``, or ``moment``: none to raise it.
            ExpiredError: What the screen had shown is too old to raise it, or was lowered since.
        """
        before, self._people = self._people, self.asked(limit, person, moment, now, at)
        if self._people == before:
            return Sentence("link.speed.same", percent=100 * limit)
        if limit <= before.limit:
            self._lowered = replace(now, at=now.at + SHOWN_AFTER)
        whose = before.person or Sentence("link.speed.nobody")
        key = "link.speed.raised" if limit > before.limit else "link.speed.lowered"
        return Sentence(key, percent=100 * limit, before=100 * before.limit, whose=whose)

    def asked(self, limit: float, person: str, moment: str, now: Moment, at: int) -> PeopleLimit:
        """Return what `set` would make the limit of people; arguments and errors are its own."""
        # written so that a nan does not pass
        if not LEAST <= limit <= 1.0:
            raise PayloadError("values", Sentence("link.payload.speed_limit", found=limit, least=LEAST))
        if not person.strip():
            raise PayloadError("person", Sentence("link.speed.nameless"))
        before = self._people
        if limit == before.limit and not before.problem:
            return before
        if limit > before.limit:
            self._check_raise(parse_moment(moment), now)
        return PeopleLimit(limit, person, at, before.limit, before.person)

    def _check_raise(self, seen: Moment, now: Moment) -> None:
        if problem := staleness(seen, now):
            raise ExpiredError(Sentence("executor.void.speed", problem=problem))
        if not is_newer(seen, self._lowered):
            raise ExpiredError(Sentence("executor.void.speed_since"))

    def report(self, now: int) -> SpeedReport | None:
        """Return what is in force at `now` [ns, monotonic]; None before anybody has set a limit: nothing is to be repeated then."""
        program, people = self._program, self._people
        allowed = program.update(now)
        if not program.name and people == PeopleLimit():
            return None
        # nobody was heard, and one is required: what the executor does of itself then holds beside a person's limit, too
        asks = program.state is not LimitState.UNLIMITED
        limit = min(allowed, people.limit)
        by = NOBODY if limit == 1.0 else PEOPLE if people.limit <= allowed else PROGRAM
        reason = people.reason if by == PEOPLE else program.reason if asks else Sentence("link.speed.free")
        return SpeedReport(
            limit=limit,
            by=by,
            reason=reason,
            people=people.limit,
            person=people.person,
            since=people.since,
            replaced=people.replaced,
            replaced_person=people.replaced_person,
            program=allowed,
            program_name=program.name,
        )


#: Longest message [bytes].
MAX_REQUEST_BYTES = 256


@dataclass(frozen=True)
class SpeedRequest:
    """A person's speed limit.

    Attributes:
        limit: Fraction of the planned speed, `LEAST` to 1.
        moment: The newest that the screen had received; "" where none was told, or none that can be one.
    """

    id: str
    limit: float
    moment: str


def parse_speed(document: Mapping[str, Any]) -> SpeedRequest:
    """Return the limit in a document of `read_document`; PayloadError (``format`` or ``values``).

    A moment that makes no sense refuses nothing here: a lower limit must not be lost by it.
    """
    keys(document, "speed", ("id", "limit"), ("id", "limit", "moment"))
    id_, limit, moment = own_id(document["id"], "id"), number(document["limit"], "limit"), document.get("moment")
    if not LEAST <= limit <= 1.0:
        raise PayloadError("values", Sentence("link.payload.speed_limit", found=limit, least=LEAST))
    return SpeedRequest(id_, limit, moment if isinstance(moment, str) and len(moment) <= MAX_TEXT else "")
