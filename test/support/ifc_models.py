"""Building models for tests, made with ifcopenshell: small files whose contents the test says.

`IfcModel` builds one: elements with a body from a profile, placements, mapped items, assemblies, openings, tasks. Lengths are
given in metres and written in the model's unit. The same in IFC2X3, IFC4 and IFC4X3.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path

import ifcopenshell
import ifcopenshell.guid

from construction_twin.extensions.work.building import BuildingModel

#: Metres per unit.
UNITS = {"m": 1.0, "mm": 0.001, "foot": 0.3048, "inch": 0.0254}
Entity = ifcopenshell.entity_instance


class IfcModel:
    """A model under construction.

    Args:
        schema: ``IFC2X3``, ``IFC4`` or ``IFC4X3``.
        unit: Of `UNITS`.

    Attributes:
        file: For what this class has no method for.
        storey: "Ground floor", where elements are unless they are part of something.
    """

    def __init__(self, schema: str = "IFC4", unit: str = "mm"):
        self.file = ifcopenshell.file(schema=schema)
        self.unit = UNITS[unit]
        self._guids = (ifcopenshell.guid.compress(f"{number:032x}") for number in itertools.count(1))
        units = [self._length_unit(unit), self.make("IfcSIUnit", UnitType="PLANEANGLEUNIT", Name="RADIAN")]
        self.context = self.make(
            "IfcGeometricRepresentationContext",
            ContextType="Model",
            CoordinateSpaceDimension=3,
            Precision=1e-5,
            WorldCoordinateSystem=self.axes(),
        )
        self.body = self.make(
            "IfcGeometricRepresentationSubContext",
            ContextIdentifier="Body",
            ContextType="Model",
            ParentContext=self.context,
            TargetView="MODEL_VIEW",
        )
        self.project = self.root(
            "IfcProject",
            Name="Test",
            RepresentationContexts=[self.context],
            UnitsInContext=self.make("IfcUnitAssignment", Units=units),
        )
        self.site = self.root("IfcSite", Name="Site", ObjectPlacement=self.placement())
        self.building = self.root("IfcBuilding", Name="House", ObjectPlacement=self.placement(relative_to=self.site))
        self.storey = self.root(
            "IfcBuildingStorey", Name="Ground floor", ObjectPlacement=self.placement(relative_to=self.building)
        )
        for whole, part in ((self.project, self.site), (self.site, self.building), (self.building, self.storey)):
            self.aggregate(whole, [part])

    def _length_unit(self, unit: str) -> Entity:
        if unit in ("m", "mm"):
            return self.make("IfcSIUnit", UnitType="LENGTHUNIT", Prefix="MILLI" if unit == "mm" else None, Name="METRE")
        metre = self.make("IfcSIUnit", UnitType="LENGTHUNIT", Name="METRE")
        factor = self.make(
            "IfcMeasureWithUnit", ValueComponent=self.make("IfcLengthMeasure", UNITS[unit]), UnitComponent=metre
        )
        exponents = self.make("IfcDimensionalExponents", 1, 0, 0, 0, 0, 0, 0)
        return self.make(
            "IfcConversionBasedUnit",
            Dimensions=exponents,
            UnitType="LENGTHUNIT",
            Name=unit.upper(),
            ConversionFactor=factor,
        )

    def make(self, kind: str, *values: object, **attributes: object) -> Entity:
        """Add any entity."""
        return self.file.create_entity(kind, *values, **attributes)

    def root(self, kind: str, **attributes: object) -> Entity:
        """Add an entity with a GlobalId."""
        return self.make(kind, GlobalId=next(self._guids), **attributes)

    def text(self) -> str:
        """Return the file's contents."""
        return str(self.file.to_string())

    def save(self, path: Path) -> Path:
        """Write the file and return its path."""
        self.file.write(str(path))
        return path

    # placements

    def point(self, *metres: float) -> Entity:
        """Add a point [m]."""
        return self.make("IfcCartesianPoint", [value / self.unit for value in metres])

    def axes(self, at: tuple = (0.0, 0.0, 0.0), z: tuple | None = None, x: tuple | None = None) -> Entity:
        """Add an IfcAxis2Placement3D."""
        return self.make(
            "IfcAxis2Placement3D",
            self.point(*at),
            None if z is None else self.make("IfcDirection", [float(value) for value in z]),
            None if x is None else self.make("IfcDirection", [float(value) for value in x]),
        )

    def placement(
        self,
        at: tuple = (0.0, 0.0, 0.0),
        relative_to: Entity | None = None,
        z: tuple | None = None,
        x: tuple | None = None,
    ) -> Entity:
        """Add a placement relative to a product."""
        parent = None if relative_to is None else relative_to.ObjectPlacement
        return self.make("IfcLocalPlacement", parent, self.axes(at, z, x))

    # geometry

    def rectangle(self, x: float, y: float) -> Entity:
        """Add a rectangle [m] around its centre."""
        return self.make("IfcRectangleProfileDef", "AREA", None, self.axes_2d(), x / self.unit, y / self.unit)

    def axes_2d(self) -> Entity:
        """Add an IfcAxis2Placement2D at the origin."""
        return self.make("IfcAxis2Placement2D", self.point(0.0, 0.0), self.make("IfcDirection", [1.0, 0.0]))

    def polygon(self, corners: list[tuple[float, float]], *holes: list[tuple[float, float]]) -> Entity:
        """Add a profile of corners [m], not repeated at the end."""
        curves = [
            self.make("IfcPolyline", [self.point(*corner) for corner in (*loop, loop[0])]) for loop in (corners, *holes)
        ]
        if not holes:
            return self.make("IfcArbitraryClosedProfileDef", "AREA", None, curves[0])
        return self.make("IfcArbitraryProfileDefWithVoids", "AREA", None, curves[0], curves[1:])

    def profile(self, kind: str, **lengths: float) -> Entity:
        """Add a parametric profile, its attributes in metres."""
        attributes = {name: value / self.unit for name, value in lengths.items()}
        return self.make(kind, ProfileType="AREA", Position=self.axes_2d(), **attributes)

    def weigh(self, element: Entity, weight: float, unit: Entity | None = None) -> Entity:
        """Give an element a weight, in kg or a unit of its own."""
        quantity = self.make("IfcQuantityWeight", "NetWeight", None, unit, weight)
        quantities = self.root("IfcElementQuantity", Name="Qto_MemberBaseQuantities", Quantities=[quantity])
        self.root("IfcRelDefinesByProperties", RelatedObjects=[element], RelatingPropertyDefinition=quantities)
        return element

    def extrusion(
        self, profile: Entity, depth: float, direction: tuple = (0.0, 0.0, 1.0), at: tuple = (0, 0, 0)
    ) -> Entity:
        """Add an extrusion [m] of a profile that lies at a height in the element's frame."""
        along = self.make("IfcDirection", [float(value) for value in direction])
        return self.make("IfcExtrudedAreaSolid", profile, self.axes(tuple(map(float, at))), along, depth / self.unit)

    def representation(self, *items: Entity, kind: str = "SweptSolid") -> Entity:
        """Add a body representation."""
        return self.make("IfcShapeRepresentation", self.body, "Body", kind, list(items))

    def mapped(self, source: Entity, scale: float = 1.0, at: tuple = (0.0, 0.0, 0.0)) -> Entity:
        """Add a mapped item of a representation; `source` is one, or a map that was made of one."""
        origin = source if source.is_a("IfcRepresentationMap") else self.map_of(source)
        operator = self.make("IfcCartesianTransformationOperator3D", LocalOrigin=self.point(*at), Scale=scale)
        return self.make("IfcMappedItem", origin, operator)

    def map_of(self, representation: Entity) -> Entity:
        """Add a map of a representation."""
        return self.make("IfcRepresentationMap", self.axes(), representation)

    # products

    def element(
        self,
        kind: str,
        name: str,
        body: Entity | None = None,
        at: tuple = (0.0, 0.0, 0.0),
        within: Entity | None = None,
        **attributes: object,
    ) -> Entity:
        """Add an element on the storey, or placed relative to another product.

        Args:
            body: Representation, item or profile; a profile becomes an extrusion of 1 m.
            at: [m]
            within: Relative to which it is placed; None: the storey, in which it is then contained.
        """
        if body is not None and body.is_a("IfcProfileDef"):
            body = self.extrusion(body, 1.0)
        if body is not None and not body.is_a("IfcRepresentation"):
            body = self.representation(body)
        shape = None if body is None else self.make("IfcProductDefinitionShape", Representations=[body])
        placement = attributes.pop("placement", None) or self.placement(at, within or self.storey)
        product = self.root(kind, Name=name, ObjectPlacement=placement, Representation=shape, **attributes)
        if within is None:
            self.root("IfcRelContainedInSpatialStructure", RelatedElements=[product], RelatingStructure=self.storey)
        return product

    def box(
        self, name: str, size: tuple[float, float, float], at: tuple = (0.0, 0.0, 0.0), kind: str = "IfcMember", **more
    ):
        """Add an element that is a box around its placement's z axis, from there upwards."""
        body = self.extrusion(self.rectangle(size[0], size[1]), size[2])
        return self.element(kind, name, body, at, **more)

    def aggregate(self, whole: Entity, parts: list[Entity]) -> Entity:
        """Make things parts of another one."""
        return self.root("IfcRelAggregates", RelatingObject=whole, RelatedObjects=parts)

    def opening(self, element: Entity, size: tuple[float, float, float], at: tuple = (0.0, 0.0, 0.0)) -> Entity:
        """Cut a box out of an element."""
        hole = self.box("hole", size, at, "IfcOpeningElement", within=element)
        self.root("IfcRelVoidsElement", RelatingBuildingElement=element, RelatedOpeningElement=hole)
        return hole

    def properties(self, product: Entity, name: str, **values: object) -> Entity:
        """Give an element a property set; a value is an entity of a measure, or a text, number or truth value."""
        kinds = {bool: "IfcBoolean", int: "IfcInteger", float: "IfcReal", str: "IfcLabel"}
        single = [
            self.make(
                "IfcPropertySingleValue",
                Name=key,
                NominalValue=value if isinstance(value, Entity) else self.make(kinds[type(value)], value),
            )
            for key, value in values.items()
        ]
        definition = self.root("IfcPropertySet", Name=name, HasProperties=single)
        return self.root("IfcRelDefinesByProperties", RelatedObjects=[product], RelatingPropertyDefinition=definition)

    # schedule

    def schedule(self, name: str = "Schedule", **attributes: object) -> Entity:
        """Add a work schedule."""
        start = "2027-01-04T08:00:00"
        if self.file.schema == "IFC2X3":
            date = self.make("IfcCalendarDate", 4, 1, 2027)
            return self.root("IfcWorkSchedule", Name=name, Identifier=name, CreationDate=date, StartTime=date)
        return self.root("IfcWorkSchedule", Name=name, CreationDate=start, StartTime=start, **attributes)

    def task(
        self,
        name: str,
        products: list[Entity] | None = None,
        parent: Entity | None = None,
        schedule: Entity | None = None,
        **attributes: object,
    ) -> Entity:
        """Add a task that makes products."""
        if self.file.schema == "IFC2X3":
            attributes["TaskId"] = name
        task = self.root("IfcTask", Name=name, IsMilestone=attributes.pop("IsMilestone", False), **attributes)
        for product in products or ():
            self.root("IfcRelAssignsToProduct", RelatedObjects=[task], RelatingProduct=product)
        if parent is not None:
            self.root("IfcRelNests", RelatingObject=parent, RelatedObjects=[task])
        if schedule is not None:
            self.root("IfcRelAssignsToControl", RelatedObjects=[task], RelatingControl=schedule)
        return task

    def sequence(
        self, before: Entity, after: Entity, kind: str = "FINISH_START", lag: str | float | None = None
    ) -> Entity:
        """Let a task wait for another; a lag is a duration (``P1D``), a ratio, or in IFC2X3 seconds."""
        if self.file.schema == "IFC2X3":
            value: object = float(lag or 0.0)
        elif lag is None:
            value = None
        else:
            measure = self.make("IfcDuration" if isinstance(lag, str) else "IfcRatioMeasure", lag)
            value = self.make("IfcLagTime", LagValue=measure, DurationType="WORKTIME")
        return self.root(
            "IfcRelSequence", RelatingProcess=before, RelatedProcess=after, SequenceType=kind, TimeLag=value
        )

    def resource(self, name: str, *tasks: Entity, kind: str = "IfcConstructionEquipmentResource") -> Entity:
        """Add a resource that does tasks."""
        resource = self.root(kind, Name=name)
        for task in tasks:
            self.root("IfcRelAssignsToProcess", RelatedObjects=[resource], RelatingProcess=task)
        return resource

    def inputs(self, task: Entity, *products: Entity) -> Entity:
        """Assign products to a task as what it works on."""
        return self.root("IfcRelAssignsToProcess", RelatedObjects=list(products), RelatingProcess=task)


def noted(texts: Iterable[str], *parts: str) -> bool:
    """Whether one of these texts has all of these parts."""
    return any(all(part in text for part in parts) for text in texts)


def remarked(model: BuildingModel, one: Entity, *parts: str) -> bool:
    """Whether a remark on this element or task has all of these parts."""
    named = [note for note in model.notes if (one.Name or one.GlobalId) in note or one.GlobalId in note]
    return noted(named, *parts)


def two_studs(schema="IFC4"):
    """A model with two studs, each placed by a task, the second after the first."""
    model = IfcModel(schema)
    studs = [model.box(name, (0.1, 0.1, 1.0), at=(k, 0, 0)) for k, name in enumerate(("a", "b"))]
    tasks = [model.task(f"place {stud.Name}", [stud]) for stud in studs]
    model.sequence(*tasks)
    return model, studs, tasks
