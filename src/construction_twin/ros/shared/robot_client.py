"""One robot from outside: its reports as a `Snapshot`, and the services that an operator calls."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import genpy
import rospy
from std_srvs.srv import Trigger

from construction_twin.core.errors import ConstructionTwinError, RequestRefused, SilenceError
from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SyncReport
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.msg import Execution, Hold, Link, Plan, PlanCaller, Review, Sync
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.plan import Plan as PlanValue
from construction_twin.ros.messages.convert import change_from_msg, plan_from_msg
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.services import PLAN_SERVICES, Outcome, request_fields
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.master import expect_publisher
from construction_twin.ros.transport.persistent_service import PersistentService
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.scene.scene_change import SceneChange
from construction_twin.srv import ActAsSeen, PreviewPlan, ReviewPlan
from construction_twin.views.texts import Snapshot

_Report = TypeVar("_Report", LinkReport, SyncReport, HoldReport, ExecutionReport)

#: Age from which a report counts as silent [s]. `execution` is published on change only.
SILENT = {"link": 3.0, "sync": 1.0}
_REPORTS = {
    "link": Link,
    "sync": Sync,
    "hold": Hold,
    "execution": Execution,
    "plan": Plan,
    "plan_caller": PlanCaller,
    "review": Review,
}
#: What it listens to.
REPORTS = tuple(_REPORTS)


class RobotListener:
    """Keeps the newest message of each report from the node that publishes it; `refused`: why the last plan cannot be read."""

    def __init__(self, namespace: str, robot: RobotModel, refuse: Callable[[str, str], None] | None = None):
        self._refuse = refuse or warn_of_refusals()
        self._namespace = namespace.rstrip("/")
        self._robot = robot
        self._news = threading.Condition()
        self._newest: dict[str, object] = {}
        self._plan: PlanValue | None = None
        self.refused = ""
        self._received_at: dict[str, float] = {}
        self._reports = {name: self._subscribe(name, kind) for name, kind in _REPORTS.items()}

    def wait(self, condition: Callable[[], object], timeout: float | None) -> bool:
        """Wait until `condition`, asked after every report, holds; return whether it does. None waits without end."""
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._news:
            while not condition():
                left = 0.5 if deadline is None else min(0.5, deadline - time.monotonic())
                if left <= 0.0 or rospy.is_shutdown():
                    return False
                # in slices, because Ctrl-C does not interrupt a wait without a timeout
                self._news.wait(left)
        return True

    def newest(self, name: str):
        """Return the newest message of a report, one of `_REPORTS`; None before the first."""
        return self._newest.get(name)

    def publishers(self, name: str) -> int:
        """Return how many nodes publish a report now."""
        return self._reports[name].get_num_connections()

    def plan(self, plan_id: str) -> PlanValue | None:
        """Return the newest plan if it is the one with this id."""
        plan = self._plan
        return plan if plan is not None and plan.id == plan_id else None

    def under_review(self) -> PlanValue | None:
        """Return the plan that waits for a verdict according to the topics; the executor's own state decides."""
        plan = self._plan
        decided = {getattr(self._newest.get(name), "plan_id", None) for name in ("review", "execution")}
        return None if plan is None or plan.id in decided else plan

    def changes(self, plan_id: str) -> tuple[SceneChange, ...]:
        """Return the changes of the scene by the newest plan's segments; () for another plan, or an unreadable one."""
        newest = self.newest("plan")
        if newest is None or newest.id != plan_id:
            return ()
        try:
            return tuple(map(change_from_msg, newest.segments))
        except SceneError as error:
            rospy.logwarn("the objects of plan %s cannot be shown: %s", plan_id, error)
            return ()

    def snapshot(self) -> Snapshot:
        """Return what is known now."""
        with self._news:
            newest = dict(self._newest)
            plan = self.under_review()
            now = time.monotonic()
            ages = {name: now - self._received_at.get(name, now) for name in SILENT}
            silent = {name: age for name, age in ages.items() if age > SILENT[name]}
        if "execution" in newest and not self.publishers("execution"):
            silent["execution"] = now - self._received_at["execution"]
        return Snapshot(
            robot=self._namespace.strip("/"),
            joints=self._robot.joint_names,
            linear=self._robot.linear,
            link=_record(LinkReport, newest.get("link")),
            sync=_record(SyncReport, newest.get("sync")),
            execution=_record(ExecutionReport, newest.get("execution")),
            hold=_record(HoldReport, newest.get("hold")) if "sync" not in silent else None,
            plan=plan,
            silent=silent,
        )

    def _subscribe(self, name: str, kind: type) -> Subscriber:
        return Subscriber(f"{self._namespace}/{name}", kind, partial(self._receive, name), self._refuse, queue_size=20)

    def _receive(self, name: str, message) -> None:
        plan, refused = None, ""
        if name == "plan":
            try:
                plan = plan_from_msg(message)
            except ConstructionTwinError as error:
                refused = str(error)
        with self._news:
            self._newest[name], self._received_at[name] = message, time.monotonic()
            if name == "plan":
                self._plan, self.refused = plan, refused
            self._news.notify_all()


def _record(kind: type[_Report], message: genpy.Message | None) -> _Report | None:
    return None if message is None else from_msg(kind, message)


class OperatorClient:
    """Calls the services of one robot; RequestRefused or SilenceError where one fails.

    `timeout`: for the service to be there [s]; an answer may take longer. `source`: who asks, for the reviewer.
    """

    def __init__(self, namespace: str, timeout: float, source: str):
        self._namespace = namespace.rstrip("/")
        self._stop = PersistentService(f"{self._namespace}/stop", Trigger)
        self._timeout = timeout
        self._source = source

    def plan(self, asked: GoalRequest) -> Outcome:
        """Have a plan made."""
        service = PLAN_SERVICES[asked.kind]
        return self.ask(service.name, service.kind, **service.fields(asked, source=self._source))

    def preview(self, speed: float = 1.0) -> Outcome:
        """Let the ghost play the plan under review; 1: as fast as the plan."""
        return self.ask("preview_plan", PreviewPlan, speed=speed, loop=False)

    def review(self, verdict: ReviewRequest) -> Outcome:
        """Approve (and so start) or reject a plan."""
        return self.ask("review_plan", ReviewPlan, **request_fields(ReviewPlan, verdict))

    def trigger(self, service: str) -> Outcome:
        """Call `stop`, `pause`, `resume` or `reset`; a stop at once, without waiting for the service to appear."""
        if service == "stop":
            try:
                return _done(self._stop())
            except rospy.ServiceException as error:
                rospy.logwarn("stop: no answer at once (%s); trying again", error)
        return self.ask(service, Trigger)

    def arm(self, responsible: str) -> Outcome:
        """Arm a bare PLC in the name of the person who is responsible for what is not checked."""
        return self.ask("mqtt_bridge/act_as_seen", ActAsSeen, act="arm", person=responsible)

    def latched(self, name: str, kind: Any, silent: str, to_do: str) -> Any:
        """Return the message latched on a topic of the robot, or raise SilenceError."""
        topic = f"{self._namespace}/{name}"
        expect_publisher(topic)
        try:
            return rospy.wait_for_message(topic, kind, self._timeout)
        except rospy.ROSException as error:
            raise SilenceError(topic, silent, to_do) from error

    def ask(self, name: str, kind: Any, **fields: object) -> Outcome:
        """Call any service of the robot."""
        service = f"{self._namespace}/{name}"
        try:
            rospy.wait_for_service(service, self._timeout)
        except rospy.ROSException as error:
            problem = f"no node offers this service (waited {self._timeout:g} s)"
            raise SilenceError(service, problem, "start bringup, or see why the node is down") from error
        try:
            return _done(rospy.ServiceProxy(service, kind)(**fields))
        except rospy.ServiceException as error:
            problem = f"the node gave no answer ({error})"
            raise SilenceError(service, problem, "look at its log") from error


def _done(answer: Any) -> Outcome:
    outcome = Outcome.of(answer)
    if not outcome.success:
        raise RequestRefused(outcome.message)
    return outcome
