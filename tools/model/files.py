"""The files of urdf/meshes/: one COLLADA file per link and colour, and the links' inertias."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold
from model import arm, track
from model.collada import from_collada, to_collada
from model.mass import Inertia, inertia

from construction_twin.core.errors import ConfigurationError

#: Mass of each link [kg]. Arm: KR 120 R2700-2's public masses, scaled to 1049 kg (docs/rsi.md, section 10). Track: assumed.
MASSES = {
    "link_0": 221.8, "link_1": 356.3, "link_2": 227.7, "link_3": 178.4, "link_4": 41.6, "link_5": 16.7, "link_6": 6.5,
    "track_rail": 900.0, "track_carriage": 400.0,
}  # fmt: skip

#: Red, green, blue of each colour, as in the URDF. Orange: near RAL 2003.
COLOURS = {
    "orange": (1.0, 0.40, 0.05),
    "black": (0.17, 0.17, 0.18),
    "grey": (0.62, 0.63, 0.65),
    "track_grey": (0.30, 0.31, 0.34),
}

_HEADER = """\
# Mass [kg], centre of mass [m] and inertia tensor about it [kg m^2], all in the link's frame. Written by tools/make_meshes.py:
# each link's mass (tools/model/files.py names the source) spread evenly over the solids that are drawn.
"""


def link_parts(link: str) -> arm.Parts:
    """Return a link's solids by colour.

    Raises:
        ConfigurationError: If no such link is drawn.
    """
    links = arm.LINKS | track.LINKS
    if link not in links:
        raise ConfigurationError("link", link, f"one of {sorted(links)}")
    return links[link]()


def link_meshes(link: str) -> dict[str, str]:
    """Return the files of one link: name to text."""
    files = {}
    for colour, solid in link_parts(link).items():
        name = f"{link}_{colour}"
        files[f"{name}.dae"] = to_collada(name, *triangles(solid), COLOURS[colour])
    return files


def triangles(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Return a solid's vertices, shape (v, 3) [m], and triangles, shape (t, 3)."""
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, dtype=int)


def all_files() -> dict[str, str]:
    """Return every file of urdf/meshes/: name to text."""
    files, rows = {}, []
    for link, mass in MASSES.items():
        meshes = link_meshes(link)
        files |= meshes
        rows.append(_row(link, inertia(mass, [from_collada(text) for text in meshes.values()])))
    files["inertias.yaml"] = _HEADER + "\n".join(rows) + "\n"
    return files


def _row(link: str, numbers: Inertia) -> str:
    centre = ", ".join(_round(value, 4) for value in numbers.centre)
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    tensor = ", ".join(f"{key}: {_round(numbers.tensor[place], 4)}" for key, place in places.items())
    return f"{link}: {{mass: {numbers.mass}, centre: [{centre}], {tensor}}}"


def _round(value: float, digits: int) -> str:
    return f"{round(float(value), digits) + 0.0:.{digits}f}"
