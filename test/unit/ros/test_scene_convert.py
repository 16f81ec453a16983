"""ros.scene_convert: a scene keeps its hash over the wire, and looks in rviz like what is checked. Needs no ROS master."""

from __future__ import annotations

import io
from dataclasses import replace

import genpy
import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import FLOOR, box_triangles, clutter, write_stl
from visualization_msgs.msg import Marker

from construction_twin.robot.motion_errors import SceneError
from construction_twin.ros.messages import scene_convert as convert
from construction_twin.scene.objects import Scene, SceneObject

STAMP = genpy.Time(12, 34)


def over_the_wire(msg):
    buffer = io.BytesIO()
    msg.serialize(buffer)
    return type(msg)().deserialize(buffer.getvalue())


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 20))
def test_a_scene_survives_with_its_hash(seed, count):
    sent = clutter(seed, count).attach("floor", "tool0", FLOOR.pose, ("link_5",)) if count % 2 else clutter(seed, count)
    msg = over_the_wire(convert.scene_to_msg(sent, STAMP, "kr120/twin/base_link"))
    received = convert.scene_from_msg(msg)
    assert received.hash == sent.hash == msg.hash
    assert received.names == sent.names and received.padding == sent.padding
    assert (msg.header.stamp, msg.header.frame_id) == (STAMP, "kr120/twin/base_link")


def test_a_mesh_survives_and_a_changed_one_is_noticed(tmp_path):
    path = tmp_path / "part.stl"
    sent = Scene((SceneObject("part", "mesh", (0.001,) * 3, mesh=write_stl(path, box_triangles((1, 1, 1)))),))
    msg = over_the_wire(convert.scene_to_msg(sent, STAMP, "base_link"))
    assert convert.scene_from_msg(msg) == sent
    write_stl(path, box_triangles((1, 1, 2)))
    with pytest.raises(SceneError, match="hash"):
        convert.scene_from_msg(msg)


def test_a_message_nobody_filled_in_is_refused():
    msg = convert.object_to_msg(FLOOR)
    msg.pose.orientation = Quaternion()
    with pytest.raises(SceneError, match="'floor' orientation"):
        convert.object_from_msg(over_the_wire(msg))


def test_markers_have_the_objects_shapes_places_and_colours(tmp_path):
    mesh = write_stl(tmp_path / "part.stl", box_triangles((1, 1, 1)))
    objects = (
        FLOOR,
        SceneObject("post", "cylinder", (0.1, 2.0), (1.0, 2.0, 3.0)),
        SceneObject("ball", "sphere", (0.1,), link="tool0"),
        SceneObject("part", "mesh", (1.0, 2.0, 3.0), mesh=mesh),
    )
    markers = convert.scene_markers(Scene(objects), ["old"], {"post"}, "base_link", "kr120/twin").markers
    by_name = {marker.ns: over_the_wire(marker) for marker in markers}
    assert set(by_name) == {"floor", "post", "ball", "part", "old"}
    assert by_name["old"].action == Marker.DELETE
    added = [by_name[item.name] for item in objects]
    assert [marker.type for marker in added] == [Marker.CUBE, Marker.CYLINDER, Marker.SPHERE, Marker.MESH_RESOURCE]
    sizes = [(marker.scale.x, marker.scale.y, marker.scale.z) for marker in added]
    assert np.allclose(sizes, [(20, 20, 1), (0.2, 0.2, 2.0), (0.2, 0.2, 0.2), (1, 2, 3)])
    assert by_name["ball"].header.frame_id == "kr120/twin/tool0"
    assert by_name["post"].header.frame_id == "kr120/twin/base_link"
    assert all(marker.frame_locked and marker.action == Marker.ADD and marker.color.a > 0 for marker in added)
    assert by_name["part"].mesh_resource == f"file://{mesh}"
    assert len({(m.color.r, m.color.g, m.color.b) for m in added}) == 4
    red, calm = (
        convert.scene_markers(Scene((FLOOR,)), [], touching, "b", "").markers[0] for touching in ({"floor"}, ())
    )
    assert red.color != calm.color and red.header.frame_id == "b"


def test_only_what_is_carried_or_fixed_differs_in_colour():
    items = [replace(FLOOR, fixed=False, name=name) for name in ("one", "two")]
    one, two = convert.scene_markers(Scene(tuple(items)), [], (), "base_link", "").markers
    assert one.color == two.color
