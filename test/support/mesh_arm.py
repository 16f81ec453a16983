"""An arm of the proportions of a UR10, with collision meshes of as many triangles as a maker's package has."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scene_samples import write_binary_stl

#: Joint: parent, child, origin [m], axis, range [rad], speed [rad/s].
_TURN = 2 * math.pi
JOINTS = (
    ("pan", "base_link", "shoulder", (0.0, 0.0, 0.13), "0 0 1", _TURN, 2.1),
    ("lift", "shoulder", "upper_arm", (0.0, 0.22, 0.0), "0 1 0", _TURN, 2.1),
    ("elbow", "upper_arm", "forearm", (0.61, -0.17, 0.0), "0 1 0", math.pi, 3.1),
    ("wrist_1", "forearm", "wrist_a", (0.57, 0.0, 0.0), "0 1 0", _TURN, 3.1),
    ("wrist_2", "wrist_a", "wrist_b", (0.0, 0.12, 0.0), "0 0 1", _TURN, 3.1),
    ("wrist_3", "wrist_b", "wrist_c", (0.0, 0.0, 0.12), "0 1 0", _TURN, 3.1),
)
#: Link: outline of its mesh as (from, to, radius) of round tubes [m].
TUBES = {
    "base_link": (((0.0, 0.0, 0.0), (0.0, 0.0, 0.05), 0.095),),
    "shoulder": (((0.0, 0.0, -0.07), (0.0, 0.0, 0.07), 0.08), ((0.0, 0.0, 0.0), (0.0, 0.13, 0.0), 0.075)),
    "upper_arm": (
        ((0.0, -0.08, 0.0), (0.0, 0.08, 0.0), 0.075),
        ((0.0, 0.0, 0.0), (0.61, 0.0, 0.0), 0.055),
        ((0.61, -0.08, 0.0), (0.61, 0.06, 0.0), 0.065),
    ),
    "forearm": (
        ((0.0, -0.06, 0.0), (0.0, 0.06, 0.0), 0.06),
        ((0.0, 0.0, 0.0), (0.57, 0.0, 0.0), 0.045),
        ((0.57, -0.05, 0.0), (0.57, 0.05, 0.0), 0.05),
    ),
    "wrist_a": (((0.0, 0.0, 0.0), (0.0, 0.12, 0.0), 0.045), ((0.0, 0.12, -0.05), (0.0, 0.12, 0.05), 0.045)),
    "wrist_b": (((0.0, 0.0, 0.0), (0.0, 0.0, 0.12), 0.045), ((0.0, -0.05, 0.12), (0.0, 0.05, 0.12), 0.045)),
    "wrist_c": (((0.0, 0.05, 0.0), (0.0, 0.09, 0.0), 0.04),),
}  # fmt: skip


def tube(start, end, radius: float, sides: int, rings: int) -> np.ndarray:
    """Return the triangles of a closed round tube, counterclockwise seen from outside, shape (t, 3, 3) [m]."""
    start, end = np.array(start), np.array(end)
    along = (end - start) / np.linalg.norm(end - start)
    across = np.cross(along, (1.0, 0.0, 0.0) if abs(along[0]) < 0.9 else (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    circle = radius * (np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(along, across))
    levels = [start + (end - start) * part + circle for part in np.linspace(0.0, 1.0, rings + 1)]
    triangles = []
    for low, high in zip(levels, levels[1:]):
        for one in range(sides):
            two = (one + 1) % sides
            triangles += [(low[one], low[two], high[two]), (low[one], high[two], high[one])]
    for one in range(sides):
        two = (one + 1) % sides
        triangles += [(start, levels[0][two], levels[0][one]), (end, levels[-1][one], levels[-1][two])]
    return np.array(triangles)


def write_mesh_arm(folder: Path, sides: int = 24, rings: int = 6) -> Path:
    """Write the arm's meshes and its URDF into a folder; return the URDF's path. A tube has 2 * sides * (rings + 1) triangles."""
    links = []
    for link, tubes in TUBES.items():
        triangles = np.concatenate([tube(*each, sides, rings) for each in tubes])
        path = write_binary_stl(folder / f"{link}.stl", triangles)
        shape = f'<geometry><mesh filename="file://{path}"/></geometry>'
        links.append(f'  <link name="{link}"><visual>{shape}</visual><collision>{shape}</collision></link>')
    joints = [
        f'  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{" ".join(map(str, origin))}"/><axis xyz="{axis}"/>'
        f'<limit lower="{-end}" upper="{end}" velocity="{speed}" effort="100"/></joint>'
        for name, parent, child, origin, axis, end, speed in JOINTS
    ]
    flange = (
        '  <link name="tool0"/>\n  <joint name="flange" type="fixed"><parent link="wrist_c"/><child link="tool0"/>'
        '<origin xyz="0 0.09 0" rpy="-1.5707963267948966 0 0"/></joint>'
    )
    path = folder / "mesh_arm.urdf"
    path.write_text("\n".join(['<robot name="mesh_arm">', *links, *joints, flange, "</robot>", ""]))
    return path
