"""Distances of bodies that just touch: Coal's depth is told, never its word for one that it does not know."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from scene_samples import kr120, kr120_pairs
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.scene.collision_bodies import UNKNOWN, measured
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject, product, relative

#: A board that stands on the edge of a plate of 1 mm.
BOARD, PLATE = (1.2, 0.0125, 2.4), (3.65, 0.075, 0.001)
HOME = np.array(kr120().home)


def edge_to_edge(count, seed=0):
    """Yield poses of board and plate beside and above each other by up to 1 um, and their distance."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        beside, above = rng.uniform(-1e-6, 1e-6, 2)
        turn = Rotation.random(random_state=number).as_matrix()
        offset = np.array([rng.uniform(-1, 1), -(BOARD[1] + PLATE[1]) / 2 - beside, (BOARD[2] + PLATE[2]) / 2 + above])
        at = rng.uniform(-3, 3, 3)
        outside = np.maximum([beside, above], 0.0)
        distance = float(np.linalg.norm(outside)) if outside.any() else max(beside, above)
        yield Pose(at + turn @ offset, turn), Pose(at, turn), distance


def convex(size):
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    faces = ConvexHull(corners).simplices
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(corners))
    mesh.addVertices(corners)
    mesh.addTriangles(faces)
    mesh.endModel()
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex


@pytest.mark.parametrize("shape", [lambda size: coal.Box(*size), convex])
def test_the_depth_of_bodies_edge_to_edge_is_right(shape):
    first, second = shape(BOARD), shape(PLATE)
    for one, other, distance in edge_to_edge(4000):
        at, to = (coal.Transform3s(pose.rotation, pose.position) for pose in (one, other))
        assert measured(first, at, second, to).min_distance == pytest.approx(distance, abs=3e-6)


def carried_edge_to_edge(one, other):
    """Return a world in which the tool holds the board where it may touch the plate."""
    chain = Chain(kr120())
    board = SceneObject("board", "box", BOARD, link="tool0", touch=("plate",))
    plate = SceneObject("plate", "box", PLATE)
    tool = chain.forward(HOME)
    held = relative(tool, Pose(tool.position, tool.rotation))
    base_T_board = product(tool, held)
    base_T_plate = product(base_T_board, relative(one, other))
    return CollisionWorld(
        kr120(), Scene((board.moved(held, "tool0", ("plate",)), plate.moved(base_T_plate))), kr120_pairs()
    )


def test_a_board_on_the_edge_of_a_plate_is_not_infinitely_deep_in_it():
    for one, other, distance in edge_to_edge(300, 1):
        world = carried_edge_to_edge(one, other)
        found, _ = world.touching_world().clearance_of(HOME[None])
        assert found.distance == pytest.approx(distance, abs=3e-6)
        assert world.touching_world().clearance(HOME).distance == pytest.approx(distance, abs=3e-6)
        assert world.distance(HOME, "board", "plate") == pytest.approx(distance, abs=3e-6)


def test_what_coal_cannot_measure_is_measured_beside_there():
    # one of the few pairs for which Coal fails with the narrow tolerance too: two corners that just touch
    shapes = (
        convex([0.007768880223853797, 0.008804500027150953, 0.05985008562756316]),
        coal.Transform3s(
            np.array(
                [
                    [-0.4885407534518996, 0.21921284526221002, -0.8445553035110823],
                    [-0.7095161971290034, 0.4635646951848454, 0.5307490361647191],
                    [0.5078530281767033, 0.8585182012340957, -0.07093518112703262],
                ]
            ),
            np.array([-2.13690352191362, 2.641046464085269, -2.25108516493162]),
        ),
        convex([0.005349839936059479, 0.005503859570342727, 0.02234008050050087]),
        coal.Transform3s(
            np.array(
                [
                    [-0.488540753452109, 0.21921284526355125, -0.844555303510613],
                    [-0.7095161971283852, 0.463564695184825, 0.5307490361655632],
                    [0.5078530281773654, 0.8585182012337643, -0.07093518112630359],
                ]
            ),
            np.array([-2.173246818854529, 2.661520092761119, -2.2445270676392357]),
        ),
    )
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-8
    assert coal.distance(*shapes, request, coal.DistanceResult()) <= UNKNOWN
    assert measured(*shapes).min_distance == pytest.approx(0.0, abs=3e-6)
