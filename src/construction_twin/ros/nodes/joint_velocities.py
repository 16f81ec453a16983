"""joint_velocities: poses at a low rate, for those who need no 250 Hz.

`velocities/joint_states` is the twin's pose with velocities, which joint_state_publisher reads for `joint_states`. Of a twin with
mass that is the commanded pose: MoveIt starts from it, and goals in a link's frame are looked up in the tf made of it.

`shown/twin` and `shown/physical` are what tf is made of: `joint_states` and the arm's poses, a few a second while they rest.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any, Literal

import pydantic
import rospy
from sensor_msgs.msg import JointState

from construction_twin.core.units import NANOSECONDS
from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.diagnostics import OK, WARN, Report
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.ports import (
    Interface,
    Ports,
    PosePublication,
    PoseSubscription,
    Publication,
    Subscription,
    has_arm,
)
from construction_twin.ros.transport.joint_stream import to_time
from construction_twin.ros.transport.publisher import Sink
from construction_twin.views.shown_poses import ShownPoses

#: A pose that is further from the last one than the joints' speed limits allow, by this factor, was not moved to: the twin has
#: taken the arm's pose over. Rounding to three decimals of a degree adds a few percent at 20 ms.
_JUMP = 1.1


class JointVelocities:
    """Velocities of a chain's joints.

    Args:
        largest: Length n. The joints' speed limits [rad/s], [m/s].
    """

    def __init__(self, largest: Sequence[float]):
        self._largest = tuple(_JUMP * velocity for velocity in largest)
        self._rest = (0.0,) * len(self._largest)
        self._last: tuple[int, tuple[float, ...]] | None = None

    def of(self, stamp: int, q: tuple[float, ...]) -> tuple[float, ...]:
        """Return the mean velocities since the pose of the last call, shape (n,) [rad/s], [m/s].

        0 for the first pose, for a stamp that is not newer, and for a pose that no joint could have moved to since: the twin took
        the arm's pose over.

        Args:
            stamp: Of the pose [ns].
            q: Shape (n,). [rad], [m]
        """
        before, self._last = self._last, (stamp, q)
        if before is None or stamp <= before[0]:
            return self._rest
        period = (stamp - before[0]) / NANOSECONDS
        moved = tuple([(value - was) / period for value, was in zip(q, before[1])])
        if all(abs(speed) <= largest for speed, largest in zip(moved, self._largest)):
            return moved
        return self._rest


#: A twin that has published nothing for this time is silent [s]; at a low rate, for two periods.
SILENCE = 0.25
#: Between two messages with velocities, which are means over it [s].
PERIOD = 0.02
#: Between two poses for tf while they change, for people to look at [s].
FRAME_PERIOD = 0.04


class Settings(pydantic.BaseModel):
    """The private parameter, given in launch/twin.launch: the physical arm."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    arm: Literal["mock", "real", "none"]


class ShownStream:
    """What tf is made of, of one tree; several publishers may be heard.

    Args:
        period: Between two poses that change [s].
        publisher: Takes what is shown.
    """

    def __init__(self, period: float, publisher: Sink):
        self._period, self._publisher = period, publisher
        self._poses: ShownPoses[tuple[Any, ...]] = ShownPoses()
        self._lock = threading.Lock()

    def take(self, now: float, names: Sequence[str], q: Sequence[float], *message: Any) -> float:
        """Show a pose, if it is its turn.

        Args:
            now, names, q: As of `ShownPoses`.
            message: What the publisher is given for it.

        Returns:
            When the next one is of interest, on the monotonic clock [s].
        """
        with self._lock:
            shown = self._poses.take(now, names, q, message)
            if shown is not None:
                self._publisher.publish(*shown)
        return now + self._period


class JointVelocitiesNode:
    """ROS around JointVelocities; `start` gives it parameters and topics.

    Args:
        names: The chain's joints.
        period: Between two messages [s].
        publisher: Of `velocities/joint_states`.
        twin, physical: What tf is made of; the latter is None without a physical arm.
    """

    def __init__(
        self,
        names: Sequence[str],
        velocities: JointVelocities,
        period: float,
        publisher: Sink,
        twin: ShownStream,
        physical: ShownStream | None = None,
    ):
        self.twin, self.physical = twin, physical
        self._names = names
        self._velocities = velocities
        self._period = period
        self._publisher = publisher
        self._next = 0.0
        self._silence = max(SILENCE, 2 * period)
        # poses come in a thread of their own: a pose and the end of its motion must not overtake each other
        self._lock = threading.Lock()
        self._last: tuple[int, tuple[float, ...]] | None = None
        self._heard = 0.0
        self._silent = False

    def run(self) -> None:
        """Watch for silence until shutdown."""
        while not rospy.is_shutdown():
            time.sleep(self.watch(time.monotonic()))

    def on_twin(self, now: float, stamp: int, q: tuple[float, ...]) -> float:
        """Publish a pose of the twin with its own stamp.

        Args:
            now: On the monotonic clock [s].
            stamp: Of the pose [ns].
            q: Shape (n,). [rad], [m]

        Returns:
            When the next one is of interest, on the monotonic clock [s].
        """
        with self._lock:
            self._last, self._heard, self._silent = (stamp, q), now, False
            self._publish(stamp, q, self._velocities.of(stamp, q))
        # a grid, so that the rate does not depend on how long a message takes; begun anew after a silence
        self._next = max(self._next + self._period, now)
        return self._next

    def watch(self, now: float) -> float:
        """Publish once that a silent twin is at rest, or joint_state_publisher repeats its last velocity with fresh stamps.

        Args:
            now: On the monotonic clock [s].

        Returns:
            When to look again: after this time [s].
        """
        with self._lock:
            if self._last is None or self._silent:
                return self._silence
            left = self._heard + self._silence - now
            if left > 0:
                return left
            self._silent = True
            # the pose is known of its own time only
            self._publish(*self._last, (0.0,) * len(self._names))
            return self._silence

    def _publish(self, stamp: int, q: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        message = JointState(name=self._names, position=q, velocity=velocity)
        message.header.stamp = to_time(stamp)
        self._publisher.publish(message)

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        if self._last is None:
            return Report(WARN, "the twin has no pose yet")
        if self._silent:
            return Report(WARN, "the twin is silent: its last pose is shown, at rest")
        return Report(OK, "publishing the twin's velocities")


def start(settings: Settings, robot: RobotModel, ports: Ports) -> JointVelocitiesNode:
    """Return the node with its parameters and topics."""
    return JointVelocitiesNode(
        robot.joint_names,
        JointVelocities(robot.velocity),
        PERIOD,
        ports.publishers["velocities/joint_states"],
        ShownStream(FRAME_PERIOD, ports.publishers["shown/twin"]),
        ShownStream(FRAME_PERIOD, ports.publishers["shown/physical"]) if has_arm(settings) else None,
    )


def _sleep_until(moment: float) -> None:
    # in rospy's thread of a connection: when it reads on it takes the newest of what came meanwhile
    time.sleep(max(0.0, moment - time.monotonic()))


def _on_twin(node: JointVelocitiesNode, stamp: int, q: tuple[float, ...]) -> None:
    _sleep_until(node.on_twin(time.monotonic(), stamp, q))


def _on_joints(node: JointVelocitiesNode, message: JointState) -> None:
    _sleep_until(node.twin.take(time.monotonic(), message.name, message.position, message))


def _on_physical(node: JointVelocitiesNode, stamp: int, q: tuple[float, ...]) -> None:
    assert node.physical is not None  # it is heard only where there is an arm
    _sleep_until(node.physical.take(time.monotonic(), (), q, stamp, q))


INTERFACE = Interface(
    report=JointVelocitiesNode.report,
    publishes=(
        Publication("velocities/joint_states", JointState, queue_size=5),
        Publication("shown/twin", JointState, queue_size=5),
        PosePublication("shown/physical", when=has_arm),
    ),
    hears=(
        PoseSubscription("twin/joint_states", _on_twin, queue_size=1),
        Subscription("joint_states", JointState, _on_joints, queue_size=1),
        PoseSubscription("physical/joint_states", _on_physical, queue_size=1, when=has_arm),
    ),
)
NODE = NodeShell("joint_velocities", Settings, start, INTERFACE)


def main() -> None:
    """Run the node."""
    NODE.run()
