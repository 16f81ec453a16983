"""Acts that need a person's fresh consent: approval, resume, release of an engaged arm. Pure; record and clock are arguments.

An approval, or a release, is examined, recorded, and only then carried out; a rejection is carried out at once, and its record
follows: no disk stands before a person's no.

An approval is void `core.freshness.LIFETIME` after the moment that its screen had shown, or after it was called where no screen
says one: it is looked at when it comes, after its record was written, and until the plan begins to move. A plan whose approval is
void before it is played stays under review; one that was played and has not moved ends. A rejection is never too old.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from construction_twin.core.errors import ExecutionError, ExpiredError, RecordError, ReviewError
from construction_twin.core.freshness import LIFETIME, Moment, staleness
from construction_twin.core.limits import outside_tolerance
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.engagement import Engagement, check_way_back
from construction_twin.execution.executor import Executor
from construction_twin.execution.playback import START_TOLERANCE
from construction_twin.execution.segment_run import tool_missing, tool_pending
from construction_twin.execution.states import ACTIVE, ExecutorState
from construction_twin.monitor.states import SyncState
from construction_twin.review.plan_under_review import APPROVED, REFUSED, REJECTED, ExecutionEnd, Verdict, check_hash
from construction_twin.review.record import Release
from construction_twin.review.rehearsal_report import RehearsalCheck
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan

#: Reviewer of a plan that was approved without a person, because of a launch argument.
AUTO_APPROVE = "auto_approve"
#: The scene that a plan was made for may be announced this long after the plan [ns].
SCENE_DELAY = NANOSECONDS
#: A verdict counts this long [ns]; the watch repeats it ten times a second.
VERDICT_TIMEOUT = NANOSECONDS // 2


class ConflictVerdicts:
    """The newest verdict of the watch over the robot `name` ("": none) on a plan. `now` is on one clock [ns]."""

    def __init__(self, name: str = ""):
        self.name = name
        self._plan_id, self._obstacle, self._at = "", "", 0

    def on_verdict(self, plan_id: str, problem: str, now: int) -> None:
        """Store a verdict: the conflict of a plan; empty: its path is free."""
        self._plan_id, self._obstacle, self._at = plan_id, problem, now

    def obstacle(self, plan_id: str, now: int) -> str:
        """Return the sentence against a plan's start; empty for none."""
        if not self.name:
            return ""
        if self._plan_id != plan_id:
            return Sentence("its path was not checked against {name} yet; does `neighbour` run?", name=self.name)
        if now - self._at > VERDICT_TIMEOUT:
            return Sentence("its path is not checked against {name} any more; does `neighbour` run?", name=self.name)
        return self._obstacle


@dataclass(frozen=True)
class AutoApproval:
    """Automatic approval of plans by their sources, or by the clients' names that these end with.

    Whoever asks for a plan chooses these words: they are no proof of who it was.
    """

    every: bool = False
    sources: tuple[str, ...] = ()

    def reason(self, source: str) -> str:
        """Return the reason for an automatic approval, for the record; "": a person decides."""
        if self.every:
            return Sentence("the launch argument auto_approve is on")
        for name in self.sources:
            if source == name or source.endswith(f" from {name}"):
                return Sentence(
                    "auto_approve_sources names {name}, and the plan is of {source}", name=name, source=repr(source)
                )
        return ""


def check_start_pose(plan: Plan, pose: tuple[float, ...], robot: RobotModel) -> None:
    """Check that a plan starts at a pose, shape (n,) [rad]."""
    start = tuple(plan.trajectory.positions[0])
    off = outside_tolerance(start, pose, START_TOLERANCE)
    if off is not None:
        raise ReviewError(
            Sentence(
                "plan {plan} starts {distance} from the present pose at {joint}; plan again",
                plan=plan.id,
                distance=Quantity(start[off] - pose[off], "m" if robot.linear[off] else "rad"),
                joint=robot.joint_names[off],
            )
        )


class Approval:
    """The only way to start an execution: an approval is carried out only after it was recorded.

    Recording waits for a disk, so it happens outside of the `lock` that is held around every use of the executor.

    Args:
        record: Called with each approval and release before it is carried out, with one that is refused, and with the end of an
            execution that could then not begin. A rejection's record is the caller's.
        clock: Returns the present moment.

    Attributes:
        neighbour, rehearsal: Whether another arm blocks the path of a plan; whether a plan has passed its rehearsal.
        obstacle: Why the plan under review could not be approved; empty: it could, or none is.
        overridable: Whether only its rehearsal is against it.
    """

    def __init__(
        self,
        executor: Executor,
        record: Callable[[Verdict | ExecutionEnd | Release], None],
        lock: AbstractContextManager,
        clock: Callable[[], Moment],
    ):
        self._executor = executor
        self._record = record
        self._lock = lock
        self._clock = clock
        self.neighbour, self.rehearsal = ConflictVerdicts(), RehearsalCheck()
        self.obstacle, self.overridable = "", False
        self._started = clock()
        # one verdict after the other: the record must keep the order in which verdicts took effect
        self._verdict_lock = threading.RLock()
        # of the plan that waits, for `approve_automatically`: its id, and when it was seen first [ns]
        self._waiting, self._waits_since = "", 0

    def offer(self, plan: Plan) -> None:
        """Put a plan under review; a refused one (ReviewError) is reported as withdrawn, so that displays remove it."""
        try:
            if plan.asked.origin != self._started.origin:
                raise ReviewError(
                    Sentence(
                        "plan {plan} was asked for on another computer, or before its start; plan again", plan=plan.id
                    )
                )
            if plan.asked.at < self._started.at:
                raise ReviewError(Sentence("plan {plan} is older than this executor; plan again", plan=plan.id))
            with self._lock:
                active = self._executor.engagement.active
            if active is not None:
                # outside of the lock: it takes many cycles' time
                check_way_back(plan, active)
            with self._lock:
                self._executor.offer(plan, active)
        except ReviewError as error:
            with self._lock:
                self._executor.record_withdrawal(plan, str(error))
            raise

    def review(
        self,
        plan_id: str,
        plan_hash: str,
        approve: bool,
        reviewer: str,
        reason: str = "",
        seen: Moment | None = None,
        override: str | None = None,
    ) -> Verdict:
        """Carry out a verdict and return it: an approval after it was recorded, a rejection at once.

        Args:
            seen: The newest that the reviewer's screen had received; without one this call counts.
            override: Of an approval without a pass of its rehearsal: the hash of the result that the reviewer saw, "" where there
                was none. It needs the plan's hash, a reason, and something to override. A later result is not overridden.

        Raises:
            ReviewError: When it cannot be taken; a refused approval is recorded too.
            ExpiredError: When it is too old to be carried out.
            RecordError: When an approval cannot be recorded; then nothing happens.
        """
        if not approve:
            # never behind an approval whose record waits for a disk: that one is void then
            with self._lock:
                verdict = self._examine(plan_id, plan_hash, False, reviewer, reason)
                self._executor.reject(verdict)
            return verdict
        # before the verdicts that are waited for
        moment = self._clock() if seen is None else seen
        with self._verdict_lock:
            try:
                self._approval_time_left(moment)
                with self._lock:
                    plan = self._executor.under_review.plan
                if plan is not None and plan.id == plan_id:
                    # once, outside of the lock: a plan cannot change, so that it holds when it is carried out
                    check_hash(plan)
                with self._lock:
                    verdict = self._examine(plan_id, plan_hash, True, reviewer, reason, override)
            except ReviewError as error:
                self._refuse(plan_id, plan_hash, reviewer, str(error))
                raise
            self._record(verdict)
            try:
                with self._lock:
                    self._begin_approved(verdict, moment)
                return verdict
            except ReviewError as error:
                # something happened while it was written down: the record is corrected
                if verdict.plan is not None:
                    reason = Sentence("not started: {reason}", reason=str(error))
                    self._record(ExecutionEnd(verdict.plan, "dropped", reason))
                raise

    def approve_automatically(self, now: int, which: AutoApproval = AutoApproval(every=True)) -> Verdict | None:
        """Approve the waiting plan as soon as it may start, or withdraw it. None: still waiting.

        `which` says which plans need no person. RecordError when it cannot be recorded; the plan is withdrawn.
        """
        with self._lock:
            plan = self._executor.under_review.plan if self.is_ready() else None
            scene = self._executor.under_review.scene
        reason = which.reason(plan.source) if plan is not None else ""
        if plan is None or not reason:
            return None
        if self._waiting != plan.id:
            self._waiting, self._waits_since = plan.id, now
        if plan.scene != scene and now - self._waits_since <= SCENE_DELAY:
            return None
        try:
            return self.review(plan.id, plan.hash, True, AUTO_APPROVE, reason)
        except ReviewError as error:
            with self._lock:
                review = self._executor.under_review
                if review.plan is not None and review.plan.id == plan.id:
                    why = Sentence("auto_approve: {reason}", reason=str(error))
                    self._executor.record_withdrawal(review.clear(), why)
            if isinstance(error, RecordError):
                raise
            return None

    def resume(self, seen: Moment | None = None) -> str:
        """Go on after a pause; return one sentence.

        What the person's screen had `seen` is of after the newest pause or stop; None: the person is at this computer.
        """
        with self._lock:
            if seen is None:
                return self._executor.resume()
            left, problem = self._time_left(seen)
            if problem:
                raise ExpiredError(Sentence("the resume is {problem}", problem=problem))
            if seen.at <= self._executor.rested:
                raise ExpiredError(
                    Sentence("the resume is void: the arm was paused or stopped since; look, and ask anew")
                )
            return self._executor.resume(left)

    def release(self, person: str, reason: str) -> str:
        """Record and end an engagement in the name of a person who has freed the arm; return one sentence."""
        if not person or not reason:
            raise ExecutionError(Sentence("a release needs the name of a person, and how the arm was freed"))
        with self._lock:
            active = self._releasable()
        release = Release(person, reason, active.plan_id, active.task, active.segment)
        asked = self._clock()
        self._record(release)
        try:
            if problem := self._time_left(asked)[1]:
                raise ExpiredError(Sentence("the release is {problem}", problem=problem))
            with self._lock:
                if self._releasable() is not active:
                    raise ExecutionError(Sentence("the arm was left in another engaged segment meanwhile; look again"))
                self._executor.engagement.clear()
        except (ExecutionError, ExpiredError) as error:
            # something happened while it was written down: the record is corrected
            self._record(replace(release, refused=str(error)))
            raise
        return Sentence(
            "the arm, left in segment {segment} of plan {plan}, was freed by {person}: {reason}",
            segment=repr(active.segment),
            plan=active.plan_id,
            person=person,
            reason=reason,
        )

    # -- what is against it

    def update_obstacle(self) -> None:
        """Update the obstacle to an approval now, and whether an override of the rehearsal would remove it."""
        with self._lock:
            plan = self._executor.under_review.plan
            self.obstacle, self.overridable = "", False
            if plan is None:
                return
            for override in (False, True):
                try:
                    self._check_start(plan, override)
                except ReviewError as error:
                    self.obstacle = self.obstacle or str(error)
                else:
                    self.overridable = override
                    return

    def is_ready(self) -> bool:
        """Return whether executor, gate, link, scene, tool, rehearsal and other arm are ready for the plan. Under the lock."""
        executor, review = self._executor, self._executor.under_review
        plan, back = review.plan, executor.engagement.is_way_back
        idle = executor.state is ExecutorState.IDLE and executor.sync is SyncState.IN_SYNC and not executor.unarmed
        if not idle or plan is None or not review.scene or not review.scene_alive:
            return False
        if tool_pending(executor.tool, plan) or (self.rehearsal.lacks_result(plan) and not back(plan)):
            return False
        return not self.neighbour.obstacle(plan.id, executor.now)

    def _check_start(self, plan: Plan, override: bool) -> None:
        """Raise ReviewError where the plan under review may not start now, naming what is against it."""
        executor, tool = self._executor, self._executor.tool
        if executor.state is not ExecutorState.IDLE:
            values = {"state": executor.state.name, "reason": executor.reason}
            raise ReviewError(Sentence("the executor is {state} ({reason}); approve when it is idle", **values))
        if executor.sync is not SyncState.IN_SYNC:
            state = executor.sync.name
            raise ReviewError(
                Sentence("twin and physical arm are not in sync ({state}); approve when they are", state=state)
            )
        if executor.unarmed:
            raise ReviewError(Sentence("the arm is not armed ({reason}); approve when it is", reason=executor.unarmed))
        problem = self.neighbour.obstacle(plan.id, executor.now)
        engagement = executor.engagement
        if not problem and engagement.engaged and not engagement.is_way_back(plan):
            problem = engagement.sentence
        if not problem and plan.segments:
            first = plan.segments[0].requires
            problem = tool_missing(tool, plan) or tool.mismatch(first)
            if not problem and engagement.active is not None and set(first) != set(engagement.active.requires(tool)):
                problem = Sentence("the tool reads something else since the way back was planned; call plan_way_back")
        if problem:
            raise ReviewError(Sentence("plan {plan} may not start: {reason}", plan=plan.id, reason=problem))
        executor.under_review.check_scene()
        if not override and (unrehearsed := self._rehearsal_obstacle(plan)):
            raise ReviewError(unrehearsed)
        assert executor.setpoint is not None  # in IDLE there always is one
        check_start_pose(plan, executor.setpoint, executor.robot)

    def _rehearsal_obstacle(self, plan: Plan) -> str:
        """Return the rehearsal's objection to a plan; empty for none, and for the way back."""
        return "" if self._executor.engagement.is_way_back(plan) else self.rehearsal.obstacle(plan)

    def _releasable(self) -> Engagement:
        """Return the engagement that can be ended now."""
        active, plan = self._executor.engagement.active, self._executor.plan
        if active is None:
            raise ExecutionError(Sentence("the arm is not engaged; there is nothing to release"))
        if self._executor.state in ACTIVE and plan is not None:
            values = {"plan": plan.id, "state": self._executor.state.name}
            raise ExecutionError(Sentence("plan {plan} is {state}; release the arm when it is at rest", **values))
        return active

    def _examine(
        self, plan_id: str, plan_hash: str, approve: bool, reviewer: str, reason: str, override: str | None = None
    ) -> Verdict:
        """Return the verdict that could be carried out now; an approval at the wrong moment leaves the plan under review."""
        plan = self._executor.under_review.check(plan_id, plan_hash, reviewer)
        overridden = override is not None
        if approve:
            self._check_start(plan, overridden)
        rehearsal = self.rehearsal.rehearsed(plan, overridden)
        if override is not None:
            self._check_override(plan, plan_hash, reason, override)
        return Verdict(APPROVED if approve else REJECTED, plan.id, plan.hash, reviewer, reason, plan, rehearsal)

    def _check_override(self, plan: Plan, plan_hash: str, reason: str, seen: str) -> None:
        """Check an override: a result that needs one, the same that was seen, and a reason."""
        problem = self._rehearsal_obstacle(plan)
        if not problem:
            raise ReviewError(
                Sentence("plan {plan} needs no rehearsal, or has passed it: nothing to override", plan=plan.id)
            )
        if not plan_hash:
            raise ReviewError(Sentence("to override the rehearsal of plan {plan}, name the plan's hash", plan=plan.id))
        report = self.rehearsal.report_of(plan)
        if seen != (report.hash if report is not None else ""):
            now = Sentence(
                "the rehearsal of plan {plan} says something else than was seen: {now}", plan=plan.id, now=problem
            )
            raise ReviewError(now)
        if not reason.strip():
            raise ReviewError(Sentence("to override the rehearsal of plan {plan}, say why", plan=plan.id))

    def _time_left(self, moment: Moment) -> tuple[int, str]:
        """Return how long an approval may still wait for motion [ns], and why it has expired; "" while it has not."""
        now = self._clock()
        return LIFETIME - (now.at - moment.at), staleness(moment, now)

    def _approval_time_left(self, moment: Moment) -> int:
        left, problem = self._time_left(moment)
        if problem:
            raise ExpiredError(Sentence("the approval is {problem}", problem=problem))
        return left

    def _begin_approved(self, verdict: Verdict, moment: Moment) -> None:
        """Begin the plan of a recorded approval, after a second check."""
        left, known = self._approval_time_left(moment), verdict.rehearsal
        override = known.hash if known is not None and known.overridden else None
        self._examine(verdict.plan_id, verdict.plan_hash, True, verdict.reviewer, verdict.reason, override)
        plan = self._executor.under_review.decide(verdict.plan_id, verdict.plan_hash, verdict.reviewer)
        self._executor.begin(plan, Sentence("approved by {reviewer}", reviewer=verdict.reviewer), left)

    def _refuse(self, plan_id: str, plan_hash: str, reviewer: str, reason: str) -> None:
        with self._lock:
            plan = self._executor.under_review.plan
            known = plan if plan is not None and plan.id == plan_id else None
            rehearsal = self.rehearsal.rehearsed(known, False) if known is not None else None
        self._record(Verdict(REFUSED, plan_id, plan_hash, reviewer, reason, known, rehearsal))
