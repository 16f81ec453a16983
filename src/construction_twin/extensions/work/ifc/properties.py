"""Property sets, quantities, materials and masses. Measures become SI; values that are lists become texts."""

from __future__ import annotations

import math
from collections.abc import Collection

import ifcopenshell
import ifcopenshell.util.element

from construction_twin.extensions.work.building import Body, Value
from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.notes import Notes, Where, label
from construction_twin.extensions.work.ifc.units import KINDS, Units, si_factor

Sets = dict[str, dict[str, Value]]

#: Names of quantities that are the mass of what is delivered, in the order in which they are believed.
_WEIGHTS = ("NetWeight", "GrossWeight", "Weight", "Mass")
#: Densities [kg/m³] of what is built with, from insulation to lead, with much room.
_LIGHTEST, HEAVIEST = 1.0, 25000.0
_LONGEST_TEXT = 4000
#: What a number in a project of feet or inches may mean that does not say its unit of mass: pounds [kg], and per cubic foot [m³].
_POUND, _CUBIC_FOOT = 0.45359237, 0.3048**3
#: Values of `Status` of what is to be made, or of which nothing is said.
_MADE = {"NEW", "NOTKNOWN", "UNSET", "NOTDEFINED", ""}
#: Values of `Status` of what stands, and the beginnings of those of what is to go.
_STANDS = ("EXISTING", "BESTAND", "VORHANDEN")
_GOES = ("DEMOLISH", "REMOVE", "ABBRUCH", "ABRISS", "RÜCKBAU")
#: Parts of the names of properties in which programs write a status of their own, those that name when something goes, and values
#: that say nothing.
_STATUS_NAMES = ("status", "phase", "renovation", "umbau", "abbruch", "demol")
_GONE_NAMES = ("demol", "abbruch", "abgebrochen")
_NOTHING = ("", "none", "keine", "false", "no", "nein", "unset", "notdefined")
#: Densities between which a mass is believed [kg/m³]: what is hollow, and lead.
_LIKELY = (5.0, 23000.0)


def read_properties(product: ifcopenshell.entity_instance, at: str, units: Units, notes: Notes) -> Sets:
    """Return the values by set and name; the type's own included, the element's win.

    What is noted stands at the id `at`, the element's record. A set that cannot be read is left out with a note: it says nothing
    about where the element is or what shape it has.
    """
    sets: Sets = {}
    try:
        with Where("", product):
            for set_name, values in ifcopenshell.util.element.get_psets(product, verbose=True).items():
                sets[str(set_name)] = {
                    str(name): _value(value, units, f"{set_name}.{name}", product, at, notes)
                    for name, value in values.items()
                    if name is not None and isinstance(value, dict)
                }
    except BuildingError:
        notes.add("Property sets that cannot be read are left out", label(product), at)
    return sets


def _value(entry: dict, units: Units, what: str, product: ifcopenshell.entity_instance, at: str, notes: Notes) -> Value:
    value = entry.get("value")
    measure = entry.get("value_type") or entry.get("class") or ""
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, (int, float)):
        if not math.isfinite(value):
            notes.add("Values that are no finite numbers are left out", "", at)
            return None
        factor = _factor(product.file.by_id(entry["id"]), measure, units) if "id" in entry else units.factor(measure)
        if factor is None:
            about = f"{product.Name or at} ({what})"
            notes.add("Values with a unit of their own that is none of theirs are left out", about, at)
            return None
        return value if factor == 1.0 else value * factor
    if isinstance(value, str):
        # IFC's third logical value
        return None if value == "UNKNOWN" and entry.get("value_type") == "IfcLogical" else value[:_LONGEST_TEXT]
    if isinstance(value, (list, tuple)):
        return ", ".join(str(each) for each in value)[:_LONGEST_TEXT]
    # bounded, table and complex properties: what a recipe can compare is their text
    return str({key: each for key, each in value.items() if key not in ("id", "type")})[:_LONGEST_TEXT]


def _factor(holder: ifcopenshell.entity_instance, measure: str, units: Units) -> float | None:
    """Return SI units per unit of a property or quantity: of its own unit, else of the project's; None: nobody can say."""
    own = getattr(holder, "Unit", None)
    if own is None:
        return units.factor(measure)
    kind = KINDS.get(measure)
    if kind is not None and getattr(own, "UnitType", kind) != kind:
        return None
    factor = si_factor(own)
    return factor if factor is not None and math.isfinite(factor) and factor > 0 else None


def read_material(product: ifcopenshell.entity_instance, at: str, notes: Notes) -> str:
    """Return the names of the materials, those of layers and constituents from the first to the last, without repeats."""
    try:
        with Where("", product):
            materials = ifcopenshell.util.element.get_materials(product)
            return ", ".join(dict.fromkeys(material.Name for material in materials if material.Name))
    except BuildingError:
        notes.add("Materials that cannot be read are left out", label(product), at)
    return ""


def read_status(product: ifcopenshell.entity_instance, at: str, sets: Sets, notes: Notes) -> str:
    """Return ``existing``, ``demolish``, ``new`` or nothing: the property `Status` of a set ``Pset_...Common``, in any case.

    What an author says elsewhere, in a set of his own or as a phase, is noted where it is not that of a new element.
    """
    about = product.Name or at
    found = ""
    for name, values in sets.items():
        common = name.casefold().startswith("pset_") and name.casefold().endswith("common")
        for key, given in values.items():
            if not isinstance(given, str):
                continue
            if common and key == "Status":
                words = {word.strip(" .").upper() for word in given.split(",")}
                status = _status(words)
                found = found or status or ("new" if words == {"NEW"} else "")
                for word in () if status else sorted(words - _MADE):
                    notes.add(f"Elements with the status {word!r}, taken as still to be made", about, at)
            elif any(word in key.casefold() for word in _STATUS_NAMES) and _stands(key, given):
                where = name if key == "Status" else f"{name} ({key})"
                said = (
                    f"Elements with the status {given[:40]!r} in {where}, which is no `Status` of a set Pset_...Common"
                )
                notes.add(f"{said}: not used, taken as still to be made", about, at)
    return found


def _status(words: Collection[str]) -> str:
    if any(word.startswith(_GOES) for word in words):
        return "demolish"
    return "existing" if any(word in _STANDS for word in words) else ""


def _stands(name: str, given: str) -> bool:
    """Return whether a value of a name like ``Phase Demolished`` says that an element stands already, or is to go."""
    low = given.casefold()
    if any(word in name.casefold() for word in _GONE_NAMES):
        return low.strip(" .-") not in _NOTHING
    return any(word.casefold() in low for word in (*_STANDS, *_GOES))


def read_mass(
    product: ifcopenshell.entity_instance, at: str, sets: Sets, bodies: tuple[Body, ...], units: Units, notes: Notes
) -> float | None:
    """Return the mass [kg]: a quantity of weight; or the density of its only material times the volume of its closed bodies.

    One that its volume cannot have is noted.
    """
    whole = sum(body.volume for body in bodies) if all(body.is_closed for body in bodies) else 0.0
    mass = _weight(product, at, sets, units, notes)
    if mass is None and whole > 0.0 and (density := _density(product, at, units, notes)) is not None:
        mass = density * whole
    if mass is not None and whole > 0.0 and not _LIKELY[0] <= mass / whole <= _LIKELY[1]:
        found = f"{mass:.3g} kg for {1e3 * whole:.3g} l is {mass / whole:.3g} kg/m³"
        said = f"THE MASS IS DOUBTFUL: {found}, expected {_LIKELY[0]:g} to {_LIKELY[1]:g}"
        notes.add(said, product.Name or at, at)
    return mass


def _weight(product: ifcopenshell.entity_instance, at: str, sets: Sets, units: Units, notes: Notes) -> float | None:
    about = product.Name or label(product)
    for quantity in _WEIGHTS:
        for name, values in sets.items():
            value = values.get(quantity)
            if "quantit" not in name.lower() and not name.startswith("Qto_"):
                continue
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                if value <= 0:
                    notes.add("Weights that are not above 0 are left out", about, at)
                    continue
                if not units.weighs and not _has_own_unit(product, name, quantity):
                    if not _is_power_of_ten(units.length):
                        said = f"A weight of {value:.6g} without a unit can be kilograms or pounds, and is not used"
                        notes.add(f"{said}: the project has no unit of mass, and feet or inches", about, at)
                        continue
                    notes.add("The project has no unit of mass; weights are taken as kilograms")
                return float(value)
    return None


def _density(product: ifcopenshell.entity_instance, at: str, units: Units, notes: Notes) -> float | None:
    try:
        with Where("", product):
            materials = ifcopenshell.util.element.get_materials(product)
            found = _material_density(materials[0]) if len({each.id() for each in materials}) == 1 else None
            factor = None if found is None else _density_factor(found, units)
    except BuildingError:
        # told when its name was read
        return None
    if found is None:
        return None
    shown = f"{found[0]:g}"
    if factor is None:
        said = f"The mass is not known: a density of {shown} without a unit can be kg/m³ or of the project's units"
        notes.add(f"{said} of mass and volume, or is none of either", product.Name or label(product), at)
        return None
    metric = _is_power_of_ten(units.length) and _is_power_of_ten(units.mass)
    if units.density is None and found[1] is None and factor == 1.0 and not metric:
        notes.add(f"The project has no unit of density; {shown} is taken as kg/m³")
    return float(found[0] * factor)


def _density_factor(found: tuple[float, ifcopenshell.entity_instance | None], units: Units) -> float | None:
    """Return kg/m³ per unit of a density that was found; None: nobody can say, or no material is so light or heavy."""
    density, holder = found
    if holder is not None:
        candidates = [_factor(holder, "IfcMassDensityMeasure", units)]
    elif units.density is not None:
        candidates = [units.density]
    else:
        # most authors write kg/m³ whatever the project's units are; the others mean the project's
        metric = _is_power_of_ten(units.length)
        mass = units.mass if units.weighs or metric else _POUND
        candidates = [1.0, mass / units.volume, *([] if metric else [mass / _CUBIC_FOOT])]
    likely = [each for each in candidates if each is not None and _LIGHTEST <= density * each <= HEAVIEST]
    if any(not math.isclose(likely[0], other, rel_tol=0.01) for other in likely):
        return None
    return likely[0] if likely else None


def _has_own_unit(product: ifcopenshell.entity_instance, set_name: str, name: str) -> bool:
    """Whether a value that was read has a unit of its own."""
    entry = ifcopenshell.util.element.get_psets(product, verbose=True)[set_name][name]
    return "id" in entry and getattr(product.file.by_id(entry["id"]), "Unit", None) is not None


def _is_power_of_ten(factor: float) -> bool:
    return math.isclose(factor, 10.0 ** round(math.log10(factor)), rel_tol=1e-9)


def _material_density(
    material: ifcopenshell.entity_instance,
) -> tuple[float, ifcopenshell.entity_instance | None] | None:
    """Return the density that a material has, and the property that holds it if that has a unit of its own."""
    found: object = None
    holder = None
    if material.file.schema == "IFC2X3":
        for properties in material.file.get_inverse(material):
            if properties.is_a("IfcGeneralMaterialProperties"):
                found = properties.MassDensity
                break
    else:
        for values in ifcopenshell.util.element.get_psets(material, verbose=True).values():
            if isinstance(entry := values.get("MassDensity"), dict):
                found = entry.get("value")
                given = material.file.by_id(entry["id"])
                holder = given if getattr(given, "Unit", None) is not None else None
                break
    if not isinstance(found, (int, float)) or isinstance(found, bool) or not math.isfinite(found) or found <= 0:
        return None
    return float(found), holder
