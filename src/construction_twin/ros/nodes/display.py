"""display: markers, frames and poses at a low rate, for people. Nothing waits for it.

Of a twin with mass `velocities/joint_states`, and so `joint_states` and tf, have the commanded pose: goals are looked up there. The
trees of tf of arm, ghost, simulated and expected arm are made here.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from typing import Generic, Literal, TypeVar

import genpy
import numpy as np
import PyKDL
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from construction_twin.core.reports import HoldReport
from construction_twin.core.units import NANOSECONDS
from construction_twin.kinematics.chain import Chain, Pose, to_frame, to_kdl
from construction_twin.monitor.states import SyncState
from construction_twin.msg import Execution, Hold, Plan, Rehearsal, Review, Scene, Sync
from construction_twin.robot.description import Following, RobotModel
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.display_markers import (
    arm_markers,
    headline_height,
    headline_marker,
    visual_markers,
    worst_joint,
)
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import tf_frame
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.plan_display import PlanDisplay
from construction_twin.ros.transport.joint_stream import now_ns, to_time
from construction_twin.scene.neighbour import load_cell
from construction_twin.srv import PreviewPlan
from construction_twin.validation import StrictModel
from construction_twin.views.texts import hold_cause

#: Between two messages with velocities, which are means over it, and between two poses that people look at [s].
PERIOD, FRAME_PERIOD = 0.02, 0.04
#: A twin that has published nothing for this time is silent [s].
SILENCE = 0.25
#: How often the picture of the monitor's state is made, and without a report for how long that state is not known [s].
SYNC_PERIOD, SYNC_SILENCE = 0.2, 1.0

#: Time between two poses that are shown at rest [s].
REST_PERIOD = 0.2
#: A joint that is no further than this from where it was shown last has not moved [rad], [m]: 25 µm at the end of an arm of 2.5 m.
#: A measured pose is never quite still.
STILL = 1e-5
#: A pose that is further from the last one than the joints' speed limits allow, by this factor, was not moved to: the twin has
#: taken the arm's pose over. Rounding to three decimals of a degree adds a few percent at 20 ms.
_JUMP = 1.1

Shown = TypeVar("Shown")
#: Trees of tf that are made here, besides the twin's.
TREES = ("physical", "preview", "simulated", "expected")


class Settings(StrictModel):
    """Private parameters, given in launch/bringup.launch: launch arguments of these names."""

    arm: Literal["mock", "real", "none"]
    twin: Literal["kinematic", "mujoco", "gazebo"]
    servo_model: str


class ShownPoses(Generic[Shown]):
    """Selects which poses of a stream are shown."""

    def __init__(self):
        self._names: tuple[str, ...] = ()
        self._q: tuple[float, ...] = ()
        self._at = 0.0
        self._left_out: Shown | None = None

    def next_shown(self, now: float, names: Sequence[str], q: Sequence[float], shown: Shown) -> Shown | None:
        """Return what is shown now: the pose, at the end of a rest the one before, or None."""
        same_joints = tuple(names) == self._names
        moved = not same_joints or any(abs(value - before) > STILL for value, before in zip(q, self._q))
        if not moved and now - self._at < REST_PERIOD:
            self._left_out = shown
            return None
        left_out, self._left_out, self._at = self._left_out, None, now
        if moved and same_joints and left_out is not None:
            # tf draws a line from one frame to the next: a motion begins where the rest ended, not up to `REST_PERIOD` before
            return left_out
        self._names, self._q = tuple(names), tuple(q)
        return shown


class JointVelocities:
    """Velocities of a chain's joints; `largest`: their speed limits [rad/s], [m/s]."""

    def __init__(self, largest: Sequence[float]):
        self._largest = tuple(_JUMP * velocity for velocity in largest)
        self._rest = (0.0,) * len(self._largest)
        self._last: tuple[int, tuple[float, ...]] | None = None

    def update(self, stamp: int, q: tuple[float, ...]) -> tuple[float, ...]:
        """Store a pose and return the mean velocities since the last one [rad/s], [m/s]; 0 for no newer stamp, or a jump."""
        before, self._last = self._last, (stamp, q)
        if before is None or stamp <= before[0]:
            return self._rest
        period = (stamp - before[0]) / NANOSECONDS
        moved = tuple([(value - was) / period for value, was in zip(q, before[1])])
        if all(abs(speed) <= largest for speed, largest in zip(moved, self._largest)):
            return moved
        return self._rest


class RobotFrames:
    """The frames of a robot's copies, below a prefix each; the URDF's root stands at `place` in ``world``."""

    def __init__(self, robot: RobotModel, place: Pose):
        model = parse_urdf(robot.urdf)
        # the URDF's root, which need not be the base of the chain: any other link has a parent already
        self._root, self._place = model.get_root(), to_frame(place)
        moves = {name: Following(name, 1.0, 0.0) for name in robot.joint_names}
        moves |= {other.name: other.following for other in robot.other_joints if other.following is not None}
        positions = {other.name: other.position for other in robot.other_joints if other.position is not None}
        # kept: its segments live in it
        self._segments = to_kdl(model.joints)
        self._static: list[tuple[str, str, PyKDL.Frame]] = []
        self._floating: list[tuple[str, str, PyKDL.Frame]] = []
        self._moving: list[tuple[str, str, PyKDL.Segment, int, Following]] = []
        for number, joint in enumerate(model.joints):
            segment = self._segments.getSegment(number)
            if (following := moves.get(joint.name)) is not None:
                leader = robot.joint_names.index(following.leader)
                self._moving.append((joint.parent, joint.child, segment, leader, following))
                continue
            frames = self._floating if joint.joint_type == "floating" else self._static
            frames.append((joint.parent, joint.child, segment.pose(positions.get(joint.name, 0.0))))

    def unpublished_frames(self, prefix: str, stamp: genpy.Time) -> list[TransformStamped]:
        """Return the twin's frames that the stock nodes leave out: its place, and floating joints."""
        root = _transform("world", tf_frame(prefix, self._root), self._place, stamp)
        return [root, *(_below(prefix, *frame, stamp) for frame in self._floating)]

    def static_frames(self, prefix: str, stamp: genpy.Time) -> list[TransformStamped]:
        """Return every frame of a copy that does not move with the chain."""
        return [*self.unpublished_frames(prefix, stamp), *(_below(prefix, *frame, stamp) for frame in self._static)]

    def moving_frames(self, prefix: str, stamp: genpy.Time, q: Sequence[float]) -> list[TransformStamped]:
        """Return the frames of a copy that move with the chain."""
        return [
            _below(prefix, parent, child, segment.pose(following.factor * q[leader] + following.offset), stamp)
            for parent, child, segment, leader, following in self._moving
        ]


def _below(prefix: str, parent: str, child: str, place: PyKDL.Frame, stamp: genpy.Time) -> TransformStamped:
    return _transform(tf_frame(prefix, parent), tf_frame(prefix, child), place, stamp)


def _transform(parent: str, child: str, place: PyKDL.Frame, stamp: genpy.Time) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    message.transform.translation = Vector3(*place.p)
    message.transform.rotation = Quaternion(*place.M.GetQuaternion())
    return message


class DisplayNode:
    """Poses, trees of tf and the picture of the monitor's state; the plan is a `PlanDisplay`'s."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO):
        self._robot = robot
        self._publishers, self._diagnostics = node_io.publishers, node_io.diagnostics
        self._shapes = visual_markers(robot.urdf)
        self.plan = PlanDisplay(robot, self._shapes, self._prefix("preview"), node_io)
        self._text_height = headline_height(Chain(robot))
        self._sync: tuple[float, Sync] | None = None
        self._hold: HoldReport | None = None
        self._sync_shown: tuple[SyncState, str, str] | None = None
        self._velocities = JointVelocities(robot.velocity)
        # poses come in a thread of their own: a pose and the end of its motion must not overtake each other
        self._lock = threading.Lock()
        self._twin: tuple[int, tuple[float, ...]] | None = None
        self._received_at = self._next = 0.0
        self._silent = False
        self._twin_shown: ShownPoses[JointState] = ShownPoses()
        self._poses_shown = {tree: ShownPoses[tuple[int, tuple[float, ...]]]() for tree in TREES}
        cell = node_io.parameters["cell"]
        place = Pose(np.zeros(3), np.eye(3)) if cell is None else load_cell(cell).world_T_root(robot.name)
        self._frames = RobotFrames(robot, place)
        self._publish_static_frames(settings)

    def _prefix(self, tree: str) -> str:
        return f"{self._robot.name}/{tree}"

    def _publish_static_frames(self, settings: Settings) -> None:
        now = to_time(now_ns())
        shown = shell.has_arm(settings), True, shell.has_mass(settings), shell.knows_servos(settings)
        trees = [tree for tree, is_shown in zip(TREES, shown) if is_shown]
        transforms = self._frames.unpublished_frames(self._prefix("twin"), now)
        for tree in trees:
            transforms += self._frames.static_frames(self._prefix(tree), now)
        if not shell.has_arm(settings):
            # the root alone: nothing below it would move, and the links at its end would be a tree of their own
            transforms += self._frames.unpublished_frames(self._prefix("physical"), now)
        self._publishers["/tf_static"].publish(TFMessage(transforms))

    # -- poses

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Publish a pose of the twin with velocities and its own stamp, and read the next one when it is due."""
        now = time.monotonic()
        with self._lock:
            self._twin, self._received_at, self._silent = (stamp, q), now, False
            self._publish_twin(stamp, q, self._velocities.update(stamp, q))
        # a grid, so that the rate does not depend on how long a message takes; begun anew after a silence
        self._next = max(self._next + PERIOD, now)
        # in rospy's thread of a connection: when it reads on it takes the newest of what came meanwhile
        time.sleep(max(0.0, self._next - time.monotonic()))

    def on_joints(self, message: JointState) -> None:
        """Forward the twin's joint states to its tree of tf."""
        with self._lock:  # anybody may publish these
            shown = self._twin_shown.next_shown(time.monotonic(), message.name, message.position, message)
        if shown is not None:
            self._publishers["shown/twin"].publish(shown)
        time.sleep(FRAME_PERIOD)

    def move_ghost(self) -> None:
        """Publish the ghost's pose, and once the rest of a silent twin, against joint_state_publisher's last velocity."""
        now = time.monotonic()
        with self._lock:
            twin = self._twin
            if twin is not None and not self._silent and now - self._received_at >= SILENCE:
                self._silent = True
                # the pose is known of its own time only
                self._publish_twin(*twin, (0.0,) * len(twin[1]))
        pose = self.plan.ghost(now, None if twin is None else twin[1])
        if pose is not None and (shown := self.show("preview", now_ns(), pose)) is not None:
            self._publishers["preview/joint_states"].publish(*shown)

    def _publish_twin(self, stamp: int, q: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        message = JointState(name=self._robot.joint_names, position=q, velocity=velocity)
        message.header.stamp = to_time(stamp)
        self._publishers["velocities/joint_states"].publish(message)

    def show(self, tree: str, stamp: int, q: tuple[float, ...]) -> tuple[int, tuple[float, ...]] | None:
        """Publish a pose [rad] in a tree of tf and return it, if it is due."""
        shown = self._poses_shown[tree].next_shown(time.monotonic(), (), q, (stamp, q))
        if shown is not None:
            self._publish_frames(tree, *shown)
        return shown

    def _publish_frames(self, tree: str, stamp: int, q: tuple[float, ...]) -> None:
        self._publishers["/tf"].publish(TFMessage(self._frames.moving_frames(self._prefix(tree), to_time(stamp), q)))

    # -- the monitor's state

    def on_sync(self, message: Sync) -> None:
        """Store the monitor's state."""
        if message.state not in SyncState._value2member_map_:
            self._diagnostics.refuse("sync", f"sync state {message.state} is unknown; expected one of Sync.msg")
            return
        self._sync = time.monotonic(), message

    def on_hold(self, message: Hold) -> None:
        """Store why the gate is closed."""
        self._hold = from_msg(HoldReport, message)

    def show_sync(self) -> None:
        """Draw the picture of the state anew, and publish it where it has changed."""
        received_at, last = self._sync or (-math.inf, None)
        if last is None or time.monotonic() - received_at > SYNC_SILENCE:
            shown = SyncState.WAITING, "no report on sync: is pca_monitor running?", ""
        else:
            state, cause = SyncState(last.state), hold_cause(self._hold)
            worst = "" if cause else worst_joint(last.name, last.error, last.threshold, self._robot.linear)
            # what changes without an end while twin and arm agree is not shown
            shown = (state, "", "") if state is SyncState.IN_SYNC else (state, cause or last.reason, worst)
        publisher = self._publishers.get("sync_markers")
        if publisher is None or shown == self._sync_shown:
            return
        self._sync_shown = shown
        prefix = self._prefix("physical")
        over_arm = headline_marker(*shown, tf_frame(prefix, self._robot.base_link), self._text_height)
        publisher.publish(MarkerArray(markers=[*arm_markers(self._shapes, shown[0], prefix), over_arm]))

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        values = {"plan": self.plan.plan_id, "state": self._sync_shown[0].name if self._sync_shown else ""}
        if self._twin is None:
            return Diagnosis(WARN, "the twin has no pose yet", values)
        if self._silent:
            return Diagnosis(WARN, "the twin is silent: its last pose is shown, at rest", values)
        return Diagnosis(OK, "shows twin, arm and plan", values)


def _shown_pose(topic: str, tree: str, when: shell.When) -> shell.PoseSubscription:
    return shell.PoseSubscription(
        topic, lambda node, *pose: node.show(tree, *pose), queue_size=1, pause=FRAME_PERIOD, when=when
    )


INTERFACE = shell.Interface(
    diagnose=DisplayNode.diagnose,
    parameters=(shell.SharedParameter("cell"),),
    publishes=(
        shell.Publication("velocities/joint_states", JointState, queue_size=5),
        shell.Publication("shown/twin", JointState, queue_size=5),
        shell.PosePublication("preview/joint_states"),
        shell.Publication("/tf", TFMessage, queue_size=100, tcp_nodelay=True),
        shell.Publication("/tf_static", TFMessage, queue_size=100, latch=True),
        shell.Publication("plan_markers", MarkerArray, queue_size=2, latch=True),
        shell.Publication("sync_markers", MarkerArray, queue_size=2, latch=True, when=shell.has_arm),
    ),
    subscribes=(
        shell.PoseSubscription("twin/joint_states", DisplayNode.on_twin, queue_size=1),
        shell.Subscription("joint_states", JointState, DisplayNode.on_joints, queue_size=1),
        _shown_pose("physical/joint_states", "physical", shell.has_arm),
        _shown_pose("twin/effort", "simulated", shell.has_mass),
        _shown_pose("expected/joint_states", "expected", shell.knows_servos),
        shell.Subscription("sync", Sync, DisplayNode.on_sync, queue_size=1, when=shell.has_arm),
        shell.Subscription("hold", Hold, DisplayNode.on_hold, queue_size=1, when=shell.has_arm),
        shell.Subscription("scene", Scene, lambda node, message: node.plan.on_scene(message), queue_size=1),
        shell.Subscription("review", Review, lambda node, message: node.plan.on_review(message), queue_size=5),
        shell.Subscription(
            "execution", Execution, lambda node, message: node.plan.on_execution(message), queue_size=10
        ),
        shell.Subscription("plan", Plan, lambda node, message: node.plan.on_plan(message), queue_size=2),
        shell.Subscription("rehearsal", Rehearsal, lambda node, message: node.plan.on_rehearsal(message), queue_size=2),
    ),
    serves=(shell.Served("preview_plan", PreviewPlan, lambda node, request: node.plan.on_preview(request)),),
    timers=(
        shell.NodeTimer(lambda _settings: FRAME_PERIOD, DisplayNode.move_ghost),
        shell.NodeTimer(lambda _settings: SYNC_PERIOD, DisplayNode.show_sync),
    ),
)


def check(_settings: Settings, robot: RobotModel, shared: shell.Shared) -> None:
    """Check that the robot has a place in the cell; see `NodeShell`."""
    if shared["cell"] is not None:
        load_cell(shared["cell"]).world_T_root(robot.name)


NODE = shell.NodeShell("display", Settings, DisplayNode, INTERFACE, check)
main = NODE.run
