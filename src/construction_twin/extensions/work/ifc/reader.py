"""An IFC file as a `BuildingModel`, in this process: for the child that reads files, and for tests.

A broken file can end this process (the geometry kernel is C++); `reading.read_building` reads in another one.
"""

from __future__ import annotations

import codecs
import hashlib
import os
import re
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import numpy as np

from construction_twin.core.files import read_file
from construction_twin.extensions.work.building import (
    Body,
    BuildingError,
    BuildingModel,
    Element,
    Task,
    in_one_piece,
    is_workpiece,
    wholes,
)
from construction_twin.extensions.work.ifc.entities import (
    read_mass,
    read_properties,
    read_relations,
    read_status,
    read_units,
)
from construction_twin.extensions.work.ifc.geometry import NO_UNIT_CODES, Shape, body_of, bounds, shapes
from construction_twin.extensions.work.ifc.notes import (
    ABOUT_ALL,
    Doubts,
    MisreadError,
    Notes,
    ReadingEntity,
    label,
    parse_log,
)
from construction_twin.extensions.work.ifc.tasks import Groups, read_tasks, unique_id
from construction_twin.kinematics.chain import Pose

_Entity = ifcopenshell.entity_instance
#: Schemas as the parser calls them: their last publication.
SCHEMAS = {"IFC2X3": b"IFC2X3", "IFC4": b"IFC4", "IFC4X3": b"IFC4X3_ADD2"}
_SCHEMA = re.compile(rb"FILE_SCHEMA\s*\(\s*\(\s*'([^']*)'")
#: Farther from the origin [m] no model is; map coordinates reach 1e7.
FARTHEST = 1e8


class Placements:
    """Placements of a file, each computed once; `unit`: metres per length unit."""

    def __init__(self, name: str, unit: float):
        self._name, self._unit = name, unit
        self._known: dict[int, np.ndarray | None] = {}

    def matrix(self, placement: _Entity | None, inside: tuple[int, ...] = ()) -> np.ndarray | None:
        """Return ``model_T_element`` [m], shape (4, 4); None: on a grid or alignment, which the kernel knows."""
        if placement is None:
            return np.eye(4)
        if placement.id() in inside:
            found = "placed relative to itself"
            raise BuildingError(self._name, label(placement), found, "placements without a loop")
        if placement.id() not in self._known:
            matrix = None
            with ReadingEntity(self._name, placement), np.errstate(all="ignore"):
                if placement.is_a("IfcLocalPlacement"):
                    matrix = self.matrix(placement.PlacementRelTo, (*inside, placement.id()))
                if matrix is not None:
                    matrix = matrix @ self._relative(placement)
                    check_rigid(self._name, placement, matrix)
            self._known[placement.id()] = matrix
        return self._known[placement.id()]

    def _relative(self, placement: _Entity) -> np.ndarray:
        relative = np.array(ifcopenshell.util.placement.get_axis2placement(placement.RelativePlacement), dtype=float)
        relative[:3, 3] *= self._unit
        # IFC's x axis is the given one projected at right angles to z
        relative[:3, 0] = np.cross(relative[:3, 1], relative[:3, 2])
        return relative


def check_rigid(name: str, entity: object, matrix: np.ndarray) -> None:
    """Check that a matrix is a rotation and a shift that a building can have."""
    if not np.isfinite(matrix).all() or not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-6):
        found = "axes or a location that are no placement"
        raise BuildingError(name, label(entity), found, "finite, axes not parallel")
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        far = f"{float(np.abs(matrix[:3, 3]).max()):g} m from the origin"
        raise BuildingError(name, label(entity), far, f"at most {FARTHEST:g} m")


#: Entities whose meaning the work would need, and what is not done with them.
_UNREAD = {
    "IfcWorkCalendar": "calendars: lags and durations count around the clock",
    "IfcTaskTimeRecurring": "times of tasks that are repeated: only the first is read",
    "IfcEvent": "events: what comes after one does not wait until it has happened",
    "IfcProcedure": "procedures: what comes after one does not wait until it is done",
}


#: Elements of a file.
MOST_ELEMENTS = 100_000
#: Products with geometry that nothing can touch: holes, rooms, drawings, loads.
_NOT_THERE = (
    *("IfcFeatureElementSubtraction", "IfcVirtualElement", "IfcSpace", "IfcSpatialZone", "IfcExternalSpatialElement"),
    "IfcExternalSpatialStructureElement",
)
_STATUS = {
    "existing": "Existing elements: obstacles, never placed",
    "demolish": "Elements to be taken down: obstacles until a person says that they are gone (`twin work removed`)",
}
#: What is an element only with a body.
_WITH_BODY = ("IfcSpatialElement", "IfcSpatialStructureElement", "IfcProxy")


class _Reader:
    def __init__(self, file: ifcopenshell.file, name: str, notes: Notes, doubts: Doubts):
        self.file, self.name, self.notes, self.doubts = file, name, notes, doubts
        self.units, self.relations = read_units(file, name, notes), read_relations(file, name)
        #: Ids by the numbers of the products.
        self.ids: dict[int, str] = {}

    def record_ignored_coordinates(self) -> None:
        """Note ignored coordinate systems."""
        if self.file.schema != "IFC2X3" and self.file.by_type("IfcMapConversion"):
            self.notes.add("The map conversion is left out: poses are the model's own")
        for context in self.file.by_type("IfcGeometricRepresentationContext", include_subtypes=False):
            with ReadingEntity(self.name, context):
                system = context.WorldCoordinateSystem
                if context.ContextType != "Model" or system is None or not system.is_a("IfcAxis2Placement3D"):
                    continue
                matrix = np.array(ifcopenshell.util.placement.get_axis2placement(system), dtype=float)
            if not np.allclose(matrix, np.eye(4), atol=1e-9):
                self.notes.add("The context's world coordinate system is left out: poses are those of the placements")

    def elements(self) -> dict[str, Element]:
        """Return the elements by their ids."""
        products = self._products()
        placements = Placements(self.name, self.units.length)
        used_ids: set[str] = set()
        matrices: dict[int, np.ndarray | None] = {}
        bodies: dict[int, _Entity] = {}
        for product in products:
            with ReadingEntity(self.name, product):
                self.ids[product.id()] = unique_id(product, used_ids, self.notes)
                used_ids.add(self.ids[product.id()])
                try:
                    matrices[product.id()] = placements.matrix(product.ObjectPlacement)
                except MisreadError as error:
                    # it stands nobody knows where
                    matrices[product.id()] = None
                    self.doubts.everything = f"{ABOUT_ALL}: {error}"
                if (body := body_of(product)) is not None:
                    bodies[product.id()] = body
                    self._record_ignored_shapes(product, body, self.ids[product.id()])
        openings = {
            product.id(): [
                opening
                for each in (product, *self.relations.wholes(product))
                for opening in self.relations.openings.get(each.id(), ())
            ]
            for product in products
        }
        unit, notes = self.units.length, self.notes
        found = shapes(self.file, self.name, bodies, openings, unit, notes, self._record_kernel_log)
        shape_of = {shape.id: shape for shape in found}
        for number, shape in shape_of.items():
            if not shape.doubt and number in self.doubts.shapes:
                shape_of[number] = shape.doubted(self.doubts.shapes[number], bounds(bodies[number]) * self.units.length)
        elements = {}
        for product in products:
            with ReadingEntity(self.name, product):
                element = self._element(product, matrices[product.id()], shape_of.get(product.id()))
            if element is not None:
                elements[element.id] = element
        if self.doubts.everything:
            elements = {
                one: replace(each, doubt=each.doubt or self.doubts.everything) for one, each in elements.items()
            }
        for one, element in elements.items():
            if element.doubt:
                sentence = f"THE BODY IS DOUBTFUL: {element.doubt}, the arm does not place it"
                self.notes.add(sentence, element.name or one)
        _hand_down_status(elements, self.notes)
        _leave_out_doubles(elements, self.notes)
        self.ids = {entity: element for entity, element in self.ids.items() if element in elements}
        return elements

    def _record_ignored_shapes(self, product: _Entity, body: _Entity, element_id: str) -> None:
        about = product.Name or element_id
        same = [
            each
            for each in product.Representation.Representations
            if (each.RepresentationIdentifier, each.ContextOfItems)
            == (body.RepresentationIdentifier, body.ContextOfItems)
        ]
        if len(same) > 1:
            said = f"Elements with {len(same)} bodies of one kind, of which only the first is taken"
            self.notes.add(said, about)
        if any(body_of(opening) is None for opening in self.relations.openings.get(product.id(), ())):
            self.notes.add("Openings without a body are not cut out", about)

    def _record_kernel_log(self, product: _Entity) -> None:
        for entry in parse_log(ifcopenshell.get_log()):
            if entry.code in NO_UNIT_CODES:
                expected = "a unit of length of the SI, or converted to that in one step"
                raise BuildingError(self.name, "units of the project", entry.text, expected)
            self.doubts.add({product.id(), *entry.numbers}, entry.text)
            self.notes.add(f"The geometry kernel says: {entry.text}", self.ids.get(product.id(), product.GlobalId))

    def _products(self) -> list[_Entity]:
        products = []
        # by_type gives one class after the other, and numbers are the file's order
        for product in sorted(self.file.by_type("IfcProduct"), key=lambda product: product.id()):
            with ReadingEntity(self.name, product):
                if any(product.is_a(kind) for kind in _NOT_THERE):
                    continue
                has_body = any(product.is_a(kind) for kind in _WITH_BODY) and body_of(product) is not None
                if product.is_a("IfcElement") or has_body:
                    products.append(product)
        if len(products) > MOST_ELEMENTS:
            raise BuildingError(self.name, "elements", str(len(products)), f"at most {MOST_ELEMENTS}")
        return products

    def _element(self, product: _Entity, matrix: np.ndarray | None, shape: Shape | None) -> Element | None:
        element_id = self.ids[product.id()]
        bodies: tuple[Body, ...] = ()
        if matrix is None:
            if shape is None or shape.model_T_shape is None:
                sentence = "Placed on a grid or an alignment, without a body: left out"
                self.notes.add(sentence, element_id)
                if shape is not None:
                    self.doubts.everything = f"{ABOUT_ALL}: {sentence}"
                return None
            matrix = shape.model_T_shape
            check_rigid(self.name, product, matrix)
            self.notes.add("Placed on a grid or an alignment, as the geometry kernel says", element_id)
        if shape is not None:
            bodies = shape.bodies
            # the kernel can have another frame
            offset = np.eye(4) if shape.model_T_shape is None else np.linalg.inv(matrix) @ shape.model_T_shape
            if not np.allclose(offset, np.eye(4), atol=1e-6):
                turn, shift = offset[:3, :3], offset[:3, 3]
                bodies = tuple(Body(body.vertices @ turn.T + shift, body.triangles) for body in bodies)
            if product.ObjectPlacement is None:
                sentence = "HAS A BODY AND NO PLACEMENT: where it is nobody says, taken at the model's origin"
                self.notes.add(sentence, product.Name or element_id)
        doubt = "" if shape is None else shape.doubt
        if not doubt and (unknown := self.doubts.shapes.get(product.id())):
            # it can have a body that nobody knows
            doubt = self.doubts.everything = unknown
        above = self.relations.wholes(product)
        doubt = doubt or next((why for each in (product, *above) if (why := self.doubts.related.get(each.id()))), "")
        properties = read_properties(product, element_id, self.units, self.notes)
        kind = ifcopenshell.util.element.get_type(product)
        assembly = next((self.ids[whole.id()] for whole in above if whole.id() in self.ids), "")
        mass = read_mass(product, element_id, properties, () if doubt else bodies, self.units, self.notes)
        return Element(
            id=element_id,
            ifc_class=product.is_a(),
            name=product.Name or "",
            type_name=(kind.Name if kind is not None else product.ObjectType) or "",
            tag=getattr(product, "Tag", None) or "",
            assembly=assembly,
            model_T_element=Pose(matrix[:3, 3].copy(), matrix[:3, :3].copy()),
            bodies=bodies,
            properties=properties,
            mass=mass,
            status=read_status(product, element_id, properties, self.notes),
            doubt=doubt,
            on=tuple(self.ids[host.id()] for host in self.relations.on.get(product.id(), ()) if host.id() in self.ids),
        )

    def in_one_piece(self, elements: dict[str, Element], tasks: dict[str, Task]) -> dict[str, Element]:
        """Return and note what comes in one piece."""
        with ReadingEntity(self.name, "the file"):
            assemblies = [each for each in self.file.by_type("IfcElementAssembly") if each.AssemblyPlace == "FACTORY"]
        changed = in_one_piece(elements, tasks, {self.ids[each.id()] for each in assemblies if each.id() in self.ids})
        for name, element in changed.items():
            if element.bodies:
                about = element.name or name
                self.notes.add("Comes in one piece: its parts are a body and a mass with it", about)
                if element.mass is None:
                    said = "Comes in one piece with something whose mass is not known: its mass is not known either"
                    self.notes.add(said, about)
        return changed


def read_ifc(path: str | Path, most_bytes: int) -> BuildingModel:
    """Read a file."""
    name = Path(path).name
    try:
        contents = read_file(path, most_bytes)
    except OSError as error:
        raise BuildingError(name, "the file", error.strerror or str(error), "an IFC file that can be read") from error
    digest = hashlib.sha256(contents).hexdigest()
    notes = Notes()
    contents = _in_ascii(_of_last_publication(contents, name), notes)
    file = _open(contents, name)
    doubts = Doubts(file)
    log = tuple(parse_log(ifcopenshell.get_log()))
    with ReadingEntity(name, "the file"):
        doubts.on_parser_log(log, contents, name)
        for entry in log:
            notes.add("The parser says", entry.text)
    # it can be large, and the geometry needs room
    del contents
    # its units are not the model's, and the kernel reads those of one context only
    for library in () if file.schema == "IFC2X3" else file.by_type("IfcProjectLibrary"):
        file.remove(library)
    reader = _Reader(file, name, notes, doubts)
    reader.record_ignored_coordinates()
    elements = reader.elements()
    for kind, meaning in _UNREAD.items():
        if kind in file.types():
            notes.add(f"Not read: {len(file.by_type(kind))} {kind}, {meaning}")
    with_parts = {element.assembly for element in elements.values()}
    for element in elements.values():
        if not element.bodies and element.id not in with_parts:
            notes.add("Elements without a body are no obstacle", element.name or element.id)
    built_from_inputs, groups = _built_from_inputs(elements), Groups(reader.relations, reader.ids, notes)
    tasks, sequences = read_tasks(file, name, groups, built_from_inputs, reader.units, notes)
    elements |= groups.elements
    elements |= reader.in_one_piece(elements, tasks)
    project = file.by_type("IfcProject")[0]
    with ReadingEntity(name, project):
        title = project.Name or getattr(project, "LongName", None) or ""
    return BuildingModel(name, digest, title, elements, tasks, sequences, notes.sentences())


def _built_from_inputs(elements: dict[str, Element]) -> set[str]:
    """Return what a task builds that has it as an input: workpieces, and assemblies without a body that they are parts of."""
    parents = {element.assembly for element in elements.values()}
    found = {element.id for element in elements.values() if is_workpiece(element, element.id in parents)}
    for name in list(found):
        for whole in wholes(elements, name):
            if elements[whole].bodies:
                break
            found.add(whole)
    return found


def _open(contents: bytes, name: str) -> ifcopenshell.file:
    """Parse contents; no file of them is left, however this process ends."""
    # what other files left in it is not of this one
    ifcopenshell.get_log()
    copy = os.memfd_create("ifc")
    with os.fdopen(copy, "wb") as written:
        written.write(contents)
        written.flush()
        try:
            with ReadingEntity(name, "the file"):
                file = ifcopenshell.open(f"/proc/self/fd/{copy}", format=".ifc")
                count = len(file.types())
        except MisreadError as error:
            why = next((entry.text for entry in parse_log(ifcopenshell.get_log())), error.found)
            raise BuildingError(name, "the file", why, "an IFC file (ISO 10303-21)") from error
    if count == 0:
        raise BuildingError(name, "the file", "no entities", "an IFC file (ISO 10303-21)")
    return file


def _hand_down_status(elements: dict[str, Element], notes: Notes) -> None:
    """Give parts the status of the nearest whole that has one, ``new`` none; note what is not to be made."""
    said = {name: element.status for name, element in elements.items()}
    for name, element in elements.items():
        status = next((said[one] for one in (name, *wholes(elements, name)) if said[one]), "").replace("new", "")
        elements[name] = replace(element, status=status)
        if status:
            notes.add(_STATUS[status], element.name or name)


def _leave_out_doubles(elements: dict[str, Element], notes: Notes) -> None:
    """Take the body of an element whose parts fill it: it would stand where they are to be placed."""
    volumes = {name: sum(abs(body.volume) for body in element.bodies) for name, element in elements.items()}
    filled: dict[str, float] = defaultdict(float)
    for name, element in elements.items():
        filled[element.assembly] += volumes[name]
    for whole, parts in filled.items():
        if 0 < volumes.get(whole, 0.0) <= 2 * parts:
            notes.add("Has a body and parts that fill it; only the parts' bodies are taken", whole)
            elements[whole] = replace(elements[whole], bodies=())


def _of_last_publication(contents: bytes, name: str) -> bytes:
    found = _SCHEMA.search(contents, 0, contents.find(b"ENDSEC"))
    given = found.group(1).decode("latin-1").upper() if found else ""
    base, _, publication = given.partition("_")
    if found is None or base not in SCHEMAS or publication.startswith("RC"):
        raise BuildingError(
            name, "schema", given or "none",
            (f"one of {', '.join(SCHEMAS)} as published (IFC4_ADD2 and the like too), no release " "candidate: export it so"),
        )  # fmt: skip
    if SCHEMAS[base] == found.group(1):
        return contents
    return contents[: found.start(1)] + SCHEMAS[base] + contents[found.end(1) :]


def _in_ascii(contents: bytes, notes: Notes) -> bytes:
    """Return contents with letters that are not ASCII (UTF-8, else Windows-1252) written as IFC wants them."""
    # what may stand before its beginning is no part of it
    contents = contents[max(contents.find(b"ISO-10303-21;"), 0) :]
    if contents.isascii():
        return contents
    try:
        text, code = contents.decode("utf-8"), "UTF-8"
    except UnicodeDecodeError:
        text, code = contents.decode("cp1252", errors="replace"), "Latin-1 (Windows-1252)"
    letters = sorted(letter for letter in set(text) if not letter.isascii())
    notes.add(
        f"The file has letters that are not ASCII, which IFC does not allow; taken as {code}: {''.join(letters[:20])}"
    )
    return text.encode("ascii", errors="ifc")


def _escaped(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    numbers = map(ord, error.object[error.start : error.end])
    return "".join(f"\\X2\\{n:04X}\\X0\\" if n < 0x10000 else f"\\X4\\{n:08X}\\X0\\" for n in numbers), error.end


codecs.register_error("ifc", _escaped)
