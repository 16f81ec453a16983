"""A tool as gateway and controller know it: its outputs and inputs, and what telegrams tell of them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from construction_twin.core.errors import ConfigurationError

#: The channel without which none of the outputs may be changed; no output can have its name.
ENABLE = "Enable"
#: What may become of an output when RSI ends or a reply is missed, and the HOLDON that says so.
HOLDON = {"keep": True, "off": False}

_is_name = re.compile(r"[a-z][a-z0-9_]{0,23}").fullmatch


def is_tool_name(name: str) -> bool:
    """Return whether an output or input of a tool can be called so."""
    return _is_name(name) is not None


@dataclass(frozen=True)
class ToolOutput:
    """An output.

    Attributes:
        on_stop: ``keep`` or ``off``: what becomes of it when RSI ends or a reply is missed.
        opens: The value that lets go of a workpiece; None: neither does.
    """

    name: str
    on_stop: str
    opens: bool | None = None


@dataclass(frozen=True)
class GatewayTool:
    """A tool; its name is that of the tool file."""

    name: str
    outputs: tuple[ToolOutput, ...]
    inputs: tuple[str, ...]

    def __post_init__(self):
        names = [*(output.name for output in self.outputs), *self.inputs]
        for name in (self.name, *names):
            if not isinstance(name, str) or not is_tool_name(name):
                raise ConfigurationError("tool", name, "a name of small letters, digits and '_', at most 24")
        for kind, found in (("outputs", names[: len(self.outputs)]), ("inputs", list(self.inputs))):
            if not found or len(set(found)) != len(found):
                raise ConfigurationError(f"tool {kind}", found, "at least one, each once")
        for output in self.outputs:
            if output.on_stop not in HOLDON or output.opens not in (True, False, None):
                expected = "on_stop keep or off, opens true, false or nothing"
                raise ConfigurationError(f"tool output {output.name}", (output.on_stop, output.opens), expected)
            if output.on_stop == "off" and output.opens is False:
                expected = "on_stop keep, or opens true: one missed reply would drop the part"
                raise ConfigurationError(f"tool output {output.name}", (output.on_stop, output.opens), expected)

    @classmethod
    def of_document(cls, document: dict) -> GatewayTool:
        """Return the tool of a configuration file; TypeError or KeyError when it is none."""
        outputs = tuple(ToolOutput(**output) for output in document["outputs"])
        return cls(**document | {"outputs": outputs, "inputs": tuple(document["inputs"])})


@dataclass(frozen=True, slots=True)
class ToolReading:
    """What a telegram tells of a tool, in the order of the reader's names."""

    outputs: tuple[bool, ...]
    inputs: tuple[bool, ...]
