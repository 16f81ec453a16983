"""How a verdict is taken. An approval is examined, recorded, and only then carried out; a rejection is carried out at once, and its
record follows: no disk stands before a person's no. Pure; recording and the clock are arguments.

An approval is void `core.freshness.LIFETIME` after the moment that its screen had shown, or after it was called where no screen
says one: it is looked at when it comes, after its record was written, and until the plan begins to move. A plan whose approval is
void before it is played stays under review; one that was played and has not moved ends. A rejection is never too old.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from construction_twin.core.errors import ExpiredError, RecordError, ReviewError
from construction_twin.core.freshness import LIFETIME, Moment, staleness
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.executor import Executor
from construction_twin.review.plan_under_review import APPROVED, REFUSED, REJECTED, Ending, Verdict, prove_hash
from construction_twin.robot.plan import Plan

#: Reviewer of a plan that was approved without a person, because of a launch argument.
AUTO_APPROVE = "auto_approve"
#: The scene that a plan was made for may be announced this long after the plan [ns].
SCENE_DELAY = NANOSECONDS


@dataclass(frozen=True)
class WithoutPerson:
    """Which plans need no person.

    Attributes:
        sources: Sources of plans, or the names of clients that they end with: `/move_group` stands for ``... from /move_group``.
            Whoever asks for a plan chooses these words: they are no proof of who it was.
    """

    every: bool = False
    sources: tuple[str, ...] = ()

    def reason(self, source: str) -> str:
        """Return why a plan of this source needs no person, for the record; "" when it needs one."""
        if self.every:
            return Sentence("review.by_itself")
        for name in self.sources:
            if source == name or source.endswith(f" from {name}"):
                return Sentence("review.by_source", name=name, source=repr(source))
        return ""


@dataclass(frozen=True)
class Taken:
    """A verdict that was carried out: an approval after its record, a rejection before it."""

    verdict: Verdict
    sentence: str


class Approval:
    """The only way to start an execution: an approval is carried out only after it was recorded.

    Recording waits for a disk, so it happens outside of the lock that the executor's loop takes every 4 ms.

    Args:
        record: Called with each approval before it is carried out, with one that is refused, and with the Ending of an execution
            that could then not begin; raises RecordError when it cannot be kept. A rejection's record is the caller's.
        lock: Held around every use of the executor.
        clock: Returns the present moment.
    """

    def __init__(
        self,
        executor: Executor,
        record: Callable[[Verdict | Ending], None],
        lock: AbstractContextManager,
        clock: Callable[[], Moment],
    ):
        self._executor = executor
        self._record = record
        self._lock = lock
        self._clock = clock
        # one verdict after the other: the record must keep the order in which verdicts took effect
        self._one_verdict_at_a_time = threading.RLock()
        # of the plan that waits, for `approve_by_itself`: its id, and when it was seen first [ns]
        self._waiting, self._waits_since = "", 0

    def review(
        self,
        plan_id: str,
        plan_hash: str,
        approve: bool,
        reviewer: str,
        reason: str = "",
        seen: Moment | None = None,
        override: str | None = None,
    ) -> Taken:
        """Carry out a verdict: an approval after it was recorded, a rejection at once.

        Args:
            seen: The newest that the reviewer's screen had received; without one this call counts.
            override: Of an approval: although a rehearsal is required that is missing or was no pass; the hash of the result that
                the reviewer saw, "" where there was none. It needs the plan's hash, a reason, and something to override:
                whoever has this right alone approves nothing else by it. A result that came since is not overridden.

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
            return Taken(verdict, Sentence("review.rejected", plan=plan_id, reviewer=reviewer))
        # before the verdicts that are waited for
        moment = self._clock() if seen is None else seen
        with self._one_verdict_at_a_time:
            try:
                self._demand_fresh(moment)
                self._prove(plan_id)
                with self._lock:
                    verdict = self._examine(plan_id, plan_hash, True, reviewer, reason, override)
            except ReviewError as error:
                self._refuse(plan_id, plan_hash, reviewer, error.sentence)
                raise
            self._record(verdict)
            try:
                with self._lock:
                    return Taken(verdict, self._begin_approved(verdict, moment))
            except ReviewError as error:
                # something happened while it was written down: the record is corrected
                if verdict.plan is not None:
                    reason = Sentence("review.not_started", reason=error.sentence)
                    self._record(Ending(verdict.plan, "dropped", reason))
                raise

    def approve_by_itself(self, now: int, which: WithoutPerson = WithoutPerson(every=True)) -> Taken | None:
        """Approve the waiting plan as soon as it may start; withdraw it when it may not. None: there is nothing to do yet.

        Args:
            now: [ns]
            which: Which plans need no person; by default every one.

        Raises:
            RecordError: When it cannot be recorded; the plan is withdrawn.
        """
        with self._lock:
            plan = self._executor.under_review.plan if self._executor.is_ready() else None
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
                self._withdraw(plan.id, Sentence("review.not_by_itself", reason=error.sentence))
            if isinstance(error, RecordError):
                raise
            return None

    def _examine(
        self, plan_id: str, plan_hash: str, approve: bool, reviewer: str, reason: str, override: str | None = None
    ) -> Verdict:
        """Return the verdict that could be carried out now; an approval at the wrong moment leaves the plan under review."""
        plan = self._executor.under_review.check(plan_id, plan_hash, reviewer)
        overridden = override is not None
        if approve:
            self._executor.check_start(plan, overridden)
        rehearsal = self._executor.rehearsal.on_record(plan, overridden)
        if override is not None:
            self._check_override(plan, plan_hash, reason, override)
        return Verdict(APPROVED if approve else REJECTED, plan.id, plan.hash, reviewer, reason, plan, rehearsal)

    def _check_override(self, plan: Plan, plan_hash: str, reason: str, seen: str) -> None:
        """Raise ReviewError when there is nothing to override, or it is not what was seen, or the reviewer does not say why."""
        problem = self._executor.rehearsal_problem(plan)
        if not problem:
            raise ReviewError(Sentence("review.rehearsal.nothing", plan=plan.id))
        if not plan_hash:
            raise ReviewError(Sentence("review.rehearsal.unhashed", plan=plan.id))
        report = self._executor.rehearsal.of(plan)
        if seen != (report.hash if report is not None else ""):
            raise ReviewError(Sentence("review.rehearsal.unseen", plan=plan.id, now=problem))
        if not reason.strip():
            raise ReviewError(Sentence("review.rehearsal.unreasoned", plan=plan.id))

    def _demand_fresh(self, moment: Moment) -> int:
        """Return how long an approval may still wait for motion [ns]; ExpiredError when that is over."""
        now = self._clock()
        if problem := staleness(moment, now):
            raise ExpiredError(Sentence("executor.void.approval", problem=problem))
        return LIFETIME - (now.at - moment.at)

    def _begin_approved(self, verdict: Verdict, moment: Moment) -> str:
        """Begin what an approval that was recorded is for, if it still may; return a sentence."""
        left = self._demand_fresh(moment)
        known = verdict.rehearsal
        override = known.hash if known is not None and known.overridden else None
        self._examine(verdict.plan_id, verdict.plan_hash, True, verdict.reviewer, verdict.reason, override)
        plan = self._executor.under_review.decide(verdict.plan_id, verdict.plan_hash, verdict.reviewer)
        who = {"reviewer": verdict.reviewer}
        self._executor.begin(plan, Sentence("executor.approved", **who), left)
        return Sentence("review.approved", plan=plan.id, seconds=plan.trajectory.duration, **who)

    def _withdraw(self, plan_id: str, reason: str) -> None:
        """Take a plan out of review, if it is still there."""
        executor = self._executor
        if executor.under_review.plan is not None and executor.under_review.plan.id == plan_id:
            executor.tell_withdrawn(executor.under_review.clear(), reason)

    def _prove(self, plan_id: str) -> None:
        """Prove the named plan's hash once, outside of the lock: a plan cannot change, so that it holds when it is carried out."""
        with self._lock:
            plan = self._executor.under_review.plan
        if plan is not None and plan.id == plan_id:
            prove_hash(plan)

    def _refuse(self, plan_id: str, plan_hash: str, reviewer: str, reason: str) -> None:
        with self._lock:
            plan = self._executor.under_review.plan
            known = plan if plan is not None and plan.id == plan_id else None
            rehearsal = self._executor.rehearsal.on_record(known, False) if known is not None else None
        self._record(Verdict(REFUSED, plan_id, plan_hash, reviewer, reason, known, rehearsal))
