"""The schedule as it stands in the file: tasks, their order, what they make, who does them, and when.

Nothing is concluded from it here; that is `work.schedule`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import ifcopenshell
import ifcopenshell.util.date
import isodate

from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import Sequence, Task
from construction_twin.work.ifc.notes import Notes, Where, label

_CALENDAR = (
    "Calendars are not read: lags and durations count around the clock, holidays and nights included, of tasks of one"
)
_KINDS = ("FINISH_START", "START_START", "FINISH_FINISH", "START_FINISH")
#: Resources that do work; materials and products are no robots.
_WORKERS = ("IfcConstructionEquipmentResource", "IfcCrewResource", "IfcLaborResource", "IfcSubContractResource")
#: Schedules that are not what is to be done.
_OTHER_SCHEDULES = ("ACTUAL", "BASELINE")
#: Kinds of tasks that put in place what is assigned to them; all others but those below make nothing.
_MAKES = (None, "CONSTRUCTION", "INSTALLATION", "NOTDEFINED", "USERDEFINED")
#: Kinds of tasks after which what is assigned to them is no longer there.
_TAKES_DOWN = ("DEMOLITION", "DISMANTLE", "DISPOSAL", "REMOVAL")
#: The same in the words of an author's own kind.
_TAKES_DOWN_WORDS = ("demol", "dismantl", "remov", "tear", "abbruch", "abbau", "abriss", "rückbau")
#: Words of the status of a task, see `_status_word`: done, not to be done any more, and not begun.
_DONE_WORDS = (
    *("COMPLETED", "COMPLETE", "DONE", "FINISHED", "CLOSED"),
    *("FERTIGGESTELLT", "FERTIG", "ERLEDIGT", "ABGESCHLOSSEN"),
)
_CANCELLED_WORDS = ("CANCELLED", "CANCELED", "ENTFALLEN", "ENTFÄLLT", "STORNIERT")
_NOT_BEGUN_WORDS = (
    *("", "NOTSTARTED", "NOTYETSTARTED", "PLANNED", "SCHEDULED", "OPEN", "READY", "TODO", "NOTDEFINED"),
    *("GEPLANT", "OFFEN", "NICHTBEGONNEN"),
)


@dataclass
class _Assigned:
    """What relations assign to tasks, by the task's id."""

    products: dict[int, list[ifcopenshell.entity_instance]] = field(default_factory=lambda: defaultdict(list))
    inputs: dict[int, list[ifcopenshell.entity_instance]] = field(default_factory=lambda: defaultdict(list))
    workers: dict[int, list[str]] = field(default_factory=lambda: defaultdict(list))
    parents: dict[int, ifcopenshell.entity_instance] = field(default_factory=dict)
    schedules: dict[int, ifcopenshell.entity_instance] = field(default_factory=dict)
    times: dict[int, ifcopenshell.entity_instance] = field(default_factory=dict)
    calendars: dict[int, str] = field(default_factory=dict)


def read_tasks(
    file: ifcopenshell.file,
    name: str,
    ids: dict[int, str],
    workpieces: Collection[str],
    time_unit: float,
    notes: Notes,
) -> tuple[dict[str, Task], tuple[Sequence, ...]]:
    """Read tasks and sequences.

    Parameters
    ----------
    file : ifcopenshell.file
    name : str
        For messages.
    ids : dict of int to str
        Id of the element's record, by the entity's id.
    workpieces : collection of str
        Ids of elements that are workpieces by default.
    time_unit : float
        Seconds per unit of time, for IFC2x3's times that are numbers.
    notes : Notes

    Returns
    -------
    dict of str to Task, tuple of Sequence

    Raises
    ------
    BuildingError
    """
    assigned = _assigned(file, name, notes)
    entities = _scheduled(sorted(file.by_type("IfcTask"), key=lambda task: task.id()), assigned, notes)
    task_ids: dict[int, str] = {}
    for entity in entities:
        with Where(name, entity):
            task_ids[entity.id()] = unique_id(entity, task_ids.values(), notes)
    tasks = {}
    for entity in entities:
        if (calendar := assigned.calendars.get(entity.id())) is not None:
            about = entity.Name or task_ids[entity.id()]
            notes.add(f"{_CALENDAR} ({calendar})", about, task_ids[entity.id()])
        with Where(name, entity):
            task = _task(entity, name, task_ids, assigned, ids, set(workpieces), time_unit, notes)
            tasks[task.id] = task
    sequences = []
    for relation in file.by_type("IfcRelSequence"):
        with Where(name, relation):
            sequence = _sequence(relation, task_ids, time_unit, tasks, notes)
        if sequence is not None:
            sequences.append(sequence)
    return tasks, tuple(sequences)


def unique_id(entity: ifcopenshell.entity_instance, taken: Collection[str], notes: Notes) -> str:
    """Return an entity's GlobalId; where it has none, or one that is taken, its number in the file: ``#123``."""
    given = entity.GlobalId
    allowed = (
        isinstance(given, str)
        and 0 < len(given) <= 64
        and all(c.isascii() and (c.isalnum() or c in "_$") for c in given)
    )
    if allowed and given not in taken:
        return given
    notes.add("Named by the number in the file, because the GlobalId is missing, wrong or another one's", label(entity))
    return f"#{entity.id()}"


def _assigned(file: ifcopenshell.file, name: str, notes: Notes) -> _Assigned:
    found = _Assigned()
    for relation in file.by_type("IfcRelNests"):
        with Where(name, relation):
            if relation.RelatingObject.is_a("IfcTask"):
                for part in relation.RelatedObjects:
                    found.parents.setdefault(part.id(), relation.RelatingObject)
    for relation in file.by_type("IfcRelAssignsToProduct"):
        with Where(name, relation):
            for each in relation.RelatedObjects:
                if each.is_a("IfcTask"):
                    found.products[each.id()].append(relation.RelatingProduct)
    for relation in file.by_type("IfcRelAssignsToProcess"):
        with Where(name, relation):
            for each in relation.RelatedObjects:
                if each.is_a("IfcProduct"):
                    found.inputs[relation.RelatingProcess.id()].append(each)
                elif each.is_a("IfcResource"):
                    _work(found, relation.RelatingProcess, each)
    for relation in file.by_type("IfcRelAssignsToResource"):
        with Where(name, relation):
            for each in relation.RelatedObjects:
                if each.is_a("IfcTask"):
                    _work(found, each, relation.RelatingResource)
    # the subtype IfcRelAssignsTasks of IFC2x3 carries the times
    for relation in file.by_type("IfcRelAssignsToControl"):
        with Where(name, relation):
            for each in relation.RelatedObjects:
                if not each.is_a("IfcTask"):
                    continue
                if relation.RelatingControl.is_a("IfcWorkCalendar"):
                    found.calendars[each.id()] = relation.RelatingControl.Name or label(relation.RelatingControl)
                if relation.RelatingControl.is_a("IfcWorkControl"):
                    found.schedules.setdefault(each.id(), relation.RelatingControl)
                if getattr(relation, "TimeForTask", None) is not None:
                    found.times[each.id()] = relation.TimeForTask
    return found


def _work(found: _Assigned, task: ifcopenshell.entity_instance, resource: ifcopenshell.entity_instance) -> None:
    name = resource.Name or resource.GlobalId
    if any(resource.is_a(kind) for kind in _WORKERS) and name not in found.workers[task.id()]:
        found.workers[task.id()].append(name)


def _scheduled(
    entities: Iterable[ifcopenshell.entity_instance], assigned: _Assigned, notes: Notes
) -> list[ifcopenshell.entity_instance]:
    """Tasks of what is to be done: a baseline, or a record of what was done, beside it would make everything twice."""
    by_schedule: dict[int, list[ifcopenshell.entity_instance]] = defaultdict(list)
    # name and kind of each schedule by its id, 0 for tasks that are in none
    schedules: dict[int, tuple[str, str]] = {}
    for entity in entities:
        top = entity
        while (parent := assigned.parents.get(top.id())) is not None and parent.is_a("IfcTask"):
            top = parent
        schedule = assigned.schedules.get(top.id())
        if schedule is None:
            key, schedules[0] = 0, ("(tasks without a schedule)", "")
        else:
            key = schedule.id()
            schedules[key] = (schedule.Name or "", getattr(schedule, "PredefinedType", None) or "")
        by_schedule[key].append(entity)
    kept = [key for key, (_, kind) in schedules.items() if kind not in _OTHER_SCHEDULES] or list(schedules)
    for key in schedules.keys() - set(kept):
        name, kind = schedules[key]
        notes.add(f"Schedules of the kind {kind}, left out with their tasks because there is another", name)
    if len(kept) > 1:
        notes.add(f"{len(kept)} schedules, whose tasks are all read: {', '.join(schedules[key][0] for key in kept)}")
    wanted = {entity.id() for key in kept for entity in by_schedule[key]}
    return [entity for entity in entities if entity.id() in wanted]


def _task(
    entity: ifcopenshell.entity_instance,
    name: str,
    task_ids: dict[int, str],
    assigned: _Assigned,
    ids: dict[int, str],
    workpieces: set[str],
    time_unit: float,
    notes: Notes,
) -> Task:
    task_id = task_ids[entity.id()]
    shown = entity.Name or task_id
    products = _elements(assigned.products[entity.id()], ids, shown, task_id, notes)
    inputs = _elements(assigned.inputs[entity.id()], ids, shown, task_id, notes)
    cancelled = _is_cancelled(entity, assigned)
    kind = _kind(entity, task_id, shown, notes) if not cancelled else "other"
    if cancelled:
        sentence = "Tasks that the file says are cancelled: not done, nothing waits for them but what comes before"
        notes.add(sentence, shown, task_id)
    if not products and inputs and kind == "makes" and (made := [each for each in inputs if each in workpieces]):
        notes.add(
            "Tasks whose workpieces are assigned as inputs only (IfcRelAssignsToProcess); taken as what they make",
            shown,
            task_id,
        )
        products, inputs = made, [each for each in inputs if each not in made]
    parent = assigned.parents.get(entity.id())
    start, finish, duration = _times(entity, assigned.times.get(entity.id()), time_unit, shown, notes)
    return Task(
        id=task_id,
        name=entity.Name or "",
        description=entity.Description or "",
        parent="" if parent is None else task_ids.get(parent.id(), ""),
        products=tuple(products),
        inputs=tuple(inputs),
        robots=tuple(assigned.workers[entity.id()]),
        milestone=bool(entity.IsMilestone),
        start=start,
        finish=finish,
        duration=duration,
        kind=kind,
        completed=not cancelled and _completed(entity, assigned.times.get(entity.id()), task_id, shown, notes),
    )


def _kind(entity: ifcopenshell.entity_instance, task_id: str, shown: str, notes: Notes) -> str:
    given = getattr(entity, "PredefinedType", None)
    # of IFC2x3, and of a kind of its own: the author's word for it
    own = (entity.ObjectType or "") if given in (None, "USERDEFINED") else ""
    if given in _TAKES_DOWN or any(word in own.casefold() for word in _TAKES_DOWN_WORDS):
        given = own or given
        notes.add(
            f"Tasks of the kind {given}: the arm takes nothing down, a person says when it is gone", shown, task_id
        )
        return "takes_down"
    if given not in _MAKES:
        notes.add(f"Tasks of the kind {given}, which places nothing; kept for the order", shown, task_id)
        return "other"
    if given == "USERDEFINED":
        notes.add(f"Tasks of a kind of their own ({own!r}), taken as placing", shown, task_id)
    return "makes"


def _status_word(entity: ifcopenshell.entity_instance) -> str:
    """Return the status of a task in upper case, without what stands around its letters; digits, % and ? stay: they are doubts."""
    return "".join(each for each in (entity.Status or "").upper() if each.isalnum() or each in "?%")


def _is_cancelled(entity: ifcopenshell.entity_instance, assigned: _Assigned) -> bool:
    """Return whether the file says of a task, or of what it nests in, that it is not to be done any more."""
    above: ifcopenshell.entity_instance | None = entity
    seen: set[int] = set()
    while above is not None and above.is_a("IfcTask") and above.id() not in seen:
        if _status_word(above) in _CANCELLED_WORDS:
            return True
        seen.add(above.id())
        above = assigned.parents.get(above.id())
    return False


def _completed(
    entity: ifcopenshell.entity_instance,
    control: ifcopenshell.entity_instance | None,
    task_id: str,
    shown: str,
    notes: Notes,
) -> bool:
    """Return whether the file says that a task is done; one that is under way, or says both, is noted."""
    time = control if control is not None else getattr(entity, "TaskTime", None)
    status = _status_word(entity)
    part = getattr(time, "Completion", None)
    signs = [
        status in _DONE_WORDS,
        isinstance(part, (int, float)) and part >= (100.0 if part > 1.0 else 1.0),
        getattr(time, "ActualFinish", None) is not None,
    ]
    if any(signs):
        sentence = "Tasks that the file says are completed: not done again, what they made stands"
        notes.add(sentence, shown, task_id)
        if status and status not in _DONE_WORDS:
            notes.add(
                f"Tasks with the status {entity.Status!r} whose times say that they are completed", shown, task_id
            )
        return True
    begun = getattr(time, "ActualStart", None) is not None or (isinstance(part, (int, float)) and part > 0)
    if begun or (status and status not in _NOT_BEGUN_WORDS):
        said = f"status {entity.Status!r}" if status else "a start or a part that is done"
        notes.add(
            f"TASKS THAT MAY HAVE BEGUN ({said}), taken as still to be done; if what they make stands already, skip them",
            shown,
            task_id,
        )
    return False


def _elements(
    entities: list[ifcopenshell.entity_instance], ids: dict[int, str], task: str, at: str, notes: Notes
) -> list[str]:
    for entity in entities:
        if entity.id() not in ids:
            notes.add(f"Assigned to a task but no element ({entity.is_a()}); left out of", task, at)
    return list(dict.fromkeys(ids[entity.id()] for entity in entities if entity.id() in ids))


def _times(
    entity: ifcopenshell.entity_instance,
    control: ifcopenshell.entity_instance | None,
    time_unit: float,
    task: str,
    notes: Notes,
) -> tuple[str, str, float | None]:
    time = control if control is not None else getattr(entity, "TaskTime", None)
    if time is None:
        return "", "", None
    start, finish = (_moment(value, task, notes) for value in (time.ScheduleStart, time.ScheduleFinish))
    given = time.ScheduleDuration
    if isinstance(given, str):
        return start, finish, _seconds(given, task, notes)
    return start, finish, None if given is None else given * time_unit


def _moment(value: str | ifcopenshell.entity_instance | None, task: str, notes: Notes) -> str:
    if value is None:
        return ""
    try:
        with Where("", task):
            if isinstance(value, str):
                return str(ifcopenshell.util.date.ifc2datetime(value).isoformat())  # type: ignore[union-attr]
            return _date_and_time(value).isoformat()
    except BuildingError:
        notes.add("A time that is no date, left out, of tasks", task)
        return ""


def _date_and_time(value: ifcopenshell.entity_instance) -> datetime:
    """A moment of IFC2x3, which need not have minutes and seconds."""
    date, time = value, None
    if value.is_a("IfcDateAndTime"):
        date, time = value.DateComponent, value.TimeComponent
    clock = (
        (0, 0, 0) if time is None else (time.HourComponent, time.MinuteComponent or 0, int(time.SecondComponent or 0))
    )
    return datetime(date.YearComponent, date.MonthComponent, date.DayComponent, *clock)


def _seconds(value: str, task: str, notes: Notes) -> float | None:
    try:
        parsed = isodate.parse_duration(value)
    except (ValueError, TypeError, OverflowError, ArithmeticError):
        notes.add(f"{value[:40]!r} is no duration of ISO 8601, left out, of tasks", task)
        return None
    if not isinstance(parsed, timedelta):
        notes.add(f"A duration in years or months ({value[:40]!r}) has no length in seconds, left out, of tasks", task)
        return None
    return parsed.total_seconds()


def _sequence(
    relation: ifcopenshell.entity_instance,
    task_ids: dict[int, str],
    time_unit: float,
    tasks: dict[str, Task],
    notes: Notes,
) -> Sequence | None:
    before, after = (task_ids.get(end.id()) for end in (relation.RelatingProcess, relation.RelatedProcess))
    if before is None or after is None:
        notes.add("Orders with something that is no task of the schedule, left out", label(relation))
        return None
    kind = relation.SequenceType
    if kind not in _KINDS:
        notes.add("Orders without one of the four kinds, taken as finish to start", label(relation))
        kind = _KINDS[0]
    return Sequence(before, after, kind, _lag(relation, tasks[before], time_unit, notes))


def _lag(relation: ifcopenshell.entity_instance, before: Task, time_unit: float, notes: Notes) -> float:
    lag = relation.TimeLag
    if lag is None:
        return 0.0
    about = label(relation)
    if isinstance(lag, (int, float)):
        seconds: float | None = lag * time_unit
    else:
        value = lag.LagValue
        if value.is_a("IfcRatioMeasure"):
            if before.duration is None:
                notes.add("A lag that is a part of a duration that is not known, left out, of", about)
                return 0.0
            seconds = value.wrappedValue * before.duration
            notes.add("A lag that is a part of the duration of the task before, of", about)
        else:
            seconds = _seconds(value.wrappedValue, about, notes)
        if lag.DurationType == "WORKTIME" and seconds:
            sentence = (
                "A lag in working time is waited for around the clock (no calendar is read), between the tasks of"
            )
            notes.add(sentence, about)
            notes.remark(sentence, before.id)
    if seconds is None or not math.isfinite(seconds):
        return 0.0
    return float(seconds)
