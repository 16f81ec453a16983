"""The plan under review, verdicts, and ends of executions. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.robot.plan import Plan, content_hash

APPROVED, REJECTED, REFUSED, WITHDRAWN = "approved", "rejected", "refused", "withdrawn"
#: The reviewer where no person decides: a plan is withdrawn because something that it depends on has changed.
EXECUTOR = "executor"


#: State in the record of a plan that a rehearsal was required of, and that had none.
NOT_REHEARSED = "none"


@dataclass(frozen=True)
class Rehearsed:
    """A plan's rehearsal at its verdict.

    Attributes:
        state: ``passed``, ``failed``, ``broken``, or `NOT_REHEARSED`.
        hash: Of the result; empty without one.
        engine: What simulated, and its version; empty without a result, or where it broke off before.
        overridden: It was approved although a rehearsal was required and this is no pass, by the reviewer, for the reason given.
    """

    state: str
    hash: str
    engine: str = ""
    overridden: bool = False


@dataclass(frozen=True)
class Verdict:
    """A verdict on a plan, with reviewer and reason.

    Attributes:
        verdict: ``approved``, ``rejected``, ``refused`` (an approval that could not be taken) or ``withdrawn`` (by the executor).
        plan_hash: As the reviewer named it; in a refusal it may be empty.
        reason: The reviewer's words; of a refusal, why it was refused.
        rehearsal: What its rehearsal had found; None: there was none, and none was required.
    """

    verdict: str
    plan_id: str
    plan_hash: str
    reviewer: str
    reason: str
    plan: Plan | None = None
    rehearsal: Rehearsed | None = None

    @property
    def approved(self) -> bool:
        """True when it starts an execution."""
        return self.verdict == APPROVED

    @property
    def answer(self) -> Sentence:
        """The sentence for its reviewer, once it was carried out."""
        if self.plan is None or not self.approved:
            return Sentence("plan {plan} rejected by {reviewer}", plan=self.plan_id, reviewer=self.reviewer)
        return Sentence(
            "plan {plan} approved by {reviewer}; it takes {seconds:.3f} s",
            plan=self.plan_id,
            reviewer=self.reviewer,
            seconds=self.plan.trajectory.duration,
        )


@dataclass(frozen=True)
class ExecutionEnd:
    """The end of an execution: ``finished``, ``stopped``, ``held`` or ``dropped``, and why."""

    plan: Plan
    outcome: str
    reason: str


def check_hash(plan: Plan) -> None:
    """Raise ReviewError when a plan's trajectory is not what its hash says. Too slow for the cycle's lock."""
    if content_hash(plan.trajectory, plan.task, plan.segments) != plan.hash:
        values = {"plan": plan.id, "hash": plan.hash}
        raise ReviewError(Sentence("plan {plan} is no longer what its hash {hash} says; plan again", **values))


def _check_rests(plan: Plan) -> None:
    """Check that a work plan rests at the end of each segment, where it waits."""
    trajectory = plan.trajectory
    for segment in plan.segments:
        row = int(trajectory.times.searchsorted(segment.end))
        has_waypoint = row < len(trajectory.times) and trajectory.times[row] == segment.end
        if not has_waypoint or trajectory.velocities[row].any() or trajectory.accelerations[row].any():
            values = {"plan": plan.id, "segment": repr(segment.name), "time": str(segment.end)}
            raise ReviewError(Sentence("plan {plan} does not rest at the end of segment {segment}, {time} s", **values))


class PlanUnderReview:
    """Holds the newest plan until it is approved, rejected, replaced or void.

    An approval covers one execution of one plan, in the scene it was checked against.

    Attributes:
        scene: Hash of the present scene; empty while none is known.
        scene_alive: Whether the scene's publisher is there, which would tell that the scene changes.
    """

    def __init__(self):
        self.plan: Plan | None = None
        self.scene = ""
        self.scene_alive = True
        self._decided: set[str] = set()
        self._void_before = 0

    def offer(self, plan: Plan) -> Plan | None:
        """Put a plan under review, unless it was decided already; return the plan that it replaces.

        ReviewError when it does not start and end at rest, or was asked for before it was last voided.
        """
        trajectory = plan.trajectory
        if any(rows[end].any() for rows in (trajectory.velocities, trajectory.accelerations) for end in (0, -1)):
            raise ReviewError(Sentence("plan {plan} does not start and end at rest; plan again", plan=plan.id))
        _check_rests(plan)
        if plan.id in self._decided or (self.plan is not None and self.plan.id == plan.id):
            return None
        if plan.asked.at < self._void_before:
            raise ReviewError(
                Sentence("plan {plan} was asked for before the last stop, pause or reset; plan again", plan=plan.id)
            )
        replaced = self.clear()
        self.plan = plan
        return replaced

    def void(self, now: int) -> Plan | None:
        """Remove the plan from review, and refuse plans requested before `now` that arrive later; return the removed one."""
        self.void_requests_before(now)
        return self.clear()

    def void_requests_before(self, now: int) -> None:
        """Refuse plans requested before `now` [ns of the clock of `Plan.asked`] that arrive later."""
        self._void_before = now

    def on_scene(self, scene: str) -> Plan | None:
        """Store the scene's hash; return the plan removed from review because it was made for another."""
        changed, self.scene = scene != self.scene, scene
        return self.clear() if changed and self.plan is not None and self.plan.scene != scene else None

    def clear(self) -> Plan | None:
        """Remove the plan from review and return it: it can no longer be approved."""
        plan, self.plan = self.plan, None
        if plan is not None:
            self._decided.add(plan.id)
        return plan

    def decide(self, plan_id: str, plan_hash: str, reviewer: str) -> Plan:
        """Remove the named plan from review for a verdict on it; arguments and errors are those of `check`."""
        plan = self.check(plan_id, plan_hash, reviewer)
        self.clear()
        return plan

    def check(self, plan_id: str, plan_hash: str, reviewer: str) -> Plan:
        """Return the named plan; ReviewError where a verdict on it, or its reviewer's name, is invalid.

        `plan_hash` is that of the plan that was looked at; "" when the reviewer did not compare.
        """
        if not reviewer.strip():
            raise ReviewError(Sentence("a verdict needs the reviewer's name"))
        if plan_id in self._decided:
            raise ReviewError(Sentence("plan {plan} was decided already or withdrawn; plan again", plan=plan_id))
        if self.plan is None:
            raise ReviewError(Sentence("plan {plan} is not under review; no plan is", plan=plan_id))
        if self.plan.id != plan_id:
            plans = {"plan": plan_id, "present": self.plan.id}
            raise ReviewError(Sentence("plan {plan} is not under review; plan {present} is", **plans))
        if plan_hash and plan_hash != self.plan.hash:
            values = {"plan": plan_id, "hash": self.plan.hash, "seen": plan_hash}
            raise ReviewError(Sentence("plan {plan} has hash {hash}, not {seen}; look at it again", **values))
        return self.plan

    def check_scene(self) -> None:
        """Check that the plan under review was made for the present scene."""
        plan = self.plan
        if plan is None:
            raise ReviewError(Sentence("no plan is under review"))
        if not self.scene:
            raise ReviewError(
                Sentence("plan {plan} cannot be approved: no scene is known yet; does its node run?", plan=plan.id)
            )
        if not self.scene_alive:
            raise ReviewError(
                Sentence("plan {plan} cannot be approved: the scene is not published any more", plan=plan.id)
            )
        if plan.scene != self.scene:
            values = {"plan": plan.id, "scene": plan.scene[:12], "present": self.scene[:12]}
            raise ReviewError(
                Sentence("plan {plan} was made for scene {scene}, the present one is {present}; plan again", **values)
            )
