"""Waypoints from a CSV file, read strictly: a refusal names the line, the column, and what was expected there.

The first line that is neither empty nor a comment (``#`` to the end of the line) names the columns, in any order:

- ``<joint>_deg`` or ``<joint>_rad``, for a prismatic joint ``<joint>_mm`` or ``<joint>_m``: every joint exactly once;
- ``<joint>_deg_s`` and so on: velocities, of all joints or none, only with times;
- ``time_s``: optional.

Columns are separated by commas, or by semicolons if the header has one; numbers have a decimal point.
"""

from __future__ import annotations

import math
import re

import numpy as np

from construction_twin.core.motion_errors import WaypointsError
from construction_twin.planning.waypoints import Unit, Waypoints, check_finite
from construction_twin.robot.description import RobotModel

_FACTORS = {"deg": math.pi / 180.0, "rad": 1.0, "mm": 1e-3, "m": 1.0}
_COLUMN = re.compile(r"^(?P<joint>.+?)_(?P<unit>deg|rad|mm|m)(?P<rate>_s)?$")
_TIME = "time_s"


def parse_waypoints(text: str, robot: RobotModel) -> Waypoints:
    """Read the text of a CSV file of waypoints.

    Parameters
    ----------
    text : str
    robot : RobotModel

    Returns
    -------
    waypoints : Waypoints
        `rows` are the file's lines, from 1.

    Raises
    ------
    WaypointsError
        Naming the line, the column, what was found and what was expected.
    """
    lines = [
        (number, line.split("#", 1)[0].strip()) for number, line in enumerate(text.lstrip("\ufeff").splitlines(), 1)
    ]
    lines = [(number, line) for number, line in lines if line]
    if not lines:
        raise WaypointsError(
            "the file is empty; expected a line that names the columns, then one line for each waypoint"
        )
    header_line, header = lines[0]
    separator = ";" if ";" in header else ","
    columns = [name.strip() for name in header.split(separator)]
    _check_columns(header_line, columns, robot)
    values = np.array([_numbers(number, line.split(separator), columns) for number, line in lines[1:]])
    values = values.reshape(len(lines) - 1, len(columns))
    by_name = dict(zip(columns, values.T))
    units, positions = _joint_values(by_name, robot, "")
    rates = any(name.endswith("_s") and name != _TIME for name in columns)
    waypoints = Waypoints(
        rows=tuple(number for number, _ in lines[1:]),
        row_name="line",
        units=units,
        positions=positions,
        times=by_name.get(_TIME),
        velocities=_joint_values(by_name, robot, "_s")[1] if rates else None,
    )
    check_finite(waypoints, robot)
    return waypoints


def _check_columns(line: int, columns: list[str], robot: RobotModel) -> None:
    counts: dict[str, str] = {}
    for name in columns:
        if name == _TIME:
            key = name
        else:
            match = _COLUMN.match(name)
            if match is None or match["joint"] not in robot.joint_names:
                raise WaypointsError(f"line {line}: unknown column {name!r}; {_expected(robot)}", line, "", name)
            linear = robot.linear[robot.joint_names.index(match["joint"])]
            if (match["unit"] in ("mm", "m")) != linear:
                kind, units = ("prismatic", "mm or m") if linear else ("revolute", "deg or rad")
                message = f"line {line}: column {name!r} of a {kind} joint; expected its unit to be {units}"
                raise WaypointsError(message, line, match["joint"], name)
            key = match["joint"] + (match["rate"] or "")
        if key in counts:
            raise WaypointsError(f"line {line}: columns {counts[key]!r} and {name!r} are the same; expected one", line)
        counts[key] = name
    missing = [name for name in robot.joint_names if name not in counts]
    if missing:
        raise WaypointsError(f"line {line}: no column for {', '.join(missing)}; {_expected(robot)}", line, missing[0])
    rates = [name for name in robot.joint_names if f"{name}_s" in counts]
    if rates and (len(rates) < len(robot.joint_names) or _TIME not in counts):
        raise WaypointsError(f"line {line}: velocities need a column for every joint, and {_TIME}", line, rates[0])


def _expected(robot: RobotModel) -> str:
    names = (f"{name}_{'mm' if linear else 'deg'}" for name, linear in zip(robot.joint_names, robot.linear))
    return f"expected {', '.join(names)} (or _rad, _m), and {_TIME} if the waypoints are timed"


def _numbers(line: int, cells: list[str], columns: list[str]) -> list[float]:
    if len(cells) != len(columns):
        message = f"line {line}: {len(cells)} values; expected {len(columns)}, one for each column of the header"
        raise WaypointsError(message, line, "", len(cells))
    numbers = []
    for name, cell in zip(columns, cells):
        try:
            numbers.append(float(cell))
        except ValueError as error:
            match = _COLUMN.match(name)
            message = f"line {line}: {name} is {cell.strip()!r}; expected a number with a decimal point"
            raise WaypointsError(message, line, match["joint"] if match else "", cell.strip()) from error
    return numbers


def _joint_values(by_name: dict, robot: RobotModel, suffix: str) -> tuple[tuple[Unit, ...], np.ndarray]:
    """Return the columns of all joints in SI, in the robot's order."""
    units, columns = [], []
    for joint in robot.joint_names:
        unit = next(unit for unit in _FACTORS if f"{joint}_{unit}{suffix}" in by_name)
        units.append(Unit(unit, _FACTORS[unit]))
        columns.append(by_name[f"{joint}_{unit}{suffix}"] * _FACTORS[unit])
    return tuple(units), np.column_stack(columns)
