"""Engaged: an arm that was left inside an engaged segment may only go back along the path that it has executed.

What must be on the disk before the arm moves, and whether it is, stands in `EngagementStore`. Angles in rad, times in s.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from construction_twin.core.errors import ConfigurationError, ExecutionError, ReviewError, system_message
from construction_twin.core.files import read_file, write_atomically
from construction_twin.core.reports import ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.robot.executed_path import LARGEST_ENTRY, WAY_BACK_TOLERANCE, ExecutedPath, nearest_on_lines
from construction_twin.robot.motion_errors import TrajectoryError
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Segment, Signal
from construction_twin.robot.trajectory import Trajectory

#: What to do where an arm was left engaged.
_BY_HAND = Sentence("free the arm by hand and call release_engagement")
REMEDY = Sentence("call plan_way_back, or {by_hand}", by_hand=_BY_HAND)
#: Of the file's format.
VERSION = 3
#: Fields of an engagement that are texts.
TEXT_FIELDS = ("plan_id", "task", "segment", "reason")
#: Largest file [bytes]: a path of some minutes.
MOST = 64 * 2**20
Signals = tuple[Signal, ...]
#: What the tool's inputs may read, and the hash of the scene that belongs to it: only there is known what hangs on the tool.
Holding = tuple[tuple[Signals, str], ...]


@dataclass(frozen=True, eq=False)
class Engagement:
    """An engaged segment, and the path into it. Two are the same only if they are one object.

    Attributes:
        path: From the beginning of the engaged segments that follow each other.
        holding: What the tool's inputs read while the arm is there: one of these, in the order of time, none of them empty where a
            switch may have fired.
        reason: Why the plan ended inside; empty while it is executed.
    """

    plan_id: str
    task: str
    segment: str
    path: ExecutedPath
    holding: Holding
    reason: str = ""

    def requires(self, tool: ToolReport) -> Signals:
        """Return the signals that a way back requires: the last of `holding` that the tool reads, else the first."""
        return next((one for one, _ in reversed(self.holding) if not tool.mismatch(one)), self.holding[0][0])

    def scenes_of(self, requires: Signals) -> tuple[str, ...]:
        """Return the hashes of the scenes in which a way back may require this."""
        return tuple(scene for signals, scene in self.holding if set(signals) == set(requires))


def engagement_of(plan: Plan, number: int) -> Engagement:
    """Return the engagement of an engaged segment of a work plan that is about to be entered."""
    segment = plan.segments[number]
    first = number
    while first > 0 and plan.segments[first - 1].engaged:
        first -= 1
    begin = plan.segments[first - 1].end if first > 0 else 0.0
    whole = plan.trajectory
    rows = slice(*(int(abs(whole.times - time).argmin()) + last for time, last in ((begin, 0), (segment.end, 1))))
    columns = (whole.positions, whole.velocities, whole.accelerations)
    times = whole.times[rows] - whole.times[rows][0]
    part = Trajectory(whole.joint_names, times, *(column[rows] for column in columns))
    return Engagement(plan.id, plan.task, segment.name, ExecutedPath(part, part.duration), holding_of(segment))


def holding_of(segment: Segment) -> Holding:
    """Return the possible readings of the tool's inputs in a segment and at its end, with their scenes."""
    if not segment.switches:
        return tuple((segment.requires, scene) for scene in dict.fromkeys((segment.scene, segment.scene_after)))
    after = tuple(signal for switch in segment.switches for signal in switch.confirm)
    before = ((segment.requires, segment.scene),) if segment.requires else ()
    return *before, (after, segment.scene_after)


class EngagementStore:
    """The present engagement, and the one on the disk, which outlasts the executor.

    Attributes:
        present: What must be on the disk. A segment that is engaged is entered only when it is.
        engaged: Whether the arm was left inside of it, so that only the way back may be played.
        written: What is on the disk.
        way_back: Id of the plan that `check_way_back` has found to be the way back, and out of which engagement; None: of none.
    """

    def __init__(self, found: Engagement | None = None):
        self.present = self.written = found
        self.engaged = self._pose_unknown = found is not None
        self.way_back: tuple[str, Engagement] | None = None

    @property
    def active(self) -> Engagement | None:
        """The engagement in which the arm was left; None: not engaged."""
        return self.present if self.engaged else None

    @property
    def sentence(self) -> str:
        """Where the arm was left and what to do; empty: not engaged."""
        active = self.active
        if active is None:
            return ""
        values = {"segment": repr(active.segment), "plan": active.plan_id, "reason": active.reason, "remedy": REMEDY}
        return Sentence("the arm was left in engaged segment {segment} of plan {plan} ({reason}); {remedy}", **values)

    def is_way_back(self, plan: Plan) -> bool:
        """Return whether a plan is the way back of the engaged arm."""
        return self.engaged and self.way_back == (plan.id, self.present)

    @property
    def saved(self) -> bool:
        """Whether `present` is on the disk."""
        return self.written is self.present

    def save(self, lock: AbstractContextManager, file: Path) -> None:
        """Save `present`; holds the lock only to read and to confirm it. Raises ExecutionError."""
        with lock:
            present, saved = self.present, self.saved
        if not saved:
            write_engagement(file, present)
            with lock:
                self.written = present

    def mark_engaged(self, engagement: Engagement) -> None:
        """Record that the arm was left inside."""
        self.present, self.engaged = engagement, True

    def clear(self) -> None:
        """Record that the arm is out, or was freed."""
        self.present, self.engaged = None, False

    def on_pose(self, pose: Sequence[float]) -> None:
        """Clear the engagement where the first pose, shape (n,), is at the beginning of its path."""
        if not self._pose_unknown or self.present is None:
            return
        self._pose_unknown = False
        path = self.present.path
        entry = path.nearest_point(np.asarray(pose, dtype=np.float64))
        away = np.abs(path.trajectory.sample(entry.time)[0] - path.trajectory.positions[0]).max()
        # a path that comes by there again has its last passage later
        if max(entry.distance, away) <= WAY_BACK_TOLERANCE and entry.time <= 0.5 * path.end:
            self.clear()


# -- the file, there as long as the arm is inside an engaged segment


def write_engagement(path: Path, engagement: Engagement | None) -> None:
    """Write an engagement as one JSON object, a waypoint per line; None: remove the file.

    Row by row in Python: one call that encodes everything would hold up the other threads for longer than a cycle.
    """
    try:
        if engagement is None:
            path.unlink(missing_ok=True)
            return
        trajectory = engagement.path.trajectory
        fields = {
            "version": VERSION,
            **{name: getattr(engagement, name) for name in TEXT_FIELDS},
            "end": engagement.path.end,
            "holding": [
                [[[signal.name, signal.value] for signal in signals], scene] for signals, scene in engagement.holding
            ],
            "joints": list(trajectory.joint_names),
        }
        columns = zip(trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations)
        rows = [json.dumps([float(time), *(values.tolist() for values in row)]) for time, *row in columns]
        write_atomically(path, json.dumps(fields)[:-1] + ', "waypoints": [\n' + ",\n".join(rows) + "\n]}\n")
    except OSError as error:
        values = {"path": str(path), "problem": error.strerror or str(error)}
        raise ExecutionError(
            Sentence("{path}: {problem}: where the arm may be left is not on the disk; mend it", **values)
        ) from error


def read_engagement(path: Path, joint_names: Sequence[str]) -> Engagement | None:
    """Read the engagement file; None: no file. ConfigurationError: unknown whether the arm is engaged."""
    try:
        fields = json.loads(read_file(path, MOST))
        if fields["version"] != VERSION or fields["joints"] != list(joint_names):
            raise ValueError(f"version {fields['version']}, joints {fields['joints']}")
        columns = (np.array(column, dtype=np.float64) for column in zip(*fields["waypoints"], strict=True))
        trajectory = Trajectory(tuple(joint_names), *columns)
        holding = tuple(
            (tuple(Signal(str(name), bool(value)) for name, value in signals), str(scene))
            for signals, scene in fields["holding"]
        )
        end, words = float(fields["end"]), {name: fields[name] for name in TEXT_FIELDS}
        if not holding or not 0.0 <= end <= trajectory.duration:
            raise ValueError(f"end {end}, {len(holding)} states of the tool")
        if not all(isinstance(word, str) for word in words.values()):
            raise ValueError(str(words))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, TrajectoryError) as error:
        expected = "the file that an executor of this robot wrote; free the arm, and only then delete the file"
        raise ConfigurationError(str(path), f"{type(error).__name__}: {system_message(error)}", expected) from error
    engagement = Engagement(path=ExecutedPath(trajectory, end), holding=holding, **words)
    # one that was only expected
    return engagement if engagement.reason else replace(engagement, reason="the executor ended before the plan did")


def check_way_back(plan: Plan, engagement: Engagement) -> None:
    """Check that a plan goes back along the executed path, from where it starts to where the engaged segments begin.

    It is a work plan of one segment, which requires of the tool what an engagement names, switches nothing and changes no scene.
    It may start up to `LARGEST_ENTRY` beside the path, and goes to it straight.
    """
    segment = plan.segments[0] if len(plan.segments) == 1 else None
    if segment is None or segment.switches or segment.scene_after != segment.scene:
        left = Sentence("segment {segment} of plan {plan}", segment=repr(engagement.segment), plan=engagement.plan_id)
        values = {"plan": plan.id, "left": left, "remedy": REMEDY}
        raise ReviewError(Sentence("plan {plan} is not the way back out of {left}: {remedy}", **values))
    if all(set(segment.requires) != set(signals) for signals, _ in engagement.holding):
        found = ", ".join(f"{signal.name}={signal.value}" for signal in segment.requires) or "nothing"
        values = {"plan": plan.id, "found": found, "remedy": REMEDY}
        raise ReviewError(Sentence("plan {plan} requires {found} of the tool, not what it held: {remedy}", **values))
    scenes = engagement.scenes_of(segment.requires)
    if plan.scene not in scenes:
        problem = scene_obstacle(plan.scene, scenes)
        raise ReviewError(Sentence("plan {plan} is not the way back: {problem}", plan=plan.id, problem=problem))
    trajectory, path = plan.trajectory, engagement.path
    start = trajectory.positions[0]
    entry = path.nearest_point(start)
    if entry.distance > LARGEST_ENTRY:
        raise ReviewError(
            Sentence(
                "plan {plan} starts {distance:.4f} rad (or m) beside the executed path, expected at most {most:g}: {remedy}",
                plan=plan.id,
                distance=float(entry.distance),
                most=LARGEST_ENTRY,
                remedy=_BY_HAND,
            )
        )
    line = np.linspace(0.0, 1.0, 2 + math.ceil(entry.distance / WAY_BACK_TOLERANCE))[:-1, None]
    back = path.points(entry.time)[::-1]
    way = np.vstack((start + line * (back[0] - start), back))
    times = np.append(np.arange(0.0, trajectory.duration, CYCLE), trajectory.duration)
    off = first_deviation(way, trajectory.sample_many(times)[0])
    if off is not None:
        raise ReviewError(
            Sentence(
                "plan {plan} leaves the executed path {time:.3f} s after its start: {remedy}",
                plan=plan.id,
                time=float(times[off]),
                remedy=REMEDY,
            )
        )


def scene_obstacle(scene: str, scenes: Sequence[str]) -> str:
    """Return why an engaged arm cannot go back in a scene, and what to do, as a clause; `scenes`: those in which it can."""
    wanted = " or ".join(each[:12] for each in scenes) or "none that is known"
    found = {"scene": scene[:12], "wanted": wanted, "by_hand": _BY_HAND}
    return Sentence(
        "scene {scene} does not say what the tool holds; it must become {wanted} first, or {by_hand}", **found
    )


def first_deviation(way: np.ndarray, poses: np.ndarray) -> int | None:
    """Return the index of the first of the poses, shape (m, n), off a polyline with corners of shape (k, n); None: none is.

    They must go along it to its end, never back: a pose is off that is further than `WAY_BACK_TOLERANCE` from the remaining line,
    or leaves out what is further away than the distance of two poses; so is the last one, short of the end.
    """
    corner, fraction, last = 0, 0.0, len(way) - 2
    before = poses[0]
    for number, pose in enumerate(poses):
        reach = float(np.abs(pose - before).max()) + 2.0 * WAY_BACK_TOLERANCE
        while True:
            start, end = way[corner], way[corner + 1]
            # not before the place of the pose before
            nearest = max(float(nearest_on_lines(start[None], end[None], pose)[0][0]), fraction)
            if np.abs(start + nearest * (end - start) - pose).max() <= WAY_BACK_TOLERANCE:
                fraction = nearest
                break
            if corner == last or float(np.abs(end - pose).max()) > reach:
                return number
            corner, fraction = corner + 1, 0.0
        before = pose
    rest = np.abs(way[corner + 1 :] - poses[-1]).max() if corner + 1 < len(way) else 0.0
    return None if rest <= 2.0 * WAY_BACK_TOLERANCE else len(poses) - 1
