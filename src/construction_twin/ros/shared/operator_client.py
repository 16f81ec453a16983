"""The services an operator uses of one robot, as calls; the command line and the marker in rviz use the same ones."""

from __future__ import annotations

from typing import Any

import rospy
from std_srvs.srv import Trigger

from construction_twin.core.errors import RequestRefused, SilenceError
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.ros.messages.plan_services import PLAN_SERVICES, request_fields
from construction_twin.ros.shared.master import expect_publisher
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.transport.persistent_service import PersistentService
from construction_twin.srv import ActAsSeen, PreviewPlan, ReviewPlan


class OperatorClient:
    """Calls the services of one robot; RequestRefused where the answer is no, SilenceError where there is none.

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
        """Return what is latched on a topic of the robot; SilenceError when nothing is."""
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
