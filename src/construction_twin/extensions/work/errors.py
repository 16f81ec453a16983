"""Exceptions of work from a building model."""

from __future__ import annotations

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence


class WorkError(ConstructionTwinError):
    """Root of the errors of work from a building model."""


class BuildingError(WorkError):
    """A building model cannot be used; `what`: which part of it."""

    def __init__(self, file: str, what: str, found: str, expected: str):
        self.file, self.what, self.found, self.expected = file, what, found, expected
        super().__init__(f"{file}: {what}: found {found}, expected {expected}")


class ScheduleError(WorkError):
    """The order of the tasks makes no sense."""


class PlacementError(WorkError):
    """The model does not stand where the robot is."""


class TaskPlanningError(WorkError):
    """A task cannot be planned.

    Attributes:
        stage: Segment that failed, with the method that came furthest; empty: before any.
        method: `TaskMotions.method`
    """

    def __init__(self, task: str, reason: str, stage: str = "", method: str = ""):
        self.task, self.reason, self.stage, self.method = task, reason, stage, method
        where = (f", {stage}" if stage else "") + (f" with {method!r}" if method else "")
        super().__init__(Sentence("task {task}{where}: {reason}", task=task, where=where, reason=reason))


class LedgerError(WorkError):
    """The ledger cannot be written or read; nothing is done without it."""

    def __init__(self, path: str, problem: str):
        super().__init__(f"{path}: {problem}")
