"""An element of a building as objects of the scene: few convex pieces that hold all of it and reach little beyond. Metres.

A body becomes convex pieces (`scene.convex_pieces`) if these reach no further beyond it than the bound, otherwise its surface with
a margin. Mesh files are named by their contents, results by what they were made from.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.files import read_file, write_atomically
from construction_twin.extensions.work.building import Body, Element, WorkError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.collision_bodies import scene_geometry
from construction_twin.scene.convex_pieces import convex_pieces
from construction_twin.scene.mesh_file import MOST_TRIANGLES, parse_mesh
from construction_twin.scene.objects import SceneObject, read_mesh_file
from construction_twin.scene.same_space import BOX, same_points
from construction_twin.scene.solids import hull_solid, mesh_of, welded

#: Changes when the same body would give other pieces.
_VERSION = 7
#: How far a piece may reach beyond its body, and the padding of a body that remains a surface [m].
BOUND, MARGIN = 0.005, 0.005
#: Largest file of a result [bytes].
_LARGEST = 8 * 2**20
#: A box around something flat is as thick [m].
_FLAT = 0.001
#: A hull of this fraction of its box is the box.
_IS_BOX = 1e-9


@dataclass(frozen=True)
class ElementShape:
    """One element as objects ``<GlobalId>/0``, ... in its frame; `excess`: how far they reach beyond it at most [m]."""

    objects: tuple[SceneObject, ...]
    excess: float


def element_shapes(elements: Iterable[Element], folder: Path) -> tuple[dict[str, ElementShape], dict[str, str]]:
    """Return many elements as objects of the scene, and why others cannot be; both by GlobalId."""
    shapes: dict[str, ElementShape] = {}
    failures: dict[str, str] = {}
    for element in elements:
        try:
            if not element.bodies:
                raise WorkError("found no geometry, expected at least one body; leave it out or give it a shape")
            found = [_cached(body, folder) for body in element.bodies]
        except ConstructionTwinError as error:
            failures[element.id] = f"element {element.id}: {error}"
        except OSError as error:
            said = f"its mesh files cannot be kept in {folder}: {error.strerror}"
            failures[element.id] = f"element {element.id}: {said}"
        else:
            pieces = [piece for _, each in found for piece in each]
            named = (replace(piece, name=f"{element.id}/{number}") for number, piece in enumerate(pieces))
            shapes[element.id] = ElementShape(tuple(named), max(reach for reach, _ in found))
    return shapes, failures


def box_of(element: Element) -> SceneObject:
    """Return the box around an element's bodies, which stands for it where nothing better is known."""
    points = np.concatenate([body.vertices for body in element.bodies])
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, _FLAT)
    return SceneObject(f"{element.id}/0", "box", tuple(size.tolist()), tuple((0.5 * (low + high)).tolist()))


def _cached(body: Body, folder: Path) -> tuple[float, list[SceneObject]]:
    """Return a body's excess and objects, from an earlier run if its files are as they were."""
    vertices = np.ascontiguousarray(body.vertices, dtype=float)
    triangles = np.ascontiguousarray(body.triangles, dtype=np.int64)
    made_of = [_VERSION, BOUND, MARGIN, vertices.shape, triangles.shape]
    digest = hashlib.sha256(json.dumps(made_of).encode() + vertices.tobytes() + triangles.tobytes()).hexdigest()
    path = folder / f"{digest}.json"
    # not made yet, damaged, or a mesh is gone: made anew
    with contextlib.suppress(FileNotFoundError, ValueError, KeyError, TypeError, ConstructionTwinError):
        kept = json.loads(read_file(path, _LARGEST))
        pieces = [_object(item, folder) for item in kept["pieces"]]
        if all(not item.mesh or item.mesh_digest == Path(item.mesh).stem for item in pieces):
            return kept["excess"], pieces
    reach, descriptions = _convex_objects(vertices, triangles, folder)
    write_atomically(path, json.dumps({"excess": reach, "pieces": descriptions}) + "\n")
    return reach, [_object(item, folder) for item in descriptions]


def _object(item: dict, folder: Path) -> SceneObject:
    return SceneObject("piece", **{**item, "mesh": str((folder / item["mesh"]).absolute()) if item.get("mesh") else ""})


def _convex_objects(vertices: np.ndarray, triangles: np.ndarray, folder: Path) -> tuple[float, list[dict]]:
    if not len(triangles) or not np.isfinite(vertices).all():
        raise WorkError(f"found a body of {len(triangles)} triangles, expected triangles with finite corners")
    if len(triangles) > MOST_TRIANGLES:
        raise WorkError(f"found a body of {len(triangles)} triangles, expected at most {MOST_TRIANGLES}; simplify it")
    pieces = convex_pieces(vertices, triangles)
    if pieces is not None and pieces.reach <= BOUND:
        return pieces.reach, [
            _as_box(points) or {"shape": "mesh", "mesh": _write_mesh(*mesh_of(hull_solid(points)), folder)}
            for points in pieces.corners
        ]
    vertices, triangles = welded(vertices, triangles)
    if not len(triangles):
        raise WorkError("found a body without area, expected one that can be checked")
    mesh = _write_mesh(vertices, triangles, folder)
    return MARGIN, [{"shape": "mesh", "padding": MARGIN, "mesh": mesh}]


def _as_box(points: np.ndarray) -> dict | None:
    """Return the fields of a SceneObject for a convex piece that is a box, else None."""
    hull = ConvexHull(points)
    axes: list[np.ndarray] = []
    for normal in np.round(hull.equations[:, :3], 12):
        if all(abs(normal @ one) < 1.0 - 1e-9 for one in axes):
            axes.append(normal / np.linalg.norm(normal))
    if len(axes) != 3 or max(abs(axes[0] @ axes[1]), abs(axes[1] @ axes[2]), abs(axes[2] @ axes[0])) > 1e-9:
        return None
    # the axes in the order and sense that turn the box least
    rotation = np.zeros((3, 3))
    left = list(range(3))
    for axis in sorted(axes, key=lambda one: -round(float(np.abs(one).max()), 9)):
        column = max(left, key=lambda number: round(abs(float(axis[number])), 9))
        left.remove(column)
        rotation[:, column] = axis if axis[column] > 0 else -axis
    if np.linalg.det(rotation) < 0:
        rotation[:, 2] *= -1.0
    rotation += 0.0
    local = points @ rotation
    low, high = local.min(axis=0), local.max(axis=0)
    if np.prod(high - low) - hull.volume > _IS_BOX * hull.volume:
        return None
    centre = rotation @ (0.5 * (low + high))
    return {
        "shape": "box",
        "size": (high - low).tolist(),
        "position": centre.tolist(),
        "quaternion": [float(value) for value in rotation_to_quaternion(rotation)],
    }


def _write_mesh(vertices: np.ndarray, triangles: np.ndarray, folder: Path) -> str:
    """Write an OBJ file, whose numbers have all digits, under the hash of its contents; return its name."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (np.asarray(vertices, dtype=float) + 0.0).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    text = "\n".join([*lines, ""])
    name = f"{hashlib.sha256(text.encode()).hexdigest()}.obj"
    write_atomically(folder / name, text)
    return name


def element_triangles(element: Element) -> np.ndarray:
    """Return all triangles of an element, shape (t, 3, 3), in its frame [m]."""
    found = [np.asarray(body.vertices, dtype=float)[np.asarray(body.triangles)] for body in element.bodies]
    return np.concatenate(found) if found else np.empty((0, 3, 3))


#: Points further outside of a plane are not on it [m].
ON_PLANE = 1e-5
#: Facets whose normals differ by less are of one face [-, sine].
_PARALLEL = 1e-4


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex body; `planes`: shape (f, 4), outward normal and offset: inside where ``normal . x + offset <= 0``."""

    points: np.ndarray
    planes: np.ndarray
    volume: float
    centre: np.ndarray


class ElementPieces:
    """The pieces of one element, in the element's frame: boxes and meshes, `link` empty."""

    def __init__(self, objects: Sequence[SceneObject]):
        self.objects = tuple(objects)
        self.hulls = tuple(map(_hull, objects))

    @cached_property
    def solid(self) -> bool:
        """Whether every piece is a closed convex body, no surface."""
        return not any(isinstance(scene_geometry(item), coal.BVHModelBase) for item in self.objects)

    @cached_property
    def points(self) -> np.ndarray:
        """Corners of all pieces, shape (n, 3)."""
        return np.concatenate([hull.points for hull in self.hulls])

    @cached_property
    def centre(self) -> np.ndarray:
        """Centre of gravity of the pieces, all of one density, shape (3,)."""
        return np.average([hull.centre for hull in self.hulls], axis=0, weights=[hull.volume for hull in self.hulls])

    @cached_property
    def planes(self) -> np.ndarray:
        """The different planes of the facets of all pieces, largest first, shape (p, 4)."""
        found: list[np.ndarray] = []
        for plane in np.concatenate([hull.planes for hull in self.hulls]):
            if not any(
                abs(plane[3] - other[3]) <= ON_PLANE and np.linalg.norm(plane[:3] - other[:3]) <= _PARALLEL
                for other in found
            ):
                found.append(plane)
        return np.array(
            sorted(found, key=lambda plane: (-round(self._extent(plane), 6), *np.round(-plane, 6).tolist()))
        )

    def on(self, plane: np.ndarray) -> np.ndarray:
        """Return the corners that lie on a plane, shape (k, 3)."""
        return self.points[np.abs(self.points @ plane[:3] + plane[3]) <= ON_PLANE]

    def contain(self, points: np.ndarray, slack: float = 1e-6) -> np.ndarray:
        """Return which points lie in one of the pieces, shape (n,)."""
        inside = np.zeros(len(points), dtype=bool)
        for hull in self.hulls:
            inside |= (points @ hull.planes[:, :3].T + hull.planes[:, 3] <= slack).all(axis=1)
        return inside

    def same_turned(self, turn: Pose) -> bool:
        """Return whether a motion maps the pieces onto themselves."""
        left = list(self.hulls)
        for hull in self.hulls:
            moved = hull.points @ turn.rotation.T + turn.position
            match = next((other for other in left if same_points(moved, other.points, 1e-4)), None)
            if match is None:
                return False
            left.remove(match)
        return True

    def _extent(self, plane: np.ndarray) -> float:
        return float(np.prod(np.sort(np.ptp(self.on(plane), axis=0))[1:]))


@lru_cache(maxsize=4096)
def _hull(item: SceneObject) -> Hull:
    name, (x, y, z) = f"object {item.name!r}", item.size
    if item.mesh:
        corners = parse_mesh(f"{name} mesh", item.mesh, read_mesh_file(item.name, item.mesh), (x, y, z))[0]
    else:
        corners = BOX * item.size
    try:
        hull = ConvexHull(corners @ item.pose.rotation.T + item.pose.position)
    except QhullError as error:
        raise SceneError(name, item.shape, "a body that has a volume") from error
    points = hull.points[hull.vertices]
    middle = points.mean(axis=0)
    # of gravity: that of the tetrahedra between the middle and the facets
    a, b, c = np.moveaxis(hull.points[hull.simplices] - middle, 1, 0)
    volumes = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
    centre = middle + volumes @ (a + b + c) / (4.0 * volumes.sum())
    return Hull(points, np.unique(np.round(hull.equations, 9) + 0.0, axis=0), float(hull.volume), centre)
