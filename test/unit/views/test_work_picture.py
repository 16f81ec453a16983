"""What a reviewer sees of a work plan: paths, ends with names, what is carried and placed, and whether that is approved."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plan_samples import make_plan

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment, Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange
from construction_twin.views.preview import WorkContext, picture
from construction_twin.views.work_picture import work_path, work_states

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
    text = picture(plan(), skeleton, 9.0, WorkContext(lied, states, forward, "tool0")).text
    assert f"LOOK TWICE: {states.problem}" in text


def test_a_removal_of_what_is_not_there_is_drawn_as_nothing_and_pointed_out():
    lied = [SceneChange((), ("nobody",)), *CHANGES[1:]]
    assert work_states(plan(), lied, START).problem == ""  # the scene is the same: nothing is missing in the picture
    assert work_states(plan(), CHANGES[:1], START).problem.startswith("after 'approach' ")


def test_the_path_is_in_parts_that_join_and_ends_at_one_place_share_a_label():
    drawn = work_path(plan(), work_states(plan(), CHANGES, START), forward, "tool0", 0.02, 1000)
    assert len(drawn.parts) == 6 and drawn.engaged == (False, False, True, False, True, False)
    for number, part in enumerate(drawn.parts):
        np.testing.assert_allclose(part[[0, -1], :2], PLACES[number : number + 2])
    assert sum(map(len, drawn.parts)) <= 1000 + 12
    assert [label for label, _ in drawn.marks] == [
        "1 to the stock, 3 lift",
        "2 approach",
        "4 carry",
        "5 set down",
        "6 home",
    ]


def test_what_is_carried_is_drawn_where_one_segment_carries_it_into_the_next():
    drawn = work_path(plan(), work_states(plan(), CHANGES, START), forward, "tool0", 0.02, 1000)
    # at the ends of lift and carry; not in the stock, not where it is placed, and never the tool
    assert [(item.name, pose.position.tolist()) for item, pose in drawn.on_the_way] == [
        ("beam/0", [1.0, 0.0, 1.6]), ("beam/1", [1.0, 0.0, 1.6]), ("beam/0", [3.0, 2.0, 1.6]), ("beam/1", [3.0, 2.0, 1.6])
    ]  # fmt: skip
    elsewhere = work_path(plan(), work_states(plan(), CHANGES, START), forward, "flange", 0.02, 1000)
    assert elsewhere.on_the_way == () and elsewhere.placed == tuple(BUILT)


def skeleton(q: np.ndarray) -> np.ndarray:
    return np.array([(0.0, 0.0, 0.0), (q[0], q[1], 1.0)])
