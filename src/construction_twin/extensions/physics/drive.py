"""The drives of the axes: torques, motor inertias, friction, and the arm's payload rating. SI.

Torque limits are the URDF's ``effort``; the rest is in a file of the arm (config/kr120_drives.yaml), or zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf, read_yaml
from construction_twin.validation import StrictModel

_Positive = Annotated[float, pydantic.Field(gt=0.0, le=1e7, allow_inf_nan=False)]
_NotNegative = Annotated[float, pydantic.Field(ge=0.0, le=1e7, allow_inf_nan=False)]
_Finite = Annotated[float, pydantic.Field(ge=-1e4, le=1e4, allow_inf_nan=False)]


class PayloadRating(StrictModel):
    """The payload permitted at the flange; None: unknown.

    Attributes:
        across_m, along_m: How far the load's centre of mass may be from the flange, across the last axis and along it.
    """

    mass_kg: _Positive
    inertia_kg_m2: _Positive | None = None
    across_m: _Positive | None = None
    along_m: _Positive | None = None
    source: str


@dataclass(frozen=True)
class ArmDrives:
    """The drives of an arm, in the order of ``robot.joint_names``.

    Attributes:
        torque: What an axis can give [N m], of a linear one [N]; None: unknown.
        armature: Inertia of motor and gear, seen from the axis [kg m^2], [kg].
        damping: Friction that grows with speed [N m s/rad], [N s/m].
        friction: Friction at any speed [N m], [N].
        source: Where the torques are from.
        estimates: Keys of the file that are estimates, `torque` also where it is the URDF's effort; `link_masses`: the URDF's.
    """

    torque: tuple[float | None, ...]
    armature: tuple[float, ...]
    damping: tuple[float, ...]
    friction: tuple[float, ...]
    rating: PayloadRating | None
    source: str
    estimates: tuple[str, ...]

    @property
    def remarks(self) -> list[str]:
        """Sentence on the estimates; empty for none."""
        keys = ", ".join(self.estimates).replace("_", " ")
        return [f"of the arm these are estimates: {keys}; torques: {self.source}"] if keys else []


class _Axis(StrictModel):
    """One axis of the file; units in the keys are those of an axis that turns."""

    torque_nm: _Positive | None = None
    armature_kg_m2: _NotNegative = 0.0
    damping_nm_s: _NotNegative = 0.0
    friction_nm: _NotNegative = 0.0


class _DrivesFile(StrictModel):
    robot: str
    source: str
    joints: dict[str, _Axis]
    payload: PayloadRating | None = None
    # a word that is none would leave an estimate unnamed
    estimates: tuple[Literal["torque", "armature", "damping", "friction", "payload", "link_masses"], ...] = ()


def drives_of(robot: RobotModel) -> ArmDrives:
    """Return what the URDF alone says: its efforts, as estimates."""
    zeros = (0.0,) * len(robot.joint_names)
    return ArmDrives(_efforts(robot), zeros, zeros, zeros, None, "URDF effort", ("torque", "armature", "friction"))


def read_drives(path: str | Path, robot: RobotModel) -> ArmDrives:
    """Read the file of an arm's drives, see config/kr120_drives.yaml; no such file: what the URDF says."""
    if not Path(path).is_file():
        return drives_of(robot)
    where = str(path)
    read = _DrivesFile.read(read_yaml(path), where)
    if set(read.joints) != set(robot.joint_names):
        expected = f"one entry for each of {list(robot.joint_names)}"
        raise ConfigurationError(f"{where}/joints", sorted(read.joints), expected)
    axes = [read.joints[name] for name in robot.joint_names]
    efforts = _efforts(robot)
    return ArmDrives(
        tuple(axis.torque_nm or effort for axis, effort in zip(axes, efforts)),
        tuple(axis.armature_kg_m2 for axis in axes),
        tuple(axis.damping_nm_s for axis in axes),
        tuple(axis.friction_nm for axis in axes),
        read.payload,
        read.source,
        read.estimates,
    )


def _efforts(robot: RobotModel) -> tuple[float | None, ...]:
    limits: Mapping[str, object] = parse_urdf(robot.urdf).joint_map
    efforts = (getattr(limits[name].limit, "effort", None) for name in robot.joint_names)  # type: ignore[attr-defined]
    return tuple(float(effort) if effort else None for effort in efforts)
