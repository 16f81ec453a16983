"""What rviz draws: the physical arm, the path of a plan, what a work plan carries and places, and its rehearsal."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from plan_samples import make_plan
from visualization_msgs.msg import Marker

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Pose
from construction_twin.monitor.states import SyncState
from construction_twin.review.rehearsal_report import BROKEN, RehearsalReport
from construction_twin.robot.plan import Clearance, Plan, content_hash
from construction_twin.robot.segments import Segment, Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.messages.display_markers import (
    COLOURS,
    arm_markers,
    plan_markers,
    rehearsal_markers,
    visual_markers,
)
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange
from construction_twin.views.preview import work_states
from construction_twin.views.texts import describe

KR120 = expand_xacro(Path(__file__).parents[3] / "urdf/kr120r2500.urdf.xacro")
PRIMITIVES = """<robot name="r"><link name="a">
<visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><geometry><box size="0.1 0.2 0.3"/></geometry></visual>
<visual><geometry><cylinder radius="0.5" length="2"/></geometry></visual>
<visual><geometry><sphere radius="0.25"/></geometry></visual>
<visual><geometry><mesh filename="package://p/m.stl" scale="0.001 0.001 0.001"/></geometry></visual>
</link></robot>"""


def place(marker: Marker) -> list[float]:
    return [marker.pose.position.x, marker.pose.position.y, marker.pose.position.z]


def test_primitives_keep_place_and_size():
    markers = visual_markers(PRIMITIVES)
    assert [marker.type for marker in markers] == [Marker.CUBE, Marker.CYLINDER, Marker.SPHERE, Marker.MESH_RESOURCE]
    scales = [(marker.scale.x, marker.scale.y, marker.scale.z) for marker in markers]
    assert scales == [(0.1, 0.2, 0.3), (1.0, 1.0, 2.0), (0.5, 0.5, 0.5), (0.001, 0.001, 0.001)]
    turned = markers[0].pose.orientation
    np.testing.assert_allclose((turned.x, turned.y, turned.z, turned.w), (0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    assert place(markers[0]) == [1, 2, 3] and markers[1].pose.orientation.w == 1.0
    assert markers[3].mesh_resource == "package://p/m.stl"


def test_what_is_no_urdf_is_refused():
    with pytest.raises(ConfigurationError):
        visual_markers("<robot")


def test_the_physical_arm_has_every_mesh_in_its_link_s_frame_and_the_colour_of_the_state():
    markers = arm_markers(visual_markers(KR120), SyncState.HOLDING, "kr120/physical")
    assert {marker.header.frame_id for marker in markers} == {f"kr120/physical/link_{number}" for number in range(7)}
    assert len({(marker.ns, marker.id) for marker in markers}) == len(markers) == KR120.count("<visual>")
    for marker in markers:
        assert (marker.type, marker.action, marker.frame_locked) == (Marker.MESH_RESOURCE, Marker.ADD, True)
        assert marker.header.frame_id.rpartition("/")[2] in marker.mesh_resource
        assert not marker.mesh_use_embedded_materials and marker.pose.orientation.w == 1.0
        colour = marker.color
        assert (colour.r, colour.g, colour.b, colour.a) == COLOURS[SyncState.HOLDING]


# -- a plan


TOOL = SceneObject("tool/frame", "box", (0.6, 0.1, 0.1), (0.0, 0.0, 0.05), link="tool0")
STOCK = [SceneObject(f"beam/{k}", "box", (0.1, 0.1, 1.0), (0.0, float(k), 0.5)) for k in range(2)]
HELD = [dataclasses.replace(item, position=(0.0, 0.0, 0.6), link="tool0") for item in STOCK]
BUILT = [dataclasses.replace(item, position=(3.0, 2.0, 0.5)) for item in STOCK]
TABLE = SceneObject("table", "box", (1.0, 1.0, 0.1))
START = Scene((TOOL, TABLE, *STOCK), 0.01)
CHANGES = (
    SceneChange(),
    SceneChange(tuple(HELD)),
    SceneChange(),
    SceneChange(),
    SceneChange(tuple(BUILT)),
    SceneChange(),
)
NAMES = ("to the stock", "approach", "lift", "carry", "set down", "home")
HOLDING = (Signal("held", True),)
#: Where the tool is at the ends of the segments: there and back again over the stock.
PLACES = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 0.0], [3.0, 2.0], [3.0, 2.5], [0.0, 0.0]])


def forward(q: np.ndarray) -> Pose:
    return Pose(np.array([q[0], q[1], 1.0]), np.eye(3))


#: An arm whose elbow is higher than its tool.
CHAIN = SimpleNamespace(
    forward=forward,
    skeleton=lambda q: np.array([(0.0, 0.0, 0.0), (0.1, 0.2, 1.5 + 0.1 * q[0]), (q[0], q[1], 1.0)]),
    robot=SimpleNamespace(tip_link="tool0"),
)


def plan(changes=CHANGES) -> Plan:
    rest = np.zeros((7, 2))
    motion = Trajectory(("joint_a1", "joint_a2"), 2.0 * np.arange(7.0), PLACES, rest, rest)
    scene, segments = START, []
    for number, change in enumerate(changes):
        after = change.apply(scene)
        switches = {1: (Switch("vacuum", True, HOLDING, 2.0),), 4: (Switch("vacuum", False, (), 2.0),)}.get(number, ())
        requires = HOLDING if number in (2, 3, 4) else ()
        segments.append(
            Segment(NAMES[number], 2.0 * (number + 1), number in (2, 4), requires, switches, scene.hash, after.hash)
        )
        scene = after
    made, task = make_plan(motion, scene=START.hash), "task-1"
    found = content_hash(motion, task, tuple(segments))
    return dataclasses.replace(made, hash=found, task=task, segments=tuple(segments))


def test_what_is_carried_in_each_segment_and_placed_in_the_end_follows_from_the_changes():
    states = work_states(plan(), CHANGES, START)
    assert states.problem == ""
    assert [tuple(item.name for item in held) for held in states.carried] == [
        ("tool/frame",), ("tool/frame",), *[("tool/frame", "beam/0", "beam/1")] * 3, ("tool/frame",), ("tool/frame",)
    ]  # fmt: skip
    assert states.placed == tuple(BUILT)
    assert [bool(states.loads(number)) for number in range(6)] == [False, False, True, True, True, False]


def test_a_scene_that_is_not_known_is_said_and_the_rest_is_drawn():
    for scene in (None, Scene((TABLE,), 0.01)):
        states = work_states(plan(), CHANGES, scene)
        assert states.problem == "the scene that the plan begins in is not known here"
        assert states.placed == tuple(BUILT) and states.loads(3) == tuple(HELD)


@pytest.mark.parametrize(
    "number,change",
    [(1, SceneChange((HELD[0],))), (4, SceneChange((TABLE,))), (4, SceneChange()), (0, SceneChange((), ("table",)))],
)
def test_objects_that_are_not_those_of_the_approved_scenes_are_pointed_out(number, change):
    """The hashes are what is approved; what is drawn comes from fields that the approval does not cover."""
    lied = [*CHANGES[:number], change, *CHANGES[number + 1 :]]
    states = work_states(plan(), lied, START)
    assert states.problem == f"after {NAMES[number]!r} the scene is to be another one than drawn here"
    assert f"LOOK TWICE: {states.problem}" in describe(plan(), lied, states.problem)


def test_a_removal_of_what_is_not_there_is_drawn_as_nothing_and_pointed_out():
    lied = [SceneChange((), ("nobody",)), *CHANGES[1:]]
    assert work_states(plan(), lied, START).problem == ""  # the scene is the same: nothing is missing in the picture
    assert work_states(plan(), CHANGES[:1], START).problem.startswith("after 'approach' ")


def drawn(chain=CHAIN) -> dict[str, list[Marker]]:
    """The markers of the plan, by namespace."""
    markers = plan_markers(plan(), chain, "base", 9.0, CHANGES, work_states(plan(), CHANGES, START))
    return {name: [each for each in markers if each.ns == name] for name in {each.ns for each in markers}}


def test_the_path_is_in_parts_that_join_and_ends_at_one_place_share_a_label():
    found = drawn()
    parts = [[(point.x, point.y) for point in marker.points] for marker in found["plan_path"]]
    assert len(parts) == 6 and [marker.color.b > 0.9 for marker in found["plan_path"]] == [
        False, False, True, False, True, False
    ]  # fmt: skip
    for number, part in enumerate(parts):
        np.testing.assert_allclose([part[0], part[-1]], PLACES[number : number + 2])
    assert sum(map(len, parts)) <= 1000 + 12
    names = ["1 to the stock, 3 lift", "2 approach", "4 carry", "5 set down", "6 home"]
    assert [marker.text for marker in found["plan_names"]] == names


def test_what_is_carried_is_drawn_where_one_segment_carries_it_into_the_next():
    found = drawn()
    # at the ends of lift and carry; not in the stock, not where it is placed, and never the tool
    assert [place(marker) for marker in found["plan_on_the_way"]] == [[1.0, 0.0, 1.6]] * 2 + [[3.0, 2.0, 1.6]] * 2
    elsewhere = drawn(SimpleNamespace(**vars(CHAIN) | {"robot": SimpleNamespace(tip_link="flange")}))
    assert "plan_on_the_way" not in elsewhere
    assert [place(marker) for marker in elsewhere["plan_placed"]] == [list(item.position) for item in BUILT]


def test_the_path_of_any_other_plan_is_the_tool_s_and_the_closest_point_is_marked_where_there_is_something_to_touch():
    rest = np.zeros((2, 2))
    made = make_plan(Trajectory(("joint_a1", "joint_a2"), np.array([0.0, 2.0]), PLACES[[0, 4]], rest, rest))
    path, text = plan_markers(made, CHAIN, "base", 9.0)
    points = np.array([(point.x, point.y, point.z) for point in path.points])
    assert points.shape == (101, 3) and points[-1].tolist() == [3.0, 2.0, 1.0]
    np.testing.assert_allclose(points[:, 1], points[:, 0] * 2 / 3, atol=1e-12)
    assert "nothing to touch" in text.text and text.pose.position.z > 1.8 + 0.5
    clearance = Clearance(0.0312, ("link_5", "wall"), (1.2, -0.4, 0.9), 0.752)
    near = dataclasses.replace(made, report=dataclasses.replace(made.report, clearance=clearance))
    _, text, closest = plan_markers(near, CHAIN, "base", 9.0)
    assert place(closest) == [1.2, -0.4, 0.9] and "closest: 31 mm, link_5 to wall, after 0.75 s" in text.text


# -- a rehearsal


def test_one_that_broke_off_has_its_reasons_and_no_arm():
    report = RehearsalReport(plan_id="p", state=BROKEN, reasons=tuple("abcde"))
    (text,) = rehearsal_markers(
        report, visual_markers(KR120), lambda q, link: Pose(np.zeros(3), np.eye(3)), 2.0, (), "base"
    )
    assert text.text.split("\n")[1:4] == ["a", "b", "c"] and "2 reasons more" in text.text
