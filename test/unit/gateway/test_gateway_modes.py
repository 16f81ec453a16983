"""Modes of the gateway as a pure object: commissioning, read-only, ending RSI_MOVECORR; linear axes; why a session began."""

from __future__ import annotations

import dataclasses

import pytest
from gateway_cell import RUN, START, Cell, following, gap, slow

from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.rsi.layout import RsiLayout

PLAIN = RsiLayout.plain(("A1", "A2"))
WITH_STOP = dataclasses.replace(PLAIN, receive=("Stop", *PLAIN.receive), holdon=(False, *PLAIN.holdon))
READ_ONLY = dataclasses.replace(PLAIN, onlysend=True, receive=(), holdon=())


# -- commissioning -----------------------------------------------------------------------------------------------------


def commissioning() -> Cell:
    cell = Cell()
    cell.gateway = Gateway(cell.config, RUN, commissioning=True)
    cell.cycle(3)
    return cell


def test_commissioning_takes_the_stream_computes_and_sends_zeros():
    cell, normal = commissioning(), Cell()
    normal.cycle(3)
    for each in (cell, normal):
        ok, said = each.arm()
        assert ok
        each.stream(slow(k) for k in range(200))
    assert said == "armed"
    assert set(cell.replies) == {(0.0, 0.0)} and cell.measured == START
    assert cell.state is State.FOLLOWING and cell.count("commands_received") == 200
    # what it would have sent is what it sends without the mode
    assert (
        cell.gateway.controller.replies.correction
        == normal.gateway.controller.replies.correction
        == normal.replies[-1]
        != (0.0, 0.0)
    )
    assert cell.gateway.status()["correction"] == list(normal.replies[-1])


def test_commissioning_is_said_wherever_somebody_looks():
    cell = commissioning()
    assert cell.gateway.status()["mode"] == "commissioning"
    assert "commissioning" in cell.gateway.reason
    assert "every correction is sent as zero" in cell.arm()[1]
    assert Cell().gateway.status()["mode"] == "normal"


def test_missing_telegrams_are_no_restart_where_only_the_computed_correction_is_not_zero():
    cell = commissioning()
    cell.arm()
    cell.stream(slow(k) for k in range(200))
    cell.control("stop")
    cell.cycle(300)
    assert any(cell.gateway.controller.replies.correction)
    cell.cycle(step_ms=3 * cell.config.cycle)
    assert (cell.state, cell.count("rsi_sessions"), cell.count("ipoc_steps_irregular")) == (State.HOLDING, 1, 1)


def test_after_a_stop_in_commissioning_the_next_stream_begins_where_the_arm_stands():
    cell = commissioning()
    cell.arm()
    cell.stream(slow(k) for k in range(200))
    cell.control("stop")
    cell.cycle(300)
    assert cell.state is State.HOLDING and cell.gateway.controller.replies.correction[0] != 0.0
    assert cell.control("reset")[0]
    assert cell.arm("s2")[0]
    cell.stamp += 10 * NANOSECONDS
    cell.send(START, session="s2")
    cell.cycle()
    assert cell.state is State.FOLLOWING and cell.count("refused_start") == 0
    assert cell.gateway.controller.replies.correction == pytest.approx((0.0, 0.0), abs=1e-12)


# -- read-only ---------------------------------------------------------------------------------------------------------


def test_read_only_answers_nothing_publishes_states_and_refuses_motion_with_the_reason():
    cell = Cell(layout=READ_ONLY)
    cell.cycle(50)
    assert set(cell.replies) == {None}
    assert (cell.state, cell.count("telegrams_unanswered")) == (State.READ_ONLY, 50)
    payload, _ = cell.gateway.state_message(cell.now)
    assert cell.codec.decode(payload) == pytest.approx(START)
    for verb in ("arm", "reset", "end"):
        ok, said = cell.control(verb, "s1", cell.arming)
        assert not ok
    assert "ONLYSEND TRUE" in cell.arm()[1]
    cell.send(START)
    assert cell.count("refused_not_armed") == 1
    assert cell.gateway.status()["mode"] == "read_only"


def test_onlysend_wins_over_commissioning():
    assert Gateway(Cell(layout=READ_ONLY).config, RUN, commissioning=True).status()["mode"] == "read_only"


# -- the end of RSI_MOVECORR -------------------------------------------------------------------------------------------


def test_end_brakes_first_and_asks_for_the_stop_only_at_rest():
    cell = following(layout=WITH_STOP)
    assert not cell.gateway.ends_program
    ok, said = cell.control("end")
    assert ok and "at rest" in said
    asked = []
    for _ in range(300):
        cell.cycle()
        asked.append((cell.gateway.ends_program, cell.state))
    assert asked[0] == (False, State.BRAKING)
    assert asked[-1] == (True, State.HOLDING)
    assert all(state is State.HOLDING for ends, state in asked if ends)
    assert cell.gateway.fault


def test_after_the_end_a_new_session_carries_no_stop_and_needs_a_reset():
    cell = Cell(layout=WITH_STOP)
    cell.cycle(3)
    cell.control("end")
    cell.cycle(3)
    assert cell.gateway.ends_program
    gap(cell)
    cell.cycle(3)
    assert cell.state is State.READY and not cell.gateway.ends_program
    assert not cell.arm()[0]
    assert cell.control("reset")[0] and cell.arm()[0]


def test_without_a_stop_channel_the_end_is_refused_and_nothing_is_stopped():
    cell = following()
    ok, said = cell.control("end")
    assert not ok and "no Stop element" in said
    # nor has it a tool
    assert not cell.control("switch", value={})[0] and "tool" not in cell.gateway.status()
    assert cell.state is State.FOLLOWING


# -- a linear axis through codec, session and mock ----------------------------------------------------------------------


# -- why a session began -----------------------------------------------------------------------------------------------
