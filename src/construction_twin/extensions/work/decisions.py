"""Decisions of people, recorded in the ledger; each returns a sentence."""

from __future__ import annotations

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.loaded_model import Deviation, deviation, pose_tuple
from construction_twin.extensions.work.task_board import FROM_MODEL, PROPOSED, TaskBoard, WorkRefused, removed_command
from construction_twin.extensions.work.task_memory import (
    ACCEPTED,
    ANSWERS_OF_FORMER,
    NOT_IN_MODEL,
    SETTLED,
    Entry,
    TaskMemory,
    TaskState,
)
from construction_twin.kinematics.chain import Pose

_MEANINGS = {
    "in_stock": Sentence("it lies in its stock, and the grip is empty"),
    "in_grip": Sentence("it is in the grip, as it was taken"),
    "placed": Sentence("it stands at its place, and the grip is empty"),
    "gone": Sentence("it is none of these: it was taken away; it waits until it is skipped or done again"),
    "stands": Sentence("it stands there: an obstacle until a person says that it was taken away"),
    "taken_away": Sentence("it was taken away: it is no obstacle any more"),
    "done": Sentence("it was done"),
    "not_done": Sentence("it was not done: it is to be done again from its beginning"),
}
#: A measured element further than this from its place was not measured in the robot's frame [m].
_FARTHEST = 10.0


def accept(board: TaskBoard, person: str, reason: str) -> str:
    """Accept the proposed schedule."""
    if board.schedule_word != PROPOSED:
        origin = "the model's own" if board.schedule_word == FROM_MODEL else "accepted already"
        raise WorkRefused(f"the schedule is {origin}: there is nothing to accept")
    _require_person(person)
    board.ledger.add(Entry(ACCEPTED, person=person, reason=reason, schedule=board.loaded.schedule_digest))
    return f"{person} accepts the proposed schedule of {len(board.loaded.schedule.jobs)} tasks"


def skip(board: TaskBoard, task: str, person: str, reason: str) -> str:
    """Take a task out: others no longer wait for it."""
    state = _memory(board, task, person).state
    if state is TaskState.ASKS:
        raise WorkRefused(f"{board.title(task)} asks first: {board.question(task)}")
    if state not in (TaskState.WAITING, TaskState.READY, TaskState.HELD):
        raise WorkRefused(f"{board.title(task)} is {state.value} and cannot be skipped")
    board.add(Entry("skipped", task, person=person, reason=reason))
    skipped = f"{board.title(task)} is skipped: what comes after it no longer waits"
    if task in board.loaded.removals:
        return f"{skipped}; {board.built.element(task).name} stays"
    return skipped if board.loaded.stays(task) else f"{skipped}; take its element out of the stock"


def removed(board: TaskBoard, task: str, person: str, reason: str) -> str:
    """Record that what a removal takes down, or what was placed, is gone."""
    memory = _memory(board, task, person, former=True)
    if task in board.loaded.removals:
        if memory.state is TaskState.DONE:
            raise WorkRefused(f"{board.built.element(task).name} is gone already")
    elif not memory.placed:
        raise WorkRefused(
            f"{board.title(task)} has placed nothing and takes nothing down: `removed` is for what stands"
        )
    name, answer = board.built.element(task).name, "gone" if memory.state is TaskState.ASKS else ""
    board.add(Entry("answered" if answer else "removed", task, answer=answer, person=person, reason=reason))
    return f"{person} says that {name} is gone: it is no obstacle from now on"


def redo(board: TaskBoard, task: str, person: str, reason: str) -> str:
    """Reopen a task that is done, skipped or held; ask about one whose element counts as carried."""
    state = _memory(board, task, person).state
    if state is TaskState.CARRIED:
        board.add(Entry("unknown", task, person=person, reason=reason or "a person doubts that it is in the grip"))
        return f"{board.title(task)} asks: {board.question(task)}"
    if state not in (TaskState.DONE, TaskState.SKIPPED, TaskState.HELD):
        raise WorkRefused(f"{board.title(task)} is {state.value}; it was not done or skipped yet")
    later = board.states.followers(task)
    if later:
        raise WorkRefused(f"{board.title(later[0])} came after {board.title(task)}: redo that first")
    taken_down, stays = task in board.loaded.removals, board.loaded.stays(task)
    if not taken_down and not stays:
        _require_free_slot(board, task)
    board.add(Entry("redone", task, person=person, reason=reason))
    if taken_down:
        return f"{board.built.element(task).name} counts as standing again: an obstacle until a person says that it is gone"
    if stays:
        return f"{board.title(task)} is to be done again"
    return f"{board.title(task)} is to be done again; {board.built.element(task).name} counts as back in its stock"


def ask_about_carried(board: TaskBoard) -> str:
    """Ask about the element that counts as carried while the tool is open; return a sentence if there is one."""
    held = board.states.in_state(TaskState.CARRIED)
    if not held:
        return ""
    reason = "the tool says that it holds nothing"
    board.add(Entry("unknown", held[0], reason=reason))
    return f"{reason}: {board.title(held[0])} asks: {board.question(held[0])}"


def answer(board: TaskBoard, task: str, answer: str, person: str, reason: str, shown: str = "") -> str:
    """Record the answer to a task's question; `shown`: the one that the person saw, if known."""
    memory = _memory(board, task, person, former=True)
    possible = board.answers(task)
    if not possible:
        raise WorkRefused(f"{board.title(task)} is {memory.state.value} and asks nothing")
    question = board.question(task)
    if shown and shown != question:
        raise WorkRefused(Sentence("another question is open by now: {question}; look again", question=question))
    if answer not in possible:
        raise WorkRefused(f"{answer!r} is no answer to: {question}; expected one of {', '.join(possible)}")
    if answer == "in_stock":
        _require_free_slot(board, task)
    name, meaning = board.built.element(task).name, _MEANINGS[answer]
    sentence = Sentence("{task}: {element}: {answer}", task=board.title(task), element=name, answer=meaning)
    said, seen = ANSWERS_OF_FORMER.get(answer, answer), NOT_IN_MODEL if answer in ANSWERS_OF_FORMER else ""
    board.add(Entry("answered", task, answer=said, person=person, reason=reason, seen=seen))
    return sentence


def record_measured(board: TaskBoard, element: str, pose: Pose, person: str, reason: str) -> Deviation:
    """Record the measured pose of an element."""
    _require_person(person)
    task = board.loaded.schedule.placing.get(element)
    if task is None:
        raise WorkRefused(f"no task places element {element!r}; `twin work list` names them")
    state = board.states.tasks[task].state
    if state not in SETTLED:
        raise WorkRefused(f"{board.built.element(task).name} is not placed yet: {board.title(task)} is {state.value}")
    found = deviation(pose, board.built.element(task).base_T_goal)
    if not (found.distance <= _FARTHEST and np.isfinite(found.angle)):
        away = f"the pose is {found.distance:.3g} m from where the model has {board.built.element(task).name}"
        raise WorkRefused(f"{away}; expected within {_FARTHEST:g} m, in the robot's base_link")
    board.add(Entry("measured", task, pose=pose_tuple(pose), person=person, reason=reason))
    return found


def _require_free_slot(board: TaskBoard, task: str) -> None:
    other = board.loaded.stock.later_element_in_slot(board.element_of(task), board.built.out_of_stock())
    if not other:
        return
    later = board.title(board.loaded.schedule.placing[other])
    taken = f"{board.loaded.elements[other].name} counts as delivered in the slot of {board.built.element(task).name}"
    raise WorkRefused(f"{taken}: take it out and skip {later} first; redo that afterwards")


def _memory(board: TaskBoard, task: str, person: str, former: bool = False) -> TaskMemory:
    if task not in board.states.predecessors and task not in board.states.former:
        raise WorkRefused(f"there is no task {task!r}; `twin work list` names them")
    if task not in board.states.predecessors and not former:
        name = board.built.element(task).name
        raise WorkRefused(f"{name} is not in the model any more; once it is taken away, say {removed_command(name)}")
    _require_person(person)
    return board.states.tasks[task]


def _require_person(person: str) -> None:
    if not person.strip():
        raise WorkRefused("who says so? Give the name of a person: it is kept with the record")
