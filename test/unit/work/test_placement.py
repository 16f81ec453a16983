"""Where a model stands, and readings of the figures that cannot be true."""

from dataclasses import replace

import numpy as np
import pytest
from building_models import box, building, element
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.work_errors import PlacementError
from construction_twin.kinematics.chain import Pose
from construction_twin.work.placement import base_element, check_placement

REACH = 3.0


def pose(*xyz, rotation=None):
    return Pose(np.array(xyz, dtype=float), np.eye(3) if rotation is None else np.array(rotation, dtype=float))


def panel(*, at=(1.0, 0.0, 0.0), scale=1.0):
    boxes = [box((0.3 * i * scale, 0, 0), ((0.3 * i + 0.2) * scale, 0.1 * scale, 0.1 * scale)) for i in range(5)]
    return building(*(element(f"e{i}", one, at=np.array(at) * scale) for i, one in enumerate(boxes)))


def test_a_placement_within_reach_has_no_remarks():
    placement = check_placement(panel(), pose(0.0, 0.0, 0.0), REACH)
    assert placement.remarks == () and placement.far == ()


@pytest.mark.parametrize(
    ("base", "message"),
    [
        (pose(np.nan, 0, 0), "not finite"),
        (pose(0, 0, 0, rotation=np.diag((1.0, 1.0, -1.0))), "left-handed"),
        (pose(0, 0, 0, rotation=np.eye(3) * 2.0), "unit vectors"),
    ],
)
def test_what_is_no_pose_is_refused(base, message):
    with pytest.raises(PlacementError, match=message):
        check_placement(panel(), base, REACH)


@pytest.mark.parametrize(
    ("model", "base", "message"),
    [
        (panel(), pose(500.0, 800.0, 0.0), "millimetres: give metres"),
        (panel(at=(50.0, 0.0, 0.0)), pose(-49.0, 0.0, 0.0), "looks like base_T_model"),
        (panel(scale=1000.0), pose(0.0, 0.0, 0.0), "length unit looks like metres where millimetres"),
        (panel(at=(20.0, 0.0, 0.0)), pose(0.019, 0.0, 0.0), "divided by 1000 once too often"),
        (panel(at=(682000.0, 5400000.0, 0.0)), pose(1.0, 2.0, 0.0), "coordinates of a map.*base_element"),
        (panel(), pose(682000.0, 5400000.0, 0.0), "model_T_base looks like coordinates of a map"),
        (panel(at=(40.0, 200.0, 0.0)), pose(0.0, 0.0, 0.0), "before one was measured"),
        (panel(), pose(6.0, 1.0, 0.0), "Move the base"),
        (panel(), pose(70.0, 200.0, 0.0), "wrong placement, not a matter of reach"),
    ],
)
def test_all_out_of_reach_names_the_likely_cause_and_figures(model, base, message):
    with pytest.raises(PlacementError, match=message) as caught:
        check_placement(model, base, REACH)
    assert "all 5 elements" in str(caught.value) and "3.00 m" in str(caught.value)
    assert caught.value.ids == tuple(model.elements)


def test_a_single_element_far_away_is_misplaced_and_one_a_little_too_far_unreachable():
    model = building(
        element("near", box((1, 0, 0), (2, 1, 1))),
        element("out", box((5, 0, 0), (6, 1, 1))),
        element("lost", box((200, 0, 0), (201, 1, 1))),
    )
    placement = check_placement(model, pose(0, 0, 0), REACH)
    lost, out = placement.remarks
    assert lost.ids == ("lost",) and "200.0 m" in lost.text and "wrong placement" in lost.text
    assert out.ids == ("out",) and "5.00 m" in out.text and "out of reach" in out.text
    assert placement.far == ("out", "lost")


def test_a_base_inside_of_an_element_is_refused_and_one_standing_on_it_is_not():
    model = building(element("slab", box((-2, -2, -0.3), (2, 2, 0.0))), element("post", box((0.5, 0, 0), (1, 1, 2))))
    assert check_placement(model, pose(0, 0, 0), REACH).remarks == ()
    with pytest.raises(PlacementError, match="stands inside of element 'slab'"):
        check_placement(model, pose(-1.0, -1.0, -0.2), REACH)
    doubtful = building(*(replace(one, doubt="its profile crosses itself") for one in model.elements.values()))
    assert check_placement(doubtful, pose(-1.0, -1.0, -0.2), REACH).remarks == ()


def test_a_base_in_the_opening_of_a_frame_is_not_inside_of_it():
    frame = element("frame", box((-2, -2, 0), (-1, 2, 1)), box((1, -2, 0), (2, 2, 1)), box((-1, -2, 0), (1, -1, 1)))
    assert check_placement(building(frame), pose(0, 0, 0), REACH).remarks == ()


def test_a_leaning_base_is_remarked():
    angle = np.radians(12.0)
    lean = [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    (remark,) = check_placement(panel(), pose(0, 0, 0, rotation=lean), REACH).remarks
    assert "12.0 deg" in remark.text


def test_the_element_of_the_base_is_found_by_id_or_name_and_not_compared():
    model = building(element("id1", box((-1, -1, 0), (1, 1, 1)), name="Robot"), element("e", box((1, 0, 0), (2, 1, 1))))
    assert base_element(model, "id1") is base_element(model, "Robot") is model.elements["id1"]
    assert check_placement(model, base_element(model, "Robot").model_T_element, REACH, base="id1").remarks == ()
    with pytest.raises(PlacementError, match="no element of that GlobalId or name"):
        base_element(model, "nobody")
    twice = building(element("a", name="R"), element("b", name="R"))
    with pytest.raises(PlacementError, match="2 elements.*a, b"):
        base_element(twice, "R")


def test_a_model_without_geometry_is_refused():
    with pytest.raises(PlacementError, match="no element has geometry"):
        check_placement(building(element("a")), pose(0, 0, 0), REACH)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1e7, 1e7), min_size=3, max_size=3), st.floats(0.0, 360.0))
def test_any_pose_ends_in_a_placement_or_one_sentence(xyz, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    try:
        placement = check_placement(panel(), pose(*xyz, rotation=[[c, -s, 0], [s, c, 0], [0, 0, 1]]), REACH)
    except PlacementError as error:
        assert "\n" not in str(error)
    else:
        assert len(placement.far) < 5
