"""A tool at the flange, from a YAML file (config/tools/vacuum_frame.yaml). Metres, kilograms; degrees only in ``rpy_deg``."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from construction_twin.core.errors import ConfigurationError, system_message
from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.urdf import read_yaml
from construction_twin.validation import StrictModel

_Name = Annotated[str, pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=24)]
_Finite = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
_Positive = Annotated[float, pydantic.Field(allow_inf_nan=False, gt=0.0, le=1e4)]
_Vector = tuple[_Finite, _Finite, _Finite]


class FilePose(StrictModel):
    """A pose in a file: `xyz` [m], and turns about the fixed x, y and z axes, in this order."""

    xyz: _Vector
    rpy_deg: _Vector = (0.0, 0.0, 0.0)


class ToolShape(StrictModel):
    """One body of the tool, in the flange's frame; keys as in config/scene.yaml."""

    shape: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[_Finite, ...] = ()
    position: _Vector = (0.0, 0.0, 0.0)
    rpy_deg: _Vector = (0.0, 0.0, 0.0)
    mesh: str = ""


class Cups(StrictModel):
    """Suction cups at places in the plane of the TCP [m]; what one holds has the safety factor in it [kg]."""

    radius: _Positive
    holds: _Positive
    at: Annotated[tuple[tuple[_Finite, _Finite], ...], pydantic.Field(min_length=1)]


class Output(StrictModel):
    """One output: `on_stop`: what becomes of it when RSI ends or a reply is missed; `opens`: the value that lets a workpiece go."""

    on_stop: Literal["keep", "off"]
    opens: bool | None = None

    @pydantic.model_validator(mode="after")
    def _check_stop_value(self) -> Output:
        if self.on_stop == "off" and self.opens is False:
            raise ValueError("on_stop keep, or opens true: one missed reply would drop the part")
        return self

    @pydantic.field_validator("on_stop", mode="before")
    @classmethod
    def _off_in_yaml(cls, value: object) -> object:
        # an `off` without quotation marks is false in YAML
        return "off" if value is False else value


class Action(StrictModel):
    """What closes or opens the grip: outputs, and what the inputs must read afterwards within `timeout` [s]."""

    set: Annotated[dict[_Name, bool], pydantic.Field(min_length=1)]
    confirm: Annotated[dict[_Name, bool], pydantic.Field(min_length=1)]
    timeout: Annotated[float, pydantic.Field(gt=0.0, le=60.0)]

    def switches(self) -> tuple[Switch, ...]:
        """Return the switches; each waits for all of the confirmation."""
        return tuple(Switch(name, value, self.signals(), self.timeout) for name, value in self.set.items())

    def signals(self) -> tuple[Signal, ...]:
        """Return what the inputs read while the action holds."""
        return tuple(Signal(name, value) for name, value in self.confirm.items())


class Tool(StrictModel):
    """A tool. The keys of the file, each explained in config/tools/vacuum_frame.yaml."""

    name: _Name
    tool0_T_tcp: FilePose
    mass: _Positive
    payload: _Positive
    load: _Positive
    shapes: dict[_Name, ToolShape]
    touch: tuple[str, ...] = ()
    cups: Cups | None = None
    outputs: Annotated[dict[_Name, Output], pydantic.Field(min_length=1, max_length=8)]
    inputs: Annotated[tuple[_Name, ...], pydantic.Field(min_length=1, max_length=8)]
    grip: Action
    release: Action

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Tool:
        if len(set(self.inputs)) != len(self.inputs):
            raise ValueError("inputs with different names")
        if self.mass + self.payload > self.load:
            raise ValueError(f"mass and payload, {self.mass + self.payload:g} kg, within load, {self.load:g} kg")
        for name, action in (("grip", self.grip), ("release", self.release)):
            unknown = sorted((set(action.set) - set(self.outputs)) | (set(action.confirm) - set(self.inputs)))
            if unknown:
                known = ", ".join((*self.outputs, *self.inputs))
                raise ValueError(f"in {name} outputs and inputs that the file has ({known}), not {', '.join(unknown)}")
        opening = {name: output.opens for name, output in self.outputs.items() if output.opens is not None}
        if not opening:
            raise ValueError("opens for at least one output: the value that lets go of a workpiece")
        for name, value in opening.items():
            if self.grip.set.get(name) is value:
                raise ValueError(f"a grip that does not set {name} to the value that opens")
            if self.release.set.get(name) is not value:
                raise ValueError(f"a release that sets {name} to the value that opens")
        return self


@dataclass(frozen=True)
class ToolFile:
    """A tool, and the folder that its mesh files are relative to."""

    tool: Tool
    folder: Path


def read_tool(path: str | Path) -> ToolFile:
    """Read a tool file."""
    return ToolFile(tool_of(read_yaml(path, " of a tool"), str(path)), Path(path).resolve().parent)


def tool_hash(path: str | Path) -> str:
    """Return the SHA-256 of a tool file; empty for no file; raises like `read_tool`."""
    if not path:
        return ""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigurationError(str(path), system_message(error), "a YAML file of a tool") from error


def tool_of(description: object, where: str) -> Tool:
    """Parse the content of a tool file; ConfigurationError names `where` it is invalid."""
    return Tool.read(description, where)
