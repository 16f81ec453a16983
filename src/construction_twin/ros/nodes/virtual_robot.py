"""virtual_robot: the twin: publishes the commanded pose, or where an arm with mass would be."""

from __future__ import annotations

import threading
from typing import Annotated, Any, Literal

import pydantic
import rospy
from sensor_msgs.msg import JointState

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.extensions import check_extras, import_extension
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.msg import Link, WorkTasks
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.params import NodeSettings
from construction_twin.ros.transport.joint_stream import Cycles, now_ns, to_time
from construction_twin.twin.virtual_robot import GazeboTwin, KinematicBackend, TwinBackend, TwinClock, VirtualRobot

#: Between two reads of the arm's stream while the twin needs nothing from it [s].
PAUSE = 0.02
#: Between two messages with efforts [ns]: a joint state that has them is read field by field, which 250 Hz have no time for.
EFFORT_PERIOD = NANOSECONDS // 50


class Settings(NodeSettings):
    """Private parameters, given in launch/bringup.launch; what follows `twin` counts with mujoco alone."""

    arm: Literal["mock", "real", "none"]
    twin: Literal["kinematic", "mujoco", "gazebo"]
    self_collision: str
    drives: str
    tool: str = ""
    payload: list[Annotated[float, pydantic.Field(allow_inf_nan=False)]] = []


def is_simulated_here(settings: Settings) -> bool:
    """Return whether it is simulated in this process."""
    return settings.twin == "mujoco"


def is_in_gazebo(settings: Settings) -> bool:
    """Return whether it is simulated by Gazebo."""
    return settings.twin == "gazebo"


class VirtualRobotNode:
    """ROS around a VirtualRobot and its TwinClock."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO):
        self._robot = VirtualRobot(robot.home if settings.arm == "none" else None, robot.linear)
        self._limits, self._names, self._diagnostics = MotionLimits.of(robot), robot.joint_names, node_io.diagnostics
        self._publishers, self._twin = node_io.publishers, node_io.publishers["twin/joint_states"]
        self._commanded = node_io.publishers.get("twin/commanded")
        self._gazebo = GazeboTwin() if is_in_gazebo(settings) else None
        self._backend: TwinBackend = self._gazebo or KinematicBackend()
        #: The twin with mass, of the extension physics.
        self._simulated: Any = None
        if is_simulated_here(settings):
            simulated = import_extension("physics.nodes.simulated_twin")
            self._simulated = simulated.SimulatedTwin(settings, robot, node_io.diagnostics.refuse)
            self._backend = self._simulated.twin
        self._effort_at = 0
        self._lock = threading.Lock()
        self._cycles, self._clock = Cycles(), TwinClock()
        self._session: str | None = None
        self._leads = False
        # ends the wait of `run` for a silence
        self._restarted = threading.Event()
        # the twin needs the arm's poses: it has none of its own, or follows
        self._needs_arm = threading.Event()
        self._needs_arm.set()

    def run(self) -> None:
        """Publish the held pose while no commands come, until shutdown."""
        for stamp, _ in self._cycles:
            self._restarted.clear()
            with self._lock:
                # the grid may have gone back since
                present = stamp <= self._cycles.now()
                if self._robot.pose is not None and present and self._clock.on_cycle(stamp):
                    self._advance(stamp, self._robot.pose, True)
                idle = self._clock.idle(stamp)
            if idle > CYCLE_NS:
                # commands come, and their poses are published with them
                self._restarted.wait(idle / NANOSECONDS)
                self._cycles.skip()

    def _advance(self, stamp: int, commanded: tuple[float, ...], published: bool) -> None:
        """Simulate one cycle, and publish its poses with a stamp [ns] if `published`; under the lock."""
        if published and self._gazebo is not None:
            # before it can be answered
            self._gazebo.on_published(stamp)
        if published and self._commanded is not None:
            # first: who decides what is commanded next waits for no simulation
            self._commanded.publish(stamp, commanded)
        pose = self._backend.cycle(commanded)
        if not published or pose is None:
            return
        self._twin.publish(stamp, pose)
        if self._simulated is not None and abs(stamp - self._effort_at) >= EFFORT_PERIOD and self._backend.effort:
            self._effort_at = stamp
            message = JointState(name=self._names, position=pose, effort=self._backend.effort)
            message.header.stamp = to_time(stamp)
            self._publishers["twin/effort"].publish(message)

    def on_simulated(self, stamp: int, q: tuple[float, ...]) -> None:
        """Publish a pose that Gazebo has simulated [rad], with the stamp of its command [ns]."""
        gazebo = self._gazebo
        if gazebo is None:
            return
        with self._lock:
            if gazebo.on_simulated_pose(stamp):
                self._twin.publish(stamp, q)
                return
        self._diagnostics.refuse("answer", "a simulated pose with the stamp of no command, or of one answered before")

    def on_scene(self, message: SceneMsg) -> None:
        """Pass the scene on to the simulation. In rospy's thread of this connection, which may wait."""
        self._simulated.on_scene(message)

    def on_tasks(self, message: WorkTasks) -> None:
        """Pass on what elements weigh."""
        self._simulated.on_tasks(message)

    def on_command(self, stamp: int, q: tuple[float, ...]) -> None:
        """Execute a command [rad] with its stamp [ns]."""
        with self._lock:
            set_back = self._clock.is_set_back(stamp, self._robot.stamp, self._cycles.now())
            if set_back:
                self._robot.begin_stream()
            if self._robot.execute(stamp, q):
                if set_back:
                    self._clock.restart()
                    self._cycles.begin_at(stamp)
                self._advance(stamp, q, self._clock.on_command(stamp, self._cycles.reach(stamp)))
                return
        why = "command before the arm's pose was taken over, away from it, or not newer than the last"
        self._diagnostics.refuse("order", why)

    def on_physical(self, stamp: int, q: tuple[float, ...]) -> None:
        """Follow the arm's pose [rad], or begin at it, with its stamp [ns]; waits while the twin needs none."""
        with self._lock:
            if self._robot.mirrors:
                follows = self._robot.follow(stamp, q) and self._clock.on_command(stamp, self._cycles.reach(stamp))
                if follows and self._robot.pose is not None:
                    self._advance(stamp, self._robot.pose, True)
            elif self._robot.assume_pose(q):
                rospy.loginfo("took over the physical arm's pose")
                if self._leads:
                    self._robot.begin_mirror(self._limits)
            if self._robot.pose is not None and not self._leads:
                self._needs_arm.clear()
        # rospy reads on when this returns: poses that are not needed are taken in bundles, which costs a fraction
        if now_ns() - stamp < CYCLE_NS:
            self._needs_arm.wait(PAUSE)

    def on_link(self, message: Link) -> None:
        """Store the link's state: a new session begins at the arm's pose, in mirror mode the arm leads."""
        leads = message.state == Link.MIRROR
        with self._lock:
            begins = bool(message.session) and message.session != self._session
            if begins:
                # to follow the arm the twin sets out from where it is; otherwise it takes the arm's pose
                if self._session is not None and not leads:
                    self._robot.restart()
                    self._backend.restart()
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

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        if self._robot.pose is None:
            return Diagnosis(WARN, "waiting for the physical arm's pose")
        activity = "following the physical arm" if self._robot.mirrors else "executing"
        if self._gazebo is not None:
            fault = self._backend.fault
            return Diagnosis(WARN if fault else OK, fault or activity)
        if self._simulated is None:
            return Diagnosis(OK, activity)
        contacts = ", ".join(f"{first} + {second}" for first, second in self._backend.contacts)
        values = {"simulated scene": self._simulated.scene, "contacts": contacts or "none"}
        touches = contacts and f"the simulated arm touches: {contacts}"
        fault = self._simulated.scene_fault or self._backend.fault or touches
        return Diagnosis(WARN, fault, values) if fault else Diagnosis(OK, activity, values)


INTERFACE = shell.Interface(
    diagnose=VirtualRobotNode.diagnose,
    publishes=(
        shell.PosePublication("twin/joint_states"),
        shell.PosePublication("twin/commanded", when=shell.has_mass),
        shell.Publication("twin/effort", JointState, queue_size=5, when=is_simulated_here),
    ),
    subscribes=(
        shell.PoseSubscription("command/joint_states", VirtualRobotNode.on_command),
        shell.Subscription("link", Link, VirtualRobotNode.on_link, queue_size=5, when=shell.has_arm),
        shell.PoseSubscription("physical/joint_states", VirtualRobotNode.on_physical, when=shell.has_arm),
        shell.Subscription("work/tasks", WorkTasks, VirtualRobotNode.on_tasks, queue_size=1, when=is_simulated_here),
        shell.Subscription("scene", SceneMsg, VirtualRobotNode.on_scene, queue_size=1, when=is_simulated_here),
        shell.PoseSubscription("gazebo/joint_states", VirtualRobotNode.on_simulated, when=is_in_gazebo),
    ),
)


def check(settings: Settings, robot: RobotModel, *_: object) -> None:
    """Check that a twin with mass can be simulated; see `NodeShell`."""
    if settings.twin == "gazebo" and settings.payload:
        expected = "none with twin:=gazebo, whose world knows no payload; twin:=mujoco does"
        raise ConfigurationError("payload", settings.payload, expected)
    if shell.has_mass(settings):
        import_extension("physics")
    if is_simulated_here(settings):
        check_extras("physics")
        import_extension("physics.nodes.simulated_twin").check(settings, robot)


NODE = shell.NodeShell("virtual_robot", Settings, VirtualRobotNode, INTERFACE, check, fast=True)
main = NODE.run
