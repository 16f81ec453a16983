"""The review record: an append-only file of verdicts and ends of executions. Durations in s, distances in m."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from construction_twin.core.append_only import AppendOnlyFile, read_lines
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RecordError
from construction_twin.core.reports import SessionRequest, SpeedChange
from construction_twin.review.plan_under_review import APPROVED, ExecutionEnd, Verdict
from construction_twin.robot.plan import Plan


@dataclass(frozen=True)
class Responsibility:
    """A bare PLC was armed by a person, who is responsible for what is not checked; see docs/broker.md."""

    name: str
    session: str
    not_checked: tuple[str, ...]


@dataclass(frozen=True)
class Release:
    """A person has freed an arm that was engaged, and says how; `refused`: why it stays engaged after all."""

    person: str
    reason: str
    plan: str
    task: str
    segment: str
    refused: str = ""


#: What is recorded.
Record = Verdict | ExecutionEnd | Responsibility | Release | SessionRequest | SpeedChange


@dataclass(frozen=True)
class PlanRecord:
    """Summary of the record's entries on one plan.

    Attributes:
        plan: Its id; empty: the record has none that fits.
        approved: None: the record cannot be read.
        outcome: Of its execution; empty: none is recorded.
    """

    plan: str
    approved: bool | None
    outcome: str = ""
    under_review: bool = False


def read_plan_record(path: str | Path, plan_id: str, source: str = "") -> PlanRecord:
    """Return the summary of a review file's entries on a plan, found by its id or a part of its source."""
    try:
        found = PlanRecord(plan_id, False)
        for fields in read_lines(path):
            named = fields.get("plan", "")
            if (plan_id and named == plan_id) or (source and source in fields.get("source", "")):
                plan_id = plan_id or named
                approved = bool(found.approved) or fields.get("verdict") == APPROVED
                found = PlanRecord(named, approved, fields.get("outcome", "") or found.outcome)
    except (ConfigurationError, TypeError):
        return PlanRecord(plan_id, None)
    return found


class ReviewLog:
    """Appends records to a review file, from several threads; `clock` returns UTC [ns].

    `responsibility` is what is in force; it is recorded with every verdict.
    """

    def __init__(self, path: str | Path, clock: Callable[[], int]):
        if not str(path).strip():
            raise ConfigurationError("review file", str(path), "a path: nothing is approved without a record")
        self._clock = clock
        self.responsibility: Responsibility | None = None
        self.file = AppendOnlyFile(path, RecordError, "executor")
        try:
            self._end_interrupted()
        except ConstructionTwinError:
            self.close()
            raise

    def on_responsible(self, responsibility: Responsibility | None) -> None:
        """Store the responsible person, and record a change."""
        before, self.responsibility = self.responsibility, responsibility
        if responsibility is not None and responsibility != before:
            self.defer(responsibility)

    def defer(self, record: Record) -> None:
        """Queue a record, with the present time, for `flush`."""
        self.file.defer(self._clock(), _fields(record, self.responsibility))

    def flush(self) -> None:
        """Write queued records; RecordError leaves them queued."""
        self.file.flush()

    def append(self, record: Record) -> None:
        """Write queued records, then this one, to the disk; RecordError leaves nothing of it."""
        self.file.append(self._clock(), _fields(record, self.responsibility))

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def _end_interrupted(self) -> None:
        """Record the end of an execution that the executor before left open."""
        last = _execution_without_end(read_lines(self.file.path))
        if last is not None:
            fields = {
                "record": "execution",
                "outcome": "dropped",
                "plan": last["plan"],
                "trajectory": last["trajectory"],
            }
            fields |= {"scene": last["scene"], "reason": "the executor ended before the execution did"}
            self.file.append(self._clock(), fields)


# -- records


def _fields(record: Record, responsibility: Responsibility | None) -> dict:
    if isinstance(record, Responsibility):
        return {"record": "responsibility", "session": record.session} | _responsibility_fields(record)
    if isinstance(record, SessionRequest):
        return {"record": "session", "verb": record.verb, "person": record.person, "lifts": record.lifts}
    if isinstance(record, SpeedChange):
        named = {"record": "speed", "person": record.person, "limit": record.limit}
        return named | {"before": record.before, "whose": record.whose}
    if isinstance(record, Release):
        return {"record": "release"} | asdict(record)
    if isinstance(record, ExecutionEnd):
        plan = record.plan
        named = {"record": "execution", "outcome": record.outcome, "plan": plan.id, "trajectory": plan.hash}
        return named | _task_fields(plan) | {"scene": plan.scene, "reason": record.reason}
    trajectory = record.plan_hash if record.plan is None else record.plan.hash
    named = {"record": "verdict", "verdict": record.verdict, "plan": record.plan_id, "trajectory": trajectory}
    named |= {"reviewer": record.reviewer, "reason": record.reason}
    # of a rehearsal nothing where there was none, and none was required
    named |= {} if record.rehearsal is None else {"rehearsal": asdict(record.rehearsal)}
    return named | _responsibility_fields(responsibility) | _plan_fields(record.plan)


def _responsibility_fields(responsibility: Responsibility | None) -> dict:
    """Return the record's fields of who is responsible in place of a gateway's checks; {} with a gateway."""
    if responsibility is None:
        return {}
    return {"responsible": responsibility.name, "not_checked": list(responsibility.not_checked)}


def _plan_fields(plan: Plan | None) -> dict:
    """Return the plan's fields of a record; {} for an unknown plan."""
    if plan is None:
        return {}
    clearance = plan.report.clearance
    return _task_fields(plan) | {
        "scene": plan.scene,
        "source": plan.source,
        "planner": plan.planner,
        "duration": plan.trajectory.duration,
        "clearance": _number(clearance.distance),
        "clearance_between": list(clearance.between),
        "clearance_time": _number(clearance.time),
    }


def _task_fields(plan: Plan) -> dict:
    """Return the task of a work plan and its segments by name; nothing of any other plan."""
    if not (plan.task or plan.segments):
        return {}
    return {"task": plan.task, "segments": [segment.name for segment in plan.segments]}


def _number(value: float) -> float | None:
    """Return what JSON can hold: None for a distance that is infinite because there is nothing to touch."""
    return value if math.isfinite(value) else None


def _execution_without_end(lines: Iterable[dict]) -> dict | None:
    """Return the last approval if no end of its execution is recorded after it."""
    last = None
    for fields in lines:
        if fields.get("verdict") == APPROVED:
            last = fields
        elif last is not None and fields.get("record") == "execution" and fields.get("plan") == last["plan"]:
            last = None
    return last
