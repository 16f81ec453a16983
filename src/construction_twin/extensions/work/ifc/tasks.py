"""The schedule as it stands in the file: tasks, their order, what they make, who does them, and when.

Nothing is concluded from it here; that is `work.schedule`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from datetime import datetime, timedelta
from functools import partial

import ifcopenshell
import ifcopenshell.util.date
import ifcopenshell.util.element
import isodate
import numpy as np

from construction_twin.extensions.work.building import BuildingError, Element, Sequence, Task
from construction_twin.extensions.work.ifc.entities import Relations, Units, read_properties, refuse_loops
from construction_twin.extensions.work.ifc.notes import Notes, ReadingEntity, label
from construction_twin.extensions.work.process import PROPERTY_SET, RECIPE
from construction_twin.kinematics.chain import Pose

_Entity = ifcopenshell.entity_instance
_NO_TIME = "The project has no unit of time: a lag or duration that is a number is taken as seconds"
#: Adds a note on one task or order.
_Note = Callable[[str], None]
_KINDS = ("FINISH_START", "START_START", "FINISH_FINISH", "START_FINISH")
#: Resources that do work; materials and products are no robots.
_WORKERS = ("IfcConstructionEquipmentResource", "IfcCrewResource", "IfcLaborResource", "IfcSubContractResource")
#: Schedules that are not what is to be done.
_OTHER_SCHEDULES = ("ACTUAL", "BASELINE")
#: Kinds of tasks that put in place what is assigned to them; all others but those below make nothing.
_MAKES = ("CONSTRUCTION", "INSTALLATION")
#: Kinds of tasks after which what is assigned to them is no longer there.
_TAKES_DOWN = ("DEMOLITION", "DISMANTLE", "DISPOSAL", "REMOVAL")
#: All other kinds of the schema; in IFC2x3, which has none, an author's own word is one.
_OTHER_KINDS = (
    *("ADJUSTMENT", "ATTENDANCE", "CALIBRATION", "EMERGENCY", "INSPECTION", "LOGISTIC", "MAINTENANCE", "MOVE"),
    *("OPERATION", "RENOVATION", "SAFETY", "SHUTDOWN", "STARTUP", "TESTING", "TROUBLESHOOTING"),
)
#: Words of the status of a task: done, not to be done any more, and not begun.
_DONE_WORDS = ("COMPLETED", "COMPLETE", "DONE", "FINISHED", "CLOSED")
_CANCELLED_WORDS = ("CANCELLED", "CANCELED")
_NOT_BEGUN_WORDS = ("", "NOTSTARTED", "NOTYETSTARTED", "PLANNED", "SCHEDULED", "OPEN", "READY", "NOTDEFINED")
#: By how much a part that is done may differ from 1, which is all.
_ROUNDING = 1e-6


class Groups:
    """What tasks are assigned to: elements, and groups and parts of the site, which become records of their own (`elements`)."""

    def __init__(self, relations: Relations, ids: dict[int, str], notes: Notes):
        self.relations, self._ids, self._notes = relations, dict(ids), notes
        self.elements: dict[str, Element] = {}

    def named(self, entity: _Entity) -> str:
        """Return the id of an element, or of what holds elements; empty: it is neither."""
        if entity.id() not in self._ids:
            within = self.relations.within(entity)
            members = tuple(self._ids[each.id()] for each in within if each.id() in self._ids)
            if not members:
                return ""
            own = unique_id(entity, self._ids.values(), self._notes)
            self._ids[entity.id()] = own
            self.elements[own] = Element(
                own, entity.is_a(), entity.Name or "", "", "", "", Pose(np.zeros(3), np.eye(3)), (), {}, None,
                members=members,
            )  # fmt: skip
        return self._ids[entity.id()]


def read_tasks(
    file: ifcopenshell.file, name: str, groups: Groups, built_from_inputs: Collection[str], units: Units, notes: Notes
) -> tuple[dict[str, Task], tuple[Sequence, ...]]:
    """Read tasks and sequences; `built_from_inputs`: ids of elements that a task builds where it has them as inputs only."""
    parents: dict[int, _Entity] = {}
    # IFC wants nesting; some authors aggregate
    for relation in (*file.by_type("IfcRelNests"), *file.by_type("IfcRelAggregates")):
        if relation.RelatingObject.is_a("IfcTask"):
            for part in relation.RelatedObjects:
                parents.setdefault(part.id(), relation.RelatingObject)
    refuse_loops(file, name, parents)
    reading = _Reading(parents, groups, built_from_inputs, units, notes)
    every = sorted(file.by_type("IfcTask"), key=lambda task: task.id())
    with ReadingEntity(name, "the schedule"):
        reading.beyond = any(_completion(_time_of(task)) > 1.0 + _ROUNDING for task in every)
        if reading.beyond:
            said = "A part that is done (`Completion`) is above 1, perhaps percent"
            notes.add(f"{said}: by their parts no tasks are completed")
        entities = reading.scheduled(every)
    for entity in entities:
        with ReadingEntity(name, entity):
            reading.ids[entity.id()] = unique_id(entity, reading.ids.values(), notes)
    for entity in entities:
        with ReadingEntity(name, entity):
            task = reading.task(entity)
            reading.tasks[task.id] = task
    sequences = []
    for relation in file.by_type("IfcRelSequence") if entities else ():
        with ReadingEntity(name, relation):
            sequence = reading.sequence(relation)
        if sequence is not None:
            sequences.append(sequence)
    return reading.tasks, tuple(sequences)


def unique_id(entity: _Entity, used_ids: Collection[str], notes: Notes) -> str:
    """Return an entity's GlobalId; where it has none, or one that is taken, its number in the file: ``#123``."""
    global_id = entity.GlobalId
    allowed = (
        isinstance(global_id, str)
        and 0 < len(global_id) <= 64
        and all(c.isascii() and (c.isalnum() or c in "_$") for c in global_id)
    )
    if allowed and global_id not in used_ids:
        return global_id
    notes.add("Named by the number in the file, because the GlobalId is missing, wrong or another one's", label(entity))
    return f"#{entity.id()}"


class _Reading:
    """The tasks of a file; `beyond`: some `Completion` is above 1, perhaps percent."""

    def __init__(
        self,
        parents: dict[int, _Entity],
        groups: Groups,
        built_from_inputs: Collection[str],
        units: Units,
        notes: Notes,
    ):
        self._groups, self._built_from_inputs, self._notes = groups, built_from_inputs, notes
        self._time_unit = units.factors.get("TIMEUNIT")
        self._units, self._parents = units, parents
        self.ids: dict[int, str] = {}
        self.tasks: dict[str, Task] = {}
        self.beyond = False

    def scheduled(self, entities: list[_Entity]) -> list[_Entity]:
        """Return the tasks to do, without those of a baseline or a record of what was done."""
        by_schedule: dict[int, list[_Entity]] = defaultdict(list)
        # name and kind of each schedule by its id, 0 for tasks that are in none
        schedules = {0: ("(tasks without a schedule)", "")}
        for entity in entities:
            *_, top = self._above(entity)
            controls = [each.RelatingControl for each in _assignments(top, "IfcRelAssignsToControl")]
            schedule = next((control for control in controls if control.is_a("IfcWorkControl")), None)
            if schedule is not None:
                # the second is IFC2x3's
                kinds = (getattr(schedule, name, None) for name in ("PredefinedType", "WorkControlType"))
                schedules[schedule.id()] = (schedule.Name or "", next(filter(None, kinds), ""))
            by_schedule[0 if schedule is None else schedule.id()].append(entity)
        schedules_read = [key for key in by_schedule if schedules[key][1] not in _OTHER_SCHEDULES] or list(by_schedule)
        for key in by_schedule.keys() - set(schedules_read):
            name, kind = schedules[key]
            self._notes.add(f"Schedules of the kind {kind}, left out with their tasks because there is another", name)
        if len(schedules_read) > 1:
            names = ", ".join(schedules[key][0] for key in schedules_read)
            self._notes.add(f"{len(schedules_read)} schedules, whose tasks are all read: {names}")
        return sorted((entity for key in schedules_read for entity in by_schedule[key]), key=lambda entity: entity.id())

    def task(self, entity: _Entity) -> Task:
        """Return one."""
        task_id, time = self.ids[entity.id()], _time_of(entity)
        note = partial(self._notes.add, about=entity.Name or task_id)
        operates = [each for relation in entity.OperatesOn for each in relation.RelatedObjects]
        products = self._elements(
            [each.RelatingProduct for each in _assignments(entity, "IfcRelAssignsToProduct")], note
        )
        inputs = self._elements([each for each in operates if not each.is_a("IfcResource")], note)
        workers = [each for each in operates if each.is_a("IfcResource")]
        workers += [each.RelatingResource for each in _assignments(entity, "IfcRelAssignsToResource")]
        robots = (each.Name or each.GlobalId for each in workers if any(map(each.is_a, _WORKERS)))
        cancelled = any(_status_word(each) in _CANCELLED_WORDS for each in self._above(entity))
        properties = read_properties(entity, task_id, self._units, self._notes).get(PROPERTY_SET, {})
        by_recipe = properties.get(RECIPE) is not None
        kind = "other" if cancelled else self._kind(entity, by_recipe, note)
        if cancelled:
            note("Tasks that the file says are cancelled: not done, nothing waits for them but what comes before")
        if kind == "makes" and not products:
            built, groups = self._built_from_inputs, self._groups.elements
            products = [each for each in inputs if by_recipe or each in built or each in groups]
            inputs = [each for each in inputs if each not in products]
            if products and not by_recipe:
                note("Tasks whose workpieces are inputs only (IfcRelAssignsToProcess); taken as what they make")
        parent = self._parents.get(entity.id())
        starts = (getattr(time, f"{word}Start", None) for word in ("Schedule", "Early", "Late"))
        duration = getattr(time, "ScheduleDuration", None)
        return Task(
            id=task_id,
            name=entity.Name or "",
            parent="" if parent is None else self.ids.get(parent.id(), ""),
            products=tuple(products),
            inputs=tuple(inputs),
            robots=tuple(dict.fromkeys(robots)),
            milestone=bool(entity.IsMilestone),
            start=next(filter(None, (_moment(start, note) for start in starts)), ""),
            duration=None if duration is None else self._seconds(duration, note),
            kind=kind,
            completed=not cancelled and self._completed(entity, note),
            properties=properties,
        )

    def _above(self, entity: _Entity) -> Iterator[_Entity]:
        at: _Entity | None = entity
        while at is not None and at.is_a("IfcTask"):
            yield at
            at = self._parents.get(at.id())

    def _elements(self, entities: list[_Entity], note: _Note) -> list[str]:
        found: dict[str, None] = {}
        for entity in entities:
            if own := self._groups.named(entity):
                found[own] = None
            else:
                note(f"Assigned to a task but no element ({entity.is_a()}); left out")
        return list(found)

    def _kind(self, entity: _Entity, by_recipe: bool, note: _Note) -> str:
        """Return ``makes``, ``takes_down`` or ``other``: of the task or its type, else of what it nests in.

        A task that names its recipe (`by_recipe`) is the arm's, unless it takes down.
        """
        known = (*_MAKES, *_TAKES_DOWN, *_OTHER_KINDS)
        kind = next((word for word in map(_kind_word, self._above(entity)) if word in known), "")
        if kind in _TAKES_DOWN:
            note(f"Tasks of the kind {kind}: the arm takes nothing down, a person says when it is gone")
            return "takes_down"
        if by_recipe:
            return "makes"
        if kind in _OTHER_KINDS:
            note(f"Tasks of the kind {kind}, which places nothing; kept for the order")
            return "other"
        if (own := _kind_word(entity)) and own not in known:
            note(f"Tasks of a kind of their own ({own!r}), taken as placing")
        return "makes"

    def _is_marked_completed(self, entity: _Entity) -> bool:
        time = _time_of(entity)
        whole = not self.beyond and math.isclose(_completion(time), 1.0, abs_tol=_ROUNDING)
        return _status_word(entity) in _DONE_WORDS or whole or getattr(time, "ActualFinish", None) is not None

    def _completed(self, entity: _Entity, note: _Note) -> bool:
        """Return whether the file says that a task, or what it nests in, is done; note one that may have begun."""
        time, status = _time_of(entity), _status_word(entity)
        if any(map(self._is_marked_completed, self._above(entity))):
            note("Tasks that the file says are completed, or what they nest in is: what they made stands")
            return True
        if status not in _NOT_BEGUN_WORDS or getattr(time, "ActualStart", None) is not None or _completion(time) > 0:
            said = f"status {entity.Status!r}" if status else "a start or a part that is done"
            note(f"TASKS THAT MAY HAVE BEGUN ({said}), taken as still to be done; if what they make stands, skip them")
        return False

    def _seconds(self, value: str | float, note: _Note) -> float | None:
        if not isinstance(value, str):
            if value and self._time_unit is None:
                note(_NO_TIME)
            return value * (self._time_unit or 1.0)
        try:
            parsed = isodate.parse_duration(value)
        except (ValueError, TypeError, OverflowError, ArithmeticError):
            parsed = None
        if isinstance(parsed, timedelta):
            return parsed.total_seconds()
        note(f"A duration without a length in seconds ({value[:40]!r}) is left out")
        return None

    def sequence(self, relation: _Entity) -> Sequence | None:
        """Return one; None: it is of no tasks that are read, or within one."""
        processes = (relation.RelatingProcess, relation.RelatedProcess)
        before, after = map(self._end, processes)
        # what is in one task needs no order
        if not before or not after or (before == after and not all(each.is_a("IfcTask") for each in processes)):
            return None
        if not processes[0].is_a("IfcTask"):
            said = f"Comes after what the arm does not see happen ({processes[0].is_a()})"
            self._notes.add(f"{said}: only what is before that is waited for", processes[0].Name or before)
        note = partial(self._notes.add, about=label(relation))
        kind = relation.SequenceType
        if kind not in _KINDS:
            note("Orders without one of the four kinds, taken as finish to start")
            kind = _KINDS[0]
        return Sequence(before, after, kind, self._lag(relation.TimeLag, self.tasks[before].duration, note))

    def _end(self, process: _Entity) -> str:
        """Return the id of the task that an order names; empty: it is left out with its schedule.

        An event or a procedure passes the order on, or stands for the task that it is in.
        """
        if process.is_a("IfcTask") or process.id() in self.ids:
            return self.ids.get(process.id(), "")
        parent = self._parents.get(process.id())
        above = "" if parent is None else self.ids.get(parent.id(), "")
        if above and not any(task.parent == above for task in self.tasks.values()):
            return above
        own = self.ids[process.id()] = unique_id(process, self.ids.values(), self._notes)
        self.tasks[own] = Task(own, process.Name or "", parent=above, milestone=True, kind="other")
        return own

    def _lag(self, lag: _Entity | float | None, before: float | None, note: _Note) -> float:
        """Return a lag [s]; `before`: duration of the task that comes first [s]."""
        if lag is None:
            return 0.0
        if isinstance(lag, (int, float)):
            seconds = self._seconds(lag, note)
        else:
            value = lag.LagValue
            if not value.is_a("IfcRatioMeasure"):
                seconds = self._seconds(value.wrappedValue, note)
            elif before is None:
                note("A lag that is a part of a duration that is not known is left out")
                return 0.0
            else:
                note("A lag that is a part of the duration of the task before")
                seconds = value.wrappedValue * before
            if lag.DurationType == "WORKTIME" and seconds:
                note("A lag in working time is waited for around the clock (no calendar is read)")
        return float(seconds) if seconds is not None and math.isfinite(seconds) else 0.0


# -- what one entity says


def _assignments(task: _Entity, kind: str) -> list[_Entity]:
    return [each for each in task.HasAssignments if each.is_a(kind)]


def _time_of(task: _Entity) -> _Entity | None:
    times = (getattr(each, "TimeForTask", None) for each in _assignments(task, "IfcRelAssignsToControl"))
    return next(filter(None, times), None) or getattr(task, "TaskTime", None)


def _completion(time: _Entity | None) -> float:
    part = getattr(time, "Completion", None)
    return float(part) if isinstance(part, (int, float)) else 0.0


def _status_word(entity: _Entity) -> str:
    """Return the status of a task in upper case, without what stands around its letters; digits, % and ? stay: they are doubts."""
    return "".join(each for each in (entity.Status or "").upper() if each.isalnum() or each in "?%")


def _kind_word(entity: _Entity) -> str:
    """Return the kind of a task or its type, by the schema, else in a word of its author; empty: it says none."""
    kind = ifcopenshell.util.element.get_type(entity)
    words = (*(getattr(each, "PredefinedType", None) for each in (entity, kind)), entity.ObjectType)
    upper = ((word or "").strip().upper() for word in (*words, getattr(kind, "ProcessType", None)))
    return next((word for word in upper if word not in ("", "NOTDEFINED", "USERDEFINED")), "")


def _moment(value: str | _Entity | None, note: _Note) -> str:
    if value is None:
        return ""
    try:
        with ReadingEntity("", "a time"):
            moment = ifcopenshell.util.date.ifc2datetime(value) if isinstance(value, str) else _date_and_time(value)
            text = str(moment.isoformat())  # type: ignore[union-attr]
        datetime.fromisoformat(text).timestamp()  # orders compare it: no time of day, no year 0
        return text
    except (BuildingError, ValueError, OverflowError):
        note("A time that is no date is left out")
        return ""


def _date_and_time(value: _Entity) -> datetime:
    """Return a moment of IFC2x3, which need not have minutes and seconds."""
    date, time = (value.DateComponent, value.TimeComponent) if value.is_a("IfcDateAndTime") else (value, None)
    clock = (0,) if time is None else (time.HourComponent, time.MinuteComponent or 0, int(time.SecondComponent or 0))
    return datetime(date.YearComponent, date.MonthComponent, date.DayComponent, *clock)
