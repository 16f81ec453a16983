"""Triangles from STL and OBJ files, read strictly: what Coal builds from them is safe only when every number is checked.

Vertices in the file's own unit; a scale makes them metres.
"""

from __future__ import annotations

import re

import numpy as np

from construction_twin.core.motion_errors import SceneError

#: Most triangles: far beyond what a collision shape needs, and still checked and built within seconds.
MOST_TRIANGLES = 100_000
#: Smallest and largest size of a mesh after scaling, and how far away from its origin it may be [m]: beyond, its unit or
#: its scale is wrong.
SMALLEST, LARGEST = 1e-4, 1e4
#: Below this fraction of its size squared a triangle has no area.
_FLAT = 1e-12
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(r"^[ \t]*vertex[ \t]+(.*?)[ \t]*$", re.MULTILINE)


def parse_mesh(
    where: str, path: str, contents: bytes, scale: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Read the triangles of a mesh file.

    Args:
        where: What the mesh is, for messages.
        path: The file's name; its ending says which format it is.
        scale: Factors for x, y and z that make metres.

    Returns:
        Vertices, shape (v, 3) [m], all finite, and triangles, shape (t, 3), at least one with an area.
    """
    try:
        vertices, triangles = _obj(contents) if path.lower().endswith(".obj") else _stl(contents)
    except (ValueError, IndexError, OverflowError) as error:
        raise SceneError(where, path, f"a well-formed STL or OBJ file with finite numbers ({error})") from error
    if not 0 < len(triangles) <= MOST_TRIANGLES:
        found = f"{path} with {len(triangles)} triangles"
        raise SceneError(where, found, f"1 to {MOST_TRIANGLES} triangles; simplify or repair the mesh")
    _check(where, path, vertices, triangles, scale)
    return vertices * scale, triangles


def binary_stl(corners: np.ndarray) -> bytes:
    """Return the contents of a binary STL file.

    `corners`: Shape (t, 3, 3). Of each triangle [m], counterclockwise seen from outside.
    """
    triangles = np.zeros(len(corners), _STL_TRIANGLE)
    triangles["corners"] = corners
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return bytes(80) + len(corners).to_bytes(4, "little") + triangles.tobytes()


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


def _stl(contents: bytes) -> tuple[np.ndarray, np.ndarray]:
    # a binary file may begin with the word solid, too: its length tells
    count = int.from_bytes(contents[80:84], "little")
    if len(contents) >= 84 and len(contents) == 84 + count * _STL_TRIANGLE.itemsize:
        corners = np.frombuffer(contents, _STL_TRIANGLE, count, 84)["corners"].astype(float).reshape(-1, 3)
    else:
        text = contents.decode("ascii")
        if not text.lstrip().lower().startswith("solid"):
            raise ValueError("neither a binary STL of its length nor a text that begins with solid")
        numbers = [line.split() for line in _VERTEX.findall(text.lower())]
        corners = np.array([_numbers(line, 3) for line in numbers]).reshape(-1, 3)
        if len(corners) % 3 or text.lower().count("endfacet") * 3 != len(corners):
            raise ValueError(f"{len(corners)} vertices; expected three for each facet")
    vertices, triangles = np.unique(corners, axis=0, return_inverse=True)
    return vertices, triangles.reshape(-1, 3)


def _obj(contents: bytes) -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = [], []
    for number, line in enumerate(contents.decode("utf-8").replace("\\\n", " ").splitlines(), 1):
        kind, *words = line.split("#", 1)[0].split() or [""]
        try:
            if kind == "v":
                # what follows x y z is a weight or a colour
                vertices.append(_numbers(words[:3], 3))
            elif kind == "f":
                corners = [int(word.split("/", 1)[0]) for word in words]
                if len(corners) < 3 or 0 in corners:
                    raise ValueError("a face needs three vertices or more, counted from 1")
                # negative: counted back from the vertices so far
                corners = [corner - 1 if corner > 0 else len(vertices) + corner for corner in corners]
                triangles += [(corners[0], *pair) for pair in zip(corners[1:], corners[2:])]
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
    return np.array(vertices, dtype=float).reshape(-1, 3), np.array(triangles, dtype=int).reshape(-1, 3)


def _numbers(words: list[str], count: int) -> list[float]:
    if len(words) != count:
        raise ValueError(f"{len(words)} numbers; expected {count}")
    return [float(word) for word in words]
