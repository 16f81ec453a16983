"""COLLADA 1.4.1 files of one closed mesh each, with smooth normals where a surface bends and sharp ones at its edges.

Metres, z up. Positions stay shared between triangles, so that a reader finds the mesh closed.
The colour stands in the file as well as in the URDF: rviz takes it from here.
Format: The Khronos Group, COLLADA 1.4.1 specification, section 5.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from construction_twin.core.errors import ConfigurationError

#: Decimals of positions [m] and of normals.
DECIMALS, NORMAL_DECIMALS = 5, 3
#: Faces that meet at a smaller angle are one smooth surface [deg].
CREASE = 32.0
_NAMESPACE = "{http://www.collada.org/2005/11/COLLADASchema}"


def canonical(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a mesh on the file's grid and in an order that depends on the mesh alone.

    Vertices that become equal are one, and triangles that lose their area go; sorted by coordinates.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers

    Returns:
        vertices: Shape (w, 3)
        triangles: Shape (u, 3), integers
    """
    rounded = np.round(np.asarray(vertices, dtype=float), DECIMALS) + 0.0
    points, merged = np.unique(rounded, axis=0, return_inverse=True)
    faces = merged.reshape(-1)[np.asarray(triangles)]
    first, second, third = faces.T
    faces = faces[(first != second) & (second != third) & (third != first)]
    turn = np.argmin(faces, axis=1)
    faces = np.stack([faces[np.arange(len(faces)), (turn + shift) % 3] for shift in range(3)], axis=1)
    faces = faces[np.lexsort(faces.T[::-1])]
    used, faces = np.unique(faces, return_inverse=True)
    return points[used], faces.reshape(-1, 3)


def corner_normals(vertices: np.ndarray, triangles: np.ndarray, crease_deg: float = CREASE) -> np.ndarray:
    """Return a unit normal for every corner of every triangle, shape (t, 3, 3).

    It is the mean, by area, over the faces around the corner's vertex that meet the corner's own face below the crease angle.
    """
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    unit = cross / np.maximum(length, 1e-30)
    corners = triangles.ravel()
    order = np.argsort(corners, kind="stable")
    starts = np.searchsorted(corners[order], np.arange(len(vertices) + 1))
    limit = np.cos(np.radians(crease_deg))
    normals = np.empty((len(triangles) * 3, 3))
    for vertex in range(len(vertices)):
        here = order[starts[vertex] : starts[vertex + 1]]
        faces = here // 3
        together = unit[faces] @ unit[faces].T >= limit
        total = together @ cross[faces]
        size = np.linalg.norm(total, axis=1, keepdims=True)
        normals[here] = np.where(size > 1e-30, total / np.maximum(size, 1e-30), unit[faces])
    return normals.reshape(-1, 3, 3)


def to_collada(name: str, vertices: np.ndarray, triangles: np.ndarray, colour: tuple[float, float, float]) -> str:
    """Return the file's text: same mesh, same text.

    Args:
        name: Of the geometry.
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers. Counter-clockwise seen from outside.
        colour: Length 3. Red, green, blue, 0 to 1.
    """
    vertices, triangles = canonical(vertices, triangles)
    corners = np.round(corner_normals(vertices, triangles), NORMAL_DECIMALS) + 0.0
    normals, which = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    pairs = np.stack([triangles.reshape(-1), which.reshape(-1)], axis=1)
    return _TEMPLATE.format(
        name=name,
        colour=" ".join(f"{fraction:g}" for fraction in (*colour, 1.0)),
        positions=_source(f"{name}-positions", vertices, DECIMALS),
        normals=_source(f"{name}-normals", normals, NORMAL_DECIMALS),
        count=len(triangles),
        indices=" ".join(map(str, pairs.ravel().tolist())),
    )


def from_collada(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Read back what `to_collada` wrote.

    Returns:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers

    Raises:
        ConfigurationError: If the text is not such a file.
    """
    try:
        mesh = ElementTree.fromstring(text).find(f".//{_NAMESPACE}mesh")
        positions = mesh.find(f"{_NAMESPACE}source/{_NAMESPACE}float_array").text.split()
        indices = mesh.find(f"{_NAMESPACE}triangles/{_NAMESPACE}p").text.split()
    except (ElementTree.ParseError, AttributeError) as error:
        raise ConfigurationError("mesh", str(error), "a COLLADA file of this package") from error
    return np.array(positions, dtype=float).reshape(-1, 3), np.array(indices, dtype=int).reshape(-1, 3, 2)[:, :, 0]


def _number(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _source(name: str, rows: np.ndarray, decimals: int) -> str:
    values = " ".join(_number(value, decimals) for value in rows.ravel().tolist())
    return _SOURCE.format(name=name, size=rows.size, rows=len(rows), values=values)


_SOURCE = """\
<source id="{name}">
<float_array id="{name}-array" count="{size}">{values}</float_array>
<technique_common><accessor source="#{name}-array" count="{rows}" stride="3"><param name="X" type="float"/>\
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
</source>"""

_TEMPLATE = """\
<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2026-01-01T00:00:00Z</created>\
<modified>2026-01-01T00:00:00Z</modified><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="paint-effect"><profile_COMMON><technique sid="common"><phong>
<ambient><color>{colour}</color></ambient><diffuse><color>{colour}</color></diffuse>\
<specular><color>0.12 0.12 0.12 1</color></specular><shininess><float>18</float></shininess>
</phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="paint"><instance_effect url="#paint-effect"/></material></library_materials>
<library_geometries><geometry id="{name}" name="{name}"><mesh>
{positions}
{normals}
<vertices id="{name}-vertices"><input semantic="POSITION" source="#{name}-positions"/></vertices>
<triangles material="paint" count="{count}"><input semantic="VERTEX" source="#{name}-vertices" offset="0"/>\
<input semantic="NORMAL" source="#{name}-normals" offset="1"/>
<p>{indices}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="node-{name}">\
<instance_geometry url="#{name}"><bind_material><technique_common>\
<instance_material symbol="paint" target="#paint"/></technique_common></bind_material></instance_geometry></node>\
</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>
"""
