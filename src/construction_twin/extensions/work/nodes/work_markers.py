"""The building model in rviz (topic `work/markers`): every element at its place in a colour that says how far it is.

Drawn are the triangles of the model, not the convex pieces that are checked. No parameters, no clock.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from construction_twin.extensions.work.task_board import Appearance
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rotation_to_quaternion

#: Colours r, g, b, a of the words for an element's state. What is not there yet is seen through.
COLOURS = {
    "todo": (0.60, 0.62, 0.66, 0.25),
    "next": (0.10, 0.40, 0.95, 0.55),
    "stock": (0.80, 0.62, 0.35, 1.00),
    "carried": (0.95, 0.60, 0.10, 1.00),
    "placed": (0.20, 0.65, 0.30, 1.00),
    "off": (0.85, 0.12, 0.10, 1.00),
    "skipped": (0.35, 0.30, 0.40, 0.12),
}
#: Namespace of the name of the next element; no GlobalId has it.
TEXT = "work next"
_TEXT_COLOUR = (0.05, 0.15, 0.45, 1.0)
#: So far the colour stands out of the element [m]: the scene draws its own body at the same place, and only one is seen there.
_SKIN = 0.003
#: Height of the text, and its distance above the element [m].
_TEXT_SIZE, _TEXT_ROOM = 0.10, 0.15


def work_markers(
    elements: Iterable[Appearance],
    triangles: Mapping[str, np.ndarray],
    base_frame: str,
    tip_frame: str,
    shown: Collection[str] = (),
) -> list[Marker]:
    """Return the markers, a namespace for each; all of them each time: who begins to listen hears the last message only.

    Args:
        triangles: Shape (t, 3, 3) each. By element, in its frame [m]; one without any is not drawn.
        tip_frame: Of what is carried.
        shown: Namespaces that were drawn before: those that are drawn no more are deleted.
    """
    markers: dict[str, Marker] = {}
    for one in elements:
        corners = np.asarray(triangles[one.element]).reshape(-1, 3)
        if not len(corners):
            continue
        key = f"{one.element} {one.word}" if one.word in ("stock", "carried") else one.element
        markers[key] = _element(key, one, corners, tip_frame if one.word == "carried" else base_frame)
        if one.word == "next":
            placed = corners @ one.pose.rotation.T + one.pose.position
            low, high = placed.min(axis=0), placed.max(axis=0)
            x, y = (low + high)[:2] / 2.0
            text = f"next: {one.name}"
            marker = Marker(ns=TEXT, type=Marker.TEXT_VIEW_FACING, action=Marker.ADD, text=text, frame_locked=True)
            marker.header.frame_id = base_frame
            marker.pose = PoseMsg(
                Point(float(x), float(y), float(high[2]) + _TEXT_ROOM), Quaternion(0.0, 0.0, 0.0, 1.0)
            )
            marker.scale = Vector3(0.0, 0.0, _TEXT_SIZE)
            marker.color = ColorRGBA(*_TEXT_COLOUR)
            markers[TEXT] = marker
    gone = [Marker(ns=key, action=Marker.DELETE) for key in sorted(set(shown) - markers.keys())]
    return [*gone, *markers.values()]


def _element(key: str, one: Appearance, corners: np.ndarray, frame: str) -> Marker:
    marker = Marker(ns=key, type=Marker.TRIANGLE_LIST, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = frame
    low, high = corners.min(axis=0), corners.max(axis=0)
    grown = 1.0 + 2.0 * _SKIN / np.maximum(high - low, _SKIN)
    # rviz scales about the frame's origin; the element is to grow about its middle
    pose: Pose = one.pose
    position = pose.position + pose.rotation @ ((1.0 - grown) * (low + high) / 2.0)
    marker.pose = PoseMsg(Point(*map(float, position)), Quaternion(*map(float, rotation_to_quaternion(pose.rotation))))
    marker.scale = Vector3(*map(float, grown))
    marker.color = ColorRGBA(*COLOURS[one.word])
    marker.points = [Point(*corner) for corner in corners.tolist()]
    return marker
