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
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError
from scipy.stats import qmc

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.scene.collision_bodies import RobotBodies, is_convex, mesh_triangles
from construction_twin.scene.mesh_file import binary_stl
from construction_twin.scene.triangle_mesh import hull_mesh

#: Points by which a volume is estimated where it cannot be calculated, and their seed: a power of 2, as Sobol's sequence asks.
_POINTS, _SEED = 2048, 0


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of one collision mesh.

    Attributes:
        number: Which collision element of the link, from 0.
        triangles: Of the mesh.
        volume: Of the mesh [m^3].
        estimated: Whether the mesh is not one closed surface, so that its volume is an estimate.
        vertices: Shape (v, 3). Of the hull, in the frame of the collision element [m].
        faces: Shape (t, 3), integers. Of the hull, counterclockwise seen from outside.
        hull_volume: [m^3]
    """

    link: str
    number: int
    triangles: int
    volume: float
    estimated: bool
    vertices: np.ndarray
    faces: np.ndarray
    hull_volume: float

    @property
    def added(self) -> float:
        """What the hull has more than the mesh [m^3]."""
        return self.hull_volume - self.volume


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
                Sentence("expected.scene.volume"),
            ) from error  # fmt: skip
        volume = closed_volume(vertices, triangles)
        estimated = volume is None
        if volume is None:
            volume = estimated_volume(vertices, triangles, hull)
        corners, faces = hull_mesh(hull)
        hulls.append(
            Hull(
                body.link,
                number,
                len(triangles),
                volume,
                estimated,
                corners,
                faces,
                float(hull.volume),
            )
        )
    return hulls


def closed_volume(vertices: np.ndarray, triangles: np.ndarray) -> float | None:
    """Return the volume of a mesh that is one closed surface whose triangles look outwards [m^3]; None for any other mesh.

    Several closed surfaces in one mesh may overlap: their volumes cannot be added.

    Args:
        vertices: Shape (v, 3). [m]; equal vertices are one.
        triangles: Shape (t, 3), integers
    """
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forth, rows, uses = np.unique(edges, axis=0, return_index=True, return_counts=True)
    back, columns = np.unique(edges[:, ::-1], axis=0, return_index=True)
    if (uses != 1).any() or not np.array_equal(forth, back):
        return None
    # which triangles have an edge in common; three edges each
    shared = coo_array((np.ones(len(rows)), (rows // 3, columns // 3)), shape=(len(triangles), len(triangles)))
    if connected_components(shared, directed=False)[0] > 1:
        return None
    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    volume = float(np.einsum("ij,ij->", first, np.cross(second, third))) / 6.0
    return volume if volume > 0 else None


def estimated_volume(vertices: np.ndarray, triangles: np.ndarray, hull: ConvexHull) -> float:
    """Return what a mesh of any kind encloses [m^3]: the fraction of the points in its hull around which it winds more than half.

    The solid angle under which a point sees the whole mesh is 4 pi inside of a closed surface and 0 outside; a hole changes it
    little, and bodies that overlap each other count once. The solid angle of a triangle: tan(angle / 2) is its vertices' triple
    product over a sum of products of their lengths and scalar products, with the vertices as seen from the point.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    points = low + (high - low) * qmc.Sobol(3, rng=np.random.default_rng(_SEED)).random(_POINTS)
    points = points[(points @ hull.equations[:, :3].T + hull.equations[:, 3] <= 0).all(axis=1)]
    if not len(points):
        return 0.0
    inside = 0
    for point in points:
        a, b, c = (vertices[triangles[:, corner]] - point for corner in range(3))
        la, lb, lc = (np.sqrt(np.einsum("ij,ij->i", side, side)) for side in (a, b, c))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("ij,ij->i", one, other) for one, other in ((a, b), (b, c), (c, a)))
        angle = 2.0 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum()
        # either way round: some files have their triangles inside out
        inside += abs(angle) > 2.0 * np.pi
    return float(hull.volume) * inside / len(points)


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
    """Return a table of the hulls for a terminal: volumes in litres, and those that add most marked by nothing but their number."""
    width = max(len("link"), *(len(hull.link) for hull in hulls))
    lines = [f"{'link':<{width}}  {'triangles':>17}  {'mesh':>9}  {'hull':>9}  added"]
    for hull in hulls:
        about = "~" if hull.estimated else ""
        fraction = f"{100 * hull.added / hull.volume:.0f} %" if hull.volume > 0 else "all of it"
        lines.append(
            f"{hull.link:<{width}}  {hull.triangles:>7} -> {len(hull.faces):>6}  {about + _litres(hull.volume):>9}  "
            f"{_litres(hull.hull_volume):>9}  {about}{_litres(hull.added)} ({fraction})"
        )
    if any(hull.estimated for hull in hulls):
        lines.append("~ the mesh is not one closed surface: its volume is an estimate")
    return lines


def _litres(volume: float) -> str:
    return f"{volume * 1e3:.2f} l"
