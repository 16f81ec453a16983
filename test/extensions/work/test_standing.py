"""Elements that no task makes stand where the model has them."""

from dataclasses import replace

import numpy as np
from building_models import box
from work_samples import box_pieces, building, element, robot, work_cell

from construction_twin.extensions.work.layout import Layout
from construction_twin.extensions.work.worker_functions import standing_obstacles

#: Of the tool of the samples [m].
REACH = 6.0
WALL = box((0.0, 0.0, 0.0), (2.0, 0.1, 1.0))


def wall(name, at=(0.0, 0.3, 0.0), **changes):
    return replace(element(name, at, ifc_class="IfcWall"), bodies=(WALL,), **changes)


def pieces_of(model, *names):
    return {name: box_pieces(model.element(name)) for name in names}


def test_a_wall_that_no_task_makes_is_a_fixed_obstacle_where_the_model_has_it(tmp_path):
    at = work_cell(tmp_path)
    model = building(element("b"), wall("wall"))
    pieces, notes = standing_obstacles(model, ["b"], at, REACH, tmp_path)
    assert set(pieces) == {"wall"} and not notes
    layout = Layout(at, model, pieces_of(model, "b"), ["b"], robot().tip_link, pieces)
    for state in ({}, {"b": layout.base_T_goal("b")}):
        item = next(one for one in layout.scene(state).objects if one.name == "wall/0")
        # model_T_base is (0, -1.6, -0.6), the middle of the wall (1, 0.35, 0.5) in the model
        assert item.fixed and not item.link and np.allclose(item.position, (1.0, 1.95, 1.1))


def test_what_an_element_of_the_work_touches_may_be_one_that_stands(tmp_path):
    at = work_cell(tmp_path)
    model = building(element("b"), wall("wall", (-0.5, -0.05, -1.0)))
    pieces, notes = standing_obstacles(model, ["b"], at, REACH, tmp_path)
    layout = Layout(at, model, pieces_of(model, "b"), ["b"], robot().tip_link, pieces)
    assert "wall/0" in layout.job_for("b", layout.scene()).supports


def test_what_the_work_is_part_of_and_what_is_far_away_do_not_stand(tmp_path):
    at = work_cell(tmp_path)
    part = replace(element("part"), assembly="panel")
    model = building(part, wall("panel", assembly="house"), wall("house"), wall("far", (500.0, 0.0, 0.0)))
    assert not standing_obstacles(model, ["part"], at, REACH, tmp_path)[0]


def test_the_box_of_an_element_whose_geometry_is_unusable_stands_for_it(tmp_path):
    model = building(element("b"), replace(wall("odd"), bodies=(replace(WALL, triangles=WALL.triangles[:0]),)))
    pieces, notes = standing_obstacles(model, ["b"], work_cell(tmp_path), REACH, tmp_path)
    (box,) = pieces["odd"]
    assert (box.shape, box.size, box.position) == ("box", (2.0, 0.1, 1.0), (1.0, 0.05, 0.5))
    assert len(notes) == 1 and notes[0].startswith("odd cannot be divided into bodies")


def test_a_whole_that_exists_stands_though_a_part_of_it_is_placed(tmp_path):
    at = work_cell(tmp_path)
    board = replace(element("board"), assembly="wall")
    model = building(board, wall("wall", status="existing"))
    assert set(standing_obstacles(model, ["board"], at, REACH, tmp_path)[0]) == {"wall"}


def test_what_was_taken_down_is_in_no_scene(tmp_path):
    at = work_cell(tmp_path)
    model = building(element("b"), wall("old", status="demolish"))
    pieces, notes = standing_obstacles(model, ["b"], at, REACH, tmp_path)
    layout = Layout(at, model, pieces_of(model, "b"), ["b"], robot().tip_link, pieces)
    assert "old/0" in layout.scene().names
    assert "old/0" not in layout.scene(gone=frozenset({"old"})).names
