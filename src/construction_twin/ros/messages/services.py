"""Services between nodes: fields of requests, the services that make plans, outcomes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from geometry_msgs.msg import Point, PoseStamped, Quaternion
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from construction_twin.kinematics.chain import Pose
from construction_twin.link.requests import GoalRequest
from construction_twin.msg import CartesianWaypoint
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.ros.messages.records import sentence_of, with_sentences
from construction_twin.srv import PlanCartesian, PlanToJoints, PlanToPose, PlanTrajectory, WorkPlanTask


def request_fields(kind: Any, record: object, **further: object) -> dict[str, object]:
    """Return the fields of a request of a kind of service that a record has, by name, and those of `further` that it takes."""
    slots = kind._request_class.__slots__
    found = {name: getattr(record, name) for name in slots if hasattr(record, name)}
    return found | {name: value for name, value in further.items() if name in slots}


@dataclass(frozen=True)
class PlanService:
    """A service that makes plans; `goal` returns the fields that have another name or form there."""

    name: str
    kind: Any
    goal: Callable[[GoalRequest], dict[str, object]] = lambda _: {}

    def fields(self, request: GoalRequest, **further: object) -> dict[str, object]:
        """Return the fields of the service's request, with those of `further` that it has."""
        return request_fields(self.kind, request, **further) | self.goal(request)


def pose_fields(pose: Pose) -> dict[str, Any]:
    """Return the fields of a `GoalRequest` that name a pose."""
    orientation = tuple(rotation_to_quaternion(pose.rotation).tolist())
    return {"position": tuple(map(float, pose.position)), "orientation": orientation}


def _pose(asked: GoalRequest) -> PoseMsg:
    return PoseMsg(Point(*asked.position), Quaternion(*asked.orientation))


PLAN_SERVICES: Mapping[str, PlanService] = {
    "joints": PlanService("plan_to_joints", PlanToJoints, lambda asked: {"goal": list(asked.joints)}),
    "pose": PlanService(
        "plan_to_pose", PlanToPose, lambda asked: {"goal": PoseStamped(Header(frame_id=asked.frame), _pose(asked))}
    ),
    "line": PlanService(
        "plan_cartesian",
        PlanCartesian,
        lambda asked: {"frame_id": asked.frame, "waypoints": [CartesianWaypoint(pose=_pose(asked))]},
    ),
    "csv": PlanService("plan_trajectory", PlanTrajectory),
    "way_back": PlanService("plan_way_back", Trigger),
    "work_task": PlanService("work/plan", WorkPlanTask),
}


@dataclass(frozen=True)
class Outcome:
    """The outcome of a request, with the field names of the services' answers."""

    success: bool
    message: str
    expired: bool = False
    fields: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def of(cls, answer: Any) -> Outcome:
        """Return the outcome in a service's answer; what it has no field for keeps its default."""
        known = {name: getattr(answer, name) for name in answer.__slots__ if name != "said"}
        message = sentence_of(answer, known.pop("message"))
        return cls(known.pop("success"), message, known.pop("expired", False), known)

    def response(self, kind: Any) -> Any:
        """Return the response of a kind of service; what it has no field for is left out."""
        response = kind._response_class(success=self.success, message=self.message)
        for name, value in {"expired": self.expired, **self.fields}.items():
            if hasattr(response, name):
                setattr(response, name, value)
        return with_sentences(response, self.message)
