"""Bodies of products as triangles, by ifcopenshell's geometry kernel, in the element's frame [m].

Openings are cut out by manifold3d: the kernel leaves away what it cannot cut. The bounding box stands for a body that nobody can be
sure of. Mapped items are followed here before the kernel does: a loop, or a few lines that mean a million copies, is refused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import ifcopenshell
import ifcopenshell.geom
import manifold3d
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from construction_twin.extensions.work.building import Body
from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.notes import Misread, Notes, Where, label
from construction_twin.scene.solids import hull_solid, mesh_of, solid

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
#: Copies by mapped items, and operands of booleans, of one element.
MOST_ITEMS = 100_000
DEEPEST = 200
#: Triangles of a file.
MOST_TRIANGLES = 8_000_000
#: Farther from its own origin [m] no element reaches; some exporters write the whole building into one frame.
FARTHEST = 1e8
#: Largest distance of the triangles from a curved surface [m]; they lie inside of a convex one.
DEFLECTION = 0.001
_ANGLE = 0.5
#: By how much an opening is larger than it is given [m], so that no skin is left where a face of it lies in one of the element's.
_GROWN = 1e-7
#: By what part of it openings take volume away at least.
_SHRUNK = 1e-12
#: By how much bodies may have more volume than the hull around them, as a part of it.
_OVERLAP = 1e-3
#: By how much volumes may differ that are the same, as a part of one.
_ROUNDING = 1e-6
#: Pieces that are nearer touch [m]; smaller ones [m³] are rounding of the kernel's.
_TOUCH = 1e-4
_CRUMB = 1e-9
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
        bodies: In the frame of `model_T_shape`.
        model_T_shape: Shape (4, 4) [m]; None: the element's own frame.
        doubt: Why the bodies are not one workpiece as the model says, and what stands for it: the box around everything it can
            mean, or, of an element in pieces, its bodies. Empty: they are.
    """

    id: int
    bodies: tuple[Body, ...]
    model_T_shape: np.ndarray | None
    doubt: str = ""

    def doubted(self, why: str, *beyond: np.ndarray) -> Shape:
        """Return the shape with a box in place of its bodies.

        `beyond`: Shape (k, 3) each. What the box holds beside the bodies [m].
        """
        points = [*(body.vertices for body in self.bodies), *beyond]
        return replace(self, bodies=(box(np.concatenate(points)),) if points else (), doubt=why)


def shapes(
    file: ifcopenshell.file,
    name: str,
    bodies: Mapping[int, ifcopenshell.entity_instance],
    openings: Mapping[int, Sequence[tuple[ifcopenshell.entity_instance, bool]]],
    unit: float,
    notes: Notes,
) -> Iterator[Shape]:
    """Make the bodies of products; one of which nothing is made has none, and is doubted.

    Args:
        openings: What is cut from a product, by its id, and whether that is an opening of its own: else of what it is a part of.
        unit: Metres per length unit.
    """
    items = Items(name)
    for representation in bodies.values():
        items.check(representation)
    cuts = {each.id(): body for given in openings.values() for each, _ in given if (body := body_of(each)) is not None}
    for representation in cuts.values():
        items.check(representation)
    holes = {made.id: made for made in _made(file, name, cuts)}
    missing = dict(bodies)
    for made in _made(file, name, bodies):
        representation = bodies[made.id]
        given = [(each.id(), own) for each, own in openings.get(made.id, ()) if each.id() in cuts]
        try:
            with Where(name, file.by_id(made.id)):
                resolved = items.resolved(representation)
                yield _shape(made, resolved, given, holes, unit, file.by_id(made.id).GlobalId, notes)
                del missing[made.id]
        except Misread:
            # told as what is missing
            pass
    for number, representation in missing.items():
        # one of lines alone has nothing to touch
        if any(_has_surface(part) for part in file.traverse(representation)):
            said = "the geometry kernel cannot make its shape; a box that holds it stands as an obstacle"
            yield Shape(number, (), None).doubted(said, bounds(representation) * unit)


@dataclass(frozen=True)
class _Made:
    """What the kernel made of a product: triangles, and for each of them the number of the item that it is of."""

    id: int
    vertices: np.ndarray
    triangles: np.ndarray
    owners: np.ndarray
    matrix: np.ndarray


def _made(file: ifcopenshell.file, name: str, bodies: Mapping[int, ifcopenshell.entity_instance]) -> Iterator[_Made]:
    """Give what the kernel makes of representations, nothing cut out; each once, and only what has triangles."""
    if not bodies:
        return
    contexts = {representation.ContextOfItems.id() for representation in bodies.values()}
    products = [file.by_id(product) for product in bodies]
    iterator = ifcopenshell.geom.iterator(_settings(contexts), file, 1, include=products)
    done: set[int] = set()
    total = 0
    more = iterator.initialize()
    while more:
        shape = iterator.get()
        # a product with two bodies in two contexts comes twice: the one that was chosen is looked for
        if shape.id in bodies and shape.id not in done and _is_of(shape.geometry.id, bodies[shape.id]):
            done.add(shape.id)
            vertices, triangles, owners = _arrays(shape.geometry)
            total += len(triangles)
            check_mesh(name, file.by_id(shape.id), vertices, total)
            if len(triangles):
                matrix = np.array(shape.transformation.matrix, dtype=float).reshape(4, 4, order="F")
                yield _Made(shape.id, vertices.copy(), triangles.copy(), owners.copy(), matrix)
        more = bool(iterator.next())
    # one that it cannot place keeps it from all others
    left = {one: body for one, body in bodies.items() if one not in done} if len(bodies) > 1 else {}
    for one, body in left.items():
        yield from _made(file, name, {one: body})


def _shape(
    made: _Made, items: list[ifcopenshell.entity_instance], openings: Sequence[tuple[int, bool]], holes: Mapping[int, _Made],
    unit: float, about: str, notes: Notes,
) -> Shape:  # fmt: skip
    bodies = tuple(_bodies(made, [] if openings else items, about, notes))
    shape = Shape(made.id, bodies, made.matrix)
    if less := _less(items, made.owners):
        said = (
            f"the geometry kernel cannot make a part of its shape ({less}); a box that holds it stands as an obstacle"
        )
        return shape.doubted(said, *(bounds(item) * unit for item in items))
    if not all(map(_is_simple, bodies)):
        return shape.doubted("parts of its shape lie within each other; its box stands as an obstacle")
    if openings:
        cut = _cut(shape, openings, holes)
        if cut is None:
            said = "its openings take nothing from it, or all of it, or cannot be cut out"
            return shape.doubted(f"{said}; its box stands as an obstacle")
        shape = replace(shape, bodies=cut)
        if (pieces := pieces_of(cut)) > 1:
            said = f"it is in {pieces} pieces that do not touch, after its openings"
            return replace(shape, doubt=f"{said}; it stands as an obstacle")
    whole = sum(body.volume for body in shape.bodies if body.is_closed)
    if whole > hull_solid(made.vertices).volume() * (1.0 + _OVERLAP):
        return shape.doubted("its bodies have more volume than the hull around them; its box stands as an obstacle")
    return shape


def _is_simple(body: Body) -> bool:
    """Return whether no part of a closed body lies within another one but as a cavity, turned inwards."""
    pieces = [Body(body.vertices, piece) for piece in _split(body.triangles)] if body.is_closed else []
    if len(pieces) < 2:
        return True
    whole, cavities = manifold3d.Manifold(), manifold3d.Manifold()
    for piece in pieces:
        found = solid(piece.vertices, piece.triangles)
        if found is None:
            return False
        if piece.volume > 0:
            whole += found
        else:
            cavities += found
    return abs((whole - cavities).volume() - body.volume) <= _ROUNDING * body.volume


def _cut(shape: Shape, openings: Sequence[tuple[int, bool]], holes: Mapping[int, _Made]) -> tuple[Body, ...] | None:
    """Return the bodies less openings; None: one cannot be cut out, or is the element's own and takes nothing away, or all."""
    solids = [one for body in shape.bodies if (one := solid(body.vertices, body.triangles)) is not None]
    if len(solids) < len(shape.bodies) or shape.model_T_shape is None:
        return None
    less = solids
    for number, own in openings:
        if number not in holes:
            return None
        hole, before = holes[number], sum(one.volume() for one in less)
        shape_T_hole = np.linalg.inv(shape.model_T_shape) @ hole.matrix
        points = hole.vertices @ shape_T_hole[:3, :3].T + shape_T_hole[:3, 3]
        middle, size = 0.5 * (points.max(axis=0) + points.min(axis=0)), np.ptp(points, axis=0).max()
        points = middle + (points - middle) * (1.0 + 2 * _GROWN / size)
        for owner in np.unique(hole.owners):
            tool = solid(points, hole.triangles[hole.owners == owner])
            if tool is None:
                return None
            less = [one - tool for one in less]
        if own and sum(one.volume() for one in less) > before * (1.0 - _SHRUNK):
            return None
    made_of = [mesh_of(one) for one in less if one.volume() > _CRUMB]
    return tuple(Body(vertices, triangles.astype(np.int32)) for vertices, triangles in made_of) or None


def pieces_of(bodies: Sequence[Body]) -> int:
    """Return into how many pieces that do not touch each other the closed ones of these bodies fall."""
    solids = [one for body in bodies if (one := solid(body.vertices, body.triangles)) is not None]
    # the wall of a cavity is turned inwards
    pieces = [piece for one in solids for piece in one.decompose() if piece.volume() > _CRUMB]
    touching = np.array([[one.min_gap(other, 2 * _TOUCH) <= _TOUCH for other in pieces] for one in pieces], dtype=bool)
    return int(connected_components(touching, directed=False)[0]) if pieces else 0


def _less(items: list[ifcopenshell.entity_instance], owners: np.ndarray) -> str:
    """Return the items with a surface that gave no triangle, as ``#12=IFCEXTRUDEDAREASOLID``; empty: there is none."""
    made = set(owners.tolist())
    missing = [label(item) for item in items if _has_surface(item) and made.isdisjoint(_numbers(item))]
    return ", ".join(dict.fromkeys(missing[:3]))


def _has_surface(item: ifcopenshell.entity_instance) -> bool:
    return any(item.is_a(kind) for kind in _SURFACES)


def _numbers(item: ifcopenshell.entity_instance) -> set[int]:
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
    settings.set("disable-opening-subtractions", True)
    # in 2D, what is cut away whole stands whole
    settings.set("boolean-attempt-2d", False)
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
    """Check what the kernel made."""
    what = f"element {product.GlobalId!r}"
    if total > MOST_TRIANGLES:
        raise BuildingError(name, what, f"more than {MOST_TRIANGLES} triangles up to it", "less")
    if len(vertices) and not (np.isfinite(vertices).all() and np.abs(vertices).max() <= FARTHEST):
        raise BuildingError(name, what, "corners that are no finite numbers, or too far", f"at most {FARTHEST:g} m")


def _bodies(made: _Made, items: list[ifcopenshell.entity_instance], about: str, notes: Notes) -> Iterator[Body]:
    copies = Counter(item.id() for item in items)
    for owner in dict.fromkeys(made.owners.tolist()):
        part = made.triangles[made.owners == owner]
        # the same item, mapped several times
        for each in _split(part) if copies[owner] > 1 else [part]:
            used, corners = np.unique(each, return_inverse=True)
            body = _oriented(made.vertices[used], corners.reshape(-1, 3).astype(np.int32), about, notes)
            if body is not None:
                yield body


def _split(triangles: np.ndarray) -> list[np.ndarray]:
    count = int(triangles.max()) + 1
    ends = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    graph = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, component = connected_components(graph, directed=False)
    of = component[triangles[:, 0]]
    return [triangles[of == each] for each in np.unique(of)]


def _oriented(vertices: np.ndarray, triangles: np.ndarray, about: str, notes: Notes) -> Body | None:
    body = _welded(vertices, triangles)
    if len(body.triangles) and not body.is_closed:
        notes.add("Bodies that are not closed (their triangles stand as they are, without a volume)", about)
        return body
    enclosed = body.volume
    if abs(enclosed) < 1e-15:
        notes.add("Bodies without any extent are left out", about)
        return None
    return body if enclosed > 0 else Body(body.vertices, np.ascontiguousarray(body.triangles[:, ::-1]))


def _welded(vertices: np.ndarray, triangles: np.ndarray) -> Body:
    """Vertices at the same place are one; triangles that have two corners there are none."""
    places, index = np.unique(vertices, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[triangles].astype(np.int32)
    a, b, c = triangles.T
    return Body(places, np.ascontiguousarray(triangles[(a != b) & (b != c) & (c != a)]))


# -- representations


def body_of(product: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
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


class Items:
    """Items of the representations of a file."""

    def __init__(self, name: str):
        self._name = name
        self._counts: dict[int, int] = {}

    def check(self, representation: ifcopenshell.entity_instance) -> None:
        """Check that a representation is no loop and of bounded size."""
        self._count(representation, ())

    def _count(self, node: ifcopenshell.entity_instance, path: tuple[int, ...]) -> int:
        if (known := self._counts.get(node.id())) is not None:
            return known
        if node.id() in path:
            raise BuildingError(self._name, label(node), "geometry that contains itself", "geometry without a loop")
        if len(path) >= DEEPEST:
            raise BuildingError(self._name, label(node), f"geometry nested {DEEPEST} deep", "less")
        count = 1
        with Where(self._name, node):
            parts = _parts(node)
        for part in parts:
            count += self._count(part, (*path, node.id()))
            if count > MOST_ITEMS:
                raise BuildingError(self._name, label(node), f"more than {MOST_ITEMS} items by mapping", "less")
        self._counts[node.id()] = count
        return count

    def resolved(self, representation: ifcopenshell.entity_instance) -> list[ifcopenshell.entity_instance]:
        """Return the items of a representation that was checked, those of mapped items in their place."""
        with Where(self._name, representation):
            return list(_resolved(representation))


def _parts(node: ifcopenshell.entity_instance) -> tuple[ifcopenshell.entity_instance, ...]:
    if node.is_a("IfcShapeModel"):
        return tuple(node.Items)
    if node.is_a("IfcMappedItem"):
        return (node.MappingSource.MappedRepresentation,)
    if node.is_a("IfcBooleanResult"):
        return (node.FirstOperand, node.SecondOperand)
    if node.is_a("IfcCsgSolid"):
        return (node.TreeRootExpression,)
    return ()


def _resolved(representation: ifcopenshell.entity_instance) -> Iterator[ifcopenshell.entity_instance]:
    for item in representation.Items:
        if item.is_a("IfcMappedItem"):
            yield from _resolved(item.MappingSource.MappedRepresentation)
        else:
            yield item


def bounds(node: ifcopenshell.entity_instance) -> np.ndarray:
    """Return the lowest and highest coordinates of a representation or one of its items [unit of the file], shape (2, 3).

    What flat faces bound is as large as its points; of other items see `reach`.
    """
    if node.is_a("IfcRepresentation"):
        boxes = [bounds(item) for item in node.Items]
        return np.array([np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))]) if boxes else np.zeros((2, 3))
    points = list(_points(node)) if any(node.is_a(kind) for kind in _FLAT) else []
    if not points:
        return reach(node) * np.array([[-1.0] * 3, [1.0] * 3])
    return np.array([np.min(points, axis=0), np.max(points, axis=0)])


def _points(value: object) -> Iterator[tuple[float, ...]]:
    if isinstance(value, tuple):
        for each in value:
            yield from _points(each)
    elif isinstance(value, ifcopenshell.entity_instance):
        if value.is_a("IfcCartesianPoint"):
            yield value.Coordinates
        elif value.is_a("IfcCartesianPointList3D"):
            yield from value.CoordList
        else:
            yield from _points(tuple(value))


def reach(node: ifcopenshell.entity_instance, known: dict[int, float] | None = None) -> float:
    """Return how far from its origin a representation or one of its items reaches at most, in the file's units.

    Points, lengths and axes of what is nested are added, of what is side by side the largest counts, a half space only cuts. Far
    too large for most, too small only for a line that is cut by its parameters.
    """
    known = {} if known is None else known
    if node.id() == 0 or any(node.is_a(kind) for kind in _NO_REACH):
        return 0.0
    if node.id() in known:
        return known[node.id()]
    found, scale = 0.0, 1.0
    for name, value in node.get_info(include_identifier=False).items():
        if isinstance(value, ifcopenshell.entity_instance):
            if value.is_a("IfcCartesianTransformationOperator"):
                scale = max(abs(getattr(value, each, None) or 1.0) for each in ("Scale", "Scale2", "Scale3"))
            # what is turned about an axis reaches beyond it
            found += reach(value, known) * (2.0 if value.is_a("IfcAxis1Placement") else 1.0)
        elif isinstance(value, tuple):
            found += max((_reach_of(each, name, known) for each in value), default=0.0)
        elif isinstance(value, float) and not any(word in name for word in ("Angle", "Param", "Scale")):
            found += abs(value)
    known[node.id()] = found * max(1.0, scale)
    return known[node.id()]


def _reach_of(value: object, name: str, known: dict[int, float]) -> float:
    if isinstance(value, ifcopenshell.entity_instance):
        return reach(value, known)
    if isinstance(value, tuple):
        return max((_reach_of(each, name, known) for each in value), default=0.0)
    # the largest coordinate of a point is within its distance
    return 2.0 * abs(value) if isinstance(value, float) and name.startswith("Coord") else 0.0
