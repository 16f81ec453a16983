"""The gate's surroundings: session, settings at rest, the plan to request after a hold, reports."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from construction_twin.core.append_only import AppendOnlyFile, iso_time
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, RequestRefused
from construction_twin.core.reports import SyncReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.monitor.gate import Gate
from construction_twin.monitor.settings import REPLAN
from construction_twin.monitor.states import SyncEvent, SyncState, Transition

#: Plans remembered besides the one that was played last.
MAX_GOALS = 20
#: Rate of `sync` while its state does not change [Hz]. After 0.5 s of silence the executor takes the gate for closed.
SYNC_RATE = 50.0
#: Longest time between two `sync` of an open gate while the command rests [ns]: five nodes read each of them.
RESTING_SYNC = NANOSECONDS // 10
#: Transitions shown on `/diagnostics`, the newest first.
SHOWN = 5


@dataclass(frozen=True)
class ReplanGoal:
    """Goal and pace of a plan.

    Attributes:
        goal: Shape (n,). [rad]
        speed_scale, acceleration_scale: Largest fraction of the limits that the plan uses, at most 1; 0 for a plan that stands
            still.
        last_played: Robot clock when the executor was last known to play it; empty: never. A plan that a person stopped later must
            not be taken up again.
    """

    plan_id: str
    goal: tuple[float, ...]
    speed_scale: float
    acceleration_scale: float
    last_played: str = ""


@dataclass(frozen=True)
class Replan:
    """A plan to request: to the goal of the plan that was interrupted; `violation` says by which hold."""

    held: tuple[float, ...]
    wanted: ReplanGoal
    violation: int


@dataclass(frozen=True)
class _PlayState:
    """The executor's last state: whether it played that plan undisturbed by stop and pause."""

    plan_id: str = ""
    playing: bool = False
    moment: str = ""


class Monitor:
    """The gate with what it needs to know beside setpoints and poses. Not for use from several threads at once.

    Args:
        stopped_in: The session in which a monitor before this one was STOPPED: the gate stays so until the link tells of another.
    """

    def __init__(self, gate: Gate, names: tuple[str, ...], stopped_in: str = "", now: int = 0):
        self.gate, self._names = gate, names
        self._session = stopped_in
        if stopped_in:
            was = Sentence(
                "the monitor before was STOPPED in session {session}; see to it, call reset", session=stopped_in
            )
            gate.fire(SyncEvent.STOPPED_BEFORE, was, now)
        self._goals: dict[str, ReplanGoal] = {}
        self._played = _PlayState()
        #: The executor's sentence while a plan is being executed, at rest or not; empty otherwise.
        self._executing = ""
        self._reported: tuple = ()
        self._sync_at = 0

    @property
    def stopped_in(self) -> str:
        """The session in which the gate is STOPPED; empty while it is not."""
        return self._session if self.gate.state is SyncState.STOPPED else ""

    def on_link(self, session: str, leads: bool, now: int) -> None:
        """Store the link's session, and whether the arm leads; a new session restarts the gate."""
        self.gate.set_mirrored(leads, now)
        if session and session != self._session:
            if self._session:
                self.gate.restart(Sentence("new command session"), now)
            self._session = session

    def configure(self, operator: str, text: str, now: int) -> str:
        """Change settings of the gate, at rest only; return what has changed, or raise RequestRefused."""
        try:
            if not operator.strip():
                raise ConfigurationError("operator", operator, "the name of a person: the change is recorded")
            if self._executing:
                raise ConfigurationError("the executor", self._executing, "no plan that is being executed")
            # before the text is read: whatever reading it costs, it costs at rest
            self.gate.check_rest(now)
            settings = self.gate.settings.with_changes(text)
            difference = self.gate.settings.difference(settings)
            if not difference:
                return "nothing to change"
            self.gate.configure(settings, f"{operator.strip()} changed {difference}", now)
        except ConfigurationError as error:
            raise RequestRefused(f"{str(error)}; nothing was changed") from error
        return f"changed {difference}"

    # -- the re-plan

    def on_plan(
        self, plan_id: str, goal: Sequence[float], velocity_use: Sequence[float], acceleration_use: Sequence[float]
    ) -> None:
        """Store an offered plan's goal, and its use of the limits per joint."""
        speed, acceleration = (min(1.0, max(use, default=0.0)) for use in (velocity_use, acceleration_use))
        self._goals[plan_id] = ReplanGoal(plan_id, tuple(goal), speed, acceleration)
        old = [known for known in self._goals if known not in (self._played.plan_id, plan_id)]
        for known in old[: max(len(old) - MAX_GOALS, 0)]:
            del self._goals[known]

    def on_execution(self, plan_id: str, executing: str, playing: bool, moment: str) -> None:
        """Store the executor's state at a moment: a word while it follows the plan, else empty."""
        self._executing = executing and f"plan {plan_id} is {executing}"
        self._played = _PlayState(plan_id, playing, moment)

    @property
    def interrupted(self) -> ReplanGoal | None:
        """Goal of a re-plan if the gate closed now.

        None when nothing plays: what a person stops or pauses is not taken up by itself. Nor is a plan that stands still.
        """
        played = self._played
        found = self._goals.get(played.plan_id) if played.playing else None
        if found is None or found.speed_scale <= 0.0 or found.acceleration_scale <= 0.0:
            return None
        return replace(found, last_played=played.moment)

    def pop_transitions(self) -> tuple[list[Transition], Replan | None]:
        """Return the gate's transitions, and the plan to request when it has just closed."""
        changes = self.gate.pop_transitions()
        first, wanted = changes[0], self.interrupted
        closed = first.source is SyncState.IN_SYNC and first.target is not SyncState.IN_SYNC
        if not closed or self.gate.policy != REPLAN or wanted is None:
            return changes, None
        asked = Sentence("a path to the goal of plan {plan} was asked for, no faster than that", plan=wanted.plan_id)
        asks = self.gate.fire(SyncEvent.REPLAN_ASKED, asked, first.at)
        changes += self.gate.pop_transitions()
        replan = Replan(self.gate.held, wanted, self.gate.violations)
        return changes, replan if asks else None

    def on_replan_failed(self, replan: Replan, problem: str, now: int) -> None:
        """End the wait for a new plan; no effect in another hold."""
        if self.gate.violations == replan.violation:
            failed = Sentence("re-plan failed: {problem}", problem=problem)
            self.gate.fire(SyncEvent.REPLAN_FAILED, failed, now)

    # -- reports

    def pop_sync_report(self, now: int) -> SyncReport | None:
        """Return the gate's report when it is due: at once in another state, else at `SYNC_RATE`, at rest less often."""
        gate = self.gate
        state = (gate.state, gate.reason, gate.is_agreed(now))
        resting = gate.state is SyncState.IN_SYNC and gate.is_at_rest(now) and not gate.mirrored
        pause = RESTING_SYNC if resting else round(NANOSECONDS / SYNC_RATE)
        if state == self._reported and now - self._sync_at < pause:
            return None
        self._reported, self._sync_at = state, now
        report = SyncReport(
            state=gate.state.value,
            text=gate.state.name,
            reason=gate.reason,
            agreed=state[2],
            policy=gate.policy,
            violations=gate.violations,
            held_stamp=gate.held_stamp,
        )
        last = gate.comparison.last
        if last is None:
            return report
        return replace(
            report,
            comparison=last.mode,
            round_trip=last.round_trip,
            servo_lag=last.servo_lag,
            name=self._names,
            error=last.error,
            threshold=last.threshold,
        )

    def values(self) -> dict[str, object]:
        """Return the gate's values for `/diagnostics`."""
        gate, watch = self.gate, self.gate.servo_watch
        last = gate.comparison.last
        values: dict[str, object] = {
            "policy": gate.policy,
            "comparison": last.mode if last else "none yet",
            "servo lag [s]": f"{last.servo_lag:.6f}" if last else "nan",
            "violations": gate.violations,
            "refused setpoints": gate.refused,
        }
        if watch is None:
            return values | {"servo model": "none: the arm is compared with the twin alone"}
        return values | {
            "servo model": "judges" if watch.judges else "waits until the arm has moved as commanded",
            "compared with it": watch.judged,
            "largest residual": f"{max(watch.largest):.6f}",
            "lag beyond the file [ms]": ", ".join(f"{1e3 * lag:+.2f}" for lag in watch.refinement.added_lags),
        }


class TransitionLogError(ConstructionTwinError):
    """A transition cannot be written; it stays queued."""

    def __init__(self, path: str, problem: str):
        super().__init__(f"{path}: {problem}; transitions are kept in memory until the file can be written")


class TransitionLog:
    """Log of transitions in ROS time: a file of all, and the newest in memory; `fault`: why the file cannot be written."""

    def __init__(self, path: Path, names: tuple[str, ...]):
        self.fault, self._names, self._count = "", names, 0
        self._file = AppendOnlyFile(path, TransitionLogError, "pca_monitor")
        self._recent: deque[Transition] = deque(maxlen=SHOWN)

    def add(self, change: Transition) -> None:
        """Queue a transition for `flush`."""
        self._file.defer(change.at, transition_fields(change, self._names))
        self._recent.appendleft(change)
        self._count += 1

    def flush(self) -> None:
        """Write queued transitions (background thread only)."""
        try:
            self._file.flush()
        except TransitionLogError as error:
            self.fault = str(error)
        else:
            self.fault = ""

    def values(self) -> dict[str, str]:
        """Return the values for `/diagnostics`."""
        recent = enumerate(tuple(self._recent), start=1)
        values = {f"transition {number}": f"{iso_time(change.at)} {change}" for number, change in recent}
        log = {"transition log": str(self._file.path), "transitions lost to the log": str(self._file.lost)}
        return {"transitions": str(self._count)} | values | log


def transition_fields(change: Transition, names: Sequence[str]) -> dict:
    """Return what a line of the log holds of a transition, besides its time; `error` and `threshold` by joint [rad], [m]."""
    last = change.comparison
    return {
        "from": change.source.name,
        "to": change.target.name,
        "event": change.event.value,
        "reason": change.reason,
        "error": _by_joint(names, last.error) if last else {},
        "threshold": _by_joint(names, last.threshold) if last else {},
        "held_stamp_ns": change.held_stamp,
    }


def _by_joint(names: Sequence[str], values: Sequence[float]) -> dict[str, float | None]:
    """Return values by joint name, nan and infinity as None."""
    return {name: value if math.isfinite(value) else None for name, value in zip(names, values)}
