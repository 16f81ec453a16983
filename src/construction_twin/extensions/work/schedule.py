"""The order of a building model's tasks: which jobs there are for an arm, what each waits for, and what may start now.

A job is one element that a task without subtasks makes or works on; it is placed before anything works on it. What the end of a job
waits for (``FINISH_FINISH``, ``START_FINISH``), its start waits for here. A removal is one element that people take down. A model
without tasks gets a proposal, which a person must accept: what supports an element comes before it, otherwise from below. Times [s]
are of any one clock.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import Any, TypeVar

import numpy as np

from construction_twin.extensions.work.building import (
    BuildingModel,
    Element,
    ScheduleError,
    Sequence,
    Task,
    first_few,
    parts_of,
    workpieces,
)
from construction_twin.extensions.work.process import DEFAULT, RECIPE, process_of

#: Takes an element and a task; returns the process by which the task works on it.
ProcessOf = Callable[[Element, Task], str]


@dataclass(frozen=True)
class Wait:
    """What a job waits for: another one's end (`finished`) or start, and a `lag` [s]."""

    job: str
    finished: bool
    lag: float


@dataclass(frozen=True)
class Job:
    """One element to be placed, or worked on.

    `id`: the task's GlobalId, of a task that makes several elements with ``/1``, ``/2``, ... behind it. `robots`: empty: any.
    """

    id: str
    task: str
    name: str
    element: str
    robots: tuple[str, ...]
    after: tuple[Wait, ...]
    process: str = DEFAULT

    @property
    def moves(self) -> bool:
        """Whether it takes the element from its stock to its place."""
        return process_of(self.process).moves


@dataclass(eq=False)
class Schedule:
    """A checked graph of jobs, made by `Schedule.of`; in an order in which they can be done, by dates if all have one."""

    jobs: tuple[Job, ...]
    notes: tuple[str, ...]
    proposed: bool = False
    removals: tuple[Job, ...] = ()

    @cached_property
    def placing(self) -> dict[str, str]:
        """The job that places each element."""
        return {job.element: job.id for job in self.jobs if job.moves}

    @cached_property
    def _by_id(self) -> dict[str, Job]:
        return {job.id: job for job in (*self.jobs, *self.removals)}

    @classmethod
    def of(
        cls, model: BuildingModel, proposed: bool = False, process: ProcessOf = lambda element, task: DEFAULT
    ) -> Schedule:
        """Return the schedule of a model."""
        reading = _Reading(model, process)
        everything = reading.jobs()
        moments, note = _moments(everything, model)
        reading.notes += [note] if note and not proposed else []
        # what is to be taken down without a task has no date and comes first
        places = {job.id: (moments.get(job.id, -math.inf), number) for number, job in enumerate(everything)}
        by_id = {job.id: job for job in everything}
        before = {job.id: [wait.job for wait in job.after] for job in everything}
        order = [by_id[name] for name in in_order(before, lambda one: places[one])]
        jobs = tuple(job for job in order if job.id not in reading.removals)
        removals = tuple(job for job in order if job.id in reading.removals)
        return cls(jobs, tuple(reading.notes), proposed or reading.guessed, removals)

    def job(self, identifier: str) -> Job:
        """Return the job of that id."""
        return self._by_id[identifier]

    def waits_for(
        self, identifier: str, started: Mapping[str, float], finished: Mapping[str, float], now: float
    ) -> str:
        """Return the first thing that a job still waits for: ``after 2xF... has finished``; empty: it may start."""
        for wait in self.job(identifier).after:
            since = finished.get(wait.job) if wait.finished else started.get(wait.job, finished.get(wait.job))
            if since is not None and since + wait.lag <= now:
                continue
            after = f"after {wait.job} has {'finished' if wait.finished else 'started'}"
            return after if since is None else f"{since + wait.lag - now:.0f} s from now, its lag {after}"
        return ""


#: What something waits for: lag by job and whether that must be finished.
_Waits = dict[tuple[str, bool], float]


class _Reading:
    """Tasks and sequences of one model, checked; `guessed`: a part of the order is proposed from the geometry."""

    def __init__(self, model: BuildingModel, process: ProcessOf):
        if not model.tasks:
            raise ScheduleError(f"{model.file}: it has no tasks; have an order proposed and accept it")
        self._model, self._tasks, self._elements, self._process_of = model, model.tasks, model.elements, process
        self.notes: list[str] = []
        self.removals: set[str] = set()
        self.guessed = False
        self._standing: set[str] = set()
        self._children: dict[str, list[str]] = {identifier: [] for identifier in model.tasks}
        for identifier, task in model.tasks.items():
            if task.parent:
                self._children[task.parent].append(identifier)
        try:
            TopologicalSorter(self._children).prepare()
        except CycleError as error:
            circle = ", ".join(dict.fromkeys(reversed(error.args[1])))
            raise ScheduleError(f"tasks nest in each other in a circle: {circle}") from error
        self._sequences = self._checked_sequences()
        self._products = self._checked_products()

    def jobs(self) -> tuple[Job, ...]:
        """Return jobs and removals in the file's order."""
        waits = self._all_waits()
        jobs: list[Job] = []
        for identifier, products in self._products.items():
            task, after, down = self._tasks[identifier], waits[identifier], self._is_removal(identifier)
            robots = next(filter(None, (self._tasks[at].robots for at in self._above(identifier))), ())
            for number, product in enumerate(products, 1):
                own = self._job_id(identifier, number)
                found = tuple(Wait(job, finished, lag) for (job, finished), lag in after.items())
                process = DEFAULT if down else self._process_of(self._elements[product], task)
                jobs.append(Job(own, identifier, task.name, product, () if down else robots, found, process))
                after = {(own, True): 0.0}
                self.removals |= {own} if down else set()
        jobs = self._with_distinct_names(jobs)
        taken_down = {job.element for job in jobs if job.id in self.removals}
        for element in self._elements.values():
            if element.status == "demolish" and element.bodies and element.id not in taken_down:
                own = f"{element.id}/removal"
                self.removals.add(own)
                jobs.append(Job(own, own, f"Take down {element.name or element.id}", element.id, (), ()))
        for job in jobs:
            if job.id in self.removals:
                remark = f"{job.element} is to be taken down ({job.name}): an obstacle until a person says that it is"
                self.notes.append(f"{remark} gone (`twin work removed {job.id}`).")
        made = {job.element for job in jobs} | self._standing
        if left := [one for one in workpieces(self._model) if one not in made]:
            remark = f"No task makes {len(left)} of the elements: {first_few(left)}"
            self.notes.append(f"{remark}; the arm leaves them alone.")
        return tuple(jobs)

    def _with_distinct_names(self, jobs: list[Job]) -> list[Job]:
        shared = Counter(job.name for job in jobs)
        found = []
        for job in jobs:
            element = self._elements[job.element].name
            more = shared[job.name] > 1 and job.name and element and element not in job.name
            found.append(replace(job, name=f"{job.name}: {element}") if more else job)
        return found

    def _is_removal(self, identifier: str) -> bool:
        """Return whether a task takes down: by its kind, or because all of its products are to be taken down."""
        task = self._tasks[identifier]
        known = [self._elements[one] for one in task.products if one in self._elements]
        demolish = bool(known) and all(element.status == "demolish" for element in known)
        works = task.properties.get(RECIPE) is not None
        return task.kind == "takes_down" or (task.kind == "makes" and demolish and not works)

    def _moves(self, identifier: str, element: str) -> bool:
        """Return whether a task places an element."""
        return process_of(self._process_of(self._elements[element], self._tasks[identifier])).moves

    def _is_completed(self, identifier: str) -> bool:
        return any(self._tasks[at].completed for at in self._above(identifier))

    def _job_id(self, task: str, number: int) -> str:
        return task if len(self._products[task]) == 1 else f"{task}/{number}"

    def _above(self, identifier: str) -> Iterator[str]:
        while identifier:
            yield identifier
            identifier = self._tasks[identifier].parent

    def _with_parts(self, ids: Iterable[str]) -> dict[str, None]:
        return dict.fromkeys(part for one in ids for part in (one, *parts_of(self._elements, one)))

    def _checked_sequences(self) -> dict[str, list[Sequence]]:
        into: dict[str, list[Sequence]] = {identifier: [] for identifier in self._tasks}
        for sequence in self._model.sequences:
            ids = (sequence.before, sequence.after)
            called = f"sequence from {ids[0]} to {ids[1]}"
            if sequence.before in self._above(sequence.after) or sequence.after in self._above(sequence.before):
                if sequence.kind not in ("START_START", "FINISH_FINISH") or ids[0] == ids[1]:
                    why = "they are the same, or one nests in the other"
                    raise ScheduleError(f"the {called} makes a task wait for itself: {why}")
                self.notes.append(f"The {called} is left out: one of them nests in the other.")
                continue
            if sequence.lag < 0.0:
                said = f"The lead from {ids[0]} to {ids[1]} is not used"
                self.notes.append(f"{said}: the arm waits as if its lag were 0.")
            into[sequence.after].append(sequence)
        return into

    def _checked_products(self) -> dict[str, tuple[str, ...]]:
        """Return the elements that each task without subtasks makes or takes down."""
        found: dict[str, tuple[str, ...]] = {}
        maker: dict[str, str] = {}
        works: list[tuple[str, str]] = []
        idle: list[str] = []
        for identifier, task in self._tasks.items():
            given = (*task.products, *(task.inputs if task.kind == "takes_down" else ()))
            known = tuple(dict.fromkeys(one for one in given if one in self._elements))
            if self._children[identifier]:
                if known:
                    sentence = f"What task {identifier} makes is taken from the tasks that nest in it"
                    self.notes.append(f"{sentence}: {first_few(known)}.")
                continue
            if unknown := [one for one in task.products if one not in self._elements]:
                sentence = f"Task {identifier} makes {first_few(unknown)}, which the arm cannot place"
                self.notes.append(f"{sentence}: no such element was read.")
            known = self._to_do(identifier, known)
            if not known:
                if not task.milestone and task.kind == "makes" and not self._is_completed(identifier):
                    idle.append(identifier)
                continue
            for element in () if self._is_removal(identifier) else known:
                if not self._moves(identifier, element):
                    works.append((identifier, element))
                    continue
                if element in maker:
                    twice = f"element {element} ({self._elements[element].name!r}) is made twice"
                    raise ScheduleError(f"{twice}, by tasks {maker[element]} and {identifier}; it can be placed once")
                maker[element] = identifier
            found[identifier] = known
        for identifier, element in works:
            # it stands before anybody works on it, whether or not the file says so
            if element in maker:
                self._sequences[identifier].append(Sequence(maker[element], identifier))
        if idle:
            sentence = f"{len(idle)} {'tasks' if len(idle) > 1 else 'task'} without element: {first_few(idle)}"
            self.notes.append(f"{sentence}; kept for the order, no time is waited for.")
        return self._without_temporary(found, maker)

    def _to_do(self, identifier: str, known: tuple[str, ...]) -> tuple[str, ...]:
        """Return what is left for a task to do: what stands is not placed again."""
        elements = self._elements
        if self._is_removal(identifier):
            # what the file calls completed still stands here until a person says that it does not
            return tuple(one for one in self._with_parts(known) if elements[one].bodies)
        if self._tasks[identifier].kind != "makes":
            return ()
        if self._is_completed(identifier):
            self._standing |= self._with_parts(known).keys()
            return ()
        works = [one for one in known if elements[one].bodies and not self._moves(identifier, one)]
        there = [one for one in known if elements[one].status and one not in works]
        if there:
            self._standing |= set(there)
            said = f"Task {identifier} makes {first_few(there)}, which the model has as existing or to be taken down"
            self.notes.append(f"{said}: not placed.")
        found: list[str] = []
        for one in known:
            if one not in there:
                whole = one in works or elements[one].bodies or not parts_of(elements, one)
                found += [one] if whole else self._of_assembly(identifier, one)
        return tuple(dict.fromkeys(found))

    def _of_assembly(self, identifier: str, element: str) -> list[str]:
        """Return the workpieces in what has no body, but for those of other tasks, in a proposed order."""
        model, parts = self._model, set(parts_of(self._elements, element))
        # also the parts of an assembly within this one that has a task of its own, done or not
        elsewhere: set[str] = set()
        earlier = True
        for name, task in self._tasks.items():
            earlier = earlier and name != identifier
            for one in task.products if name != identifier and task.kind == "makes" else ():
                if one not in model.elements or not self._moves(name, one):
                    continue
                theirs = set(parts_of(self._elements, one))
                # of groups with something in common the smaller one has it, else the first
                if one in parts or (theirs & parts and (theirs < parts or (earlier and not theirs > parts))):
                    elsewhere |= {one, *theirs}
        wanted = [one for one in workpieces(model) if one in parts - elsewhere]
        sentence = "nothing that is in it is left for this task"
        if wanted:
            alone = replace(model, elements={one: model.elements[one] for one in wanted}, tasks={}, sequences=())
            wanted = [one for part in propose(alone).tasks.values() for one in part.products]
            self.guessed = self.guessed or len(wanted) > 1
            order = "one after the other, in an order from the geometry that a person must accept"
            sentence = f"what is in it is placed {order}: {first_few(wanted)}"
        assembly = f"Task {identifier} makes {model.elements[element].name or element}, which has no body of its own"
        self.notes.append(f"{assembly}: {sentence}.")
        return wanted

    def _without_temporary(
        self, found: dict[str, tuple[str, ...]], maker: Mapping[str, str]
    ) -> dict[str, tuple[str, ...]]:
        """Return what tasks do, without removals of what another one places first: it does not stand yet."""
        removed: set[str] = set()
        left = {}
        for identifier, elements in found.items():
            if self._is_removal(identifier):
                if placed := [element for element in elements if element in maker]:
                    said = f"Task {identifier} takes down {first_few(placed)}, which another task places: not read"
                    self.notes.append(f"{said}, it stays; what comes after does not wait for it to be gone.")
                elements = tuple(element for element in elements if element not in {*placed, *removed})
                removed |= {*elements}
            if elements:
                left[identifier] = elements
        return left

    def _all_waits(self) -> dict[str, _Waits]:
        """Return the jobs that the start of each task waits for.

        Two nodes per task: its start may come (0), and it is done (1).
        """
        before: dict[tuple[str, int], list[tuple[str, int]]] = {}
        for identifier, task in self._tasks.items():
            start = [(sequence.before, 1) for sequence in self._sequences[identifier]]
            before[identifier, 0] = start + ([(task.parent, 0)] if task.parent else [])
            before[identifier, 1] = [(child, 1) for child in self._children[identifier]] or [(identifier, 0)]
        try:
            order = list(TopologicalSorter(before).static_order())
        except CycleError as error:
            circle = dict.fromkeys(identifier for identifier, _ in error.args[1])
            names = ", ".join(f"{identifier} ({self._tasks[identifier].name!r})" for identifier in circle)
            raise ScheduleError(f"tasks wait for each other in a circle: {names}") from error
        started: dict[str, _Waits] = {}
        finished: dict[str, _Waits] = {}
        gates: dict[str, _Waits] = {"": {}}
        for identifier, node in order:
            if node == 0:
                gates[identifier] = dict(gates[self._tasks[identifier].parent])
                for sequence in self._sequences[identifier]:
                    source = started if sequence.kind.startswith("START") else finished
                    _merge(gates[identifier], source[sequence.before], max(sequence.lag, 0.0))
            elif identifier in self._products:
                last = self._job_id(identifier, len(self._products[identifier]))
                started[identifier], finished[identifier] = {(last, False): 0.0}, {(last, True): 0.0}
            elif self._children[identifier]:
                started[identifier], finished[identifier] = {}, {}
                for child in self._children[identifier]:
                    _merge(started[identifier], started[child])
                    _merge(finished[identifier], finished[child])
            else:
                started[identifier] = finished[identifier] = gates[identifier]
        return gates


def _merge(waits: _Waits, more: _Waits, lag: float = 0.0) -> None:
    for wait, own in more.items():
        waits[wait] = max(own + lag, waits.get(wait, 0.0))


def _moments(jobs: tuple[Job, ...], model: BuildingModel) -> tuple[dict[str, float], str]:
    """Return the dates of jobs, and a note; none where one is missing or they cannot be compared."""
    start_of = {job.id: model.tasks[job.task].start for job in jobs if job.task in model.tasks}
    dates = {one: datetime.fromisoformat(start) for one, start in start_of.items() if start}
    if dates and (missing := len(start_of) - len(dates)):
        return {}, f"Dates are not used for the order, because {missing} of {len(start_of)} jobs have none."
    if len({date.tzinfo is None for date in dates.values()}) > 1:
        return {}, "Dates are not used for the order, because some have a time zone and others none."
    if not dates and not model.sequences and len({job.task for job in jobs if job.id in start_of}) > 1:
        return {}, "The file says no order of its tasks, neither sequences nor dates: they come as they stand in it."
    return {one: date.timestamp() for one, date in dates.items()}, ""


T = TypeVar("T")
#: How far apart, or inside of each other, two faces may be that touch as built [m].
GAP = 0.006
#: A face whose normal is closer to the horizontal than this sine supports nothing.
_STEEP = 0.1
#: Vertical lines per direction on which the faces of two elements are compared.
_LINES = 15


def propose(model: BuildingModel) -> BuildingModel:
    """Return the model with a task for each element, in an order in which they can be built, in one that nests them all."""
    solids = [_Solid(model.elements[identifier]) for identifier in workpieces(model)]
    if not solids:
        raise ScheduleError(f"{model.file}: it has no workpiece with geometry; an order cannot be proposed")
    before: dict[int, set[int]] = {number: set() for number in range(len(solids))}
    for i, j in _near(solids):
        for lower, upper in ((i, j), (j, i)):
            if _rests_on(solids[upper], solids[lower]):
                before[upper].add(lower)
    try:
        order = in_order(before, lambda number: solids[number].key)
    except CycleError as error:
        circle = first_few(solids[number].element.id for number in error.args[1][1:])
        raise ScheduleError(f"{circle} rest on each other in a circle; an order cannot be proposed") from error
    root = Task("proposed", "Proposed order")
    tasks = {}
    for number in order:
        element = solids[number].element
        name = f"Place {element.name or element.id}"
        tasks[number] = Task(f"{element.id}/task", name, parent=root.id, products=(element.id,))
    sequences = [
        Sequence(tasks[first].id, tasks[second].id)
        for second in order
        for first in sorted(before[second], key=order.index)
    ]
    return replace(model, tasks={task.id: task for task in (root, *tasks.values())}, sequences=tuple(sequences))


class _Solid:
    def __init__(self, element: Element):
        self.element = element
        pose, (self.low, self.high) = element.model_T_element, element.box
        corners = [body.vertices[body.triangles] for body in element.bodies]
        triangles = np.concatenate(corners) @ pose.rotation.T + pose.position
        first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
        normals = np.cross(first, second)
        size = np.linalg.norm(normals, axis=1)
        slope = np.divide(normals[:, 2], size, out=np.zeros(len(size)), where=size > 0.0)
        self.up, self.down = triangles[slope > _STEEP], triangles[slope < -_STEEP]
        # lower end in steps of the gap, then the middle's height
        self.key = (round(float(self.low[2]) / GAP), round(float(self.low[2] + self.high[2]) / GAP))


def _near(solids: list[_Solid]) -> list[tuple[int, int]]:
    """Return pairs of elements whose boxes are closer than the gap."""
    lows, highs = np.array([one.low for one in solids]), np.array([one.high for one in solids])
    close = (((lows[:i] <= one.high + GAP) & (highs[:i] >= one.low - GAP)).all(axis=1) for i, one in enumerate(solids))
    return [(i, int(j)) for i, near in enumerate(close) for j in np.flatnonzero(near)]


def _rests_on(upper: _Solid, lower: _Solid) -> bool:
    low = np.maximum(upper.low, lower.low)[:2]
    high = np.minimum(upper.high, lower.high)[:2]
    if np.any(high <= low):
        return False
    # lines through the middle of cells, so that none runs along a common edge
    cells = (np.arange(_LINES) + 0.5 + 1e-3 * np.sqrt(2.0)) / _LINES
    x, y = np.meshgrid(low[0] + cells * (high[0] - low[0]), low[1] + cells * (high[1] - low[1]))
    points = np.column_stack((x.ravel(), y.ravel()))
    band = (max(upper.low[2], lower.low[2]) - GAP, min(upper.high[2], lower.high[2]) + GAP)
    tops, bottoms = _heights(lower.up, points, band), _heights(upper.down, points, band)
    # nan, where a line misses a face, is no contact
    return any(bool(np.any(np.abs(bottom - top) <= GAP)) for top in tops for bottom in bottoms)


def _heights(triangles: np.ndarray, points: np.ndarray, band: tuple[float, float]) -> list[np.ndarray]:
    """Return where vertical lines meet each face that reaches into a band of heights; nan: they do not."""
    z = triangles[:, :, 2]
    found = []
    for a, b, c in triangles[(z.max(axis=1) >= band[0]) & (z.min(axis=1) <= band[1])]:
        ab, ac, ap = b[:2] - a[:2], c[:2] - a[:2], points - a[:2]
        area = ab[0] * ac[1] - ab[1] * ac[0]
        if area == 0.0:
            continue
        u = (ap[:, 0] * ac[1] - ap[:, 1] * ac[0]) / area
        v = (ab[0] * ap[:, 1] - ab[1] * ap[:, 0]) / area
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        if inside.any():
            found.append(np.where(inside, a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]), np.nan))
    return found


def in_order(before: Mapping[T, Collection[T]], key: Callable[[T], Any]) -> list[T]:
    """Return things so that each comes after those before it, otherwise by a key."""
    sorter = TopologicalSorter(before)
    sorter.prepare()
    heap: list[tuple[Any, T]] = []
    order = []
    while sorter.is_active():
        for one in sorter.get_ready():
            heapq.heappush(heap, (key(one), one))
        order.append(heapq.heappop(heap)[1])
        sorter.done(order[-1])
    return order
