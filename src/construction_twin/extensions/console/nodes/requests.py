"""Motions from planners elsewhere, and plan requests: handed to the planner's own services, and answered. Nothing here moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import genpy
import rospy
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.extensions import import_extension
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.nodes.endpoint import Connection, IncomingRequest, RequestQueue
from construction_twin.link.requests import GoalRequest, Joints, read_goal
from construction_twin.mqtt.requests import NAMELESS_TRAJECTORY, PLAN_REQUEST, TRAJECTORY
from construction_twin.ros.messages.services import PLAN_SERVICES, Outcome
from construction_twin.ros.transport.persistent_service import call
from construction_twin.srv import PlanTrajectoryResponse

#: Motions and plan requests that may wait while one is carried out; a person sends one at a time.
WAITING = 4


class ConsoleRequests:
    """What carries out motions and plan requests, which wait in `queue`.

    Args:
        has_work: Returns whether a building model is worked on.
        is_engaged: Returns whether only the way back can be planned.
        max_trajectory_bytes: Longest motion that is read; 0: neither motions nor plan requests are taken.
    """

    def __init__(
        self,
        joints: Joints,
        services: Mapping[str, rospy.ServiceProxy],
        plan_trajectory: rospy.ServiceProxy,
        connection: Connection,
        max_trajectory_bytes: int,
        has_work: Callable[[], bool],
        is_engaged: Callable[[], bool],
    ):
        self._joints, self._connection = joints, connection
        self._services, self._plan_trajectory = services, plan_trajectory
        self._has_work, self._is_engaged = has_work, is_engaged
        self.queue = RequestQueue(WAITING, PLAN_REQUEST.pace)
        if max_trajectory_bytes:
            for kind in (NAMELESS_TRAJECTORY, TRAJECTORY):
                read = partial(import_extension("planners.remote_trajectory").parse_trajectory, joints=joints)
                connection.serve(replace(kind, limit=max_trajectory_bytes), read, self._check_motion, self.queue)
            connection.serve(PLAN_REQUEST, partial(read_goal, joints=joints), self._plan, self.queue)

    # -- motions

    def _check_motion(self, asked: Any, request: IncomingRequest) -> Outcome:
        """Have a motion, a `TrajectoryRequest` of the extension planners, checked and timed."""
        answer = call(
            self._plan_trajectory,
            "the planner",
            trajectory=trajectory_message(asked, self._joints),
            speed_scale=asked.speed_scale,
            acceleration_scale=asked.acceleration_scale,
            retime=True,
            source=source_of(asked.source, request.account, self._connection.proves_accounts),
        )
        outcome = Outcome.of(answer)
        return replace(outcome, fields={**outcome.fields, "notes": _timing_notes(asked, answer)})

    # -- plan requests

    def _plan(self, asked: GoalRequest, request: IncomingRequest) -> Outcome:
        kind = asked.kind
        if kind == "way_back" and self._has_work() and self._is_engaged():
            # the node `work` makes the scene right before it has the way back planned
            kind = "work_task"
        if kind == "work_task" and not self._has_work():
            return Outcome(
                False, Sentence("no building model is worked on here; start bringup with work_model and work_cell")
            )
        # a stop between the message and its turn voids the plan
        source = source_of("", request.account, self._connection.proves_accounts)
        fields = PLAN_SERVICES[kind].fields(asked, source=source, asked=str(request.arrived))
        return Outcome.of(call(self._services[kind], "its node", **fields))


def source_of(says: str, sender: str, proven: bool) -> str:
    """Return who asked, for the reviewer, with what the sender `says` of itself.

    Args:
        proven: The broker knows accounts, and by a site's rules only this one writes on that topic.
    """
    if not sender:
        known = "MQTT, sender not known"
    else:
        known = f"MQTT account {sender}" if proven else f"MQTT, on the topic of {sender}"
    return f"{known}, which says it is {says!r}" if says else known


def trajectory_message(asked: Any, joints: Joints) -> JointTrajectory:
    """Return the motion as `plan_trajectory` takes it; its header has no stamp, because a foreign clock proves nothing."""
    points = [
        JointTrajectoryPoint(
            positions=point.positions,
            velocities=point.velocities,
            accelerations=point.accelerations,
            time_from_start=genpy.Duration(*divmod(point.time_ns, NANOSECONDS)),
        )
        for point in asked.points
    ]
    return JointTrajectory(joint_names=list(joints.names), points=points)


def _timing_notes(asked: Any, answer: PlanTrajectoryResponse) -> list[str]:
    """Return that the times were replaced, and why, where they were."""
    if not answer.retimed:
        return []
    requested = (asked.points[-1].time_ns - asked.points[0].time_ns) / NANOSECONDS
    return [f"timed anew: {answer.duration:.3f} s instead of {requested:.3f} s, because {answer.retimed}"]
