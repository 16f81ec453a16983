"""The sets of files in krl/, and the numbers that all of them use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from construction_twin.rsi.make import receive_channels, send_channels

TIMEOUT, FLAG, PRECISION = 100, 1, 6
#: Length of each axis' range [deg]: a correction can never be larger, wherever the session starts. KR 120 R2500 pro.
SPAN = {"A1": 370, "A2": 135, "A3": 275, "A4": 700, "A5": 250, "A6": 700}
#: Placeholder for a track [mm]: longer than any.
TRACK = 30000


@dataclass(frozen=True)
class Variant:
    """One set of files: its name, whether it moves E1, whether it only listens, and its tool.

    `outputs` says of each output of the tool whether it keeps its value when a reply is missed, `inputs` names its inputs.
    `first_out` and `first_in` are the numbers of the first one in `$OUT` and `$IN`; the others follow.
    """

    name: str
    external: bool = False
    read_only: bool = False
    outputs: Mapping[str, bool] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    first_out: int = 1
    first_in: int = 1

    @property
    def ethernet(self) -> str:
        """Name of the Ethernet XML."""
        return f"{self.name}_ethernet.xml"

    @property
    def axes(self) -> tuple[str, ...]:
        """RSI axes that are corrected."""
        return (*SPAN, *(("E1",) if self.external else ()))

    @property
    def channels(self) -> list[tuple[str, str, int, int]]:
        """RECEIVE: TAG, TYPE, INDX, HOLDON."""
        if self.read_only:
            return []
        found = receive_channels(self.axes, self.outputs)
        return [(tag, kind, index, holdon) for index, (tag, kind, holdon) in enumerate(found, 1)]

    @property
    def sent(self) -> list[str]:
        """SEND: TAGs of the tool, in the order of their INDX, from 1."""
        return send_channels(list(self.outputs), self.inputs)


#: Outputs and inputs of config/tools/vacuum_frame.yaml.
VACUUM_FRAME = {"outputs": {"vacuum": True}, "inputs": ("vacuum_reached",)}

VARIANTS = (
    Variant("ctwin"),
    Variant("ctwin_e1", external=True),
    Variant("ctwin_ro", read_only=True),
    Variant("ctwin_tool", **VACUUM_FRAME),
    Variant("ctwin_e1_tool", external=True, **VACUUM_FRAME),
)
