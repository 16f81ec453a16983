"""What the page gets of a robot's URDF: shapes to be shown, and their meshes by digest."""

from __future__ import annotations

import hashlib
from xml.etree import ElementTree

import numpy as np

from construction_twin.extensions.console.private_files import PrivateFiles
from construction_twin.scene.mesh_file import binary_stl

CORNERS = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=float)


def test_a_urdf_names_its_meshes_by_digest_and_has_no_collision_shapes(tmp_path):
    mesh = tmp_path / "arm.STL"
    mesh.write_bytes(binary_stl(CORNERS))
    shape = f'<geometry><mesh filename="file://{mesh}"/></geometry>'
    box = '<geometry><box size="1 1 1"/></geometry>'
    shapes = f"<visual>{shape}</visual><visual>{box}</visual><collision>{shape}</collision>"
    urdf = f'<?xml version="1.0" encoding="utf-8"?><robot name="r"><link name="a">{shapes}</link></robot>'
    name = hashlib.sha256(mesh.read_bytes()).hexdigest() + ".stl"
    assert PrivateFiles(tmp_path / "private", "r").write_robot(urdf) == ()
    link = ElementTree.fromstring((tmp_path / "private/r/robot.urdf").read_text()).find("link")
    assert [tag.tag for tag in link] == ["visual", "visual"]
    assert link.find("visual/geometry/mesh").get("filename") == f"../mesh/{name}"
    assert (tmp_path / "private/mesh" / name).read_bytes() == mesh.read_bytes()
