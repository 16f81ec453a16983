"""Scenes, robots and mesh files that several tests share."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision, read_self_collision, sample_self_collision

ROOT = Path(__file__).parents[2]
FLOOR = SceneObject("floor", "box", (20.0, 20.0, 1.0), (0.0, 0.0, -0.5), fixed=True)


@cache
def kr120() -> RobotModel:
    return read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")


@cache
def kr120_pairs() -> SelfCollision:
    return read_self_collision(ROOT / "config/kr120_self_collision.yaml", kr120())


@cache
def ur_like() -> RobotModel:
    return read_robot_files(ROOT / "test/data/ur_like.urdf", ROOT / "test/data/ur_like.yaml")


@cache
def ur_like_pairs() -> SelfCollision:
    return sample_self_collision(ur_like(), samples=500)


@cache
def track7() -> RobotModel:
    return read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml")


@cache
def track7_pairs() -> SelfCollision:
    return sample_self_collision(track7(), samples=500)


def clutter(seed: int = 0, count: int = 15) -> Scene:
    """Return a scene of boxes, cylinders and spheres around the arm."""
    rng = np.random.default_rng(seed)
    shapes = (("box", (0.15, 0.1, 1.2)), ("cylinder", (0.08, 0.9)), ("sphere", (0.12,)))
    objects = [FLOOR]
    for index in range(count):
        angle, distance, height = rng.uniform((-3.0, 1.2, 0.3), (3.0, 2.4, 2.4))
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        position = (distance * np.cos(angle), distance * np.sin(angle), height)
        objects.append(SceneObject(f"object{index}", *shapes[index % 3], position, tuple(quaternion)))
    return Scene(tuple(objects), padding=0.02)


def random_poses(robot: RobotModel, count: int, seed: int = 0) -> np.ndarray:
    """Return joint values within the ranges, shape (count, n)."""
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, len(robot.lower)))


def write_stl(path: Path, triangles: np.ndarray) -> str:
    """Write triangles, shape (t, 3, 3) [m], as an ASCII STL file; return its path."""
    lines = ["solid test"]
    for corners in np.asarray(triangles, dtype=float):
        vertices = "".join(f"vertex {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in corners)
        lines.append(f"facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet")
    path.write_text("\n".join([*lines, "endsolid test", ""]))
    return str(path)


def write_obj(path: Path, triangles: np.ndarray) -> str:
    """Write triangles, shape (t, 3, 3) [m], as an OBJ file; return its path."""
    vertices, corners = np.unique(np.asarray(triangles, dtype=float).reshape(-1, 3), axis=0, return_inverse=True)
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in corners.reshape(-1, 3) + 1]
    path.write_text("\n".join([*lines, ""]))
    return str(path)


def box_triangles(size, centre=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Return the twelve triangles of a box [m]."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size + centre
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.array([corners[[a, b, c]] for a, b, c, d in faces] + [corners[[a, c, d]] for a, b, c, d in faces])


def bracket_triangles() -> np.ndarray:
    """Return an L made of two boxes that share an edge region: closed surfaces, but not convex together."""
    return np.concatenate([box_triangles((1.0, 0.2, 0.2)), box_triangles((0.2, 0.2, 1.0), (0.4, 0.0, 0.6))])
