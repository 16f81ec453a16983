"""The cell of a work: tool, recipes, surroundings, where the model stands, and the racks with the stock.

Read from a YAML file, see config/work/timber_panel.yaml. Metres; degrees only in the file's ``rpy_deg``. Frames: `base` is the
robot's base_link, `model` the building model's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import configuration_error
from construction_twin.extensions.work.building import BuildingModel, Element
from construction_twin.extensions.work.recipe import PROPERTY_SET, Match, Strict
from construction_twin.extensions.work.recipes import DELIVERED, Recipes, read_recipes
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rpy_to_rotation
from construction_twin.robot.tool import Place as FilePose
from construction_twin.robot.tool import ToolFile, read_tool
from construction_twin.robot.urdf import read_yaml
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_yaml import read_scene

#: Poses of the file are this close to the origin [m]; in binary fractions a map's coordinates would cost accuracy.
FARTHEST = 1e4
_Finite = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-FARTHEST, le=FARTHEST)]
_Count = Annotated[int, pydantic.Field(ge=1, le=10000)]
_Step = Annotated[float, pydantic.Field(allow_inf_nan=False, gt=0.0, le=100.0)]
_Vector = tuple[_Finite, _Finite, _Finite]
_RackName = Annotated[str, pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]


class _Rack(Strict):
    """What every rack has.

    Attributes:
        holds: Which elements it holds; an element belongs to the first rack that fits.
        frame: ``base`` or ``model``: what its poses are in.
        order: ``schedule``: slots are filled in the order in which the elements are needed; ``file``: in the order of the model.
        surface: Name of the scene's object that the elements lie on; empty: none.
    """

    holds: Match = Match()
    frame: Literal["base", "model"] = "base"
    order: Literal["schedule", "file"] = "schedule"
    surface: str = ""


class LyingRack(_Rack):
    """Racks with slots of their own: a slot is where the middle of the underside of an element's box stands.

    Attributes:
        at: The first slot, and the directions of the rack.
        lies: ``as_built``: the elements lie in the rack's frame as they do in the model's; ``own_axes``: their own axes along the
            rack's.
        rpy_deg: Turn of the element on top of that, about the rack's x, y and z axes [deg].
        refill: A slot is filled again when its element has been taken; otherwise more elements than slots are refused.
    """

    at: FilePose
    lies: Literal["as_built", "own_axes"] = "as_built"
    rpy_deg: _Vector = (0.0, 0.0, 0.0)
    refill: bool = False


class GridRack(LyingRack):
    """Slots in rows (along the rack's y) and columns (along its x)."""

    kind: Literal["grid"]
    rows: _Count
    columns: _Count
    pitch: tuple[_Step, _Step]

    @property
    def count(self) -> int:
        """How many slots it has."""
        return self.rows * self.columns

    def slot(self, at: int, filled: int) -> Pose:
        """Return the pose of a slot in the rack, of which the first `filled` are filled."""
        row, column = divmod(at, self.columns)
        return Pose(np.array([column * self.pitch[0], row * self.pitch[1], 0.0]), np.eye(3))


class StackRack(LyingRack):
    """Elements on top of each other: what is needed first lies on top."""

    kind: Literal["stack"]
    levels: _Count
    step: _Step

    @property
    def count(self) -> int:
        """How many slots it has."""
        return self.levels

    def slot(self, at: int, filled: int) -> Pose:
        """Return the pose of a slot in the rack, of which the first `filled` are filled."""
        return Pose(np.array([0.0, 0.0, (filled - 1 - at) * self.step]), np.eye(3))


class ListRack(LyingRack):
    """Slots at poses of their own, in the rack's frame."""

    kind: Literal["list"]
    slots: Annotated[tuple[FilePose, ...], pydantic.Field(min_length=1)]

    @property
    def count(self) -> int:
        """How many slots it has."""
        return len(self.slots)

    def slot(self, at: int, filled: int) -> Pose:
        """Return the pose of a slot in the rack, of which the first `filled` are filled."""
        return pose_of(self.slots[at])


class DeliveredRack(_Rack):
    """The model says where the elements are delivered.

    Attributes:
        offset: Every element lies this far from where it will be built, in the model's frame, turned about its own origin.
        property: ``Pset.Name`` of a text ``x y z`` or ``x y z roll pitch yaw`` [m, deg]: where the element's frame is, in `frame`.
    """

    kind: Literal["delivered"]
    offset: FilePose | None = None
    property: Annotated[str, pydantic.Field(pattern=r"^[^.]+\.[^.]+$")] = f"{PROPERTY_SET}.{DELIVERED}"


Rack = Annotated[GridRack | StackRack | ListRack | DeliveredRack, pydantic.Field(discriminator="kind")]


class CellFile(Strict):
    """The keys of a cell file, each explained in config/work/timber_panel.yaml.

    Attributes:
        model_T_base: Where the robot's base_link is in the model.
        base_element: GlobalId or name of the element of the model that stands for the robot's base_link; empty: `model_T_base` is
            given.
        supports: Objects of the scene that elements are set down on.
    """

    tool: str
    recipes: str
    scene: str
    model_T_base: FilePose | None = None
    base_element: str = ""
    supports: tuple[str, ...] = ()
    racks: Annotated[dict[_RackName, Rack], pydantic.Field(min_length=1)]

    @pydantic.model_validator(mode="after")
    def _one_place(self) -> CellFile:
        if (self.model_T_base is None) == (not self.base_element):
            raise ValueError("either model_T_base or base_element")
        return self


@dataclass(frozen=True, eq=False)
class Site:
    """A cell, read."""

    path: str
    file: CellFile
    tool: ToolFile
    recipes: Recipes
    scene: Scene

    def model_T_base(self, building: BuildingModel) -> Pose:
        """Return where the robot's base_link is in a model."""
        if self.file.model_T_base is not None:
            return pose_of(self.file.model_T_base)
        return self.base(building).model_T_element

    def base(self, building: BuildingModel) -> Element:
        """Return the element that stands for the robot's base; raises as `model_T_base`."""
        asked = self.file.base_element
        if asked in building.elements:
            return building.elements[asked]
        found = [element for element in building.elements.values() if element.name == asked]
        if len(found) != 1:
            expected = f"GlobalId or name of one element of {building.file}; {len(found)} have this name"
            raise ConfigurationError(f"{self.path}/base_element", asked, expected)
        return found[0]


def read_site(path: str | Path) -> Site:
    """Read a cell file and the files that it names."""
    description = read_yaml(path, " of a cell, as config/work/timber_panel.yaml")
    try:
        cell = CellFile.model_validate(description)
    except pydantic.ValidationError as error:
        raise configuration_error(error, CellFile, str(path)) from error
    folder = Path(path).resolve().parent
    tool, recipes = read_tool(folder / cell.tool), read_recipes(folder / cell.recipes)
    recipes.check_tool(tool.tool)
    scene = read_scene(folder / cell.scene)
    _check_names(str(path), cell, scene)
    return Site(str(path), cell, tool, recipes, scene)


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


def pose_of(place: FilePose) -> Pose:
    """Return a pose of a file."""
    return Pose(np.array(place.xyz), rpy_to_rotation(place.rpy_deg))


def inverse(a_T_b: Pose) -> Pose:
    """Return ``b_T_a``."""
    return Pose(-a_T_b.rotation.T @ a_T_b.position, a_T_b.rotation.T)
