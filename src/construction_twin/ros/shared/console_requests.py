"""Plan and IK requests of consoles: handed to the planner's own services, and answered. Nothing here moves.

What a plan service makes waits for a person's verdict as any plan. A plan request is carried out in its turn (`RequestQueue`); the
pose of an IK request, which is dragged, is worth solving only while it is the newest of its account, in a thread of its own
(`NewestQueue`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import rospy

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.freshness import Moment, staleness
from construction_twin.core.motion_errors import SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.link.remote_view import ClosestView
from construction_twin.link.requests import GoalRequest, IkRequest, Joints, read_goal
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import IK, PLAN_REQUEST
from construction_twin.robot.frames import quaternion_to_rotation
from construction_twin.ros.messages.plan_services import PLAN_SERVICES
from construction_twin.ros.shared.endpoint import TOO_OLD, Endpoint, Incoming, Outlets
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.pose_judge import PoseJudge
from construction_twin.ros.shared.request_counts import RequestCounts
from construction_twin.ros.shared.request_queue import NewestQueue, RequestQueue
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.transport.persistent_service import call

#: Accounts whose poses wait at once; each has one at most.
IK_ACCOUNTS = 16
#: How often the closest two bodies are looked for [s].
CLOSEST_PERIOD = 0.2


@dataclass(frozen=True)
class RobotContext:
    """What these requests need to know of the robot.

    Attributes:
        twin: Returns the twin's joint values [rad], [m]; empty while they are not known.
        has_work: Returns whether a node `work` runs.
        is_engaged: Returns whether only the way back can be planned.
        clock: Returns the present moment.
    """

    twin: Callable[[], Sequence[float]]
    has_work: Callable[[], bool] = lambda: False
    is_engaged: Callable[[], bool] = lambda: False
    clock: Callable[[], Moment] = present


@dataclass(frozen=True)
class _PlanAsked:
    """A plan request, who asked (for the reviewer), and when it arrived."""

    asked: GoalRequest
    account: str
    arrived: Moment


class ConsoleRequests:
    """The endpoints of plan and IK requests.

    Args:
        queue: Where plan requests wait.
        services: Those that make plans, by kind of request.
        source_of: Takes an account; returns who asks, for the reviewer.

    Attributes:
        plan_requests, ik: What takes messages of each kind.
        poses: Where poses wait, for a thread of their own.
    """

    def __init__(
        self,
        topics: Topics,
        joints: Joints,
        queue: RequestQueue,
        services: Mapping[str, rospy.ServiceProxy],
        judge: PoseJudge,
        around: RobotContext,
        outlets: Outlets,
        source_of: Callable[[str], str],
    ):
        self._joints = joints
        self._services, self._judge, self._around = services, judge, around
        self._refuse, self._source_of = outlets.refuse, source_of
        self._plans = RequestCounts("plan_requests", "under review", "no plan")
        self._poses = RequestCounts("ik", "solved", "not solved")
        self.poses = NewestQueue(
            IK_ACCOUNTS,
            Sentence("link.payload.accounts", count=IK_ACCOUNTS),
            lambda: self._poses.add(False, "overtaken"),
        )
        self._closest: tuple[ClosestView, float] | None = None
        self._problem = ""
        self.plan_requests: Endpoint[_PlanAsked] = Endpoint(
            PLAN_REQUEST,
            topics,
            self._read_plan_request,
            self._carry_out,
            self._plans,
            outlets,
            _describe,
            lambda _: queue,
        )
        self.ik: Endpoint[IkRequest] = Endpoint(
            IK, topics, self._read_pose, self._solve, self._poses, outlets, queue=lambda _: self.poses
        )

    @property
    def counts(self) -> dict[str, int]:
        """What was done so far, for `/diagnostics`."""
        return self._poses.report() | self._plans.report()

    # -- plan requests

    def _read_plan_request(self, incoming: Incoming) -> _PlanAsked:
        asked = read_goal(incoming.read_document(PLAN_REQUEST.name, PLAN_REQUEST.limit), self._joints)
        self._demand_fresh(asked)
        return _PlanAsked(asked, incoming.account, self._around.clock())

    def _carry_out(self, request: _PlanAsked) -> Outcome:
        # it may have waited too long for its turn
        self._demand_fresh(request.asked)
        asked, kind = request.asked, request.asked.kind
        if kind == "way_back" and self._around.has_work() and self._around.is_engaged():
            # the node `work` makes the scene right before it has the way back planned
            kind = "work_task"
        if kind == "work_task" and not self._around.has_work():
            return Outcome(False, Sentence("link.no_work"))
        # a stop between the message and its turn voids the plan
        source, arrived = self._source_of(request.account), str(request.arrived)
        fields = PLAN_SERVICES[kind].fields(asked, source=source, asked=arrived)
        return Outcome.of(call(self._services[kind], "its node", **fields))

    def _demand_fresh(self, asked: GoalRequest) -> None:
        """Refuse a plan request (PayloadError) that is too old to be begun."""
        if problem := staleness(asked.moment, self._around.clock()):
            raise PayloadError(TOO_OLD, Sentence("executor.void.request", problem=problem))

    # -- IK requests

    def _read_pose(self, incoming: Incoming) -> IkRequest:
        return incoming.read(IK, IkRequest)

    def _solve(self, asked: IkRequest) -> Outcome:
        seed = self._joints.in_order(asked.seed, "seed") if asked.seed else tuple(self._around.twin())
        if not seed:
            return Outcome(False, Sentence("link.no_seed"))
        try:
            verdict = self._judge.judge(asked.position, quaternion_to_rotation(asked.orientation), seed)
        except (ConfigurationError, SceneError) as error:
            raise PayloadError("ik", error.sentence) from error
        joints = None if verdict.q is None else dict(zip(self._joints.names, map(float, verdict.q)))
        found = {"reach": verdict.reach.value, "joints": joints, "between": verdict.between}
        return Outcome(joints is not None, verdict.sentence, fields=found, counted=verdict.reach.value)

    # -- the closest two bodies

    def look_around(self) -> None:
        """Find the two bodies that are closest at the twin's pose."""
        q = tuple(self._around.twin())
        found = None
        try:
            clearance = self._judge.closest(q) if q else None
            problem = ""
        except (ConfigurationError, SceneError) as error:
            clearance, problem = None, str(error)
        if problem and problem != self._problem:
            self._refuse("closest", problem)
        self._problem = problem
        if clearance is not None:
            found = ClosestView(clearance.distance, clearance.between, clearance.point, 0.0), time.monotonic()
        self._closest = found

    def closest(self) -> ClosestView | None:
        """Return what `look_around` found last, with its age."""
        found = self._closest
        if found is None:
            return None
        view, at = found
        return ClosestView(view.distance, view.between, view.point, time.monotonic() - at)

    def run(self, looks_around: bool) -> None:
        """Answer poses until shutdown, and look around between them."""
        due = 0.0
        while not rospy.is_shutdown():
            self.poses.run(CLOSEST_PERIOD)
            if looks_around and time.monotonic() >= due:
                due = time.monotonic() + CLOSEST_PERIOD
                self.look_around()


def _describe(request: _PlanAsked) -> str:
    return f"plan_request {request.asked.id!r} ({request.asked.kind}) from {request.account}"
