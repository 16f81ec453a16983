"""Inertias of links from their solids: a link's mass is spread evenly over its solids. Kilograms, metres, in the link's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Inertia:
    """Inertia of one link.

    Attributes:
        mass: [kg]
        centre: Shape (3,). Centre of mass in the link's frame [m].
        tensor: Shape (3, 3). About the centre of mass, axes of the link's frame [kg m^2].
    """

    mass: float
    centre: np.ndarray
    tensor: np.ndarray


def inertia(mass: float, meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> Inertia:
    """Return the inertia of closed meshes of one density that weigh `mass` together.

    Sums over the tetrahedra between the origin and each triangle (Tonon, Journal of Mathematics and Statistics 1, 2005).

    Args:
        mass: [kg]
        meshes: Sequence of (array, shape (v, 3); array of int, shape (t, 3)). Vertices [m] and triangles, counter-clockwise seen
            from outside.
    """
    corners = np.concatenate([vertices[triangles] for vertices, triangles in meshes])
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = volumes.sum()
    centre = np.einsum("i,ij->j", volumes, corners.sum(axis=1)) / (4 * volume)
    corners = corners - centre
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    total = corners.sum(axis=1)
    second = np.einsum("i,ikj,ikl->jl", volumes, corners, corners) + np.einsum("i,ij,il->jl", volumes, total, total)
    second *= mass / volume / 20
    return Inertia(mass, centre, np.trace(second) * np.eye(3) - second)
