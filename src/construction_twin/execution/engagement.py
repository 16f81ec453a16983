"""Engaged: an arm that was left inside an engaged segment may only go back along the path that it has executed.

Pure. What must be on the disk before the arm moves, and whether it is, stands in `EngagementKeeper`; who writes it tells it so.
Angles in rad, times in s.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from construction_twin.core.errors import ConfigurationError, ReviewError
from construction_twin.core.motion_errors import TrajectoryError
from construction_twin.core.reports import ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.robot.executed_path import LARGEST_ENTRY, WAY_BACK_TOLERANCE, ExecutedPath, nearest_on_lines
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Segment, Signal
from construction_twin.robot.trajectory import Trajectory

#: Of the file's format.
VERSION = 2
Signals = tuple[Signal, ...]
#: What the inputs may read, and for each the hash of its scene.
Holding = tuple[tuple[Signals, ...], tuple[str, ...]]


@dataclass(frozen=True, eq=False)
class Engagement:
    """An engaged segment, and the path into it. Two are the same only if they are one object.

    Attributes:
        path: From the beginning of the engaged segments that follow each other without one that is not engaged.
        holding: What the tool's inputs read while the arm is there: one of these, in the order of time. They differ where a switch
            may have fired; then none is empty, as an empty one would hold whatever is gripped.
        scenes: For each of them the hash of the scene that belongs to it: only there is known what hangs on the tool.
        reason: Why the plan ended inside; empty while it is executed.
    """

    plan_id: str
    task: str
    segment: str
    path: ExecutedPath
    holding: tuple[Signals, ...]
    scenes: tuple[str, ...]
    reason: str = ""

    def requires(self, tool: ToolReport) -> Signals:
        """Return what a way back must require: the last that holds now; the first while none does."""
        return next((signals for signals in reversed(self.holding) if not tool.problem(signals)), self.holding[0])

    def scenes_of(self, requires: Signals) -> tuple[str, ...]:
        """Return the hashes of the scenes in which a way back may require this."""
        return tuple(scene for signals, scene in zip(self.holding, self.scenes) if set(signals) == set(requires))


def engagement_of(plan: Plan, number: int) -> Engagement:
    """Return the engagement of an engaged segment of a work plan that is about to be entered."""
    segment = plan.segments[number]
    first = number
    while first > 0 and plan.segments[first - 1].engaged:
        first -= 1
    begin = plan.segments[first - 1].end if first > 0 else 0.0
    part = part_of(plan.trajectory, begin, segment.end)
    return Engagement(plan.id, plan.task, segment.name, ExecutedPath(part, part.duration), *holding_of(segment))


def left_inside(engagement: Engagement, end: float, holding: Holding, reason: str) -> Engagement:
    """Return an engagement in which the arm was left: `end` is the time along its path [s], the rest as in `Engagement`."""
    path = ExecutedPath(engagement.path.trajectory, min(end, engagement.path.trajectory.duration))
    return replace(engagement, path=path, holding=holding[0], scenes=holding[1], reason=reason)


def part_of(trajectory: Trajectory, begin: float, end: float) -> Trajectory:
    """Return the part of a trajectory between two of its waypoints, by their times [s]."""
    times = trajectory.times
    first, last = (int(abs(times - time).argmin()) for time in (begin, end))
    rows = slice(first, last + 1)
    names, kept = trajectory.joint_names, (trajectory.positions, trajectory.velocities, trajectory.accelerations)
    return Trajectory(names, times[rows] - times[first], *(values[rows] for values in kept))


def holding_of(segment: Segment) -> Holding:
    """Return what the tool's inputs may read inside of a segment or at its end, and the scenes that belong to that."""
    after = tuple(signal for switch in segment.switches for signal in switch.confirm)
    if not segment.switches:
        scenes = tuple(dict.fromkeys((segment.scene, segment.scene_after)))
        return (segment.requires,) * len(scenes), scenes
    if not segment.requires:
        return (after,), (segment.scene_after,)
    return (segment.requires, after), (segment.scene, segment.scene_after)


class EngagementKeeper:
    """Which engagement there is, and which of it is on the disk.

    Attributes:
        present: What must be on the disk. A segment that is engaged is entered only when it is.
        engaged: Whether the arm was left inside of it, so that only the way back may be played.
    """

    def __init__(self):
        self.present: Engagement | None = None
        self.engaged = False
        self._written: Engagement | None = None
        self._unseen = False

    @property
    def settled(self) -> bool:
        """Whether the disk says what is so."""
        return self._written is self.present

    def expect(self, engagement: Engagement | None) -> None:
        """Take the engagement that the arm is about to enter; None: it is about to leave one, or there is none."""
        self.present = engagement

    def leave_inside(self, engagement: Engagement) -> None:
        """The arm was left inside."""
        self.present, self.engaged = engagement, True

    def end(self) -> None:
        """The arm is out, or was freed."""
        self.present, self.engaged = None, False

    def found(self, engagement: Engagement) -> None:
        """Take what the disk says at the start: the executor before this one ended inside."""
        self._written = engagement
        self._unseen = True
        self.leave_inside(engagement)

    def see(self, pose: Sequence[float]) -> None:
        """Take the arm's pose at the start, shape (n,): an arm at the beginning of the path is not inside."""
        if not self._unseen or self.present is None:
            return
        self._unseen = False
        entry = self.present.path.entry(np.asarray(pose, dtype=np.float64))
        begin = self.present.path.trajectory.positions[0]
        near = np.abs(self.present.path.trajectory.sample(entry.time)[0] - begin).max() <= WAY_BACK_TOLERANCE
        # a path that comes by there again has its last passage later
        if entry.distance <= WAY_BACK_TOLERANCE and near and entry.time <= 0.5 * self.present.path.end:
            self.end()

    def on_written(self, engagement: Engagement | None) -> None:
        """Take what is on the disk now."""
        self._written = engagement


# -- the file


def to_text(engagement: Engagement) -> str:
    """Return the file of an engagement: one JSON object, a waypoint per line.

    Written row by row in Python: one call that encodes everything would hold up the other threads for longer than a cycle.
    """
    trajectory = engagement.path.trajectory
    fields = {
        "version": VERSION,
        "plan": engagement.plan_id,
        "task": engagement.task,
        "segment": engagement.segment,
        "reason": engagement.reason,
        "end": engagement.path.end,
        "holding": [[[signal.name, signal.value] for signal in signals] for signals in engagement.holding],
        "scenes": list(engagement.scenes),
        "joints": list(trajectory.joint_names),
    }
    columns = zip(trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations)
    rows = [
        json.dumps([float(time), position.tolist(), velocity.tolist(), acceleration.tolist()], allow_nan=False)
        for time, position, velocity, acceleration in columns
    ]
    return json.dumps(fields, allow_nan=False)[:-1] + ', "waypoints": [\n' + ",\n".join(rows) + "\n]}\n"


def from_text(where: str, text: str, joint_names: Sequence[str]) -> Engagement:
    """Return the engagement that a file tells of.

    Raises:
        ConfigurationError: When it is not one of this version and robot: then nobody knows whether the arm is engaged, and a person
            decides.
    """
    expected = Sentence("expected.engagement")
    try:
        fields = json.loads(text)
        if fields["version"] != VERSION or fields["joints"] != list(joint_names):
            raise ValueError(f"version {fields['version']}, joints {fields['joints']}")
        columns = (np.array(column, dtype=np.float64) for column in zip(*fields["waypoints"], strict=True))
        trajectory = Trajectory(tuple(joint_names), *columns)
        holding = tuple(tuple(Signal(str(n), bool(v)) for n, v in signals) for signals in fields["holding"])
        scenes = tuple(map(str, fields["scenes"]))
        end = float(fields["end"])
        if not holding or len(scenes) != len(holding) or not 0.0 <= end <= trajectory.duration:
            raise ValueError(f"end {end}, {len(holding)} states of the tool, {len(scenes)} scenes")
        words = [fields[name] for name in ("plan", "task", "segment", "reason")]
        if not all(isinstance(word, str) for word in words):
            raise ValueError(f"plan, task, segment and reason {words}")
    except (ValueError, KeyError, TypeError, TrajectoryError) as error:
        raise ConfigurationError(where, f"{type(error).__name__}: {error}", expected) from error
    return Engagement(words[0], words[1], words[2], ExecutedPath(trajectory, end), holding, scenes, words[3])


def check_way_back(plan: Plan, engagement: Engagement) -> None:
    """Check that a plan goes back along the executed path, from where it starts to where the engaged segments begin.

    It is a work plan of one segment, which requires of the tool what an engagement names, switches nothing and changes no scene.
    It may start up to `LARGEST_ENTRY` beside the path, where a hold or the gateway has brought the arm to rest, and goes to it
    straight.
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
