"""Where the robots of one cell stand. Metres; degrees only in `load_cell` (``rpy_deg``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import wrong_value
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rpy_to_rotation
from construction_twin.scene.objects import relative

_Metres = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
_Degrees = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-360.0, le=360.0)]


class _Place(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    xyz: tuple[_Metres, _Metres, _Metres]
    rpy_deg: tuple[_Degrees, _Degrees, _Degrees]


@dataclass(frozen=True)
class Cell:
    """Robots and where they stand: ``world_T_root`` of each one's URDF, by the robot's name."""

    places: Mapping[str, Pose]

    def world_T_root(self, robot: str) -> Pose:  # noqa: N802 (a transform's name)
        """Return where a robot stands."""
        if robot not in self.places:
            raise ConfigurationError("the cell's robots", sorted(self.places), f"one named {robot!r}")
        return self.places[robot]

    def root_T_root(self, robot: str, other: str) -> Pose:  # noqa: N802 (a transform's name)
        """Return where another robot stands, seen from a robot; raises like `world_T_root`."""
        return relative(self.world_T_root(robot), self.world_T_root(other))


_PLACES = pydantic.TypeAdapter(dict[str, _Place])


def load_cell(description: object) -> Cell:
    """Build a cell from a parsed YAML file, see config/cell_two_robots.yaml."""
    try:
        places = _PLACES.validate_python(description)
    except pydantic.ValidationError as error:
        wrong = wrong_value(error, _PLACES.json_schema())
        raise ConfigurationError("/".join(filter(None, ("cell", wrong.key))), wrong.value, wrong.expected) from error
    return Cell({name: Pose(np.array(place.xyz), rpy_to_rotation(place.rpy_deg)) for name, place in places.items()})
