"""The cell of a work: tool, recipes, scene, where the model stands, and the racks with the stock. Metres, degrees."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.process import Finite, Match, Recipes, read_recipes
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rpy_to_rotation
from construction_twin.robot.tool import FilePose, ToolFile, read_tool
from construction_twin.robot.urdf import read_yaml
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.validation import StrictModel

_Count = Annotated[int, pydantic.Field(ge=1, le=10000)]
_Step = Annotated[float, pydantic.Field(allow_inf_nan=False, gt=0.0, le=100.0)]
_RackName = Annotated[str, pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]


class _Rack(StrictModel):
    """Slots, `poses` in the rack's frame: where the middle of the underside of an element's box stands."""

    holds: Match = Match()
    surface: str = ""
    at: FilePose
    lies: Literal["as_built", "own_axes"] = "as_built"
    rpy_deg: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    refill: bool = False


class GridRack(_Rack):
    """Slots in rows along the rack's y and columns along its x."""

    kind: Literal["grid"]
    rows: _Count
    columns: _Count
    pitch: tuple[_Step, _Step]

    @property
    def poses(self) -> list[Pose]:
        """The slots, row by row."""
        x, y = self.pitch
        return [_at(column * x, row * y, 0.0) for row in range(self.rows) for column in range(self.columns)]


class StackRack(_Rack):
    """Elements on top of each other: what is needed first lies on top."""

    kind: Literal["stack"]
    levels: _Count
    step: _Step

    @property
    def poses(self) -> list[Pose]:
        """The slots, from below."""
        return [_at(0.0, 0.0, level * self.step) for level in range(self.levels)]


Rack = Annotated[GridRack | StackRack, pydantic.Field(discriminator="kind")]


class CellFile(StrictModel):
    """The keys of a cell file, explained in config/work/timber_panel.yaml."""

    tool: str
    recipes: str
    scene: str
    model_T_base: FilePose
    supports: tuple[str, ...] = ()
    racks: Annotated[dict[_RackName, Rack], pydantic.Field(min_length=1)]


@dataclass(frozen=True, eq=False)
class WorkCell:
    """The tool, recipes and scene of a cell file."""

    path: str
    file: CellFile
    tool: ToolFile
    recipes: Recipes
    scene: Scene

    @property
    def model_T_base(self) -> Pose:
        """The robot's base_link in the model."""
        return pose_of(self.file.model_T_base)


def read_work_cell(path: str | Path) -> WorkCell:
    """Read a cell file and the files that it names."""
    description = read_yaml(path, " of a cell, as config/work/timber_panel.yaml")
    cell = CellFile.read(description, str(path))
    folder = Path(path).resolve().parent
    tool, recipes = read_tool(folder / cell.tool), read_recipes(folder / cell.recipes)
    recipes.check_tool(tool.tool)
    scene = read_scene(folder / cell.scene)
    _check_names(str(path), cell, scene)
    return WorkCell(str(path), cell, tool, recipes, scene)


def _check_names(path: str, cell: CellFile, scene: Scene) -> None:
    known = f"one of the scene's objects: {', '.join(scene.names) or 'it has none'}"
    for name in cell.supports:
        if name not in scene.names:
            raise ConfigurationError(f"{path}/supports", name, known)
    for rack, description in cell.racks.items():
        if description.surface and description.surface not in scene.names:
            raise ConfigurationError(f"{path}/racks/{rack}/surface", description.surface, known)
    for item in scene.objects:
        if "/" in item.name:
            expected = "objects without / in their names, which belong to elements and tool"
            raise ConfigurationError(f"{path}/scene", item.name, expected)


def _at(x: float, y: float, z: float) -> Pose:
    return Pose(np.array([x, y, z]), np.eye(3))


def pose_of(place: FilePose) -> Pose:
    """Return a pose of a file."""
    return Pose(np.array(place.xyz), rpy_to_rotation(place.rpy_deg))


def inverse(a_T_b: Pose) -> Pose:
    """Return ``b_T_a``."""
    return Pose(-a_T_b.rotation.T @ a_T_b.position, a_T_b.rotation.T)
