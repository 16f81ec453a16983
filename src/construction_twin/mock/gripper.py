"""The tool at the mock's flange: the controller's outputs and inputs, what connects them to telegrams, and a simulated gripper.

Outputs outlive every session. The channels of a reply set and reset them behind `ENABLE`, as in the files of krl/: on rising edges.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from construction_twin.controller.port import ENABLE, Layout

_NOTHING: Mapping[str, bool] = MappingProxyType({})


@dataclass(frozen=True)
class Gripper:
    """The simulated grip: outputs that close and open it, the inputs then, and the time from the ones to the others [s]."""

    close: Mapping[str, bool] = field(default_factory=dict)
    closed: Mapping[str, bool] = field(default_factory=dict)
    open: Mapping[str, bool] = field(default_factory=dict)
    opened: Mapping[str, bool] = field(default_factory=dict)
    time: float = 0.2


class SimulatedTool:
    """The tool of one mock controller.

    Attributes:
        fails, lost, hidden: Faults: the grip does not close; it has let go, until it is opened; telegrams hide the outputs.
    """

    def __init__(self, layout: Layout, gripper: Gripper, period: float):
        self._names = layout.switched
        self._holdon = layout.switched_holdon
        self._gripper = gripper
        self._wait = max(1, round(gripper.time / period))
        self.outputs = {name: False for name in layout.outputs}
        self.inputs = {name: False for name in layout.inputs}
        self.inputs |= {name: value for name, value in gripper.opened.items() if name in self.inputs}
        self.fails = self.lost = self.hidden = False
        self._target: Mapping[str, bool] = _NOTHING
        self._due = 0
        self.begin_session()

    def begin_session(self) -> None:
        """Begin a session: every channel of a reply is 0 before the first reply; outputs stay."""
        self._channels = (False,) * len(self._names)
        self._edges: dict[str, bool | None] = {}

    def on_reply(self, switched: tuple[bool, ...]) -> None:
        """Switch the outputs by the channels of a valid reply."""
        self._channels = switched
        self._switch_outputs()

    def on_missed_reply(self) -> None:
        """Switch the outputs at a missed reply: HOLDON decides."""
        self._channels = tuple([value and held for value, held in zip(self._channels, self._holdon)])
        self._switch_outputs()

    def _switch_outputs(self) -> None:
        values = dict(zip(self._names, self._channels))
        enabled = values.pop(ENABLE, False)
        for name, value in values.items():
            # AND of Enable with the channel sets, AND of Enable with its opposite resets, each on a rising edge
            edge = value if enabled else None
            if edge is not None and edge is not self._edges.get(name):
                self.outputs[name] = edge
            self._edges[name] = edge

    def step(self) -> None:
        """Let a cycle pass: the inputs follow the outputs."""
        gripper = self._gripper
        target = _NOTHING
        if gripper.close and self._reads(self.outputs, gripper.close):
            target = gripper.opened if self.fails or self.lost else gripper.closed
        elif gripper.open and self._reads(self.outputs, gripper.open):
            target = gripper.opened
            self.lost = False
        if target is not self._target:
            self._target, self._due = target, 1 if self.lost else self._wait  # a lost element is read in this cycle
        if self._due:
            self._due -= 1
            if not self._due:
                self.inputs |= {name: value for name, value in target.items() if name in self.inputs}

    def open_by_hand(self) -> None:
        """Let a person at the pendant switch the outputs to what opens the grip; the channels of the replies stay as they are."""
        self.outputs |= {name: value for name, value in self._gripper.open.items() if name in self.outputs}

    @staticmethod
    def _reads(values: Mapping[str, bool], wanted: Mapping[str, bool]) -> bool:
        return all(values.get(name) is value for name, value in wanted.items())
