"""What is to be done of a building model: the ledger read against schedule, stock and model. Answers and refuses; plans nothing.

Pure but for the ledger's file. Times in ns since 1970, poses in the robot's base_link [m].
"""

from __future__ import annotations

import functools
import math
import shlex
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from construction_twin.core.reports import TaskReport, WorkReport
from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.built import (
    Deviation,
    at,
    deviation,
    objects_of,
    placed_at,
    pose_of_tuple,
    pose_tuple,
)
from construction_twin.extensions.work.convex_bodies import Pieces
from construction_twin.extensions.work.errors import WorkError
from construction_twin.extensions.work.ledger import Book, Ledger, placed_elsewhere, replay
from construction_twin.extensions.work.names import labels, named
from construction_twin.extensions.work.prepared import ElementFacts, Prepared, Scheduled, element_in
from construction_twin.extensions.work.schedule import Job
from construction_twin.extensions.work.task_memory import (
    ACCEPTED,
    ANSWERS_FOR_ALL,
    ANSWERS_OF_FORMER,
    NOT_IN_MODEL,
    PLANNABLE,
    PLANNED,
    SAME,
    SETTLED,
    UNDER_WAY,
    Entry,
    TaskEvent,
    TaskMemory,
    TaskState,
)  # fmt: skip
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.objects import SceneObject

#: Words for where the schedule comes from, as `WorkTasks.msg` has them.
FROM_MODEL, FROM_PERSON, PROPOSED = "model", "accepted", "proposed"


class WorkRefused(WorkError):
    """What was asked for cannot be done now; the sentence says why and what to do."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """An element as people see it.

    Attributes:
        word: ``todo``, ``next``, ``stock``, ``carried``, ``placed``, ``off`` or ``skipped``, as in `ros.messages.work_markers`.
        pose: In the base_link, or in the tip link where it is carried.
    """

    element: str
    name: str
    word: str
    pose: Pose


def removed_command(task: str) -> str:
    """Return the command by which a person says that what a removal takes down, or what was placed, is gone; sentences name it."""
    return f"`twin work removed {shlex.quote(task)}`"


class TaskBoard:
    """Answers what can be done, and takes what people say. Not for several threads at once.

    `failures`: Why a task could not be planned when it was tried last, by id; not on the disk.
    """

    def __init__(self, prepared: Prepared, ledger: Ledger, robot: str, tip_link: str):
        self.prepared, self.ledger = prepared, ledger
        self._robot, self._tip_link = robot, tip_link
        self.failures: dict[str, str] = {}
        self._kept: dict[tuple[str, str], tuple[SceneObject, ...]] = {}
        for memory in self.book.tasks.values():
            if memory.placed and memory.body:
                # what stands and cannot be shown is told at once
                self._bodies(memory)

    @property
    def book(self) -> Book:
        """What the ledger says now."""
        return self.ledger.book

    def add(self, entry: Entry) -> None:
        """Write an event of a task, with the task's element; when this returns it is on the disk.

        The first one, and each that is about to be handled, says what the element is, so that it can stand without its model.
        """
        task, memory = entry.task, self.book.tasks[entry.task]
        handled = entry.event == TaskEvent.OFFERED.value and not memory.in_grip
        if task in self.book.after and (handled or not memory.body) and self._element(task).bodies:
            facts = self._element(task)
            body, goal = self.ledger.keep(facts.bodies), pose_tuple(facts.base_T_goal)
            entry = replace(entry, name=facts.name, ifc_class=facts.ifc_class, body=body, goal=goal)
        if task in self.book.after and entry.event in _SEEING:
            entry = replace(entry, seen=self.prepared.present[task].digest)
        self.ledger.add(replace(entry, element=self.element_of(task)))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know of model, schedule and ledger before anything is accepted or planned."""
        return (*self.prepared.notes, *self.prepared.schedule.notes)

    # -- the schedule

    @property
    def schedule_word(self) -> str:
        """``model``, ``accepted`` or ``proposed``."""
        if not self.prepared.schedule.proposed:
            return FROM_MODEL
        return FROM_PERSON if self.book.accepted == self.prepared.schedule_digest else PROPOSED

    def accept(self, person: str, reason: str) -> str:
        """Take a person's word that the proposed schedule is right."""
        if self.schedule_word != PROPOSED:
            origin = "the model's own" if self.schedule_word == FROM_MODEL else "accepted already"
            raise WorkRefused(f"the schedule is {origin}: there is nothing to accept")
        _check_named(person)
        self.ledger.add(Entry(ACCEPTED, person=person, reason=reason, schedule=self.prepared.schedule_digest))
        return f"{person} accepts the proposed schedule of {len(self.prepared.schedule.jobs)} tasks"

    # -- what can be planned

    def next(self, now: int) -> str:
        """Return the task that comes next; empty: none can be planned."""
        return next((job for job in self.book.after if not self.obstacle(job, now)), "")

    def obstacle(self, task: str, now: int) -> str:
        """Return why a task cannot be planned now, as a sentence; empty: it can; `now`: since 1970 [ns]."""
        book = self.book
        if task not in book.after:
            return f"there is no task {task!r}; `twin work list` names them"
        if self.schedule_word == PROPOSED:
            return "the schedule is a proposal from the geometry: look at it, then accept it (`twin work accept`)"
        if book.asking:
            return f"{self.title(book.asking[0])} asks first: {self._question(book.asking[0])}"
        for name, memory in book.former.items():
            if not memory.body:
                placed = (
                    f"{self._element(name).name} was placed, is not in the model any more, and its shape was not kept"
                )
                return f"{placed}: take it away, and say {removed_command(name)}"
        busy = book.busy
        if busy:
            what = "under review" if book.tasks[busy].state is TaskState.PLANNED else "under way"
            return f"{self.title(busy)} is {what}"
        held = book.in_state(TaskState.CARRIED)
        if held and held[0] != task:
            return f"{self._element(held[0]).name} is in the grip: {self.title(held[0])} comes first"
        state = book.tasks[task].state
        if state is TaskState.WAITING:
            return Sentence("{task} waits for {tasks}", task=self.title(task), tasks=self._missing(task))
        if state not in PLANNABLE:
            return f"{self.title(task)} is {state.value}"
        if task in self.prepared.removals:
            name, say = self._element(task).name, removed_command(self._typed(task))
            return f"{name} is to be taken down by people; when it is gone, a person says so: {say}"
        robots = self.prepared.schedule.job(task).robots
        if robots and self._robot not in robots:
            return f"{self.title(task)} is for {' or '.join(robots)}, not for {self._robot}"
        element = self.prepared.schedule.job(task).element
        if element in self.prepared.unplannable:
            return f"{self.title(task)} cannot be planned: {self.prepared.unplannable[element]}; skip it when it stands"
        if self.prepared.stays(task):
            return self._not_there(task) or self._lag(task, now)
        if state is TaskState.READY and element not in self._present():
            return f"{self._element(task).name} is not delivered yet: its slot in the rack is taken by another element"
        return self._lag(task, now)

    def _not_there(self, task: str) -> str:
        """Return why an element cannot be worked on where it is to stand; empty: it stands there."""
        element, name = self.element_of(task), self._element(task).name
        placing = self.prepared.schedule.placing.get(element)
        if element in self._gone():
            return f"{name} was taken down; skip {self.title(task)}"
        if placing and not self.book.tasks[placing].placed:
            to_do = f"if it stands, say where (`twin work measured`), else skip {self.title(task)}, too"
            return f"{name} does not count as placed: {self.title(placing)} is {self.book.tasks[placing].state.value}; {to_do}"
        return ""

    def left_closed(self, commanded: Collection[str]) -> str:
        """Return what a person does about a grip that is commanded to hold while nothing counts as held; empty: nothing.

        So it is after a grip that was not confirmed, when the element was said to lie in its stock. The next approach would suck it
        too early, and no plan opens a grip that holds nothing. `commanded`: The tool's outputs that command its grip to hold.
        """
        book = self.book
        doubtful = book.in_state(TaskState.ASKS, TaskState.PLANNED, *UNDER_WAY)
        if not commanded or doubtful or book.in_grip:
            return ""
        names, off = ", ".join(commanded), self.prepared.tool.release.set
        values = ", ".join(f"{name} {'on' if off[name] else 'off'}" for name in commanded if name in off)
        to_do = f"end the controller's RSI program, switch {values or names} by hand, start it anew, then ask again"
        return f"nothing counts as held, but the tool is commanded to grip ({names}): hold what may fall; {to_do}"

    def element_of(self, task: str) -> str:
        """Return the GlobalId of a task's element."""
        return self._job(task).element

    def goal(self, task: str) -> Pose:
        """Return where the model has a task's element."""
        return self._element(task).base_T_goal

    # -- what people say

    def skip(self, task: str, person: str, reason: str) -> str:
        """Take a task out: others no longer wait for it."""
        state = self._memory(task, person).state
        if state is TaskState.ASKS:
            raise WorkRefused(f"{self.title(task)} asks first: {self._question(task)}")
        if state not in (TaskState.WAITING, TaskState.READY, TaskState.HELD):
            raise WorkRefused(f"{self.title(task)} is {state.value} and cannot be skipped")
        self.add(Entry("skipped", task, person=person, reason=reason))
        skipped = f"{self.title(task)} is skipped: what comes after it no longer waits"
        if task in self.prepared.removals:
            return f"{skipped}; {self._element(task).name} stays"
        return skipped if self.prepared.stays(task) else f"{skipped}; take its element out of the stock"

    def removed(self, task: str, person: str, reason: str) -> str:
        """Take a person's word that what a removal takes down, or what was placed, is gone, and no obstacle."""
        memory = self._memory(task, person, former=True)
        if task in self.prepared.removals:
            if memory.state is TaskState.DONE:
                raise WorkRefused(f"{self._element(task).name} is gone already")
        elif not memory.placed:
            raise WorkRefused(
                f"{self.title(task)} has placed nothing and takes nothing down: `removed` is for what stands"
            )
        name, answer = self._element(task).name, "gone" if memory.state is TaskState.ASKS else ""
        self.add(Entry("answered" if answer else "removed", task, answer=answer, person=person, reason=reason))
        return f"{person} says that {name} is gone: it is no obstacle from now on"

    def redo(self, task: str, person: str, reason: str) -> str:
        """Have a task done again, its element back in stock; of one that counts as carried, have it asked about."""
        state = self._memory(task, person).state
        if state is TaskState.CARRIED:
            self.add(Entry("unknown", task, person=person, reason=reason or "a person doubts that it is in the grip"))
            return f"{self.title(task)} asks: {self._question(task)}"
        if state not in (TaskState.DONE, TaskState.SKIPPED, TaskState.HELD):
            raise WorkRefused(f"{self.title(task)} is {state.value}; it was not done or skipped yet")
        later = self.book.followers(task)
        if later:
            raise WorkRefused(f"{self.title(later[0])} came after {self.title(task)}: redo that first")
        taken_down, stays = task in self.prepared.removals, self.prepared.stays(task)
        if not taken_down and not stays:
            self._slot_free(task)
        self.add(Entry("redone", task, person=person, reason=reason))
        if taken_down:
            return (
                f"{self._element(task).name} counts as standing again: an obstacle until a person says that it is gone"
            )
        if stays:
            return f"{self.title(task)} is to be done again"
        return f"{self.title(task)} is to be done again; {self._element(task).name} counts as back in its stock"

    def lost(self) -> str:
        """Take note that the tool is surely open: what counts as carried is asked about; return a sentence, empty: nothing is."""
        held = self.book.in_state(TaskState.CARRIED)
        if not held:
            return ""
        reason = "the tool says that it holds nothing"
        self.add(Entry("unknown", held[0], reason=reason))
        return f"{reason}: {self.title(held[0])} asks: {self._question(held[0])}"

    def answer(self, task: str, answer: str, person: str, reason: str, shown: str = "") -> str:
        """Take the answer to a task's question; return a sentence.

        `shown`: The question as the person saw it; empty: it is not compared.
        """
        memory = self._memory(task, person, former=True)
        possible = self._answers(task)
        if not possible:
            raise WorkRefused(f"{self.title(task)} is {memory.state.value} and asks nothing")
        question = self._question(task)
        if shown and shown != question:
            raise WorkRefused(Sentence("another question is open by now: {question}; look again", question=question))
        if answer not in possible:
            answers = ", ".join(possible)
            raise WorkRefused(f"{answer!r} is no answer to: {question}; expected one of {answers}")
        if answer == "in_stock":
            self._slot_free(task)
        name, meaning = self._element(task).name, _MEANINGS[answer]
        sentence = Sentence("{task}: {element}: {answer}", task=self.title(task), element=name, answer=meaning)
        if answer == SAME:
            self._take_as(task, self._counterpart(task), person, reason)
        else:
            said, seen = ANSWERS_OF_FORMER.get(answer, answer), NOT_IN_MODEL if answer in ANSWERS_OF_FORMER else ""
            self.add(Entry("answered", task, answer=said, person=person, reason=reason, seen=seen))
        return sentence

    def answer_all(self, answer: str, person: str, reason: str) -> str:
        """Answer, with what leaves it an obstacle, what is asked of all that was placed and can be answered so."""
        _check_named(person)
        if answer not in ANSWERS_FOR_ALL:
            answers = ", ".join(ANSWERS_FOR_ALL)
            raise WorkRefused(f"{answer!r} is answered for one task at a time; for all at once only {answers}")
        count = 0
        for task in self.book.asking:
            # each is looked at when it is its turn: what was answered before may have taken its counterpart
            if self.book.tasks[task].placed and answer in self._answers(task):
                self.answer(task, answer, person, reason)
                count += 1
        meaning, left = _MEANINGS[answer], len(self.book.asking)
        return Sentence("{count} answered ({answer}), {left} still ask", count=count, answer=meaning, left=left)

    def _take_as(self, task: str, heir: str, person: str, reason: str) -> None:
        """Count what a task that is no more has placed as placed by one of the schedule."""
        memory, facts = self.book.tasks[task], self._element(heir)
        entry = replace(placed_elsewhere("same", heir, memory, reason), seen=self.prepared.present[heir].digest)
        body, goal = self.ledger.keep(facts.bodies), pose_tuple(facts.base_T_goal)
        if body != memory.body:
            # its frame may be another one: where it stands is known as well as places are compared
            entry = replace(entry, pose=goal, source=PLANNED, body=body, goal=goal)
        self.ledger.add(replace(entry, element=self.element_of(heir), person=person))

    def look_around(self) -> None:
        """Have it asked about what other ledgers of the folder say was placed, where it is of this model or at a place of it."""
        for path in sorted(self.ledger.path.parent.glob("*.jsonl")):
            if path == self.ledger.path:
                continue
            book = replay(path, {})
            mine = self._robot == book.robot or (not book.robot and path.name.startswith(f"{self._robot}_"))
            for memory in book.tasks.values():
                source = f"{path.name} {memory.task} {memory.settled_ns}"
                if memory.placed and source not in self.book.found:
                    self._look_at(memory if mine else replace(memory, base_T_element=(), goal=()), mine, source)

    def _look_at(self, memory: TaskMemory, mine: bool, source: str) -> None:
        """Have it asked about what another ledger says was placed; its pose is known in the frame of the same robot only."""
        book, task = self.book, self.prepared.schedule.placing.get(memory.element, "")
        if any(each.element == memory.element and each.touched for each in book.tasks.values()):
            return
        if not task:
            if not (mine and memory.body):
                return
            (low, high), placing = (
                _box(self._bodies(memory), placed_at(memory, _ORIGIN)),
                self.prepared.schedule.placing,
            )
            boxes = (self._goal_box(one) for one in placing.values() if self._element(one).bodies)
            if not any((np.minimum(high, box[1]) - np.maximum(low, box[0]) > _OVERLAP).all() for box in boxes):
                return
            task = memory.element
        elif book.tasks[task].state not in (TaskState.WAITING, TaskState.READY):
            return
        self.ledger.add(replace(placed_elsewhere("found", task, memory, source=source), former=""))

    def measured(self, element: str, pose: Pose, person: str, reason: str) -> Deviation:
        """Take where an element really is."""
        _check_named(person)
        task = self.prepared.schedule.placing.get(element)
        if task is None:
            raise WorkRefused(f"no task places element {element!r}; `twin work list` names them")
        state = self.book.tasks[task].state
        if state not in SETTLED:
            raise WorkRefused(f"{self._element(task).name} is not placed yet: {self.title(task)} is {state.value}")
        found = deviation(pose, self._element(task).base_T_goal)
        if not (found.distance <= _FARTHEST and np.isfinite(found.angle)):
            away = f"the pose is {found.distance:.3g} m from where the model has {self._element(task).name}"
            raise WorkRefused(f"{away}; expected within {_FARTHEST:g} m, in the robot's base_link")
        self.add(Entry("measured", task, pose=pose_tuple(pose), person=person, reason=reason))
        return found

    # -- what stands where

    def wanted_scene(self) -> tuple[dict[str, SceneObject], tuple[str, ...]]:
        """Return the work's objects of the scene by name, and the elements whose objects are left as they are."""
        gone, former = self._gone(), {memory.element: memory for memory in self.book.former.values()}
        wanted = {item.name: item for item in self.prepared.tool_objects}
        # what was placed stands as it was placed, whatever the model says of it
        for item in self.prepared.standing:
            element = element_in(item)
            before = map(self._placing, self.prepared.comes_after.get(element, ()))
            there = element not in gone and all(memory is not None and memory.placed for memory in before)
            if there and not (element in former and former[element].body):
                wanted[item.name] = item
        present = self._present()
        found: list[tuple[str, tuple[SceneObject, ...] | None]] = []
        for element, memory in former.items():
            bodies = self._bodies(memory) if memory.body else ()
            found.append((element, objects_of(bodies, memory, None, _ORIGIN, self._tip_link) if bodies else None))
        for element in self._elements():
            if element in gone or (element in former and former[element].body):
                continue
            facts, stock = self.prepared.elements[element], self._stock(element) if element in present else None
            known = self._placing(element)
            bodies = self._bodies(known) if known is not None and known.placed and known.body else facts.bodies
            found.append((element, objects_of(bodies, known, stock, facts.base_T_goal, self._tip_link)))
        wanted |= {item.name: item for _, items in found for item in items or ()}
        return wanted, tuple(element for element, items in found if items is None)

    def _bodies(self, memory: TaskMemory) -> tuple[SceneObject, ...]:
        """Return an element's pieces as they were placed; they are kept, because they do not change."""
        key = memory.element, memory.body
        if key not in self._kept:
            self._kept[key] = self.ledger.body(*key)
        return self._kept[key]

    def _goal_box(self, task: str) -> np.ndarray:
        facts = self._element(task)
        return _box(facts.bodies, facts.base_T_goal)

    def _counterpart(self, task: str) -> str:
        """Return the task that is to place what has name, class and place of what one that is no more has placed; empty: none."""
        memory = self.book.tasks[task]
        if task in self.book.after or not (memory.placed and memory.body):
            return ""
        here = _box(self._bodies(memory), placed_at(memory, _ORIGIN))
        for element, heir in self.prepared.schedule.placing.items():
            facts = self.prepared.elements[element]
            free = self.book.tasks[heir].state in (TaskState.WAITING, TaskState.READY)
            if free and facts.bodies and (facts.name, facts.ifc_class) == (memory.name, memory.ifc_class):
                if np.abs(here - self._goal_box(heir)).max() <= _SAME_PLACE:
                    return heir
        return ""

    def forms(self, task: str) -> tuple[tuple[SceneObject, ...], ...]:
        """Return the objects of a task's element as the record can have them: in its stock, in the grip, at its place."""
        facts, memory = self._element(task), self._placing(self.element_of(task))
        stock = self._stock(self.element_of(task))
        places = [(stock, "")] if stock is not None else []
        if memory is not None and memory.base_T_element:
            places.append((pose_of_tuple(memory.base_T_element), ""))
        if memory is not None and memory.tool0_T_element:
            places.append((pose_of_tuple(memory.tool0_T_element), self._tip_link))
        places.append((facts.base_T_goal, ""))
        return tuple(at(facts.bodies, place, link) for place, link in places)

    def _elements(self) -> list[str]:
        """Return the elements that jobs place or work on, in their order."""
        return list(dict.fromkeys(job.element for job in self.prepared.schedule.jobs))

    def _gone(self) -> set[str]:
        """Return what was taken down."""
        return {element for task, element in self.prepared.removals.items() if self.book.tasks[task].gone}

    def _placing(self, element: str) -> TaskMemory | None:
        """Return what is known of where an element is: of the task that places it, or did; None: it stands as the model has it."""
        task = self.prepared.schedule.placing.get(element)
        if task is not None:
            return self.book.tasks[task]
        return next((memory for memory in self.book.former.values() if memory.element == element), None)

    def deviation(self, task: str) -> Deviation | None:
        """Return how far a placed element stands from the model; None: it is not placed, not in it, or where was not measured."""
        memory = self.book.tasks[task]
        if task not in self.book.after or not (memory.placed and memory.base_T_element) or memory.as_planned:
            return None
        return deviation(pose_of_tuple(memory.base_T_element), self._element(task).base_T_goal)

    # -- for people

    def appearances(self, now: int) -> tuple[Appearance, ...]:
        """Return what each element looks like: in stock and where it is to come, or where it is; `now`: since 1970 [ns]."""
        found = []
        present, following = self._present(), self.next(now)
        for element in self._elements():
            facts, memory = self.prepared.elements[element], self._placing(element)
            mine = [job.id for job in self.prepared.schedule.jobs if job.element == element]
            states = {self.book.tasks[task].state for task in mine}
            placed, where = False, facts.base_T_goal
            if memory is not None and memory.placed:
                placed, where = True, placed_at(memory, facts.base_T_goal)
            if placed and self._is_off(element):
                word = "off"
            elif following in mine:
                word = "next"
            elif placed or (TaskState.DONE in states and states <= {*SETTLED}):
                word = "placed"
            else:
                word = "skipped" if states == {TaskState.SKIPPED} else "todo"
            found.append(Appearance(element, facts.name, word, where))
            if memory is not None and memory.in_grip:
                found.append(Appearance(element, facts.name, "carried", pose_of_tuple(memory.tool0_T_element)))
            elif element in present and (stock := self._stock(element)) is not None:
                found.append(Appearance(element, facts.name, "stock", stock))
        return tuple(found)

    def _is_off(self, element: str) -> bool:
        task = self.prepared.schedule.placing.get(element)
        far = None if task is None else self.deviation(task)
        return far is not None and (far.distance > OFF or far.angle > OFF_ANGLE)

    def report(self, now: int) -> WorkReport:
        """Return what is published of the work while the arm is not engaged."""
        return WorkReport(
            model=self.prepared.model,
            model_hash=self.prepared.digest,
            schedule=self.schedule_word,
            engaged=False,
            next=self.next(now),
            reason=self.summary(now),
            tasks=tuple(self._row(task, now) for task in (*self.book.after, *self.book.former)),
            notes=self.notes,
        )

    def title(self, task: str) -> str:
        """Return a task's name for sentences; its id where it has none, and behind it where others have the same."""
        return self.prepared.titles.get(task) or repr(self._element(task).name)

    def _typed(self, task: str) -> str:
        """Return what a person types for a task: its name, or its id where others have the same name."""
        name = self._job(task).name
        return name if name and self.title(task) == repr(name) else task

    def called(self, sentence: str) -> str:
        """Return a sentence with names in place of the ids of tasks, and of elements that are not in the model any more."""
        former = labels({each.element: each.name for each in self.book.former.values()})
        return named(sentence, {**self.prepared.titles, **former})

    def summary(self, now: int) -> str:
        """Return one sentence: what the work waits for."""
        book = self.book
        if not book.tasks:
            return "the model has no task for this arm"
        following = self.next(now)
        if following:
            return f"{self.title(following)} can be planned"
        return self.obstacle(book.open[0], now) if book.open else "every task is done or skipped"

    def _row(self, task: str, now: int) -> TaskReport:
        job, memory, facts, far = self._job(task), self.book.tasks[task], self._element(task), self.deviation(task)
        scheduled = self.prepared.scheduled.get(task, Scheduled())
        return TaskReport(
            id=task,
            name=job.name,
            element=job.element,
            element_name=facts.name,
            state=memory.state.value,
            reason=self._reason(task, now),
            after=tuple(dict.fromkeys(wait.job for wait in job.after)),
            robot=", ".join(job.robots),
            plan_id=memory.plan,
            deviation_mm=math.nan if far is None else far.distance * 1e3,
            deviation_deg=math.nan if far is None else math.degrees(far.angle),
            mass_kg=math.nan if facts.mass is None else facts.mass,
            scheduled_duration=math.nan if scheduled.duration is None else scheduled.duration,
            tolerance_mm=OFF * 1e3,
            tolerance_deg=math.degrees(OFF_ANGLE),
            question=self._question(task),
            answers=self._answers(task),
            grip=memory.grip,
            scheduled_start=scheduled.start,
            begun=memory.begun_ns,
            settled=memory.settled_ns,
        )

    def _reason(self, task: str, now: int) -> str:
        """Return what a task waits for, with what a person should know of it and its element while that can still matter."""
        reason = self._stands(task, now)
        if self.book.tasks[task].state is not TaskState.DONE:
            for remark in self.prepared.schedule.remarks.get(task, ()):
                note = Sentence("Note: {remark}", remark=remark)
                reason = Sentence("{reason}. {note}", reason=reason, note=note) if reason else note
        return reason

    def _stands(self, task: str, now: int) -> str:
        memory = self.book.tasks[task]
        if memory.state is TaskState.ASKS:
            return ""
        if task not in self.book.after:
            return "placed, and not in the model: an obstacle until a person says that it was taken away"
        if memory.state is TaskState.WAITING:
            return f"waits for {self._missing(task)}"
        if memory.state in PLANNABLE:
            return self.failures.get(task) or self.obstacle(task, now) or "can be planned"
        if memory.state is TaskState.PLANNED:
            return "its plan waits for a person's approval"
        if memory.state is TaskState.HELD:
            return "its element is gone: skip it, or put another into its stock and redo it"
        if memory.state is TaskState.DONE and memory.gone:
            return "taken down, as a person says"
        if memory.state is not TaskState.DONE:
            return ""
        if self.prepared.stays(task):
            return "done"
        if memory.as_planned:
            return "placed; as planned, not measured"
        if not memory.base_T_element:
            return "placed; where exactly is not known"
        return f"placed, measured by {memory.measured}" if memory.measured else "placed, by the arm's own pose"

    def _question(self, task: str) -> str:
        memory = self.book.tasks[task]
        if task in self.book.after or memory.state is not TaskState.ASKS:
            return memory.question(self._element(task).name)
        first = self._answers(task)[0]
        asked = Sentence(
            "is the {element} of the model the one that stands there? It has another id, but the same name, class and place"
            if first == SAME
            else "was {element} taken out of the grip and away? The model does not have it"
            if first == "taken_away"
            else "does {element} still stand? The model does not have it",
            element=self._element(task).name,
        )
        return Sentence("{question}. The last that is known of it: {known}", question=asked, known=memory.known)

    def _answers(self, task: str) -> tuple[str, ...]:
        """Return what can be answered to a task's question; of what has no task any more, whether it stands."""
        memory = self.book.tasks[task]
        if task in self.book.after or memory.state is not TaskState.ASKS:
            return memory.possible_answers()
        if not memory.placed:
            return ("taken_away",)
        return (*((SAME,) if self._counterpart(task) else ()), *ANSWERS_OF_FORMER)

    def _missing(self, task: str) -> str:
        return ", ".join(map(self.title, self.book.missing(task)))

    def _lag(self, task: str, now: int) -> str:
        tasks = self.book.tasks
        started = {name: memory.begun_ns / 1e9 for name, memory in tasks.items() if memory.begun_ns}
        finished = {name: memory.settled_ns / 1e9 for name, memory in tasks.items() if memory.state in SETTLED}
        # what was skipped has started, too
        waits = self.prepared.schedule.waits_for(task, {**finished, **started}, finished, now / 1e9)
        return f"{self.title(task)} waits {named(waits, self.prepared.titles)}" if waits else ""

    def _stock(self, element: str) -> Pose | None:
        """Return where an element lies before it is taken; None: it has no slot."""
        slot = self.prepared.stock.slots.get(element)
        return None if slot is None else slot.base_T_element

    def _present(self) -> tuple[str, ...]:
        """Return the elements that lie in their stock."""
        return self.prepared.stock.present(self._taken())

    def _slot_free(self, task: str) -> None:
        """Refuse to count a task's element as back in its stock while another one counts as lying there."""
        other = self.prepared.stock.instead_of(self.element_of(task), self._taken())
        if not other:
            return
        later = self.title(self.prepared.schedule.placing[other])
        taken = f"{self.prepared.elements[other].name} counts as delivered in the slot of {self._element(task).name}"
        raise WorkRefused(f"{taken}: take it out and skip {later} first; redo that afterwards")

    def _taken(self) -> list[str]:
        """Return the elements that do not lie in their stock any more."""
        tasks = self.book.tasks
        return [element for element, task in self.prepared.schedule.placing.items() if tasks[task].taken]

    def _element(self, task: str) -> ElementFacts:
        if task in self.book.after:
            return self.prepared.elements[self.element_of(task)]
        memory = self.book.tasks[task]
        name, bodies = memory.name or memory.element or task, self._bodies(memory) if memory.body else ()
        return ElementFacts(name, bodies, placed_at(memory, _ORIGIN), np.empty((0, 3, 3)))

    def _job(self, task: str) -> Job:
        """Return a task's job; of one that the schedule does not have any more what the ledger says."""
        if task in self.book.after:
            return self.prepared.schedule.job(task)
        memory = self.book.tasks[task]
        return Job(task, task, memory.name, memory.element, (), ())

    def _memory(self, task: str, person: str, former: bool = False) -> TaskMemory:
        """Return what is known of a task of which a person says something; refuse one that there is not, or nobody's word."""
        if task not in self.book.after and task not in self.book.former:
            raise WorkRefused(f"there is no task {task!r}; `twin work list` names them")
        if task not in self.book.after and not former:
            name = self._element(task).name
            raise WorkRefused(
                f"{name} is not in the model any more; once it is taken away, say {removed_command(name)}"
            )
        _check_named(person)
        return self.book.tasks[task]


def _check_named(person: str) -> None:
    if not person.strip():
        raise WorkRefused("who says so? Give the name of a person: it is kept with the record")


#: What answers mean.
_MEANINGS = {
    "in_stock": Sentence("it lies in its stock, and the grip is empty"),
    "in_grip": Sentence("it is in the grip, as it was taken"),
    "placed": Sentence("it stands at its place, and the grip is empty"),
    "gone": Sentence("it is none of these: it was taken away; it waits until it is skipped or done again"),
    SAME: Sentence("it is the one that stands there: it counts as placed"),
    "stands": Sentence("it stands there: an obstacle until a person says that it was taken away"),
    "taken_away": Sentence("it was taken away: it is no obstacle any more"),
    "done": Sentence("it was done"),
    "not_done": Sentence("it was not done: it is to be done again from its beginning"),
}
#: Events by which what the model says of an element is seen by the arm, or by a person.
_SEEING = ("offered", "answered")
#: Boxes whose sides are all closer than this are at the same place; boxes that reach further than that into each other overlap [m].
_SAME_PLACE, _OVERLAP = 0.02, 0.005
_ORIGIN = Pose(np.zeros(3), np.eye(3))


def _box(bodies: tuple[SceneObject, ...], pose: Pose) -> np.ndarray:
    """Return the lowest and highest coordinates of an element's pieces at its pose, shape (2, 3)."""
    points = _corners(bodies) @ pose.rotation.T + pose.position
    return np.array([points.min(axis=0), points.max(axis=0)])


@functools.lru_cache(maxsize=4096)
def _corners(bodies: tuple[SceneObject, ...]) -> np.ndarray:
    return Pieces(bodies).points


#: A measured element further than this from its place was not measured in the robot's frame [m].
_FARTHEST = 10.0
#: A placed element further than this from where the model has it is shown as off [m], [rad].
OFF, OFF_ANGLE = 0.005, 0.01
