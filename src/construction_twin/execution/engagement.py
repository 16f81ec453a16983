"""Engaged: an arm that was left inside an engaged segment may only go back along the path that it has executed.

Pure. What must be on the disk before the arm moves, and whether it is, stands in `EngagementKeeper`; who writes it tells it so.
Angles in rad, times in s.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.motion_errors import TrajectoryError
from construction_twin.core.reports import ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.robot.executed_path import WAY_BACK_TOLERANCE, ExecutedPath
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
        plan_id, task, segment: Of the work plan; the segment's name.
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
    """Return the engagement of an engaged segment of a work plan that is about to be entered.

    Args:
        number: Of the segment.
    """
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
