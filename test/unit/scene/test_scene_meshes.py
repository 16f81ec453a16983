"""scene.mesh_file and what bodies are made of it: every number is checked before Coal sees it."""

from __future__ import annotations

import os
import struct
from dataclasses import replace

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import FLOOR, box_triangles, bracket_triangles, kr120, kr120_pairs, write_obj, write_stl

from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene import mesh_file
from construction_twin.scene.collision_bodies import scene_geometry
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import Scene, SceneObject

ONE = (1.0, 1.0, 1.0)
BOX = box_triangles((0.2, 0.3, 0.4))


def parsed(path: str, contents: str | bytes, scale=ONE):
    return parse_mesh("object 'part' mesh", path, contents.encode() if isinstance(contents, str) else contents, scale)


def binary_stl(triangles: np.ndarray, header: bytes = b"solid but binary") -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *corners.ravel(), 0) for corners in triangles)
    return header.ljust(80) + struct.pack("<I", len(triangles)) + rows


def corners_of(path: str, contents, scale=ONE) -> np.ndarray:
    vertices, triangles = parsed(path, contents, scale)
    return vertices[triangles]


def test_the_formats_hold_the_same_triangles(tmp_path):
    for triangles in (BOX, bracket_triangles()):
        texts = [
            ("a.stl", open(write_stl(tmp_path / "a.stl", triangles), "rb").read()),
            ("a.STL", binary_stl(triangles)),
            ("a.obj", open(write_obj(tmp_path / "a.obj", triangles), "rb").read()),
        ]
        for name, contents in texts:
            np.testing.assert_allclose(corners_of(name, contents), triangles, atol=1e-7)
            np.testing.assert_allclose(corners_of(name, contents, (2.0, 1.0, 0.5)), triangles * (2, 1, 0.5), atol=1e-7)


def test_an_obj_file_may_have_polygons_normals_colours_and_count_backwards():
    text = "# a square\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nvn 0 0 1\nv 0 1 0\nusemtl red\nf 1/1/1 2//1 3 \\\n 4\nf -4 -3 -2\n"
    np.testing.assert_array_equal(parsed("a.obj", text)[1], [[0, 1, 2], [2, 3, 0], [0, 1, 2]])


def test_indices_of_an_obj_file_count_back_from_their_line():
    block = "v {0} 0 0\nv {0} 1 0\nv {0} 0 1\nvt 0 0\n f -3/-1 -2/-1 -1/-1  # a corner\n"
    text = "o one\n" + block.format(0) + "o two\n" + block.format(1)
    assert corners_of("a.obj", text)[:, :, 0].tolist() == [[0, 0, 0], [1, 1, 1]]


def test_of_an_stl_text_every_solid_is_read_or_it_is_refused(tmp_path):
    text = open(write_stl(tmp_path / "a.stl", BOX)).read()
    assert len(corners_of("a.stl", text + text)) == 24
    odd = "\ufeff" + text.replace("solid", "solid part of a solid").replace("endloop\n", "endloop ").upper()
    assert len(corners_of("a.stl", odd)) == 12
    for cut in (text.rindex("endsolid"), text.rindex("vertex")):
        with pytest.raises(SceneError, match="well-formed.*times end"):
            parsed("a.stl", text + text[:cut])


@pytest.mark.parametrize(
    "name, text, said",
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "vertex 2 at"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1e999 0\nf 1 2 3\n", "finite"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1\nf 1 2 3\n", "well-formed"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "well-formed"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "well-formed"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "counted from 1"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "1 to 100000 triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "with an area"),
        ("a.obj", "v 0 0 0\nv 1e-9 0 0\nv 0 1e-9 0\nf 1 2 3\n", "unit and the scale"),
        ("a.obj", "v 0 0 0\nv 1e200 0 0\nv 0 1e200 0\nf 1 2 3\n", "unit and the scale"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "1 to 100000 triangles"),
        ("a.obj", "", "1 to 100000 triangles"),
        ("a.stl", "", "1 to 100000 triangles"),
        ("a.stl", "solid\nvertex 1 2 3\n", "1 times solid and 0 times endsolid"),
        (
            "a.stl",
            "solid\nfacet normal 0 0 0\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 x 0\nendfacet\nendsolid\n",
            "expected",
        ),
        (
            "a.stl",
            "solid\nfacet normal 0 0 0\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 nan 0\nendfacet\nendsolid\n",
            "expected",
        ),
        ("a.stl", binary_stl(np.full((1, 3, 3), np.nan)), "finite"),
        ("a.stl", binary_stl(BOX)[:-1], "well-formed"),
        ("a.stl", b"\x00" * 84, "1 to 100000 triangles"),
    ],
)
def test_what_no_shape_can_be_made_of_is_refused(name, text, said):
    with pytest.raises(SceneError, match=said) as caught:
        parsed(name, text)
    assert name in str(caught.value) and "object 'part' mesh" in caught.value.where


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    vertex=st.integers(0, 7), axis=st.integers(0, 2), value=st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e200])
)
def test_one_wild_number_never_reaches_coal(vertex, axis, value, tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "wild.obj"
    lines = open(write_obj(path, BOX)).read().splitlines()
    words = lines[vertex].split()
    words[1 + axis] = repr(value)
    path.write_text("\n".join([*lines[:vertex], " ".join(words), *lines[vertex + 1 :], ""]))
    part = SceneObject("part", "mesh", mesh=str(path))
    with pytest.raises(SceneError, match="wild.obj"):
        CollisionWorld(kr120(), Scene((FLOOR, part)), kr120_pairs())


def test_too_many_triangles_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(mesh_file, "MOST_TRIANGLES", 11)
    with pytest.raises(SceneError, match="with 12 triangles.*1 to 11"):
        scene_geometry(SceneObject("part", "mesh", mesh=write_obj(tmp_path / "a.obj", BOX)))


def test_a_closed_mesh_without_a_volume_is_said_in_our_words(monkeypatch, tmp_path):
    part = SceneObject("part", "mesh", mesh=write_obj(tmp_path / "a.obj", BOX))

    def fail(self, keep, flags):
        raise RuntimeError("From file: /project/src/qhull.cpp line 3")

    monkeypatch.setattr(coal.BVHModelOBBRSS, "buildConvexHull", fail)
    with pytest.raises(SceneError, match="a closed convex mesh that has a volume") as caught:
        scene_geometry(part)
    assert "/project" not in str(caught.value)


def test_a_flat_plate_is_a_surface(tmp_path):
    plate = SceneObject("plate", "mesh", (1.0, 1.0, 1e-9), mesh=write_obj(tmp_path / "a.obj", box_triangles((1, 1, 1))))
    assert CollisionWorld(kr120(), Scene((plate,)), kr120_pairs()).clearance(kr120().home).distance < 1.0


def test_a_pipe_and_a_device_are_no_mesh_files(tmp_path):
    pipe = tmp_path / "pipe.stl"
    os.mkfifo(pipe)
    device = tmp_path / "zero.obj"
    device.symlink_to("/dev/zero")
    for path in (pipe, device, tmp_path):
        with pytest.raises(SceneError):
            SceneObject("part", "mesh", mesh=str(path))


def test_a_mesh_that_changed_is_another_one(tmp_path):
    path = tmp_path / "a.obj"
    part = SceneObject("part", "mesh", mesh=write_obj(path, BOX))
    write_obj(path, 2 * BOX)
    with pytest.raises(SceneError, match="has changed"):
        scene_geometry(part)


@pytest.mark.parametrize("change", [{"size": (1e300, 1.0, 1.0)}, {"position": (1e300, 0.0, 0.0)}, {"padding": 1e300}])
def test_numbers_that_overflow_are_refused(change):
    with pytest.raises(SceneError, match="at most 10000"):
        replace(FLOOR, **change)
