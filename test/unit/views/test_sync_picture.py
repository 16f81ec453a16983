"""sync_picture, and its markers: every visual shape of the arm in the colour of the state, and why it is not in sync."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.kinematics.chain import Chain
from construction_twin.monitor.states import SyncState
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.nodes.sync_view import arm_markers, text_marker
from construction_twin.views.sync_picture import (
    COLOURS,
    LINE_LENGTH,
    headline,
    headline_height,
    visual_shapes,
    worst_joint,
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


@pytest.mark.parametrize("state", SyncState)
def test_every_state_has_a_translucent_colour_of_its_own(state):
    assert 0.2 <= COLOURS[state][3] <= 0.7
    same = {other for other in SyncState if COLOURS[other][:3] == COLOURS[state][:3]}
    assert same == ({SyncState.STOPPED, SyncState.FAULT} if state in (SyncState.STOPPED, SyncState.FAULT) else {state})


def test_there_is_no_text_while_in_sync():
    assert headline(SyncState.IN_SYNC, "all agree", "joint_a1 differs") == ""


def test_the_text_says_state_reason_and_worst_joint_in_short_lines():
    reason = "joint_a3 differs by 0.0123 rad, " * 8
    lines = headline(SyncState.HOLDING, reason, "joint_a3 differs by 0.7 deg").split("\n")
    assert lines[0] == "HOLDING" and lines[-1] == "joint_a3 differs by 0.7 deg"
    assert " ".join(lines[1:-1]) == reason.strip()
    assert max(map(len, lines)) <= LINE_LENGTH
    assert headline(SyncState.WAITING, "", "") == "WAITING"


def test_the_worst_joint_is_the_one_that_uses_most_of_its_threshold():
    found = worst_joint(("track", "a1", "a2"), (0.002, 0.02, 0.001), (0.005, 0.01, 0.01), (True, False, False))
    assert found == Sentence("view.picture.differs", joint="a1", difference=Quantity(0.02, "rad"), allowed="0.573")
    found = worst_joint(("track", "a1"), (0.004, 0.001), (0.005, 0.01), (True, False))
    assert found == Sentence("view.picture.differs", joint="track", difference=Quantity(0.004, "m"), allowed="5.000")
    assert worst_joint(("a1", "a2"), (math.nan, 0.001), (0.01, 0.01), (False, False)).values["joint"] == "a2"
    assert worst_joint(("a1",), (math.nan,), (0.01,), (False,)) == worst_joint((), (), (), ()) == ""
    assert worst_joint(("a1",), (0.5,), (0.0,), (False,)) == ""


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


def test_the_text_is_taken_away_when_there_is_none():
    at = Point(0.4, 0.0, 3.7)
    shown, gone = (text_marker(text, "kr120/physical/base_link", at) for text in ("HOLDING", ""))
    assert shown.pose.position == at
    assert (shown.action, shown.text, shown.color.a) == (Marker.ADD, "HOLDING", 1.0)
    assert (gone.action, gone.ns, gone.id) == (Marker.DELETE, shown.ns, shown.id)
    assert shown.scale.z > 0


def test_the_text_stands_above_all_that_the_arm_can_reach():
    robot = read_robot_files("urdf/kr120r2500.urdf.xacro", "config/kr120.yaml")
    chain = Chain(robot)
    height = headline_height(float(chain.shoulder[2]), chain.arm_length)
    rng = np.random.default_rng(0)
    poses = rng.uniform(robot.lower, robot.upper, (500, len(robot.joint_names)))
    assert max(chain.skeleton(q)[:, 2].max() for q in poses) < height - 0.2 < 3.5
