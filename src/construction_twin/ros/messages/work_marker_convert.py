"""The picture of a building model as rviz markers (topic `work/markers`); no parameters, no clock."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.ros.messages.scene_convert import tf_frame
from construction_twin.views.work_markers import COLOURS, SKIN, TEXT, TEXT_SIZE, DrawnElement, WorkPicture

_TEXT_COLOUR = (0.05, 0.15, 0.45, 1.0)


def work_marker_array(picture: WorkPicture, base_link: str, tf_prefix: str) -> MarkerArray:
    """Return a picture for rviz: one triangle list per element, in a namespace of its key.

    Args:
        base_link: Frame of what stands in the world, without prefix.
        tf_prefix: Of the twin's frames, without a slash at its end; may be empty.
    """
    markers = [Marker(ns=key, action=Marker.DELETE) for key in picture.gone]
    markers += [_element(item, base_link, tf_prefix) for item in picture.elements]
    if picture.text:
        text = Marker(ns=TEXT, type=Marker.TEXT_VIEW_FACING, action=Marker.ADD, text=picture.text, frame_locked=True)
        text.header.frame_id = tf_frame(tf_prefix, base_link)
        text.pose = PoseMsg(Point(*picture.text_at), Quaternion(0.0, 0.0, 0.0, 1.0))
        text.scale = Vector3(0.0, 0.0, TEXT_SIZE)
        text.color = ColorRGBA(*_TEXT_COLOUR)
        markers.append(text)
    return MarkerArray(markers)


def _element(item: DrawnElement, base_link: str, tf_prefix: str) -> Marker:
    marker = Marker(ns=item.key, type=Marker.TRIANGLE_LIST, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = tf_frame(tf_prefix, item.link or base_link)
    corners = item.triangles.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    grown = 1.0 + 2.0 * SKIN / np.maximum(high - low, SKIN)
    # rviz scales about the frame's origin; the element is to grow about its middle
    position = item.pose.position + item.pose.rotation @ ((1.0 - grown) * (low + high) / 2.0)
    marker.pose = PoseMsg(
        Point(*map(float, position)), Quaternion(*map(float, rotation_to_quaternion(item.pose.rotation)))
    )
    marker.scale = Vector3(*map(float, grown))
    marker.color = ColorRGBA(*COLOURS[item.state])
    marker.points = [Point(*corner) for corner in corners.tolist()]
    return marker
