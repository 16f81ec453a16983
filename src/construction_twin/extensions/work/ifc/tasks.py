"""The schedule as it stands in the file: tasks, their order, what they make, who does them, and when.

Nothing is concluded from it here; that is `work.schedule`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import partial

import ifcopenshell
import ifcopenshell.util.date
import ifcopenshell.util.element
import isodate
import numpy as np

from construction_twin.extensions.work.building import Element, Sequence, Task
from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.notes import Notes, Where, label
from construction_twin.extensions.work.ifc.properties import Units, read_properties
from construction_twin.extensions.work.ifc.relations import Relations
from construction_twin.extensions.work.process import PROPERTY_SET, RECIPE
from construction_twin.kinematics.chain import Pose

_NO_TIME = "The project has no unit of time: a lag or duration that is a number is taken as seconds"
#: Adds a note on one task or order.
_Note = Callable[[str], None]
#: Dates of a task, the first that is said counts.
_DATES = ("Schedule", "Early", "Late")
_KINDS = ("FINISH_START", "START_START", "FINISH_FINISH", "START_FINISH")
#: Resources that do work; materials and products are no robots.
_WORKERS = ("IfcConstructionEquipmentResource", "IfcCrewResource", "IfcLaborResource", "IfcSubContractResource")
#: Schedules that are not what is to be done.
_OTHER_SCHEDULES = ("ACTUAL", "BASELINE")
#: Kinds of tasks that put in place what is assigned to them; all others but those below make nothing.
_MAKES = ("CONSTRUCTION", "INSTALLATION")
#: Kinds of tasks after which what is assigned to them is no longer there.
_TAKES_DOWN = ("DEMOLITION", "DISMANTLE", "DISPOSAL", "REMOVAL")
#: Kinds that place nothing, by which an author calls his own (of IFC2x3, which has no kinds): the schema's words.
_OTHER_KINDS = ("ATTENDANCE", "INSPECTION", "LOGISTIC", "MAINTENANCE", "MOVE", "OPERATION", "RENOVATION", "TESTING")
#: Kinds with which nothing is said, or only by the author's own word.
_OPEN = (None, "NOTDEFINED", "USERDEFINED")
#: Words of the status of a task: done, not to be done any more, and not begun.
_DONE_WORDS = ("COMPLETED", "COMPLETE", "DONE", "FINISHED", "CLOSED")
_CANCELLED_WORDS = ("CANCELLED", "CANCELED")
_NOT_BEGUN_WORDS = ("", "NOTSTARTED", "NOTYETSTARTED", "PLANNED", "SCHEDULED", "OPEN", "READY", "NOTDEFINED")
#: By how much a part that is done may differ from 1, which is all.
_ROUNDING = 1e-6


@dataclass
class _Assigned:
    """What relations assign to tasks, by the task's id."""

    products: dict[int, list[ifcopenshell.entity_instance]] = field(default_factory=lambda: defaultdict(list))
    inputs: dict[int, list[ifcopenshell.entity_instance]] = field(default_factory=lambda: defaultdict(list))
    workers: dict[int, list[str]] = field(default_factory=lambda: defaultdict(list))
    parents: dict[int, ifcopenshell.entity_instance] = field(default_factory=dict)
    schedules: dict[int, ifcopenshell.entity_instance] = field(default_factory=dict)
    times: dict[int, ifcopenshell.entity_instance] = field(default_factory=dict)
    #: Some `Completion` is above 1: nobody knows what the others are parts of.
    beyond: bool = False


class Groups:
    """What tasks are assigned to: elements, and groups and parts of the site, which become records of their own.

    `elements`: Records of the groups and parts of the site that tasks are assigned to, by their ids.
    """

    def __init__(self, relations: Relations, ids: dict[int, str], notes: Notes):
        self._relations, self._ids, self._notes = relations, dict(ids), notes
        self.elements: dict[str, Element] = {}

    def named(self, entity: ifcopenshell.entity_instance) -> str:
        """Return the id of an element, or of what holds elements; empty: it is neither."""
        if entity.id() not in self._ids:
            within = self._relations.within(entity)
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
    file: ifcopenshell.file, name: str, groups: Groups, given: Collection[str], units: Units, notes: Notes
) -> tuple[dict[str, Task], tuple[Sequence, ...]]:
    """Read tasks and sequences; `given`: ids of elements that a task builds where it has them as inputs only."""
    every = sorted(file.by_type("IfcTask"), key=lambda task: task.id())
    with Where(name, "the schedule"):
        assigned = _assigned(file, name)
        assigned.beyond = any(_completion(_time_of(task, assigned)) > 1.0 + _ROUNDING for task in every)
    if assigned.beyond:
        notes.add(
            "A part that is done (`Completion`) is above 1, perhaps percent: by their parts no tasks are completed"
        )
    entities = _scheduled(every, assigned, notes)
    task_ids: dict[int, str] = {}
    for entity in entities:
        with Where(name, entity):
            task_ids[entity.id()] = unique_id(entity, task_ids.values(), notes)
    tasks = {}
    for entity in entities:
        with Where(name, entity):
            tasks[task_ids[entity.id()]] = _task(entity, task_ids, assigned, groups, set(given), units, notes)
    sequences = []
    for relation in file.by_type("IfcRelSequence") if tasks else ():
        with Where(name, relation):
            ends = [_end(each, assigned, task_ids, tasks, notes) for each in _ends(relation)]
            sequence = _sequence(relation, ends, units.given.get("TIMEUNIT"), tasks, notes)
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


def _assigned(file: ifcopenshell.file, name: str) -> _Assigned:
    found = _Assigned()

    def pairs(attribute: str, *kinds: str) -> Iterator[tuple[ifcopenshell.entity_instance, ...]]:
        """Yield what relations of some kinds have in an attribute, each that they relate with it, and the relation."""
        for relation in (each for kind in kinds for each in file.by_type(kind)):
            with Where(name, relation):
                found = [(getattr(relation, attribute), each, relation) for each in relation.RelatedObjects]
            yield from found

    # IFC wants nesting; some authors aggregate
    for whole, part, _ in pairs("RelatingObject", "IfcRelNests", "IfcRelAggregates"):
        if whole.is_a("IfcTask"):
            found.parents.setdefault(part.id(), whole)
    for product, task, _ in pairs("RelatingProduct", "IfcRelAssignsToProduct"):
        if task.is_a("IfcTask"):
            found.products[task.id()].append(product)
    for task, each, _ in pairs("RelatingProcess", "IfcRelAssignsToProcess"):
        if each.is_a("IfcResource"):
            _work(found, task, each)
        else:
            found.inputs[task.id()].append(each)
    for resource, task, _ in pairs("RelatingResource", "IfcRelAssignsToResource"):
        if task.is_a("IfcTask"):
            _work(found, task, resource)
    # the subtype IfcRelAssignsTasks of IFC2x3 carries the times
    for control, task, relation in pairs("RelatingControl", "IfcRelAssignsToControl"):
        if task.is_a("IfcTask"):
            if control.is_a("IfcWorkControl"):
                found.schedules.setdefault(task.id(), control)
            if getattr(relation, "TimeForTask", None) is not None:
                found.times[task.id()] = relation.TimeForTask
    return found


def _completion(time: ifcopenshell.entity_instance | None) -> float:
    """Return what part of a task the file says is done; 0 where it says nothing."""
    part = getattr(time, "Completion", None)
    return float(part) if isinstance(part, (int, float)) else 0.0


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
            schedules[key] = (schedule.Name or "", _schedule_kind(schedule))
        by_schedule[key].append(entity)
    kept = [key for key, (_, kind) in schedules.items() if kind not in _OTHER_SCHEDULES] or list(schedules)
    for key in schedules.keys() - set(kept):
        name, kind = schedules[key]
        notes.add(f"Schedules of the kind {kind}, left out with their tasks and orders because there is another", name)
    if len(kept) > 1:
        names = ", ".join(schedules[key][0] for key in kept)
        notes.add(f"{len(kept)} schedules, whose tasks are all read: {names}")
    wanted = {entity.id() for key in kept for entity in by_schedule[key]}
    return [entity for entity in entities if entity.id() in wanted]


def _schedule_kind(schedule: ifcopenshell.entity_instance | None) -> str:
    # the second is IFC2x3's
    return getattr(schedule, "PredefinedType", None) or getattr(schedule, "WorkControlType", None) or ""


def _task(
    entity: ifcopenshell.entity_instance, task_ids: dict[int, str], assigned: _Assigned, groups: Groups, given: set[str],
    units: Units, notes: Notes,
) -> Task:  # fmt: skip
    task_id = task_ids[entity.id()]
    note = partial(notes.add, about=entity.Name or task_id, at=task_id)
    products = _elements(assigned.products[entity.id()], groups, note)
    inputs = _elements(assigned.inputs[entity.id()], groups, note)
    cancelled = any(_status_word(each) in _CANCELLED_WORDS for each in _above(entity, assigned))
    properties = read_properties(entity, task_id, units, notes).get(PROPERTY_SET, {})
    by_recipe = properties.get(RECIPE) is not None
    kind = "other" if cancelled else _kind(entity, assigned, by_recipe, note)
    if cancelled:
        note("Tasks that the file says are cancelled: not done, nothing waits for them but what comes before")
    if kind == "makes" and not products:
        made = inputs if by_recipe else [each for each in inputs if each in given or each in groups.elements]
        if made and not by_recipe:
            note("Tasks whose workpieces are assigned as inputs only (IfcRelAssignsToProcess); taken as what they make")
        products, inputs = made, [each for each in inputs if each not in made]
    parent = assigned.parents.get(entity.id())
    start, duration = _times(_time_of(entity, assigned), units.given.get("TIMEUNIT"), note)
    return Task(
        id=task_id,
        name=entity.Name or "",
        parent="" if parent is None else task_ids.get(parent.id(), ""),
        products=tuple(products),
        inputs=tuple(inputs),
        robots=tuple(assigned.workers[entity.id()]),
        milestone=bool(entity.IsMilestone),
        start=start,
        duration=duration,
        kind=kind,
        completed=not cancelled and _completed(entity, assigned, note),
        properties=properties,
    )


def _kind(entity: ifcopenshell.entity_instance, assigned: _Assigned, by_recipe: bool, note: _Note) -> str:
    """Return ``makes``, ``takes_down`` or ``other``: of the task, else of its type, else of what it nests in.

    A task that names its recipe (`by_recipe`) is the arm's, whatever else its kind says than that it takes down.
    """
    said = next(filter(None, map(_said_kind, _above(entity, assigned))), "")
    shown = said if said and said == _said_kind(entity) else f"{said} (said of what they nest in)"
    if said in _TAKES_DOWN:
        note(f"Tasks of the kind {shown}: the arm takes nothing down, a person says when it is gone")
        return "takes_down"
    if by_recipe:
        return "makes"
    if said and said not in _MAKES:
        note(f"Tasks of the kind {shown}, which places nothing; kept for the order")
        return "other"
    own = _own_word(entity)
    if own and own.upper() not in _MAKES:
        note(f"Tasks of a kind of their own ({own!r}), taken as placing")
    return "makes"


def _said_kind(entity: ifcopenshell.entity_instance) -> str:
    """Return the kind that a task or its type says, by the schema or in a word of it; empty: it says none."""
    given = _given_kind(entity)
    own = _own_word(entity).upper()
    return str(given) if given not in _OPEN else own if own in (*_MAKES, *_TAKES_DOWN, *_OTHER_KINDS) else ""


def _given_kind(entity: ifcopenshell.entity_instance) -> str | None:
    given = getattr(entity, "PredefinedType", None)
    if given not in (None, "NOTDEFINED"):
        return str(given)
    kind = ifcopenshell.util.element.get_type(entity)
    return getattr(kind, "PredefinedType", None) or given


def _own_word(entity: ifcopenshell.entity_instance) -> str:
    """Return the author's own word for the kind of a task, the only one in IFC2x3; empty: none, or the schema's counts."""
    if _given_kind(entity) not in _OPEN:
        return ""
    kind = ifcopenshell.util.element.get_type(entity)
    return str(entity.ObjectType or getattr(kind, "ProcessType", None) or "").strip()


def _above(entity: ifcopenshell.entity_instance, assigned: _Assigned) -> Iterator[ifcopenshell.entity_instance]:
    """Yield a task and those that it nests in, from inside; a loop, which is refused elsewhere, once."""
    at: ifcopenshell.entity_instance | None = entity
    seen: set[int] = set()
    while at is not None and at.is_a("IfcTask") and at.id() not in seen:
        yield at
        seen.add(at.id())
        at = assigned.parents.get(at.id())


def _status_word(entity: ifcopenshell.entity_instance) -> str:
    """Return the status of a task in upper case, without what stands around its letters; digits, % and ? stay: they are doubts."""
    return "".join(each for each in (entity.Status or "").upper() if each.isalnum() or each in "?%")


def _time_of(entity: ifcopenshell.entity_instance, assigned: _Assigned) -> ifcopenshell.entity_instance | None:
    """Return the times of a task; those of IFC2x3 are a control's."""
    return assigned.times.get(entity.id()) or getattr(entity, "TaskTime", None)


def _says_completed(entity: ifcopenshell.entity_instance, assigned: _Assigned) -> bool:
    """Return whether a task says of itself that it is done: by its status, or by its times."""
    time = _time_of(entity, assigned)
    whole = not assigned.beyond and math.isclose(_completion(time), 1.0, abs_tol=_ROUNDING)
    return _status_word(entity) in _DONE_WORDS or whole or getattr(time, "ActualFinish", None) is not None


def _completed(entity: ifcopenshell.entity_instance, assigned: _Assigned, note: _Note) -> bool:
    """Return whether the file says that a task, or what it nests in, is done; one that is under way is noted."""
    time, status = _time_of(entity, assigned), _status_word(entity)
    done = next((each for each in _above(entity, assigned) if _says_completed(each, assigned)), None)
    if done is not None and done is entity:
        note("Tasks that the file says are completed: not done again, what they made stands")
    elif done is not None:
        because = f"what they nest in ({done.Name or done.GlobalId}) is"
        note(f"Tasks taken as completed because {because}: what they make counts as standing")
    elif status not in _NOT_BEGUN_WORDS or getattr(time, "ActualStart", None) is not None or _completion(time) > 0.0:
        said = f"status {entity.Status!r}" if status else "a start or a part that is done"
        note(f"TASKS THAT MAY HAVE BEGUN ({said}), taken as still to be done; if what they make stands, skip them")
    return done is not None


def _elements(entities: list[ifcopenshell.entity_instance], groups: Groups, note: _Note) -> list[str]:
    found: dict[str, None] = {}
    for entity in entities:
        if own := groups.named(entity):
            found[own] = None
        else:
            note(f"Assigned to a task but no element ({entity.is_a()}); left out")
    return list(found)


def _times(time: ifcopenshell.entity_instance | None, time_unit: float | None, note: _Note) -> tuple[str, float | None]:
    if time is None:
        return "", None
    start = next(filter(None, (_moment(getattr(time, f"{said}Start"), note) for said in _DATES)), "")
    if start and time.ScheduleStart is None:
        note("No scheduled start: the early one is taken, or else the late one")
    given = time.ScheduleDuration
    if isinstance(given, str):
        return start, _seconds(given, note)
    if given and time_unit is None:
        note(_NO_TIME)
    return start, None if given is None else given * (time_unit or 1.0)


def _moment(value: str | ifcopenshell.entity_instance | None, note: _Note) -> str:
    if value is None:
        return ""
    try:
        with Where("", "a time"):
            read = ifcopenshell.util.date.ifc2datetime(value) if isinstance(value, str) else _date_and_time(value)
            text = str(read.isoformat())  # type: ignore[union-attr]
        datetime.fromisoformat(text).timestamp()  # orders compare it: no time of day, no year 0
        return text
    except (BuildingError, ValueError, OverflowError):
        note("A time that is no date is left out")
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


def _seconds(value: str, note: _Note) -> float | None:
    """Return a duration [s]; one that cannot be read is noted."""
    try:
        parsed = isodate.parse_duration(value)
    except (ValueError, TypeError, OverflowError, ArithmeticError):
        note(f"{value[:40]!r} is no duration of ISO 8601, and is left out")
        return None
    if isinstance(parsed, timedelta):
        return parsed.total_seconds()
    note(f"A duration in years or months ({value[:40]!r}) has no length in seconds, and is left out")
    return None


def _ends(relation: ifcopenshell.entity_instance) -> tuple[ifcopenshell.entity_instance, ...]:
    return relation.RelatingProcess, relation.RelatedProcess


def _end(
    process: ifcopenshell.entity_instance,
    assigned: _Assigned,
    task_ids: dict[int, str],
    tasks: dict[str, Task],
    notes: Notes,
) -> str:
    """Return the id of the task that an order names; empty: it is left out with its schedule.

    An event or a procedure passes the order on, as a milestone does; in a task that nests no others it stands for that.
    """
    parent = assigned.parents.get(process.id())
    if process.is_a("IfcTask") or process.id() in task_ids:
        return task_ids.get(process.id(), "")
    above = "" if parent is None else task_ids.get(parent.id(), "")
    if above and not any(task.parent == above for task in tasks.values()):
        return above
    own = task_ids[process.id()] = unique_id(process, task_ids.values(), notes)
    tasks[own] = Task(own, process.Name or "", parent=above, milestone=True, kind="other")
    return own


def _sequence(
    relation: ifcopenshell.entity_instance,
    ends: list[str],
    time_unit: float | None,
    tasks: dict[str, Task],
    notes: Notes,
) -> Sequence | None:
    before, after = ends
    # what is in one task needs no order
    if not before or not after or (before == after and not all(each.is_a("IfcTask") for each in _ends(relation))):
        return None
    process = relation.RelatingProcess
    if not process.is_a("IfcTask"):
        said = (
            f"Comes after what the arm does not see happen ({process.is_a()}): only what is before that is waited for"
        )
        notes.add(said, process.Name or before, after)

    def note(sentence: str) -> None:
        """Add a note on the relation, and a remark at each of the tasks that it is between."""
        notes.add(sentence, label(relation))
        notes.remark(sentence, before)
        notes.remark(sentence, after)

    kind = relation.SequenceType
    if kind not in _KINDS:
        note("Orders without one of the four kinds, taken as finish to start")
        kind = _KINDS[0]
    return Sequence(before, after, kind, _lag(relation.TimeLag, tasks[before], time_unit, note))


def _lag(lag: ifcopenshell.entity_instance | float | None, before: Task, time_unit: float | None, note: _Note) -> float:
    if lag is None:
        return 0.0
    if isinstance(lag, (int, float)):
        seconds: float | None = lag * (time_unit or 1.0)
        if lag and time_unit is None:
            note(_NO_TIME)
    else:
        value = lag.LagValue
        if not value.is_a("IfcRatioMeasure"):
            seconds = _seconds(value.wrappedValue, note)
        elif before.duration is None:
            note("A lag that is a part of a duration that is not known is left out")
            return 0.0
        else:
            note("A lag that is a part of the duration of the task before")
            seconds = value.wrappedValue * before.duration
        if lag.DurationType == "WORKTIME" and seconds:
            note("A lag in working time is waited for around the clock (no calendar is read)")
    return float(seconds) if seconds is not None and math.isfinite(seconds) else 0.0
