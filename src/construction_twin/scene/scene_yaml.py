"""Scenes from YAML files. Metres; degrees in ``rpy_deg``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import pydantic
import yaml

from construction_twin.core.errors import system_message
from construction_twin.robot.frames import rpy_to_quaternion
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.validation import StrictModel, wrong_value

#: Stands for the path of a scene without objects and padding: roslaunch drops an argument that is empty.
NONE = "none"

_Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]


class _ObjectDescription(StrictModel):
    """One object in YAML: see the comments in config/scene.yaml."""

    shape: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[_Finite, ...] = ()
    position: tuple[_Finite, _Finite, _Finite] = (0.0, 0.0, 0.0)
    rpy_deg: tuple[_Finite, _Finite, _Finite] = (0.0, 0.0, 0.0)
    padding: _Finite = 0.0
    mesh: str = ""
    link: str = ""
    touch: tuple[str, ...] = ()
    fixed: bool = False


class _SceneDescription(StrictModel):
    padding: _Finite
    objects: dict[str, _ObjectDescription]


def load_scene(description: Mapping, base_dir: str | Path) -> Scene:
    """Build a scene from a parsed YAML file, see config/scene.yaml, whose mesh files are relative to `base_dir`."""
    try:
        parsed = _SceneDescription.model_validate(dict(description))
    except pydantic.ValidationError as error:
        wrong = wrong_value(error, _SceneDescription.model_json_schema())
        raise SceneError("/".join(filter(None, ("scene", wrong.key))), wrong.value, wrong.expected) from error
    objects = (_object(name, item, Path(base_dir)) for name, item in parsed.objects.items())
    return Scene(tuple(objects), parsed.padding)


def read_scene(path: str | Path) -> Scene:
    """Read a scene from a YAML file, see `load_scene`; `NONE` or an empty path: a scene of nothing."""
    if str(path) in ("", NONE):
        return Scene()
    try:
        description = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SceneError(str(path), system_message(error), "a YAML file of a scene") from error
    if not isinstance(description, dict):
        raise SceneError(str(path), description, "a mapping with the keys padding and objects")
    return load_scene(description, Path(path).parent)


def _object(name: str, item: _ObjectDescription, base_dir: Path) -> SceneObject:
    values = item.model_dump(exclude={"rpy_deg", "mesh"})
    x, y, z, w = map(float, rpy_to_quaternion(item.rpy_deg))
    mesh = str((base_dir / item.mesh).resolve()) if item.mesh else ""
    return SceneObject(name=name, quaternion=(x, y, z, w), mesh=mesh, **values)
