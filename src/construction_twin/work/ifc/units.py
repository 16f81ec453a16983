"""Factors from the file's units to SI."""

from __future__ import annotations

import math
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.unit

from construction_twin.core.work_errors import BuildingError
from construction_twin.work.ifc.notes import Notes, Where

#: Metres per length unit that a building may be drawn in, with much room.
_SMALLEST, _LARGEST = 1e-7, 1e5
_LENGTH = {"IfcLengthMeasure", "IfcPositiveLengthMeasure", "IfcNonNegativeLengthMeasure", "IfcQuantityLength"}
_AREA = {"IfcAreaMeasure", "IfcQuantityArea"}
_VOLUME = {"IfcVolumeMeasure", "IfcQuantityVolume"}
_MASS = {"IfcMassMeasure", "IfcQuantityWeight"}
_ANGLE = {"IfcPlaneAngleMeasure", "IfcPositivePlaneAngleMeasure"}
_TIME = {"IfcTimeMeasure", "IfcQuantityTime"}


@dataclass(frozen=True)
class Units:
    """SI units per unit of the file.

    Attributes
    ----------
    length, area, volume, mass, angle, time : float
        [m], [m²], [m³], [kg], [rad], [s]
    """

    length: float
    area: float
    volume: float
    mass: float
    angle: float
    time: float

    def factor(self, measure: str) -> float:
        """Return SI units per unit of a measure or quantity of the schema; 1 for what has no unit or one that is not converted."""
        for factor, measures in (
            (self.length, _LENGTH),
            (self.area, _AREA),
            (self.volume, _VOLUME),
            (self.mass, _MASS),
            (self.angle, _ANGLE),
            (self.time, _TIME),
        ):
            if measure in measures:
                return factor
        return 1.0


def read_units(file: ifcopenshell.file, name: str, notes: Notes) -> Units:
    """Read the project's units.

    Raises
    ------
    BuildingError
        If there is no project, no length unit, or one that no building is drawn in.
    """
    projects = file.by_type("IfcProject")
    if not projects:
        raise BuildingError(name, "IFCPROJECT", "none", "a project, which says in which units the model is")
    with Where(name, projects[0]):
        assignment = projects[0].UnitsInContext
        given = [getattr(unit, "UnitType", None) for unit in assignment.Units] if assignment else []
    if "LENGTHUNIT" not in given:
        raise BuildingError(
            name, "units of the project", "no length unit", "one, or no length of the model has a meaning"
        )
    if given.count("LENGTHUNIT") > 1:
        raise BuildingError(name, "units of the project", "several length units", "one")
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
        _scale(file, name, "TIMEUNIT") if "TIMEUNIT" in given else 1.0,
    )


def _scale(file: ifcopenshell.file, name: str, kind: str) -> float:
    with Where(name, f"{kind} of the project"):
        scale = float(ifcopenshell.util.unit.calculate_unit_scale(file, kind))
    if not (math.isfinite(scale) and scale > 0):
        raise BuildingError(name, f"{kind} of the project", f"{scale:g}", "a finite factor above 0")
    return scale
