"""Cell files and racks: where the stock is, what is there, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from work_samples import BRICK, CELL, SCENE, building, element, layout, work_cell

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.work_cell import CellFile

RACK = CELL["racks"]["bricks"]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A cell that was read."""
    return work_cell(tmp_path_factory.mktemp("cell"))


def bricks(count):
    return building(*(element(f"b{number}", (0.25 * number, 0, 0)) for number in range(count)))


def stock(folder, rack, count=3, **cell):
    return layout(work_cell(folder, {"racks": {"r": rack}, **cell}), bricks(count)).stock


def feet(found):
    return np.array([slot.base_T_element.position for slot in found.slots.values()])


def test_a_grid_is_filled_row_by_row_with_the_middle_of_the_underside_in_the_slot(tmp_path):
    rack = {**RACK, "rows": 2, "columns": 2, "pitch": [0.5, 0.2]}
    assert np.allclose(feet(stock(tmp_path, rack)), [(-0.5, -1.5, 0.6), (0, -1.5, 0.6), (-0.5, -1.3, 0.6)])


def test_a_turned_rack_turns_slots_and_elements(tmp_path):
    rack = {**RACK, "at": {"xyz": [0, -1.5, 0.6], "rpy_deg": [0, 0, 90]}}
    found = stock(tmp_path, rack)
    assert np.allclose(feet(found), [(0, -1.5, 0.6), (0, -1.0, 0.6), (0, -0.5, 0.6)])
    assert np.allclose(found.slots["b0"].base_T_element.rotation[:, 0], (0, 1, 0))


def test_elements_lie_on_their_side_when_the_rack_says_so(tmp_path):
    found = stock(tmp_path, {**RACK, "rpy_deg": [90, 0, 0], "lies": "own_axes"})
    pose = found.slots["b0"].base_T_element
    assert np.allclose(pose.rotation[:, 2], (0, -1, 0))
    # the underside is a long side now: half a width above the slot
    assert np.allclose(pose.position, (-0.5, -1.5 + BRICK[2] / 2, 0.6 + BRICK[1] / 2))


def test_the_first_needed_lies_on_top_of_a_stack(tmp_path):
    rack = {
        "kind": "stack",
        "surface": "rack",
        "at": {"xyz": [0, -1.5, 0.6]},
        "levels": 2,
        "step": 0.071,
        "refill": True,
    }
    found = stock(tmp_path, rack)
    assert np.allclose(feet(found)[:, 2], [0.671, 0.6, 0.6])
    assert found.in_stock(()) == ("b0", "b1")
    assert found.in_stock(("b0",)) == ("b1",)
    assert found.in_stock(("b0", "b1")) == ("b2",)


def test_a_slot_of_a_grid_is_filled_again_when_it_is_empty(tmp_path):
    found = stock(tmp_path, {**RACK, "columns": 2, "refill": True}, 5)
    assert found.in_stock(()) == ("b0", "b1")
    assert found.in_stock(("b1",)) == ("b0", "b3")
    assert found.in_stock(("b0", "b1", "b2", "b3")) == ("b4",)
    assert np.allclose(feet(found)[0], feet(found)[2])


def test_more_elements_than_slots_are_one_sentence(tmp_path):
    with pytest.raises(ConfigurationError, match=r"racks/r: .*2 slots for 3 elements, none for 'b2' \(b2\)"):
        stock(tmp_path, {**RACK, "columns": 2})


def test_an_element_without_a_rack_is_one_sentence(tmp_path):
    with pytest.raises(
        ConfigurationError,
        match=r"/racks for element 'b1' \(b1\), IfcBuildingElementPart: found nothing, expected a rack that holds it$",
    ):
        stock(tmp_path, {**RACK, "holds": {"elements": ["b0", "b2"]}})


@pytest.mark.parametrize(
    ("cell", "sentence"),
    [
        ({"model_T_base": None}, "model_T_base"),
        ({"supports": ["bench"]}, "supports.*bench.*floor, rack, table"),
        ({"racks": {"r": {**RACK, "surface": "bench"}}}, "racks/r/surface"),
        ({"racks": {"r": {**RACK, "pitsch": 1}}}, "no such key"),
        ({"racks": {"r": {**RACK, "rows": 0}}}, "rows.*greater than or equal to 1"),
        ({"racks": {"r": {**RACK, "kind": "heap"}}}, "heap"),
        ({"racks": {}}, "racks"),
        ({"tool": "nothing.yaml"}, "nothing.yaml"),
    ],
)
def test_a_wrong_cell_file_is_one_sentence(tmp_path, cell, sentence):
    with pytest.raises(ConfigurationError, match=sentence) as caught:
        work_cell(tmp_path, cell)
    assert "\n" not in str(caught.value)


def test_a_scene_with_names_of_elements_is_refused(tmp_path):
    objects = {**SCENE["objects"], "a/0": SCENE["objects"]["table"]}
    with pytest.raises(ConfigurationError, match="a/0"):
        work_cell(tmp_path, scene={**SCENE, "objects": objects})


@given(
    rows=st.integers(1, 4), columns=st.integers(1, 4), count=st.integers(1, 20), kind=st.sampled_from(["grid", "stack"]),
    taken=st.sets(st.integers(0, 19)),
)  # fmt: skip
def test_no_slot_ever_holds_two_and_everything_comes_at_last(cell, rows, columns, count, kind, taken):
    rack = {**RACK, "rows": rows, "columns": columns, "refill": True}
    if kind == "stack":
        rack = {"kind": "stack", "at": RACK["at"], "levels": rows, "step": 0.08, "refill": True}
    file = CellFile.model_validate({**CELL, "racks": {"r": rack}})
    found = layout(replace(cell, file=file), bricks(count)).stock
    gone = {f"b{number}" for number in taken if number < count}
    present = found.in_stock(gone)
    places = [found.slots[one].number for one in present]
    assert len(set(places)) == len(places) and not gone & set(present)
    assert bool(present) == (len(gone) < count)
    gone = set()
    for _ in range(count):
        first = found.in_stock(gone)[0]
        assert first not in gone
        gone.add(first)
    assert found.in_stock(gone) == ()


def test_the_scene_of_a_state_has_the_tool_the_stock_and_what_stands(tmp_path):
    found = layout(work_cell(tmp_path), bricks(3))
    assert set(found.scene().names) == {
        "floor", "table", "rack", "tool/post", "tool/frame", "tool/cups", "b0/0", "b1/0", "b2/0"
    }  # fmt: skip
    built = found.base_T_goal("b0")
    scene = found.scene({"b0": built}, frozenset({"b1"}))
    assert "b1/0" not in scene.names
    assert np.allclose(scene.get("b0/0").position, (0, 1.6, 0.6 + BRICK[2] / 2))


def test_supports_of_a_job_are_what_the_cell_names_and_the_neighbours(tmp_path):
    found = layout(work_cell(tmp_path), bricks(3))
    built = {"b0": found.base_T_goal("b0")}
    # b0 stands 10 mm beside the place of b1, and 0.26 m from that of b2
    assert found.job_for("b1", found.scene(built)).supports == ("b0/0", "rack", "table")
    assert found.job_for("b2", found.scene(built)).supports == ("rack", "table")
