"""How the marker at the tool looks in rviz: arrows, rings and a handle to grab, and beside it the verdict as colour and text.

The verdict is drawn by markers of its own, because rviz takes a changed interactive marker for a new one in the middle of a drag.
"""

from __future__ import annotations

import math
import textwrap

from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import InteractiveMarker, InteractiveMarkerControl, Marker, MarkerArray

from construction_twin.views.reachability import Reach

#: Name of the interactive marker.
NAME = "tool"
#: Colours r, g, b, a of a verdict; None: not known. Clear enough that the tool path can be seen through them.
COLOURS = {
    Reach.FREE: (0.1, 0.75, 0.25, 0.5),
    Reach.CONTACT: (1.0, 0.55, 0.0, 0.55),
    Reach.OUT: (0.9, 0.05, 0.05, 0.55),
    Reach.UNKNOWN: (0.55, 0.35, 0.75, 0.55),
    None: (0.55, 0.57, 0.6, 0.5),
}
#: Can be read in front of the sky, the floor and the arm.
_TEXT_COLOUR = (0.1, 0.1, 0.15, 1.0)
#: Height of a letter, and distance of the text below the marker, where it seldom hides the arm, as fractions of the marker's size.
_LETTER, _BELOW = 0.1, 0.95
#: Characters of a line.
_WIDTH = 45
#: Size of the handle, and of the sphere in it that shows the verdict, as fractions of the marker's size. The handle is a clear
#: shell around the sphere, because rviz gives a click to the first object it meets, and the sphere has no menu.
_HANDLE, _SPHERE = 0.3, 0.25
_HALF = math.sqrt(0.5)
#: Orientation of a control whose axis is the marker's x, y, z.
_AXES = {"x": (_HALF, 0.0, 0.0, _HALF), "y": (0.0, 0.0, _HALF, _HALF), "z": (0.0, _HALF, 0.0, _HALF)}


def tool_marker(frame: str, pose: PoseMsg, scale: float) -> InteractiveMarker:
    """Return the interactive marker: it moves along and turns about its axes, and opens the menu.

    Args:
        frame: tf frame of the pose. The stamp is 0: rviz then keeps the marker in this frame, and reports poses in it.
        scale: [m]
    """
    marker = InteractiveMarker(name=NAME, description="", pose=pose, scale=scale)
    marker.header.frame_id = frame
    handle = Marker(type=Marker.SPHERE, color=ColorRGBA(1.0, 1.0, 1.0, 0.2))
    handle.scale = Vector3(*[_HANDLE * scale] * 3)
    menu = InteractiveMarkerControl(name="menu", interaction_mode=InteractiveMarkerControl.MENU, always_visible=True)
    menu.description = "plan, review, stop"
    menu.markers.append(handle)
    marker.controls.append(menu)
    for axis, orientation in _AXES.items():
        for name, mode in (
            ("move", InteractiveMarkerControl.MOVE_AXIS),
            ("turn", InteractiveMarkerControl.ROTATE_AXIS),
        ):
            control = InteractiveMarkerControl(name=f"{name}_{axis}", interaction_mode=mode)
            control.orientation = Quaternion(*orientation)
            marker.controls.append(control)
    return marker


def verdict_markers(frame: str, pose: PoseMsg, scale: float, reach: Reach | None, lines: list[str]) -> MarkerArray:
    """Return the coloured sphere and the text.

    Args:
        pose: Of the interactive marker, in that frame.
        scale: Of the interactive marker [m].
        reach: None: not known.
        lines: Wrapped where they are long.
    """
    sphere = Marker(ns="verdict", id=0, type=Marker.SPHERE, pose=pose, color=ColorRGBA(*COLOURS[reach]))
    sphere.scale = Vector3(*[_SPHERE * scale] * 3)
    text = _text("\n".join(textwrap.fill(line, _WIDTH) for line in lines if line), pose.position, scale)
    for marker in (sphere, text):
        # stamp 0: with the newest transform
        marker.header.frame_id = frame
        marker.frame_locked = True
    return MarkerArray([sphere, text])


def _text(text: str, at: Point, scale: float) -> Marker:
    marker = Marker(ns="verdict", id=1, type=Marker.TEXT_VIEW_FACING, color=ColorRGBA(*_TEXT_COLOUR), text=text)
    # rviz centres a text on its position: a longer one is placed lower, so that all begin at the same height
    below = _BELOW + 0.6 * _LETTER * text.count("\n")
    marker.pose = PoseMsg(Point(at.x, at.y, at.z - below * scale), Quaternion(w=1.0))
    marker.scale.z = _LETTER * scale
    return marker
