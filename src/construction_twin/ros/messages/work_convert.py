"""Conversions between the messages of work from a building model and the library's values; no parameters, no clock."""

from __future__ import annotations

from construction_twin.msg import Engagement, Execution
from construction_twin.work.engaged_scene import Left
from construction_twin.work.following import Report


def is_playing(message: Execution) -> bool:
    """Return whether the executor says that a plan is under way, paused or held included."""
    return message.state not in (Execution.WAITING, Execution.IDLE)


def report_from_msg(message: Execution) -> Report:
    """Return what the executor says of its plan; an outcome counts only when nothing is under way any more."""
    playing = is_playing(message)
    return Report(
        plan=message.plan_id,
        playing=playing,
        outcome="" if playing else message.outcome,
        segment=message.segment,
        at_boundary=message.at_boundary,
        wants_scene=message.wants_scene,
        reason=message.reason,
    )


def left_from_msg(message: Engagement) -> Left:
    """Return how an arm was left engaged."""
    return Left(message.plan_id, message.segment, tuple(message.scenes))
