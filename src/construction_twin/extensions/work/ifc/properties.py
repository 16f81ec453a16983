"""Units, property sets, quantities, materials and masses. Measures become SI; values that are lists become texts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.unit

from construction_twin.extensions.work.building import Body, Value
from construction_twin.extensions.work.errors import BuildingError
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
    """SI units per unit of the file.

    `factors`: By each kind of which the project has one: [m], [m²], [m³], [kg], [rad], [s], [kg/m³].
    """

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
        """Return SI units per unit of a measure or quantity of the schema; 1 for what has no unit or one that is not converted."""
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
    """Return SI units (of mass: kilograms) per unit; None: only people know what it is, or it is none."""
    # money has no kind
    if not hasattr(unit, "UnitType") or any(part.is_a("IfcContextDependentUnit") for part in unit.file.traverse(unit)):
        return None
    factor = float(ifcopenshell.util.unit.get_unit_scale(unit)) / (1e3 if unit.UnitType in _OF_MASS else 1.0)
    return factor if math.isfinite(factor) and factor > 0 else None


def _kind(measure: str) -> str:
    """Return the kind of unit of a measure or quantity of the schema."""
    measure = measure.replace("Quantity", "").replace("Weight", "Mass")
    return ifcopenshell.util.unit.get_measure_unit_type(measure)  # type: ignore[arg-type]


# -- of products and tasks


def read_properties(product: _Entity, at: str, units: Units, notes: Notes) -> Sets:
    """Return the values by set and name; the type's own included, the element's win.

    What is noted stands at the id `at`, the element's record. A set that cannot be read is left out with a note: it says nothing
    about where the element is or what shape it has.
    """
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
    """Return SI units per unit of a property or quantity: of its own unit, else of the project's; None: nobody can say."""
    own = getattr(holder, "Unit", None)
    if own is None:
        return units.factor(measure)
    kind = _kind(measure)
    return None if kind in _CONVERTED and getattr(own, "UnitType", kind) != kind else _si_factor(own)


def read_status(product: _Entity, at: str, sets: Sets, notes: Notes) -> str:
    """Return ``existing``, ``demolish``, ``new`` or nothing: the property `Status` of a set ``Pset_...Common``, in any case.

    Another word is noted, and its element is still to be made.
    """
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
    """Return the mass [kg]: a quantity of weight; or the density of its only material times the volume of its closed bodies.

    One that its volume cannot have is noted; by a density it is not known then.
    """
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
    """Return the density of an element's only material [kg/m³]; None: not known, or in a unit that nobody says."""
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
    """Return the density that a material has, and the property that holds it; both None: it has none."""
    if material.file.schema == "IFC2X3":
        given = [each for each in material.file.get_inverse(material) if each.is_a("IfcGeneralMaterialProperties")]
        return next((each.MassDensity for each in given), None), None
    for values in ifcopenshell.util.element.get_psets(material, verbose=True).values():
        if isinstance(entry := values.get("MassDensity"), dict):
            return entry.get("value"), material.file.by_id(entry["id"])
    return None, None


def _is_power_of_ten(factor: float) -> bool:
    return math.isclose(factor, 10.0 ** round(math.log10(factor)), rel_tol=1e-9)
