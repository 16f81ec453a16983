"""Bodies of products as triangles, by ifcopenshell's geometry kernel, in the element's frame [m].

Openings are cut out by manifold3d: the kernel leaves away what it cannot cut. A box stands for what it fails at.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import ifcopenshell
import ifcopenshell.geom
import manifold3d
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from construction_twin.extensions.work.building import Body, BuildingError, first_few
from construction_twin.extensions.work.ifc.notes import Notes, label
from construction_twin.scene.solids import mesh_of, solid, welded

_Entity = ifcopenshell.entity_instance
#: Identifiers of representations that are a body, the best first.
_BODIES = ("Body", "Body-FallBack", "Facetation", "Tessellation", "Mesh")
#: What a representation without one of those identifiers must be to be taken as the body.
_SOLID = {
    "SweptSolid", "AdvancedSweptSolid", "Brep", "AdvancedBrep", "CSG", "Clipping", "SolidModel", "SurfaceModel", "Surface3D",
    "Tessellation", "MappedRepresentation",
}  # fmt: skip
#: Identifiers of what has a surface and is no body.
_NO_BODIES = (
    *("Axis", "FootPrint", "Box", "Annotation", "Plan", "Clearance", "CoG", "Profile", "Reference", "Surface"),
    "Lighting",
)
#: Items that lie between their points.
_FLAT = ("IfcFacetedBrep", "IfcTessellatedFaceSet")
#: What reaches nowhere, or without an end and only cuts.
_NO_REACH = ("IfcHalfSpaceSolid", "IfcRepresentationContext", "IfcDirection", "IfcPresentationItem")
#: Triangles of a file.
MOST_TRIANGLES = 8_000_000
#: Farther from its own origin [m] no element reaches; some exporters write the whole building into one frame.
FARTHEST = 1e8
#: Largest distance of the triangles from a curved surface [m]; they lie inside of a convex one.
DEFLECTION = 0.001
_ANGLE = 0.5
#: By how much an opening is larger than it is given [m], so that no skin is left where a face of it lies in one of the element's.
_GROWN = 1e-7
#: Smaller pieces [m³] are rounding of the cutting.
_CRUMB = 1e-9
#: Messages of the kernel's after which its lengths are none.
NO_UNIT_CODES = ("GEO308", "GEO309", "GEO312")
#: Items that have a surface: one that gives no triangle is missed.
_SURFACES = (
    *("IfcSolidModel", "IfcBooleanResult", "IfcCsgPrimitive3D", "IfcTessellatedItem", "IfcFaceBasedSurfaceModel"),
    *("IfcShellBasedSurfaceModel", "IfcSurface"),
)


_SETTINGS = ifcopenshell.geom.settings()
_SETTINGS.set("no-normals", True)
_SETTINGS.set("weld-vertices", True)
_SETTINGS.set("disable-opening-subtractions", True)
# in 2D, what is cut away whole stands whole
_SETTINGS.set("boolean-attempt-2d", False)
_SETTINGS.set("mesher-linear-deflection", DEFLECTION)
_SETTINGS.set("mesher-angular-deflection", _ANGLE)


@dataclass(frozen=True)
class Shape:
    """Bodies of a product in a frame, shape (4, 4) [m], None: the element's own; and why they are doubtful."""

    id: int
    bodies: tuple[Body, ...]
    model_T_shape: np.ndarray | None
    doubt: str = ""

    def doubted(self, why: str, *beyond: np.ndarray) -> Shape:
        """Return the shape with a box in place of its bodies and what is `beyond`, shape (k, 3) each [m]."""
        points = [*(body.vertices for body in self.bodies), *beyond]
        return replace(self, bodies=(box(np.concatenate(points)),) if points else (), doubt=why)


def shapes(
    file: ifcopenshell.file,
    name: str,
    bodies: Mapping[int, _Entity],
    openings: Mapping[int, Sequence[_Entity]],
    unit: float,
    notes: Notes,
    read_log: Callable[[_Entity], None],
) -> Iterator[Shape]:
    """Make the bodies of products; one of which nothing is made has none, and is doubted.

    `openings`: what is cut from a product, by its id. `unit`: metres per length unit. `read_log`: called with a product when the
    kernel has made what it can of it.
    """
    cuts = {each.id(): body for of in openings.values() for each in of if (body := body_of(each)) is not None}
    holes = {shape.id: shape for shape in _kernel_shapes(file, name, cuts, read_log)}
    missing = dict(bodies)
    for shape in _kernel_shapes(file, name, bodies, read_log):
        items = list(_resolved(missing.pop(shape.id)))
        own_openings = [each.id() for each in openings.get(shape.id, ()) if each.id() in cuts]
        yield _shape(shape, items, own_openings, holes, unit, file.by_id(shape.id).GlobalId, notes)
    for number, representation in missing.items():
        # one of lines alone has nothing to touch
        if any(map(_has_surface, file.traverse(representation))):
            reason = "the geometry kernel cannot make its shape; a box that holds it stands as an obstacle"
            yield Shape(number, (), None).doubted(reason, bounds(representation) * unit)


@dataclass(frozen=True)
class _KernelShape:
    """What the kernel made of a product: triangles, and for each of them the number of the item that it is of."""

    id: int
    vertices: np.ndarray
    triangles: np.ndarray
    owners: np.ndarray
    matrix: np.ndarray


def _kernel_shapes(
    file: ifcopenshell.file, name: str, bodies: Mapping[int, _Entity], read_log: Callable[[_Entity], None]
) -> Iterator[_KernelShape]:
    """Yield the kernel's shapes of representations that have triangles, openings still filled."""
    total = 0
    for number, representation in bodies.items():
        product = file.by_id(number)
        shape: Any = None
        try:
            shape = ifcopenshell.geom.create_shape(_SETTINGS, product, representation)
        except RuntimeError:
            pass  # its log says why
        read_log(product)
        if shape is None:
            continue
        mesh = shape.geometry
        vertices = np.frombuffer(mesh.verts_buffer, dtype=np.float64).reshape(-1, 3).copy()
        triangles = np.frombuffer(mesh.faces_buffer, dtype=np.int32).reshape(-1, 3).copy()
        total += len(triangles)
        what = f"element {product.GlobalId!r}"
        if total > MOST_TRIANGLES:
            raise BuildingError(name, what, f"more than {MOST_TRIANGLES} triangles up to it", "less")
        if not np.all(np.abs(vertices) <= FARTHEST):
            found = "corners that are no finite numbers, or too far"
            raise BuildingError(name, what, found, f"at most {FARTHEST:g} m")
        if len(triangles):
            owners = np.frombuffer(mesh.item_ids_buffer, dtype=np.int32).copy()
            matrix = np.array(shape.transformation.matrix, dtype=float).reshape(4, 4, order="F")
            yield _KernelShape(number, vertices, triangles, owners, matrix)


def _shape(
    kernel_shape: _KernelShape,
    items: list[_Entity],
    openings: Sequence[int],
    holes: Mapping[int, _KernelShape],
    unit: float,
    about: str,
    notes: Notes,
) -> Shape:
    bodies = tuple(_bodies(kernel_shape, [] if openings else items, about, notes))
    shape = Shape(kernel_shape.id, bodies, kernel_shape.matrix)
    made = set(kernel_shape.owners.tolist())
    # of a full turn about an axis through the profile, or a bar with a sharp bend, the kernel makes nothing, and reports nothing
    if less := [label(item) for item in items if _has_surface(item) and made.isdisjoint(_numbers(item))]:
        reason = f"the geometry kernel cannot make a part of its shape ({first_few(less)}); a box that holds it"
        return shape.doubted(f"{reason} stands as an obstacle", *(bounds(item) * unit for item in items))
    if not openings:
        return shape
    cut = _cut(kernel_shape, bodies, openings, holes)
    if not cut:
        return shape.doubted("its openings cannot be cut out, or leave nothing; its box stands as an obstacle")
    return replace(shape, bodies=tuple(Body(vertices, faces.astype(np.int32)) for vertices, faces in map(mesh_of, cut)))


def _cut(
    kernel_shape: _KernelShape, bodies: Sequence[Body], openings: Sequence[int], holes: Mapping[int, _KernelShape]
) -> list[manifold3d.Manifold]:
    left = [one for body in bodies if (one := solid(body.vertices, body.triangles)) is not None]
    if len(left) < len(bodies) or any(number not in holes for number in openings):
        return []
    for hole in (holes[number] for number in openings):
        shape_T_hole = np.linalg.inv(kernel_shape.matrix) @ hole.matrix
        points = hole.vertices @ shape_T_hole[:3, :3].T + shape_T_hole[:3, 3]
        middle, size = 0.5 * (points.max(axis=0) + points.min(axis=0)), np.ptp(points, axis=0).max()
        points = middle + (points - middle) * (1.0 + 2 * _GROWN / size)
        for owner in np.unique(hole.owners):
            tool = solid(points, hole.triangles[hole.owners == owner])
            if tool is None:
                return []
            left = [one - tool for one in left]
    return [one for one in left if one.volume() > _CRUMB]


def _has_surface(item: _Entity) -> bool:
    return any(map(item.is_a, _SURFACES))


def _numbers(item: _Entity) -> set[int]:
    """Return the numbers by which the kernel may call an item: its own, a CSG solid's tree's, a surface model's shells'."""
    parts = (getattr(item, name, ()) or () for name in ("TreeRootExpression", "FbsmFaces", "SbsmBoundary"))
    flat = (each for part in parts for each in (part if isinstance(part, tuple) else (part,)))
    return {item.id(), *(each.id() for each in flat)}


def box(points: np.ndarray) -> Body:
    """Return the box around points, shape (n, 3), and around curved surfaces that have corners there [m]."""
    low, high = points.min(axis=0) - DEFLECTION, points.max(axis=0) + DEFLECTION
    corners = manifold3d.Manifold.cube(high - low).translate(low)
    vertices, triangles = mesh_of(corners)
    return Body(vertices, triangles.astype(np.int32))


def _bodies(kernel_shape: _KernelShape, items: list[_Entity], about: str, notes: Notes) -> Iterator[Body]:
    copies = Counter(item.id() for item in items)
    for owner in dict.fromkeys(kernel_shape.owners.tolist()):
        part = kernel_shape.triangles[kernel_shape.owners == owner]
        # the same item, mapped several times
        for each in _split(part) if copies[owner] > 1 else [part]:
            used, corners = np.unique(each, return_inverse=True)
            vertices, triangles = welded(kernel_shape.vertices[used], corners.reshape(-1, 3))
            body = Body(vertices, triangles.astype(np.int32))
            if len(triangles) and not body.is_closed:
                notes.add("Bodies that are not closed (their triangles stand as they are, without a volume)", about)
            elif abs(enclosed := body.volume) < 1e-15:
                notes.add("Bodies without any extent are left out", about)
                continue
            elif enclosed < 0:
                body = Body(vertices, np.ascontiguousarray(body.triangles[:, ::-1]))
            yield body


def _split(triangles: np.ndarray) -> list[np.ndarray]:
    count = int(triangles.max()) + 1
    ends = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    graph = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    of = connected_components(graph, directed=False)[1][triangles[:, 0]]
    return [triangles[of == each] for each in np.unique(of)]


def body_of(product: _Entity) -> _Entity | None:
    """Return a product's body representation; None: it has none."""
    definition = getattr(product, "Representation", None)
    representations = [] if definition is None else [r for r in definition.Representations if r.is_a("IfcShapeModel")]
    for identifier in _BODIES:
        for representation in representations:
            if representation.RepresentationIdentifier == identifier:
                return representation
    for representation in representations:
        if representation.RepresentationIdentifier not in _NO_BODIES and representation.RepresentationType in _SOLID:
            return representation
    return None


def _resolved(representation: _Entity) -> Iterator[_Entity]:
    for item in representation.Items:
        if item.is_a("IfcMappedItem"):
            yield from _resolved(item.MappingSource.MappedRepresentation)
        else:
            yield item


def bounds(node: _Entity) -> np.ndarray:
    """Return the lowest and highest coordinates of a representation or one of its items [unit of the file], shape (2, 3)."""
    if node.is_a("IfcRepresentation"):
        boxes = [bounds(item) for item in node.Items]
        return np.array([np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))]) if boxes else np.zeros((2, 3))
    points: list[tuple[float, ...]] = []
    for each in node.file.traverse(node) if any(node.is_a(kind) for kind in _FLAT) else ():
        if each.is_a("IfcCartesianPoint"):
            points.append(each.Coordinates)
        elif each.is_a("IfcCartesianPointList3D"):
            points += each.CoordList
    if not points:
        return _reach(node) * np.array([[-1.0] * 3, [1.0] * 3])
    return np.array([np.min(points, axis=0), np.max(points, axis=0)])


def _reach(value: object) -> float:
    """Return how far from its origin an item reaches at most, in the file's units: the sum of all lengths on the way to a point."""
    if isinstance(value, tuple):
        return max(map(_reach, value), default=0.0)
    if isinstance(value, float):
        # beyond the distance of a point with this coordinate, and of what is turned about an axis there
        return 4.0 * abs(value)
    if not isinstance(value, _Entity) or value.id() == 0 or any(map(value.is_a, _NO_REACH)):
        return 0.0
    found = sum(map(_reach, value.get_info(include_identifier=False).values()))
    if value.is_a("IfcMappedItem"):
        target = value.MappingTarget
        found *= max(1.0, *(abs(getattr(target, name, None) or 1.0) for name in ("Scale", "Scale2", "Scale3")))
    return found
