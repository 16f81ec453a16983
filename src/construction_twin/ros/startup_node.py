"""startup: tells the operator what a start waits for and what to do, and when everything is there."""

from __future__ import annotations

import math
import time
from typing import Literal

import pydantic
import rospy

from construction_twin.msg import Execution, Feedback, Link, Scene, Sync
from construction_twin.ros.diagnostics import OK, WARN, NodeDiagnostics
from construction_twin.ros.node import run_node
from construction_twin.ros.params import read_parameters, robot_from_parameters
from construction_twin.startup import Deployment, Seen, StartUp

#: How often it looks [s].
PERIOD = 0.25
#: A report that is older counts for nothing [s]; both come at least once a second.
SILENT = {"link": 3.0, "sync": 3.0}


class Settings(pydantic.BaseModel):
    """Private parameters, given in launch/bringup.launch: see `startup.Deployment`."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    arm: Literal["mock", "real", "none"]
    broker: str
    rsi: str
    gateway: bool


class StartupNode:
    """ROS around a StartUp."""

    def __init__(self):
        settings = read_parameters(Settings)
        namespace = rospy.get_namespace().rstrip("/")
        self._startup = StartUp(Deployment(namespace=namespace, **settings.model_dump()))
        self._words: dict[str, tuple[float, tuple[str, str]]] = {}
        self._came: set[str] = set()
        self._diagnostics = NodeDiagnostics(robot_from_parameters().name, self._report)
        self._reports = {
            name: rospy.Subscriber(name, kind, self._on_report, callback_args=name, queue_size=1)
            for name, kind in {"link": Link, "sync": Sync, "execution": Execution}.items()
        }
        self._once = {
            "feedback": rospy.Subscriber("physical/feedback", Feedback, self._on_first, callback_args="feedback"),
            "twin": rospy.Subscriber("twin/joint_states", rospy.AnyMsg, self._on_first, callback_args="twin"),
            "scene": rospy.Subscriber("scene", Scene, self._on_first, callback_args="scene"),
        }
        self._timer = rospy.Timer(rospy.Duration(PERIOD), self._on_timer)

    def _on_report(self, message, name: str) -> None:
        self._words[name] = time.monotonic(), (message.text, message.reason)

    def _on_first(self, _message, name: str) -> None:
        self._came.add(name)

    def _on_timer(self, _event) -> None:
        for name in self._came & set(self._once):
            self._once.pop(name).unregister()  # one message of a 250 Hz stream is enough
        now = time.monotonic()
        # who fell silent is not there; `execution` comes on change only, so its publisher counts
        words = {
            name: said for name, (heard, said) in tuple(self._words.items()) if now - heard < SILENT.get(name, math.inf)
        }
        if not self._reports["execution"].get_num_connections():
            words.pop("execution", None)
        seen = Seen(**words, **{name: True for name in self._came})
        for line in self._startup.update(seen, now):
            waits = self._startup.missing is not None
            (rospy.logwarn if waits else rospy.loginfo)("%s", line)

    def _report(self) -> tuple[int, str, dict]:
        missing = self._startup.missing
        return (OK, "ready", {}) if missing is None else (WARN, str(missing), {})


def main() -> None:
    """Run the node."""
    run_node("startup", StartupNode)
