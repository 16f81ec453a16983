"""scene.convex_pieces: a mesh that is not convex is the same convex pieces for the planner and for the simulation."""

from __future__ import annotations

from xml.etree import ElementTree

import coal
import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from physics_samples import READY, bodies_of, drives, model_of, pairs_of, robot_of
from scene_samples import box_triangles, bracket_triangles, write_obj, write_stl

from construction_twin.kinematics.chain import Chain
from construction_twin.physics.gazebo_world import world_of
from construction_twin.physics.model import Load
from construction_twin.scene import convex_pieces as module
from construction_twin.scene.collision_bodies import is_convex, measured, mesh_triangles, scene_geometry, scene_shapes
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.containment import distances, excess, lost
from construction_twin.scene.convex_pieces import convex_pieces
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.solids import mesh_of, solid

L = [(0.0, 0.0), (0.4, 0.0), (0.4, 0.1), (0.1, 0.1), (0.1, 0.4), (0.0, 0.4)]
U = [(-0.3, -0.1), (0.3, -0.1), (0.3, 0.4), (0.2, 0.4), (0.2, 0.0), (-0.2, 0.0), (-0.2, 0.4), (-0.3, 0.4)]
#: Middle of the notch of each in its frame, and how far a sphere there is from the mesh, without its radius.
SHAPES = {"L": (L, (0.25, 0.25, 0.0), 0.15), "U": (U, (0.0, 0.2, 0.0), 0.2)}
RADIUS = 0.05


def extruded(outline) -> np.ndarray:
    """Return the triangles of an outline that is 0.2 m thick, its middle at z 0, shape (t, 3, 3)."""
    body = manifold3d.Manifold.extrude(manifold3d.CrossSection([outline]), 0.2).translate((0.0, 0.0, -0.1))
    vertices, triangles = mesh_of(body)
    return vertices[triangles]


def dented_ball() -> np.ndarray:
    """Return the triangles of a ball with a dent, all of its faces in planes of their own."""
    body = manifold3d.Manifold.sphere(0.3, 48) - manifold3d.Manifold.sphere(0.2, 48).translate((0.3, 0.0, 0.0))
    vertices, triangles = mesh_of(body)
    return vertices[triangles]


def indexed(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices, index = np.unique(np.round(corners.reshape(-1, 3), 12), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3)


def rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


@pytest.mark.parametrize("name", SHAPES)
@given(
    quaternion=st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    place=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    scale=st.floats(0.1, 10.0),
    seed=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=40)
def test_pieces_are_the_mesh_wherever_it_lies(name, quaternion, place, scale, seed):
    corners = (
        scale * extruded(SHAPES[name][0]) @ rotation(*(np.array(quaternion) / np.linalg.norm(quaternion))).T + place
    )
    vertices, triangles = indexed(corners)
    pieces = convex_pieces(vertices, triangles)
    assert pieces is not None and len(pieces) == {"L": 2, "U": 3}[name]
    closed = solid(vertices, triangles)
    assert lost(vertices, triangles, closed, pieces) == 0.0
    assert excess(closed, pieces) <= 2e-6
    # outside, each point is as far from the nearest piece as from the surface
    shapes = [coal_hull(piece) for piece in pieces]
    points = np.random.default_rng(seed).uniform(vertices.min(axis=0) - scale, vertices.max(axis=0) + scale, (30, 3))
    exact = distances(points, vertices, triangles)
    for point, expected in zip(points, exact):
        found = min(distance(coal.Sphere(1e-6), point, shape) for shape in shapes) + 1e-6
        if found > 0.0:
            assert found == pytest.approx(expected, abs=5e-6)


def coal_hull(points: np.ndarray) -> coal.CollisionGeometry:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(0, len(points))
    mesh.addVertices(np.ascontiguousarray(points))
    mesh.endModel()
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex


def distance(first: coal.CollisionGeometry, at: np.ndarray, second: coal.CollisionGeometry) -> float:
    here = coal.Transform3s.Identity()
    return measured(first, coal.Transform3s(np.eye(3), at), second, here).min_distance


@pytest.mark.parametrize("name", SHAPES)
def test_the_arm_in_the_notch_is_free_and_on_an_arm_of_it_is_not_for_both(name, tmp_path):
    outline, middle, gap = SHAPES[name]
    path = write_stl(tmp_path / f"{name}.stl", extruded(outline))
    flange = Chain(robot_of("kr120")).forward(READY)
    # a ball half a metre in front of the flange
    ball = SceneObject("ball", "sphere", (RADIUS,), (0.0, 0.0, 0.5), link="tool0")
    centre = flange.position + flange.rotation @ (0.0, 0.0, 0.5)
    for aside, free in ((0.0, True), (gap - RADIUS + 0.005, False)):
        at = tuple(centre - np.array(middle) + (aside, 0.0, 0.0))
        stand = SceneObject("stand", "mesh", (), at, mesh=path)
        scene = Scene((stand, ball))
        world = CollisionWorld(robot_of("kr120"), scene, pairs_of("kr120"))
        found = {contact.between for contact in world.contacts(READY)}
        physics = model_of(scene=scene)
        touching = [{physics.owners[geom] for geom in geoms} for geoms in physics.at_rest(READY).contact.geom]
        assert (("ball", "stand") not in found) is free
        assert ({"ball", "stand"} not in touching) is free
        assert "physics.remark.hull" not in [remark.key for remark in physics.remarks]
        if free:
            assert world.distance(READY, "ball", "stand") == pytest.approx(gap - RADIUS, abs=1e-6)
            assert world.is_free(READY) and not touching


def test_inside_a_piece_is_inside_the_object(tmp_path):
    path = write_obj(tmp_path / "u.obj", 20.0 * extruded(U))
    bottom = SceneObject("stand", "mesh", (), (0.0, 1.0, 0.0), mesh=path)
    # the whole arm is within the bottom of the U, which as a surface nobody would see
    assert not CollisionWorld(robot_of("kr120"), Scene((bottom,)), pairs_of("kr120")).is_free(READY)


def test_a_carried_mesh_is_one_body_with_the_mass_of_the_mesh(tmp_path):
    path = write_stl(tmp_path / "u.stl", extruded(U))
    part = SceneObject("part", "mesh", (), (0.0, 0.0, 0.3), mesh=path, link="tool0")
    bodies = bodies_of("kr120")
    pieces = bodies.place(part, (part.name,))
    assert [piece.owner for piece in pieces] == ["part"] * 3
    mesh = scene_geometry(part)
    physics = model_of(scene=Scene((part,)))
    assert physics.model.body("part").mass[0] == pytest.approx(1000.0 * mesh.computeVolume(), rel=1e-9)
    assert physics.model.body("part").ipos == pytest.approx(np.ravel(mesh.computeCOM()), abs=1e-9)
    moment = np.linalg.eigvalsh(1000.0 * np.array(mesh.computeMomentofInertiaRelatedToCOM()))
    assert np.sort(physics.model.body("part").inertia) == pytest.approx(moment, rel=1e-9)
    assert [remark.values["object"] for remark in physics.remarks if remark.key == "physics.remark.object_mass"] == [
        "part"
    ]
    loose = model_of(
        scene=Scene((SceneObject("part", "mesh", (), (2.0, 0.0, 1.0), mesh=path),)), load=Load({}, {"part": "part"})
    )
    assert loose.model.body("part").mass[0] == pytest.approx(1000.0 * mesh.computeVolume(), rel=1e-9)
    assert list(loose.loose) == ["part"]


def test_gazebo_has_the_same_pieces(tmp_path):
    path = write_stl(tmp_path / "u.stl", extruded(U))
    part = SceneObject("part", "mesh", (), (0.0, 0.0, 0.3), mesh=path, link="tool0")
    stand = SceneObject("stand", "mesh", (), (2.0, 0.0, 1.0), mesh=path)
    world = world_of(bodies_of("kr120"), Scene((part, stand)), drives(), tmp_path)
    root = ElementTree.fromstring(world.sdf)
    for name in ("part", "stand"):
        touched = [one for one in root.iter("collision") if one.get("name").startswith(name)]
        assert len(touched) == 3
    # each is convex
    meshes = [world.meshes[name] for name in world.meshes]
    assert len(meshes) == 6
    for contents in meshes:
        assert is_convex(*indexed(_stl_corners(contents)))
    masses = [remark.values for remark in world.remarks if remark.key == "physics.remark.object_mass"]
    assert [(one["object"], one["mass"]) for one in masses] == [
        ("part", pytest.approx(1000.0 * scene_geometry(part).computeVolume(), rel=1e-6))
    ]


def _stl_corners(contents: bytes) -> np.ndarray:
    vertices, triangles = parse_mesh("a piece", "piece.stl", contents, (1.0, 1.0, 1.0))
    return vertices[triangles]


@pytest.mark.parametrize(
    "corners",
    [extruded(L)[1:], dented_ball(), box_triangles((1.0, 1.0, 1.0))[:, ::-1][2:]],
    ids=["open", "curved", "open box"],
)
def test_what_cannot_be_divided_is_a_surface_and_the_simulation_says_that_it_has_the_hull(corners, tmp_path):
    assert convex_pieces(*indexed(corners)) is None
    part = SceneObject("part", "mesh", (), (2.0, 0.0, 1.0), mesh=write_stl(tmp_path / "part.stl", corners))
    (shape,) = scene_shapes(part)
    assert isinstance(shape, coal.BVHModelBase)
    physics = model_of(scene=Scene((part,)))
    assert [remark.values["object"] for remark in physics.remarks if remark.key == "physics.remark.hull"] == ["part"]


def test_closed_bodies_of_one_mesh_that_reach_into_each_other_are_one():
    """The bracket's boxes share a face; two crossed bars share their middle."""
    crossed = np.concatenate([box_triangles((1.0, 0.2, 0.2)), box_triangles((0.2, 1.0, 0.2))])
    for corners, volume in ((bracket_triangles(), 0.08), (crossed, 0.072)):
        pieces = convex_pieces(*indexed(corners))
        assert pieces is not None
        assert sum(coal_hull(piece).computeVolume() for piece in pieces) == pytest.approx(volume, rel=1e-9)


def test_pieces_that_lose_something_are_not_taken(monkeypatch):
    vertices, triangles = indexed(extruded(U))
    whole = module.convex_cells
    monkeypatch.setattr(module, "convex_cells", lambda *given: whole(*given)[1:])
    assert convex_pieces(vertices, triangles) is None


def test_the_same_mesh_gives_the_same_pieces_and_is_divided_once(tmp_path, monkeypatch):
    path = write_stl(tmp_path / "u.stl", extruded(U))
    calls = []
    divide = module.convex_pieces
    monkeypatch.setattr(module, "convex_pieces", lambda *given: calls.append(1) or divide(*given))
    one, other = (
        SceneObject(name, "mesh", (), (2.0, y, 1.0), mesh=path) for name, y in (("one", -1.0), ("other", 1.0))
    )
    bodies = type(bodies_of("kr120"))(robot_of("kr120"))
    placed = bodies.place_all(Scene((one, other)))
    assert [body.owner for body in placed] == ["one"] * 3 + ["other"] * 3 and calls == [1]
    assert [id(body.geometry) for body in placed[:3]] == [id(body.geometry) for body in placed[3:]]
    again = convex_pieces(*mesh_triangles(scene_geometry(one)))
    assert [piece.tolist() for piece in again] == [
        piece.tolist() for piece in convex_pieces(*mesh_triangles(scene_geometry(other)))
    ]
