"""Where an element can be held: faces, cups, centre of gravity, turns."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from work_samples import BRICK, recipes, tool

from construction_twin.extensions.work.element_bodies import ElementPieces
from construction_twin.extensions.work.place.grips import find_grips
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.objects import SceneObject, product

UP = np.array([0.0, 0.0, 1.0])


def grips(*boxes, mass=3.0, up=UP, **changes):
    recipe = recipes().recipes["brick"]
    wanted = {"along": (0.0,), "turns_deg": (0.0,), "yaws_deg": (0.0,), "min_cups": 1, **changes}
    recipe = recipe.model_copy(update={"grips": recipe.grips.model_copy(update=wanted)})
    pieces = tuple(SceneObject(f"e/{number}", "box", size, middle) for number, (size, middle) in enumerate(boxes))
    return find_grips(ElementPieces(pieces), up, mass, recipe, tool().tool)


BEAM = ((1.0, 0.06, 0.12), (0.0, 0.0, 0.06))


def test_the_tool_comes_to_the_middle_of_the_upper_face_against_its_normal():
    (grip,) = grips(BEAM).grips
    assert np.allclose(grip.element_T_tcp.position, (0, 0, 0.12))
    assert np.allclose(grip.element_T_tcp.rotation[:, 2], -UP)
    assert np.allclose(np.abs(grip.element_T_tcp.rotation[:, 0]), (1, 0, 0))
    assert grip.cups == 6


def test_a_face_is_seen_across_the_seam_of_two_pieces():
    halves = ((0.5, 0.06, 0.12), (-0.25, 0, 0.06)), ((0.5, 0.06, 0.12), (0.25, 0, 0.06))
    (grip,) = grips(*halves).grips
    assert grip.cups == 6


def test_a_cup_over_a_gap_or_under_another_piece_does_not_count():
    gap = ((0.4, 0.06, 0.12), (-0.205, 0, 0.06)), ((0.4, 0.06, 0.12), (0.205, 0, 0.06))
    assert grips(*gap).grips[0].cups == 6  # the gap of 10 mm is between the cups at +-40 mm
    wide = ((0.4, 0.06, 0.12), (-0.25, 0, 0.06)), ((0.4, 0.06, 0.12), (0.25, 0, 0.06))
    assert grips(*wide).grips[0].cups == 4
    covered = BEAM, ((0.1, 0.06, 0.05), (0.18, 0, 0.145))
    found = grips(*covered, faces=("+z",), lever=0.3).grips
    assert all(grip.cups < 6 for grip in found if grip.element_T_tcp.position[2] < 0.13)


def test_cups_that_stand_out_are_not_counted_and_too_few_are_a_reason():
    brick = (BRICK, (0, 0, 0.0355))
    assert grips(brick).grips[0].cups == 2
    found = grips(brick, min_cups=3)
    assert not found.grips and found.reason.endswith(": 2 cups lie on the face; 3 are needed")
    assert grips(brick, along=(0.115,), min_cups=3).grips[0].cups == 3


def test_the_margin_keeps_cups_from_the_edge():
    strip = ((1.0, 0.042, 0.05), (0, 0, 0.025))
    assert grips(strip, margin=0.0005).grips[0].cups == 6
    assert not grips(strip, margin=0.002).grips


def test_the_mass_decides_how_many_cups_must_hold():
    assert grips(BEAM, mass=60.0).grips
    few = ((0.3, 0.06, 0.12), (0, 0, 0.06))
    assert grips(few, mass=48.0).grips[0].cups == 4
    assert grips(few, mass=48.1).reason.endswith(": 4 cups lie on the face; 5 are needed")
    reason = grips(BEAM, mass=73.0).reason
    assert "need 7 cups" in reason and reason.endswith(" has 6")


def test_the_centre_of_gravity_has_to_be_near_the_cups():
    assert grips(BEAM, along=(0.2,), lever=0.05).grips
    found = grips(BEAM, along=(0.3,), lever=0.05)
    assert not found.grips and "the centre of gravity is 120 mm beside" in found.reason


def test_faces_come_in_the_order_of_the_recipe_each_once():
    found = grips(((1.0, 0.3, 0.2), (0, 0, 0)), faces=("+y", "up", "any"), min_cups=1, lever=0.3).grips
    assert [grip.name.split()[0] for grip in found][:2] == ["+y", "+z"]
    normals = {tuple(np.round(grip.element_T_tcp.rotation[:, 2]) + 0.0) for grip in found}
    assert len(normals) == len(found) == 6


def test_up_follows_how_the_element_lies_in_the_stock():
    (grip,) = grips(BEAM, up=np.array([0.0, -1.0, 0.0])).grips
    assert np.allclose(grip.element_T_tcp.rotation[:, 2], (0, 1, 0))


def test_only_a_symmetric_element_may_be_turned():
    assert len(grips(BEAM, turns_deg=(0.0, 90.0, 180.0)).grips) == 2
    lopsided = BEAM, ((0.1, 0.06, 0.02), (0.4, 0, -0.01))
    assert len(grips(*lopsided, turns_deg=(0.0, 180.0)).grips) == 1


@given(
    length=st.floats(0.1, 3.0), width=st.floats(0.03, 1.0), height=st.floats(0.01, 0.5), along=st.floats(-0.3, 0.3),
    yaw=st.sampled_from([0.0, 37.0, 90.0]),
)  # fmt: skip
def test_every_cup_that_counts_lies_on_the_face_whole(length, width, height, along, yaw):
    found = grips(((length, width, height), (0, 0, 0)), along=(along,), yaws_deg=(yaw,), lever=10.0)
    cups, sides = tool().tool.cups, np.array([max(length, width), min(length, width)])
    for grip in found.grips:
        longer_first = [0, 1] if length >= width else [1, 0]
        at = np.array(
            [product(grip.element_T_tcp, Pose(np.array([x, y, 0.0]), np.eye(3))).position for x, y in cups.at]
        )
        inside = (np.abs(at[:, longer_first]) + cups.radius <= sides / 2).all(axis=1)
        assert grip.cups <= inside.sum()
        surely = (np.abs(at[:, longer_first]) + cups.radius + 0.003 <= sides / 2).all(axis=1)
        assert grip.cups >= surely.sum()


def test_a_body_that_is_not_closed_or_not_convex_has_no_grip(tmp_path):
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 0.3) for z in (0, 0.2))
    sides = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    recipe = recipes().recipes["brick"]
    found = []
    for count in (6, 5):
        quads = [side.split() for side in sides[:count]]
        faces = "".join(f"f {a} {b} {c}\nf {a} {c} {d}\n" for a, b, c, d in quads)
        path = tmp_path / f"{count}.obj"
        path.write_text(corners + faces)
        body = SceneObject("e/0", "mesh", mesh=str(path))
        found.append(find_grips(ElementPieces([body]), UP, 3.0, recipe, tool().tool))
    closed, open_above = found
    assert closed.grips
    assert not open_above.grips and "is not closed" in open_above.reason
