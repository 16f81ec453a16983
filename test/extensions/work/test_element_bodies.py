"""work.element_bodies: pieces hold the whole element, reach little beyond it, and leave hollows hollow."""

from __future__ import annotations

from pathlib import Path

import coal
import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from piece_checks import points_on

from construction_twin.extensions.work import element_bodies
from construction_twin.extensions.work.building import Body, Element
from construction_twin.extensions.work.element_bodies import ElementPieces, ElementShape, element_shapes
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.collision_bodies import scene_geometry
from construction_twin.scene.solids import mesh_of

M = manifold3d.Manifold
HERE = Pose(np.zeros(3), np.eye(3))
HOLLOW = {
    "tube": (lambda: M.cube((0.1, 0.1, 2.0), True) - M.cube((0.08, 0.08, 3.0), True), 4),
    "closed box": (lambda: M.cube((2.0, 2.0, 2.0), True) - M.cube((1.8, 1.8, 1.8), True), 6),
    "room with a door": (
        lambda: M.cube((5.0, 4.0, 3.0), True) - M.cube((4.8, 3.8, 2.8), True) - M.cube((1.0, 1.0, 2.0)).translate((2.0, 0.0, -1.4)),
        12,
    ),
    "U": (lambda: M.cube((1.0, 0.2, 1.0), True) - M.cube((0.8, 1.0, 0.9), True).translate((0.0, 0.0, 0.1)), 3),
    "wall with a window": (lambda: M.cube((5.0, 0.2, 3.0)) - M.cube((1.0, 0.2, 1.0)).translate((1.0, 0.0, 1.0)), 4),
    "pipe": (lambda: M.cylinder(2.0, 0.1, 0.1, 24) - M.cylinder(2.0, 0.08, 0.08, 24), 24),
    "hall": (lambda: M.cube((30.0, 20.0, 8.0), True) - M.cube((29.6, 19.6, 7.6), True), 6),
    "notched rafter, turned": (
        lambda: (M.cube((3.0, 0.08, 0.2)) - M.cube((0.1, 0.08, 0.05)).translate((0.5, 0.0, 0.0))).rotate((10, 20, 30)),
        3,
    ),
}  # fmt: skip


def body_of(solid: M) -> Body:
    return Body(*mesh_of(solid))


def element(*bodies: Body, name: str = "2O2Fr$t4X7Zf8NOew3FLOH") -> Element:
    return Element(name, "IfcMember", "stud", "", "", "", HERE, bodies, {}, None)


def element_shape(one: Element, folder: Path) -> ElementShape:
    return element_shapes([one], folder)[0][one.id]


def triangles_of(size: tuple, centre=(0.0, 0.0, 0.0)) -> M:
    return M.cube(size, True).translate(centre)


@pytest.mark.parametrize("name", HOLLOW)
def test_hollow_things_stay_hollow(name, tmp_path):
    make, most = HOLLOW[name]
    solid = make()
    shape = element_shape(element(body_of(solid)), tmp_path)
    assert len(shape.objects) <= most
    assert shape.excess <= 1e-6
    pieces = ElementPieces(shape.objects)
    vertices, triangles = mesh_of(solid)
    assert pieces.contain(points_on(vertices, triangles), 1e-6).all()
    assert sum(hull.volume for hull in pieces.hulls) == pytest.approx(solid.volume(), rel=1e-6)


def test_objects_are_named_after_the_element_and_boxes_are_boxes(tmp_path):
    stud = element(body_of(triangles_of((0.06, 0.12, 2.4), (0.03, 0.06, 1.2))), body_of(triangles_of((1.0, 0.02, 1.0))))
    shape = element_shape(stud, tmp_path)
    assert [item.name for item in shape.objects] == [f"{stud.id}/0", f"{stud.id}/1"]
    first = shape.objects[0]
    assert (first.shape, first.quaternion) == ("box", (0.0, 0.0, 0.0, 1.0))
    np.testing.assert_allclose(first.size, (0.06, 0.12, 2.4), atol=1e-12)
    np.testing.assert_allclose(first.position, (0.03, 0.06, 1.2), atol=1e-12)
    assert not list(tmp_path.glob("*.obj"))


def test_a_wedge_is_one_solid_mesh_with_all_digits(tmp_path):
    wedge = M.hull_points(np.array([(0, 0, 0), (1 / 3, 0, 0), (0, 1 / 7, 0), (0, 0, 1), (1 / 3, 0, 1), (0, 1 / 7, 1)]))
    shape = element_shape(element(body_of(wedge)), tmp_path)
    (item,) = shape.objects
    assert item.shape == "mesh" and Path(item.mesh).stem == item.mesh_digest
    assert "0.3333333333333333" in Path(item.mesh).read_text()
    assert scene_geometry(item).computeVolume() == pytest.approx(1 / 42)


def test_a_curved_hollow_is_held_and_its_excess_is_stated(tmp_path, monkeypatch):
    bowl = (M.sphere(0.3, 12) - M.sphere(0.24, 12)).trim_by_plane((0, 0, -1), 0.0)
    monkeypatch.setattr(element_bodies, "BOUND", 0.1)
    shape = element_shape(element(body_of(bowl)), tmp_path)
    vertices, triangles = mesh_of(bowl)
    assert 0 < shape.excess <= 0.1
    assert ElementPieces(shape.objects).contain(points_on(vertices, triangles), 1e-6).all()
    assert not ElementPieces(shape.objects).contain(np.array([(0.0, 0.0, -0.01)])).any()


def test_what_pieces_would_make_too_large_becomes_its_surface_with_a_margin(tmp_path, monkeypatch):
    bowl = (M.sphere(0.3, 24) - M.sphere(0.27, 24)).trim_by_plane((0, 0, -1), 0.0)
    monkeypatch.setattr(element_bodies, "BOUND", 1e-5)
    monkeypatch.setattr(element_bodies, "MARGIN", 0.008)
    shape = element_shape(element(body_of(bowl)), tmp_path)
    assert (shape.excess, shape.objects[0].padding) == (0.008, 0.008)
    assert isinstance(scene_geometry(shape.objects[0]), coal.BVHModelBase)


def test_a_body_that_is_not_closed_stays_a_surface(tmp_path):
    vertices, triangles = mesh_of(triangles_of((1.0, 1.0, 1.0)))
    shape = element_shape(element(Body(vertices, triangles[2:])), tmp_path)
    assert shape.excess == element_bodies.MARGIN == shape.objects[0].padding


def test_faces_in_any_order_of_corners_are_the_same_body(tmp_path):
    vertices, triangles = mesh_of(HOLLOW["closed box"][0]())
    turned = element_shape(element(Body(vertices, triangles[:, ::-1])), tmp_path)
    assert len(turned.objects) == 6


def test_the_same_body_gives_the_same_files(tmp_path):
    solid = HOLLOW["notched rafter, turned"][0]()
    first = element_shape(element(body_of(solid)), tmp_path / "one")
    second = element_shape(element(body_of(solid)), tmp_path / "two")
    names = [sorted(path.name for path in (tmp_path / folder).iterdir()) for folder in ("one", "two")]
    assert names[0] == names[1]
    assert [item.contents() for item in first.objects] == [item.contents() for item in second.objects]
    # kept: the same again, from the files
    assert element_shape(element(body_of(solid)), tmp_path / "one") == first


def test_a_damaged_file_is_made_anew(tmp_path):
    wedge = M.hull_points(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)], dtype=float))
    shape = element_shape(element(body_of(wedge)), tmp_path)
    Path(shape.objects[0].mesh).write_text("v 0 0 0\n")
    assert element_shape(element(body_of(wedge)), tmp_path) == shape
    (kept,) = tmp_path.glob("*.json")
    kept.write_text("{")
    assert element_shape(element(body_of(wedge)), tmp_path) == shape


@pytest.mark.parametrize(
    ("bodies", "sentence"),
    [
        ((), "no geometry"),
        ((Body(np.zeros((3, 3)), np.zeros((0, 3), dtype=int)),), "0 triangles"),
        ((Body(np.full((3, 3), np.nan), np.array([(0, 1, 2)])),), "finite corners"),
        ((Body(np.zeros((3, 3)), np.array([(0, 1, 2)])),), "without area"),
    ],
)
def test_what_cannot_be_used_is_said_with_the_element(bodies, sentence, tmp_path):
    shapes, failures = element_shapes([element(*bodies)], tmp_path)
    (said,) = failures.values()
    assert not shapes and said.startswith("element 2O2Fr") and sentence in said


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), cuts=st.integers(0, 4))
def test_blocks_with_random_notches_are_divided_exactly(seed, cuts, tmp_path_factory):
    rng = np.random.default_rng(seed)
    solid = M.cube((1.0, 1.0, 1.0), True)
    for _ in range(cuts):
        solid = solid - M.cube(tuple(rng.uniform(0.1, 0.6, 3)), True).translate(tuple(rng.uniform(-0.6, 0.6, 3)))
    solid = solid.rotate(tuple(rng.uniform(-180, 180, 3)))
    shape = element_shape(element(body_of(solid)), tmp_path_factory.mktemp("bodies"))
    assert shape.excess <= 0.001
    pieces = ElementPieces(shape.objects)
    assert pieces.contain(points_on(*mesh_of(solid)), 2e-6).all()
