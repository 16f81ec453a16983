"""Conversions between the messages of work from a building model and the library's values; no parameters, no clock."""

from __future__ import annotations

from construction_twin.msg import Segment as SegmentMsg
from construction_twin.msg import WorkSegment as WorkSegmentMsg
from construction_twin.ros.messages.convert import (
    change_from_msg,
    signal_to_msg,
    switch_from_msg,
    switch_to_msg,
    trajectory_to_msg,
)
from construction_twin.ros.messages.scene_convert import object_to_msg
from construction_twin.work.engaged_scene import Step
from construction_twin.work.following import SegmentEnd
from construction_twin.work.jobs import WorkSegment


def work_segment_to_msg(segment: WorkSegment) -> WorkSegmentMsg:
    """Return the message of a segment that the planner is asked for."""
    return WorkSegmentMsg(
        name=segment.name,
        trajectory=trajectory_to_msg(segment.trajectory),
        engaged=segment.engaged,
        requires=[signal_to_msg(signal) for signal in segment.requires],
        switches=[switch_to_msg(switch) for switch in segment.switches],
        put=[object_to_msg(item) for item in segment.put],
        remove=list(segment.remove),
    )


def step_from_msg(segment: SegmentMsg) -> Step:
    """Return what a segment of a published plan changes.

    Raises:
        SceneError: When an object cannot be read.
    """
    return Step(segment.scene, segment.scene_after, change_from_msg(segment))


def end_from_msg(segment: SegmentMsg) -> SegmentEnd:
    """Return what the end of a published plan's segment does to the grip."""
    carries = any(item.link for item in segment.put)
    return SegmentEnd(tuple(map(switch_from_msg, segment.switches)), carries, segment.engaged)
