"""Replies that do not reach the controller while its telegrams go on: no step, on the planned path, still following.

The controller holds the last correction that arrived. Every one that arrives later is inside the limits against that one.
"""

from __future__ import annotations

import itertools
import math

import pytest
from gateway_cell import START, Cell
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.gateway.gateway import State
from construction_twin.gateway.trace import TraceEntry
from construction_twin.scenario.judge import trace_excesses


class LossyCell(Cell):
    """A `Cell` whose network loses what it is told to.

    Args:
        cumulative: Bool. `Delay` counts all missed cycles of the session; False: those in a row.

    Attributes:
        tells_delay: False: telegrams have no `Delay`.
        arrived: Every correction that arrived, as a position [rad], with the number of its cycle.
    """

    def __init__(self, cumulative=False, **changes):
        super().__init__(**changes)
        self.tells_delay = True
        self.arrived = []
        self.number = 0
        self._cumulative = cumulative
        self._losses = ""

    def lose(self, losses):
        """Lose something in the next cycles: ``r`` a reply, ``t`` a telegram, anything else nothing."""
        self._losses += losses

    def telegram(self, **changes):
        loss, self._losses = self._losses[:1], self._losses[1:]
        self.number += 1
        held = self.measured
        reply = None
        if loss != "t":
            reply = super().telegram(**({} if self.tells_delay else {"missed": None}) | changes)
        if reply is None or loss == "r":
            self.measured = held
            self.delay += 1
        else:
            self.arrived.append((self.number, self.measured))
            self.delay = self.delay if self._cumulative else 0
        return reply


def steps_of(arrived):
    """Return the step of each cycle in which something arrived, and that of the cycle before, 0 where HOLDON held the arm."""
    moves = []
    for (before, start), (number, end) in itertools.pairwise(arrived):
        step = tuple(b - a for a, b in zip(start, end))
        last = moves[-1][0] if moves and number == before + 1 else (0.0,) * len(step)
        moves.append((step, last))
    return moves


def assert_arrived_within_limits(cell):
    """Every correction that arrived is inside the limits against the one that arrived before it, from rest after a missed cycle."""
    config, period = cell.config, cell.config.period
    allowances = config.limits.allowances(config.decimals, period)
    lower, upper = config.limits.lower, config.limits.upper
    for number, (step, last) in enumerate(steps_of(cell.arrived), 1):
        for axis, allowance in enumerate(allowances):
            speed, change = abs(step[axis]) / period, abs(step[axis] - last[axis]) / period**2
            where = f"axis {axis} in cycle {cell.arrived[number][0]}"
            assert speed <= config.limits.velocity[axis] + allowance * period / 2 + 1e-9, (where, "velocity", speed)
            assert change <= config.limits.acceleration[axis] + allowance + 1e-6, (where, "acceleration", change)
            assert lower[axis] - 1e-9 <= cell.arrived[number][1][axis] <= upper[axis] + 1e-9, where


#: A motion of both axes along one curve: A1 and 3 times as much of A2.
RATIO = 3.0
CYCLES = (4, 12)


def curve(command, rate=2.5, size=0.19):
    """Where the motion is at a command of 4 ms, well inside the limits."""
    way = size * (1 - math.cos(rate * max(0, command) * CYCLE))
    return (START[0] + way, START[1] + RATIO * way)


def moving(commands=200, rate=2.5, **changes):
    """Return a cell in the middle of the motion, all of whose entries of a trace are in `entries`."""
    cell = LossyCell(**({"decimals": 6} | changes))
    cell.entries = []
    cell.gateway.trace = lambda ipoc, session, state, stamp, position, lost: cell.entries.append(
        TraceEntry(ipoc, stamp, state, session, position, lost)
    )
    cell.cycle(3)
    assert cell.arm()[0]
    cell.sent = 0
    go_on(cell, commands, rate)
    assert cell.state is State.FOLLOWING and cell.count("settling") == 0
    return cell


def go_on(cell, commands, rate=2.5):
    cell.stream(curve(cell.sent + k, rate) for k in range(commands))
    cell.sent += commands


def commands_of(cycles, cell):
    return cycles * cell.config.cycle // 4


def assert_on_path(cell, error=3e-8, arrived=None):
    for _, (a1, a2) in arrived or cell.arrived:
        assert abs((a2 - START[1]) - RATIO * (a1 - START[0])) < error


def assert_trace_agrees(cell):
    """The trace tells what arrived, and what is read from it finds nothing outside the limits."""
    period = cell.config.period
    assert trace_excesses(cell.entries, cell.config.limits, cell.config.decimals, period) == []


@pytest.mark.parametrize("cumulative", [False, True])
@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize("lost", [1, 2, 5, 10])
def test_after_lost_replies_the_next_one_that_arrives_is_a_step_from_rest(lost, cycle, cumulative):
    cell = moving(cycle=cycle, cumulative=cumulative)
    speed = steps_of(cell.arrived)[-1][0][0]
    before = len(cell.arrived)
    cell.lose("r" * lost)
    go_on(cell, commands_of(lost + 1, cell))
    assert len(cell.arrived) == before + 1, "one has arrived again"
    step = cell.arrived[-1][1][0] - cell.arrived[-2][1][0]
    budget = cell.config.acceleration[0] * cell.config.period**2
    assert 0.0 < step <= 1.01 * budget < abs(speed) / 2
    assert (cell.state, cell.gateway.fault) == (State.FOLLOWING, False)
    assert (cell.count("late_replies"), cell.count("standstills")) == (lost, lost)
    assert cell.count("delay_irregular") == 0
    go_on(cell, 600)
    assert_arrived_within_limits(cell)
    assert_on_path(cell)
    assert_trace_agrees(cell)
    assert (cell.state, cell.count("settling"), cell.count("rsi_sessions")) == (State.FOLLOWING, 0, 1)


@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize("lost", [1, 2, 10])
def test_lost_telegrams_are_the_same(lost, cycle):
    cell = moving(cycle=cycle)
    cell.lose("t" * lost)
    go_on(cell, commands_of(lost + 1, cell))
    step = cell.arrived[-1][1][0] - cell.arrived[-2][1][0]
    assert 0.0 < step <= 1.01 * cell.config.acceleration[0] * cell.config.period**2
    assert (cell.count("standstills"), cell.count("ipoc_steps_irregular"), cell.count("delay_irregular")) == (1, 1, 0)
    go_on(cell, 600)
    assert_arrived_within_limits(cell)
    assert_on_path(cell)
    assert_trace_agrees(cell)
    assert (cell.state, cell.count("settling")) == (State.FOLLOWING, 0)


def test_what_has_arrived_last_stays_while_replies_are_lost_for_whoever_goes_on_from_there():
    # the last resort, and a controller whose cycle is shorter than the expected one
    cell = moving()
    cell.lose("nrrrn")
    go_on(cell, 1)
    arrived = cell.measured
    for _ in range(3):
        go_on(cell, 1)
        replies = cell.gateway.controller.replies
        assert cell.measured == arrived and replies.sent != replies.last_acknowledged
    go_on(cell, 1)
    expected = tuple(now - origin for now, origin in zip(arrived, cell.gateway.controller.origin))
    assert replies.last_acknowledged == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("cumulative", [False, True])
def test_the_stamp_of_a_pose_is_that_of_the_target_that_arrived(cumulative):
    cell = moving(cumulative=cumulative)
    cell.lose("rnrrtnrtrnnttr")
    first = cell.stamp - (cell.sent - 1) * CYCLE_NS
    compared = 0
    for _ in range(100):
        held = cell.measured
        go_on(cell, 1)
        _, properties = cell.gateway.state_message(0)
        if cell.entries[-1].ipoc != cell.ipoc:
            continue
        # the twin's pose for the same command is where the arm was before this reply
        compared += 1
        assert curve((properties.command_stamp - first) / CYCLE_NS) == pytest.approx(held, abs=3e-7)
    assert compared > 90


@settings(max_examples=150, deadline=None)
@given(
    losses=st.lists(st.sampled_from(["n" * 40, "n" * 7, "n", "r", "rr", "rrrrr", "t", "tt", "rtr"]), max_size=25),
    cycle=st.sampled_from(CYCLES),
    decimals=st.sampled_from([3, 6]),
    rate=st.floats(0.05, 3.3),
    cumulative=st.booleans(),
    limit=st.sampled_from([None, 0.0, 0.1, 0.3]),
    tail=st.sampled_from(["stream", "silence", "stop"]),
)
def test_whatever_is_lost_every_correction_that_arrives_is_inside_the_limits(
    losses, cycle, decimals, rate, cumulative, limit, tail
):
    cell = moving(1, cycle=cycle, decimals=decimals, cumulative=cumulative, speed_limit_backlog=60.0)
    if limit is not None:
        assert cell.control("speed_limit", value=limit)[0]
    go_on(cell, 200, rate)
    pattern = "".join(losses)
    cell.lose(pattern)
    go_on(cell, commands_of(len(pattern), cell), rate)
    assert cell.state is State.FOLLOWING, cell.gateway.reason
    followed, settled = list(cell.arrived), cell.count("settling")
    cell.lose(pattern[::-1])
    if tail == "stream":
        go_on(cell, commands_of(len(pattern) + 50, cell), rate)
    elif tail == "stop":
        cell.control("stop")
    cell.cycle(len(pattern) + 300)
    assert cell.state is State.HOLDING
    assert_arrived_within_limits(cell)
    assert_trace_agrees(cell)
    if limit is None or not settled:
        assert settled == 0
        assert_on_path(cell, 1e-7 if decimals == 6 else 1e-4, followed)
    assert (cell.count("rsi_sessions"), cell.count("delay_irregular"), cell.count("stops_refused")) == (1, 0, 0)


def test_with_a_backlog_after_lost_replies_no_step_is_above_a_lowered_limit():
    cell = moving(speed_limit_backlog=60.0)
    cell.lose("nnr" * 40)
    go_on(cell, 120)
    for _ in range(20):
        assert cell.control("speed_limit", value=0.1)[0]
        go_on(cell, 25)
    assert cell.state is State.FOLLOWING and cell.gateway.status()["playout"]["put_off_ms"] > 500.0
    # grace, and time to slow down
    slowed = steps_of(cell.arrived[-300:])
    fastest = max(abs(v) / (most * CYCLE) for step, _ in slowed for v, most in zip(step, cell.config.velocity))
    assert 0.09 < fastest <= 0.1 + 1e-4
    assert_arrived_within_limits(cell)


@pytest.mark.parametrize("cycle", CYCLES)
def test_replies_lost_while_it_brakes_end_the_braking_where_the_arm_stands(cycle):
    cell = moving(cycle=cycle)
    cell.control("stop")
    cell.cycle(3)
    assert cell.state is State.BRAKING
    cell.lose("r")
    cell.cycle()
    held = cell.measured
    cell.cycle(20)
    assert cell.measured == held and cell.state is State.HOLDING
    assert_arrived_within_limits(cell)
    stop = cell.gateway.status()["stop"]
    assert stop["cause"] == "stop" and stop["took_s"] is not None
    assert max(moved - stated for moved, stated in zip(stop["moved_deg"], stop["distance_deg"])) <= 0.0


def test_replies_that_keep_being_lost_end_in_a_stop_that_says_so():
    cell = moving(rate=1.0)
    for _ in range(200):
        cell.lose("nnr")
        go_on(cell, 3, rate=1.0)
        if cell.state is not State.FOLLOWING:
            break
    else:
        for _ in range(300):
            cell.lose("nnr")
            go_on(cell, 3, rate=1.0)
    assert cell.gateway.fault and cell.count("stops_replies") == 1
    assert "did not arrive in time" in cell.gateway.reason and "allowed 2 s" in cell.gateway.reason
    assert_arrived_within_limits(cell)
    assert_on_path(cell)


@pytest.mark.parametrize("cycle", CYCLES)
def test_a_pose_is_of_the_present_once_no_reply_has_arrived_for_long(cycle):
    """An arm that takes no replies stands, while the twin goes on: the gate must see that, as of any arm that stands."""
    cell = moving(cycle=cycle)
    stamps = []
    cycles = round(0.2 / cell.config.period)
    cell.lose("r" * cycles)
    for _ in range(cycles + 3):
        go_on(cell, commands_of(1, cell))
        stamps.append(cell.gateway.state_message(0)[1].command_stamp)
    silent = [stamp == 0 for stamp in stamps]
    assert True in silent
    # one cycle until `Delay` tells of the first one
    patience = round(cell.config.silence / cell.config.period)
    assert silent.index(True) in (patience, patience + 1, patience + 2)
    assert all(silent[silent.index(True) : cycles])
    assert not any(silent[-2:]) and cell.state is State.FOLLOWING
    assert len(set(stamps[1 : silent.index(True)])) == 1, "until then it is of the target that arrived"


class TestADelayThatCannotBe:
    @pytest.mark.parametrize("jump", [2, 7, 90])
    def test_one_that_jumps_up_means_that_nothing_arrived(self, jump):
        """Too careful once: it goes back by the one step that had arrived, and no further."""
        cell = moving()
        cell.send(curve(cell.sent))
        before = cell.arrived[-2][1]
        cell.cycle(missed=jump)
        assert cell.count("delay_irregular") == 1
        budget = cell.config.acceleration[0] * CYCLE**2
        assert 0.0 <= cell.measured[0] - before[0] <= 1.01 * budget
        assert cell.state is State.FOLLOWING

    def test_telegrams_without_one_begin_no_session(self):
        cell = LossyCell()
        cell.tells_delay = False
        assert cell.cycle() is None
        assert cell.state is State.JOINED and "declare DEF_Delay" in cell.gateway.reason

    def test_telegrams_that_lose_it_later_are_counted(self):
        cell = moving()
        cell.tells_delay = False
        go_on(cell, 50)
        assert (cell.count("telegrams_without_delay"), cell.count("standstills")) == (50, 0)
        cell.tells_delay = True
        cell.lose("r")
        go_on(cell, 2)
        assert cell.count("standstills") == 1 and cell.state is State.FOLLOWING
