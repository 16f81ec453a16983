"""Tool I/O: what fires when, what is void, and that nothing opens before the outputs are known."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mock_cell import HOME
from tool_cell import LAYOUT, TOOL, ToolCell, switched_off_on_stop

from construction_twin.controller.port import ToolReading
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.gateway import State
from construction_twin.gateway.tool_switches import (
    LONGEST_DIFFERENCE,
    MOST_AHEAD,
    ToolSwitches,
)

GRIPPED = {"vacuum_reached": True}


def gripped() -> ToolCell:
    """Return a cell that holds something, with the stream going on."""
    cell = ToolCell().follow()
    assert cell.ask(True)[0]
    cell.go_on(80)
    assert cell.out and cell.status()["inputs"] == GRIPPED
    return cell


def test_a_switch_fires_once_and_the_gripper_confirms_it():
    cell = ToolCell().follow()
    assert cell.status()["known"] is True and cell.status()["outputs"] == {"vacuum": False}
    assert cell.ask(True, id="grip") == (True, "armed")
    assert cell.switches() == {"grip": "armed"} and not cell.out
    cell.go_on(30)
    assert cell.switches() == {"grip": "fired"} and cell.out
    cell.go_on(60)
    assert cell.status()["inputs"] == GRIPPED
    assert cell.gateway.counters["tool_switches_fired"] == 1


@pytest.mark.parametrize("ahead", [5, 6, 17, 40])
def test_it_fires_in_the_cycle_in_which_the_playout_passes_its_stamp(ahead):
    cell = ToolCell().follow()
    played = []
    cell.gateway.trace = lambda ipoc, session, state, stamp, position, lost: played.append(stamp)
    assert cell.ask(True, ahead=ahead)[0]
    stamp = cell.status()["switches"][0]["stamp"]
    before = len(cell.sent)
    cell.go_on(ahead + 15)
    fired = [index for index, values in enumerate(cell.sent[before:]) if values["vacuum"]]
    passed = [index for index, at in enumerate(played) if at >= stamp]
    assert fired == passed and played[passed[0]] - stamp < CYCLE_NS


# -- refused


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"output": "clamp"}, "has no output 'clamp'; it has vacuum"),
        ({"stamp": 5}, "the playout has passed the stamp 5 already"),
        ({"ahead": round(MOST_AHEAD * 250) + 100}, "ahead of the playout; at most 2 s"),
        ({"session": "other"}, "session other does not command"),
    ],
)
def test_what_is_refused_says_why_and_does_nothing(changes, sentence):
    cell = ToolCell().follow()
    ok, reason = cell.switch(True, **{"session": cell.session} | changes)
    assert not ok and reason.startswith("tool: ") and sentence in reason
    cell.go_on(40)
    assert not cell.out and list(cell.switches().values()) == ["refused"]
    assert cell.gateway.counters["refused_switch"] == 1 and sentence in cell.gateway.status()["last_refusal"]


@pytest.mark.parametrize(
    "value",
    [None, 1, "x", [], {}, {"id": "a", "output": "vacuum", "value": True}]
    + [
        {"id": "a", "output": "vacuum", "value": True, "stamp": 1} | change
        for change in (
            {"id": ""}, {"id": 5}, {"id": "\n"}, {"output": 7}, {"value": 1}, {"value": None}, {"stamp": 1.5}, {"stamp": True},
            {"stamp": -1}, {"stamp": 1 << 70}, {"more": 1},
        )
    ],
)  # fmt: skip
def test_what_is_no_switch_is_refused(value):
    cell = ToolCell().follow()
    ok, reason = cell.control("switch", value, cell.session)
    assert not ok and reason.startswith("tool: a switch must have")
    assert cell.switches() == {}


def test_a_switch_is_used_once_and_a_copy_of_its_message_is_refused():
    cell = ToolCell().follow()
    assert cell.ask(True, id="one")[0]
    assert "was answered before" in cell.ask(True, id="one")[1]
    content = {"id": "one", "output": "vacuum", "value": False, "stamp": cell.stamp + 20 * CYCLE_NS}
    assert "asked for before" in cell.control("switch", content, cell.session)[1]
    cell.go_on(40)
    assert cell.out and cell.switches() == {"one": "fired"}


def test_without_a_stream_and_in_commissioning_mode_nothing_is_switched():
    cell = ToolCell()
    cell.cycle(5)
    ok, reason = cell.switch(True)
    assert not ok and "no stream is followed" in reason
    cell = ToolCell(commissioning=True).follow()
    ok, reason = cell.ask(True)
    assert not ok and "commissioning mode" in reason


# -- void


def stop(cell):
    assert cell.control("stop", None, "anybody")[0]


def end(cell):
    assert cell.control("end", None, "anybody")[0]


def silence(cell):
    cell.cycle(60)
    assert cell.state in (State.BRAKING, State.HOLDING)


def refused_command(cell):
    cell.send((1.0, *HOME[1:]), cell.session)
    assert cell.gateway.fault


def reset(cell):
    assert cell.control("reset", None, cell.session)[0]


def rsi_ends(cell):
    cell.now += NANOSECONDS
    cell.gateway.poll(cell.now)
    assert cell.state is State.NO_CONTROLLER


def rsi_restarts(cell):
    cell.restart()
    cell.cycle()


def speed_limit_0(cell):
    assert cell.control("speed_limit", 0.0, cell.session)[0]


def void(cell):
    assert cell.control("void", None, "anybody") == (True, "1 armed switch is void")


def read_back_lost(cell):
    cell.tool.hidden = True
    cell.send(session=cell.session)
    cell.cycle()
    cell.tool.hidden = False


CASES = [
    (stop, "asked for by anybody"),
    (end, "end asked for by anybody"),
    (silence, "no command for"),
    (refused_command, "A1"),
    (reset, "reset"),
    (rsi_ends, "no telegram for"),
    (rsi_restarts, "another RSI session began"),
    (speed_limit_0, "the speed limit is 0"),
    (void, "asked for by anybody"),
    (read_back_lost, "the outputs are not read back"),
]


@pytest.mark.parametrize("cause, sentence", CASES, ids=[cause.__name__ for cause, _ in CASES])
def test_an_armed_switch_is_void_for_good(cause, sentence):
    cell = ToolCell().follow()
    assert cell.ask(True, ahead=100, id="grip")[0]
    cause(cell)
    switch = cell.status()["switches"][0]
    assert (switch["id"], switch["state"]) == ("grip", "void") and sentence in switch["reason"]
    # and nothing fires on resume
    if cell.state is State.FOLLOWING:
        cell.control("speed_limit", 1.0, cell.session, id="1000")
        cell.go_on(150)
    else:
        cell.cycle(200)
        if not cell.controller.running:
            cell.restart()
        cell.follow(150)
    assert not cell.out and cell.switches() == {"grip": "void"}
    assert cell.gateway.counters["tool_switches_void"] == 1


def test_a_stream_that_runs_dry_for_some_cycles_fires_nothing_meanwhile_and_goes_on():
    cell = ToolCell().follow()
    assert cell.ask(True, ahead=6)[0]
    cell.go_on(4)
    cell.cycle(12)  # dry, not yet given up
    assert cell.state is State.FOLLOWING and not cell.out and list(cell.switches().values()) == ["armed"]
    cell.go_on(40)
    assert cell.out


def test_at_a_speed_limit_of_0_no_switch_is_armed():
    cell = ToolCell().follow()
    speed_limit_0(cell)
    assert "the speed limit is 0" in cell.ask(True)[1]


@settings(max_examples=60)
@given(
    st.lists(
        st.sampled_from(["go", "arm", "grip", "release", "stop", "reset", "void", "silent", "restart", "blind"]),
        max_size=25,
    )
)
def test_armed_switches_exist_only_while_a_stream_is_followed_and_final_states_stay(actions):
    cell = ToolCell().follow(10)
    final, count = {}, 0
    for action in actions:
        count += 1
        if action == "go" and cell.state is State.FOLLOWING:
            cell.go_on(7)
        elif action == "arm" and cell.state is State.HOLDING:
            cell.follow(10)
        elif action in ("grip", "release") and cell.gateway.command_session:
            cell.ask(action == "grip", ahead=12, id=f"s{count}")
        elif action in ("stop", "void"):
            cell.control(action, None, "anybody")
        elif action == "silent":
            cell.cycle(40)
        elif action == "restart":
            cell.restart()
            cell.follow(10)
        elif action == "blind":
            cell.tool.hidden = not cell.tool.hidden
        cell.cycle()
        told = cell.switches()
        assert "armed" not in told.values() or cell.state is State.FOLLOWING
        assert {id: told[id] for id in final if id in told} == {id: s for id, s in final.items() if id in told}
        final |= {id: state for id, state in told.items() if state != "armed"}


# -- nothing opens before the outputs are known


def test_until_the_read_back_comes_nothing_is_sent_and_switches_are_refused():
    cell = gripped()
    cell.restart()
    cell.tool.hidden = True
    cell.sent.clear()
    cell.follow()
    assert cell.status()["known"] is False
    ok, reason = cell.ask(False)
    assert not ok and reason.startswith("tool: the outputs are not known: telegrams do not tell")
    cell.go_on(60)
    assert cell.out and all(values == {"Enable": False, "vacuum": False} for values in cell.sent)
    cell.tool.hidden = False
    cell.go_on(5)
    assert cell.status()["known"] is True and cell.ask(False)[0]
    cell.go_on(30)
    assert not cell.out


def test_a_gateway_that_joins_a_running_session_refuses_switches():
    cell = ToolCell().follow()
    pose = tuple(q + 0.002 * k for k, q in zip((1, 0, 0, 0, 0, 0), HOME))
    for part in range(40):
        cell.send(tuple(a + (b - a) * part / 39 for a, b in zip(HOME, pose)), cell.session)
        cell.cycle()
    cell.cycle(5)
    cell.start_gateway(run="run2")
    cell.sent.clear()
    cell.cycle(5)
    assert cell.state is State.JOINED and cell.sent == []
    status = cell.status()
    assert status["known"] is False and "this session is not answered" in status["reason"]
    assert cell.status()["outputs"] == {"vacuum": False}
    assert not cell.switch(True)[0]


def test_what_a_person_switches_at_the_pendant_before_the_first_switch_is_right():
    cell = ToolCell()
    cell.cycle(5)
    cell.tool.outputs["vacuum"] = True
    cell.cycle(50)
    assert cell.out and cell.status()["commanded"] == {"vacuum": True} and cell.status()["reason"] == ""


def test_while_outputs_differ_nothing_is_switched_and_the_sentence_says_what_to_do():
    cell = gripped()
    assert cell.ask(True, ahead=60, id="waiting")[0]
    cell.tool.outputs["vacuum"] = False
    cell.go_on(round(LONGEST_DIFFERENCE * 250) + 2)
    assert cell.switches()["waiting"] == "void"
    ok, reason = cell.ask(True)
    assert not ok and "reads back off, commanded on" in reason and "end the RSI program and start it anew" in reason
    cell.restart()
    cell.follow()
    assert cell.status()["known"] is True and cell.status()["commanded"] == {"vacuum": False}
    assert cell.ask(True)[0]
    cell.go_on(20)
    assert cell.out


# -- missed replies, and the end


def drilling() -> ToolCell:
    """Return a cell whose output is off without RSI, and on."""
    cell = ToolCell(*switched_off_on_stop()).follow()
    assert cell.ask(True)[0]
    cell.go_on(60)
    assert cell.out
    return cell


@pytest.mark.parametrize("count", [1, 2, 5, 30])
@pytest.mark.parametrize("which", ["delivering", "answering"])
def test_what_a_missed_reply_switched_off_stays_off_until_it_is_switched_on_anew(count, which):
    """Delay tells it, or telegrams are missing."""
    cell = drilling()
    assert cell.ask(True, ahead=60, id="waiting")[0]
    setattr(cell, which, False)
    cell.go_on(count)
    setattr(cell, which, True)
    cell.sent.clear()
    seen = set()
    for _ in range(100):
        cell.go_on(1)
        seen.add(cell.out)
    assert seen == {False} and not any(values["vacuum"] for values in cell.sent)
    assert cell.switches()["waiting"] == "void" and cell.gateway.counters["tool_outputs_dropped"] == 1
    assert "stays off until it is switched on anew" in cell.status()["reason"] and cell.status()["known"] is True
    if cell.state is not State.FOLLOWING:
        cell.follow()
    assert cell.ask(True, id="again")[0]
    cell.go_on(30)
    assert cell.out and cell.status()["reason"] == ""


def test_at_the_end_of_rsi_outputs_are_kept_or_switched_off():
    for layout, tool, held in ((LAYOUT, TOOL, True), (*switched_off_on_stop(), False)):
        cell = ToolCell(layout, tool).follow()
        assert cell.ask(True)[0]
        cell.go_on(60)
        end(cell)
        cell.cycle(5)
        assert not cell.controller.running and cell.controller.reason.startswith("stop: requested")
        assert cell.out is held


# -- how often it is told


def test_inputs_that_chatter_are_told_at_most_20_times_a_second():
    tool, told = ToolSwitches(TOOL, LAYOUT, CYCLE_NS, Counter()), 0
    for cycle in range(1000):
        tool.on_reading(ToolReading((False,), (cycle % 2 == 0,)))
        tool.on_telegram()
        told += tool.pop_change()
    assert 60 <= told <= 82
