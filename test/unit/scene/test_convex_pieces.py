"""scene.convex_pieces: a mesh that is not convex is the same convex pieces for the planner and for the simulation."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from xml.etree import ElementTree

import coal
import manifold3d
import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from physics_samples import READY, bodies_of, drives, model_of, pairs_of, robot_of
from piece_checks import distances, lost
from scene_samples import box_triangles, bracket_triangles, write_obj, write_stl
from scipy.spatial import ConvexHull

from construction_twin.extensions.physics.model import Load, PhysicsModel
from construction_twin.extensions.physics.nodes.gazebo import world_of
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.scene import convex_pieces as module
from construction_twin.scene.collision_bodies import (
    RobotBodies,
    is_convex,
    measured,
    mesh_triangles,
    scene_geometry,
    scene_shapes,
)
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.convex_pieces import HELD, convex_pieces, farthest_outside
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.solids import mesh_of, solid

L = [(0.0, 0.0), (0.4, 0.0), (0.4, 0.1), (0.1, 0.1), (0.1, 0.4), (0.0, 0.4)]
U = [(-0.3, -0.1), (0.3, -0.1), (0.3, 0.4), (0.2, 0.4), (0.2, 0.0), (-0.2, 0.0), (-0.2, 0.4), (-0.3, 0.4)]
#: Middle of the notch of each in its frame, and how far a sphere there is from the mesh, without its radius.
SHAPES = {"L": (L, (0.25, 0.25, 0.0), 0.15), "U": (U, (0.0, 0.2, 0.0), 0.2)}
RADIUS = 0.05
#: Remarks of the simulation, with the object's name.
HULL = r"the mesh of (\w+) is neither convex nor closed, .* has its convex hull"
PIECES = r"the mesh of (\w+) is curved"
COVER = r"the mesh of (\w+) is not convex: the simulation has convex pieces"
MASS = r"mass of (\w+) is an estimate from its volume"


def extruded(outline) -> np.ndarray:
    """Return the triangles of an outline that is 0.2 m thick, its middle at z 0, shape (t, 3, 3)."""
    body = manifold3d.Manifold.extrude(manifold3d.CrossSection([outline]), 0.2).translate((0.0, 0.0, -0.1))
    vertices, triangles = mesh_of(body)
    return vertices[triangles]


def dented_ball() -> np.ndarray:
    """Return the triangles of a ball with a dent, all of its faces in planes of their own."""
    body = manifold3d.Manifold.sphere(0.3, 36) - manifold3d.Manifold.sphere(0.2, 36).translate((0.3, 0.0, 0.0))
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
@settings(deadline=None, max_examples=12)
def test_pieces_are_the_mesh_wherever_it_lies(name, quaternion, place, scale, seed):
    corners = (
        scale * extruded(SHAPES[name][0]) @ rotation(*(np.array(quaternion) / np.linalg.norm(quaternion))).T + place
    )
    vertices, triangles = indexed(corners)
    found = convex_pieces(vertices, triangles)
    assert found is not None and found.whole is None and len(found.corners) == {"L": 2, "U": 3}[name]
    pieces = found.corners
    closed = solid(vertices, triangles)
    assert lost(closed, pieces) == 0.0
    assert sum(coal_hull(piece).computeVolume() for piece in pieces) == pytest.approx(closed.volume(), rel=1e-6)
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
        assert not remarks_of(physics, HULL)
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
    assert remarks_of(physics, MASS) == ["part"]
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
    mass = 1000.0 * scene_geometry(part).computeVolume()
    assert [one for one in world.remarks if one.startswith("mass of")] == [
        f"mass of part is an estimate from its volume: {mass:.1f} kg"
    ]


def _stl_corners(contents: bytes) -> np.ndarray:
    vertices, triangles = parse_mesh("a piece", "piece.stl", contents, (1.0, 1.0, 1.0))
    return vertices[triangles]


def remarks_of(physics: PhysicsModel, words: str) -> list[str]:
    """Return the names of the objects that a remark of these words is about."""
    return [found[1] for remark in physics.remarks if (found := re.match(words, remark))]


def fine_ball() -> np.ndarray:
    """Return a dented ball of more triangles than are divided."""
    body = manifold3d.Manifold.sphere(0.3, 96) - manifold3d.Manifold.sphere(0.2, 96).translate((0.3, 0.0, 0.0))
    vertices, triangles = mesh_of(body)
    return vertices[triangles]


@pytest.mark.parametrize(
    "corners",
    [extruded(L)[1:], fine_ball(), box_triangles((1.0, 1.0, 1.0))[:, ::-1][2:]],
    ids=["open", "fine", "open box"],
)
def test_what_cannot_be_divided_is_a_surface_and_the_simulation_says_that_it_has_the_hull(corners, tmp_path):
    assert convex_pieces(*indexed(corners)) is None
    part = SceneObject("part", "mesh", (), (2.0, 0.0, 1.0), mesh=write_stl(tmp_path / "part.stl", corners))
    (shape,) = scene_shapes(part).shapes
    assert isinstance(shape, coal.BVHModelBase)
    physics = model_of(scene=Scene((part,)))
    assert remarks_of(physics, HULL) == ["part"]
    assert not remarks_of(physics, PIECES) and not remarks_of(physics, COVER)


def test_pieces_that_reach_too_far_are_for_the_simulation_alone_which_says_how_far(tmp_path):
    """The planner keeps the surface: it would lose room. The simulation had the hull instead, which fills the dent."""
    ball = SceneObject("ball", "mesh", (), (2.0, 0.0, 1.0), mesh=write_stl(tmp_path / "ball.stl", dented_ball()))
    vertices, triangles = mesh_triangles(scene_geometry(ball))
    found = convex_pieces(vertices, triangles)
    assert 0.005 < found.reach < 0.01
    assert farthest_outside(vertices, found.corners) <= HELD
    assert [type(shape) for shape in scene_shapes(ball).shapes] == [coal.BVHModelOBBRSS]
    # 8 cm inside the hull, 8 cm outside the ball
    probe = SceneObject("probe", "sphere", (0.05,), (2.2, 0.0, 1.0))
    scene = Scene((ball, probe))
    physics = model_of(scene=scene, load=Load({"probe": 1.0}, {"probe": "probe"}))
    assert remarks_of(physics, COVER) == ["ball"] and not remarks_of(physics, HULL)
    assert any(f"reach up to {1e3 * found.reach:.1f} mm beyond it" in remark for remark in physics.remarks)
    assert not touching(physics, "ball", "probe")


def touching(physics: PhysicsModel, one: str, other: str) -> bool:
    return {one, other} in [{physics.owners[geom] for geom in geoms} for geoms in physics.at_rest(READY).contact.geom]


def test_closed_bodies_of_one_mesh_that_reach_into_each_other_are_one():
    """The bracket's boxes share a face; two crossed bars share their middle."""
    crossed = np.concatenate([box_triangles((1.0, 0.2, 0.2)), box_triangles((0.2, 1.0, 0.2))])
    for corners, volume in ((bracket_triangles(), 0.08), (crossed, 0.072)):
        pieces = convex_pieces(*indexed(corners))
        assert pieces is not None and pieces.whole is None
        assert sum(coal_hull(piece).computeVolume() for piece in pieces.corners) == pytest.approx(volume, rel=1e-9)


def test_the_same_mesh_gives_the_same_pieces_and_is_divided_once(tmp_path, monkeypatch):
    one, other = (
        SceneObject(name, "mesh", (), (2.0, y, 1.0), mesh=write_stl(tmp_path / f"{name}.stl", 1.03 * extruded(U)))
        for name, y in (("one", -1.0), ("other", 1.0))
    )
    calls, divide = [], module.convex_cells
    monkeypatch.setattr(module, "convex_cells", lambda *given: calls.append(1) or divide(*given))
    # another planner, another robot: still the same mesh
    placed = [body for each in (one, other) for body in RobotBodies(robot_of("kr120")).place(each)]
    assert [body.owner for body in placed] == ["one"] * 3 + ["other"] * 3 and calls == [1]


def arc(middle: tuple[float, float], radius: float, begin: float, end: float, count: int) -> list[tuple[float, float]]:
    x, y = middle
    angles = np.radians(np.linspace(begin, end, count))
    return [(float(x + radius * np.cos(angle)), float(y + radius * np.sin(angle))) for angle in angles]


def rounded_u() -> np.ndarray:
    """Return a U, 0.4 m wide inside, with inner edges of 30 mm radius."""
    floor = [*arc((0.17, 0.03), 0.03, 0.0, -90.0, 17), *arc((-0.17, 0.03), 0.03, -90.0, -180.0, 17)]
    return extruded([(-0.3, -0.1), (0.3, -0.1), (0.3, 0.4), (0.2, 0.4), *floor, (-0.2, 0.4), (-0.3, 0.4)])


def i_beam() -> np.ndarray:
    """Return a beam 0.1 m wide and 0.2 m high, 10 mm thick, with fillets of 12 mm."""
    x, y = 0.017, 0.078
    outline = [(-0.05, -0.1), (0.05, -0.1), (0.05, -0.09), *arc((x, -y), 0.012, -90.0, -180.0, 9)]
    outline += [*arc((x, y), 0.012, 180.0, 90.0, 9), (0.05, 0.09), (0.05, 0.1), (-0.05, 0.1), (-0.05, 0.09)]
    outline += [*arc((-x, y), 0.012, 90.0, 0.0, 9), *arc((-x, -y), 0.012, 0.0, -90.0, 9), (-0.05, -0.09)]
    return extruded(outline)


def torus() -> np.ndarray:
    """Return a ring of 0.6 m, 0.2 m thick, of 4096 triangles."""
    body = manifold3d.Manifold.revolve(manifold3d.CrossSection([arc((0.3, 0.0), 0.1, 0.0, 360.0, 33)[:-1]]), 64)
    vertices, triangles = mesh_of(body)
    return vertices[triangles]


CURVED = {"rounded U": rounded_u, "I-beam": i_beam, "torus": torus}


@pytest.mark.parametrize("name", CURVED)
def test_curved_meshes_are_held_by_pieces_that_reach_little_beyond(name):
    corners = CURVED[name]()
    vertices, triangles = indexed(corners)
    found = convex_pieces(vertices, triangles)
    closed = solid(vertices, triangles)
    assert found is not None and len(found.corners) <= {"rounded U": 18, "I-beam": 12, "torus": 64}[name]
    # by all that `containment` can find, not only by corners
    assert lost(closed, found.corners) == 0.0
    # what the pieces have more is as thin as they say, also at points that the search has not looked at
    assert found.reach <= {"rounded U": 0.0011, "I-beam": 0.0011, "torus": 0.0025}[name]
    rng = np.random.default_rng(5)
    planes = [ConvexHull(piece).equations for piece in found.corners]
    points = rng.uniform(vertices.min(axis=0), vertices.max(axis=0), (3000, 3))
    held = np.min([(points @ one[:, :3].T + one[:, 3]).max(axis=1) for one in planes], axis=0) <= 0.0
    away = distances(points[held], vertices, triangles)
    outside = np.array([is_outside(closed, point) for point in points[held]])
    assert held.sum() > 100 and not outside.all()
    assert away[outside].max(initial=0.0) <= found.reach + 2e-4


def is_outside(body: manifold3d.Manifold, point: np.ndarray) -> bool:
    """Return whether a point lies outside of a closed body: on a line to far away it meets an even number of faces."""
    return len(body.ray_cast(tuple(point.tolist()), tuple((point + (3.1, 4.7, 8.3)).tolist()))) % 2 == 0


def test_curved_pieces_are_the_same_in_every_process():
    vertices, triangles = indexed(rounded_u())
    command = [sys.executable, "-c", "import pickle, sys; from construction_twin.scene.convex_pieces import convex_pieces; "
               "found = convex_pieces(*pickle.load(sys.stdin.buffer)); "
               "sys.stdout.buffer.write(b''.join(one.tobytes() for one in found.corners))"]  # fmt: skip
    there = subprocess.run(command, input=pickle.dumps((vertices, triangles)), capture_output=True, check=True)
    assert there.stdout == b"".join(piece.tobytes() for piece in convex_pieces(vertices, triangles).corners)


def test_a_brick_stands_in_a_rounded_u_for_planner_and_simulation(tmp_path):
    """It is set down 3 mm above the floor of the U, 1 cm beside the rounded edges, where the hull is full."""
    path = write_stl(tmp_path / "u.stl", rounded_u())
    at = (1.6, 0.0, 1.0)
    stand = SceneObject("stand", "mesh", (), at, (0.7071067811865476, 0.0, 0.0, 0.7071067811865476), mesh=path)
    brick = SceneObject("brick", "box", (0.32, 0.115, 0.07), (1.6, 0.0, 1.038))
    robot, pairs = robot_of("kr120"), pairs_of("kr120")
    assert len(scene_shapes(stand).shapes) > 3
    physics = model_of(scene=Scene((stand, brick)), load=Load({"brick": 3.5}, {"brick": "brick"}))
    assert remarks_of(physics, PIECES) == ["stand"]
    assert not remarks_of(physics, HULL) and not remarks_of(physics, COVER)
    assert not touching(physics, "stand", "brick")
    # it falls the 3 mm and stays there
    data = physics.at_rest(READY)
    place = physics.loose["brick"]
    for _ in range(500):
        mujoco.mj_step(physics.model, data)
    assert data.qpos[place : place + 3] == pytest.approx((1.6, 0.0, 1.035), abs=5e-4)
    # the planner, with the brick in the arm's hand at the same place
    flange = Chain(robot).forward(READY)
    inverse = flange.rotation.T
    for lower, free in ((0.0, True), (0.005, False)):
        held_at = inverse @ (np.array((1.6, 0.0, 1.038 - lower)) - flange.position)
        turn = rotation_to_quaternion(inverse)
        held = SceneObject("brick", "box", brick.size, tuple(held_at), tuple(turn), link="tool0")
        world = CollisionWorld(robot, Scene((stand, held)), pairs)
        assert (("brick", "stand") not in {contact.between for contact in world.contacts(READY)}) is free
        carried = model_of(scene=Scene((stand, held)))
        assert touching(carried, "brick", "stand") is not free
        if free:
            # that of the mesh, less what the pieces have more
            assert 0.003 - scene_shapes(stand).reach <= world.distance(READY, "brick", "stand") < 0.0031


def test_what_is_curved_weighs_what_its_mesh_encloses(tmp_path):
    """Hulls of its parts overlap and reach beyond it: their sum would be more."""
    path = write_stl(tmp_path / "u.stl", rounded_u()[:, ::-1])
    part = SceneObject("part", "mesh", (), (2.0, 0.0, 1.0), mesh=path)
    physics = model_of(scene=Scene((part,)), load=Load({}, {"part": "part"}))
    mesh = scene_geometry(part)
    volume = abs(mesh.computeVolume())
    assert sum(shape.computeVolume() for shape in scene_shapes(part).shapes) > 1.0002 * volume
    body = physics.model.body("part")
    assert body.mass[0] == pytest.approx(1000.0 * volume, rel=1e-6)
    assert body.ipos == pytest.approx(np.ravel(mesh.computeCOM()), abs=1e-6)


@given(
    holes=st.lists(
        st.tuples(*[st.floats(-0.3, 0.3)] * 3, st.floats(0.05, 0.25), st.integers(8, 14)), min_size=1, max_size=3
    )
)
@settings(deadline=None, max_examples=2)
def test_a_box_with_any_dents_is_in_its_pieces(holes):
    body = manifold3d.Manifold.cube((0.6, 0.5, 0.4), True)
    for x, y, z, radius, segments in holes:
        body -= manifold3d.Manifold.sphere(radius, segments).translate((x, y, z))
    assume(body.volume() > 1e-4)
    vertices, triangles = mesh_of(body)
    found = convex_pieces(vertices, triangles)
    assume(found is not None)
    whole = solid(vertices, triangles)
    assert lost(whole, found.corners) == 0.0
    volumes = [coal_hull(piece).computeVolume() for piece in found.corners]
    assert sum(volumes) >= whole.volume() * (1.0 - 1e-6)
