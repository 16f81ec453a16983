"""A controller whose cycle is 12 ms: a stream of 250 Hz is played, limited, braked and timed in cycles of three commands each."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from gateway_cell import START, Cell, following, slow
from sentence_checks import expects

from construction_twin.controller.last_resort import LONGEST_GAP_MS
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.follower import Follower
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS, format_allowance
from construction_twin.gateway.config import parse_config
from construction_twin.gateway.playout import CALM, CATCH_UP, URGENT, Playout, PlayoutBounds, Slew
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


def test_a_motion_at_full_limits_is_followed():
    cell = Cell(cycle=12, decimals=6)
    cell.cycle(3)
    cell.arm()
    speed, acceleration, q, v, poses = 1.9, 2.3, START[0] - 0.5, 0.0, []
    cell = Cell(start=(-0.45, START[1]), cycle=12, decimals=6)
    cell.cycle(3)
    assert cell.arm()[0]
    q = cell.measured[0]
    poses = [q] * 20
    while q + v * CYCLE + v * v / (2 * acceleration) < 0.45:
        v = min(speed, v + acceleration * CYCLE)
        q += v * CYCLE
        poses.append(q)
    while v > 0.0:
        v = max(0.0, v - acceleration * CYCLE)
        q += v * CYCLE
        poses.append(q)
    poses += [q] * 40
    cell.stream(cell.codec.quantise((q, START[1])) for q in poses)
    assert (cell.state, cell.count("settling")) == (State.FOLLOWING, 0)
    assert cell.measured[0] == pytest.approx(poses[-1], abs=2e-8)
    assert_within_limits(cell)


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


def test_after_a_missed_telegram_the_motion_begins_from_rest():
    for missed in (1, 2):
        cell = following(360, **FINE)
        before = cell.measured
        speed = positions(cell)[-1][0] - positions(cell)[-2][0]
        cell.cycle(step_ms=12 * (1 + missed))
        step = cell.measured[0] - before[0]
        budget = (cell.config.acceleration[0] + format_allowance(6, cycle=PERIOD)) * PERIOD**2
        assert abs(step) <= budget + 1e-12 and abs(speed) > 2 * budget
        assert (cell.count("rsi_sessions"), cell.count("ipoc_steps_irregular")) == (1, 1)


@pytest.mark.parametrize("drift_ppm", [-300.0, 300.0])
def test_a_drifting_sender_with_jitter_is_followed_for_minutes(drift_ppm):
    cell = Cell(cycle=12, decimals=6)
    cell.cycle(3)
    assert cell.arm()[0]
    rng, start = random.Random(3), cell.now
    arrivals = sorted(
        (round(k * CYCLE_NS * (1 + drift_ppm * 1e-6)) + rng.randrange(6_000_000), k) for k in range(30_000)
    )
    for k in range(9_900):
        end = start + (k + 1) * 12_000_000
        while arrivals and start + arrivals[0][0] <= end:
            at, number = arrivals.pop(0)
            cell.now = start + at
            cell.send(slow(number, rate=0.5), seq=number + 1, stamp=10**18 + number * CYCLE_NS)
        cell.now = end - 12_000_000
        cell.cycle()
    assert cell.state is State.FOLLOWING, cell.gateway.reason
    assert (cell.count("stops_silence"), cell.count("stops_refused"), cell.count("cycles_without_command")) == (0, 0, 0)
    assert_within_limits(cell)
    playout = cell.gateway.status()["playout"]
    assert playout["drift_ppm"] == pytest.approx(-drift_ppm, abs=60.0)
    assert 12.0 <= playout["lead_ms"] + 16.0 <= 60.0


def test_a_sender_that_runs_ahead_of_time_is_refused_by_its_lead_as_at_4_ms():
    after = {}
    for cycle in (4, 12):
        cell = following(300, cycle=cycle)
        for k in range(300, 3000):
            cell.send(slow(k))
            # twice as fast as time
            if k % (2 * cycle // 4) == 0:
                cell.cycle()
            if cell.state is not State.FOLLOWING:
                break
        after[cycle] = cell.stamp
        assert cell.gateway.status()["last_refusal"].startswith("lead: ")
    assert abs(after[12] - after[4]) <= 24_000_000


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


def test_the_session_lasts_through_gaps_of_the_controllers_own_timeout():
    cell = following(300, cycle=12, timeout=1.2)
    cell.cycle(step_ms=12 * 99)
    assert cell.count("rsi_sessions") == 1
    cell.cycle(step_ms=12 * 101)
    assert cell.count("rsi_sessions") == 2


@pytest.mark.parametrize("cycle", [0, 8, 12.0, "12", True, None])
def test_only_the_cycles_of_rsi_are_taken(cycle):
    with pytest.raises(
        ConfigurationError,
        check=expects("expected.cycle_why", "cycle", cycles="4 or 12", why="RSI_ON with #IPO_FAST or #IPO"),
    ):
        Cell(cycle=cycle)


def test_the_cycle_is_in_the_file_and_in_the_hash():
    four, twelve = Cell().config, Cell(cycle=12).config
    assert four.hash != twelve.hash and parse_config(twelve.to_json(), "file") == twelve


# -- the parts ---------------------------------------------------------------------------------------------------------

LIMITS = MotionLimits(("a",), (-10.0,), (10.0,), (2.0,), (2.5,))


@pytest.mark.parametrize("decimals", [3, 6])
def test_rounding_to_the_wire_never_looks_like_an_acceleration_at_12_ms(decimals):
    """A motion at the limit, rounded: the follower meets it, and no more than rounding is allowed beside the limit."""
    unit = math.radians(10.0**-decimals)
    follower = Follower(LIMITS, decimals, (0.0,), PERIOD)
    for k in range(50):
        target = round(0.5 * 2.5 * (k * PERIOD) ** 2 / unit) * unit
        assert follower.follow((target,)) == (target,) and not follower.settling
    beyond = 2.5 + 1.2 * format_allowance(decimals, cycle=PERIOD)
    follower = Follower(LIMITS, decimals, (0.0,), PERIOD)
    assert follower.follow((beyond * PERIOD**2,)) != (beyond * PERIOD**2,)


def test_playout_time_is_moved_at_the_same_rates():
    for pace in (CALM, URGENT, CATCH_UP):
        long = pace.of_cycle(12_000_000)
        assert (long.back, long.ahead, long.change) == (3 * pace.back, 3 * pace.ahead, 9 * pace.change)
        assert pace.of_cycle(CYCLE_NS) == pace
    slew, shifts = Slew(12_000_000), [0]
    slew.remaining = 8_000_000
    while slew.moving:
        shifts.append(slew.step(CALM.of_cycle(12_000_000)))
        assert slew.rate == shifts[-1] / 12_000_000
    assert sum(shifts) == 8_000_000 and max(shifts) <= 0.005 * 12_000_000
    assert max(abs(b - a) for a, b in itertools.pairwise(shifts)) <= 0.005 * PERIOD * 12_000_000


def test_jitter_between_telegrams_makes_the_delay_no_longer_than_it_must_be():
    playout = Playout(PlayoutBounds(20_000_000, 20_000_000, 250_000_000), None, 12_000_000)
    for k in range(3000):
        playout.push(10**18 + k * CYCLE_NS, (k * 1e-4,), 0)
        if k % 3 == 2:
            playout.advance(12_000_000)
            assert playout.silence == 0
    assert playout.delay == 20_000_000
    assert playout.report()["lead_ms"] == pytest.approx(16.0, abs=4.0)


def test_the_last_resort_brakes_per_cycle_of_12_ms():
    config = Cell(cycle=12).config
    resort = config.make.last_resort(config)
    resort.sent(1012, "controller", (0.012, 0.0), (0.0, 0.0), 0)
    resort.take_over()
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


def test_durations_are_in_time_not_in_cycles():
    cell = following(300, **FINE)
    begin = cell.now
    while cell.state is State.FOLLOWING:
        cell.cycle()
    assert (cell.now - begin) / NANOSECONDS == pytest.approx(cell.config.silence + 0.02, abs=0.024)
