"""Whether a plan is the way back out of an engaged segment: every setpoint on the executed path, in reverse. Pure; rad and m.

Not for the cycle's thread: a plan of ten seconds takes some tenths of a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.execution.engagement import Engagement
from construction_twin.robot.executed_path import LARGEST_ENTRY, WAY_BACK_TOLERANCE, nearest_on_lines
from construction_twin.robot.plan import Plan


def check_way_back(plan: Plan, engagement: Engagement) -> None:
    """Check that a plan goes back along the executed path, from where it starts to where the engaged segments begin.

    It is a work plan of one segment, which requires of the tool what an engagement names, switches nothing and changes no scene.
    It may start up to `LARGEST_ENTRY` beside the path, where a hold or the gateway has brought the arm to rest, and goes to it
    straight.

    Raises:
        ReviewError: Naming what is against it.
    """
    _check_segment(plan, engagement)
    trajectory, path = plan.trajectory, engagement.path
    start = trajectory.positions[0]
    entry = path.entry(start)
    if entry.distance > LARGEST_ENTRY:
        distance = float(entry.distance)
        raise ReviewError(Sentence("review.back.beside", plan=plan.id, distance=distance, most=LARGEST_ENTRY))
    line = np.linspace(0.0, 1.0, 2 + math.ceil(entry.distance / WAY_BACK_TOLERANCE))[:-1, None]
    back = path.points(entry.time)[::-1]
    way = np.vstack((start + line * (back[0] - start), back))
    times = np.append(np.arange(0.0, trajectory.duration, CYCLE), trajectory.duration)
    off = follow(way, trajectory.sample_many(times)[0])
    if off is not None:
        raise ReviewError(Sentence("review.back.leaves", plan=plan.id, time=float(times[off])))


def _check_segment(plan: Plan, engagement: Engagement) -> None:
    where = {"segment": repr(engagement.segment), "left": engagement.plan_id}
    segment = plan.segments[0] if len(plan.segments) == 1 else None
    if segment is None or segment.switches or segment.scene_after != segment.scene:
        raise ReviewError(Sentence("review.back.another", plan=plan.id, **where))
    if all(set(segment.requires) != set(signals) for signals in engagement.holding):
        found = ", ".join(f"{signal.name}={signal.value}" for signal in segment.requires) or "nothing"
        raise ReviewError(Sentence("review.back.tool", plan=plan.id, found=found, **where))
    scenes = engagement.scenes_of(segment.requires)
    if plan.scene not in scenes:
        raise ReviewError(Sentence("review.back.refused", plan=plan.id, problem=scene_problem(plan.scene, scenes)))


def scene_problem(scene: str, scenes: Sequence[str]) -> str:
    """Return why an engaged arm cannot go back in a scene, and what to do, as a clause; `scenes`: those in which it can."""
    wanted = " or ".join(each[:12] for each in scenes) or "none that is known"
    return Sentence("review.back.scene", scene=scene[:12], wanted=wanted)


def follow(way: np.ndarray, poses: np.ndarray) -> int | None:
    """Follow a polyline from its beginning to its end, never backwards.

    Args:
        way: Shape (k, n). Corners, at least two.
        poses: Shape (m, n). Each within `WAY_BACK_TOLERANCE` of the polyline, at or after the place of the one before. Between two
            poses nothing of it may be left out that is further away than their distance.

    Returns:
        Number of the first pose that is not so; None: all of them are, and the last is at the end.
    """
    corner, fraction, last = 0, 0.0, len(way) - 2
    before = poses[0]
    for number, pose in enumerate(poses):
        reach = float(np.abs(pose - before).max()) + 2.0 * WAY_BACK_TOLERANCE
        while True:
            nearest, distance = _ahead(way[corner], way[corner + 1], fraction, pose)
            if distance <= WAY_BACK_TOLERANCE:
                fraction = nearest
                break
            if corner == last or float(np.abs(way[corner + 1] - pose).max()) > reach:
                return number
            corner, fraction = corner + 1, 0.0
        before = pose
    rest = np.abs(way[corner + 1 :] - poses[-1]).max() if corner + 1 < len(way) else 0.0
    return None if rest <= 2.0 * WAY_BACK_TOLERANCE else len(poses) - 1


def _ahead(start: np.ndarray, end: np.ndarray, fraction: float, pose: np.ndarray) -> tuple[float, float]:
    """Return where on a line, not before `fraction`, a pose is nearest, and how far that is."""
    fractions, _ = nearest_on_lines(start[None], end[None], pose)
    nearest = max(float(fractions[0]), fraction)
    return nearest, float(np.abs(start + nearest * (end - start) - pose).max())
