"""Segments of a plan on one trajectory, which rests between them for the tool and the scene; times in s from its start."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass

from construction_twin.robot.motion_errors import TrajectoryError


@dataclass(frozen=True)
class Signal:
    """An input of the tool file, and what it must read."""

    name: str
    value: bool


@dataclass(frozen=True)
class Switch:
    """An output of the tool that is switched at rest, and what all inputs in `confirm` must read within `timeout` [s] after it."""

    output: str
    value: bool
    confirm: tuple[Signal, ...]
    timeout: float

    def __post_init__(self):
        # 2 and 2.0 are equal, but would give different hashes
        object.__setattr__(self, "timeout", float(self.timeout))


@dataclass(frozen=True)
class Segment:
    """One part of a plan, from rest to rest.

    Attributes:
        end: In the plan's trajectory [s].
        engaged: After a stop inside of it, nothing but the way back along the executed path may be planned.
        requires: What the tool's inputs must read during all of it.
        switches: Fired together at its end.
        scene, scene_after: Hash of the scene while it is executed, and after its switches: that of the next segment.
    """

    name: str
    end: float
    engaged: bool
    requires: tuple[Signal, ...]
    switches: tuple[Switch, ...]
    scene: str
    scene_after: str

    def __post_init__(self):
        object.__setattr__(self, "end", float(self.end))


def segments_hash(trajectory_hash: str, task: str, segments: tuple[Segment, ...]) -> str:
    """Return the SHA-256 (hex) over a trajectory's hash, the task, and the ordered segments with switches and scenes."""
    return hashlib.sha256(segments_content(trajectory_hash, task, segments).encode()).hexdigest()


def segments_content(trajectory_hash: str, task: str, segments: tuple[Segment, ...]) -> str:
    """Return the JSON that `segments_hash` covers."""
    content = {"trajectory": trajectory_hash, "task": task, "segments": [asdict(segment) for segment in segments]}
    return json.dumps(content, sort_keys=True, allow_nan=False)


def check_segments(plan_id: str, scene: str, duration: float, segments: tuple[Segment, ...]) -> None:
    """Check that segments fill a trajectory and that each begins in the scene (hash) in which the one before ended."""
    before, present = 0.0, scene
    for number, segment in enumerate(segments, start=1):
        if not math.isfinite(segment.end) or segment.end <= before:
            raise TrajectoryError(
                f"plan {plan_id}, segment {number} ('{segment.name}') ends at {segment.end} s; expected after {before}"
                " s"
            )
        if segment.scene != present:
            raise TrajectoryError(
                f"plan {plan_id}, segment {number} ('{segment.name}') is for scene {segment.scene[:12]}; the "
                f"one before it leaves {present[:12]}"
            )
        for switch in segment.switches:
            if not (math.isfinite(switch.timeout) and switch.timeout > 0.0):
                raise TrajectoryError(
                    f"plan {plan_id}, segment {number} ('{segment.name}'): {switch.output} has {switch.timeout} s "
                    "to be confirmed; expected above 0"
                )
        before, present = segment.end, segment.scene_after
    if segments and before != duration:
        raise TrajectoryError(f"plan {plan_id}: its last segment ends at {before} s, its trajectory at {duration} s")
