"""Writes models/: two building models with schedules, small enough to read, for samples, tests and benchmarks.

``timber_panel.ifc``: a timber wall panel, built lying on a table. ``brick_wall.ifc``: a stepped brick wall in running bond.
models/README.md says what they are. The same run gives the same bytes: ids follow from names, the time is fixed. Millimetres.
Needs ifcopenshell.

Run: ``python tools/make_models.py [--schema IFC2X3] [folder]``
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence as Ordered
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import ifcopenshell
import ifcopenshell.api.context
import ifcopenshell.api.unit

from construction_twin.extensions.work.building import Sequence, Task
from construction_twin.extensions.work.proposed_schedule import global_id

ROOT = Path(__file__).resolve().parents[1]
CREATED = datetime(2026, 1, 5, 7, 0, 0, tzinfo=UTC)
SCHEMAS = ("IFC2X3", "IFC4", "IFC4X3")

#: The robot that the schedules name: the namespace of bringup.launch.
ROBOT = "kr120"

#: Joint between neighbouring timbers, and between sheathing boards [mm].
JOINT, BOARD_JOINT = 2.0, 3.0

#: Length along x, height of the wall along y, section of the timbers, thickness of the sheathing [mm].
PANEL = {"length": 2400.0, "height": 1200.0, "width": 60.0, "depth": 120.0, "board": 15.0}

#: Length, width and height of a brick, open joint between two heads [mm]; bricks in each course, from below.
BRICK, HEAD_JOINT, COURSES = (240.0, 115.0, 71.0), 10.0, (10, 9, 8, 7, 6)


@dataclass(frozen=True)
class Part:
    """One element: a box, its frame in the middle of the lower face, x along `size[0]`.

    Attributes:
        name, ifc_class, kind, type_name, material: `kind`: PredefinedType where the schema knows it.
        size: Length 3. [mm]
        at: Length 3. Origin of its frame in the model [mm].
        turned: Its x axis lies along the model's y.
    """

    name: str
    ifc_class: str
    kind: str
    type_name: str
    material: str
    size: tuple[float, float, float]
    at: tuple[float, float, float]
    turned: bool = False


@dataclass(frozen=True)
class Design:
    """A model: its parts, how they are called together, and how they are built.

    Attributes:
        assembly: Name of the IfcElementAssembly that the parts make.
        densities: [kg/m3] by material.
        mapped: Parts of a type share its geometry as a mapped item.
    """

    name: str
    assembly: str
    assembly_kind: str
    parts: tuple[Part, ...]
    tasks: tuple[Task, ...]
    sequences: tuple[Sequence, ...]
    densities: dict[str, float] = field(default_factory=dict)
    mapped: bool = False


# -- the timber panel --------------------------------------------------------------------------------------------------


def timber_panel() -> Design:
    """Return the panel: two plates, five studs, three noggins, four boards."""
    length, height, width, depth = (PANEL[key] for key in ("length", "height", "width", "depth"))

    def timber(name: str, kind: str, along: float, x: float, y: float, turned: bool = False) -> Part:
        type_name = f"{name.split()[0] if kind != 'PLATE' else 'Plate'} {width:g}x{depth:g}"
        return Part(name, "IfcMember", kind, type_name, "C24", (along, width, depth), (x, y, 0.0), turned)

    middle = length / 2
    plates = [timber("Bottom plate", "PLATE", length, middle, width / 2)]
    plates.append(timber("Top plate", "PLATE", length, middle, height - width / 2))
    axes = [width / 2] + [length * i / 4 for i in (1, 2, 3)] + [length - width / 2]
    stud_length = height - 2 * width - 2 * JOINT
    studs = [timber(f"Stud {i}", "STUD", stud_length, x, height / 2, True) for i, x in enumerate(axes, 1)]
    noggins = []
    for i, (left, right) in enumerate(zip(axes[:3], axes[1:4], strict=True), 1):
        clear = right - left - width - 2 * JOINT
        noggins.append(timber(f"Noggin {i}", "MEMBER", clear, (left + right) / 2, height / 2))
    board = ((length - 3 * BOARD_JOINT) / 4, height)
    boards = []
    for i in range(4):
        x = board[0] / 2 + i * (board[0] + BOARD_JOINT)
        size = (height, board[0], PANEL["board"])
        boards.append(
            Part(f"Board {i + 1}", "IfcPlate", "SHEET", "OSB/3 15", "OSB/3", size, (x, height / 2, depth), True)
        )
    parts = (*plates, *studs, *noggins, *boards)

    def task(name: str, parent: str, product: Part | None = None, milestone: bool = False) -> Task:
        made = () if product is None else (global_id("timber_panel", "element", product.name),)
        robots = () if product is None else (ROBOT,)
        duration = None if product is None else 60.0
        return Task(_task_id("timber_panel", name), name, parent, made, (), robots, milestone, duration=duration)

    root = task("Panel W1", "")
    frame, sheathing = task("Frame", root.id), task("Sheathing", root.id)
    checked = task("Frame checked", root.id, milestone=True)
    place = {part.name: task(f"Place {part.name.lower()}", frame.id, part) for part in (*plates, *studs, *noggins)}
    place |= {part.name: task(f"Place {part.name.lower()}", sheathing.id, part) for part in boards}
    order = [Sequence(frame.id, checked.id), Sequence(checked.id, sheathing.id)]
    order += [Sequence(place["Bottom plate"].id, place[stud.name].id) for stud in studs]
    order.append(Sequence(place["Bottom plate"].id, place["Top plate"].id, "START_START"))
    order += [Sequence(place[a.name].id, place[b.name].id) for a, b in zip(studs[:-1], studs[1:], strict=True)]
    for i, noggin in enumerate(noggins):
        order.append(Sequence(place[studs[i + 1].name].id, place[noggin.name].id))
    order += [Sequence(place[a.name].id, place[b.name].id) for a, b in zip(boards[:-1], boards[1:], strict=True)]
    tasks = (root, frame, *(place[part.name] for part in parts[:10]), checked, sheathing)
    tasks += tuple(place[part.name] for part in boards)
    return Design(
        "timber_panel", "Wall panel W1", "USERDEFINED", parts, tasks, tuple(order), {"C24": 420.0, "OSB/3": 620.0}
    )


# -- the brick wall ----------------------------------------------------------------------------------------------------


def brick_wall() -> Design:
    """Return the wall: courses in running bond, each one brick shorter, so that both ends are stepped."""
    length, width, height = BRICK
    parts, tasks, order = [], [], []
    root = Task(_task_id("brick_wall", "Wall W2"), "Wall W2")
    tasks.append(root)
    last_course = ""
    for course, count in enumerate(COURSES):
        parent = Task(_task_id("brick_wall", f"Course {course + 1}"), f"Course {course + 1}", root.id)
        tasks.append(parent)
        if last_course:
            order.append(Sequence(last_course, parent.id))
        last_course, last_brick = parent.id, ""
        for i in range(count):
            name = f"Brick {course + 1}.{i + 1}"
            at = (length / 2 + (i + course / 2) * (length + HEAD_JOINT), width / 2, course * height)
            parts.append(Part(name, "IfcBuildingElementPart", "", "NF 240x115x71", "Clay brick", BRICK, at))
            made = (global_id("brick_wall", "element", name),)
            lay = Task(
                _task_id("brick_wall", name), f"Lay {name.lower()}", parent.id, made, (), (ROBOT,), duration=40.0
            )
            tasks.append(lay)
            if last_brick:
                order.append(Sequence(last_brick, lay.id))
            last_brick = lay.id
    return Design(
        "brick_wall",
        "Wall W2",
        "USERDEFINED",
        tuple(parts),
        tuple(tasks),
        tuple(order),
        {"Clay brick": 1800.0},
        mapped=True,
    )


# -- writing -----------------------------------------------------------------------------------------------------------


def _task_id(design: str, name: str) -> str:
    return global_id(design, "task", name)


class _Model:
    """One IFC file under way."""

    def __init__(self, design: Design, schema: str):
        self.design = design
        self.file = ifcopenshell.file(schema="IFC4X3_ADD2" if schema == "IFC4X3" else schema)
        self.old = schema == "IFC2X3"
        self.history = self._owner_history() if self.old else None

    def root(self, kind: str, *words: str, **fields: object) -> ifcopenshell.entity_instance:
        """Add an entity with a GlobalId that follows from `words`."""
        identifier = global_id(self.design.name, *words)
        return self.file.create_entity(kind, GlobalId=identifier, OwnerHistory=self.history, **fields)

    def write(self) -> ifcopenshell.file:
        """Fill the file."""
        project = self.root("IfcProject", "project", Name=self.design.name)
        ifcopenshell.api.unit.assign_unit(self.file, length={"is_metric": True, "raw": "MILLIMETERS"})
        self._add_other_units(project)
        context = ifcopenshell.api.context.add_context(self.file, context_type="Model")
        body = ifcopenshell.api.context.add_context(
            self.file, context_type="Model", context_identifier="Body", target_view="MODEL_VIEW", parent=context
        )
        project.RepresentationContexts = [context]
        building = self.root(
            "IfcBuilding", "building", Name="Shop", CompositionType="ELEMENT", ObjectPlacement=self._placement()
        )
        storey = self.root(
            "IfcBuildingStorey",
            "storey",
            Name="Ground floor",
            CompositionType="ELEMENT",
            Elevation=0.0,
            ObjectPlacement=self._placement(building.ObjectPlacement),
        )
        assembly = self.root(
            "IfcElementAssembly",
            "assembly",
            Name=self.design.assembly,
            ObjectType="Wall",
            PredefinedType=self.design.assembly_kind,
            ObjectPlacement=self._placement(storey.ObjectPlacement),
        )
        self._aggregate("project", project, [building])
        self._aggregate("building", building, [storey])
        self.root(
            "IfcRelContainedInSpatialStructure",
            "contained",
            RelatedElements=[assembly],
            RelatingStructure=storey,
        )
        elements = [self._element(part, assembly, body) for part in self.design.parts]
        self._aggregate("assembly", assembly, elements)
        self._types_and_materials(elements, body)
        for part, element in zip(self.design.parts, elements, strict=True):
            self._quantities(part, element)
        self._add_schedule(project, f"Schedule of {self.design.assembly.lower()}")
        self._header()
        return self.file

    def _add_other_units(self, project: ifcopenshell.entity_instance) -> None:
        assignment = self.file.by_type("IfcUnitAssignment")[0]
        mass = self.file.create_entity("IfcSIUnit", UnitType="MASSUNIT", Prefix="KILO", Name="GRAM")
        time = self.file.create_entity("IfcSIUnit", UnitType="TIMEUNIT", Name="SECOND")
        area = self.file.create_entity("IfcSIUnit", UnitType="AREAUNIT", Name="SQUARE_METRE")
        volume = self.file.create_entity("IfcSIUnit", UnitType="VOLUMEUNIT", Name="CUBIC_METRE")
        length = [unit for unit in assignment.Units if getattr(unit, "UnitType", "") == "LENGTHUNIT"]
        angle = self.file.create_entity("IfcSIUnit", UnitType="PLANEANGLEUNIT", Name="RADIAN")
        assignment.Units = [*length, area, volume, angle, mass, time]
        project.UnitsInContext = assignment

    def _aggregate(self, word: str, whole: ifcopenshell.entity_instance, parts: list) -> None:
        self.root("IfcRelAggregates", "aggregates", word, RelatingObject=whole, RelatedObjects=parts)

    def _placement(
        self,
        relative_to: ifcopenshell.entity_instance | None = None,
        at: Ordered[float] = (0.0, 0.0, 0.0),
        turned: bool = False,
    ) -> ifcopenshell.entity_instance:
        placed = self.file.create_entity(
            "IfcLocalPlacement", PlacementRelTo=relative_to, RelativePlacement=self._axes(at, turned)
        )
        return placed

    def _axes(self, at: Ordered[float] = (0.0, 0.0, 0.0), turned: bool = False) -> ifcopenshell.entity_instance:
        create = self.file.create_entity
        if not turned:
            return create("IfcAxis2Placement3D", create("IfcCartesianPoint", [float(v) for v in at]))
        return create(
            "IfcAxis2Placement3D",
            create("IfcCartesianPoint", [float(v) for v in at]),
            create("IfcDirection", (0.0, 0.0, 1.0)),
            create("IfcDirection", (0.0, 1.0, 0.0)),
        )

    def _box(
        self, size: tuple[float, float, float], body: ifcopenshell.entity_instance
    ) -> ifcopenshell.entity_instance:
        create = self.file.create_entity
        profile = create(
            "IfcRectangleProfileDef",
            ProfileType="AREA",
            ProfileName=f"{size[0]:g}x{size[1]:g}",
            Position=create("IfcAxis2Placement2D", create("IfcCartesianPoint", (0.0, 0.0))),
            XDim=size[0],
            YDim=size[1],
        )
        solid = create(
            "IfcExtrudedAreaSolid", profile, self._axes(), create("IfcDirection", (0.0, 0.0, 1.0)), float(size[2])
        )
        return create("IfcShapeRepresentation", body, "Body", "SweptSolid", [solid])

    def _element(
        self, part: Part, assembly: ifcopenshell.entity_instance, body: ifcopenshell.entity_instance
    ) -> ifcopenshell.entity_instance:
        fields: dict[str, object] = {}
        if not self.old and part.kind:
            fields["PredefinedType"] = part.kind
        if self.old:
            fields["ObjectType"] = part.type_name
        element = self.root(
            part.ifc_class,
            "element",
            part.name,
            Name=part.name,
            Tag=f"{self.design.name[0].upper()}{self.design.parts.index(part) + 1:02d}",
            ObjectPlacement=self._placement(assembly.ObjectPlacement, part.at, part.turned),
            **fields,
        )
        if not self.design.mapped:
            element.Representation = self.file.create_entity(
                "IfcProductDefinitionShape", Representations=[self._box(part.size, body)]
            )
        return element

    def _types_and_materials(self, elements: list, body: ifcopenshell.entity_instance) -> None:
        create = self.file.create_entity
        by_type: dict[str, list[int]] = {}
        for i, part in enumerate(self.design.parts):
            by_type.setdefault(part.type_name, []).append(i)
        materials: dict[str, list] = {}
        for name, members in by_type.items():
            part = self.design.parts[members[0]]
            kind = f"{part.ifc_class}Type"
            if self.old and part.ifc_class == "IfcBuildingElementPart":
                kind = "IfcBuildingElementProxyType"  # IFC2x3 has no type of building element parts
            fields: dict[str, object] = {"PredefinedType": part.kind or "NOTDEFINED"}
            known = self.file.schema != "IFC2X3" or part.kind in ("PLATE", "STUD", "MEMBER", "SHEET", "")
            fields["PredefinedType"] = fields["PredefinedType"] if known else "NOTDEFINED"
            pset = self._pset(name, "Common", {"Reference": ("IfcIdentifier", name)}, part.ifc_class)
            sets = [pset]
            typed = self.root(kind, "type", name, Name=name, HasPropertySets=sets, **fields)
            if self.design.mapped:
                source = create("IfcRepresentationMap", self._axes(), self._box(part.size, body))
                typed.RepresentationMaps = [source]
                for i in members:
                    target = create(
                        "IfcCartesianTransformationOperator3D",
                        LocalOrigin=create("IfcCartesianPoint", (0.0, 0.0, 0.0)),
                    )
                    shape = create(
                        "IfcShapeRepresentation",
                        body,
                        "Body",
                        "MappedRepresentation",
                        [create("IfcMappedItem", source, target)],
                    )
                    elements[i].Representation = create("IfcProductDefinitionShape", Representations=[shape])
            of_type = [elements[i] for i in members]
            self.root("IfcRelDefinesByType", "types", name, RelatedObjects=of_type, RelatingType=typed)
            materials.setdefault(part.material, []).extend(of_type)
        for name, of_material in materials.items():
            material = create("IfcMaterial", Name=name)
            self._density(material, self.design.densities[name])
            self.root(
                "IfcRelAssociatesMaterial", "material", name, RelatedObjects=of_material, RelatingMaterial=material
            )

    def _density(self, material: ifcopenshell.entity_instance, density: float) -> None:
        if self.old:
            self.file.create_entity("IfcGeneralMaterialProperties", Material=material, MassDensity=density)
            return
        value = self.file.create_entity("IfcMassDensityMeasure", density)
        single = self.file.create_entity("IfcPropertySingleValue", Name="MassDensity", NominalValue=value)
        self.file.create_entity(
            "IfcMaterialProperties", Name="Pset_MaterialCommon", Properties=[single], Material=material
        )

    def _pset(
        self, word: str, suffix: str, values: dict[str, tuple[str, object]], ifc_class: str
    ) -> ifcopenshell.entity_instance:
        properties = [
            self.file.create_entity(
                "IfcPropertySingleValue", Name=name, NominalValue=self.file.create_entity(measure, value)
            )
            for name, (measure, value) in values.items()
        ]
        set_name = f"Pset_{ifc_class[3:]}{suffix}"
        return self.root("IfcPropertySet", "pset", word, Name=set_name, HasProperties=properties)

    def _quantities(self, part: Part, element: ifcopenshell.entity_instance) -> None:
        create = self.file.create_entity
        volume = part.size[0] * part.size[1] * part.size[2] / 1e9
        weight = round(volume * self.design.densities[part.material], 3)
        values = [
            create("IfcQuantityLength", Name="Length", LengthValue=part.size[0]),
            create("IfcQuantityVolume", Name="NetVolume", VolumeValue=round(volume, 9)),
            create("IfcQuantityWeight", Name="NetWeight", WeightValue=weight),
        ]
        quantities = self.root(
            "IfcElementQuantity",
            "quantities",
            part.name,
            Name=f"Qto_{part.ifc_class[3:]}BaseQuantities",
            Quantities=values,
        )
        self._define("quantities", part.name, element, quantities)
        pset = self._pset(part.name, "Common", {"Status": ("IfcLabel", "NEW")}, part.ifc_class)
        self._define("properties", part.name, element, pset)

    def _define(
        self, word: str, name: str, element: ifcopenshell.entity_instance, what: ifcopenshell.entity_instance
    ) -> None:
        self.root(
            "IfcRelDefinesByProperties",
            "defines",
            word,
            name,
            RelatedObjects=[element],
            RelatingPropertyDefinition=what,
        )

    def _add_schedule(self, project: ifcopenshell.entity_instance, name: str) -> None:
        """Add the tasks: IFC2x3 has their times in relations of their own."""
        moment = self._moment()
        kind = {"Identifier": name} if self.old else {"PredefinedType": "PLANNED"}
        schedule = self._of_schedule(
            "IfcWorkSchedule", "schedule", name, Name=name, CreationDate=moment, StartTime=moment, **kind
        )
        if not self.old:
            self._relate("IfcRelDeclares", name, RelatingContext=project, RelatedDefinitions=[schedule])
        tasks = {task.id: self._task(task) for task in self.design.tasks}
        if self.old:
            for task in self.design.tasks:
                time = self._of_schedule("IfcScheduleTimeControl", "time", task.id, ScheduleDuration=task.duration)
                self._relate(
                    "IfcRelAssignsTasks", task.id, RelatedObjects=[tasks[task.id]], RelatingControl=schedule, TimeForTask=time
                )  # fmt: skip
        else:
            roots = [tasks[task.id] for task in self.design.tasks if not task.parent]
            self._relate("IfcRelAssignsToControl", name, RelatedObjects=roots, RelatingControl=schedule)
        for parent in dict.fromkeys(task.parent for task in self.design.tasks if task.parent):
            nested = [tasks[task.id] for task in self.design.tasks if task.parent == parent]
            self._relate("IfcRelNests", parent, RelatingObject=tasks[parent], RelatedObjects=nested)
        made = [(task, product) for task in self.design.tasks for product in task.products]
        for task, product in made:
            self._relate(
                "IfcRelAssignsToProduct", task.id + product, RelatedObjects=[tasks[task.id]],
                RelatingProduct=self.file.by_guid(product),
            )  # fmt: skip
        robot = self._of_schedule("IfcConstructionEquipmentResource", "robot", ROBOT, Name=ROBOT)
        for task, _ in made:
            self._relate(
                "IfcRelAssignsToProcess", "robots" + task.id, RelatedObjects=[robot], RelatingProcess=tasks[task.id]
            )
        for one in self.design.sequences:
            self._relate(
                "IfcRelSequence", one.before + one.after + one.kind, RelatingProcess=tasks[one.before],
                RelatedProcess=tasks[one.after], TimeLag=0.0 if self.old else None, SequenceType=one.kind,
            )  # fmt: skip

    def _task(self, task: Task) -> ifcopenshell.entity_instance:
        fields = {"GlobalId": task.id, "Name": task.name, "IsMilestone": task.milestone}
        if self.old:
            return self.file.create_entity("IfcTask", OwnerHistory=self.history, TaskId=task.id, **fields)
        entity = self.file.create_entity("IfcTask", PredefinedType="CONSTRUCTION", **fields)
        if task.duration is not None:
            entity.TaskTime = self.file.create_entity(
                "IfcTaskTime", ScheduleDuration=f"PT{task.duration:g}S", DurationType="ELAPSEDTIME"
            )
        return entity

    def _of_schedule(self, kind: str, *words: str, **fields: object) -> ifcopenshell.entity_instance:
        """Add an entity whose GlobalId follows from `words` alone."""
        return self.file.create_entity(kind, GlobalId=global_id(*words), OwnerHistory=self.history, **fields)

    def _relate(self, kind: str, word: str, **fields: object) -> None:
        self._of_schedule(kind, kind, word, **fields)

    def _moment(self) -> object:
        """Return when it was made, as the schema has it."""
        if not self.old:
            return CREATED.isoformat(timespec="seconds")
        create = self.file.create_entity
        date = create(
            "IfcCalendarDate", DayComponent=CREATED.day, MonthComponent=CREATED.month, YearComponent=CREATED.year
        )
        time = create("IfcLocalTime", HourComponent=CREATED.hour, MinuteComponent=CREATED.minute, SecondComponent=0.0)
        return create("IfcDateAndTime", date, time)

    def _owner_history(self) -> ifcopenshell.entity_instance:
        create = self.file.create_entity
        person = create("IfcPerson", FamilyName="construction_twin")
        organization = create("IfcOrganization", Name="construction_twin")
        return create(
            "IfcOwnerHistory",
            OwningUser=create("IfcPersonAndOrganization", person, organization),
            OwningApplication=create("IfcApplication", organization, "1", "make_models", "make_models"),
            ChangeAction="ADDED",
            CreationDate=int(CREATED.timestamp()),
        )

    def _header(self) -> None:
        header = self.file.header
        header.file_name.name = f"{self.design.name}.ifc"
        header.file_name.time_stamp = CREATED.strftime("%Y-%m-%dT%H:%M:%S")
        header.file_name.preprocessor_version = f"IfcOpenShell {ifcopenshell.version}"
        header.file_name.originating_system = "tools/make_models.py"


DESIGNS = {"timber_panel": timber_panel, "brick_wall": brick_wall}


def build(name: str, schema: str = "IFC4") -> ifcopenshell.file:
    """Return one of the models.

    Args:
        name: ``timber_panel`` or ``brick_wall``.
        schema: One of `SCHEMAS`.
    """
    return _Model(DESIGNS[name](), schema).write()


def main() -> None:
    """Write both models and open them again."""
    parser = argparse.ArgumentParser(description="Write the sample models.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "models", help="default: models")
    parser.add_argument("--schema", choices=SCHEMAS, default="IFC4", help="default: IFC4, as in models/")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for name, design in DESIGNS.items():
        path = options.folder / f"{name}.ifc"
        build(name, options.schema).write(str(path))
        written = ifcopenshell.open(str(path))
        parts = written.by_type("IfcElementAssembly")[0].IsDecomposedBy[0].RelatedObjects
        found = (len(parts), len(written.by_type("IfcTask")))
        wanted = (len(design().parts), len(design().tasks))
        if found != wanted:
            raise SystemExit(f"{path}: {found} elements and tasks; wanted {wanted}")
        print(f"{path}: {options.schema}, {found[0]} elements, {found[1]} tasks, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
