"""Property sets, quantities, materials and masses. Measures become SI; values that are lists become texts."""

from __future__ import annotations

import math

import ifcopenshell
import ifcopenshell.util.element

from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import Body, Value
from construction_twin.work.ifc.notes import Notes, Where, label
from construction_twin.work.ifc.units import Units
from construction_twin.work.mesh_checks import is_closed, volume

Sets = dict[str, dict[str, Value]]

#: Names of quantities that are the mass of what is delivered, in the order in which they are believed.
_WEIGHTS = ("NetWeight", "GrossWeight", "Weight", "Mass")
#: Densities [kg/m³] of what is built with, from insulation to lead, with much room.
_LIGHTEST, _HEAVIEST = 1.0, 25000.0
_LONGEST_TEXT = 4000


def read_properties(product: ifcopenshell.entity_instance, units: Units, notes: Notes) -> Sets:
    """Return the values by set and name; the type's own included, the element's win.

    A set that cannot be read is left out with a note: it says nothing about where the element is or what shape it has.
    """
    sets: Sets = {}
    try:
        with Where("", product):
            for set_name, values in ifcopenshell.util.element.get_psets(product, verbose=True).items():
                sets[str(set_name)] = {
                    str(name): _value(value, units, notes)
                    for name, value in values.items()
                    if name is not None and isinstance(value, dict)
                }
    except BuildingError:
        notes.add("Property sets that cannot be read are left out of", label(product))
    return sets


def _value(entry: dict, units: Units, notes: Notes) -> Value:
    value = entry.get("value")
    factor = units.factor(entry.get("value_type") or entry.get("class") or "")
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, (int, float)):
        if not math.isfinite(value):
            notes.add("Values that are no finite numbers are left out", "")
            return None
        return value if factor == 1.0 else value * factor
    if isinstance(value, str):
        # IFC's third logical value
        return None if value == "UNKNOWN" and entry.get("value_type") == "IfcLogical" else value[:_LONGEST_TEXT]
    if isinstance(value, (list, tuple)):
        return ", ".join(str(each) for each in value)[:_LONGEST_TEXT]
    # bounded, table and complex properties: what a recipe can compare is their text
    return str({key: each for key, each in value.items() if key not in ("id", "type")})[:_LONGEST_TEXT]


def read_material(product: ifcopenshell.entity_instance, notes: Notes) -> str:
    """Return the names of the materials, those of layers and constituents from the first to the last, without repeats."""
    try:
        with Where("", product):
            materials = ifcopenshell.util.element.get_materials(product)
            return ", ".join(dict.fromkeys(material.Name for material in materials if material.Name))
    except BuildingError:
        notes.add("Materials that cannot be read are left out of", label(product))
    return ""


def read_mass(
    product: ifcopenshell.entity_instance, sets: Sets, bodies: tuple[Body, ...], units: Units, notes: Notes
) -> float | None:
    """Return the mass [kg]: a quantity of weight; or the density of its only material times the volume of its closed bodies."""
    for quantity in _WEIGHTS:
        for name, values in sets.items():
            value = values.get(quantity)
            if "quantit" not in name.lower() and not name.startswith("Qto_"):
                continue
            if isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0:
                return float(value)
    if not bodies or not all(is_closed(body.triangles) for body in bodies):
        return None
    density = _density(product, units, notes)
    return None if density is None else density * sum(volume(body.vertices, body.triangles) for body in bodies)


def _density(product: ifcopenshell.entity_instance, units: Units, notes: Notes) -> float | None:
    try:
        with Where("", product):
            materials = ifcopenshell.util.element.get_materials(product)
            density = _material_density(materials[0]) if len({each.id() for each in materials}) == 1 else None
    except BuildingError:
        # told when its name was read
        return None
    if not isinstance(density, (int, float)) or isinstance(density, bool) or density == 0:
        return None
    # most authors write kg/m³ whatever the project's units are; the others mean the project's
    for factor in (1.0, units.mass / units.volume):
        if _LIGHTEST <= density * factor <= _HEAVIEST:
            return float(density * factor)
    notes.add(
        f"A density of {density:g} is neither kg/m³ nor in the project's units; the mass is not known of",
        label(product),
    )
    return None


def _material_density(material: ifcopenshell.entity_instance) -> object:
    if material.file.schema == "IFC2X3":
        for properties in material.file.get_inverse(material):
            if properties.is_a("IfcGeneralMaterialProperties"):
                return properties.MassDensity
        return None
    for values in ifcopenshell.util.element.get_psets(material).values():
        if "MassDensity" in values:
            return values["MassDensity"]
    return None
