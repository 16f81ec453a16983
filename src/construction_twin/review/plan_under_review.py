"""Review: which plan is under review, what was decided about it, and what became of it. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.errors import ReviewError
from construction_twin.robot.plan import Plan, content_hash

APPROVED, REJECTED, REFUSED, WITHDRAWN = "approved", "rejected", "refused", "withdrawn"
#: The reviewer where no person decides: a plan is withdrawn because something that it depends on has changed.
EXECUTOR = "executor"


@dataclass(frozen=True)
class Verdict:
    """What was decided about a plan, by whom and why.

    Attributes:
        verdict: ``approved``, ``rejected``, ``refused`` (an approval that could not be taken) or ``withdrawn`` (by the executor).
        plan_id, plan_hash: As the reviewer named them; the hash may be empty in a refusal.
        reviewer, reason: The reviewer's words; of a refusal, why it was refused.
        plan: The plan, where it was known.
    """

    verdict: str
    plan_id: str
    plan_hash: str
    reviewer: str
    reason: str
    plan: Plan | None = None

    @property
    def approved(self) -> bool:
        """True when it starts an execution."""
        return self.verdict == APPROVED


@dataclass(frozen=True)
class Ending:
    """What became of an execution: ``finished``, ``stopped``, ``held`` or ``dropped``, and why."""

    plan: Plan
    outcome: str
    reason: str


def prove_hash(plan: Plan) -> None:
    """Raise ReviewError when a plan's trajectory is not what its hash says. Too slow for the cycle's lock."""
    if content_hash(plan.trajectory, plan.task, plan.segments) != plan.hash:
        raise ReviewError(f"plan {plan.id} is no longer what its hash {plan.hash} says; plan again")


def _check_rests(plan: Plan) -> None:
    """Raise ReviewError when a work plan does not rest at the end of each segment: there it stands for as long as it takes."""
    trajectory = plan.trajectory
    for segment in plan.segments:
        row = int(trajectory.times.searchsorted(segment.end))
        where = f"plan {plan.id} does not rest at the end of segment {segment.name!r}, {segment.end} s"
        if row == len(trajectory.times) or trajectory.times[row] != segment.end:
            raise ReviewError(f"{where}, where it has no waypoint; plan again")
        if trajectory.velocities[row].any() or trajectory.accelerations[row].any():
            raise ReviewError(f"{where}; plan again")


class PlanUnderReview:
    """Holds the newest plan until it is approved, rejected, replaced or void.

    An approval covers one execution of one plan, in the scene it was checked against.

    Attributes:
        plan: Under review.
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

        Raises:
            ReviewError: When it, or one of its segments, does not start and end at rest, or was asked for before the queue was last
                voided. (That a plan's hash is that of its content is the Plan's own matter.)
        """
        trajectory = plan.trajectory
        if any(rows[end].any() for rows in (trajectory.velocities, trajectory.accelerations) for end in (0, -1)):
            raise ReviewError(f"plan {plan.id} does not start and end at rest; plan again")
        _check_rests(plan)
        if plan.id in self._decided or (self.plan is not None and self.plan.id == plan.id):
            return None
        if plan.created_ns < self._void_before:
            raise ReviewError(
                f"plan {plan.id} was asked for before the last stop, pause or reset and is void; plan again"
            )
        replaced = self.clear()
        self.plan = plan
        return replaced

    def void(self, now: int) -> Plan | None:
        """Clear the queue and refuse plans asked for until `now` [ns] that are not here yet; return what lay there."""
        self.void_coming(now)
        return self.clear()

    def void_coming(self, now: int) -> None:
        """Refuse plans asked for until `now` [ns] that are not here yet."""
        self._void_before = now

    def on_scene(self, scene: str) -> Plan | None:
        """Take the present scene's hash; return the plan taken out of review because it was made for another."""
        changed, self.scene = scene != self.scene, scene
        return self.clear() if changed and self.plan is not None and self.plan.scene != scene else None

    def clear(self) -> Plan | None:
        """Take the plan out of review and return it: it can no longer be approved."""
        plan, self.plan = self.plan, None
        if plan is not None:
            self._decided.add(plan.id)
        return plan

    def decide(self, plan_id: str, plan_hash: str, reviewer: str) -> Plan:
        """Take the named plan out of review to carry out a verdict on it.

        Args:
            plan_hash: Hash of the plan that was looked at; "" when the reviewer did not compare.
            reviewer: Must not be empty.

        Raises ReviewError.
        """
        plan = self.check(plan_id, plan_hash, reviewer)
        self.clear()
        return plan

    def check(self, plan_id: str, plan_hash: str, reviewer: str) -> Plan:
        """Return the named plan; raise ReviewError when a verdict on it by this reviewer cannot be taken."""
        if not reviewer.strip():
            raise ReviewError("a verdict needs the reviewer's name")
        if plan_id in self._decided:
            raise ReviewError(
                f"plan {plan_id} was decided already or withdrawn; an approval covers one execution, plan again"
            )
        if self.plan is None or self.plan.id != plan_id:
            waiting = f"plan {self.plan.id} is" if self.plan else "no plan is"
            raise ReviewError(f"plan {plan_id} is not under review; {waiting}")
        if plan_hash and plan_hash != self.plan.hash:
            raise ReviewError(f"plan {plan_id} has hash {self.plan.hash}, not {plan_hash}; look at it again")
        return self.plan

    def check_scene(self) -> None:
        """Raise ReviewError when the plan under review must not be executed: no scene is known, or it was made for another."""
        plan = self.plan
        if plan is None:
            raise ReviewError("no plan is under review")
        if not self.scene:
            raise ReviewError(
                f"plan {plan.id} cannot be approved: no scene is known yet; check that the scene node runs"
            )
        if not self.scene_alive:
            raise ReviewError(
                f"plan {plan.id} cannot be approved: the scene is not published any more; check that the scene node runs"
            )
        if plan.scene != self.scene:
            raise ReviewError(
                f"plan {plan.id} was made for scene {plan.scene[:12]}, the present one is {self.scene[:12]}; plan again"
            )
