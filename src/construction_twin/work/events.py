"""The events of the work on a building model: one line of the ledger each. Everything else is computed from them.

Metres; poses as x, y, z and quaternion x, y, z, w.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from construction_twin.core.sentences import Sentence
from construction_twin.work.processes import MODULES
from construction_twin.work.recipe import DEFAULT
from construction_twin.work.task_states import TaskEvent

#: Events that are about no task.
OPENED, ACCEPTED, MENDED, CHANGED = "opened", "accept_schedule", "mended", "changed"
OF_NO_TASK = (OPENED, ACCEPTED, MENDED, CHANGED)
#: Where the pose of an element that was let go comes from.
MEASURED, PLANNED = "measured", "planned"
#: What a person has seen of an element of which they said that it stands, and is not in the model.
NOT_IN_MODEL = "not in the model"


@dataclass(frozen=True)
class Entry:
    """One line of the ledger.

    Attributes:
        event: A `TaskEvent`'s word, or `OPENED`, `ACCEPTED`, `MENDED`, `CHANGED`.
        task, element: GlobalIds; empty where it is about neither.
        name, ifc_class, body, goal: Of the element, as it was handled: what it needs to stand in the scene without its model.
            `body`: digest of its pieces (`Ledger.keep`); `goal`: where the model had it.
        seen: What the model said of the element then, as `book.Present.digest`; of one that it did not have `NOT_IN_MODEL`.
        former: Of `same`, `found` and `unknown`: the task that handled the element, which this one replaces.
        source: Of the pose of `released` and `same`: `MEASURED` by the arm's own feedback, or `PLANNED`: as planned, not measured.
            Of `found`: the ledger that says so.
        plan, offer: `offer` is named in the plan's `source`, so that a plan whose id was never learnt is known again.
        grip: Of `offered`: how it is done, see `jobs.TaskMotions.method`.
        process: Of `offered`; empty: `recipe.DEFAULT`.
        pose, goal: Length 7 or 0. How it will be held (`offered`), or where it stands (`released`, `measured`, `same`) or is said
            to stand (`unknown`, `found`).
        answer: One of `task_states.ANSWERS`.
        model, cell, schedule: SHA-256 of the model's file; path of the cell file; SHA-256 of the schedule that was accepted.
        robot: Of `opened`: its name.
        time_ns: When it was written, since 1970 [ns].
    """

    event: str
    task: str = ""
    element: str = ""
    plan: str = ""
    offer: str = ""
    grip: str = ""
    pose: tuple[float, ...] = ()
    source: str = ""
    answer: str = ""
    person: str = ""
    reason: str = ""
    model: str = ""
    cell: str = ""
    schedule: str = ""
    process: str = ""
    name: str = ""
    ifc_class: str = ""
    body: str = ""
    goal: tuple[float, ...] = ()
    seen: str = ""
    former: str = ""
    robot: str = ""
    time_ns: int = 0

    def fields(self) -> dict:
        """Return what is written of it: all that is not empty."""
        return {name: value for name, value in asdict(self).items() if value and name != "time_ns"}


def entry_of(fields: Mapping[str, Any]) -> Entry:
    """Return a line as it was written.

    Raises:
        ValueError, TypeError: If it is none of a ledger.
    """
    known = {name: value for name, value in fields.items() if name not in ("time", "previous")}
    pose, goal = (tuple(map(float, known.pop(name, ()))) for name in ("pose", "goal"))
    for each in (pose, goal):
        if len(each) not in (0, 7) or not all(map(math.isfinite, each)):
            raise ValueError(Sentence("expected.work.finite_pose", pose=str(each)))
    time_ns = int(known.pop("time_ns", 0))
    if not all(isinstance(value, str) for value in known.values()):
        raise ValueError(Sentence("expected.work.texts"))
    process = known.get("process", DEFAULT)
    if process not in MODULES:
        raise ValueError(Sentence("expected.work.process", process=repr(process), known=", ".join(MODULES)))
    event = known.get("event", "")
    if event not in OF_NO_TASK:
        TaskEvent(event)
    return Entry(**known, pose=pose, goal=goal, time_ns=time_ns)
