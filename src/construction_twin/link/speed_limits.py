"""The speed limit in force: the lowest of a program's and people's. Times are arguments. Not safety rated.

A program has a deadline: its silence never speeds up. People have one limit in common, which stands until a person sets another,
whatever becomes of tablet, broker and process. Lowering acts at once; nobody raises a limit unseen.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

from construction_twin.core.errors import ExpiredError, PayloadError
from construction_twin.core.files import read_file, write_in_place
from construction_twin.core.freshness import Moment, is_newer, parse_moment, staleness
from construction_twin.core.reports import SpeedChange, SpeedReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.speed_limit import LimitState, SpeedLimit
from construction_twin.link.observations import SHOWN_AFTER
from construction_twin.link.requests import LEAST_SPEED

#: Largest file that is read, and the least that it has [bytes].
MAX_BYTES, MIN_BYTES = 1 << 16, 4096
#: Nobody has set one; and what counts where people's is unknown: a restart raises nothing.
NOBODY, UNKNOWN = SpeedChange("", 1.0, 1.0, ""), SpeedChange("", LEAST_SPEED, 1.0, "")
#: Keys of the file, in the order of the record.
_KEYS = ("person", "limit", "replaced", "replaced_person", "since")


def read_people(path: Path) -> tuple[SpeedChange, str]:
    """Return people's limit, and why it is unknown or cannot be saved, "" where it can.

    The file has its room from the first start on, so that a full disk takes every limit; a mark beside it says that there was one.
    """
    mark = path.with_suffix(".mark")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        is_first = not mark.exists() and not path.exists()
        mark.touch()
        people = NOBODY if is_first else _people(json.loads(read_file(path, MAX_BYTES)))
    except (OSError, ValueError, TypeError, KeyError) as error:
        return UNKNOWN, f"{path}: {error}"[:200]
    problem = write_people(path, people)
    return UNKNOWN if problem else people, problem


def _people(found: Mapping[str, Any]) -> SpeedChange:
    people = SpeedChange(*[found[key] for key in _KEYS])
    in_range = LEAST_SPEED <= people.limit <= 1.0 and LEAST_SPEED <= people.before <= 1.0
    if [type(each) for each in astuple(people)] != [str, float, float, str, int] or not in_range:
        raise ValueError(f"expected fractions from {LEAST_SPEED:g} to 1, names and a time, found {found}")
    return people


def write_people(path: Path, people: SpeedChange) -> str:
    """Write people's limit; return the sentence of a failure, "" for none."""
    try:
        write_in_place(path, json.dumps(dict(zip(_KEYS, astuple(people)))) + "\n", MIN_BYTES)
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink()
        return Sentence(
            "{path} was not written ({problem}); mend it: until then the speed limit of people only falls, to the least "
            "after a restart",
            path=str(path),
            problem=error.strerror or str(error),
        )
    return ""


class SpeedLimits:
    """Merges one program's limit and that of people; `problem`: why the latter is unknown."""

    def __init__(self, program: SpeedLimit, people: SpeedChange, started: Moment, problem: str = ""):
        self.program, self.people, self.fault = program, people, problem
        self._lowered = started

    def set(self, limit: float, person: str, moment: str, now: Moment, at: int) -> str:
        """Set people's limit as `requested_change` allows; return the sentence of the answer."""
        before, self.people = self.people, self.requested_change(limit, person, moment, now, at)
        if self.people is before:
            return Sentence("the speed limit of people is {percent:.0f}% already", percent=100 * limit)
        self.fault = ""
        if limit <= before.limit:
            self._lowered = replace(now, at=now.at + SHOWN_AFTER)
        whose, was, now_is = before.person or Sentence("nobody"), 100 * before.limit, 100 * limit
        former = Sentence("before it was {before:.0f}% ({whose})", before=was, whose=whose)
        if limit > before.limit:
            return Sentence(
                "the speed limit of people is raised to {percent:.0f}%; {former}", percent=now_is, former=former
            )
        return Sentence(
            "the speed limit of people is lowered to {percent:.0f}%; {former}", percent=now_is, former=former
        )

    def requested_change(self, limit: float, person: str, moment: str, now: Moment, at: int) -> SpeedChange:
        """Return people's limit after a request at the ROS time `at` [ns]; a moment only raises it, none only lowers it.

        Raises:
            PayloadError: ``values``, ``person``, ``moment``, or ``direction``.
            ExpiredError: The moment is too old, or the limit was lowered since.
        """
        if not LEAST_SPEED <= limit <= 1.0:
            raise PayloadError("values", f"limit is {limit:g}; expected {LEAST_SPEED:g} to 1, of the planned speed")
        if not person.strip():
            raise PayloadError("person", Sentence("a speed limit of people needs the name of who sets it"))
        before = self.people
        if limit == before.limit and not self.fault:
            return before
        if not moment and limit > before.limit:
            raise PayloadError(
                "direction",
                Sentence(
                    "lower_speed only lowers the limit of people, which is {before:.0f}%", before=100 * before.limit
                ),
            )
        if moment and limit < before.limit:
            raise PayloadError(
                "direction",
                Sentence(
                    "raise_speed only raises the limit of people, which is {before:.0f}%", before=100 * before.limit
                ),
            )
        if moment:
            shown_at = parse_moment(moment)
            if problem := staleness(shown_at, now):
                raise ExpiredError(Sentence("the raise of the speed limit is {problem}", problem=problem))
            if not is_newer(shown_at, self._lowered):
                raise ExpiredError(Sentence("the raise of the speed limit is void: it was lowered since; ask anew"))
        return SpeedChange(person, limit, before.limit, before.person, at)

    def state_report(self, now: int) -> SpeedReport | None:
        """Return the limit in force at `now` [ns, monotonic]; None before the first limit."""
        program, people = self.program, self.people
        allowed = program.update(now)
        if not program.name and people == NOBODY:
            return None
        limit = min(allowed, people.limit)
        by = "" if limit == 1.0 else "people" if people.limit <= allowed else "program"
        reason: str = Sentence(
            "{person} has limited the speed to {percent:.0f}%", percent=100 * people.limit, person=people.person
        )
        if by != "people":
            # a required source is silent: what the executor does then holds beside a person's limit, too
            asks = program.state is not LimitState.UNLIMITED
            reason = program.reason if asks else Sentence("nobody limits the speed")
        elif self.fault:
            reason = Sentence(
                "speed limit {percent:.0f}%: what people had set could not be read ({problem}); set it anew",
                percent=100 * people.limit,
                problem=self.fault,
            )
        set_by_people = people.limit, people.person, people.stamp, people.before, people.whose
        return SpeedReport(limit, by, reason, *set_by_people, program=allowed, program_name=program.name)
