"""The bridge's side of the tool: commands become control messages, statuses and answers become the report on `tool`.

Pure. A switch is sent once: its stamp is the moment for which it was meant. Its state is the gateway's last word.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace

from construction_twin.core.reports import SwitchReport, SwitchState, ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.gateway.tool_switches import MOST_REPORTED
from construction_twin.link.gateway_status import GatewayAnswer, GatewayStatus, cut
from construction_twin.mqtt.messages import Control


class ToolLink:
    """The tool behind one gateway."""

    def __init__(self, new_id: Callable[[], str]):
        self._new_id = new_id
        self._switches: OrderedDict[str, SwitchReport] = OrderedDict()
        self._by_control: OrderedDict[str, str] = OrderedDict()
        self._run = self._session = ""
        self._status = ToolReport(reason=Sentence("no status of the gateway yet"))
        self._refused = ""
        #: Switches for which a gate that closed has sent `void`.
        self._voided: frozenset[str] = frozenset()

    # -- from the executor

    def switch(self, id: str, output: str, value: bool, stamp: int, session: str, obstacle: str) -> Control | None:
        """Return the message for a switch at a stamp [ns]; None: it is refused here, as for an `obstacle`."""
        if id in self._switches or id in self._by_control.values():
            self._refused = Sentence("tool: switch {id} was asked for before", id=repr(id))
            return None
        if obstacle:
            self._record_switch(id, SwitchState.REFUSED, Sentence("tool: {why}", why=obstacle))
            return None
        asked = {"id": id, "output": output, "value": value, "stamp": stamp}
        control = Control(self._new_id(), session, "switch", asked)
        self._by_control[control.id] = id
        while len(self._by_control) > MOST_REPORTED:
            self._by_control.popitem(last=False)
        return control

    def void(self, session: str) -> Control:
        """Return the message that makes every armed switch void, also without a session."""
        return Control(self._new_id(), session, "void")

    @property
    def waiting(self) -> frozenset[str]:
        """Ids of the switches that are armed, or were sent and not answered yet."""
        armed = [id for id, switch in self._switches.items() if switch.state is SwitchState.ARMED]
        return frozenset((*armed, *self._by_control.values()))

    def on_gate(self, is_open: bool, session: str) -> Control | None:
        """Return the message that voids the waiting switches of a closed gate, each once; None: nothing to void."""
        if is_open or self.waiting <= self._voided:
            return None
        self._voided = self.waiting
        return self.void(session)

    # -- from the gateway

    def on_answer(self, answer: GatewayAnswer) -> None:
        """Store the gateway's answer to a switch; others are ignored."""
        if answer.id not in self._by_control or answer.verb != "switch":
            return
        if answer.ok:
            self._refused = ""
        state = SwitchState.ARMED if answer.ok else SwitchState.REFUSED
        self._record_switch(self._by_control.pop(answer.id), state, cut(answer.reason))

    def on_status(self, status: GatewayStatus) -> None:
        """Store the gateway's status."""
        if status.run and status.run != self._run:
            if self._run:
                self._refuse_waiting(Sentence("the gateway was started again: whether it fired is not known"))
            self._run = status.run
        if status.session and status.session != self._session:
            self._session, self._refused = status.session, ""
        self._status = tool_report(status)
        for id, switch in self._status.switches.items():
            self._record_switch(id, switch.state, switch.reason)

    def _refuse_waiting(self, why: str) -> None:
        # not void: that would say that it has not fired, and may be asked for again
        for id in sorted(self.waiting):
            self._record_switch(id, SwitchState.REFUSED, why)
        self._by_control.clear()

    def _record_switch(self, id: str, state: SwitchState, reason: str) -> None:
        known = self._switches.get(id)
        if known is not None and known.state is not SwitchState.ARMED:
            # final: an older message cannot take it back
            return
        self._switches[id] = SwitchReport(state, reason)
        if state is SwitchState.REFUSED:
            self._refused = reason
        while len(self._switches) > MOST_REPORTED:
            self._switches.popitem(last=False)

    # -- to ROS

    def state_report(self, obstacle: str) -> ToolReport:
        """Return the report on `tool`; `obstacle`: why the gateway's status is not the present one."""
        status, reason = self._status, obstacle or self._status.reason or self._refused
        return replace(status, known=status.known and not obstacle, switches=dict(self._switches), reason=reason)


def tool_report(status: GatewayStatus) -> ToolReport:
    """Return the report of the tool in a status."""
    if status.tool is None:
        return ToolReport(reason=Sentence("the gateway's configuration has no tool: a robot without hands"))
    tool, states = status.tool, {state.word: state for state in SwitchState}
    switches = {cut(each.id): SwitchReport(states[each.state], cut(each.reason)) for each in tool.switches}
    return ToolReport(tool.known, cut(tool.name), tool.outputs, tool.inputs, switches, cut(tool.reason))
