"""work register: where the robot stands in the model, from three or more points. Runs without a ROS master.

Exit code 0: written into the cell file; 2: refused, after one sentence on standard error.
"""

from __future__ import annotations

import argparse
import datetime
import sys
from pathlib import Path

import numpy as np

from construction_twin.core.errors import ConstructionTwinError, command_message
from construction_twin.extensions.work.errors import PlacementError
from construction_twin.extensions.work.registration import read_points, register, write_base
from construction_twin.extensions.work.work_cell import read_work_cell
from construction_twin.views.arguments import finite


def main(arguments: list[str]) -> int:
    """Fit the points named on the command line; return the exit code."""
    options = _parser().parse_args(arguments)
    try:
        read_work_cell(options.cell)
        names, base, model = read_points(options.points, _origins(options.model))
        found = register(names, base, model, 1e-3 * options.most)
        if found.tilt > np.pi / 2 and not options.hanging:
            raise PlacementError(
                f"the base would stand upside down ({np.degrees(found.tilt):.1f} deg): are the points mirrored, as by an "
                "exchanged x and y? --hanging if the arm hangs"
            )
        today = datetime.date.today().isoformat()
        write_base(options.cell, found, f"{today} from {options.points.name}, residuals {found}")
    except (ConstructionTwinError, OSError) as error:
        print(f"work register: {command_message(error)}", file=sys.stderr)
        return 2
    for name, residual in found.residuals.items():
        print(f"{name}: {1e3 * residual:.2f} mm")
    position = ", ".join(f"{value:.4f}" for value in found.model_T_base.position)
    print(f"model_T_base: {position} m, its z axis {np.degrees(found.tilt):.2f} deg off the model's; in {options.cell}")
    return 0


def _origins(path: Path | None):
    """Return what finds the origin of an element of a model by its name or GlobalId, shape (3,) [m]."""
    building = None

    def origin(name: str) -> np.ndarray:
        nonlocal building
        if path is None:
            raise PlacementError(f"{name!r} is a point of the model; name its IFC file by --model")
        if building is None:
            from construction_twin.extensions.work.ifc.reading import read_building  # only where a point asks for it

            building = read_building(path)
        return building.named(name, str(path)).model_T_element.position

    return origin


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="work register",
        description="Where the robot stands in the building model: fits model_T_base and writes it into the cell file.",
    )
    parser.add_argument("cell", type=Path, help="cell file, as config/work/timber_panel.yaml")
    parser.add_argument(
        "points", type=Path,
        help="CSV: name; base_x, base_y, base_z in base_link; model_x, model_y, model_z, or model: the name of an element, whose "
        "origin is meant. Metres; _mm behind a column's name: millimetres",
    )  # fmt: skip
    parser.add_argument("--model", type=Path, metavar="FILE", help="IFC file of the elements that are named")
    parser.add_argument(
        "--most", type=finite, default=5.0, metavar="MM", help="largest residual that is accepted [5 mm]"
    )
    parser.add_argument("--hanging", action="store_true", help="the arm hangs: its base may be upside down")
    return parser
