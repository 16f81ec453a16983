"""An element of a building as objects of the scene: few convex pieces that hold all of it and reach little beyond. Metres.

Each body is tried in this order: one convex hull; cut exactly by planes of its own faces; hulls of its parts; its surface with a
margin. The first that holds the body and reaches no further beyond it than the bound is taken. Mesh files are named by their
contents, results by what they were made from.
"""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import manifold3d
import numpy as np
import shapely
from scipy.spatial import ConvexHull, QhullError

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.files import read_file, write_whole
from construction_twin.core.work_errors import BodyError, WorkError
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.scene.containment import excess, extra_volume, lost
from construction_twin.scene.convex_cells import convex_cells
from construction_twin.scene.convex_pieces import convex_cover
from construction_twin.scene.mesh_file import MOST_TRIANGLES
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.solids import hull_solid, mesh_of, parts, solid, welded
from construction_twin.scene.triangle_mesh import hull_mesh
from construction_twin.work.building import Body, Element

#: Changes when the same body would give other pieces.
_VERSION = 5
#: Triangles beyond which a body is not divided.
_MOST_DIVIDED = 5000
#: Triangles beyond which a body is not divided by planes of its faces: they are those of curved faces.
_MOST_CUT = 2000
#: Largest file of a result [bytes].
_LARGEST = 8 * 2**20
#: Ways whose pieces have no overlaps and, together, the volume of the body.
_EXACT = ("cut",)
#: A box around something flat is as thick [m].
_FLAT = 0.001
#: A hull of this fraction of its box is the box.
_IS_BOX = 1e-9


@dataclass(frozen=True)
class BodySettings:
    """What the pieces of an element must keep.

    Attributes:
        bound: How far a piece may reach beyond the body [m].
        pieces: Most pieces of one body; of one that is divided exactly four times as many.
        margin: Padding of a body that remains a surface [m].
    """

    bound: float = 0.005
    pieces: int = 32
    margin: float = 0.005


@dataclass(frozen=True)
class ElementShape:
    """One element as objects of the scene.

    Attributes:
        objects: ``<GlobalId>/0``, ``<GlobalId>/1``, ...; poses in the element's frame, `link` empty.
        excess: How far they reach beyond the element, at most, where measured [m]; of a surface its margin.
        ways: How each body was made: ``hull``, ``cut``, ``cover``, ``surface``.
    """

    element: str
    objects: tuple[SceneObject, ...]
    excess: float
    ways: tuple[str, ...]


def element_shapes(
    elements: Iterable[Element], folder: Path, settings: BodySettings | None = None
) -> tuple[dict[str, ElementShape], dict[str, BodyError]]:
    """Return many elements as objects of the scene, and those for which that is not possible; both by GlobalId."""
    shapes: dict[str, ElementShape] = {}
    failures: dict[str, BodyError] = {}
    for element in elements:
        try:
            shapes[element.id] = _shape(element.id, element.bodies, folder, settings or BodySettings())
        except BodyError as error:
            failures[element.id] = error
    return shapes, failures


def box_of(element: Element) -> SceneObject:
    """Return the box around an element's bodies, which stands for it where nothing better is known."""
    points = np.concatenate([body.vertices for body in element.bodies])
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, _FLAT)
    return SceneObject(
        f"{element.id}/0", "box", tuple(size.tolist()), tuple((0.5 * (low + high)).tolist()), (0.0, 0.0, 0.0, 1.0)
    )


def _shape(element: str, bodies: tuple[Body, ...], folder: Path, settings: BodySettings) -> ElementShape:
    if not bodies:
        raise BodyError(element, "found no geometry, expected at least one body; leave it out or give it a shape")
    objects: list[SceneObject] = []
    ways, most = [], 0.0
    for body in bodies:
        try:
            way, reach, pieces = _cached(body, folder, settings)
            for piece in pieces:
                objects.append(replace(piece, name=f"{element}/{len(objects)}"))
        except BodyError:
            raise
        except ConstructionTwinError as error:
            raise BodyError(element, str(error)) from error
        except OSError as error:
            raise BodyError(element, f"its mesh files cannot be kept in {folder}: {error.strerror}") from error
        ways.append(way)
        most = max(most, reach)
    return ElementShape(element, tuple(objects), most, tuple(ways))


def _digest(body: Body, settings: BodySettings) -> str:
    parts_of = [np.asarray(body.vertices, dtype=float), np.asarray(body.triangles, dtype=np.int64)]
    text = hashlib.sha256(json.dumps([_VERSION, asdict(settings), [list(part.shape) for part in parts_of]]).encode())
    for part in parts_of:
        text.update(np.ascontiguousarray(part).tobytes())
    return text.hexdigest()


def _cached(body: Body, folder: Path, settings: BodySettings) -> tuple[str, float, list[SceneObject]]:
    """Return how a body was made, its excess, and its objects; from an earlier run if its files are as they were."""
    path = folder / f"{_digest(body, settings)}.json"
    try:
        kept = json.loads(read_file(path, _LARGEST))
        pieces = [_object(item, folder) for item in kept["pieces"]]
        if all(not item.mesh or item.mesh_digest == Path(item.mesh).stem for item in pieces):
            return kept["way"], kept["excess"], pieces
    except FileNotFoundError:
        # not made yet
        pass
    except (ValueError, KeyError, TypeError, ConstructionTwinError):
        # a damaged file, or a mesh that is gone: made anew, and written over
        path.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    way, reach, descriptions = _made(body, folder, settings)
    write_whole(path, json.dumps({"way": way, "excess": reach, "pieces": descriptions}) + "\n")
    return way, reach, [_object(item, folder) for item in descriptions]


def _object(item: dict, folder: Path) -> SceneObject:
    return SceneObject(
        "piece", item["shape"], tuple(item["size"]), tuple(item["position"]), tuple(item["quaternion"]),
        item["padding"], str((folder / item["mesh"]).absolute()) if item["mesh"] else "",
    )  # fmt: skip


def _made(body: Body, folder: Path, settings: BodySettings) -> tuple[str, float, list[dict]]:
    vertices = np.asarray(body.vertices, dtype=float)
    triangles = np.asarray(body.triangles, dtype=np.int64)
    if not len(triangles) or not np.isfinite(vertices).all():
        raise WorkError(f"found a body of {len(triangles)} triangles, expected triangles with finite corners")
    if len(triangles) > MOST_TRIANGLES:
        raise WorkError(f"found a body of {len(triangles)} triangles, expected at most {MOST_TRIANGLES}; simplify it")
    closed = solid(vertices, triangles)
    if closed is None and len(triangles) <= _MOST_DIVIDED:
        corners, faces = welded(vertices, triangles)
        closed = solid(corners, _wound(faces))
    why: list[str] = []
    for way, pieces in _candidates(body, closed, settings):
        problem, reach = _judged(vertices, triangles, closed, pieces, settings.bound, way in _EXACT)
        if not problem:
            return way, reach, [_description(points, folder) for points in pieces]
        why.append(f"{way}: {problem}")
    vertices, triangles = welded(vertices, triangles)
    if not len(triangles):
        raise WorkError(f"found a body without area, expected one that can be checked ({'; '.join(why) or 'flat'})")
    mesh = _write_mesh(vertices, triangles, folder)
    place = {"size": [1.0, 1.0, 1.0], "position": [0.0, 0.0, 0.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}
    return "surface", settings.margin, [{"shape": "mesh", **place, "padding": settings.margin, "mesh": mesh}]


def _candidates(body: Body, closed: manifold3d.Manifold | None, settings: BodySettings):
    """Give ways to divide a body, the best first, each when it is asked for."""
    vertices = np.asarray(body.vertices, dtype=float)
    if closed is None or len(body.triangles) > _MOST_DIVIDED:
        yield from _one_hull(vertices)
        return
    separate = parts(closed)
    hulls = [mesh_of(part)[0] for part in separate]
    if len(hulls) <= settings.pieces:
        yield "hull", hulls
    cut = convex_cells(closed, 4 * settings.pieces) if len(body.triangles) <= _MOST_CUT else None
    if cut is not None:
        yield "cut", cut
    held = convex_cover(closed, settings.pieces, 0.4 * settings.bound)
    if held is not None:
        yield "cover", held


def _one_hull(vertices: np.ndarray):
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        return
    yield "hull", [hull.points[hull.vertices]]


def _wound(triangles: np.ndarray) -> np.ndarray:
    """Return triangles wound as their neighbours are: a file can have the sides of a hole turned inside out."""
    sides: dict[tuple[int, int], list[tuple[int, bool]]] = defaultdict(list)
    edges = [[(a, b), (b, c), (c, a)] for a, b, c in triangles.tolist()]
    for number, around in enumerate(edges):
        for start, end in around:
            sides[min(start, end), max(start, end)].append((number, start < end))
    turned: dict[int, bool] = {}
    for first in range(len(edges)):
        left = [first] if turned.setdefault(first, False) is False else []
        while left:
            at = left.pop()
            for start, end in edges[at]:
                for other, sense in sides[min(start, end), max(start, end)]:
                    if other not in turned:
                        turned[other] = turned[at] ^ (sense == (start < end))
                        left.append(other)
    wrong = np.array([turned[number] for number in range(len(edges))], dtype=bool)
    return np.where(wrong[:, None], triangles[:, ::-1], triangles)


def _judged(
    vertices: np.ndarray, triangles: np.ndarray, closed: manifold3d.Manifold | None,
    pieces: Sequence[np.ndarray], bound: float, exact: bool,
) -> tuple[str, float]:  # fmt: skip
    """Return what is wrong with pieces, empty if nothing is, and how far they reach beyond the body [m]."""
    if any(hull_solid(points).is_empty() for points in pieces):
        return "a flat piece", 0.0
    if exact and closed is not None:
        difference = extra_volume(closed, pieces)
        if difference:
            return f"{difference:g} m^3 more than the body", 0.0
    # manifold3d is not asked where faces lie in the same planes: with the same volume, points on the surface suffice
    outside = lost(vertices, triangles, None if exact else closed, pieces)
    if outside:
        return f"{outside * 1e3:g} mm of the body are outside of the pieces", 0.0
    if closed is None:
        # of what has no inside only a hull that is the body itself is known to reach no further
        if _is_closed_hull(vertices, triangles, pieces):
            return "", 0.0
        return "the body is not closed, so that nobody knows what the pieces have more", 0.0
    reach = 0.0 if exact else excess(closed, pieces)
    if reach > bound:
        return f"a piece reaches {reach * 1e3:g} mm beyond the body, expected at most {bound * 1e3:g} mm", reach
    return "", reach


def _is_closed_hull(vertices: np.ndarray, triangles: np.ndarray, pieces: Sequence[np.ndarray]) -> bool:
    """Return whether the triangles cover the whole surface of the one piece: doubled faces do not matter."""
    if len(pieces) != 1:
        return False
    hull = ConvexHull(pieces[0])
    corners = vertices[triangles]
    middles = corners.mean(axis=1)
    on_plane = np.abs(middles @ hull.equations[:, :3].T + hull.equations[:, 3]).min(axis=1)
    covered = set()
    for plane in np.unique(np.round(hull.equations, 6), axis=0):
        mine = np.abs(corners @ plane[:3] + plane[3]).max(axis=1) <= 1e-5
        basis = np.linalg.svd(plane[None, :3])[2][1:]
        face = hull.points[np.abs(hull.points @ plane[:3] + plane[3]) <= 1e-5] @ basis.T
        wanted = shapely.MultiPoint(face).convex_hull.area
        have = shapely.union_all(shapely.polygons(corners[mine] @ basis.T)).area if mine.any() else 0.0
        covered.add(have >= wanted * (1.0 - 1e-6))
    return bool((on_plane <= 1e-5).all()) and covered == {True}


def _description(points: np.ndarray, folder: Path) -> dict:
    """Return what makes a SceneObject of a convex piece: a box where it is one."""
    box = _as_box(points)
    if box is not None:
        return {**box, "shape": "box", "padding": 0.0, "mesh": ""}
    mesh = _write_mesh(*hull_mesh(ConvexHull(points)), folder)
    place = {"size": [1.0, 1.0, 1.0], "position": [0.0, 0.0, 0.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}
    return {"shape": "mesh", **place, "padding": 0.0, "mesh": mesh}


def _as_box(points: np.ndarray) -> dict | None:
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
    write_whole(folder / name, text)
    return name


def element_triangles(element: Element) -> np.ndarray:
    """Return all triangles of an element as the model has them, for pictures: shape (t, 3, 3), in its frame [m]."""
    found = [np.asarray(body.vertices, dtype=float)[np.asarray(body.triangles)] for body in element.bodies]
    return np.concatenate(found) if found else np.empty((0, 3, 3))
