"""What a reviewer sees of a plan before approving it: a ghost that plays it, its tool path, and what was measured on it.

Pure; joint values in rad (m for a prismatic joint), times in s on any monotonic clock, points in the robot's base frame [m].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.core.errors import ReviewError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.plan import Plan
from construction_twin.scene.scene_change import SceneChange
from construction_twin.views.texts import between
from construction_twin.views.work_picture import WorkPath, WorkStates, cut, segment_words, work_path

#: How long a ghost rests at the goal before it plays again [s].
LOOP_REST = 0.5
#: Spacing of the points of the drawn tool path [s], and the most of them.
PATH_SPACING = 0.02
PATH_POINTS = 1000
#: Height of a line of the text [m], and the room between it and the arm below, whose bodies reach beyond its joints.
TEXT_SIZE, TEXT_ROOM = 0.06, 0.55
#: Most segments of a work plan that the text lists.
MOST_ROWS = 12
#: Room that the text of the sync state needs above and below its middle [m].
HEADLINE_ROOM = 0.3


@dataclass(frozen=True)
class Playing:
    """A ghost that plays a plan.

    Attributes:
        began: [s]
        speed: 1: as fast as the plan.
        loop: Play again and again.
    """

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
    """Which plan is shown, and where the ghost is.

    The ghost stands at the goal of the plan under review, and plays it when asked to, from its start. Without a plan under review
    it has the twin's pose and is hidden by it.

    Attributes:
        plan: The plan that is shown: under review, or approved and not at its end.
    """

    def __init__(self):
        self.plan: Plan | None = None
        self._twin: tuple[float, ...] | None = None
        self._playing: Playing | None = None
        self._approved: set[str] = set()
        self._over: set[str] = set()

    @property
    def under_review(self) -> Plan | None:
        """The plan that can be played."""
        return None if self.plan is None or self.plan.id in self._approved else self.plan

    def on_plan(self, plan: Plan) -> None:
        """Show a plan in place of the previous one, unless it was rejected or has ended already."""
        if plan.id not in self._over and (self.plan is None or self.plan.id != plan.id):
            self.plan, self._playing = plan, None

    def on_verdict(self, plan_id: str, approved: bool) -> None:
        """Take a verdict: an approved plan stays drawn until its execution ends, a rejected one disappears."""
        if not approved:
            self.on_ending(plan_id)
            return
        self._approved.add(plan_id)
        if self.plan is not None and self.plan.id == plan_id:
            self._playing = None

    def on_ending(self, plan_id: str) -> None:
        """Take the end of a plan: it is no longer shown."""
        self._over.add(plan_id)
        if self.plan is not None and self.plan.id == plan_id:
            self.plan = self._playing = None

    def on_twin(self, q: tuple[float, ...]) -> None:
        """Take the twin's pose [rad]."""
        self._twin = q

    def play(self, speed: float, loop: bool, now: float) -> str:
        """Let the ghost play the plan under review from its start; return one sentence.

        Args:
            speed: 1: as fast as the plan; 0 ends the preview.
            loop: Play it again and again.
            now: [s]

        Raises:
            ReviewError: If the speed is negative or not finite, or no plan is under review.
        """
        if not 0.0 <= speed < math.inf:
            raise ReviewError(f"a preview at speed {speed} was asked for; expected a positive number, or 0 to end it")
        if speed == 0.0:
            self._playing = None
            return "the preview has ended"
        plan = self.under_review
        if plan is None:
            raise ReviewError("no plan is under review; plan first, then preview it")
        self._playing = Playing(plan, now, speed, loop)
        again = ", again and again" if loop else ""
        return f"the ghost plays plan {plan.id} in {plan.trajectory.duration / speed:.3f} s{again}; nothing moves"

    def pose(self, now: float) -> tuple[float, ...] | None:
        """Return where the ghost is at `now` [s]; None while the twin's pose is unknown and no plan is under review."""
        if self._playing is not None:
            return self._playing.pose(now)
        if self.under_review is not None:
            return tuple(self.under_review.trajectory.positions[-1].tolist())
        return self._twin

    def segment(self, now: float) -> int | None:
        """Return the number of the segment that the ghost plays at `now` [s]; None when it plays none of a work plan."""
        playing = self._playing
        if playing is None or not playing.plan.segments:
            return None
        elapsed = playing.elapsed(now)
        if elapsed >= playing.plan.trajectory.duration:
            return None
        return next(number for number, segment in enumerate(playing.plan.segments) if elapsed < segment.end)


@dataclass(frozen=True, eq=False)
class WorkContext:
    """What is known of a work plan's objects.

    Attributes:
        forward: Returns the tip's pose in the base, for joint values of shape (n,).
        tip: Name of the tip link.
    """

    changes: Sequence[SceneChange]
    states: WorkStates
    forward: Callable[[np.ndarray], Pose]
    tip: str


@dataclass(frozen=True, eq=False)
class PlanPicture:
    """What is drawn of a plan.

    Attributes:
        path: Shape (m, 3). Positions of the tool.
        closest: Length 3. Where the arm comes closest to anything; None when there is nothing to touch.
        text: Some lines for the reviewer.
        text_at: Length 3
        work: Of a work plan.
    """

    path: np.ndarray
    closest: tuple[float, float, float] | None
    text: str
    text_at: tuple[float, float, float]
    work: WorkPath | None = None


def picture(
    plan: Plan,
    skeleton: Callable[[np.ndarray], np.ndarray],
    headline: float,
    told: WorkContext | None = None,
) -> PlanPicture:
    """Return what is to be drawn of a plan.

    The text hangs above all that moves, so that the arm does not hide it.

    Args:
        skeleton: Returns the points from the base through all joints to the tool, shape (m, 3), for joint values, shape (n,).
        headline: Height of the text of the sync state, which this one keeps clear of [m].
        told: What is known of a work plan's objects; without it, only its tool path is drawn.
    """
    trajectory = plan.trajectory
    points = min(max(math.ceil(trajectory.duration / PATH_SPACING) + 1, 2), PATH_POINTS)
    poses = trajectory.sample_many(np.linspace(0.0, trajectory.duration, points))[0]
    arms = np.array([skeleton(q) for q in poses])
    path = arms[:, -1]
    top = arms.reshape(-1, 3)[np.argmax(arms[:, :, 2])]
    clearance = plan.report.clearance
    closest = clearance.point if math.isfinite(clearance.distance) else None
    work = None
    if told is not None and plan.segments:
        work = work_path(plan, told.states, told.forward, told.tip, PATH_SPACING, PATH_POINTS)
    text = describe(plan) if told is None else describe_work(plan, told)
    height = _text_height(float(top[2]), text.count("\n") + 1, headline)
    return PlanPicture(path, closest, text, (float(top[0]), float(top[1]), height), work)


def _text_height(top: float, lines: int, headline: float) -> float:
    """Return the middle of a text of some lines [m], as rviz centres it: over the arm, and not across the headline."""
    half = lines * TEXT_SIZE / 2
    middle = top + TEXT_ROOM + half
    return middle if middle + half < headline - HEADLINE_ROOM else max(middle, headline + HEADLINE_ROOM + half)


def describe(plan: Plan) -> str:
    """Return the plan's duration, closest clearance and largest fractions of the limits, some lines of text."""
    fractions = plan.report.usage
    lines = [_headline(plan), _closest(plan), "largest fraction of velocity / acceleration / jerk:"]
    rows = zip(plan.trajectory.joint_names, fractions.velocity, fractions.acceleration, fractions.jerk)
    lines += [
        f"{joint}: {velocity:.0%} / {acceleration:.0%} / {jerk:.0%}" for joint, velocity, acceleration, jerk in rows
    ]
    return "\n".join(lines)


def describe_work(plan: Plan, told: WorkContext) -> str:
    """Return a work plan's task, its segments and what was measured, one line each: shorter about the joints than `describe`."""
    lines = [
        _headline(plan),
        f"task {cut(plan.task)}: {len(plan.segments)} segments, blue: engaged",
    ]
    if told.states.problem:
        lines.append(f"LOOK TWICE: {told.states.problem}")
    begin = 0.0
    changes = [*told.changes, *[None] * (len(plan.segments) - len(told.changes))]
    for number, (segment, change) in enumerate(zip(plan.segments, changes)):
        if number < MOST_ROWS:
            words = segment_words(segment, change)
            lines.append(", ".join([f"{number + 1} {cut(segment.name)} {segment.end - begin:.2f} s", *words]))
        begin = segment.end
    if len(plan.segments) > MOST_ROWS:
        lines.append(f"and {len(plan.segments) - MOST_ROWS} more")
    usage = plan.report.usage
    largest = " / ".join(
        f"{max(values, default=0.0):.0%}" for values in (usage.velocity, usage.acceleration, usage.jerk)
    )
    lines += [_closest(plan), f"largest fraction of velocity / acceleration / jerk: {largest}"]
    return "\n".join(lines)


def _headline(plan: Plan) -> str:
    return f"{plan.trajectory.duration:.2f} s, {plan.planner} for {plan.source}"


def _closest(plan: Plan) -> str:
    clearance = plan.report.clearance
    if not math.isfinite(clearance.distance):
        return "nothing to touch"
    where, bodies = ", ".join(f"{value:.2f}" for value in clearance.point), between(clearance.between)
    return f"closest {clearance.distance:.3f} m, {bodies}, after {clearance.time:.2f} s at ({where}) m"
