"""Convex hulls in place of a robot's collision meshes: a proposal for a person, with the volume that each hull adds.

A hull is closed, solid and quick to check, and it encloses its mesh; but it also fills hollows, which the arm then cannot use.
Nothing is replaced here: the proposal is a URDF of its own beside the meshes that it names. Metres; volumes in m^3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from construction_twin.core.errors import ConfigurationError
from construction_twin.scene.collision_bodies import RobotBodies, is_convex, mesh_triangles
from construction_twin.scene.mesh_file import binary_stl
from construction_twin.scene.solids import parts, solid, union
from construction_twin.scene.triangle_mesh import hull_mesh


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of one collision mesh.

    Attributes:
        number: Which collision element of the link, from 0.
        triangles: Of the mesh.
        volume: Of the mesh [m^3]; None: it is not closed, so that it has none.
        vertices: Shape (v, 3). Of the hull, in the frame of the collision element [m].
        faces: Shape (t, 3), integers. Of the hull, counterclockwise seen from outside.
        hull_volume: [m^3]
    """

    link: str
    number: int
    triangles: int
    volume: float | None
    vertices: np.ndarray
    faces: np.ndarray
    hull_volume: float


def mesh_hulls(bodies: RobotBodies) -> list[Hull]:
    """Return the hull of every collision mesh that is not convex itself, in the order of the links."""
    hulls = []
    numbers: dict[str, int] = {}
    for body in bodies.bodies:
        number = numbers.get(body.link, 0)
        numbers[body.link] = number + 1
        if not isinstance(body.geometry, coal.BVHModelBase):
            continue
        vertices, triangles = mesh_triangles(body.geometry)
        if is_convex(vertices, triangles):
            continue
        try:
            # of the numbers that an STL file can hold: rounded later, the faces would no longer be those of a convex body
            hull = ConvexHull(vertices.astype(np.float32).astype(float))
        except QhullError as error:
            raise ConfigurationError(
                f"URDF link {body.link} collision mesh", f"{len(triangles)} triangles in one plane",
                "a mesh that has a volume; mend it, or have no hulls proposed",
            ) from error  # fmt: skip
        closed = solid(vertices, triangles)
        # closed surfaces that reach into each other count once
        volume = None if closed is None else float(union(parts(closed)).volume())
        corners, faces = hull_mesh(hull)
        hulls.append(Hull(body.link, number, len(triangles), volume, corners, faces, float(hull.volume)))
    return hulls


def hull_file(hull: Hull) -> str:
    """Return the name of the file of a hull's mesh."""
    return f"{hull.link}_{hull.number}.stl"


def urdf_with_hulls(urdf: str, hulls: Sequence[Hull], folder: Path) -> str:
    """Return a URDF with hulls in place of the meshes.

    Args:
        folder: Where their meshes lie: absolute.
    """
    root = ElementTree.fromstring(urdf.encode())
    links = {link.get("name"): link for link in root.iter("link")}
    for hull in hulls:
        geometry = links[hull.link].findall("collision")[hull.number].find("geometry")
        assert geometry is not None
        mesh = geometry.find("mesh")
        assert mesh is not None
        # the hull is in metres: a scale was applied
        mesh.attrib = {"filename": f"file://{folder / hull_file(hull)}"}
    note = "<!-- A proposal by `rosrun construction_twin self_collision`: convex hulls in place of the collision meshes. -->"
    return f'<?xml version="1.0"?>\n{note}\n{ElementTree.tostring(root, encoding="unicode")}\n'


def write_proposal(urdf: str, hulls: Sequence[Hull], folder: Path) -> Path:
    """Write the meshes of the hulls and the URDF that names them into a folder; return the URDF's path.

    Raises OSError.
    """
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    for hull in hulls:
        (folder / hull_file(hull)).write_bytes(binary_stl(hull.vertices[hull.faces]))
    path = folder / "robot.urdf"
    path.write_text(urdf_with_hulls(urdf, hulls, folder), encoding="utf-8")
    return path


def hull_lines(hulls: Sequence[Hull]) -> list[str]:
    """Return a table of the hulls for a terminal: volumes in litres."""
    width = max(len("link"), *(len(hull.link) for hull in hulls))
    lines = [f"{'link':<{width}}  {'triangles':>17}  {'mesh':>9}  {'hull':>9}  added"]
    for hull in hulls:
        lines.append(
            f"{hull.link:<{width}}  {hull.triangles:>7} -> {len(hull.faces):>6}  {_litres(hull.volume):>9}  "
            f"{_litres(hull.hull_volume):>9}  {_added(hull)}"
        )
    return lines


def _added(hull: Hull) -> str:
    if hull.volume is None:
        return "unknown: the mesh is not closed"
    added = hull.hull_volume - hull.volume
    return f"{_litres(added)} ({100 * added / hull.volume:.0f} %)"


def _litres(volume: float | None) -> str:
    return "?" if volume is None else f"{volume * 1e3:.2f} l"
