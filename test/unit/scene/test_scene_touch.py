"""`touch`: links and objects that may touch an object, carried or standing."""

from __future__ import annotations

import numpy as np
import pytest
from planning_cell import CHAIN, HOME, REQUEST, planner, world

from construction_twin.planning.recheck import CollisionError
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.objects import Scene, SceneObject, relative
from construction_twin.scene.scene_yaml import load_scene

TOOL = CHAIN.forward(HOME).position
#: A workpiece that hangs under the flange and stands on a table.
TABLE = SceneObject("table", "box", (0.6, 0.6, 0.2), (TOOL[0], 0.0, TOOL[2] - 0.5))
PIECE = SceneObject("piece", "box", (0.2, 0.2, 0.3), (TOOL[0], 0.0, TOOL[2] - 0.25))
UP = HOME + np.radians([0, -10, 0, 0, 0, 0])


def carried(touch, *others: SceneObject, table: SceneObject = TABLE):
    standing = world(table, PIECE, *others)
    pose = relative(standing.link_pose(HOME, "tool0"), PIECE.pose)
    return standing.with_scene(standing.scene.attach("piece", "tool0", pose, touch))


def test_a_workpiece_is_lifted_off_the_table_it_names():
    with pytest.raises(CollisionError, check=lambda error: error.between == ("piece", "table")):
        planner().plan_to_joints(HOME, UP, REQUEST, carried(("link_5", "link_6")))
    lifted = planner().plan_to_joints(HOME, UP, REQUEST, carried(("link_5", "link_6", "table")))
    assert "piece" not in lifted.report.clearance.between or "table" not in lifted.report.clearance.between


def test_it_is_enough_if_the_table_names_the_workpiece_or_the_link_that_carries_it():
    for name in ("piece", "tool0"):
        table = SceneObject("table", "box", TABLE.size, TABLE.position, touch=(name,))
        assert carried(("link_5", "link_6"), table=table).is_free(HOME)


def test_what_is_not_named_is_still_checked():
    shelf = SceneObject("shelf", "box", TABLE.size, TABLE.position)
    assert carried(("link_6", "table"), shelf).contact(HOME).between == ("piece", "shelf")


def test_a_standing_object_names_the_link_that_may_touch_it():
    below = tuple(TOOL - [0.0, 0.0, 0.08])
    assert world(SceneObject("ball", "sphere", (0.1,), below)).contact(HOME).between == ("link_6", "ball")
    rest = SceneObject("ball", "sphere", (0.1,), below, touch=("link_6",))
    assert world(rest).is_free(HOME)


@pytest.mark.parametrize("name", ["tabel", "piece", "link_9", ""])
def test_a_name_that_does_not_exist_is_refused_with_those_that_do(name):
    with pytest.raises(SceneError, match="'piece' touch.*link_6.*'table'") as caught:
        carried((name,))
    assert caught.value.value == name and "'piece'" not in caught.value.expected


def test_an_object_that_is_gone_may_not_be_touched_by_its_name_any_more():
    scene = Scene(
        (TABLE, SceneObject("piece", "box", PIECE.size, PIECE.position, touch=("table", "link_6"), fixed=True))
    )
    left = scene.without(["table"])
    assert left.get("piece").touch == ("link_6",)
    assert left.add(TABLE).get("piece").touch == ("link_6",)
    assert scene.add(TABLE, replace_existing=True).get("piece").touch == ("link_6", "table")


def test_a_yaml_may_name_objects_in_any_order(tmp_path):
    box = {"shape": "box", "size": [0.1, 0.1, 0.1]}
    scene = load_scene({"padding": 0.0, "objects": {"a": {**box, "touch": ["b", "link_1"]}, "b": box}}, tmp_path)
    assert scene.get("a").touch == ("b", "link_1")
    assert world(*scene.objects).scene.names == ("a", "b")
