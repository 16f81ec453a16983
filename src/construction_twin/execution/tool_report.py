"""What is known of the tool: its outputs, inputs, and the switches that were asked for. Pure; built from `ToolState.msg`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Signal

#: Why nothing is known before the first report.
NO_REPORT = "no report of the tool yet; check that bridge and gateway run"
#: Why there is none without a physical arm.
NO_ARM = "there is no physical arm (`arm:=none`), so nothing switches or reads a tool"


class SwitchState(Enum):
    """What became of a switch that was asked for; values are those of `ToolState.msg`."""

    ARMED = 0
    FIRED = 1
    VOID = 2
    REFUSED = 3


@dataclass(frozen=True)
class SwitchReport:
    """What the gateway says of one switch: its state, and one sentence."""

    state: SwitchState
    reason: str = ""


@dataclass(frozen=True)
class ToolReport:
    """The newest report.

    Attributes:
        known: Whether the outputs were read back in this RSI session: what is told below is true.
        tool: Name of the tool; empty: a tool without hands.
        outputs: Names.
        switches: The last switches that were asked for, by id.
        reason: Why nothing is known.
    """

    known: bool = False
    tool: str = ""
    outputs: tuple[str, ...] = ()
    inputs: Mapping[str, bool] = field(default_factory=dict)
    switches: Mapping[str, SwitchReport] = field(default_factory=dict)
    reason: str = NO_REPORT

    def problem(self, signals: Iterable[Signal]) -> str:
        """Return why the inputs are not known to read what these signals say, as a clause; "" when they do, or none are named."""
        signals = tuple(signals)
        if not signals:
            return ""
        if not self.known:
            return self.unknown()
        for signal in signals:
            if signal.name not in self.inputs:
                return f"the tool {self.tool!r} has no input {signal.name!r}"
            if self.inputs[signal.name] is not signal.value:
                return f"{signal.name} reads {_word(self.inputs[signal.name])}, not {_word(signal.value)}"
        return ""

    def unknown(self) -> str:
        """Return why nothing is known of the tool, as a clause; "" when it is known."""
        return "" if self.known else f"the tool's state is not known: {self.reason or NO_REPORT}"

    def awaited(self, plan: Plan) -> str:
        """Return what passes by itself and is against a work plan, as a clause: its tool is not known yet. "" when nothing is."""
        return self.unknown() if needs_tool(plan) and self.reason != NO_ARM else ""

    def lacks(self, plan: Plan) -> str:
        """Return what a work plan needs of the tool and is not there, as a clause; "" when nothing is missing."""
        if not needs_tool(plan):
            return ""
        if problem := self.awaited(plan) or self.unknown():
            return problem
        if not self.tool:
            return "the gateway's configuration names no tool"
        for segment in plan.segments:
            for switch in segment.switches:
                if switch.output not in self.outputs:
                    return f"the tool {self.tool!r} has no output {switch.output!r}"
            confirmed = [signal for switch in segment.switches for signal in switch.confirm]
            for signal in (*segment.requires, *confirmed):
                if signal.name not in self.inputs:
                    return f"the tool {self.tool!r} has no input {signal.name!r}"
        return ""


def needs_tool(plan: Plan) -> bool:
    """Return whether a plan switches the tool or requires something of its inputs."""
    return any(segment.switches or segment.requires for segment in plan.segments)


def _word(value: bool) -> str:
    return "on" if value else "off"
