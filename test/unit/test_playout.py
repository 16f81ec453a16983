"""Playout of stamped commands on the controller's time."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.rsi.playout import REALIGN_WINDOW, Playout, interpolate
from construction_twin.units import CYCLE_NS

DELAY = 5 * CYCLE_NS
#: Any time on the sender's clock, here late in 2025.
T0 = 1_764_000_000_000_000_000


def pose(k):
    """A different pose for every k."""
    return (0.001 * k, -0.002 * k)


class Link:
    """A sender and a controller on simulated clocks."""

    def __init__(self, delay=DELAY):
        self.playout = Playout(delay)
        self.sent = 0

    def send(self, q=None):
        self.playout.push(T0 + self.sent * CYCLE_NS, pose(self.sent) if q is None else q)
        self.sent += 1

    def cycle(self, q=None):
        self.send(q)
        return self.playout.advance(CYCLE_NS)


@pytest.mark.parametrize("share, expected", [(0, (0.0, 1.0)), (1, (0.25, 0.5)), (2, (0.5, 0.0)), (4, (1.0, -1.0))])
def test_interpolation_is_linear_and_meets_both_ends(share, expected):
    assert interpolate(T0 + share * 1000, T0, (0.0, 1.0), T0 + 4000, (1.0, -1.0)) == expected


@given(st.integers(1, 10**9), st.floats(0, 1), st.floats(-7, 7), st.floats(-7, 7))
def test_interpolation_is_exact_to_the_last_digits_at_any_epoch(period, share, a, b):
    offset = int(share * period)
    exact = Fraction(a) + (Fraction(b) - Fraction(a)) * Fraction(offset, period)
    (value,) = interpolate(T0 + offset, T0, (a,), T0 + period, (b,))
    assert abs(value - exact) <= 4e-15


def test_playing_begins_the_delay_behind_the_newest_and_waits_at_the_first_command():
    link = Link()
    played = [link.cycle() for _ in range(12)]
    assert played[:5] == [(T0, pose(0))] * 5
    assert played[5:] == [(T0 + k * CYCLE_NS, pose(k)) for k in range(1, 8)]


def test_between_two_commands_the_target_is_interpolated_at_playout_time():
    link = Link(delay=DELAY + CYCLE_NS // 4)
    for _ in range(8):
        stamp, q = link.cycle()
    k = (stamp - T0) // CYCLE_NS
    assert (stamp - T0) % CYCLE_NS == 3 * CYCLE_NS // 4
    assert q == interpolate(stamp, T0 + k * CYCLE_NS, pose(k), T0 + (k + 1) * CYCLE_NS, pose(k + 1))


def test_a_lost_command_is_bridged_by_interpolation():
    link = Link()
    for k in range(12):
        if k == 6:
            link.sent += 1
        link.send()
    played = [link.playout.advance(CYCLE_NS) for _ in range(12)]
    stamp, q = next(entry for entry in played if entry[0] == T0 + 6 * CYCLE_NS)
    assert q == interpolate(stamp, T0 + 5 * CYCLE_NS, pose(5), T0 + 7 * CYCLE_NS, pose(7))


def test_a_controller_step_of_8_ms_moves_playout_time_8_ms():
    link = Link()
    for _ in range(8):
        before, _ = link.cycle()
    link.send()
    link.send()
    assert link.playout.advance(2 * CYCLE_NS)[0] == before + 2 * CYCLE_NS


def test_several_commands_at_once_play_at_the_controllers_pace():
    link = Link()
    for _ in range(10):
        before, _ = link.cycle()
    for _ in range(4):
        link.send()
    stamps = [link.playout.advance(CYCLE_NS)[0] for _ in range(4)]
    assert stamps == [before + k * CYCLE_NS for k in (1, 2, 3, 4)]


def test_when_commands_run_out_the_newest_is_held_and_silence_grows():
    link = Link()
    for _ in range(10):
        link.cycle()
    held = [link.playout.advance(CYCLE_NS) for _ in range(10)][4:]
    assert held == [(T0 + 9 * CYCLE_NS, pose(9))] * 6
    assert link.playout.silence == 6 * CYCLE_NS


def test_there_is_no_silence_while_commands_are_ahead():
    link = Link()
    for _ in range(10):
        link.cycle()
        assert link.playout.silence == 0
    assert link.playout.lead(link.playout.newest) == DELAY - CYCLE_NS


def test_after_an_underflow_playing_goes_on_where_time_is():
    link = Link()
    for _ in range(10):
        link.cycle()
    for _ in range(8):
        link.playout.advance(CYCLE_NS)
    for _ in range(8):
        link.send()
    # what was due during the underflow is not played late: time went on
    assert link.playout.advance(CYCLE_NS) == (T0 + 14 * CYCLE_NS, pose(14))


def test_clearing_starts_a_stream_of_its_own():
    link = Link()
    for _ in range(10):
        link.cycle()
    link.playout.clear()
    assert (link.playout.newest, link.playout.silence) == (0, 0)
    link.playout.push(7, pose(3))
    assert link.playout.advance(CYCLE_NS) == (7, pose(3))


def crowd(link, count, q=None):
    """Let the sender run ahead by `count` commands."""
    for _ in range(count):
        link.send(q)


def test_time_is_not_realigned_while_the_stream_moves():
    link = Link()
    for _ in range(10):
        before, _ = link.cycle()
    crowd(link, 4)
    for _ in range(3 * REALIGN_WINDOW):
        stamp, _ = link.cycle()
        assert stamp == before + CYCLE_NS
        before = stamp


@pytest.mark.parametrize("ahead", [4, -4])
def test_at_rest_time_is_realigned_to_the_delay(ahead):
    link = Link()
    rest = pose(1)
    for _ in range(10):
        link.cycle(rest)
    crowd(link, max(0, ahead), rest)
    for _ in range(max(0, -ahead)):
        link.playout.advance(CYCLE_NS)
    for _ in range(3 * REALIGN_WINDOW):
        _, q = link.cycle(rest)
        assert q == rest
    assert link.playout.lead(link.playout.newest) == DELAY


def test_realigning_never_skips_a_motion_that_is_still_to_be_played():
    link = Link()
    for _ in range(10):
        link.cycle()
    crowd(link, 3 * REALIGN_WINDOW)
    rest = pose(link.sent - 1)
    before = None
    for _ in range(5 * REALIGN_WINDOW):
        _, q = link.cycle(rest)
        assert before is None or abs(q[0] - before) <= 0.001 + 1e-12
        before = q[0]
    assert q == rest
    assert link.playout.lead(link.playout.newest) == DELAY


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(1, 3)), min_size=1, max_size=60))
def test_targets_stay_within_the_commands_and_never_run_backwards(rounds):
    link = Link()
    link.send()
    last = T0
    for sends, steps in rounds:
        crowd(link, sends)
        stamp, q = link.playout.advance(steps * CYCLE_NS)
        assert last <= stamp <= link.playout.newest
        assert q == pytest.approx(pose((stamp - T0) / CYCLE_NS), abs=1e-12)
        last = stamp
