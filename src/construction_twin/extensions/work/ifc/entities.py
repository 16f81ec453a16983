"""Properties and relations of entities: units, property sets, masses, and which is part of, in or on which.

Measures become SI; values that are lists become texts. Loops of parts are refused.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.unit

from construction_twin.extensions.work.building import Body, BuildingError, Value
from construction_twin.extensions.work.ifc.notes import Notes, ReadingEntity, label

_Entity = ifcopenshell.entity_instance
Sets = dict[str, dict[str, Value]]

#: Names of quantities that are the mass of what is delivered, in the order in which they are believed.
_WEIGHTS = ("NetWeight", "GrossWeight", "Weight", "Mass")
_LONGEST_TEXT = 4000
#: Values of `Status`, and what they mean here; empty: nothing is said.
_STATUS = {
    "EXISTING": "existing", "DEMOLISH": "demolish", "NEW": "new", "NOTKNOWN": "", "UNSET": "", "NOTDEFINED": "", "": "",
}  # fmt: skip
#: Densities between which a mass is believed [kg/m³]: what is hollow, and lead.
_LIKELY = (5.0, 23000.0)
#: Metres per length unit that a building may be drawn in, with much room.
_SMALLEST, _LARGEST = 1e-7, 1e5
#: Kinds of units whose measures become SI; of those of mass ifcopenshell's own unit is the gram.
_CONVERTED = ("LENGTHUNIT", "AREAUNIT", "VOLUMEUNIT", "MASSUNIT", "PLANEANGLEUNIT", "TIMEUNIT", "MASSDENSITYUNIT")
_OF_MASS = ("MASSUNIT", "MASSDENSITYUNIT")


@dataclass(frozen=True)
class Units:
    """SI units ([m], [kg], ...) per unit of the file, by the kinds of which the project has one."""

    factors: Mapping[str, float]

    @property
    def length(self) -> float:
        """Metres per unit."""
        return self.factors["LENGTHUNIT"]

    @property
    def is_metric(self) -> bool:
        """Whether the unit of length is no foot or inch."""
        return _is_power_of_ten(self.length)

    def factor(self, measure: str) -> float:
        """Return SI units per unit of a measure or quantity of the schema; 1: not converted."""
        kind = _kind(measure)
        power = {"AREAUNIT": 2, "VOLUMEUNIT": 3}.get(kind)
        return self.factors.get(kind, self.length**power if power else 1.0)


def read_units(file: ifcopenshell.file, name: str, notes: Notes) -> Units:
    """Read the project's units."""
    projects = file.by_type("IfcProject")
    if len(projects) != 1:
        found = str(len(projects) or "none")
        raise BuildingError(name, "IFCPROJECT", found, "one project, which says in which units the model is")
    factors: dict[str, float] = {}
    with ReadingEntity(name, projects[0]):
        assignment = projects[0].UnitsInContext
        units = [(getattr(unit, "UnitType", ""), unit) for unit in assignment.Units] if assignment else []
        for kind, unit in units:
            if kind not in _CONVERTED:
                continue
            factor = _si_factor(unit)
            if factor is None:
                raise BuildingError(name, f"{kind} of the project", label(unit), "a unit of known units, above 0")
            if kind == "LENGTHUNIT" and kind in factors:
                raise BuildingError(name, "units of the project", "several length units", "one")
            factors[kind] = factor
    if "LENGTHUNIT" not in factors:
        raise BuildingError(
            name, "units of the project", "no length unit", "one, or no length of the model has a meaning"
        )
    if not _SMALLEST <= factors["LENGTHUNIT"] <= _LARGEST:
        expected = "a unit of length that buildings are drawn in"
        raise BuildingError(name, "length unit of the project", f"{factors['LENGTHUNIT']:g} m", expected)
    if "PLANEANGLEUNIT" not in factors:
        notes.add("The project has no unit of angles; radians are assumed")
    return Units(factors)


def _si_factor(unit: _Entity) -> float | None:
    """Return SI units (of mass: kilograms) per unit; None: unknown."""
    # money has no kind
    if not hasattr(unit, "UnitType") or any(part.is_a("IfcContextDependentUnit") for part in unit.file.traverse(unit)):
        return None
    factor = float(ifcopenshell.util.unit.get_unit_scale(unit)) / (1e3 if unit.UnitType in _OF_MASS else 1.0)
    return factor if math.isfinite(factor) and factor > 0 else None


def _kind(measure: str) -> str:
    measure = measure.replace("Quantity", "").replace("Weight", "Mass")
    return ifcopenshell.util.unit.get_measure_unit_type(measure)  # type: ignore[arg-type]


def read_properties(product: _Entity, at: str, units: Units, notes: Notes) -> Sets:
    """Return the values by set and name, the type's own included; `at`: the id for notes, also on sets that cannot be read."""
    sets: Sets = {}
    try:
        with ReadingEntity("", product):
            for set_name, values in ifcopenshell.util.element.get_psets(product, verbose=True).items():
                sets[str(set_name)] = {
                    str(name): _value(value, units, f"{set_name}.{name}", product, at, notes)
                    for name, value in values.items()
                    if name is not None and isinstance(value, dict)
                }
    except BuildingError:
        notes.add("Property sets that cannot be read are left out", label(product))
    return sets


def _value(entry: dict, units: Units, what: str, product: _Entity, at: str, notes: Notes) -> Value:
    value = entry.get("value")
    measure = entry.get("value_type") or entry.get("class") or ""
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, (int, float)):
        if not math.isfinite(value):
            notes.add("Values that are no finite numbers are left out", at)
            return None
        factor = _factor(product.file.by_id(entry["id"]), measure, units) if "id" in entry else units.factor(measure)
        if factor is None:
            about = f"{product.Name or at} ({what})"
            notes.add("Values with a unit of their own that is none of theirs are left out", about)
            return None
        return value if factor == 1.0 else value * factor
    if isinstance(value, str):
        # IFC's third logical value
        return None if value == "UNKNOWN" and entry.get("value_type") == "IfcLogical" else value[:_LONGEST_TEXT]
    if isinstance(value, (list, tuple)):
        return ", ".join(str(each) for each in value)[:_LONGEST_TEXT]
    # bounded, table and complex properties: what a recipe can compare is their text
    return str({key: each for key, each in value.items() if key not in ("id", "type")})[:_LONGEST_TEXT]


def _factor(holder: _Entity, measure: str, units: Units) -> float | None:
    """Return SI units per unit of a property or quantity, by its own unit or the project's; None: unknown."""
    own = getattr(holder, "Unit", None)
    if own is None:
        return units.factor(measure)
    kind = _kind(measure)
    return None if kind in _CONVERTED and getattr(own, "UnitType", kind) != kind else _si_factor(own)


def read_status(product: _Entity, at: str, sets: Sets, notes: Notes) -> str:
    """Return ``existing``, ``demolish``, ``new`` or nothing: the property `Status` of a set ``Pset_...Common``."""
    found: set[str] = set()
    for name, values in sets.items():
        given, low = values.get("Status"), name.casefold()
        if not isinstance(given, str) or not (low.startswith("pset_") and low.endswith("common")):
            continue
        for word in (each.strip(" .").upper() for each in given.split(",")):
            found.add(_STATUS.get(word, ""))
            if word not in _STATUS:
                notes.add(f"Elements with the status {word!r}, taken as still to be made", product.Name or at)
    return next((status for status in ("demolish", "existing", "new") if status in found), "")


def read_mass(
    product: _Entity, at: str, sets: Sets, bodies: tuple[Body, ...], units: Units, notes: Notes
) -> float | None:
    """Return the mass [kg]: a quantity of weight, or the density of its only material times the volume of its closed bodies."""
    whole = sum(body.volume for body in bodies) if all(body.is_closed for body in bodies) else 0.0
    mass = weight = _weight(product, at, sets, units, notes)
    if mass is None and whole > 0.0 and (density := _density(product, at, units, notes)) is not None:
        mass = density * whole
    if mass is not None and whole > 0.0 and not _LIKELY[0] <= mass / whole <= _LIKELY[1]:
        found = f"{mass:.3g} kg for {1e3 * whole:.3g} l is {mass / whole:.3g} kg/m³"
        said = f"THE MASS IS DOUBTFUL: {found}, expected {_LIKELY[0]:g} to {_LIKELY[1]:g}"
        notes.add(said, product.Name or at)
        return weight
    return mass


def _weight(product: _Entity, at: str, sets: Sets, units: Units, notes: Notes) -> float | None:
    about = product.Name or label(product)
    found = [
        (name, quantity, values[quantity])
        for quantity in _WEIGHTS
        for name, values in sets.items()
        if quantity in values and ("quantit" in name.lower() or name.startswith("Qto_"))
    ]
    for name, quantity, value in found:
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            continue
        if value <= 0:
            notes.add("Weights that are not above 0 are left out", about)
            continue
        if "MASSUNIT" not in units.factors:
            entry = ifcopenshell.util.element.get_psets(product, verbose=True)[name][quantity]
            own = getattr(product.file.by_id(entry["id"]), "Unit", None) if "id" in entry else None
            if own is None and not units.is_metric:
                said = f"A weight of {value:.6g} without a unit can be kilograms or pounds, and is not used"
                notes.add(f"{said}: the project has no unit of mass, and feet or inches", about)
                continue
            if own is None:
                notes.add("The project has no unit of mass; weights are taken as kilograms")
        return float(value)
    return None


def _density(product: _Entity, at: str, units: Units, notes: Notes) -> float | None:
    """Return the density of an element's only material [kg/m³]; None: unknown."""
    try:
        with ReadingEntity("", product):
            materials = {each.id(): each for each in ifcopenshell.util.element.get_materials(product)}
            if len(materials) != 1:
                return None
            density, holder = _material_density(*materials.values())
            if not isinstance(density, (int, float)) or not math.isfinite(density) or density <= 0:
                return None
            if holder is not None and getattr(holder, "Unit", None) is not None:
                factor = _factor(holder, "IfcMassDensityMeasure", units)
            else:
                # in a metric project authors write kg/m³, whatever its units of length and mass are
                metric = units.is_metric and _is_power_of_ten(units.factors.get("MASSUNIT", 1.0))
                factor = units.factors.get("MASSDENSITYUNIT", 1.0 if metric else None)
    except BuildingError:
        notes.add("Materials that cannot be read are left out", label(product))
        return None
    if factor is None:
        said = f"The mass is not known: a density of {density:g} has no unit, and the project none of density"
        notes.add(said, product.Name or label(product))
        return None
    return float(density) * factor


def _material_density(material: _Entity) -> tuple[object, _Entity | None]:
    if material.file.schema == "IFC2X3":
        given = [each for each in material.file.get_inverse(material) if each.is_a("IfcGeneralMaterialProperties")]
        return next((each.MassDensity for each in given), None), None
    for values in ifcopenshell.util.element.get_psets(material, verbose=True).values():
        if isinstance(entry := values.get("MassDensity"), dict):
            return entry.get("value"), material.file.by_id(entry["id"])
    return None, None


def _is_power_of_ten(factor: float) -> bool:
    return math.isclose(factor, 10.0 ** round(math.log10(factor)), rel_tol=1e-9)


_Entities = dict[int, list[_Entity]]
#: Relations of what is in or on elements: attributes of the elements, and of what is in or on them.
_ON = {
    "IfcRelFillsElement": (("RelatingOpeningElement",), "RelatedBuildingElement"),
    "IfcRelCoversBldgElements": (("RelatingBuildingElement",), "RelatedCoverings"),
    "IfcRelProjectsElement": (("RelatingElement",), "RelatedFeatureElement"),
    "IfcRelConnectsWithRealizingElements": (("RelatingElement", "RelatedElement"), "RealizingElements"),
}


@dataclass(frozen=True)
class Relations:
    """By id: the whole of a part, openings of an element, what something is on, and what a group or part of the site holds."""

    whole: dict[int, _Entity]
    openings: _Entities
    on: _Entities
    members: _Entities

    def within(self, group: _Entity) -> list[_Entity]:
        """Return what a group or a part of the site holds, what holds things itself replaced by these."""
        found: dict[int, _Entity] = {}
        left, visited = [group], set()
        while left:
            at = left.pop(0)
            if at.id() in visited:
                continue
            visited.add(at.id())
            if at.id() in self.members:
                left += self.members[at.id()]
            elif at is not group:
                found[at.id()] = at
        return [found[number] for number in sorted(found)]

    def wholes(self, entity: _Entity) -> list[_Entity]:
        """Return what an entity is part of, the nearest first."""
        found: list[_Entity] = []
        whole = self.whole.get(entity.id())
        while whole is not None:
            found.append(whole)
            whole = self.whole.get(whole.id())
        return found


def read_relations(file: ifcopenshell.file, name: str) -> Relations:
    """Read the relations of a file."""
    whole: dict[int, _Entity] = {}
    members: _Entities = defaultdict(list)
    # in IFC2x3 both are subtypes of IfcRelDecomposes; nesting of tasks and resources is read with them, for its loops
    for relation in (*file.by_type("IfcRelAggregates"), *file.by_type("IfcRelNests")):
        with ReadingEntity(name, relation):
            for part in relation.RelatedObjects:
                whole.setdefault(part.id(), relation.RelatingObject)
                if relation.RelatingObject.is_a("IfcProduct") and not relation.RelatingObject.is_a("IfcElement"):
                    members[relation.RelatingObject.id()].append(part)
    for relation in file.by_type("IfcRelContainedInSpatialStructure"):
        with ReadingEntity(name, relation):
            for part in relation.RelatedElements:
                members[relation.RelatingStructure.id()].append(part)
    for relation in file.by_type("IfcRelAssignsToGroup"):
        with ReadingEntity(name, relation):
            members[relation.RelatingGroup.id()] += relation.RelatedObjects
    voided: dict[int, _Entity] = {}
    openings: _Entities = defaultdict(list)
    for relation in file.by_type("IfcRelVoidsElement"):
        with ReadingEntity(name, relation):
            openings[relation.RelatingBuildingElement.id()].append(relation.RelatedOpeningElement)
            voided[relation.RelatedOpeningElement.id()] = relation.RelatingBuildingElement
    refuse_loops(file, name, whole)
    return Relations(whole, dict(openings), _on(file, name, voided), dict(members))


def _on(file: ifcopenshell.file, name: str, voided: dict[int, _Entity]) -> _Entities:
    found: _Entities = defaultdict(list)
    for kind, (hosts, guests) in _ON.items():
        for relation in file.by_type(kind):
            with ReadingEntity(name, relation):
                given = getattr(relation, guests)
                for host in filter(None, (getattr(relation, attribute) for attribute in hosts)):
                    # what fills an opening is in the element that it is cut out of
                    element = voided.get(host.id(), host)
                    for guest in filter(None, given if isinstance(given, tuple) else (given,)):
                        found[guest.id()].append(element)
    return dict(found)


def refuse_loops(file: ifcopenshell.file, name: str, whole: dict[int, _Entity]) -> None:
    """Raise BuildingError where an entity is part of itself."""
    try:
        TopologicalSorter({part: (parent.id(),) for part, parent in whole.items()}).prepare()
    except CycleError as error:
        # from the part to its whole
        loop = [label(file.by_id(each)) for each in reversed(error.args[1])]
        found = f"part of itself ({' in '.join(loop[:4])} ...)"
        raise BuildingError(name, loop[0], found, "no loop of parts") from error
