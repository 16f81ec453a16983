"""The bridge's side of the tool: what is sent, what is told, and that a final state is final."""

from __future__ import annotations

import itertools

import pytest
from tool_cell import ToolCell

from construction_twin.core.reports import SwitchReport, SwitchState, ToolReport
from construction_twin.link.gateway_status import NO_STATUS, GatewayAnswer, GatewayStatus, read
from construction_twin.link.tool_link import ToolLink, tool_report

_, ARMED, FIRED, VOID, REFUSED = SwitchState


def link():
    return ToolLink(map(str, itertools.count(1)).__next__)


def switch(tool, id="a", obstacle=""):
    return tool.switch(id, "vacuum", True, 5, "s1", obstacle)


def told(tool, obstacle=""):
    return {id: switch.state for id, switch in tool.state_report(obstacle).switches.items()}


def status(state="armed", run="r1", session="", **changes):
    switches = [{"id": "a", "output": "vacuum", "value": True, "stamp": 5, "state": state, "reason": "why"}]
    tool = {
        "name": "frame", "known": True, "reason": "", "outputs": {"vacuum": False}, "commanded": {"vacuum": False},
        "enabled": False, "inputs": {"reached": True}, "switches": switches,
    }  # fmt: skip
    return GatewayStatus.model_validate({"state": "following", "run": run, "session": session, "tool": tool | changes})


#: A status of another session.
NEXT = status(session="s2", switches=[])


def answer(control, ok=True, reason="armed", **other):
    return GatewayAnswer(**{"id": control.id, "verb": control.verb} | other, ok=ok, reason=reason)


def test_a_switch_becomes_a_message_of_the_session_and_its_answer_is_told():
    tool = link()
    control = switch(tool)
    assert (control.verb, control.session) == ("switch", "s1")
    assert control.value == {"id": "a", "output": "vacuum", "value": True, "stamp": 5}
    assert told(tool) == {}
    tool.on_answer(answer(control))
    assert told(tool) == {"a": ARMED}
    tool.on_status(status("fired"))
    assert told(tool) == {"a": FIRED}


def test_a_refusal_is_told_with_its_sentence():
    tool = link()
    tool.on_status(status(switches=[]))
    tool.on_answer(answer(switch(tool), False, "tool: the outputs are not known"))
    report = tool.state_report("")
    assert report.switches == {"a": SwitchReport(REFUSED, "tool: the outputs are not known")}
    assert report.reason == "tool: the outputs are not known" and report.known


def test_without_an_armed_link_nothing_is_sent():
    tool = link()
    assert switch(tool, obstacle="the link is RESYNC: why") is None
    assert tool.state_report("").switches == {
        "a": SwitchReport(
            REFUSED,
            "tool: the link is RESYNC: why",
        )
    }


def test_an_id_is_used_once():
    tool = link()
    tool.on_status(status(switches=[]))
    control = switch(tool)
    assert switch(tool) is None
    tool.on_answer(answer(control))
    assert switch(tool) is None and told(tool) == {"a": ARMED}
    assert "asked for before" in tool.state_report("").reason


@pytest.mark.parametrize("final", ["fired", "void", "refused"])
def test_what_is_final_stays_whatever_comes_later(final):
    tool = link()
    control = switch(tool)
    tool.on_status(status(final))
    before = told(tool)
    tool.on_answer(answer(control))
    for state in ("armed", "fired", "void"):
        tool.on_status(status(state))
    assert told(tool) == before


def test_a_gateway_that_was_started_again_has_no_armed_switches():
    tool = link()
    tool.on_status(status("armed"))
    tool.on_status(status(run="r2", switches=[]))
    why = "the gateway was started again: whether it fired is not known"
    assert tool.state_report("").switches == {"a": SwitchReport(REFUSED, why)}
    waiting = switch(tool, "b")
    tool.on_status(status(run="r3", switches=[]))
    tool.on_answer(answer(waiting))
    assert (
        tool.state_report("").switches == {"a": SwitchReport(REFUSED, why), "b": SwitchReport(REFUSED, why)}
        and not tool.waiting
    )


def test_the_last_refusal_is_told_until_a_switch_is_accepted_or_another_session_begins():
    tool = link()
    tool.on_status(status(session="s1", switches=[]))
    assert tool.state_report("").reason == ""
    for number, end in enumerate((lambda: tool.on_answer(answer(switch(tool, "ok"))), lambda: tool.on_status(NEXT))):
        tool.on_answer(answer(switch(tool, f"no{number}"), False, "tool: no"))
        tool.on_status(status(session="s1", switches=[]))
        assert tool.state_report("").reason == "tool: no"
        end()
        assert tool.state_report("").reason == ""


def test_a_gate_that_closes_voids_what_is_armed_or_not_answered_yet_and_nothing_else():
    tool = link()
    assert tool.on_gate(False, "s1") is None
    control = switch(tool)
    assert tool.on_gate(True, "s1") is None
    void = tool.on_gate(False, "s1")
    assert (void.verb, void.session) == ("void", "s1")
    tool.on_answer(answer(control))
    assert tool.on_gate(False, "s1") is None
    tool.on_status(status("void"))
    switch(tool, "b")
    assert tool.on_gate(False, "s1").verb == "void" and tool.on_gate(False, "s1") is None


def test_while_the_gateway_is_not_there_nothing_is_known_but_what_was_told():
    tool = link()
    assert tool.state_report("").reason == "no status of the gateway yet"
    tool.on_status(status("fired"))
    report = tool.state_report("the link is DISCONNECTED: why")
    assert (report.known, report.reason, report.tool) == (
        False,
        "the link is DISCONNECTED: why",
        "frame",
    )
    assert told(tool, "x") == {"a": FIRED}


def test_of_many_switches_the_last_16_are_told():
    tool = link()
    for number in range(40):
        tool.on_answer(answer(switch(tool, f"s{number}")))
    assert list(told(tool)) == [f"s{number}" for number in range(24, 40)]


def test_answers_to_others_and_to_other_verbs_are_not_its_own():
    tool = link()
    control = switch(tool)
    tool.on_answer(answer(control, id="other"))
    tool.on_answer(answer(control, verb="arm"))
    assert told(tool) == {}


def test_a_real_status_is_read_and_a_gateway_without_a_tool_has_no_hands():
    cell = ToolCell().follow()
    assert cell.ask(True, id="grip")[0]
    report = tool_report(read(GatewayStatus, cell.gateway.status()))
    assert report == ToolReport(True, "vacuum_frame", {"vacuum": False}, {"vacuum_reached": False}, report.switches, "")
    assert [(id, switch.state) for id, switch in report.switches.items()] == [("grip", ARMED)]
    assert tool_report(NO_STATUS).tool == "" and "without hands" in tool_report(NO_STATUS).reason
