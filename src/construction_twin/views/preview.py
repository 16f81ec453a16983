"""What a reviewer sees of a plan before approving it: a ghost that plays it, its tool path, and what was measured on it.

Pure; joint values in rad (m for a prismatic joint), times in s on any monotonic clock, points in the robot's base frame [m].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from construction_twin.core.errors import ReviewError
from construction_twin.robot.plan import Plan

#: How long a ghost rests at the goal before it plays again [s].
LOOP_REST = 0.5
#: Spacing of the points of the drawn tool path [s], and the most of them.
PATH_SPACING = 0.02
PATH_POINTS = 1000
#: Height of a line of the text [m], and the room between it and the arm below, whose bodies reach beyond its joints.
TEXT_SIZE, TEXT_ROOM = 0.06, 0.55
#: Room that the text of the sync state needs above and below its middle [m].
HEADLINE_ROOM = 0.3


@dataclass(frozen=True)
class Playing:
    """A ghost that plays a plan.

    Attributes
    ----------
    plan : Plan
    began : float
        [s]
    speed : float
        1: as fast as the plan.
    loop : bool
        Play again and again.
    """

    plan: Plan
    began: float
    speed: float
    loop: bool

    def pose(self, now: float) -> tuple[float, ...]:
        """Return where the ghost is at `now` [s]: joint values [rad], [m] for prismatic joints."""
        trajectory, elapsed = self.plan.trajectory, now - self.began
        if self.loop:
            elapsed %= trajectory.duration / self.speed + LOOP_REST
        return tuple(trajectory.sample(min(max(elapsed * self.speed, 0.0), trajectory.duration))[0].tolist())


class Preview:
    """Which plan is shown, and where the ghost is.

    The ghost stands at the goal of the plan under review, and plays it when asked to, from its start. Without a plan under review
    it has the twin's pose and is hidden by it.

    Attributes
    ----------
    plan : Plan or None
        The plan that is shown: under review, or approved and not at its end.
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

        Parameters
        ----------
        speed : float
            1: as fast as the plan; 0 ends the preview.
        loop : bool
            Play it again and again.
        now : float
            [s]

        Raises
        ------
        ReviewError
            If the speed is negative or not finite, or no plan is under review.
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


@dataclass(frozen=True, eq=False)
class PlanPicture:
    """What is drawn of a plan.

    Attributes
    ----------
    path : array, shape (m, 3)
        Positions of the tool.
    closest : tuple of float, length 3, or None
        Where the arm comes closest to anything; None when there is nothing to touch.
    text : str
        Some lines for the reviewer.
    text_at : tuple of float, length 3
    """

    path: np.ndarray
    closest: tuple[float, float, float] | None
    text: str
    text_at: tuple[float, float, float]


def picture(plan: Plan, skeleton: Callable[[np.ndarray], np.ndarray], headline: float) -> PlanPicture:
    """Return what is to be drawn of a plan.

    The text hangs above all that moves, so that the arm does not hide it.

    Parameters
    ----------
    plan : Plan
    skeleton : callable
        Returns the points from the base through all joints to the tool, shape (m, 3), for joint values, shape (n,).
    headline : float
        Height of the text of the sync state, which this one keeps clear of [m].

    Returns
    -------
    picture : PlanPicture
    """
    trajectory = plan.trajectory
    points = min(max(math.ceil(trajectory.duration / PATH_SPACING) + 1, 2), PATH_POINTS)
    poses = trajectory.sample_many(np.linspace(0.0, trajectory.duration, points))[0]
    arms = np.array([skeleton(q) for q in poses])
    path = arms[:, -1]
    top = arms.reshape(-1, 3)[np.argmax(arms[:, :, 2])]
    clearance = plan.report.clearance
    closest = clearance.point if math.isfinite(clearance.distance) else None
    text = describe(plan)
    height = _text_height(float(top[2]), text.count("\n") + 1, headline)
    return PlanPicture(path, closest, text, (float(top[0]), float(top[1]), height))


def _text_height(top: float, lines: int, headline: float) -> float:
    """Return the middle of a text of some lines [m], as rviz centres it: over the arm, and not across the headline."""
    half = lines * TEXT_SIZE / 2
    middle = top + TEXT_ROOM + half
    return middle if middle + half < headline - HEADLINE_ROOM else max(middle, headline + HEADLINE_ROOM + half)


def describe(plan: Plan) -> str:
    """Return the plan's duration, closest clearance and largest fractions of the limits, some lines of text."""
    clearance, fractions = plan.report.clearance, plan.report.usage
    lines = [f"{plan.trajectory.duration:.2f} s, {plan.planner} for {plan.source}"]
    if math.isfinite(clearance.distance):
        where = ", ".join(f"{value:.2f}" for value in clearance.point)
        between = " to ".join(clearance.between)
        lines.append(f"closest {clearance.distance:.3f} m, {between}, after {clearance.time:.2f} s at ({where}) m")
    else:
        lines.append("nothing to touch")
    lines.append("largest fraction of velocity / acceleration / jerk:")
    rows = zip(plan.trajectory.joint_names, fractions.velocity, fractions.acceleration, fractions.jerk)
    lines += [
        f"{joint}: {velocity:.0%} / {acceleration:.0%} / {jerk:.0%}" for joint, velocity, acceleration, jerk in rows
    ]
    return "\n".join(lines)
