"""The building model in rviz: at its place in the colours of its states, and nothing of what is gone."""

from __future__ import annotations

import io

import numpy as np
import pytest
from scene_samples import box_triangles
from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.extensions.work.as_built import Appearance
from construction_twin.extensions.work.nodes.work import COLOURS, TEXT, work_markers
from construction_twin.kinematics.chain import Pose

QUARTER = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
TRIANGLES = {**dict.fromkeys("abc", box_triangles((0.1, 0.2, 2.0))), "empty": np.empty((0, 3, 3))}


def appearance(element: str, word: str, x: float = 0.0) -> Appearance:
    return Appearance(element, f"stud {element}", word, Pose(np.array((x, 0, 1.0)), QUARTER))


def markers(*elements: Appearance) -> dict[str, Marker]:
    made = MarkerArray(work_markers(elements, TRIANGLES, "twin/base_link", "twin/tool0"))
    buffer = io.BytesIO()
    made.serialize(buffer)
    cleared, *drawn = MarkerArray().deserialize(buffer.getvalue()).markers
    assert cleared.action == Marker.DELETEALL
    return {marker.ns: marker for marker in drawn}


def test_the_next_element_is_named_above_itself():
    text = markers(appearance("a", "placed"), appearance("b", "next", 3.0), appearance("c", "todo", 5.0))[TEXT]
    assert text.text == "next: stud b" and text.scale.z > 0
    assert (text.pose.position.x, text.pose.position.y, text.pose.position.z) == pytest.approx((3.0, 0.0, 2.15))


def test_what_has_no_geometry_is_not_drawn():
    assert set(markers(appearance("a", "next"), appearance("a", "stock"), appearance("empty", "next"))) == {
        "a",
        "a stock",
        TEXT,
    }


def test_markers_have_the_triangles_places_and_colours():
    found = markers(appearance("a", "todo", 2.0), appearance("b", "carried", 0.1))
    one, carried = found["a"], found["b carried"]
    assert one.type == Marker.TRIANGLE_LIST and len(one.points) == 36
    assert (one.header.frame_id, carried.header.frame_id) == ("twin/base_link", "twin/tool0")
    colour = carried.color
    assert (colour.r, colour.g, colour.b, colour.a) == pytest.approx(COLOURS["carried"])
    # a quarter of a turn about z
    pose, point = one.pose, one.points[0]
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))
    corner = (pose.position.x - point.y, pose.position.y + point.x, pose.position.z + point.z)
    assert corner == pytest.approx(tuple(QUARTER @ TRIANGLES["a"][0, 0] + (2.0, 0.0, 1.0)))
