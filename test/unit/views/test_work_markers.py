"""views.work_markers and its messages: the model at its place in the colours of its states, and nothing of what is gone."""

from __future__ import annotations

import io

import numpy as np
import pytest
from scene_samples import box_triangles
from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.kinematics.chain import Pose
from construction_twin.ros.messages.work_marker_convert import work_marker_array
from construction_twin.views.work_markers import COLOURS, TEXT, DrawnElement, placed_triangles, work_picture

QUARTER = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])


def drawn(key: str, state: str, x: float = 0.0, link: str = "") -> DrawnElement:
    return DrawnElement(
        key, f"stud {key}", box_triangles((0.1, 0.2, 2.0)), Pose(np.array((x, 0, 1.0)), QUARTER), state, link
    )


def test_the_next_element_is_named_above_itself():
    picture = work_picture([drawn("a", "placed"), drawn("b", "next", 3.0), drawn("c", "todo", 5.0)])
    assert picture.text == "next: stud b"
    assert picture.text_at == pytest.approx((3.0, 0.0, 2.15))
    assert work_picture([drawn("a", "placed")]).text == ""


def test_what_is_not_drawn_any_more_is_deleted_once():
    first = work_picture([drawn("a", "next"), drawn("b stock", "stock")])
    assert first.keys == {"a", "b stock", TEXT} and first.gone == ()
    second = work_picture([drawn("a", "placed")], first.keys)
    assert second.gone == ("b stock", TEXT)
    assert work_picture([drawn("a", "placed")], second.keys).gone == ()


def test_an_element_without_geometry_is_not_drawn():
    empty = DrawnElement("a", "a", np.empty((0, 3, 3)), Pose(np.zeros(3), np.eye(3)), "next")
    assert work_picture([empty]).elements == ()


def test_markers_have_the_triangles_places_and_colours():
    before = work_picture([drawn("old", "todo")])
    picture = work_picture([drawn("a", "next", 2.0), drawn("b", "carried", 0.1, "tool0")], before.keys)
    buffer = io.BytesIO()
    work_marker_array(picture, "base_link", "kr120/twin").serialize(buffer)
    markers = {marker.ns: marker for marker in MarkerArray().deserialize(buffer.getvalue()).markers}
    assert set(markers) == {"old", "a", "b", TEXT}
    assert markers["old"].action == Marker.DELETE
    assert markers["a"].type == Marker.TRIANGLE_LIST and len(markers["a"].points) == 36
    assert markers["a"].header.frame_id == "kr120/twin/base_link" and markers["b"].header.frame_id == "kr120/twin/tool0"
    colour = markers["b"].color
    assert (colour.r, colour.g, colour.b, colour.a) == pytest.approx(COLOURS["carried"])
    assert markers[TEXT].text == "next: stud a" and markers[TEXT].scale.z > 0
    pose, point = markers["a"].pose, markers["a"].points[0]
    # a quarter of a turn about z
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))
    corner = (pose.position.x - point.y, pose.position.y + point.x, pose.position.z + point.z)
    assert corner == pytest.approx(tuple(placed_triangles(picture.elements[0])[0, 0]))
