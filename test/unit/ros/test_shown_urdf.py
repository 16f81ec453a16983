"""What the page gets of a robot's URDF: shapes to be shown, and their meshes by digest."""

from __future__ import annotations

import hashlib
from xml.etree import ElementTree

import numpy as np

from construction_twin.ros.shared.private_files import shown_urdf
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
    shown = shown_urdf(urdf, "/private/mesh/")
    link = ElementTree.fromstring(shown.text).find("link")
    assert [tag.tag for tag in link] == ["visual", "visual"] and shown.problems == ()
    assert link.find("visual/geometry/mesh").get("filename") == f"/private/mesh/{name}"
    assert shown.meshes == {name: mesh.read_bytes()}
