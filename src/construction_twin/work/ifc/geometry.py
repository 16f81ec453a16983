"""Bodies of products as triangles, by ifcopenshell's geometry kernel, and as extrusions where they are one.

Triangles are in the element's frame [m], openings cut out. An extrusion is given only when its bounding box and volume are those of
the kernel's triangles: the two know nothing of each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import coal
import ifcopenshell
import ifcopenshell.geom
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import BuildingError
from construction_twin.scene.triangle_mesh import hull_mesh, surface
from construction_twin.work.building import Body, Extrusion
from construction_twin.work.ifc.notes import Notes, Where
from construction_twin.work.ifc.profiles import is_curved
from construction_twin.work.ifc.representations import Item, Items, corners_of, crosses_itself, extent, extrusion
from construction_twin.work.mesh_checks import is_closed, volume

#: Triangles of a file.
MOST_TRIANGLES = 8_000_000
#: Farther from its own origin [m] no element reaches; some exporters write the whole building into one frame.
FARTHEST = 1e8
#: Largest distance of the triangles from a curved surface [m]; they lie inside of a convex one.
DEFLECTION = 0.001
_ANGLE = 0.5
#: By how much an extrusion's box [m, at 1 m] and volume may differ from the triangles'; where curves were replaced, as a part of
#: the volume without holes.
_SAME = 1e-5
_SAME_VOLUME = 1e-5
_CURVED_VOLUME = 0.06
#: Corners that are closer are one where that closes a body [m, at 1 m].
_ROUNDING = 1e-9
#: Pieces that are nearer touch [m]; smaller ones [m³] are rounding of the kernel's.
_TOUCH = 1e-4
_CRUMB = 1e-9
#: The message of the kernel's after which a part of a shape that crosses another is missing.
MISSING_CODE = "GEO161"
#: Messages of the kernel's after which its lengths are none.
NO_UNIT_CODES = ("GEO308", "GEO309", "GEO312")
#: Items that have a surface: one that gives no triangle is missed.
_SURFACES = (
    *("IfcSolidModel", "IfcBooleanResult", "IfcCsgPrimitive3D", "IfcTessellatedItem", "IfcFaceBasedSurfaceModel"),
    *("IfcShellBasedSurfaceModel", "IfcSurface"),
)


@dataclass(frozen=True)
class Shape:
    """What the kernel made of a product.

    Attributes:
        id: The product's.
        bodies: In the frame of `model_T_shape`.
        model_T_shape: Shape (4, 4). [m]
        doubt: Why the bodies are not one workpiece as the model says, and what stands for it: one hull around everything it can
            mean, or, of an element in pieces, its bodies. Empty: they are.
    """

    id: int
    bodies: tuple[Body, ...]
    model_T_shape: np.ndarray
    doubt: str = ""

    def doubted(self, why: str) -> Shape:
        """Return the shape with a hull in place of its bodies."""
        points = [body.vertices for body in self.bodies]
        return replace(self, bodies=hull(np.concatenate(points)) if points else (), doubt=why)


def shapes(
    file: ifcopenshell.file,
    name: str,
    bodies: Mapping[int, ifcopenshell.entity_instance],
    cut: frozenset[int],
    unit: float,
    notes: Notes,
    progress: Callable[[int, int], None],
) -> Iterator[Shape]:
    """Make the bodies of products.

    Args:
        name: For messages.
        bodies: Body representation by the product's id.
        cut: Products that something is cut from.
        unit: Metres per length unit.
        progress: Takes how many are done, of how many.

    Raises BuildingError.
    """
    if not bodies:
        return
    items = Items(name)
    for representation in bodies.values():
        items.check(representation)
    contexts = {representation.ContextOfItems.id() for representation in bodies.values()}
    made = set()
    total = 0
    iterator = ifcopenshell.geom.iterator(
        _settings(contexts), file, 1, include=[file.by_id(product) for product in bodies]
    )
    progress(0, len(bodies))
    more = iterator.initialize()
    while more:
        shape = iterator.get()
        if shape.id in bodies and shape.id not in made:
            product = file.by_id(shape.id)
            with Where(name, product):
                vertices, triangles, owners = _arrays(shape.geometry)
                total += len(triangles)
                check_mesh(name, product, vertices, total)
                resolved = items.resolved(bodies[shape.id])
                crossed = _crossed(resolved, unit)
                less = _less(resolved, owners)
                resolved = [] if shape.id in cut else resolved
                if crossed:
                    found = hull(np.concatenate([vertices, *crossed]))
                elif less:
                    found = hull(vertices)
                else:
                    found = tuple(_bodies(vertices, triangles, owners, resolved, unit, product.GlobalId, notes))
                matrix = np.array(shape.transformation.matrix, dtype=float).reshape(4, 4, order="F")
            # a product with two bodies in two contexts comes twice: the one that was chosen is looked for
            if _is_of(shape.geometry.id, bodies[shape.id]):
                made.add(shape.id)
                progress(len(made), len(bodies))
                pieces = pieces_of(found) if shape.id in cut and not (crossed or less) else 1
                yield Shape(shape.id, found, matrix, _doubt(bool(crossed), less, pieces))
        more = bool(iterator.next())


def pieces_of(bodies: Sequence[Body]) -> int:
    """Return into how many pieces that do not touch each other the closed ones of these bodies fall.

    Args:
        bodies: Normals outwards.
    """
    pieces = [
        (body.vertices[used], corners.reshape(-1, 3))
        for body in bodies
        if is_closed(body.triangles)
        for used, corners in (np.unique(part, return_inverse=True) for part in _split(body.triangles))
    ]
    # the wall of a cavity is turned inwards
    pieces = [piece for piece in pieces if volume(*piece) > _CRUMB]
    if len(pieces) < 2:
        return len(pieces)
    low = np.array([vertices.min(axis=0) for vertices, _ in pieces]) - _TOUCH
    high = np.array([vertices.max(axis=0) for vertices, _ in pieces])
    meshes = [surface(*piece) for piece in pieces]
    groups = list(range(len(pieces)))
    for one in range(len(pieces)):
        near = (low[one] <= high[one + 1 :]).all(axis=1) & (low[one + 1 :] <= high[one]).all(axis=1)
        for other in (one + 1 + np.flatnonzero(near)).tolist():
            if groups[one] != groups[other] and _touch(meshes[one], meshes[other]):
                groups = [groups[one] if group == groups[other] else group for group in groups]
    return len(set(groups))


def _touch(one: coal.BVHModelOBBRSS, other: coal.BVHModelOBBRSS) -> bool:
    identity = coal.Transform3s.Identity()
    return bool(coal.distance(one, identity, other, identity, coal.DistanceRequest(), coal.DistanceResult()) <= _TOUCH)


def _less(items: list[Item], owners: np.ndarray) -> str:
    """Return the items with a surface that gave no triangle, as ``#12=IfcExtrudedAreaSolid``; empty: there is none."""
    made = set(owners.tolist())
    missing = [
        f"#{item.entity.id()}={item.entity.is_a()}"
        for item in items
        if any(item.entity.is_a(kind) for kind in _SURFACES) and made.isdisjoint(_numbers(item.entity))
    ]
    return ", ".join(dict.fromkeys(missing[:3]))


def _numbers(item: ifcopenshell.entity_instance) -> set[int]:
    """Return the numbers by which the kernel may call an item: its own, a CSG solid's tree's, a surface model's shells'."""
    parts = (getattr(item, name, ()) or () for name in ("TreeRootExpression", "FbsmFaces", "SbsmBoundary"))
    flat = (each for part in parts for each in (part if isinstance(part, tuple) else (part,)))
    return {item.id(), *(each.id() for each in flat)}


def _crossed(items: list[Item], unit: float) -> list[np.ndarray]:
    """Return the corners of the extrusions whose profile crosses itself."""
    given = (extrusion(item, unit) for item in items)
    return [corners_of(each) for each in given if each is not None and crosses_itself(each)]


def hull(points: np.ndarray) -> tuple[Body, ...]:
    """Return the convex hull of points as one body; none where they lie in a plane.

    Args:
        points: Shape (n, 3)
    """
    try:
        vertices, triangles = hull_mesh(ConvexHull(points))
    except QhullError:
        return ()
    return (Body(vertices, triangles.astype(np.int32)),)


def _is_of(geometry: str, representation: ifcopenshell.entity_instance) -> bool:
    """Whether a geometry was made of a representation, or of what that one maps."""
    number = int(geometry.split("-")[0])
    while representation.id() != number:
        items = representation.Items
        if len(items) != 1 or not items[0].is_a("IfcMappedItem"):
            return False
        representation = items[0].MappingSource.MappedRepresentation
    return True


def _settings(contexts: set[int]) -> ifcopenshell.geom.settings:
    settings = ifcopenshell.geom.settings()
    settings.set("context-ids", sorted(contexts))
    settings.set("no-normals", True)
    settings.set("weld-vertices", True)
    settings.set("reorient-shells", True)
    settings.set("mesher-linear-deflection", DEFLECTION)
    settings.set("mesher-angular-deflection", _ANGLE)
    return settings


def _arrays(geometry: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices = np.frombuffer(geometry.verts_buffer, dtype=np.float64).reshape(-1, 3)  # type: ignore[attr-defined]
    triangles = np.frombuffer(geometry.faces_buffer, dtype=np.int32).reshape(-1, 3)  # type: ignore[attr-defined]
    owners = np.frombuffer(geometry.item_ids_buffer, dtype=np.int32)  # type: ignore[attr-defined]
    if len(owners) != len(triangles):
        owners = np.zeros(len(triangles), dtype=np.int32)
    return vertices, triangles, owners


def check_mesh(name: str, product: ifcopenshell.entity_instance, vertices: np.ndarray, total: int) -> None:
    """Check what the kernel made.

    Raises BuildingError.
    """
    what = Sentence("ifc.element", id=repr(product.GlobalId))
    if total > MOST_TRIANGLES:
        raise BuildingError(name, what, Sentence("ifc.found.triangles", most=MOST_TRIANGLES), Sentence("ifc.less"))
    if len(vertices) and not (np.isfinite(vertices).all() and np.abs(vertices).max() <= FARTHEST):
        raise BuildingError(name, what, Sentence("ifc.found.corners"), Sentence("ifc.at_most", most=FARTHEST))


def _bodies(
    vertices: np.ndarray,
    triangles: np.ndarray,
    owners: np.ndarray,
    items: list,
    unit: float,
    about: str,
    notes: Notes,
) -> Iterator[Body]:
    exact: dict[int, list[tuple[Extrusion | None, bool]]] = {}
    for item in items:
        curved = item.entity.is_a("IfcSweptAreaSolid") and is_curved(item.entity.SweptArea)
        exact.setdefault(item.entity.id(), []).append((extrusion(item, unit), curved))
    for owner in dict.fromkeys(owners.tolist()):
        part = triangles[owners == owner]
        candidates = exact.get(owner, [])
        # the same item, mapped several times
        for each in _split(part) if len(candidates) > 1 else [part]:
            used, corners = np.unique(each, return_inverse=True)
            body = _oriented(vertices[used], corners.reshape(-1, 3).astype(np.int32), about, notes)
            if body is not None:
                yield Body(body.vertices, body.triangles, _agreeing(body, candidates))


def _doubt(crossed: bool, less: str, pieces: int) -> str:
    """Return why a body is doubted, and what stands for it; empty: it is not."""
    if crossed:
        return Sentence("ifc.doubt.crossed")
    if less:
        return Sentence("ifc.doubt.less", problem=less)
    return Sentence("ifc.doubt.in_pieces", count=pieces) if pieces > 1 else ""


def _split(triangles: np.ndarray) -> list[np.ndarray]:
    count = int(triangles.max()) + 1
    ends = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    graph = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, component = connected_components(graph, directed=False)
    of = component[triangles[:, 0]]
    return [triangles[of == each] for each in np.unique(of)]


def _oriented(vertices: np.ndarray, triangles: np.ndarray, about: str, notes: Notes) -> Body | None:
    vertices, triangles = _welded(vertices, triangles)
    if len(triangles) == 0:
        notes.add(Sentence("ifc.note.no_extent"), about)
        return None
    if not is_closed(triangles):
        # cut by an opening: the corners of both sides of an edge may differ by rounding
        near = _welded(_rounding_removed(vertices), triangles)
        if is_closed(near[1]):
            vertices, triangles = near
    if not is_closed(triangles):
        notes.add(Sentence("ifc.note.not_closed"), about)
        return Body(vertices, triangles)
    enclosed = volume(vertices, triangles)
    if abs(enclosed) < 1e-15:
        notes.add(Sentence("ifc.note.no_extent"), about)
        return None
    return Body(vertices, triangles if enclosed > 0 else np.ascontiguousarray(triangles[:, ::-1]))


def _welded(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices at the same place are one; triangles that have two corners there are none."""
    places, index = np.unique(vertices, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[triangles].astype(np.int32)
    a, b, c = triangles.T
    return places, np.ascontiguousarray(triangles[(a != b) & (b != c) & (c != a)])


def _rounding_removed(vertices: np.ndarray) -> np.ndarray:
    """Return corners, shape (v, 3) [m]: those that differ by rounding only are at the place of the first of them."""
    pairs = cKDTree(vertices).query_pairs(_ROUNDING * max(1.0, float(np.abs(vertices).max())), output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=[len(vertices)] * 2)
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    return vertices[first[group]]


def _agreeing(body: Body, candidates: list[tuple[Extrusion | None, bool]]) -> Extrusion | None:
    if not candidates or not is_closed(body.triangles):
        return None
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    enclosed = volume(body.vertices, body.triangles)
    for given, curved in candidates:
        if given is None:
            continue
        least, most, whole, outer = extent(given)
        off = max(np.abs(least - low).max(), np.abs(most - high).max())
        scale = max(1.0, float(np.abs([low, high]).max()))
        if off <= _SAME * scale and abs(whole - enclosed) <= _SAME_VOLUME * whole + 1e-9:
            return given
        # polygons around curves contain what the triangles approximate from within
        around = (least <= low + _SAME * scale).all() and (most >= high - _SAME * scale).all()
        near = off <= 0.02 * float((high - low).max()) + 2 * DEFLECTION
        if curved and around and near and -1e-6 * outer <= whole - enclosed <= _CURVED_VOLUME * outer:
            return given
    return None
