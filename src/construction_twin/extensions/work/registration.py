"""Where the robot stands in the model: `model_T_base` from points known in both, and its place in the cell file."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file, write_atomically
from construction_twin.extensions.work.errors import PlacementError
from construction_twin.extensions.work.work_cell import read_work_cell
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rotation_to_abc

#: Points must reach at least so far across the line that fits them best [m]: less leaves the rotation about it open.
_LEAST_SPREAD = 0.05
#: A reflection or another scale that fits so many times better is named as the cause.
_BETTER = 10.0
_LARGEST_FILE = 1 << 20
_AXES = ("x", "y", "z")
_COLUMNS = (
    "name; base_x, base_y, base_z; model_x, model_y, model_z or model (the name of an element); _mm behind one in mm"
)


@dataclass(frozen=True)
class Registration:
    """Where the base stands.

    Attributes:
        residuals: Distance of each point from where the fit has it [m], by name.
    """

    model_T_base: Pose
    residuals: dict[str, float]

    @property
    def tilt(self) -> float:
        """The angle between the base's z axis and the model's [rad]."""
        return float(np.arccos(np.clip(self.model_T_base.rotation[2, 2], -1.0, 1.0)))

    def __str__(self) -> str:
        return ", ".join(f"{name} {1e3 * residual:.2f}" for name, residual in self.residuals.items()) + " mm"


def read_points(path: Path, element: Callable[[str], np.ndarray]) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Read pairs of points from a CSV file, with commas, or with semicolons and then decimal points or commas.

    Args:
        element: Origin of the element of that name in the model, shape (3,) [m].

    Returns:
        Names; positions in base_link and in the model, shape (n, 3) each [m].
    """
    try:
        text = read_file(path, _LARGEST_FILE).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigurationError(str(path), f"byte {error.start}", "text in UTF-8") from error
    german = ";" in text.partition("\n")[0]
    rows = csv.DictReader(io.StringIO(text), delimiter=";" if german else ",", skipinitialspace=True)

    def number(where: str, row: dict[str, str], column: str) -> float:
        key, unit = next(
            ((key, unit) for key, unit in ((column, 1.0), (f"{column}_mm", 1e-3)) if key in row), (column, 1)
        )
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
    """Fit ``model_T_base`` by least squares (Kabsch).

    Args:
        base, model: The points in base_link and in the model, shape (n, 3) each [m].
        most: Largest residual that is accepted [m].

    Raises:
        PlacementError: Too few points, all on a line, or a residual above `most`; names the likely cause.
    """
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
            f"{names[int(residuals.argmax())]} is {1e3 * residuals.max():.1f} mm off, {1e3 * most:.1f} mm allowed: "
            f"{_cause(names, base, model, residuals.max())} ({Registration(pose, dict(zip(names, residuals)))})"
        )
    return Registration(pose, dict(zip(names, residuals.tolist())))


def _fit(base: np.ndarray, model: np.ndarray) -> tuple[Pose, np.ndarray]:
    """Return the pose and the residuals, shape (n,)."""
    # about the means: with coordinates of 10 km the products of whole ones would lose what is sought
    base_mean, model_mean = base.mean(axis=0), model.mean(axis=0)
    u, _, vt = np.linalg.svd((model - model_mean).T @ (base - base_mean))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    residuals = np.linalg.norm((base - base_mean) @ rotation.T - (model - model_mean), axis=1)
    return Pose(model_mean - rotation @ base_mean, rotation), residuals


def _cause(names: Sequence[str], base: np.ndarray, model: np.ndarray, worst: float) -> str:
    """Say which single mistake would explain the residuals."""
    scale = float(np.linalg.norm(base - base.mean(axis=0)) / np.linalg.norm(model - model.mean(axis=0)))
    if _fit(base, scale * model)[1].max() * _BETTER < worst * max(scale, 1.0) and abs(scale - 1.0) > 0.01:
        return f"distances in the base are {scale:.6g} times those in the model; look at the units of the columns"
    if _fit(base * [1.0, -1.0, 1.0], model)[1].max() * _BETTER < worst:
        return "one of the two is mirrored; look for a changed sign, or for two columns that are exchanged"
    if len(names) > 3:
        without = [_fit(np.delete(base, n, 0), np.delete(model, n, 0))[1].max() for n in range(len(names))]
        best = int(np.argmin(without))
        if without[best] * _BETTER < worst:
            return f"without {names[best]} the largest would be {1e3 * without[best]:.1f} mm; measure that point again"
    return "look whether each point of the base is the one of the model, and measure again"


def write_base(cell: Path, registration: Registration, remark: str) -> None:
    """Write ``model_T_base`` into a cell file, in place of what says where the base stands; all else stays as it is.

    Args:
        remark: Comment behind it, one line.
    """
    text = cell.read_text(encoding="utf-8")
    document = yaml.compose(text)
    assert document is not None  # the command has read it
    keys = {key.value: (key, value) for key, value in document.value}
    key, value = keys.get("model_T_base") or keys["base_element"]
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
    """Return where a value ends; the mark of one in lines of its own stands behind the comments that follow it."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last)
    return node.end_mark.index
