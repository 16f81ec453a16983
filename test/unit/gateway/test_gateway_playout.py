"""The gateway as a pure object: stalls, holes, learned delays."""

from __future__ import annotations

import math

import pytest
from gateway_cell import DELAY_CYCLES, START, Cell, following, slow
from hypothesis import example, given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.gateway.gateway import State


def stall(cell, cycles, poses):
    """Let the controller go on while commands queue up, then deliver them all."""
    for _ in range(cycles):
        cell.cycle()
    for q in poses:
        cell.send(q)


def test_a_stall_within_the_delay_is_not_felt():
    cell = following(playout_delay=0.1)
    stall(cell, 20, [slow(100 + k) for k in range(20)])
    for k in range(120, 200):
        cell.send(slow(k))
        cell.cycle()
    assert cell.count("cycles_without_command") == cell.count("settling") == cell.count("commands_late") == 0
    assert cell.measured[0] == pytest.approx(slow(200 - 25)[0], abs=math.radians(0.0006))


def test_a_stall_beyond_the_delay_brakes_goes_on_and_is_absorbed_the_next_time():
    cell = following(cycles=200)
    stall(cell, 12, [slow(200 + k) for k in range(12)])
    assert cell.state is State.FOLLOWING
    assert cell.count("cycles_without_command") == 12 - (DELAY_CYCLES - 1)
    assert cell.count("commands_late") == 12 - (DELAY_CYCLES - 1)
    for k in range(212, 700):
        cell.send(slow(k))
        cell.cycle()
    playout = cell.gateway.status()["playout"]
    assert (playout["jitter_ms"], playout["delay_ms"]) == (48.0, 60.0)
    dry = cell.count("cycles_without_command")
    stall(cell, 12, [slow(700 + k) for k in range(12)])
    cell.cycle(4)
    assert cell.count("cycles_without_command") == dry
    assert cell.state is State.FOLLOWING


def hole(cell, missing, begin=300):
    """Lose `missing` commands in mid-motion; the next one comes in time."""
    cell.seq += missing
    cell.stamp += missing * CYCLE_NS
    cell.cycle(missing)
    cell.send(slow(begin + missing))


#: Commands that can be missing within the silence of 0.1 s: the next one is a cycle further on.
BRIDGED = 24


@settings(max_examples=60, deadline=None)
@given(delay=st.integers(5, 62), missing=st.integers(1, 70))
@example(delay=35, missing=BRIDGED)
@example(delay=35, missing=BRIDGED + 1)
@example(delay=35, missing=34)
@example(delay=35, missing=35)
@example(delay=35, missing=58)
@example(delay=5, missing=BRIDGED)
@example(delay=5, missing=BRIDGED + 1)
def test_a_hole_longer_than_the_silence_brakes_with_every_delay_and_a_shorter_one_never(delay, missing):
    cell = following(cycles=300, playout_delay=delay * CYCLE)
    hole(cell, missing)
    if missing <= BRIDGED:
        assert (cell.state, cell.count("commands_lost"), cell.count("stops_silence")) == (State.FOLLOWING, missing, 0)
        cell.stream(slow(300 + k) for k in range(missing + 1, missing + 300))
        assert cell.state is State.FOLLOWING
        # a hole as long as the delay makes it longer, never shorter
        assert cell.measured[0] == pytest.approx(slow(600 + missing - delay)[0], abs=0.02)
        return
    assert cell.state in (State.BRAKING, State.HOLDING)
    assert (cell.count("stops_silence"), cell.gateway.command_session) == (1, "")
    assert cell.gateway.reason.startswith("silence: ") and not cell.gateway.status()["fault"]
    before = cell.measured[0]
    for _ in range(200):
        cell.cycle()
        assert cell.measured[0] >= before
        before = cell.measured[0]
    assert cell.state is State.HOLDING
    # docs/architecture.md, law 5: another session from where the arm stands
    resume(cell)


@pytest.mark.parametrize("delay", [0.02, 0.14])
def test_a_hole_that_is_too_long_is_told_as_silence_and_teaches_nothing_about_the_link(delay):
    cell = following(cycles=300, playout_delay=delay)
    hole(cell, BRIDGED + 1)
    assert cell.gateway.reason == "silence: 0.104 s of the stream are missing"
    resume(cell)
    assert cell.gateway.status()["playout"]["delay_ms"] == 1000 * delay


def test_a_bridged_hole_is_hardly_felt():
    cell = following(cycles=300, playout_delay=0.2, decimals=6)
    for k in range(300, 500):
        if 320 <= k < 340:
            cell.seq += 1
            cell.stamp += CYCLE_NS
        else:
            cell.send(slow(k))
        cell.cycle()
        if k > 360:
            assert cell.measured[0] == pytest.approx(slow(k + 1 - 50)[0], abs=1e-4)
    assert (cell.count("commands_lost"), cell.count("settling")) == (20, 0)


def resume(cell, session="s2", cycles=60):
    cell.cycle(200)
    assert cell.control("reset", session)[0] and cell.arm(session)[0]
    held = cell.held()
    cell.stream([held] * cycles, session)
    assert cell.state is State.FOLLOWING


@pytest.mark.parametrize("properties", [True, False])
def test_a_stall_that_ended_a_stream_makes_the_next_ones_delay_longer(properties):
    cell = Cell(properties=properties)
    cell.cycle(3)
    cell.arm()
    cell.stream([START] * 100)
    stall(cell, 40, [START] * 40)
    assert (cell.count("stops_silence"), cell.count("refused_not_armed")) == (1, 40)
    resume(cell)
    assert cell.gateway.status()["playout"]["delay_ms"] >= 4 * 40 + 12
    stopped = cell.count("stops_silence")
    stall_session = "s2"
    for _ in range(40):
        cell.cycle()
    for _ in range(40):
        cell.send(cell.measured, stall_session)
    cell.cycle()
    assert (cell.state, cell.count("stops_silence")) == (State.FOLLOWING, stopped)
