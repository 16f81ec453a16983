"""startup: tells the operator what a start waits for and what to do, and when everything is there."""

from __future__ import annotations

import time
from typing import Literal

import pydantic
import rospy

from construction_twin.msg import Feedback, Scene
from construction_twin.robot.description import RobotModel
from construction_twin.robot.other_joints import other_joints_text
from construction_twin.ros.shared.diagnostics import OK, WARN, Report
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.ports import Every, Interface, Ports, Subscription
from construction_twin.ros.shared.robot_listener import REPORTS, RobotListener
from construction_twin.views.startup import Deployment, Seen, StartUp, Word

#: How often it checks [s].
PERIOD = 0.25
#: Topics of which one message is enough.
FEEDBACK, TWIN, SCENE = "physical/feedback", "twin/joint_states", "scene"


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

    def __init__(self, settings: Settings, robot: RobotModel, ports: Ports):
        namespace = rospy.get_namespace().rstrip("/")
        self._startup = StartUp(Deployment(namespace=namespace, **settings.model_dump()))
        self._came: set[str] = set()
        others = other_joints_text(robot.other_joints, robot.base_link, robot.tip_link)
        if others:
            rospy.loginfo("%s", others)
        self._listener = RobotListener(namespace, robot)
        self._ports = ports
        self._heard: set[str] = set()

    def on_feedback(self, _message: Feedback) -> None:
        """Note that the arm's pose comes."""
        self._came.add(FEEDBACK)

    def on_twin(self, _message: rospy.AnyMsg) -> None:
        """Note that the twin's pose comes."""
        self._came.add(TWIN)

    def on_scene(self, _message: Scene) -> None:
        """Note that there is a scene."""
        self._came.add(SCENE)

    def update(self) -> None:
        """Say what has changed."""
        for topic in self._came - self._heard:
            self._heard.add(topic)
            self._ports.stop_hearing(topic)  # one message of a 250 Hz stream is enough
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
            feedback=FEEDBACK in came,
            twin=TWIN in came,
            scene=SCENE in came,
            controller=told.get("controller_sentence", ""),
            clock=told.get("cycle_sentence", ""),
        )
        for line in self._startup.update(seen, time.monotonic()):
            waits = self._startup.missing is not None
            (rospy.logwarn if waits else rospy.loginfo)("%s", line)

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        missing = self._startup.missing
        return Report(OK, "ready") if missing is None else Report(WARN, str(missing))


INTERFACE = Interface(
    report=StartupNode.report,
    hears=(
        Subscription(FEEDBACK, Feedback, StartupNode.on_feedback, queue_size=1),
        Subscription(TWIN, rospy.AnyMsg, StartupNode.on_twin, queue_size=1),
        Subscription(SCENE, Scene, StartupNode.on_scene, queue_size=1),
    ),
    listeners=REPORTS,
    every=(Every(lambda _settings: PERIOD, lambda node, _ports: node.update()),),
)
NODE = NodeShell("startup", Settings, StartupNode, INTERFACE)


def main() -> None:
    """Run the node."""
    NODE.run()
