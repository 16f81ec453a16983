"""Waypoints as CSV files: read strictly, where a refusal names the line, the column and what was expected there; and written.

The first line that is neither empty nor a comment (``#`` to the end of the line) names the columns, in any order:

- ``<joint>_deg`` or ``<joint>_rad``, for a prismatic joint ``<joint>_mm`` or ``<joint>_m``: every joint exactly once;
- ``<joint>_deg_s`` and so on: velocities, of all joints or none, only with times;
- ``<joint>_deg_s2`` and so on: accelerations, of all joints or none, only with velocities;
- ``time_s``: optional.

A single line of values is the goal of a straight joint motion from the present pose; its time is how long that takes, 0 s: as
short as the speed allows. Columns are separated by commas, or by semicolons if the first line has one; numbers have a decimal
point.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from construction_twin.core.files import read_file
from construction_twin.planning.waypoints import Unit, Waypoints, WaypointsError, check_finite
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import PlanningError
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory

_FACTORS = {"deg": math.pi / 180.0, "rad": 1.0, "mm": 1e-3, "m": 1.0}
_COLUMN = re.compile(r"^(?P<joint>.+?)_(?P<unit>deg|rad|mm|m)(?P<rate>_s2?)?$")
#: Stricter than `float`, which also takes 1_000 and the digits of other scripts.
_NUMBER = re.compile(r"^[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|inf)$", re.ASCII | re.IGNORECASE)
_TIME = "time_s"
#: Suffixes of the columns of velocities and accelerations.
_RATES = {"_s": "velocities", "_s2": "accelerations"}
#: The place of a column among all, and its unit.
_Column = tuple[int, str]

#: Largest CSV file [bytes]: 20000 waypoints with velocities, 15 columns of 20 characters, are 6 MiB.
_LARGEST_FILE = 16 * 2**20


def read_waypoints(path: str, robot: RobotModel) -> Waypoints:
    """Read a CSV file of joint waypoints."""
    if not Path(path).is_absolute():
        raise PlanningError(f"the file is {path!r}; expected an absolute path on the planner's machine")
    try:
        text = read_file(path, _LARGEST_FILE).decode("utf-8")
    except OSError as error:
        found = f"{path} cannot be read: {error.strerror}; expected a CSV file on the planner's machine"
        raise PlanningError(found) from error
    except UnicodeDecodeError as error:
        raise PlanningError(f"{path} cannot be read: it is not text in UTF-8; save it as CSV") from error
    except ValueError as error:  # a null character in the path
        raise PlanningError(f"{path!r} cannot be read: {error}") from error
    return parse_waypoints(text, robot)


def parse_waypoints(text: str, robot: RobotModel) -> Waypoints:
    """Read the text of a CSV file of waypoints."""
    lines = [
        (number, line.split("#", 1)[0].strip()) for number, line in enumerate(text.lstrip("\ufeff").splitlines(), 1)
    ]
    lines = [(number, line) for number, line in lines if line]
    if not lines:
        raise WaypointsError("the file is empty; expected a line of columns, then one line for each waypoint")
    (first_line, first), *lines = lines
    separator = ";" if ";" in first else ","
    names = [cell.strip() for cell in first.split(separator)]
    found_columns = _checked_columns(first_line, names, robot)
    values = np.array([_numbers(number, line, separator, names) for number, line in lines])
    values = values.reshape(len(lines), len(names))
    times = values[:, found_columns[_TIME, ""][0]] if (_TIME, "") in found_columns else None
    if len(lines) == 1 and (times is None or not np.any(times)):
        # the goal of a motion from the present pose, whose time says how long it takes: with 0 s it is not timed, nor is its speed
        times = None
        found_columns = {key: column for key, column in found_columns.items() if not key[1]}
    position_columns = [found_columns[name, ""] for name in robot.joint_names]
    waypoints = Waypoints(
        rows=tuple(number for number, _ in lines),
        row_name="line",
        units=tuple(Unit(unit, _FACTORS[unit]) for _, unit in position_columns),
        positions=_in_si(values, position_columns),
        times=times,
        **{
            kind: _in_si(values, [found_columns[name, rate] for name in robot.joint_names])
            for rate, kind in _RATES.items()
            if (robot.joint_names[0], rate) in found_columns
        },
    )
    check_finite(waypoints, robot)
    return waypoints


def format_waypoints(
    trajectory: Trajectory, linear: Iterable[bool], comments: Iterable[str] = (), degrees: bool = False
) -> str:
    """Return a trajectory as a CSV file in rad and m, or in deg and mm, that `parse_waypoints` reads.

    Numbers are the shortest decimals that give the same 64 bit value again: read back, a file in rad has the trajectory's hash.
    """
    units = [("mm" if is_linear else "deg") if degrees else ("m" if is_linear else "rad") for is_linear in linear]
    names = [_TIME]
    names += [f"{name}_{unit}{rate}" for rate in ("", *_RATES) for name, unit in zip(trajectory.joint_names, units)]
    factors = np.array([_FACTORS[unit] for unit in units])
    tables = (trajectory.positions, trajectory.velocities, trajectory.accelerations)
    rows = np.column_stack((trajectory.times, *(table / factors for table in tables))).tolist()
    lines = [f"# {' '.join(comment.split())}" for comment in comments]
    lines.append(",".join(names))
    lines += [",".join(map(repr, row)) for row in rows]
    return "\n".join(lines) + "\n"


def format_plan(plan: Plan, linear: Iterable[bool], degrees: bool = False) -> str:
    """Return a plan as a CSV file; comments before the names say which plan it was."""
    comments = [f"plan {plan.id} for {plan.source}, made by {plan.planner}", f"hash {plan.hash}", f"scene {plan.scene}"]
    if plan.segments:
        comments.append(f"task {plan.task}, the path alone: of its segments the file has no switch and no scene")
        comments += [f"segment {segment.name!r} ends at {segment.end!r} s" for segment in plan.segments]
    return format_waypoints(plan.trajectory, linear, comments, degrees)


def _checked_columns(line: int, names: list[str], robot: RobotModel) -> dict[tuple[str, str], _Column]:
    """Return the column of each joint and rate, "" for its position; the time's is that of `_TIME`."""
    place = f"line {line}"
    columns: dict[tuple[str, str], _Column] = {}
    for index, name in enumerate(names):
        match = _COLUMN.match(name)
        if name == _TIME:
            key, unit = (_TIME, ""), "s"
        elif match is None or match["joint"] not in robot.joint_names:
            raise WaypointsError(f"{place}: unknown column {name!r}; {_expected(robot)}", line, "", name)
        else:
            key, unit = (match["joint"], match["rate"] or ""), match["unit"]
            linear = robot.linear[robot.joint_names.index(key[0])]
            if (unit in ("mm", "m")) != linear:
                kind, units = ("prismatic", "mm or m") if linear else ("revolute", "deg or rad")
                sentence = f"{place}: column {name!r} of a {kind} joint; expected its unit to be {units}"
                raise WaypointsError(sentence, line, key[0], name)
        if key in columns:
            same = f"{place}: columns {names[columns[key][0]]!r} and {name!r} are the same; expected one"
            raise WaypointsError(same, line)
        columns[key] = index, unit
    missing = [name for name in robot.joint_names if (name, "") not in columns]
    if missing:
        raise WaypointsError(f"{place}: no column for {', '.join(missing)}; {_expected(robot)}", line, missing[0])
    needs = {
        "_s": ("velocities", (_TIME, ""), _TIME),
        "_s2": ("accelerations", (robot.joint_names[0], "_s"), "velocities"),
    }
    for rate, (kind, needed, what) in needs.items():
        named = [name for name in robot.joint_names if (name, rate) in columns]
        if named and (len(named) < len(robot.joint_names) or needed not in columns):
            sentence = f"{place}: {kind} need a column for every joint, and {what}"
            raise WaypointsError(sentence, line, named[0])
    return columns


def _expected(robot: RobotModel) -> str:
    names = (f"{name}_{'mm' if linear else 'deg'}" for name, linear in zip(robot.joint_names, robot.linear))
    return f"expected {', '.join(names)} (or _rad, _m), and {_TIME} if the waypoints are timed"


def _numbers(line: int, text: str, separator: str, columns: list[str]) -> list[float]:
    cells = text.split(separator)
    if len(cells) != len(columns):
        found = (
            f"line {line}: {len(cells)} values between {separator!r}; expected {len(columns)}, one for each column, "
            "with decimal points"
        )
        raise WaypointsError(found, line, "", len(cells))
    numbers = []
    for name, cell in zip(columns, map(str.strip, cells)):
        if not _NUMBER.match(cell):
            match = _COLUMN.match(name)
            found = f"line {line}: {name} is {cell!r}; expected a number with a decimal point"
            raise WaypointsError(found, line, match["joint"] if match else "", cell)
        numbers.append(float(cell))
    return numbers


def _in_si(values: np.ndarray, columns: list[_Column]) -> np.ndarray:
    """Return some columns in SI."""
    return values[:, [index for index, _ in columns]] * [_FACTORS[unit] for _, unit in columns]
