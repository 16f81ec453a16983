"""sync_picture, and its markers: every visual shape of the arm in the colour of the state, and why it is not in sync."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from visualization_msgs.msg import Marker

from construction_twin.core.errors import ConfigurationError
from construction_twin.monitor.states import SyncState
from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.messages.display_markers import arm_markers
from construction_twin.views.sync_picture import (
    COLOURS,
    visual_shapes,
)

ROOT = Path(__file__).parents[3]
KR120 = expand_xacro(ROOT / "urdf/kr120r2500.urdf.xacro")
PRIMITIVES = """<robot name="r"><link name="a">
<visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><geometry><box size="0.1 0.2 0.3"/></geometry></visual>
<visual><geometry><cylinder radius="0.5" length="2"/></geometry></visual>
<visual><geometry><sphere radius="0.25"/></geometry></visual>
<visual><geometry><mesh filename="package://p/m.stl" scale="0.001 0.001 0.001"/></geometry></visual>
</link></robot>"""


def test_every_mesh_of_the_arm_is_a_shape_of_its_link():
    shapes = visual_shapes(KR120)
    assert [shape.kind for shape in shapes] == ["mesh"] * KR120.count("<visual>")
    assert {shape.link for shape in shapes} == {f"link_{number}" for number in range(7)}
    assert all(f"/{shape.link}_" in shape.mesh and shape.scale == (1, 1, 1) for shape in shapes)


def test_primitives_keep_place_and_size():
    box, cylinder, sphere, mesh = visual_shapes(PRIMITIVES)
    assert (box.kind, box.scale, box.position) == ("box", (0.1, 0.2, 0.3), (1, 2, 3))
    np.testing.assert_allclose(box.quaternion, (0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    assert (cylinder.kind, cylinder.scale, cylinder.quaternion) == ("cylinder", (1.0, 1.0, 2.0), (0, 0, 0, 1))
    assert (sphere.kind, sphere.scale) == ("sphere", (0.5, 0.5, 0.5))
    assert (mesh.kind, mesh.mesh, mesh.scale) == ("mesh", "package://p/m.stl", (0.001, 0.001, 0.001))


def test_what_is_no_urdf_is_refused():
    with pytest.raises(ConfigurationError):
        visual_shapes("<robot")


def test_markers_are_the_physical_arm_s_shapes_in_its_frames():
    shapes = visual_shapes(KR120)
    markers = arm_markers(shapes, SyncState.HOLDING, "kr120/physical")
    assert [marker.header.frame_id for marker in markers] == [f"kr120/physical/{shape.link}" for shape in shapes]
    assert len({(marker.ns, marker.id) for marker in markers}) == len(shapes)
    for marker, shape in zip(markers, shapes):
        assert (marker.type, marker.action, marker.frame_locked) == (Marker.MESH_RESOURCE, Marker.ADD, True)
        assert marker.mesh_resource == shape.mesh and not marker.mesh_use_embedded_materials
        colour = marker.color
        assert (colour.r, colour.g, colour.b, colour.a) == COLOURS[SyncState.HOLDING]
        assert marker.pose.orientation.w == 1.0
