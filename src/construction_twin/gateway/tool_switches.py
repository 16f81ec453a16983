"""The tool's outputs: what replies carry, and the switches that fire in the cycle in which the playout passes their stamps.

Until the first switch fires, replies carry what was read back, with `Set.Enable` 0: the controller leaves its outputs alone. A
switch is armed ahead, while a stream is followed; it fires once, or is void for good. An output that is off without RSI, and that a
missed reply has switched off, stays off. Cycles are counted in telegrams, stamps are the playout's [ns].
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

from construction_twin.controller.port import ENABLE, GatewayTool, Layout, ToolReading
from construction_twin.core.reports import SwitchState
from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.core.units import NANOSECONDS

#: Largest lead of a switch over the playout [s]: a later one belongs to a motion that is not there yet.
MOST_AHEAD = 2.0
#: Switches in the status.
MOST_REPORTED = 16
#: Longest id of a switch, and name of an output [characters].
LONGEST_TEXT = 160
#: Ids of switches that are remembered: one is used once.
MEMORY = 1000
#: While outputs read back otherwise than commanded for longer than this, nothing is switched [s].
LONGEST_DIFFERENCE = 0.1
#: Inputs that chatter are published no more often than this [s].
SHORTEST_PAUSE = 0.05

_NOT_READABLE, _FIRED = Sentence("telegrams do not tell Out and In, each channel as 0 or 1"), Sentence("fired")


@dataclass
class ToolSwitch:
    """One switch; it fires with the setpoint of `stamp` [ns]."""

    id: str
    output: str
    value: bool
    stamp: int
    state: SwitchState = SwitchState.PENDING
    reason: str = ""


class ToolSwitches:
    """The outputs of one tool."""

    def __init__(self, tool: GatewayTool, layout: Layout, cycle_ns: int, counters: Counter[str]):
        self.tool = tool
        self._names = tuple(output.name for output in tool.outputs)
        self._off = frozenset(output.name for output in tool.outputs if output.on_stop == "off")
        self._channels = layout.switched
        self._counters = counters
        self._longest_difference = round(LONGEST_DIFFERENCE * NANOSECONDS) // cycle_ns
        self._pause = -(-round(SHORTEST_PAUSE * NANOSECONDS) // cycle_ns)
        self._armed: list[ToolSwitch] = []
        self._reported: deque[ToolSwitch] = deque(maxlen=MOST_REPORTED)
        self._used: deque[str] = deque(maxlen=MEMORY)
        #: Changes since the last call of `pop_change`: one that is published at once, one that may wait for others.
        self._urgent, self._changed = True, False
        self._telegrams = self._reported_at = 0
        self._latest: ToolReading | None = None
        self._begin(Sentence("no telegram yet"))

    def _begin(self, why: str) -> None:
        self._reading: ToolReading | None = None
        self._commanded: tuple[bool, ...] = ()
        self._enabled = False
        self._differs = 0
        self._dropped = ""
        self._unknown = why

    # -- the controller's side

    @property
    def difference(self) -> str:
        """Outputs whose read-back has differed from the command for long, in one sentence; "" for none."""
        if self._differs <= self._longest_difference or self._reading is None:
            return ""
        pairs = zip(self._names, self._reading.outputs, self._commanded)
        differ = [
            Sentence("{name} reads back on, commanded off", name=name)
            if read
            else Sentence("{name} reads back off, commanded on", name=name)
            for name, read, commanded in pairs
            if read != commanded
        ]
        return Sentence(
            "{found}, for more than {seconds:g} s", found=join_sentences(*differ), seconds=LONGEST_DIFFERENCE
        )

    def on_reading(self, reading: ToolReading | None) -> None:
        """Store the newest telegram's reading; None: unreadable."""
        self._latest = reading

    def begin_controller_session(self) -> None:
        """Forget what was read back: another controller session has begun."""
        self.void(Sentence("another RSI session began"))
        self._begin(Sentence("nothing read back yet in this RSI session"))
        self._urgent = True

    def end_controller_session(self, why: str) -> None:
        """Forget what was read back: the controller session is over."""
        self.void(why)
        self._latest = None
        self._begin(why)
        self._urgent = True

    def on_telegram(self, obstacle: str = "", missed: bool = False) -> None:
        """Compare the stored reading; `obstacle`: why the session is not answered, `missed`: the controller missed a reply."""
        self._telegrams += 1
        reading = self._latest
        why = obstacle or ("" if reading is not None else _NOT_READABLE)
        if why != self._unknown:
            self._unknown, self._urgent = why, True
            if why:
                self._counters["tool_read_back_lost"] += 1
                self.void(Sentence("the outputs are not read back: {why}", why=why))
        if self._enabled and missed:
            self._drop()
        if reading is None:
            return
        if reading is not self._reading:
            self._record_changes(reading)
        if reading.outputs == self._commanded:
            self._urgent = self._urgent or self._differs > self._longest_difference
            self._differs = 0
        elif not self._enabled:
            # whoever else switches them, a person at the pendant or the KRL program, is right
            self._commanded = reading.outputs
        else:
            self._differs += 1
            if self._differs == self._longest_difference + 1:
                self._counters["tool_outputs_differ"] += 1
                self._urgent = True
                self.void(self.difference)

    def _drop(self) -> None:
        """Command off the outputs that the controller switched off at a missed reply, against a later edge."""
        pairs = zip(self._names, self._commanded)
        dropped = [name for name, value in pairs if value and name in self._off]
        if dropped:
            self._command(dict.fromkeys(dropped, False))
            self._dropped = Sentence(
                "{names} went off with a missed reply, and stays off until it is switched on anew",
                names=", ".join(dropped),
            )
            self._counters["tool_outputs_dropped"] += len(dropped)
            self.void(self._dropped)
            self._urgent = True

    def _record_changes(self, reading: ToolReading) -> None:
        before, self._reading = self._reading, reading
        if before is None or reading.outputs != before.outputs:
            self._urgent = True
        elif reading.inputs != before.inputs:
            self._counters["tool_input_changes"] += 1
            self._changed = True

    def fire_due(self, stamp: int) -> None:
        """Fire what is due: the playout plays the setpoint of `stamp` [ns] in this reply."""
        while self._armed and self._armed[0].stamp <= stamp:
            switch = self._armed.pop(0)
            self._enabled, self._dropped = True, ""
            self._command({switch.output: switch.value})
            self._counters["tool_switches_fired"] += 1
            self._urgent = True
            switch.state, switch.reason = SwitchState.FIRED, _FIRED

    def _command(self, values: dict[str, bool]) -> None:
        pairs = zip(self._names, self._commanded)
        self._commanded, self._differs = tuple([values.get(name, value) for name, value in pairs]), 0

    def channels(self, ending: bool = False) -> tuple[bool, ...]:
        """Return what a reply carries by `Layout.switched`; an `ending` one switches off what is off without RSI."""
        values = dict(zip(self._names, self._commanded))
        if ending and self._enabled:
            values |= dict.fromkeys(self._off, False)
        values[ENABLE] = self._enabled
        return tuple([values.get(name, False) for name in self._channels])

    # -- the command side

    def arm(self, value: object, lead: float | None, obstacle: str) -> str:
        """Arm the value of a `switch` whose stamp lies `lead` [s] ahead of the playout; return "", or why not."""
        switch = _switch_of(value)
        if switch is None:
            return (
                f"tool: a switch must have a new id (1 to {LONGEST_TEXT} printable characters), output, value (true or "
                "false) and stamp (whole number of ns), and nothing else"
            )
        if switch.id in self._used:
            return f"tool: switch {switch.id!r} was asked for before"
        self._used.append(switch.id)
        self._reported.append(switch)
        why = obstacle or self._refusal(switch, lead)
        self._urgent = True
        if why:
            switch.state, switch.reason = SwitchState.REFUSED, Sentence("tool: {why}", why=why)
            return switch.reason
        switch.state = SwitchState.ARMED
        switch.reason = Sentence("fires with the setpoint of {stamp}", stamp=switch.stamp)
        self._armed.append(switch)
        self._armed.sort(key=lambda waiting: waiting.stamp)
        return ""

    def _refusal(self, switch: ToolSwitch, lead: float | None) -> str:
        if self._unknown:
            return Sentence("the outputs are not known: {why}", why=self._unknown)
        if self.difference:
            return Sentence(
                "{difference}; switch it back where it was switched, or end the RSI program and start it anew: a new "
                "session takes the outputs as they read",
                difference=self.difference,
            )
        if switch.output not in self._names:
            return f"{self.tool.name} has no output {switch.output!r}; it has {', '.join(self._names)}"
        if lead is None or lead <= 0.0:
            return Sentence("the playout has passed the stamp {stamp} already", stamp=switch.stamp)
        if lead > MOST_AHEAD:
            return f"the stamp lies {lead:.3f} s ahead of the playout; at most {MOST_AHEAD:g} s"
        return ""

    def void(self, why: str) -> int:
        """Make every armed switch void; return how many there were."""
        count = len(self._armed)
        for switch in self._armed:
            switch.state, switch.reason = SwitchState.VOID, why
        self._armed.clear()
        if count:
            self._counters["tool_switches_void"] += count
            self._urgent = True
        return count

    # -- status

    def pop_change(self) -> bool:
        """Return whether the status is due; inputs that chatter wait `SHORTEST_PAUSE`."""
        if not self._urgent and not (self._changed and self._telegrams - self._reported_at >= self._pause):
            return False
        self._urgent = self._changed = False
        self._reported_at = self._telegrams
        return True

    def status_fields(self, failure: str = "") -> dict:
        """Return the fields of `status`; `failure`: why they hold no more."""
        reading = self._reading
        unknown = failure or self._unknown or self.difference
        return {
            "name": self.tool.name,
            "known": not unknown,
            "reason": unknown or self._dropped,
            "outputs": dict(zip(self._names, reading.outputs)) if reading else {},
            "commanded": dict(zip(self._names, self._commanded)),
            "enabled": self._enabled,
            "inputs": dict(zip(self.tool.inputs, reading.inputs)) if reading else {},
            "switches": [vars(switch) | {"state": switch.state.word} for switch in self._reported],
        }


def stamp_of(value: object) -> int | None:
    """Return the stamp of a switch that is asked for [ns]; None without one."""
    stamp = value.get("stamp") if isinstance(value, dict) else None
    return stamp if type(stamp) is int and 0 < stamp < 1 << 63 else None


def _switch_of(value: object) -> ToolSwitch | None:
    stamp = stamp_of(value)
    if not isinstance(value, dict) or set(value) != {"id", "output", "value", "stamp"} or stamp is None:
        return None
    texts = value["id"], value["output"]
    if not all(isinstance(text, str) and 0 < len(text) <= LONGEST_TEXT and text.isprintable() for text in texts):
        return None
    if not isinstance(value["value"], bool):
        return None
    return ToolSwitch(*texts, value["value"], stamp)
