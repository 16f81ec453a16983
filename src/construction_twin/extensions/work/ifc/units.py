"""Factors from the file's units to SI."""

from __future__ import annotations

import math
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.unit

from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.notes import Notes, Where

#: Metres per length unit that a building may be drawn in, with much room.
_SMALLEST, _LARGEST = 1e-7, 1e5
#: Which of `Units` holds for a measure or quantity.
_FACTORS = {
    "length": ("IfcLengthMeasure", "IfcPositiveLengthMeasure", "IfcNonNegativeLengthMeasure", "IfcQuantityLength"),
    "area": ("IfcAreaMeasure", "IfcQuantityArea"),
    "volume": ("IfcVolumeMeasure", "IfcQuantityVolume"),
    "mass": ("IfcMassMeasure", "IfcQuantityWeight"),
    "angle": ("IfcPlaneAngleMeasure", "IfcPositivePlaneAngleMeasure"),
    "time": ("IfcTimeMeasure", "IfcQuantityTime"),
    "density": ("IfcMassDensityMeasure",),
}
#: Powers of the prefix of an SI unit whose name has one.
_POWERS = {"SQUARE_METRE": 2, "CUBIC_METRE": 3}
#: Kinds of units of quantities of weight and the like, whose own unit must be of their kind.
KINDS = {
    "IfcQuantityLength": "LENGTHUNIT", "IfcQuantityArea": "AREAUNIT", "IfcQuantityVolume": "VOLUMEUNIT",
    "IfcQuantityWeight": "MASSUNIT", "IfcQuantityTime": "TIMEUNIT", "IfcMassMeasure": "MASSUNIT",
    "IfcMassDensityMeasure": "MASSDENSITYUNIT",
}  # fmt: skip


@dataclass(frozen=True)
class Units:
    """SI units per unit of the file.

    Attributes:
        length, area, volume, mass, angle: [m], [m²], [m³], [kg], [rad]
        time: [s]; None: the project has no unit of time.
        density: [kg/m³]; None: the project has no unit of density.
        weighs: The project has a unit of mass; else it is the kilogram.
    """

    length: float
    area: float
    volume: float
    mass: float
    angle: float
    time: float | None
    density: float | None = None
    weighs: bool = True

    def factor(self, measure: str) -> float:
        """Return SI units per unit of a measure or quantity of the schema; 1 for what has no unit or one that is not converted."""
        name = next((name for name, measures in _FACTORS.items() if measure in measures), "")
        factor = getattr(self, name) if name else None
        return 1.0 if factor is None else factor


def read_units(file: ifcopenshell.file, name: str, notes: Notes) -> Units:
    """Read the project's units."""
    projects = file.by_type("IfcProject")
    if len(projects) != 1:
        found = str(len(projects) or "none")
        raise BuildingError(name, "IFCPROJECT", found, "one project, which says in which units the model is")
    with Where(name, projects[0]):
        assignment = projects[0].UnitsInContext
        given = [getattr(unit, "UnitType", None) for unit in assignment.Units] if assignment else []
    if given.count("LENGTHUNIT") != 1:
        found = "several length units" if "LENGTHUNIT" in given else "no length unit"
        raise BuildingError(name, "units of the project", found, "one, or no length of the model has a meaning")
    length = _scale(file, name, "LENGTHUNIT")
    if not _SMALLEST <= length <= _LARGEST:
        expected = "a unit of length that buildings are drawn in"
        raise BuildingError(name, "length unit of the project", f"{length:g} m", expected)
    if "PLANEANGLEUNIT" not in given:
        notes.add("The project has no unit of angles; radians are assumed")
    return Units(
        length,
        _scale(file, name, "AREAUNIT") if "AREAUNIT" in given else length**2,
        _scale(file, name, "VOLUMEUNIT") if "VOLUMEUNIT" in given else length**3,
        # ifcopenshell's unit of mass is SI's root, the gram; without a unit IFC's is the kilogram
        _scale(file, name, "MASSUNIT") / 1e3 if "MASSUNIT" in given else 1.0,
        _scale(file, name, "PLANEANGLEUNIT") if "PLANEANGLEUNIT" in given else 1.0,
        _scale(file, name, "TIMEUNIT") if "TIMEUNIT" in given else None,
        _density(assignment, name) if "MASSDENSITYUNIT" in given else None,
        "MASSUNIT" in given,
    )


def _density(assignment: ifcopenshell.entity_instance, name: str) -> float:
    unit = next(unit for unit in assignment.Units if getattr(unit, "UnitType", None) == "MASSDENSITYUNIT")
    with Where(name, unit):
        factor = si_factor(unit)
    if factor is None or not (math.isfinite(factor) and factor > 0):
        raise BuildingError(name, "MASSDENSITYUNIT of the project", str(factor), "a unit of known units")
    return factor


def si_factor(unit: ifcopenshell.entity_instance) -> float | None:
    """Return SI units (of mass: kilograms) per unit; None: only people know what it is."""
    if unit.is_a("IfcSIUnit"):
        factor = ifcopenshell.util.unit.get_prefix_multiplier(unit.Prefix) ** _POWERS.get(unit.Name, 1)
        return float(factor) / 1e3 if unit.Name == "GRAM" else float(factor)
    if unit.is_a("IfcConversionBasedUnit"):
        of = unit.ConversionFactor
        base = si_factor(of.UnitComponent)
        return None if base is None else float(of.ValueComponent.wrappedValue) * base
    if unit.is_a("IfcDerivedUnit"):
        whole = 1.0
        for element in unit.Elements:
            factor = si_factor(element.Unit)
            if factor is None:
                return None
            whole *= factor**element.Exponent
        return whole
    return None


def _scale(file: ifcopenshell.file, name: str, kind: str) -> float:
    with Where(name, f"{kind} of the project"):
        scale = float(ifcopenshell.util.unit.calculate_unit_scale(file, kind))
    if not (math.isfinite(scale) and scale > 0):
        raise BuildingError(name, f"{kind} of the project", f"{scale:g}", "a finite factor above 0")
    return scale
