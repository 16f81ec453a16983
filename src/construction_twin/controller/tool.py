"""A tool at gateway and controller: outputs, inputs and their readings in telegrams."""

from __future__ import annotations

import re
from dataclasses import dataclass

#: The channel without which none of the outputs may be changed; no output can have its name.
ENABLE = "Enable"
#: What may become of an output when RSI ends or a reply is missed, and the HOLDON that says so.
HOLDON = {"keep": True, "off": False}

_is_name = re.compile(r"[a-z][a-z0-9_]{0,23}").fullmatch


def is_tool_name(name: str) -> bool:
    """Return whether a name is valid for a tool's output or input."""
    return _is_name(name) is not None


@dataclass(frozen=True)
class ToolOutput:
    """An output; `on_stop`: ``keep`` or ``off`` at RSI's end or a missed reply; `opens`: the value that lets go, if one does."""

    name: str
    on_stop: str
    opens: bool | None = None


@dataclass(frozen=True)
class GatewayTool:
    """A tool, as its file was checked by `robot.tool`."""

    name: str
    outputs: tuple[ToolOutput, ...]
    inputs: tuple[str, ...]

    @classmethod
    def of_document(cls, document: dict) -> GatewayTool:
        """Return the tool of a configuration file; TypeError or KeyError for an invalid one."""
        outputs = tuple(ToolOutput(**output) for output in document["outputs"])
        return cls(**document | {"outputs": outputs, "inputs": tuple(document["inputs"])})


@dataclass(frozen=True, slots=True)
class ToolReading:
    """A tool's signals in a telegram, in the order of the reader's names."""

    outputs: tuple[bool, ...]
    inputs: tuple[bool, ...]
