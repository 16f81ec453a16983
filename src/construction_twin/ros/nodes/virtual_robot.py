"""virtual_robot: the kinematic twin. Executes `command/joint_states`, publishes `twin/joint_states`."""

from __future__ import annotations

import sys
import threading
from typing import Literal

import rospy

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.msg import Link
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import NodeSettings, read_parameters, robot_from_parameters
from construction_twin.ros.transport.cycle import Cycles
from construction_twin.ros.transport.joint_stream import JointPublisher, JointSubscriber, now_ns
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.twin.virtual_robot import TwinClock, VirtualRobot

#: Between two reads of the arm's stream while the twin needs nothing from it [s].
PAUSE = 0.02


class Settings(NodeSettings):
    """Private parameters, given in launch/twin.launch: the physical arm."""

    arm: Literal["mock", "real", "none"]


class VirtualRobotNode:
    """ROS around a VirtualRobot and its TwinClock."""

    def __init__(self):
        settings = read_parameters(Settings)
        robot = robot_from_parameters()
        self._robot = VirtualRobot(robot.home if settings.arm == "none" else None, robot.linear)
        self._lock = threading.Lock()
        self._cycles = Cycles()
        self._clock = TwinClock()
        self._limits = MotionLimits.of(robot)
        self._session: str | None = None
        self._leads = False
        self._restarted = threading.Event()
        # the twin needs the arm's poses: it has none of its own, or follows
        self._needs_arm = threading.Event()
        self._needs_arm.set()
        self._diagnostics = NodeDiagnostics(robot.name, self._report)
        self._twin = JointPublisher("twin/joint_states", robot.joint_names)
        names, refuse = robot.joint_names, self._diagnostics.refuse
        JointSubscriber("command/joint_states", names, self._on_command, refuse)
        if settings.arm != "none":
            Subscriber("link", Link, self._on_link, refuse, queue_size=5)
            JointSubscriber("physical/joint_states", names, self._on_physical, refuse)

    def run(self) -> None:
        """Publish the held pose while no commands come, until shutdown."""
        for stamp, _ in self._cycles:
            self._restarted.clear()
            with self._lock:
                if self._robot.pose is not None and self._clock.on_cycle(stamp):
                    self._twin.publish(stamp, self._robot.pose)
                idle = self._clock.idle(stamp)
            if idle > CYCLE_NS:
                # commands come, and their poses are published with them
                self._restarted.wait(idle / NANOSECONDS)
                self._cycles.skip()

    def _on_command(self, stamp: int, q: tuple[float, ...]) -> None:
        with self._lock:
            if self._robot.execute(stamp, q):
                if self._clock.on_command(stamp, self._cycles.reach(stamp)):
                    self._twin.publish(stamp, q)
                return
        self._diagnostics.refuse(
            "order", "command before the arm's pose was taken over, away from it, or not newer than the last"
        )

    def _on_physical(self, stamp: int, q: tuple[float, ...]) -> None:
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

    def _on_link(self, message: Link) -> None:
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

    def _report(self) -> Report:
        if self._robot.pose is None:
            return Report(WARN, "waiting for the physical arm's pose")
        return Report(OK, "following the physical arm" if self._robot.mirrors else "executing")


def main() -> None:
    """Run the node."""
    sys.setswitchinterval(0.001)
    run_node("virtual_robot", VirtualRobotNode)
