"""joint_velocities: the twin's pose at a low rate with velocities, which joint_state_publisher reads for `joint_states`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import pydantic
import rospy
from sensor_msgs.msg import JointState

from construction_twin.robot.joint_velocities import JointVelocities
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters
from construction_twin.ros.transport.joint_stream import JointSubscriber, to_time
from construction_twin.ros.transport.publisher import Publisher, Sink


class Settings(pydantic.BaseModel):
    """Private parameters, given in config/joint_velocities.yaml: messages per second."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    rate: float = pydantic.Field(ge=1, le=250)


class JointVelocitiesNode:
    """ROS around JointVelocities; `start` gives it parameters and topics.

    Parameters
    ----------
    names : sequence of str
        The chain's joints.
    velocities : JointVelocities
    period : float
        Between two messages [s].
    publisher : Sink
        Of `velocities/joint_states`.
    """

    def __init__(self, names: Sequence[str], velocities: JointVelocities, period: float, publisher: Sink):
        self._names = names
        self._velocities = velocities
        self._period = period
        self._publisher = publisher
        self._next = 0.0
        #: Whether the twin has published a pose.
        self.known = False

    def run(self) -> None:
        """Wait for shutdown."""
        rospy.spin()

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> float:
        """Publish a pose of the twin [rad] with its own stamp [ns]; return when the next one is of interest [s, monotonic]."""
        self.known = True
        message = JointState(name=self._names, position=q, velocity=self._velocities.of(stamp, q))
        message.header.stamp = to_time(stamp)
        self._publisher.publish(message)
        # a grid, so that the rate does not depend on how long a message takes; begun anew after a silence
        self._next = max(self._next + self._period, time.monotonic())
        return self._next

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        return (
            Report(OK, "publishing the twin's velocities") if self.known else Report(WARN, "the twin has no pose yet")
        )


def start() -> JointVelocitiesNode:
    """Return the node with its parameters and topics."""
    settings = read_parameters(Settings)
    robot = robot_from_parameters()
    publisher = Publisher("velocities/joint_states", JointState, queue_size=5)
    node = JointVelocitiesNode(robot.joint_names, JointVelocities(robot.velocity), 1.0 / settings.rate, publisher)
    diagnostics = NodeDiagnostics(robot.name, node.report)
    JointSubscriber("twin/joint_states", robot.joint_names, _paced(node.on_twin), diagnostics.refuse, queue_size=1)
    return node


def _paced(take: Callable[[int, tuple[float, ...]], float]) -> Callable[[int, tuple[float, ...]], None]:
    """Return a callback that sleeps until the next pose is of interest: rospy then takes the newest of what came meanwhile."""

    def callback(stamp: int, q: tuple[float, ...]) -> None:
        time.sleep(max(0.0, take(stamp, q) - time.monotonic()))

    return callback


def main() -> None:
    """Run the node."""
    run_node("joint_velocities", start)
