"""A picture of convex bodies that stand still, drawn by the renderer of `film`: each in its colour, with its edges. Metres.

Seen from afar, without perspective, so that parallel edges are parallel and everything is in the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from construction_twin.physics.film import HEIGHT, WIDTH, Canvas

#: Where it is seen from [deg]: from the right and in front, from above.
_AZIMUTH, _ELEVATION = 120.0, -35.0
#: Room around the bodies, and width of an edge, as fractions of the picture.
_MARGIN, _EDGE = 0.06, 0.0011
_EDGE_COLOUR = (0.13, 0.13, 0.15, 1.0)
#: Two faces at less than this are one, and have no edge between them [deg].
_FLAT = 12.0


@dataclass(frozen=True, eq=False)
class StandingBody:
    """A convex body where it stands.

    Attributes:
        points: Shape (n, 3). Its corners; points inside do no harm.
        colour: r, g, b
    """

    points: np.ndarray
    colour: tuple[float, float, float]


def still(bodies: Sequence[StandingBody]) -> np.ndarray:
    """Return the picture, shape (`HEIGHT`, `WIDTH`, 3), 8 bits."""
    corners = np.concatenate([body.points for body in bodies])
    camera, extent = _camera(corners)
    edges = np.concatenate([edges_of(body.points) for body in bodies])
    canvas = Canvas(camera)
    try:
        model = _model(bodies, extent)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return canvas.draw(model, data, edges, _EDGE * extent * WIDTH / HEIGHT, _EDGE_COLOUR)
    finally:
        canvas.close()


def edges_of(points: np.ndarray) -> np.ndarray:
    """Return the edges of the convex hull of some points, shape (e, 2, 3): where two faces meet that are not one plane."""
    hull = ConvexHull(points)
    found: dict[tuple[int, int], list[np.ndarray]] = {}
    for corners, plane in zip(hull.simplices, hull.equations):
        for first, second in zip(corners, np.roll(corners, 1)):
            found.setdefault((min(first, second), max(first, second)), []).append(plane[:3])
    flat = np.cos(np.deg2rad(_FLAT))
    kept = [pair for pair, normals in found.items() if len(normals) == 2 and normals[0] @ normals[1] < flat]
    return points[np.array(kept, dtype=int).reshape(-1, 2)]


def _model(bodies: Sequence[StandingBody], extent: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    white = [1.0, 1.0, 1.0]
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=white, rgb2=white, width=16, height=96,
    )  # fmt: skip
    for number, body in enumerate(bodies):
        hull = ConvexHull(body.points)
        spec.add_mesh(
            name=f"{number}", uservert=body.points[hull.vertices].ravel().tolist(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )  # fmt: skip
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{number}", rgba=[*body.colour, 1.0], contype=0, conaffinity=0
        )
    model = spec.compile()
    model.vis.global_.orthographic = 1
    model.vis.global_.fovy = extent
    model.vis.headlight.ambient, model.vis.headlight.diffuse = [0.55] * 3, [0.45] * 3
    model.vis.headlight.specular = [0.0] * 3
    return model


def _camera(corners: np.ndarray) -> tuple[mujoco.MjvCamera, float]:
    """Return a camera that sees all corners, and the height of what it sees [m]."""
    azimuth, elevation = np.deg2rad((_AZIMUTH, _ELEVATION))
    forward = np.array((np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)))
    right = np.array((np.sin(azimuth), -np.cos(azimuth), 0.0))
    axes = np.array((right, np.cross(right, forward), forward))
    seen = corners @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    wide, tall, deep = high - low
    extent = (1.0 + 2 * _MARGIN) * max(float(tall), float(wide) * HEIGHT / WIDTH, 1e-3)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.orthographic = 1
    camera.lookat[:] = (low + high) / 2 @ axes
    camera.distance = float(deep) + extent
    camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
    return camera, extent
