"""A controller whose cycle is 12 ms: a stream of 250 Hz is played, limited, braked and timed in cycles of three commands each."""

from __future__ import annotations

import itertools
import math

import pytest
from gateway_cell import Cell, following, slow

from construction_twin.controller.last_resort import LONGEST_GAP_MS
from construction_twin.core.units import format_allowance
from construction_twin.gateway.states import State

PERIOD = 0.012
FINE = {"cycle": 12, "decimals": 6}


def positions(cell):
    return [tuple(start + value for start, value in zip(cell.setpoint, reply)) for reply in cell.replies]


def assert_within_limits(cell, begin=0):
    """Every reply, against the limits of one cycle of 12 ms."""
    config = cell.config
    allowance = format_allowance(config.decimals, cycle=PERIOD)
    moves = [[b - a for a, b in zip(*pair)] for pair in itertools.pairwise(positions(cell)[begin:])]
    for axis in range(2):
        digit = math.radians(10.0**-config.decimals)
        assert max(abs(move[axis]) for move in moves) <= config.velocity[axis] * PERIOD + digit + 1e-12
        bends = [abs(b[axis] - a[axis]) for a, b in itertools.pairwise(moves)]
        assert max(bends) <= (config.acceleration[axis] + allowance) * PERIOD**2 + 1e-12


@pytest.mark.parametrize("decimals", [2, 3, 6])
def test_every_third_command_is_played_exactly_and_nothing_needs_to_settle(decimals):
    cell = following(1500, cycle=12, decimals=decimals)
    sent = {cell.codec.quantise(slow(k)) for k in range(1500)}
    played = positions(cell)[60:]
    assert all(min(abs(q[0] - pose[0]) for pose in sent) < 1e-12 for q in played)
    assert len(set(played)) > 300
    assert (cell.count("settling"), cell.count("cycles_without_command"), cell.count("ipoc_steps_irregular")) == (
        0,
        0,
        0,
    )
    assert_within_limits(cell)
    delay = cell.gateway.status()["playout"]["delay_ms"]
    assert delay == pytest.approx(20.0)


def test_telegrams_that_come_every_4_ms_get_a_third_of_a_step_each():
    """Before the change of the cycle is noticed: a whole step in each of them would be three times the speed."""
    cell = following(360, **FINE)
    begin = len(cell.replies)
    for k in range(360, 369):
        cell.send(slow(k))
        cell.cycle(step_ms=4)
    assert cell.state is State.FOLLOWING, cell.gateway.reason
    played = [q[0] for q in positions(cell)[begin - 2 :]]
    step = played[1] - played[0]
    for part in zip(played[1::3], played[2::3], played[3::3], played[4::3]):
        step, before = part[-1] - part[0], step
        # the motion goes on as it was
        assert abs(step) > 1e-4 and abs(step - before) <= cell.config.acceleration[0] * PERIOD**2
        assert [b - a for a, b in itertools.pairwise(part)] == pytest.approx([step / 3] * 3, abs=4e-8)


def test_silence_brakes_within_the_limits_and_the_stated_time_is_that_of_cycles_of_12_ms():
    cell = following(300, **FINE)
    begin = len(cell.replies)
    cell.cycle(100)
    assert (cell.state, cell.count("stops_silence")) == (State.HOLDING, 1)
    assert_within_limits(cell)
    stop = cell.gateway.status()["stop"]
    assert stop["took_s"] == pytest.approx(stop["time_s"]) and stop["time_s"] / PERIOD == pytest.approx(
        round(stop["time_s"] / PERIOD)
    )
    # silence is counted in time, and it began with the first cycle without a command
    assert cell.count("cycles_without_command") <= math.ceil(cell.config.silence / PERIOD) + 1
    assert len(cell.replies) > begin


@pytest.mark.parametrize("fraction", [0.5, 0.1])
def test_a_speed_limit_is_kept_per_cycle_of_12_ms_and_on_the_path(fraction):
    cell = following(300, **FINE)
    for k in range(300, 900):
        if k % 25 == 0:
            assert cell.control("speed_limit", value=fraction)[0]
        cell.send(slow(k))
        cell.pass_command()
    begin = len(cell.replies) - 60
    assert cell.state is State.FOLLOWING, cell.gateway.reason
    assert_within_limits(cell)
    step = fraction * cell.config.velocity[0] * PERIOD
    moves = [abs(b[0] - a[0]) for a, b in itertools.pairwise(positions(cell)[begin:])]
    assert max(moves) <= step * 1.1 + 1e-12


# -- the parts ---------------------------------------------------------------------------------------------------------


def test_the_last_resort_brakes_per_cycle_of_12_ms():
    config = Cell(cycle=12).config
    resort = config.make.last_resort(config)
    resort.on_reply_sent(1012, "controller", (0.012, 0.0), (0.0, 0.0), 0)
    resort.begin()
    last, step = 0.012, 0.012
    for k in range(1, 40):
        assert resort.answer(1012 + 12 * k) is not None
        new = resort.target[0] - last
        assert new == pytest.approx(max(0.0, step - config.acceleration[0] * PERIOD**2), abs=1e-12)
        last, step = resort.target[0], new
    assert resort.at_rest
    # two missed telegrams are no new session, four are beyond what it can know
    assert resort.answer(resort.stamp + 36) is not None
    assert resort.answer(resort.stamp + 48) is None and LONGEST_GAP_MS < 48
