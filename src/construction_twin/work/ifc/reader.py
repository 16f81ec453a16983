"""An IFC file as a `BuildingModel`, in this process: for the child that reads files, and for tests.

A broken file can end this process (the geometry kernel is C++); `reading.read_building` reads in another one.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import numpy as np

from construction_twin.core.files import read_file
from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import BuildingError
from construction_twin.kinematics.chain import Pose
from construction_twin.work.building import Body, BuildingModel, Element, Task
from construction_twin.work.ifc.geometry import MISSING_CODE, NO_UNIT_CODES, Shape, shapes
from construction_twin.work.ifc.notes import Notes, Where
from construction_twin.work.ifc.placements import Placements, check_rigid
from construction_twin.work.ifc.properties import read_mass, read_material, read_properties, read_status
from construction_twin.work.ifc.relations import Relations, read_relations
from construction_twin.work.ifc.representations import body_of
from construction_twin.work.ifc.step_text import check_whole, first_error, in_ascii, kernel_says, note_parser_log
from construction_twin.work.ifc.tasks import Groups, read_tasks, unique_id
from construction_twin.work.ifc.units import Units, read_units
from construction_twin.work.ifc.unread import note_unread
from construction_twin.work.mesh_checks import volume
from construction_twin.work.wholes import in_one_piece
from construction_twin.work.workpieces import is_workpiece

#: Takes what is being done, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]

SCHEMAS = ("IFC2X3", "IFC4", "IFC4X3")
#: Elements of a file.
MOST_ELEMENTS = 100_000
#: An element farther from the model's origin than this [m] is told: map coordinates in a placement.
_FAR = 10_000.0
#: Products with geometry that nothing can touch: holes, rooms, drawings, loads.
_NOT_THERE = (
    "IfcFeatureElementSubtraction",
    "IfcVirtualElement",
    "IfcSpace",
    "IfcSpatialZone",
    "IfcExternalSpatialElement",
    "IfcExternalSpatialStructureElement",
)
_STATUS = {
    "existing": Sentence("ifc.note.existing"),
    "demolish": Sentence("ifc.note.demolish"),
}
#: What says where something is, what shape it has or in which unit; and what of that only says how it looks.
_GEOMETRY = (
    *(
        "IfcObjectPlacement",
        "IfcRepresentationItem",
        "IfcRepresentation",
        "IfcProductRepresentation",
        "IfcRepresentationMap",
    ),
    *(
        "IfcProfileDef",
        "IfcUnitAssignment",
        "IfcNamedUnit",
        "IfcDerivedUnit",
        "IfcDerivedUnitElement",
        "IfcMeasureWithUnit",
    ),
)
_LOOKS = (
    "IfcStyledItem",
    "IfcStyledRepresentation",
    "IfcPresentationItem",
    "IfcAnnotationOccurrence",
    "IfcFillAreaStyleTiles",
)
_SPATIAL = ("IfcSpatialElement", "IfcSpatialStructureElement")


@dataclass(frozen=True)
class _Found:
    """What is common to the reading of all elements."""

    name: str
    units: Units
    relations: Relations
    notes: Notes


def read_ifc(path: str | Path, most_bytes: int, progress: Progress = lambda *_: None) -> BuildingModel:
    """Read a file.

    Args:
        most_bytes: Largest file.

    Raises BuildingError.
    """
    name = Path(path).name
    progress("open", 0, 1)
    contents = _contents(path, name, most_bytes)
    digest = hashlib.sha256(contents).hexdigest()
    check_whole(contents, name)
    notes = Notes()
    # what other files left in it is not of this one
    ifcopenshell.get_log()
    read = in_ascii(contents, notes)
    if read is contents:
        file = _open(path, name)
        if hashlib.sha256(_contents(path, name, most_bytes)).hexdigest() != digest:
            raise BuildingError(
                name, Sentence("ifc.file"), Sentence("ifc.found.changed"), Sentence("ifc.nobody_writes")
            )
    else:
        file = _open_copy(read, name)
    schema = file.schema
    if schema not in SCHEMAS:
        raise BuildingError(name, Sentence("ifc.schema"), str(schema), ", ".join(SCHEMAS))
    with Where(name, Sentence("ifc.file")):
        note_parser_log(
            ifcopenshell.get_log(), read, set(file.entity_names()),
            lambda number: getattr(file.by_id(number), "GlobalId", "") or "",
            lambda number: _is_geometry(file.by_id(number)), name, schema, notes,
        )  # fmt: skip
    # it can be large, and the geometry needs room
    del contents, read
    progress("open", 1, 1)
    found = _Found(name, read_units(file, name, notes), read_relations(file, name), notes)
    _note_map(file, found)
    _note_origin(file, found)
    elements, ids = _elements(file, found, progress)
    note_unread(file, name, elements, notes)
    given, groups = _given(elements), Groups(found.relations, ids, notes)
    tasks, sequences = read_tasks(file, name, groups, given, found.units, notes)
    elements |= groups.elements
    elements |= _in_one_piece(file, elements, ids, tasks, found)
    project = file.by_type("IfcProject")[0]
    with Where(name, project):
        title = project.Name or getattr(project, "LongName", None) or ""
    names = {one: element.name for one, element in elements.items()} | {one: task.name for one, task in tasks.items()}
    return BuildingModel(
        name, digest, schema, title, found.units.length, elements, tasks, sequences, notes.sentences(names),
        notes.remarks({*elements, *tasks}),
    )  # fmt: skip


def _given(elements: dict[str, Element]) -> set[str]:
    """Return what a task that it is given to builds: workpieces, and assemblies without a body of which they are parts."""
    parents = {element.assembly for element in elements.values()}
    found = {element.id for element in elements.values() if is_workpiece(element, element.id in parents)}
    for name in list(found):
        whole = elements[name].assembly
        while whole in elements and not elements[whole].bodies and whole not in found:
            found.add(whole)
            whole = elements[whole].assembly
    return found


def _in_one_piece(
    file: ifcopenshell.file, elements: dict[str, Element], ids: dict[int, str], tasks: dict[str, Task], found: _Found
) -> dict[str, Element]:
    """Return what comes in one piece, as `in_one_piece` does, and note it."""
    with Where(found.name, Sentence("ifc.file")):
        factory = {
            ids[each.id()]
            for each in file.by_type("IfcElementAssembly")
            if each.AssemblyPlace == "FACTORY" and each.id() in ids
        }
    changed = in_one_piece(elements, tasks, factory)
    for name, element in changed.items():
        if element.bodies:
            found.notes.add(Sentence("ifc.note.one_piece"), element.name or name, name)
            if element.mass is None:
                found.notes.add(Sentence("ifc.note.one_piece_mass"), element.name or name, name)
    return changed


def _is_geometry(entity: ifcopenshell.entity_instance) -> bool:
    """Return whether an entity says where something is, what shape it has or in which unit; of a product: what it says is lost."""
    if _is(entity, "IfcProduct"):
        return entity.ObjectPlacement is None or entity.Representation is None
    return any(_is(entity, kind) for kind in _GEOMETRY) and not any(_is(entity, kind) for kind in _LOOKS)


def _contents(path: str | Path, name: str, most_bytes: int) -> bytes:
    try:
        return read_file(path, most_bytes)
    except OSError as error:
        raise BuildingError(
            name, Sentence("ifc.file"), error.strerror or str(error), Sentence("ifc.readable")
        ) from error


def _open_copy(contents: bytes, name: str) -> ifcopenshell.file:
    """Parse what is not the file's own contents; no file of it is left, however this process ends."""
    copy = os.memfd_create("ifc")
    with os.fdopen(copy, "wb") as written:
        written.write(contents)
        written.flush()
        return _open(f"/proc/self/fd/{copy}", name)


def _open(path: str | Path, name: str) -> ifcopenshell.file:
    try:
        with Where(name, Sentence("ifc.file")):
            file = ifcopenshell.open(str(path), format=".ifc")
            entities = len(file.types())
    except BuildingError as error:
        expected = Sentence("ifc.published", schemas=", ".join(SCHEMAS))
        why = first_error(ifcopenshell.get_log())
        raise BuildingError(
            name,
            Sentence("ifc.file"),
            Sentence("building.part", file=error.found, what=why) if why else error.found,
            expected,
        ) from error
    if entities == 0:
        raise BuildingError(name, Sentence("ifc.file"), Sentence("ifc.found.no_entities"), Sentence("ifc.a_file"))
    return file


def _note_map(file: ifcopenshell.file, found: _Found) -> None:
    if file.schema == "IFC2X3":
        return
    for conversion in file.by_type("IfcMapConversion"):
        with Where(found.name, conversion):
            shift = [conversion.Eastings, conversion.Northings, conversion.OrthogonalHeight]
            turned = (conversion.XAxisOrdinate or 0.0) != 0.0
        shown = ", ".join(f"{value:.3f}" for value in shift)
        found.notes.add(Sentence("ifc.note.map_turned" if turned else "ifc.note.map", shift=shown))


def _note_origin(file: ifcopenshell.file, found: _Found) -> None:
    """Note where the coordinate system of the model's context is elsewhere than that of its placements."""
    for context in file.by_type("IfcGeometricRepresentationContext", include_subtypes=False):
        with Where(found.name, context):
            system = context.WorldCoordinateSystem
            if context.ContextType != "Model" or system is None or not system.is_a("IfcAxis2Placement3D"):
                continue
            matrix = np.array(ifcopenshell.util.placement.get_axis2placement(system), dtype=float)
        if not np.allclose(matrix, np.eye(4), atol=1e-9):
            shift = ", ".join(f"{value * found.units.length:.3f}" for value in matrix[:3, 3])
            turned = not np.allclose(matrix[:3, :3], np.eye(3), atol=1e-9)
            found.notes.add(Sentence("ifc.note.origin_turned" if turned else "ifc.note.origin", shift=shift))


def _elements(file: ifcopenshell.file, found: _Found, progress: Progress) -> tuple[dict[str, Element], dict[int, str]]:
    products = _products(file, found)
    placements = Placements(found.name, found.units.length)
    ids: dict[int, str] = {}
    taken: set[str] = set()
    matrices: dict[int, np.ndarray | None] = {}
    bodies: dict[int, ifcopenshell.entity_instance] = {}
    for product in products:
        with Where(found.name, product):
            ids[product.id()] = unique_id(product, taken, found.notes)
            taken.add(ids[product.id()])
            matrices[product.id()] = placements.matrix(product)
            if (body := body_of(product)) is not None:
                bodies[product.id()] = body
                _note_more(product, body, ids[product.id()], found.notes)
    cut = frozenset(
        product.id()
        for product in products
        if any(each.id() in found.relations.openings for each in (product, *found.relations.wholes(product)))
    )
    made = {
        shape.id: shape
        for shape in shapes(
            file, found.name, bodies, cut, found.units.length, found.notes,
            lambda done, total: progress("geometry", done, total),
        )
    }  # fmt: skip
    _take_kernel_log(file, found.name, made, found.notes)
    elements = {}
    for count, product in enumerate(products):
        if count % 100 == 0:
            progress("elements", count, len(products))
        if product.id() in bodies and (product.id() not in made or not made[product.id()].bodies):
            found.notes.add(Sentence("ifc.note.no_geometry"), ids[product.id()])
        if product.id() in made and (doubt := made[product.id()].doubt):
            sentence = Sentence("ifc.note.doubtful", doubt=doubt)
            found.notes.add(sentence, product.Name or ids[product.id()], ids[product.id()])
        with Where(found.name, product):
            element = _element(product, ids, matrices[product.id()], made.get(product.id()), found)
        if element is not None:
            elements[element.id] = element
    progress("elements", len(products), len(products))
    _hand_down_status(elements, found.notes)
    return _without_doubles(elements, found.notes), {
        entity: element for entity, element in ids.items() if element in elements
    }


def _note_more(
    product: ifcopenshell.entity_instance, body: ifcopenshell.entity_instance, element_id: str, notes: Notes
) -> None:
    """Note what else a product says of its shape: bodies beside the one that is taken, openings without one."""
    about = product.Name or element_id
    same = [
        each
        for each in product.Representation.Representations
        if (each.RepresentationIdentifier, each.ContextOfItems) == (body.RepresentationIdentifier, body.ContextOfItems)
    ]
    if len(same) > 1:
        notes.add(
            Sentence("ifc.note.more_bodies", count=len(same)),
            about,
            element_id,
        )
    voids = getattr(product, "HasOpenings", None) or ()
    if any(body_of(relation.RelatedOpeningElement) is None for relation in voids):
        notes.add(Sentence("ifc.note.openings"), about, element_id)


def _take_kernel_log(file: ifcopenshell.file, file_name: str, made: dict[int, Shape], notes: Notes) -> None:
    """Note what the kernel said of shapes; where a part of one is missing, it is doubted as a whole.

    Raises:
        BuildingError: If the kernel does not know in which unit the lengths are.
    """
    for said in kernel_says(ifcopenshell.get_log()):
        if said.code in NO_UNIT_CODES:
            raise BuildingError(file_name, Sentence("ifc.project_units"), said.sentence, Sentence("ifc.kernel_unit"))
        if said.about:
            try:
                number = file.by_guid(said.about).id()
            except RuntimeError:
                number = 0
            shape = made.get(number)
            if shape is not None and not shape.doubt and said.code == MISSING_CODE:
                made[number] = shape.doubted(Sentence("ifc.doubt.missing"))
            elif shape is not None and not shape.doubt and said.is_error:
                made[number] = replace(shape, doubt=Sentence("ifc.doubt.with_error", problem=said.sentence))
        notes.add(Sentence("ifc.note.kernel", problem=said.sentence), said.about)


def _products(file: ifcopenshell.file, found: _Found) -> list[ifcopenshell.entity_instance]:
    products = []
    # by_type gives one class after the other, and numbers are the file's order
    for product in sorted(file.by_type("IfcProduct"), key=lambda product: product.id()):
        with Where(found.name, product):
            if any(_is(product, kind) for kind in _NOT_THERE):
                continue
            spatial = any(_is(product, kind) for kind in _SPATIAL)
            if _is(product, "IfcElement") or ((spatial or _is(product, "IfcProxy")) and body_of(product) is not None):
                products.append(product)
    if len(products) > MOST_ELEMENTS:
        raise BuildingError(
            found.name,
            Sentence("ifc.elements"),
            str(len(products)),
            Sentence("ifc.at_most_elements", most=MOST_ELEMENTS),
        )
    return products


def _is(product: ifcopenshell.entity_instance, kind: str) -> bool:
    # a class that the schema does not know is none of its entities'
    return bool(product.is_a(kind))


def _element(
    product: ifcopenshell.entity_instance,
    ids: dict[int, str],
    matrix: np.ndarray | None,
    shape: Shape | None,
    found: _Found,
) -> Element | None:
    element_id = ids[product.id()]
    bodies: tuple[Body, ...] = ()
    if matrix is None:
        if shape is None:
            found.notes.add(Sentence("ifc.note.grid_without_body"), element_id)
            return None
        matrix = shape.model_T_shape
        check_rigid(found.name, product, matrix)
        found.notes.add(Sentence("ifc.note.grid"), element_id)
    if shape is not None:
        bodies = _in_frame(shape, matrix)
        if product.ObjectPlacement is None:
            found.notes.add(
                Sentence("ifc.note.no_placement"),
                product.Name or element_id,
                element_id,
            )
    if np.abs(matrix[:3, 3]).max() > _FAR:
        found.notes.add(Sentence("ifc.note.far"), element_id)
    doubt = "" if shape is None else shape.doubt
    properties = read_properties(product, element_id, found.units, found.notes)
    material = read_material(product, element_id, found.notes)
    kind = ifcopenshell.util.element.get_type(product)
    assembly = next((ids[whole.id()] for whole in found.relations.wholes(product) if whole.id() in ids), "")
    return Element(
        id=element_id,
        ifc_class=product.is_a(),
        name=product.Name or "",
        type_name=(kind.Name if kind is not None else product.ObjectType) or "",
        tag=getattr(product, "Tag", None) or "",
        storey=found.relations.storey(product),
        material=material,
        assembly=assembly,
        model_T_element=Pose(matrix[:3, 3].copy(), matrix[:3, :3].copy()),
        bodies=bodies,
        properties=properties,
        mass=read_mass(product, element_id, properties, material, () if doubt else bodies, found.units, found.notes),
        status=read_status(product, element_id, properties, found.notes),
        doubt=doubt,
        on=tuple(ids[host.id()] for host in found.relations.on.get(product.id(), ()) if host.id() in ids),
    )


def _in_frame(shape: Shape, matrix: np.ndarray) -> tuple[Body, ...]:
    """Bodies in the frame of the placement, where the kernel has another one."""
    offset = np.linalg.inv(matrix) @ shape.model_T_shape
    if np.allclose(offset, np.eye(4), atol=1e-6):
        return shape.bodies
    return tuple(
        replace(body, vertices=body.vertices @ offset[:3, :3].T + offset[:3, 3], extrusion=None)
        for body in shape.bodies
    )


def _hand_down_status(elements: dict[str, Element], notes: Notes) -> None:
    """Give parts the status of the nearest whole that has one; note what is not to be made. What is new has none in the end."""
    said = {name: element.status for name, element in elements.items()}
    for name, element in elements.items():
        status, whole = element.status, element.assembly
        while not status and whole in elements:
            status, whole = said[whole], elements[whole].assembly
        status = "" if status == "new" else status
        elements[name] = replace(element, status=status)
        if status:
            notes.add(_STATUS[status], element.name or name, name)


def _without_doubles(elements: dict[str, Element], notes: Notes) -> dict[str, Element]:
    """An element whose parts fill it has their bodies and none of its own: it would stand where they are to be placed."""
    filled: dict[str, float] = {}
    for element in elements.values():
        if element.assembly:
            filled[element.assembly] = filled.get(element.assembly, 0.0) + _volume(element)
    for whole, parts in filled.items():
        own = _volume(elements[whole]) if whole in elements else 0.0
        if own > 0 and parts >= own / 2:
            notes.add(Sentence("ifc.note.parts"), whole)
            elements[whole] = replace(elements[whole], bodies=())
    return elements


def _volume(element: Element) -> float:
    return sum(abs(volume(body.vertices, body.triangles)) for body in element.bodies)
