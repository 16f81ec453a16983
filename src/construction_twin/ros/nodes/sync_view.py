"""sync_view: shows the monitor's state in rviz (`sync_markers`): the physical arm coloured by it, and why it is not in sync."""

from __future__ import annotations

import math
import threading
import time

import pydantic
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Chain
from construction_twin.monitor.states import SyncState
from construction_twin.msg import Hold, Sync
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import SHAPES, tf_frame
from construction_twin.ros.shared.diagnostics import OK, WARN, Report
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.ports import Every, Interface, Ports, Publication, Subscription
from construction_twin.views.hold_cause import hold_cause
from construction_twin.views.sync_picture import (
    COLOURS,
    Shape,
    headline,
    headline_height,
    visual_shapes,
    worst_joint,
)

#: How often the picture is made [s]; it is published when it changes.
PERIOD = 0.2
#: Without a report for this long the monitor's state is not known [s].
SILENCE = 1.0
#: Height of a line of the text, and how far in front of the arm's axis it stands [m].
TEXT_SIZE, TEXT_FORWARD = 0.085, 0.4
_DARK = ColorRGBA(0.35, 0.0, 0.0, 1.0)


class Settings(pydantic.BaseModel):
    """Private parameters, given in launch/twin.launch.

    Attributes:
        tf_prefix: Of the physical arm's frames.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    tf_prefix: str


class SyncViewNode:
    """ROS around `sync_picture`."""

    def __init__(self, settings: Settings, robot: RobotModel, ports: Ports):
        self._prefix = settings.tf_prefix
        self._robot = robot
        self._shapes = visual_shapes(self._robot.urdf)
        chain = Chain(self._robot)
        self._text_at = Point(TEXT_FORWARD, 0.0, headline_height(float(chain.shoulder[2]), chain.arm_length))
        self._lock = threading.Lock()
        self._last: Sync | None = None
        self._hold: HoldReport | None = None
        self._heard = -math.inf
        self._shown: tuple[SyncState, str] | None = None
        self._diagnostics = ports.diagnostics
        self._markers = ports.publishers["sync_markers"]

    def on_sync(self, message: Sync) -> None:
        """Take the monitor's state."""
        if message.state not in SyncState._value2member_map_:
            self._diagnostics.refuse("sync", Sentence("reason.refused.sync_state", state=message.state))
            return
        with self._lock:
            self._last, self._heard = message, time.monotonic()

    def on_hold(self, message: Hold) -> None:
        """Take why the gate is closed."""
        with self._lock:
            self._hold = from_msg(HoldReport, message)

    def update(self) -> None:
        """Make the picture anew, and publish it where it has changed."""
        with self._lock:
            last, silent = self._last, time.monotonic() - self._heard > SILENCE
            cause = hold_cause(self._hold)
        if last is None or silent:
            picture = SyncState.WAITING, headline(SyncState.WAITING, Sentence("view.sync_silent"), "")
        else:
            state = SyncState(last.state)
            worst = worst_joint(last.name, last.error, last.threshold, self._robot.linear)
            picture = state, headline(state, cause or last.reason, "" if cause else worst)
        if picture != self._shown:
            self._draw(*picture)

    def _draw(self, state: SyncState, text: str) -> None:
        self._shown = state, text
        markers = arm_markers(self._shapes, state, self._prefix)
        markers.append(text_marker(text, tf_frame(self._prefix, self._robot.base_link), self._text_at))
        self._markers.publish(MarkerArray(markers=markers))

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        if self._shown is None:
            return Report(OK, "nothing shown yet")
        state = self._shown[0]
        level = OK if state is SyncState.IN_SYNC else WARN
        return Report(level, f"shows {state.name}", {"shapes": len(self._shapes)})


def arm_markers(shapes: tuple[Shape, ...], state: SyncState, tf_prefix: str) -> list[Marker]:
    """Return the physical arm in the colour of a state: one marker per shape, in its link's frame."""
    return [_arm_marker(number, shape, ColorRGBA(*COLOURS[state]), tf_prefix) for number, shape in enumerate(shapes)]


def _arm_marker(number: int, shape: Shape, colour: ColorRGBA, tf_prefix: str) -> Marker:
    marker = Marker(ns="physical", id=number, type=SHAPES[shape.kind], action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = tf_frame(tf_prefix, shape.link)
    marker.mesh_resource = shape.mesh
    marker.pose = Pose(Point(*shape.position), Quaternion(*shape.quaternion))
    marker.scale, marker.color = Vector3(*shape.scale), colour
    return marker


def text_marker(text: str, frame: str, at: Point) -> Marker:
    """Return the text over the arm, at a point of the frame, or its removal when there is none."""
    marker = Marker(ns="why", type=Marker.TEXT_VIEW_FACING, action=Marker.ADD if text else Marker.DELETE)
    marker.header.frame_id = frame
    marker.frame_locked = True
    marker.text, marker.color = text, _DARK
    marker.pose = Pose(at, Quaternion(0, 0, 0, 1))
    marker.scale.z = TEXT_SIZE
    return marker


INTERFACE = Interface(
    report=SyncViewNode.report,
    publishes=(Publication("sync_markers", MarkerArray, queue_size=2, latch=True),),
    hears=(
        Subscription("sync", Sync, SyncViewNode.on_sync, queue_size=1),
        Subscription("hold", Hold, SyncViewNode.on_hold, queue_size=1),
    ),
    every=(Every(lambda _settings: PERIOD, lambda node, _ports: node.update()),),
)
NODE = NodeShell("sync_view", Settings, SyncViewNode, INTERFACE)


def main() -> None:
    """Run the node."""
    NODE.run()
