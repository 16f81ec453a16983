"""Wishes for plans, and poses that are dragged, from consoles: to the planner's own services, and answered. Nothing here moves.

What a plan service makes waits for a person's verdict as any plan. A wish is carried out in its turn (`RequestLine`); a pose that
is dragged is worth solving only while it is the newest of its account, in a thread of its own.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import rospy
from geometry_msgs.msg import Point, PoseStamped, Quaternion
from geometry_msgs.msg import Pose as PoseMsg

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.freshness import Moment, staleness
from construction_twin.core.motion_errors import SceneError
from construction_twin.core.rate_limit import RollingWindow, SenderLimits
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.remote_request import (
    IkRequest,
    RemoteRequest,
    ik_answer,
    parse_ik,
    parse_plan_request,
    plan_answer,
    read_request,
)
from construction_twin.link.remote_trajectory import Joints, checked_sender, request_id
from construction_twin.link.remote_view import ClosestView
from construction_twin.mqtt.messages import Topics
from construction_twin.msg import CartesianWaypoint
from construction_twin.robot.frames import quaternion_to_rotation
from construction_twin.ros.shared.malformed_answers import MalformedAnswers
from construction_twin.ros.shared.pose_judge import PoseJudge
from construction_twin.ros.shared.request_line import Request, RequestLine
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.transport.joint_stream import now_ns, to_time
from construction_twin.ros.transport.persistent_service import NO_ANSWER

#: Longest wait for a service to exist [s].
SERVICE_TIMEOUT = 1.0
#: Poses of one account that are taken in any second.
IK_RATE = 15
#: Accounts whose poses wait at once; each has one at most.
IK_ACCOUNTS = 16
#: What counts the wishes that were too old.
_TOO_OLD = "too_old"
#: How often the closest two bodies are looked for [s].
CLOSEST_PERIOD = 0.2


@dataclass(frozen=True)
class PlanServices:
    """The services that make plans, as `rospy.ServiceProxy` has them."""

    to_joints: rospy.ServiceProxy
    to_pose: rospy.ServiceProxy
    line: rospy.ServiceProxy
    way_back: rospy.ServiceProxy
    work_task: rospy.ServiceProxy


@dataclass(frozen=True)
class Surroundings:
    """What the desk asks about the robot.

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
class _Made:
    """What became of a wish; `expired`: it was too old to be begun."""

    ok: bool
    sentence: str
    plan: Mapping[str, object] = field(default_factory=dict)
    expired: bool = False


class RequestDesk:
    """Takes both kinds of messages.

    Args:
        publish: Takes topic, payload and QoS.
        refuse: Counts a refused input; takes reason and sentence.
        source_of: Takes an account; returns who asks, for the reviewer.
    """

    def __init__(
        self,
        topics: Topics,
        joints: Joints,
        line: RequestLine,
        services: PlanServices,
        judge: PoseJudge,
        around: Surroundings,
        publish: Callable[[str, bytes, int], object],
        refuse: Callable[[str, str], None],
        source_of: Callable[[str], str],
    ):
        self._topics, self._joints, self._line = topics, joints, line
        self._services, self._judge, self._around = services, judge, around
        self._publish, self._refuse, self._source_of = publish, refuse, source_of
        self._rate = SenderLimits(lambda: RollingWindow(IK_RATE))
        self._news = threading.Condition()
        self._poses: dict[str, IkRequest] = {}
        self._counts: Counter[str] = Counter()
        self._malformed = MalformedAnswers("plan_requests")
        self._closest: tuple[ClosestView, float] | None = None
        self._problem = ""

    @property
    def counts(self) -> dict[str, int]:
        """What was done so far, for `/diagnostics`."""
        with self._news:
            return dict(sorted(self._counts.items())) | self._malformed.report()

    # -- wishes for plans

    def on_plan_request(self, account: str, payload: bytes, retained: bool) -> None:
        """Take a wish; it is carried out in its turn, unless what its screen had shown is too old by then.

        Args:
            account: In the topic's name.
        """
        name = kind = ""
        try:
            account = checked_sender(account)
            document = read_request(payload, retained, "plan_request")
            name = request_id(document)
            asked = parse_plan_request(document, self._joints)
            kind = asked.kind
            self._demand_fresh(asked)
        except PayloadError as error:
            self._refuse(error.reason, str(error))
            if self._malformed.take(account):
                expired = error.reason == _TOO_OLD
                answer = plan_answer(name, account, kind, False, str(error), expired=expired)
                self._publish(self._topics.plan_request_ack, answer, 1)
            return
        arrived = now_ns()
        self._line.take(
            Request(
                "plan_request", name, account, payload, self._topics.plan_request_ack,
                lambda: self._carry_out(asked, account, arrived),
                lambda sentence: plan_answer(name, account, kind, False, sentence),
            )
        )  # fmt: skip

    def _carry_out(self, asked: RemoteRequest, account: str, arrived: int) -> bytes:
        try:
            self._demand_fresh(asked)
            made = self._make(asked, account, arrived)
        except PayloadError as error:
            self._refuse(error.reason, str(error))
            made = _Made(False, str(error), expired=error.reason == _TOO_OLD)
        self._count("plan_requests under review" if made.ok else "plan_requests no plan")
        rospy.loginfo("plan_request %r (%s) from %s: %s", asked.id, asked.kind, account, made.sentence)
        told = {**made.plan, "expired": made.expired}
        return plan_answer(asked.id, account, asked.kind, made.ok, made.sentence, **told)  # type: ignore[arg-type]

    def _demand_fresh(self, asked: RemoteRequest) -> None:
        """Refuse a wish (PayloadError) that is too old to be begun."""
        if problem := staleness(asked.moment, self._around.clock()):
            raise PayloadError(_TOO_OLD, f"the request is {problem}")

    def _make(self, asked: RemoteRequest, account: str, arrived: int) -> _Made:
        """Have a plan made by the service of its kind."""
        services, scales = (
            self._services,
            {"speed_scale": asked.speed_scale, "acceleration_scale": asked.acceleration_scale},
        )
        common = {"source": self._source_of(account), **scales}
        if asked.kind == "joints":
            # a stop between the message and its turn voids the plan
            return self._call(services.to_joints, goal=list(asked.joints), asked=to_time(arrived), **common)
        if asked.kind == "pose":
            goal = PoseStamped(pose=_pose_msg(asked))
            return self._call(services.to_pose, goal=goal, configuration=asked.configuration, **common)
        if asked.kind == "line":
            waypoints = [CartesianWaypoint(pose=_pose_msg(asked))]
            return self._call(services.line, waypoints=waypoints, speed=asked.speed, **common)
        if asked.kind == "way_back" and not (self._around.has_work() and self._around.is_engaged()):
            return self._call(services.way_back)
        # the node `work` makes the scene right before it has the way back planned
        if not self._around.has_work():
            return _Made(False, "no building model is worked on here; start bringup with work_model and work_cell")
        return self._call(services.work_task, task=asked.task)

    @staticmethod
    def _call(service: rospy.ServiceProxy, **request: object) -> _Made:
        try:
            rospy.wait_for_service(service.resolved_name, SERVICE_TIMEOUT)
            answer = service(**request)
        except (rospy.ROSException, *NO_ANSWER) as error:
            return _Made(False, f"{service.resolved_name} does not answer: {error}; does its node run?")
        told = {name: getattr(answer, name) for name in ("plan_id", "plan_hash", "duration") if hasattr(answer, name)}
        return _Made(answer.success, answer.message, told)

    # -- poses that are dragged

    def on_ik(self, account: str, payload: bytes, retained: bool) -> None:
        """Take a pose; the one of this account that still waits is not worth solving any more. Parameters as above."""
        name = ""
        try:
            account = checked_sender(account)
            if not self._rate.take(account, round(time.monotonic() * NANOSECONDS)):
                # an answer to each would be as much again
                self._refuse("ik_rate", f"more than {IK_RATE} poses in a second from {account}")
                return
            document = read_request(payload, retained, "ik")
            name = request_id(document)
            asked = parse_ik(document, self._joints)
        except PayloadError as error:
            self._refuse(error.reason, str(error))
            if error.reason != "sender":
                self._publish(self._topics.ik_ack(account), ik_answer(name, "unknown", None, str(error)), 0)
            return
        with self._news:
            if account in self._poses:
                self._counts["ik overtaken"] += 1
            if account not in self._poses and len(self._poses) >= IK_ACCOUNTS:
                full = True
            else:
                full = False
                self._poses[account] = asked
                self._news.notify_all()
        if full:
            sentence = f"{IK_ACCOUNTS} accounts drag poses already; try again"
            self._refuse("busy", sentence)
            self._publish(self._topics.ik_ack(account), ik_answer(name, "unknown", None, sentence), 0)

    def solve_waiting(self, patience: float = 0.0) -> None:
        """Answer every pose that waits; wait so long [s] for the first one."""
        with self._news:
            self._news.wait_for(lambda: self._poses, patience)
            poses, self._poses = self._poses, {}
        for account, asked in poses.items():
            self._publish(self._topics.ik_ack(account), self._solved(asked), 0)

    def _solved(self, asked: IkRequest) -> bytes:
        seed = asked.seed or tuple(self._around.twin())
        if not seed:
            return ik_answer(asked.id, "unknown", None, "the twin's pose is not known, and no seed was given")
        try:
            verdict = self._judge.judge(asked.position, quaternion_to_rotation(asked.orientation), seed)
        except (ConfigurationError, SceneError) as error:
            self._refuse("ik", str(error))
            return ik_answer(asked.id, "unknown", None, str(error))
        self._count(f"ik {verdict.reach.value}")
        joints = None if verdict.q is None else dict(zip(self._joints.names, map(float, verdict.q)))
        return ik_answer(asked.id, verdict.reach.value, joints, verdict.sentence, verdict.between)

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
            self.solve_waiting(CLOSEST_PERIOD)
            if looks_around and time.monotonic() >= due:
                due = time.monotonic() + CLOSEST_PERIOD
                self.look_around()

    def _count(self, what: str) -> None:
        with self._news:
            self._counts[what] += 1


def _pose_msg(asked: RemoteRequest) -> PoseMsg:
    return PoseMsg(Point(*asked.position), Quaternion(*asked.orientation))
