"""A reviewer's preview of a plan: a ghost that plays it, and a work plan's changes of the objects. Pure; rad, m, s."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from construction_twin.core.errors import ReviewError
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.plan import Plan
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

#: How long a ghost rests at the goal before it plays again [s].
LOOP_REST = 0.5


@dataclass(frozen=True)
class PreviewRun:
    """A plan that the ghost plays since `began` [s]."""

    plan: Plan
    began: float
    speed: float
    loop: bool

    def pose(self, now: float) -> tuple[float, ...]:
        """Return where the ghost is at `now` [s]: joint values [rad], [m] for prismatic joints."""
        return tuple(self.plan.trajectory.sample(self.elapsed(now))[0].tolist())

    def elapsed(self, now: float) -> float:
        """Return the time along the plan at `now`, both in s."""
        elapsed = now - self.began
        if self.loop:
            elapsed %= self.plan.trajectory.duration / self.speed + LOOP_REST
        return min(max(elapsed * self.speed, 0.0), self.plan.trajectory.duration)


class Preview:
    """Which plan is shown, under review or approved and not at its end, and where the ghost is.

    It stands at the goal of the plan under review, and plays it when asked to; else it has the twin's pose, and is hidden by it.
    """

    def __init__(self):
        self.plan: Plan | None = None
        self._twin: tuple[float, ...] | None = None
        self._run: PreviewRun | None = None
        self._approved: set[str] = set()
        self._over: set[str] = set()

    @property
    def under_review(self) -> Plan | None:
        """The plan that can be played."""
        return None if self.plan is None or self.plan.id in self._approved else self.plan

    def on_plan(self, plan: Plan) -> None:
        """Show a plan in place of the previous one, unless it was rejected or has ended already."""
        if plan.id not in self._over and (self.plan is None or self.plan.id != plan.id):
            self.plan, self._run = plan, None

    def on_verdict(self, plan_id: str, approved: bool) -> None:
        """Handle a verdict: an approved plan stays drawn until its execution ends, a rejected one disappears."""
        if not approved:
            self.on_ending(plan_id)
            return
        self._approved.add(plan_id)
        if self.plan is not None and self.plan.id == plan_id:
            self._run = None

    def on_ending(self, plan_id: str) -> None:
        """Remove a plan whose execution has ended."""
        self._over.add(plan_id)
        if self.plan is not None and self.plan.id == plan_id:
            self.plan = self._run = None

    def on_twin(self, q: tuple[float, ...]) -> None:
        """Store the twin's pose [rad]."""
        self._twin = q

    def play(self, speed: float, loop: bool, now: float) -> str:
        """Play the plan under review with the ghost, at `speed` times its own; 0 ends the preview. ReviewError where it cannot."""
        if not 0.0 <= speed < math.inf:
            raise ReviewError(f"a preview at speed {speed} was asked for; expected a positive number, or 0 to end it")
        if speed == 0.0:
            self._run = None
            return "the preview has ended"
        plan = self.under_review
        if plan is None:
            raise ReviewError("no plan is under review; plan first, then preview it")
        self._run = PreviewRun(plan, now, speed, loop)
        again = ", again and again" if loop else ""
        return f"the ghost plays plan {plan.id} in {plan.trajectory.duration / speed:.3f} s{again}; nothing moves"

    def pose(self, now: float) -> tuple[float, ...] | None:
        """Return where the ghost is at `now` [s]; None while the twin's pose is unknown and no plan is under review."""
        if self._run is not None:
            return self._run.pose(now)
        if self.under_review is not None:
            return tuple(self.under_review.trajectory.positions[-1].tolist())
        return self._twin

    def segment(self, now: float) -> int | None:
        """Return the number of the segment that the ghost plays at `now` [s]; None when it plays none of a work plan."""
        run = self._run
        if run is None or not run.plan.segments:
            return None
        elapsed = run.elapsed(now)
        if elapsed >= run.plan.trajectory.duration:
            return None
        return next(number for number, segment in enumerate(run.plan.segments) if elapsed < segment.end)


@dataclass(frozen=True)
class WorkStates:
    """The objects that a work plan moves.

    `carried`: in each segment, and in the end; `placed`: what stands elsewhere then, or is new; `problem`: why that may not be so.
    """

    carried: tuple[tuple[SceneObject, ...], ...]
    placed: tuple[SceneObject, ...]
    problem: str = ""

    def loads(self, number: int) -> tuple[SceneObject, ...]:
        """Return what the arm carries in segment `number` but not in all of them: the element, not the tool."""
        always = set.intersection(*({item.name for item in held} for held in self.carried))
        return tuple(item for item in self.carried[number] if item.name not in always)


def work_states(plan: Plan, changes: Sequence[SceneChange], scene: Scene | None) -> WorkStates:
    """Return what a work plan does to the objects; without the scene that it begins in, only what the changes say is known."""
    known = scene is not None and scene.hash == plan.scene
    present = scene if scene is not None and known else Scene()
    before = {item.name: item for item in present.objects}
    segment_changes = [*changes, *[SceneChange()] * (len(plan.segments) - len(changes))]
    carried, problem = [], "" if known else "the scene that the plan begins in is not known here"
    for segment, change in zip(plan.segments, segment_changes):
        carried.append(tuple(item for item in present.objects if item.link))
        present = _after(present, change)
        if known and not problem and present.hash != segment.scene_after:
            problem = f"after {segment.name!r} the scene is to be another one than drawn here"
    carried.append(tuple(item for item in present.objects if item.link))
    placed = tuple(item for item in present.objects if not item.link and before.get(item.name) != item)
    return WorkStates(tuple(carried), placed, problem)


def _after(scene: Scene, change: SceneChange) -> Scene:
    gone = set(change.remove) & set(scene.names)
    try:
        return SceneChange(change.put, tuple(sorted(gone))).apply(scene)
    except SceneError:
        return scene
