"""virtual_robot: the kinematic twin. Executes `command/joint_states`, publishes `twin/joint_states`."""

from __future__ import annotations

import threading
from typing import Literal

import rospy

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.msg import Link
from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.params import NodeSettings
from construction_twin.ros.shared.ports import (
    Interface,
    Ports,
    PosePublication,
    PoseSubscription,
    Subscription,
    has_arm,
)
from construction_twin.ros.transport.cycle import Cycles
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.publisher import Sink
from construction_twin.twin.virtual_robot import TwinClock, VirtualRobot

#: Between two reads of the arm's stream while the twin needs nothing from it [s].
PAUSE = 0.02


class Settings(NodeSettings):
    """Private parameters, given in launch/gate.launch: the physical arm."""

    arm: Literal["mock", "real", "none"]


class VirtualRobotNode:
    """ROS around a VirtualRobot and its TwinClock; `start` gives it parameters and topics.

    Args:
        limits: Within which it follows the physical arm.
        twin: For its pose.
        diagnostics: Counts what is refused.
        restarted: Ends the wait of `run` for a silence.
    """

    def __init__(
        self,
        robot: VirtualRobot,
        limits: MotionLimits,
        twin: Sink,
        diagnostics: NodeDiagnostics,
        restarted: threading.Event,
    ):
        self._robot = robot
        self._limits = limits
        self._twin = twin
        self._lock = threading.Lock()
        self._cycles = Cycles()
        self._clock = TwinClock()
        self._session: str | None = None
        self._leads = False
        self._restarted = restarted
        # the twin needs the arm's poses: it has none of its own, or follows
        self._needs_arm = threading.Event()
        self._needs_arm.set()
        self._diagnostics = diagnostics

    def run(self) -> None:
        """Publish the held pose while no commands come, until shutdown."""
        for stamp, _ in self._cycles:
            self._restarted.clear()
            with self._lock:
                # the grid may have gone back since
                present = stamp <= self._cycles.now()
                if self._robot.pose is not None and present and self._clock.on_cycle(stamp):
                    self._twin.publish(stamp, self._robot.pose)
                idle = self._clock.idle(stamp)
            if idle > CYCLE_NS:
                # commands come, and their poses are published with them
                self._restarted.wait(idle / NANOSECONDS)
                self._cycles.skip()

    def on_command(self, stamp: int, q: tuple[float, ...]) -> None:
        """Execute a command [rad] with its stamp [ns]."""
        with self._lock:
            earlier = self._clock.is_earlier(stamp, self._robot.stamp, self._cycles.now())
            if earlier:
                self._robot.begin_stream()
            if self._robot.execute(stamp, q):
                if earlier:
                    self._clock.restart()
                    self._cycles.begin_at(stamp)
                if self._clock.on_command(stamp, self._cycles.reach(stamp)):
                    self._twin.publish(stamp, q)
                return
        self._diagnostics.refuse(
            "order", "command before the arm's pose was taken over, away from it, or not newer than the last"
        )

    def on_physical(self, stamp: int, q: tuple[float, ...]) -> None:
        """Take the arm's pose [rad] with its stamp [ns]; waits while the twin needs none."""
        with self._lock:
            if self._robot.mirrors:
                follows = self._robot.follow(stamp, q) and self._clock.on_command(stamp, self._cycles.reach(stamp))
                if follows and self._robot.pose is not None:
                    self._twin.publish(stamp, self._robot.pose)
            elif self._robot.take_over(q):
                rospy.loginfo("took over the physical arm's pose")
                if self._leads:
                    self._robot.begin_mirror(self._limits)
            if self._robot.pose is not None and not self._leads:
                self._needs_arm.clear()
        # rospy reads on when this returns: poses that are not needed are taken in bundles, which costs a fraction
        if now_ns() - stamp < CYCLE_NS:
            self._needs_arm.wait(PAUSE)

    def on_link(self, message: Link) -> None:
        """Take the link's state: a new session begins at the arm's pose, in mirror mode the arm leads."""
        leads = message.state == Link.MIRROR
        with self._lock:
            begins = bool(message.session) and message.session != self._session
            if begins:
                # to follow the arm the twin sets out from where it is; otherwise it takes the arm's pose
                if self._session is not None and not leads:
                    self._robot.restart()
                    self._clock.restart()
                    self._restarted.set()
                    self._needs_arm.set()
                self._session = message.session
            if leads is self._leads:
                return
            self._leads = leads
            if leads:
                self._robot.begin_mirror(self._limits)
                self._needs_arm.set()
            else:
                self._robot.end_mirror()
        rospy.loginfo("follows the physical arm" if leads else "executes commands")

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        if self._robot.pose is None:
            return Report(WARN, "waiting for the physical arm's pose")
        return Report(OK, "following the physical arm" if self._robot.mirrors else "executing")


def start(settings: Settings, robot: RobotModel, ports: Ports) -> VirtualRobotNode:
    """Return the twin with its parameters and topics."""
    return VirtualRobotNode(
        VirtualRobot(robot.home if settings.arm == "none" else None, robot.linear),
        MotionLimits.of(robot),
        ports.publishers["twin/joint_states"],
        ports.diagnostics,
        threading.Event(),
    )


INTERFACE = Interface(
    report=VirtualRobotNode.report,
    publishes=(PosePublication("twin/joint_states"),),
    hears=(
        PoseSubscription("command/joint_states", VirtualRobotNode.on_command),
        Subscription("link", Link, VirtualRobotNode.on_link, queue_size=5, when=has_arm),
        PoseSubscription("physical/joint_states", VirtualRobotNode.on_physical, when=has_arm),
    ),
)
NODE = NodeShell("virtual_robot", Settings, start, INTERFACE, fast=True)


def main() -> None:
    """Run the node."""
    NODE.run()
