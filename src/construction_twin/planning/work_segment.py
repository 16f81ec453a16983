"""A segment of a work plan before it is checked; then it is a `robot.segments.Segment`."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.scene_change import SceneChange


@dataclass(frozen=True, eq=False)
class WorkSegment:
    """One part of a work plan, from rest to rest: `WorkSegment.msg`; the scene changes after the switches."""

    name: str
    trajectory: Trajectory
    engaged: bool = False
    requires: tuple[Signal, ...] = ()
    switches: tuple[Switch, ...] = ()
    change: SceneChange = SceneChange()
