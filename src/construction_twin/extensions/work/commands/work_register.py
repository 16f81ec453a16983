"""work register: `model_T_base` from three or more points, written into the cell file. Runs without a ROS master.

Exit code 0: written into the cell file; 2: refused, after one sentence on standard error.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, command_message
from construction_twin.core.files import read_file, write_atomically
from construction_twin.extensions.work.building import PlacementError
from construction_twin.extensions.work.work_cell import read_work_cell
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rotation_to_abc
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
    """Return a function of a name or GlobalId that gives an element's origin in the model [m]."""
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


#: Points must reach at least so far across the line that fits them best [m]: less leaves the rotation about it open.
_LEAST_SPREAD = 0.05
_LARGEST_FILE = 1 << 20
_AXES = ("x", "y", "z")
_COLUMNS = (
    "name; base_x, base_y, base_z; model_x, model_y, model_z or model (the name of an element); _mm behind one in mm"
)


@dataclass(frozen=True)
class Registration:
    """Where the base stands; `residuals`: distance of each point from where the fit has it [m]."""

    model_T_base: Pose
    residuals: dict[str, float]

    @property
    def tilt(self) -> float:
        """The angle between the base's z axis and the model's [rad]."""
        return float(np.arccos(np.clip(self.model_T_base.rotation[2, 2], -1.0, 1.0)))

    def __str__(self) -> str:
        return ", ".join(f"{name} {1e3 * residual:.2f}" for name, residual in self.residuals.items()) + " mm"


def read_points(path: Path, element: Callable[[str], np.ndarray]) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Read names and points in base_link and in the model, shape (n, 3) [m], from a CSV file, with commas or semicolons.

    `element`: origin of the element of a name in the model [m].
    """
    try:
        text = read_file(path, _LARGEST_FILE).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigurationError(str(path), f"byte {error.start}", "text in UTF-8") from error
    german = ";" in text.partition("\n")[0]
    rows = csv.DictReader(io.StringIO(text), delimiter=";" if german else ",", skipinitialspace=True)

    def number(where: str, row: dict[str, str], column: str) -> float:
        key, unit = (f"{column}_mm", 1e-3) if f"{column}_mm" in row else (column, 1.0)
        try:
            value = unit * float((row.get(key) or "").replace(",", "." if german else ","))
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ConfigurationError(f"{where}, {key}", row.get(key), f"a number; columns: {_COLUMNS}")
        return value

    names, base, model = [], [], []
    for count, row in enumerate(rows, 2):
        where = f"{path}, line {count}"
        name = (row.get("name") or "").strip()
        if not name or name in names:
            raise ConfigurationError(f"{where}, name", name, "a name of its own for each point")
        names.append(name)
        base.append([number(where, row, f"base_{axis}") for axis in _AXES])
        named = (row.get("model") or "").strip()
        model.append(element(named) if named else [number(where, row, f"model_{axis}") for axis in _AXES])
    return names, np.array(base).reshape(-1, 3), np.array(model).reshape(-1, 3)


def register(names: Sequence[str], base: np.ndarray, model: np.ndarray, most: float) -> Registration:
    """Fit ``model_T_base`` by least squares (Kabsch); refuse too few points, a line, and residuals above `most` [m]."""
    if len(names) < 3:
        raise PlacementError(f"{len(names)} points; expected three or more that are not on one line")
    for where, points in (("base", base), ("model", model)):
        spread = float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1])
        if spread < _LEAST_SPREAD:
            raise PlacementError(
                f"the points are on a line within {1e3 * spread:.0f} mm ({where}): the turn about it stays open; "
                f"touch one at least {1e3 * _LEAST_SPREAD:.0f} mm beside it"
            )
    pose, residuals = _fit(base, model)
    if residuals.max() > most:
        raise PlacementError(
            f"{names[int(residuals.argmax())]} is {1e3 * residuals.max():.1f} mm off, {1e3 * most:.1f} mm allowed: look for "
            "a changed sign, exchanged columns, their units, or exchanged points, and measure again "
            f"({Registration(pose, dict(zip(names, residuals)))})"
        )
    return Registration(pose, dict(zip(names, residuals.tolist())))


def _fit(base: np.ndarray, model: np.ndarray) -> tuple[Pose, np.ndarray]:
    # about the means: with coordinates of 10 km the products of whole ones would lose what is sought
    base_mean, model_mean = base.mean(axis=0), model.mean(axis=0)
    u, _, vt = np.linalg.svd((model - model_mean).T @ (base - base_mean))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    residuals = np.linalg.norm((base - base_mean) @ rotation.T - (model - model_mean), axis=1)
    return Pose(model_mean - rotation @ base_mean, rotation), residuals


def write_base(cell: Path, registration: Registration, remark: str) -> None:
    """Write ``model_T_base`` into a cell file, with a comment; all else stays as it is."""
    text = cell.read_text(encoding="utf-8")
    document = yaml.compose(text)
    assert document is not None  # the command has read it
    keys = {key.value: (key, value) for key, value in document.value}
    key, value = keys["model_T_base"]
    start, end = key.start_mark.index, _end(value)
    rest, newline, after = text[end:].partition("\n")
    before_comment = rest.partition("# registered ")[0].rstrip()
    pose = registration.model_T_base
    xyz = ", ".join(f"{number:.6f}" for number in pose.position)
    rpy = ", ".join(f"{np.degrees(angle):.7f}" for angle in reversed(rotation_to_abc(pose.rotation)))
    line = f"model_T_base: {{xyz: [{xyz}], rpy_deg: [{rpy}]}}{before_comment} # registered {remark}"
    write_atomically(cell, text[:start] + line + newline + after)
    read_work_cell(cell)


def _end(node: yaml.Node) -> int:
    """Return where a value ends; the mark of a block stands behind the comments that follow it."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last)
    return node.end_mark.index
