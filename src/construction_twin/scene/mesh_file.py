"""Triangles from STL, OBJ and GLB files, by trimesh: what Coal builds from them is safe only when every number is checked."""

from __future__ import annotations

import io
import re
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from construction_twin.robot.motion_errors import SceneError

if TYPE_CHECKING:
    import coal

#: Most triangles: far beyond what a collision shape needs, and still checked and built within seconds.
MOST_TRIANGLES = 100_000
#: Smallest and largest size of a mesh after scaling, and how far away from its origin it may be [m]: beyond, its unit or
#: its scale is wrong.
SMALLEST, LARGEST = 1e-4, 1e4
#: Below this fraction of its size squared a triangle has no area.
_FLAT = 1e-12


def parse_mesh(
    where: str, path: str, contents: bytes, scale: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Read the triangles of a mesh file, whose ending says which format it is; `scale` makes metres.

    Returns:
        Vertices, shape (v, 3) [m], all finite, and triangles, shape (t, 3), at least one with an area.
    """
    import trimesh  # loaded here: few scenes have a mesh  # noqa: PLC0415

    kind = ending if (ending := path.lower().rpartition(".")[2]) in ("obj", "glb") else "stl"
    try:
        if kind == "obj":
            contents = _absolute(contents)
        elif kind == "stl":
            _check_whole(contents)
        mesh = trimesh.load_mesh(io.BytesIO(contents), file_type=kind, process=False, skip_materials=True)
        vertices, triangles = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=int)
        if vertices.shape[1:] != (3,):
            raise ValueError("vertices without three numbers")
    except Exception as error:  # whatever the reader meets in a file
        raise SceneError(where, path, f"a well-formed {kind.upper()} file ({error})") from error
    if kind == "stl":
        # it repeats the corners of each triangle
        vertices, merged = np.unique(vertices, axis=0, return_inverse=True)
        triangles = merged.reshape(-1)[triangles]
    if not 0 < len(triangles) <= MOST_TRIANGLES:
        found = f"{path} with {len(triangles)} triangles"
        raise SceneError(where, found, f"1 to {MOST_TRIANGLES} triangles; simplify or repair the mesh")
    _check(where, path, vertices, triangles, scale)
    return vertices * scale, triangles


def _absolute(contents: bytes) -> bytes:
    """Return the vertices and faces of an OBJ file, counted from its first vertex: trimesh counts back from its last one."""
    count, lines = 0, []
    for line in contents.replace(b"\r\n", b"\n").replace(b"\\\n", b" ").splitlines():
        kind, *words = line.split(b"#")[0].split() or [b""]
        if kind == b"v":
            count += 1
        elif kind == b"f":
            corners = [int(word.split(b"/")[0]) for word in words]
            indices = [count + 1 + index if index < 0 else index for index in corners]
            if min(indices, default=1) < 1:
                raise ValueError(f"a face of {corners} after {count} vertices, which are counted from 1")
            words = [b"%d" % index for index in indices]
        else:
            continue
        lines.append(b" ".join((kind, *words)))
    return b"\n".join((*lines, b""))


def _check_whole(contents: bytes) -> None:
    """Refuse an STL text that was cut: trimesh drops what has no end."""
    if len(contents) == 84 + 50 * int.from_bytes(contents[80:84], "little"):
        return
    # without the names of its solids
    text = re.sub(
        r"^(\s*(?:end)?solid\b).*", r"\1", contents.decode("utf-8-sig", "replace").lower(), flags=re.MULTILINE
    )
    count = Counter(re.findall(r"[a-z]+", text))
    for word in ("solid", "facet"):
        if count[word] != count[f"end{word}"]:
            raise ValueError(f"{count[word]} times {word} and {count[f'end{word}']} times end{word}")


def binary_stl(corners: np.ndarray) -> bytes:
    """Return a binary STL file of triangles, shape (t, 3, 3) [m], counterclockwise seen from outside."""
    import trimesh  # noqa: PLC0415

    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return bytes(trimesh.exchange.stl.export_stl(trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)))


def _check(where: str, path: str, vertices: np.ndarray, triangles: np.ndarray, scale: tuple) -> None:
    wrong = np.argwhere(~np.isfinite(vertices).all(axis=1))
    if len(wrong):
        row = int(wrong[0, 0])
        raise SceneError(where, f"{path} with vertex {row} at {vertices[row].tolist()}", "finite numbers everywhere")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        expected = f"triangles of its {len(vertices)} vertices; one names a vertex that is not there"
        raise SceneError(where, path, expected)
    with np.errstate(over="ignore"):
        corners = vertices[triangles] * scale
    size, far = np.ptp(corners, axis=(0, 1)).max(), np.abs(corners).max()
    if not (size >= SMALLEST and far <= LARGEST):
        found = f"{path}, {size:.6g} m large and up to {far:.6g} m from its origin after scaling"
        raise SceneError(where, found, f"a size of {SMALLEST:g} to {LARGEST:g} m; check the unit and the scale")
    sides = corners[:, 1:] - corners[:, :1]
    if not (np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) > _FLAT * size**2).any():
        raise SceneError(where, path, "at least one triangle with an area")


def surface(vertices: np.ndarray, triangles: np.ndarray) -> coal.BVHModelOBBRSS:
    """Return triangles as a surface without an inside: vertices, shape (v, 3), and three of them for each, shape (t, 3)."""
    import coal  # loaded here: readers of files need it not  # noqa: PLC0415

    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(triangles, dtype=np.int32))
    mesh.endModel()
    return mesh
