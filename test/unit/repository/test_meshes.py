"""urdf/meshes: closed meshes within the collision shapes, and of the stated mass."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from urdf_shapes import contains, numbers, placed

from construction_twin.robot.urdf import expand_xacro

ROOT = Path(__file__).parents[3]
MESHES = ROOT / "urdf" / "meshes"
FILES = sorted(MESHES.glob("*.dae"))
ROBOT = ElementTree.fromstring(expand_xacro(ROOT / "urdf" / "kr120_track.urdf.xacro"))
LINKS = [name for link in ROBOT.iter("link") if list(MESHES.glob(f"{(name := link.get('name'))}_*.dae"))]
#: How far a vertex may lie outside the collision shapes [m].
TOLERANCE = 0.001


def mesh(path: Path) -> trimesh.Trimesh:
    root = ElementTree.parse(path).getroot()
    positions = root.find(".//{*}mesh/{*}source/{*}float_array").text.split()
    indices = root.find(".//{*}mesh/{*}triangles/{*}p").text.split()
    faces = np.array(indices, dtype=int).reshape(-1, 3, 2)[:, :, 0]
    return trimesh.Trimesh(np.array(positions, dtype=float).reshape(-1, 3), faces, process=False)


def link(name: str) -> ElementTree.Element:
    return ROBOT.find(f"link[@name='{name}']")


def link_vertices(name: str) -> np.ndarray:
    return np.concatenate([mesh(path).vertices for path in FILES if path.name.startswith(f"{name}_")])


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_mesh_is_closed_and_small(path):
    solid = mesh(path)
    assert solid.is_watertight and solid.is_winding_consistent
    assert solid.volume > 0
    assert path.stat().st_size < 500_000


@pytest.mark.parametrize("name", LINKS)
def test_the_collision_shapes_enclose_what_is_drawn(name):
    points = link_vertices(name)
    inside = np.zeros(len(points), dtype=bool)
    for shape in link(name).iter("collision"):
        rotation, centre, kind, size = placed(shape)
        larger = size + 2 * TOLERANCE if kind == "box" else size + [TOLERANCE, 2 * TOLERANCE]
        inside |= contains(kind, larger, (points - centre) @ rotation)
    assert inside.all(), points[~inside][:3]


@pytest.mark.parametrize("name", LINKS)
def test_inertias_are_those_of_the_solids(name):
    urdf = link(name).find("inertial")
    mass = float(urdf.find("mass").get("value"))
    solids = [mesh(path) for path in FILES if path.name.startswith(f"{name}_")]
    volume = sum(solid.volume for solid in solids)
    for solid in solids:
        solid.density = mass / volume
    centre = sum(solid.mass * solid.center_mass for solid in solids) / mass
    np.testing.assert_allclose(numbers(urdf.find("origin"), "xyz"), centre, atol=2e-4)
    tensor = np.zeros((3, 3))
    for solid in solids:
        arm_ = solid.center_mass - centre
        tensor += solid.moment_inertia + solid.mass * (arm_ @ arm_ * np.eye(3) - np.outer(arm_, arm_))
    found = {key: float(urdf.find("inertia").get(key)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    keys = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
    found = np.array([[found[key] for key in row] for row in keys])
    np.testing.assert_allclose(found, tensor, atol=2e-4 + 1e-3 * tensor.max())
    moments = np.linalg.eigvalsh(found)
    assert moments[0] > 0 and moments[2] <= moments[0] + moments[1]
