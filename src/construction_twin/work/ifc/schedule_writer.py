"""Writes a schedule into an IFC file: tasks, their nesting, order, products, times and robots.

IFC4 and later: IfcTaskTime and IfcLagTime. IFC2x3 has neither: IfcScheduleTimeControl by IfcRelAssignsTasks, and lags as numbers in
the project's time unit. Seconds and ISO 8601 in the records. The GlobalIds of what is written besides the tasks follow from theirs,
so that the same schedule gives the same file. Never writes over the file it was given.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path

import ifcopenshell
import ifcopenshell.util.unit

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import Sequence, Task
from construction_twin.work.global_ids import global_id


def write_schedule(
    source: str | Path,
    target: str | Path,
    name: str,
    tasks: Iterable[Task],
    sequences: Iterable[Sequence],
    created: datetime,
    description: str = "",
) -> None:
    """Write a copy of an IFC file that has one schedule more.

    Args:
        source, target: Must not be the same file; `target` must not exist.
        name: Of the IfcWorkSchedule; must be new in the file.
        tasks: Parents before or after what they nest; products by GlobalId, which must be in the file.
        description: Of the IfcWorkSchedule.

    Raises:
        ConfigurationError: If `target` exists.
        BuildingError: If the file cannot be read, has a task or a schedule of that name already, or lacks a product.
    """
    source, target = Path(source), Path(target)
    if target.exists():
        raise ConfigurationError("schedule", str(target), Sentence("ifc.new_file"))
    try:
        file = ifcopenshell.open(str(source))
    except (OSError, RuntimeError, ifcopenshell.Error) as error:
        raise BuildingError(str(source), Sentence("ifc.file"), str(error), Sentence("ifc.readable")) from error
    add_schedule(file, name, tuple(tasks), tuple(sequences), created, description, str(source))
    file.write(str(target))


def add_schedule(
    file: ifcopenshell.file,
    name: str,
    tasks: tuple[Task, ...],
    sequences: tuple[Sequence, ...],
    created: datetime,
    description: str = "",
    path: str = "",
) -> None:
    """Add a schedule to an open file. See `write_schedule`, whose parameters and errors are the same.

    Args:
        path: Name of the file in errors.
    """
    writer = _Writer(file, path, created)
    writer.check(name, tasks)
    schedule = writer.schedule(name, description)
    entities = {task.id: writer.task(task, name) for task in tasks}
    children: dict[str, list[str]] = {}
    for task in tasks:
        children.setdefault(task.parent, []).append(task.id)
    writer.assign_to_schedule(schedule, tasks, entities)
    for parent, nested in children.items():
        if parent:
            writer.relate("IfcRelNests", parent, RelatingObject=entities[parent], RelatedObjects=_of(entities, nested))
    for task in tasks:
        writer.assign_products(task, entities[task.id])
    writer.assign_robots(tasks, entities)
    for sequence in sequences:
        writer.sequence(sequence, entities)


def _of(entities: Mapping[str, ifcopenshell.entity_instance], ids: Iterable[str]) -> list[ifcopenshell.entity_instance]:
    return [entities[one] for one in ids]


class _Writer:
    """Entities of one file, in its schema."""

    def __init__(self, file: ifcopenshell.file, path: str, created: datetime):
        self._file, self._path, self._created = file, path, created
        self._old = file.schema == "IFC2X3"
        self._history = self._owner_history() if self._old else None

    def check(self, name: str, tasks: tuple[Task, ...]) -> None:
        """Refuse what the file has already, and what it has not."""
        if any(schedule.Name == name for schedule in self._file.by_type("IfcWorkSchedule")):
            raise BuildingError(
                self._path,
                Sentence("ifc.schedule", name=repr(name)),
                Sentence("ifc.found.schedule_there"),
                Sentence("ifc.new_name"),
            )
        ids = {task.id for task in tasks}
        for task in tasks:
            if self._by_id(task.id) is not None:
                raise BuildingError(
                    self._path,
                    Sentence("building.task", id=repr(task.id)),
                    Sentence("ifc.found.id_there"),
                    Sentence("ifc.new_id"),
                )
            if task.parent and task.parent not in ids:
                raise BuildingError(
                    self._path,
                    Sentence("building.task", id=repr(task.id)),
                    Sentence("ifc.found.no_parent", id=repr(task.parent)),
                    Sentence("ifc.among"),
                )
            for product in (*task.products, *task.inputs):
                if self._by_id(product) is None:
                    raise BuildingError(
                        self._path,
                        Sentence("building.task", id=repr(task.id)),
                        Sentence("ifc.found.no_product", id=repr(product)),
                        Sentence("ifc.in_file"),
                    )

    def schedule(self, name: str, description: str) -> ifcopenshell.entity_instance:
        """Add the IfcWorkSchedule."""
        moment = self._moment(self._created.isoformat(timespec="seconds"))
        fields = {"CreationDate": moment, "StartTime": moment, "Description": description or None}
        if self._old:
            return self._root("IfcWorkSchedule", ("schedule", name), Name=name, Identifier=name, **fields)
        schedule = self._root("IfcWorkSchedule", ("schedule", name), Name=name, PredefinedType="PLANNED", **fields)
        for project in self._file.by_type("IfcProject")[:1]:
            self.relate("IfcRelDeclares", name, RelatingContext=project, RelatedDefinitions=[schedule])
        return schedule

    def task(self, task: Task, schedule: str) -> ifcopenshell.entity_instance:
        """Add an IfcTask under the GlobalId it has."""
        fields = {"Name": task.name, "Description": task.description or None, "IsMilestone": task.milestone}
        if self._old:
            return self._file.create_entity(
                "IfcTask", GlobalId=task.id, OwnerHistory=self._history, TaskId=task.id, **fields
            )
        entity = self._file.create_entity("IfcTask", GlobalId=task.id, PredefinedType="CONSTRUCTION", **fields)
        if task.start or task.finish or task.duration is not None:
            entity.TaskTime = self._file.create_entity(
                "IfcTaskTime",
                ScheduleStart=task.start or None,
                ScheduleFinish=task.finish or None,
                ScheduleDuration=None if task.duration is None else _duration(task.duration),
                DurationType=None if task.duration is None else "ELAPSEDTIME",
            )
        return entity

    def assign_to_schedule(
        self,
        schedule: ifcopenshell.entity_instance,
        tasks: tuple[Task, ...],
        entities: Mapping[str, ifcopenshell.entity_instance],
    ) -> None:
        """Put the outermost tasks under the schedule; in IFC2x3 all of them, each with its times."""
        if not self._old:
            roots = _of(entities, (task.id for task in tasks if not task.parent))
            self.relate("IfcRelAssignsToControl", schedule.Name, RelatedObjects=roots, RelatingControl=schedule)
            return
        for task in tasks:
            time = self._root(
                "IfcScheduleTimeControl",
                ("time", task.id),
                ScheduleStart=self._moment(task.start) if task.start else None,
                ScheduleFinish=self._moment(task.finish) if task.finish else None,
                ScheduleDuration=None if task.duration is None else task.duration / self._time_unit(),
            )
            self.relate(
                "IfcRelAssignsTasks",
                task.id,
                RelatedObjects=[entities[task.id]],
                RelatingControl=schedule,
                TimeForTask=time,
            )

    def assign_products(self, task: Task, entity: ifcopenshell.entity_instance) -> None:
        """Add what the task makes and what it works on."""
        for product in task.products:
            self.relate(
                "IfcRelAssignsToProduct",
                task.id + product,
                RelatedObjects=[entity],
                RelatingProduct=self._file.by_guid(product),
            )
        if task.inputs:
            inputs = [self._file.by_guid(one) for one in task.inputs]
            self.relate("IfcRelAssignsToProcess", "in" + task.id, RelatedObjects=inputs, RelatingProcess=entity)

    def assign_robots(self, tasks: tuple[Task, ...], entities: Mapping[str, ifcopenshell.entity_instance]) -> None:
        """Assign a resource for each robot, of the file where it has one of that name."""
        kind = "IfcConstructionEquipmentResource"
        robots = {resource.Name: resource for resource in self._file.by_type(kind)}
        for task in tasks:
            for robot in task.robots:
                if robot not in robots:
                    robots[robot] = self._root(kind, ("robot", robot), Name=robot)
            if task.robots:
                resources = _of(robots, task.robots)
                self.relate(
                    "IfcRelAssignsToProcess",
                    "robots" + task.id,
                    RelatedObjects=resources,
                    RelatingProcess=entities[task.id],
                )

    def sequence(self, sequence: Sequence, entities: Mapping[str, ifcopenshell.entity_instance]) -> None:
        """Add an IfcRelSequence."""
        lag: object = sequence.lag / self._time_unit() if self._old else None
        if not self._old and sequence.lag:
            value = self._file.create_entity("IfcDuration", _duration(sequence.lag))
            lag = self._file.create_entity("IfcLagTime", LagValue=value, DurationType="ELAPSEDTIME")
        self.relate(
            "IfcRelSequence",
            sequence.before + sequence.after + sequence.kind,
            RelatingProcess=entities[sequence.before],
            RelatedProcess=entities[sequence.after],
            TimeLag=lag,
            SequenceType=sequence.kind,
        )

    def relate(self, kind: str, word: str, **fields: object) -> ifcopenshell.entity_instance:
        """Add a relation; its GlobalId follows from `kind` and `word`."""
        return self._root(kind, (kind, word), **fields)

    def _root(self, kind: str, words: tuple[str, ...], **fields: object) -> ifcopenshell.entity_instance:
        """Add an entity that has a GlobalId and, in IFC2x3, an owner history."""
        return self._file.create_entity(kind, GlobalId=global_id(*words), OwnerHistory=self._history, **fields)

    def _by_id(self, identifier: str) -> ifcopenshell.entity_instance | None:
        try:
            return self._file.by_guid(identifier)
        except RuntimeError:
            return None

    def _time_unit(self) -> float:
        return float(ifcopenshell.util.unit.calculate_unit_scale(self._file, "TIMEUNIT"))

    def _moment(self, text: str) -> object:
        """Return a date and time as the schema has it: text, or in IFC2x3 entities."""
        if not self._old:
            return text
        moment = datetime.fromisoformat(text)
        date = self._file.create_entity(
            "IfcCalendarDate", DayComponent=moment.day, MonthComponent=moment.month, YearComponent=moment.year
        )
        time = self._file.create_entity(
            "IfcLocalTime",
            HourComponent=moment.hour,
            MinuteComponent=moment.minute,
            SecondComponent=moment.second + moment.microsecond / 1e6,
        )
        return self._file.create_entity("IfcDateAndTime", date, time)

    def _owner_history(self) -> ifcopenshell.entity_instance:
        """Return the file's owner history, which IFC2x3 wants everywhere, or a new one."""
        for history in self._file.by_type("IfcOwnerHistory"):
            return history
        person = self._file.create_entity("IfcPerson", FamilyName="construction_twin")
        organization = self._file.create_entity("IfcOrganization", Name="construction_twin")
        return self._file.create_entity(
            "IfcOwnerHistory",
            OwningUser=self._file.create_entity("IfcPersonAndOrganization", person, organization),
            OwningApplication=self._file.create_entity(
                "IfcApplication", organization, "0", "construction_twin", "construction_twin"
            ),
            ChangeAction="ADDED",
            CreationDate=int(self._created.timestamp()),
        )


def _duration(seconds: float) -> str:
    """Return seconds as an ISO 8601 duration."""
    return f"{'-' if seconds < 0 else ''}PT{abs(seconds):g}S"
