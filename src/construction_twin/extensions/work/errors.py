"""Exceptions of work from a building model: a branch of the tree in `core.errors`.

Messages say what, where, the value, what was expected and what to do.
"""

from __future__ import annotations

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence


class WorkError(ConstructionTwinError):
    """Root of the errors of work from a building model."""


class BuildingError(WorkError):
    """A building model cannot be used.

    Attributes:
        what: Which part of it: ``#123=IFCWALL``, ``element '2O2Fr$t4X7Zf8NOew3FLOH'``.
    """

    def __init__(self, file: str, what: str, found: str, expected: str):
        self.file, self.what, self.found, self.expected = file, what, found, expected
        super().__init__(f"{file}: {what}: found {found}, expected {expected}")


class ScheduleError(WorkError):
    """The order of the tasks makes no sense."""


class PlacementError(WorkError):
    """The model does not stand where the robot is, as far as its figures can tell."""


class TaskPlanningError(WorkError):
    """A task cannot be planned.

    Attributes:
        stage: Segment that was not possible with the method that came furthest; empty: before any.
        method: Name of that method, see `work.process.TaskMotions`; empty: none.
    """

    def __init__(self, task: str, reason: str, stage: str = "", method: str = ""):
        self.task, self.reason, self.stage, self.method = task, reason, stage, method
        where = (f", {stage}" if stage else "") + (f" with {method!r}" if method else "")
        super().__init__(Sentence("task {task}{where}: {reason}", task=task, where=where, reason=reason))


class LedgerError(WorkError):
    """What was done cannot be recorded, or its record cannot be read; nothing is done without it."""

    def __init__(self, path: str, problem: str):
        super().__init__(f"{path}: {problem}")
