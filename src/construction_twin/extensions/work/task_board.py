"""What can be done of a building model: the ledger read against schedule, stock and model."""

from __future__ import annotations

import math
import shlex
from collections.abc import Collection
from dataclasses import replace

from construction_twin.core.reports import TaskReport, WorkReport
from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.building import WorkError, with_names
from construction_twin.extensions.work.ledger import Ledger, TaskStates
from construction_twin.extensions.work.loaded_model import OFF, OFF_ANGLE, AsBuilt, LoadedModel, Scheduled, pose_tuple
from construction_twin.extensions.work.task_memory import (
    ANSWERS_OF_FORMER,
    PLANNABLE,
    SETTLED,
    UNDER_WAY,
    Entry,
    TaskEvent,
    TaskState,
)  # fmt: skip

#: Words for where the schedule comes from, as `WorkTasks.msg` has them.
FROM_MODEL, FROM_PERSON, PROPOSED = "model", "accepted", "proposed"


class WorkRefused(WorkError):
    """What was asked for cannot be done now; says why and what to do."""


def removed_command(task: str) -> str:
    """Return the command by which a person says that something is gone."""
    return f"`twin work removed {shlex.quote(task)}`"


class TaskBoard:
    """What can be done. For one thread; times since 1970 [ns]. `failures`: why planning failed last, by task id."""

    def __init__(self, loaded: LoadedModel, ledger: Ledger, robot: str, tip_link: str):
        self.loaded, self.ledger, self.robot = loaded, ledger, robot
        self.built = AsBuilt(loaded, ledger, tip_link)
        self.failures: dict[str, str] = {}

    @property
    def states(self) -> TaskStates:
        """The states of the tasks."""
        return self.ledger.states

    def add(self, entry: Entry) -> None:
        """Write an event of a task, with the element's bodies where they may be needed without the model."""
        task, memory = entry.task, self.states.tasks[entry.task]
        handled = entry.event == TaskEvent.OFFERED.value and not memory.in_grip
        if task in self.states.predecessors and (handled or not memory.body) and self.built.element(task).bodies:
            facts = self.built.element(task)
            body, goal = self.ledger.save_bodies(facts.bodies), pose_tuple(facts.base_T_goal)
            entry = replace(entry, name=facts.name, body=body, goal=goal)
        if task in self.states.predecessors and entry.event in _SEEING:
            entry = replace(entry, seen=self.loaded.model_elements[task].digest)
        self.ledger.add(replace(entry, element=self.element_of(task)))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know of model and schedule."""
        return (*self.loaded.notes, *self.loaded.schedule.notes)

    @property
    def schedule_word(self) -> str:
        """``model``, ``accepted`` or ``proposed``."""
        if not self.loaded.schedule.proposed:
            return FROM_MODEL
        return FROM_PERSON if self.states.accepted == self.loaded.schedule_digest else PROPOSED

    def next(self, now: int) -> str:
        """Return the task that comes next; empty: none can be planned."""
        return next((job for job in self.states.predecessors if not self.obstacle(job, now)), "")

    def obstacle(self, task: str, now: int) -> str:
        """Return why a task cannot be planned now, empty if it can."""
        states = self.states
        if task not in states.predecessors:
            return f"there is no task {task!r}; `twin work list` names them"
        if self.schedule_word == PROPOSED:
            return "the schedule is a proposal from the geometry: look at it, then accept it (`twin work accept`)"
        if states.asking:
            return f"{self.title(states.asking[0])} asks first: {self.question(states.asking[0])}"
        for name, memory in states.former.items():
            if not memory.body:
                placed = f"{self.built.element(name).name} was placed, is not in the model any more, and its shape was not kept"
                return f"{placed}: take it away, and say {removed_command(name)}"
        busy = states.busy
        if busy:
            what = "under review" if states.tasks[busy].state is TaskState.PLANNED else "under way"
            return f"{self.title(busy)} is {what}"
        held = states.in_state(TaskState.CARRIED)
        if held and held[0] != task:
            return f"{self.built.element(held[0]).name} is in the grip: {self.title(held[0])} comes first"
        state = states.tasks[task].state
        if state is TaskState.WAITING:
            return Sentence("{task} waits for {tasks}", task=self.title(task), tasks=self._missing_titles(task))
        if state not in PLANNABLE:
            return f"{self.title(task)} is {state.value}"
        if task in self.loaded.removals:
            name, say = self.built.element(task).name, removed_command(task)
            return f"{name} is to be taken down by people; when it is gone, a person says so: {say}"
        robots = self.loaded.schedule.job(task).robots
        if robots and self.robot not in robots:
            return f"{self.title(task)} is for {' or '.join(robots)}, not for {self.robot}"
        element = self.loaded.schedule.job(task).element
        if element in self.loaded.unplannable:
            return f"{self.title(task)} cannot be planned: {self.loaded.unplannable[element]}; skip it when it stands"
        if self.loaded.stays(task):
            return self._absence(task) or self._lag_sentence(task, now)
        if state is TaskState.READY and element not in self.built.in_stock():
            return f"{self.built.element(task).name} is not delivered yet: its slot in the rack is taken by another element"
        return self._lag_sentence(task, now)

    def _absence(self, task: str) -> str:
        element, name = self.element_of(task), self.built.element(task).name
        placing = self.loaded.schedule.placing.get(element)
        if element in self.built.taken_down():
            return f"{name} was taken down; skip {self.title(task)}"
        if placing and not self.states.tasks[placing].placed:
            to_do = f"if it stands, say where (`twin work measured`), else skip {self.title(task)}, too"
            return f"{name} does not count as placed: {self.title(placing)} is {self.states.tasks[placing].state.value}; {to_do}"
        return ""

    def empty_grip_remedy(self, commanded: Collection[str]) -> str:
        """Return what a person does about a grip closed on nothing, which no plan opens; `commanded`: outputs that close it."""
        states = self.states
        doubtful = states.in_state(TaskState.ASKS, TaskState.PLANNED, *UNDER_WAY)
        if not commanded or doubtful or states.in_grip:
            return ""
        names, off = ", ".join(commanded), self.loaded.tool.release.set
        values = ", ".join(f"{name} {'on' if off[name] else 'off'}" for name in commanded if name in off)
        to_do = f"end the controller's RSI program, switch {values or names} by hand, start it anew, then ask again"
        return f"nothing counts as held, but the tool is commanded to grip ({names}): hold what may fall; {to_do}"

    def element_of(self, task: str) -> str:
        """Return the GlobalId of a task's element."""
        return self.built.job(task).element

    def state_report(self, now: int) -> WorkReport:
        """Return the state of the work; the arm is not engaged."""
        return WorkReport(
            model=self.loaded.model,
            model_hash=self.loaded.digest,
            schedule=self.schedule_word,
            engaged=False,
            next=self.next(now),
            reason=self.summary(now),
            tasks=tuple(self._row(task, now) for task in (*self.states.predecessors, *self.states.former)),
            notes=self.notes,
        )

    def title(self, task: str) -> str:
        """Return a task's name in sentences, with the id where others have it."""
        return self.loaded.titles.get(task) or repr(self.built.element(task).name)

    def summary(self, now: int) -> str:
        """Return what the work waits for."""
        states = self.states
        if not states.tasks:
            return "the model has no task for this arm"
        following = self.next(now)
        if following:
            return f"{self.title(following)} can be planned"
        return self.obstacle(states.open[0], now) if states.open else "every task is done or skipped"

    def _row(self, task: str, now: int) -> TaskReport:
        job, memory = self.built.job(task), self.states.tasks[task]
        facts, far = self.built.element(task), self.built.deviation(task)
        scheduled = self.loaded.scheduled.get(task, Scheduled())
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
            question=self.question(task),
            answers=self.answers(task),
            grip=memory.grip,
            scheduled_start=scheduled.start,
            begun=memory.begun_ns,
            settled=memory.settled_ns,
        )

    def _reason(self, task: str, now: int) -> str:
        memory = self.states.tasks[task]
        if memory.state is TaskState.ASKS:
            return ""
        if task not in self.states.predecessors:
            return "placed, and not in the model: an obstacle until a person says that it was taken away"
        if memory.state is TaskState.WAITING:
            return f"waits for {self._missing_titles(task)}"
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
        if self.loaded.stays(task):
            return "done"
        if memory.as_planned:
            return "placed; as planned, not measured"
        if not memory.base_T_element:
            return "placed; where exactly is not known"
        return f"placed, measured by {memory.measured_by}" if memory.measured_by else "placed, by the arm's own pose"

    def question(self, task: str) -> str:
        """Return what a person is asked about a task, if anything."""
        memory = self.states.tasks[task]
        if task in self.states.predecessors or memory.state is not TaskState.ASKS:
            return memory.question(self.built.element(task).name)
        asked = Sentence(
            "does {element} still stand? The model does not have it"
            if memory.placed
            else "was {element} taken out of the grip and away? The model does not have it",
            element=self.built.element(task).name,
        )
        return Sentence("{question}. The last that is known of it: {known}", question=asked, known=memory.known)

    def answers(self, task: str) -> tuple[str, ...]:
        """Return what can be answered to a task's question."""
        memory = self.states.tasks[task]
        if task in self.states.predecessors or memory.state is not TaskState.ASKS:
            return memory.possible_answers()
        return tuple(ANSWERS_OF_FORMER) if memory.placed else ("taken_away",)

    def _missing_titles(self, task: str) -> str:
        return ", ".join(map(self.title, self.states.missing(task)))

    def _lag_sentence(self, task: str, now: int) -> str:
        tasks = self.states.tasks
        started = {name: memory.begun_ns / 1e9 for name, memory in tasks.items() if memory.begun_ns}
        finished = {name: memory.settled_ns / 1e9 for name, memory in tasks.items() if memory.state in SETTLED}
        # what was skipped has started, too
        waits = self.loaded.schedule.waits_for(task, {**finished, **started}, finished, now / 1e9)
        return f"{self.title(task)} waits {with_names(waits, self.loaded.titles)}" if waits else ""


#: Events by which what the model says of an element is seen by the arm, or by a person.
_SEEING = ("offered", "answered")
