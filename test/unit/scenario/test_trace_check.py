"""The check of a trace against the limits finds what is outside of them, and nothing else."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from gateway_cell import CONFIG, Cell, slow

from construction_twin.core.units import CYCLE, format_allowance
from construction_twin.gateway.states import State
from construction_twin.gateway.trace import TraceEntry
from construction_twin.scenario.judge import trace_excesses

LIMITS = CONFIG.limits
BUDGET = LIMITS.acceleration[0] * CYCLE**2
WIDE = BUDGET + format_allowance(3) * CYCLE**2


def trace(steps, ipoc_steps=None, session=None, start=0.0):
    """Entries of A1 that make these steps after the first one."""
    ipoc, position, entries = 1000, start, [TraceEntry(1000, 0, State.FOLLOWING, 1, (start, 0.0))]
    for number, step in enumerate(steps):
        ipoc += ipoc_steps[number] if ipoc_steps else 4
        position += step
        entries.append(
            TraceEntry(ipoc, 0, State.FOLLOWING, session[number] if session else 1, (position, 0.0)),
        )
    return entries


def kinds(entries, decimals=3):
    return [(found.index, found.axis, found.kind) for found in trace_excesses(entries, LIMITS, decimals)]


def test_what_a_gateway_sends_when_its_stream_ends_in_mid_motion_is_inside():
    cell, entries = Cell(), []
    cell.gateway.trace = lambda ipoc, session, state, stamp, position, lost: entries.append(
        TraceEntry(ipoc, stamp, state, session, position, lost)
    )
    cell.cycle(3)
    cell.arm()
    cell.stream(slow(k) for k in range(100))
    cell.cycle(200)
    assert cell.state is State.HOLDING
    assert len(entries) > 300 and entries[0].position != entries[-1].position
    assert kinds(entries) == []


def test_an_acceleration_up_to_limit_and_allowance_is_inside_and_a_little_more_is_not():
    assert kinds(trace([WIDE, 2 * WIDE, WIDE, 0.0])) == []
    assert kinds(trace([WIDE, 2.01 * WIDE, 2.01 * WIDE])) == [(2, "A1", "acceleration")]
    # the allowance is the format's
    assert kinds(trace([WIDE, WIDE]), decimals=6) == [(1, "A1", "acceleration")]


def test_a_session_that_begins_in_motion_is_a_step_from_rest():
    assert kinds(trace([0.0, 5 * WIDE], session=[1, 2])) == []
    assert kinds(trace([0.0, 0.0, 5 * WIDE], session=[1, 2, 2])) == [(3, "A1", "acceleration")]


@pytest.mark.parametrize("gap", [8, 12])
def test_after_a_missed_telegram_the_arm_stands(gap):
    ramp = [n * BUDGET for n in range(1, 11)]
    assert kinds(trace([*ramp, 10 * BUDGET], [4] * 11)) == []
    assert kinds(trace([*ramp, 10 * BUDGET], [4] * 10 + [gap])) == [(11, "A1", "acceleration")]
    assert kinds(trace([*ramp, BUDGET], [4] * 10 + [gap])) == []


def test_a_reply_that_did_not_arrive_is_left_out_and_the_next_one_is_a_step_from_rest():
    ramp = [n * BUDGET for n in range(1, 11)]
    *before, last = trace([*ramp, 11 * BUDGET, 0.0, 0.0])
    assert [kind for *_, kind in kinds([*before, last])] == ["acceleration"]
    # the last one but two was lost: from where the arm was before it
    stood = before[-3].position[0]
    goes_on = [
        replace(before[-1], lost=True, position=(stood + BUDGET, 0.0)),
        replace(last, position=(stood + 3 * BUDGET, 0.0)),
    ]
    assert kinds([*before[:-1], *goes_on]) == []
    as_if_nothing = replace(before[-1], lost=True)
    assert kinds([*before[:-1], as_if_nothing]) == [(len(before) - 1, "A1", "acceleration")]


def test_velocity_and_range_are_checked():
    fast = LIMITS.velocity[0] * CYCLE
    ramp = [min(n * BUDGET, fast) for n in range(1, math.ceil(fast / BUDGET) + 1)]
    room = trace(ramp + [fast], start=LIMITS.lower[0])
    assert all(kind == "range" for _, _, kind in kinds(room)), "a full run-up leaves this axis' range"
    assert (len(ramp) + 1, "A1", "velocity") in kinds(trace([*ramp, fast + 0.5 * BUDGET], start=-0.5), decimals=6)
    assert kinds(trace([0.0], start=LIMITS.upper[0] + 1e-6)) == [(0, "A1", "range"), (1, "A1", "range")]


@pytest.mark.parametrize("state", [State.READY, State.ARMED])
def test_where_the_pose_follows_the_controller_only_its_range_is_judged(state):
    """And the first cycle of a stream is judged as one from rest."""
    led = [replace(entry, state=state) for entry in trace([10 * WIDE, 0.0, 10 * WIDE])]
    assert kinds(led) == []
    assert kinds([*led, replace(led[-1], ipoc=led[-1].ipoc + 4, state=State.FOLLOWING)]) == []
    begun = replace(
        led[-1], ipoc=led[-1].ipoc + 4, state=State.FOLLOWING, position=(led[-1].position[0] + 2 * WIDE, 0.0)
    )
    assert kinds([*led, begun]) == [(4, "A1", "acceleration")]
    outside = replace(led[-1], position=(LIMITS.upper[0] + 0.1, 0.0))
    assert kinds([*led[:-1], outside]) == [(3, "A1", "range")]
