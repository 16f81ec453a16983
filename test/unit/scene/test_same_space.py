"""Which objects fill the same space."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from construction_twin.kinematics.chain import Pose
from construction_twin.scene.mesh_file import binary_stl
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.same_space import fills_same_space

SLACK = 1e-3
HERE = Pose(np.array([0.3, -0.2, 1.0]), Rotation.from_rotvec([0.3, -0.4, 0.5]).as_matrix())


def turned(axis, angle, by=(0.0, 0.0, 0.0)):
    """Return `HERE` after a turn about its own axis and a step in the world."""
    turn = Rotation.from_rotvec(angle * np.array(axis, dtype=float)).as_matrix()
    return Pose(HERE.position + by, HERE.rotation @ turn)


@pytest.mark.parametrize(
    ("size", "axis", "angle", "same"),
    [
        ((1.0, 2.0, 3.0), (0, 0, 1), math.pi, True),
        ((1.0, 2.0, 3.0), (1, 0, 0), math.pi, True),
        ((1.0, 2.0, 3.0), (0, 0, 1), math.pi / 2, False),
        ((1.0, 1.0, 3.0), (0, 0, 1), math.pi / 2, True),
        ((1.0, 1.0, 3.0), (1, 0, 0), math.pi / 2, False),
        ((1.0, 1.0, 3.0), (0, 0, 1), 0.01, False),
    ],
)
def test_a_box_fills_the_same_space_after_the_turns_that_map_it_onto_itself(size, axis, angle, same):
    box = SceneObject("box", "box", size)
    assert fills_same_space(box, HERE, box, turned(axis, angle), SLACK) is same


@given(st.floats(-3.0, 3.0), st.sampled_from([0.0, math.pi]))
def test_round_bodies_may_be_turned_about_their_axes(about, over):
    rod, ball = SceneObject("rod", "cylinder", (0.1, 1.0)), SceneObject("ball", "sphere", (0.1,))
    around = turned((0, 0, 1), about)
    over_too = Pose(around.position, around.rotation @ Rotation.from_rotvec([over, 0, 0]).as_matrix())
    assert fills_same_space(rod, HERE, rod, over_too, SLACK)
    assert fills_same_space(ball, HERE, ball, turned((0.6, 0.8, 0), about), SLACK)


def test_what_is_elsewhere_or_another_body_does_not():
    box, rod = SceneObject("box", "box", (0.2, 0.2, 1.0)), SceneObject("rod", "cylinder", (0.1, 1.0))
    assert not fills_same_space(box, HERE, box, turned((0, 0, 1), 0.0, (0.0, 0.002, 0.0)), SLACK)
    assert fills_same_space(box, HERE, box, turned((0, 0, 1), 0.0, (0.0, 0.0005, 0.0)), SLACK)
    assert not fills_same_space(box, HERE, rod, HERE, SLACK)
    assert not fills_same_space(rod, HERE, SceneObject("rod", "cylinder", (0.11, 1.0)), HERE, SLACK)
    assert not fills_same_space(rod, HERE, rod, turned((1, 0, 0), math.pi / 2), SLACK)
    # its corners are some of the other's, but not the other way round
    assert not fills_same_space(SceneObject("half", "box", (0.2, 0.2, 0.5)), HERE, box, HERE, SLACK)


def test_meshes_are_compared_by_their_corners(tmp_path):
    wedge = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
    faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    mirrored = wedge * (-1.0, -1.0, 1.0)
    files = []
    for name, corners in (("one", wedge), ("other", mirrored)):
        path = tmp_path / f"{name}.stl"
        path.write_bytes(binary_stl(corners[faces]))
        files.append(SceneObject(name, "mesh", (1.0, 1.0, 1.0), mesh=str(path)))
    one, other = files
    assert not fills_same_space(one, HERE, other, HERE, SLACK)
    # half a turn about z maps the one piece onto the other
    assert fills_same_space(one, HERE, other, turned((0, 0, 1), math.pi), SLACK)
