"""joint_state_publisher: the twin's pose at a low rate, with velocities and the joints outside of the chain (`joint_states`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pydantic
import rospy
from sensor_msgs.msg import JointState

from construction_twin.robot.joint_states import JointStates
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters
from construction_twin.ros.transport.joint_stream import JointSubscriber, now_ns, to_time
from construction_twin.ros.transport.publisher import Publisher, Sink


class Settings(pydantic.BaseModel):
    """Private parameters, given in config/joint_state_publisher.yaml: messages per second."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    rate: float = pydantic.Field(ge=1, le=250)


class JointStatePublisherNode:
    """ROS around JointStates; `start` gives it parameters and topics.

    Parameters
    ----------
    states : JointStates
    home : tuple of float
        Shown until the twin has a pose [rad], [m].
    period : float
        Between two messages [s].
    publisher : Sink
        Of `joint_states`.
    """

    def __init__(self, states: JointStates, home: tuple[float, ...], period: float, publisher: Sink):
        self._states = states
        self._home = home
        self._period = period
        self._publisher = publisher
        self._known = threading.Event()
        self._next = 0.0

    @property
    def known(self) -> bool:
        """Whether the twin has published a pose."""
        return self._known.is_set()

    def run(self) -> None:
        """Publish the home pose until the twin's is known: rviz needs one. Return at shutdown."""
        while not self._known.wait(self._period) and not rospy.is_shutdown():
            self._publisher.publish(self._message(now_ns(), self._home))
        rospy.spin()

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> float:
        """Publish a pose of the twin [rad] with its own stamp [ns]; return when the next one is of interest [s, monotonic].

        The stamp is not made new: where the twin is silent, whoever reads this must see that the pose is old.
        """
        self._known.set()
        self._publisher.publish(self._message(stamp, q))
        now = time.monotonic()
        # a grid, so that the rate does not depend on how long a message takes; begun anew after a silence
        self._next = max(self._next + self._period, now)
        return self._next

    def _message(self, stamp: int, q: tuple[float, ...]) -> JointState:
        message = JointState(
            name=self._states.names, position=self._states.positions(q), velocity=self._states.velocities(stamp, q)
        )
        message.header.stamp = to_time(stamp)
        return message

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        return (
            Report(OK, "publishing the twin's pose") if self.known else Report(WARN, "home pose, the twin has none yet")
        )


def start() -> JointStatePublisherNode:
    """Return the node with its parameters and topics."""
    settings = read_parameters(Settings)
    robot = robot_from_parameters()
    publisher = Publisher("joint_states", JointState, queue_size=5)
    node = JointStatePublisherNode(JointStates(robot), robot.home, 1.0 / settings.rate, publisher)
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
    run_node("joint_state_publisher", start)
