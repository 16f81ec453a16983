"""startup: tells the operator what a start waits for and what to do, and when everything is there."""

from __future__ import annotations

import time
from functools import partial
from typing import Literal

import pydantic
import rospy

from construction_twin.msg import Feedback, Scene
from construction_twin.robot.description import RobotModel
from construction_twin.robot.other_joints import other_joints_text
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node import NodeShell
from construction_twin.ros.shared.robot_listener import RobotListener
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.views.startup import Deployment, Seen, StartUp, Word

#: How often it checks [s].
PERIOD = 0.25


class Settings(pydantic.BaseModel):
    """Private parameters, given in launch/bringup.launch: see `startup.Deployment`."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    arm: Literal["mock", "real", "none"]
    broker: str
    rsi: str
    gateway: bool
    gateway_kind: Literal["rsi", "plc"] = "rsi"


class StartupNode:
    """ROS around a StartUp."""

    def __init__(self, settings: Settings, robot: RobotModel):
        namespace = rospy.get_namespace().rstrip("/")
        self._startup = StartUp(Deployment(namespace=namespace, **settings.model_dump()))
        self._came: set[str] = set()
        others = other_joints_text(robot.other_joints, robot.base_link, robot.tip_link)
        if others:
            rospy.loginfo("%s", others)
        self._diagnostics = NodeDiagnostics(robot.name, self._report)
        self._listener = RobotListener(namespace, robot)
        self._once = {
            name: Subscriber(topic, kind, partial(self._on_first, name), self._diagnostics.refuse, queue_size=1)
            for name, topic, kind in (
                ("feedback", "physical/feedback", Feedback),
                ("twin", "twin/joint_states", rospy.AnyMsg),
                ("scene", "scene", Scene),
            )
        }
        self._timer = rospy.Timer(rospy.Duration(PERIOD), self._on_timer)

    def _on_first(self, name: str, _message) -> None:
        self._came.add(name)

    def _on_timer(self, _event) -> None:
        for name in self._came & set(self._once):
            self._once.pop(name).unregister()  # one message of a 250 Hz stream is enough
        snapshot = self._listener.snapshot()
        reports = {"link": snapshot.link, "sync": snapshot.sync, "execution": snapshot.execution}
        # a node that fell silent is not there
        words = {
            name: Word(facts.text, facts.reason, getattr(facts, "gateway_state", ""))
            for name, facts in reports.items()
            if facts is not None and name not in snapshot.silent
        }
        came = self._came
        told = snapshot.link.gateway_counters if snapshot.link is not None and "link" in words else {}
        seen = Seen(
            link=words.get("link"),
            sync=words.get("sync"),
            execution=words.get("execution"),
            feedback="feedback" in came,
            twin="twin" in came,
            scene="scene" in came,
            controller=told.get("controller_sentence", ""),
            clock=told.get("cycle_sentence", ""),
        )
        for line in self._startup.update(seen, time.monotonic()):
            waits = self._startup.missing is not None
            (rospy.logwarn if waits else rospy.loginfo)("%s", line)

    def _report(self) -> Report:
        missing = self._startup.missing
        return Report(OK, "ready") if missing is None else Report(WARN, str(missing))


NODE = NodeShell("startup", Settings, StartupNode)


def main() -> None:
    """Run the node."""
    NODE.run()
