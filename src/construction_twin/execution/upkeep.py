"""Work beside the executor's cycle: reports, records on disk, permission to move the arm."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.reports import ExecutionReport, ToolReport
from construction_twin.core.speed_limit import LimitState, SpeedLimit
from construction_twin.execution.approval import Approval
from construction_twin.execution.engagement import Engagement
from construction_twin.execution.executor import Executor
from construction_twin.execution.states import ACTIVE, ExecutorState
from construction_twin.robot.description import ESTIMATES, RobotModel

#: States of the limit whose source is silent or was never there.
_NO_SOURCE = (LimitState.SILENT, LimitState.MISSING)


class Permission(pydantic.BaseModel):
    """Launch arguments that permit motion of an arm."""

    arm: Literal["mock", "real", "none"]
    auto_approve: bool = False
    auto_approve_is_meant: bool = False
    auto_approve_sources: tuple[Annotated[str, pydantic.Field(min_length=1)], ...] = ()

    @pydantic.field_validator("auto_approve_sources")
    @classmethod
    def _refuse_real_arm(cls, names: tuple[str, ...], context: pydantic.ValidationInfo) -> tuple[str, ...]:
        if names and context.data.get("arm") == "real":
            raise ValueError("none with a real arm: the name of a client proves nothing, a person has to approve")
        return names

    def check(self, robot: RobotModel) -> None:
        """Check that a real arm has a person's approval and values that are no estimates."""
        if self.arm == "real" and self.auto_approve and not self.auto_approve_is_meant:
            raise ConfigurationError(
                "auto_approve",
                True,
                "false with arm:=real, for a person to approve each plan; or also give auto_approve_is_meant:=true",
            )
        if self.arm == "real" and robot.estimates:
            keys = " and ".join(ESTIMATES[word] for word in robot.estimates)
            expected = f"none with arm:=real: put in the right values of {keys}, then take the words out"
            raise ConfigurationError("estimates", list(robot.estimates), expected)


class ExecutionReporter:
    """Collects changes of executor, approvals and speed limit for report and log."""

    def __init__(self, executor: Executor, approval: Approval, limit: SpeedLimit):
        self._executor, self._approval, self._limit = executor, approval, limit
        self._published: tuple = (None,)
        self._limit_state: LimitState | None = None

    @property
    def waits(self) -> bool:
        """Whether a person should look: the arm stands until somebody acts, or the limit's source is lost."""
        return self._limit.state in _NO_SOURCE or self._executor.state in (
            ExecutorState.WAITING,
            ExecutorState.HELD,
        )

    def pop_report(
        self, moments: Callable[[], tuple[int, str]]
    ) -> tuple[ExecutionReport | None, list[tuple[bool, str]]]:
        """Return the report, where one is due, and lines for the log, each with whether it is a warning.

        `moments` returns ROS time [ns] and the robot's clock. A stop that comes after that is not known to the report.
        """
        executor, key = self._executor, self._report_key()
        lines: list[tuple[bool, str]] = []
        if self._limit.state is not self._limit_state:
            self._limit_state = self._limit.state
            lines.append((self._limit_state in _NO_SOURCE, self._limit.reason))
        if key == self._published:
            return None, lines
        if key[0] != self._published[0]:
            lines.append((False, f"{executor.state.name}: {executor.reason}"))
        report = self._report(*moments())
        # after what may fail: what was not reported is news in the next cycle, too
        self._published = key
        return report, lines

    def _report_key(self) -> tuple:
        """Return the fields whose change is reported: first those that are logged, too."""
        executor, approval, limit = self._executor, self._approval, self._executor.limit
        work, playback, active = executor.segment_run, executor.playback, executor.state in ACTIVE
        where = work and (work.number, active and work.at_boundary, active and work.expected_scene)
        steady = not active or playback is None or playback.steady
        # a limit that follows a sensor changes all the time: a hundredth is worth a report
        limited = executor.state is ExecutorState.PLAYING and (limit.waits, limit.fraction < 1.0 and limit.reason)
        logged = executor.state, executor.cause, limit.standing
        review = approval.obstacle, approval.overridable, executor.engagement.engaged
        return logged, round(limit.fraction, 2), limited, executor.plan_start, executor.outcome, steady, where, review

    def _report(self, stamp: int, moment: str) -> ExecutionReport:
        executor, active = self._executor, self._executor.state in ACTIVE
        plan, work = executor.plan, executor.segment_run
        segment = work.segment if work is not None else None
        expected = work.expected_scene if work is not None and active else ""
        return ExecutionReport(
            state=executor.state.value,
            text=executor.state.name,
            reason=executor.reason,
            plan_id=plan.id if plan is not None else "",
            outcome=executor.outcome,
            plan_start=executor.plan_start,
            duration=plan.trajectory.duration if plan is not None else 0.0,
            rate=executor.rate,
            speed_limit=executor.limit.fraction,
            segment=work.number if work is not None else -1,
            segment_name=segment.name if segment is not None else "",
            at_boundary=work is not None and active and work.at_boundary,
            wants_scene=bool(expected),
            engaged=executor.engagement.engaged,
            expected_scene=expected,
            approval_obstacle=self._approval.obstacle,
            overridable=self._approval.overridable,
            stamp=stamp,
            moment=moment,
        )


class DiskWriter:
    """Writes beside the cycle; failures are logged and tried again.

    Args:
        engagement: File of where the arm is engaged.
        lock: Held around every use of the executor.
        log: Logs a sentence.
    """

    def __init__(self, executor: Executor, engagement: Path, lock: AbstractContextManager, log: Callable[[str], None]):
        self._executor, self._engagement, self._lock, self._log = executor, engagement, lock, log
        self._faults: dict[str, str] = {}
        self._published: tuple | None = None

    @property
    def fault(self) -> str:
        """The sentences of failed writes; empty for none."""
        return next(iter(self._faults.values()), "")

    def write(self, what: str, write: Callable[[], object]) -> bool:
        """Run a write; return whether it succeeded."""
        try:
            write()
        except ConstructionTwinError as error:
            self._faults[what] = str(error)
            self._log(str(error))
            return False
        self._faults.pop(what, None)
        return True

    def save_engagement(self) -> tuple[Engagement | None, ToolReport] | None:
        """Save the engagement; return where the arm was left, and the tool, where these are new."""
        store = self._executor.engagement
        if not self.write("the engagement", lambda: store.save(self._lock, self._engagement)):
            return None
        with self._lock:
            active, tool = store.active, self._executor.tool
        engagement = active, active.requires(tool) if active is not None else ()
        if engagement == self._published:
            return None
        self._published = engagement
        return active, tool
