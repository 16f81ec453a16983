"""Playout of stamped commands on the controller's time."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.playout import MARGIN, Playout, PlayoutBounds
from construction_twin.gateway.playout_rate import CALM, URGENT, PlayoutRate

DELAY = 5 * CYCLE_NS
LONGEST = 60 * CYCLE_NS
#: Any time on the sender's clock, here late in 2025.
T0 = 1_764_000_000_000_000_000


#: Change of a rate from one cycle to the next.
CALM_CHANGE, URGENT_CHANGE = CALM.change * 0.004, URGENT.change * 0.004


def playout(start=DELAY):
    """A playout of joints that may do anything."""
    anything = (1e9, 1e9)
    limits = MotionLimits(("A1", "A2"), (-1e9, -1e9), anything, anything, anything)
    return Playout(PlayoutBounds(start, DELAY, LONGEST), PlayoutRate(limits, 3))


def pose(k):
    """A different pose for every k."""
    return (0.001 * k, -0.002 * k)


def stamped(k, q=None):
    return T0 + k * CYCLE_NS, pose(k) if q is None else q


class Link:
    """A sender and a controller on simulated clocks."""

    def __init__(self, delay=DELAY):
        self.playout = playout(delay)
        self.sent = 0

    def send(self, q=None):
        self.playout.push(*stamped(self.sent, q))
        self.sent += 1

    def cycle(self, q=None):
        self.send(q)
        return self.playout.advance(CYCLE_NS)


def test_playing_begins_the_delay_behind_the_newest_and_waits_at_the_first_command():
    link = Link()
    played = [link.cycle() for _ in range(12)]
    assert played[:5] == [(T0, pose(0))] * 5
    assert played[5:] == [(T0 + k * CYCLE_NS, pose(k)) for k in range(1, 8)]


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
    assert stamps == pytest.approx([before + k * CYCLE_NS for k in (1, 2, 3, 4)], abs=10 * CALM_CHANGE * CYCLE_NS)


def crowd(link, count, q=None):
    """Let the sender run ahead by `count` commands."""
    for _ in range(count):
        link.send(q)


def test_moving_time_never_skips_a_motion_that_is_still_to_be_played():
    link = Link()
    for _ in range(10):
        link.cycle()
    crowd(link, 60)
    rest = pose(link.sent - 1)
    before = None
    for _ in range(25 * 250):
        _, q = link.cycle(rest)
        # 1 % by the rate, and what the cubic makes of an abrupt stop
        assert before is None or abs(q[0] - before) <= 0.001 * 1.02
        before = q[0]
    assert q == rest
    assert link.playout.lead_time(link.playout.newest) == DELAY - CYCLE_NS


class Network:
    """A sender on its own clock, a link of changing delay, and a controller; all times in ns on the controller's clock."""

    def __init__(self, travel, drift_ppm=0.0, phase=1_700_000, motion=lambda t: (t, -2.0 * t)):
        self.playout = playout()
        self.motion = motion
        self._travel, self._drift, self._phase = travel, drift_ppm * 1e-6, phase
        self._sent, self._arrived, self._arrival = 0, 0, 0
        self._queue = []
        self.now = 0
        self.dry = 0

    def cycle(self):
        """Let a cycle pass; return the target's stamp and value."""
        self.now += CYCLE_NS
        while True:
            sent = round(self._sent * CYCLE_NS * (1.0 - self._drift))
            if sent > self.now:
                break
            self._arrival = max(self._arrival, sent + self._travel(sent))
            self._queue.append((self._arrival, self._sent))
            self._sent += 1
        while self._arrived < len(self._queue) and self._queue[self._arrived][0] <= self.now + self._phase:
            at, k = self._queue[self._arrived]
            self._arrived += 1
            q = self.motion(k * 0.004)
            self.playout.push(T0 + k * CYCLE_NS, q, at - (self.now - CYCLE_NS + self._phase))
        if not self._arrived:
            return None
        played = self.playout.advance(CYCLE_NS)
        self.dry += self.playout.silence > 0
        return played

    def run(self, seconds):
        """Return what is played in that time."""
        return [played for played in (self.cycle() for _ in range(round(seconds / 0.004))) if played]


def rates(stamps):
    """Return playout time's rate from cycle to cycle, minus 1."""
    return [(later - earlier - CYCLE_NS) / CYCLE_NS for earlier, later in zip(stamps, stamps[1:])]


@pytest.mark.parametrize("ppm", [100.0, -100.0, 20.0])
def test_drifting_clocks_are_followed_without_a_step_and_without_running_dry(ppm):
    network = Network(lambda _: 300_000, ppm)
    network.run(5.0)
    stamps, leads = [], []
    for _ in range(250 * 295):
        stamps.append(network.cycle()[0])
        leads.append(network.playout.lead_time(network.playout.newest))
    assert network.dry == 0
    # the drift alone would have moved it by 30 ms, or by 6 ms
    assert MARGIN - 2 * CYCLE_NS <= min(leads) <= max(leads) <= DELAY + 2 * CYCLE_NS
    change = [abs(b - a) for a, b in zip(rates(stamps), rates(stamps)[1:])]
    assert max(map(abs, rates(stamps))) <= CALM.ahead and max(change) <= CALM_CHANGE + 1e-12
    # between two moves it is played on the stamps
    assert sum((stamp - T0) % CYCLE_NS == 0 for stamp in stamps) > 0.9 * len(stamps)


def test_jitter_is_absorbed_by_a_delay_that_is_shown_and_given_back_when_it_ends():
    chance = random.Random(2)
    network = Network(lambda sent: chance.randrange(10_000_000, 30_000_001) if sent < 30 * NANOSECONDS else 10_000_000)
    network.run(10.0)
    network.dry = 0
    network.run(20.0)
    report = network.playout.status_fields()
    assert network.dry == 0
    assert 20.0 <= report["jitter_ms"] <= 24.0 and report["delay_ms"] in (32.0, 36.0)
    network.run(30.0)
    assert network.playout.status_fields()["delay_ms"] == 20.0


def test_rising_jitter_slows_playout_at_once_and_speeds_it_up_late_and_gently():
    # stalls of 40 ms once a second, from second 5 to 15
    def travel(sent):
        into = sent % NANOSECONDS
        return 300_000 + (40_000_000 - into if 5 * NANOSECONDS < sent < 15 * NANOSECONDS and into < 40_000_000 else 0)

    network = Network(travel)
    playout, times = network.playout, []
    while network.now < 60 * NANOSECONDS:
        network.cycle()
        times.append(playout.newest - playout.lead_time(playout.newest))
        if network.now == 8 * NANOSECONDS:
            # two stalls have taught it, and before the third it has moved
            assert playout.status_fields()["delay_ms"] == 52.0
            network.dry = 0
    assert network.dry == 0 and playout.status_fields()["delay_ms"] <= 24.0
    stamps = times[10:]
    slowest, fastest = min(rates(stamps)), max(rates(stamps))
    assert -URGENT.back <= slowest < -CALM.back
    assert 0.0 < fastest <= CALM.ahead


@pytest.mark.parametrize("stall", [0.2, 3.0])
def test_the_delay_stays_within_its_bounds(stall):
    network = Network(lambda sent: 300_000 + max(0, round((stall - sent / 1e9 % 5.0) * 1e9)) * (sent > NANOSECONDS))
    network.run(4.9)
    for _ in range(5000):
        network.cycle()
        assert DELAY <= network.playout.delay <= LONGEST
    # as far as what was observed asks for, and no further
    assert network.playout.delay == (PlayoutBounds(DELAY, DELAY, LONGEST).delay(200_000_000) if stall < 1 else LONGEST)


def test_a_cut_longer_than_any_delay_teaches_nothing():
    link = Link()
    link.playout.learn(LONGEST + 1)
    assert link.playout.delay == DELAY
    link.playout.learn(30 * CYCLE_NS)
    assert link.playout.delay == 30 * CYCLE_NS + MARGIN


@given(st.integers(1, 250_000_000), st.integers(0, 50), st.integers(0, 100), st.integers(0, 300_000_000))
def test_delays_are_bounded_and_whole_cycles_from_the_start(start, below, above, jitter):
    bounds = PlayoutBounds(start, max(1, start - below * 1_000_000), start + above * 1_000_000)
    delay = bounds.delay(jitter)
    assert (delay - start) % CYCLE_NS == 0
    assert bounds.shortest <= delay <= bounds.longest
    assert delay >= jitter + MARGIN or delay + CYCLE_NS > bounds.longest
    assert delay == start or delay < jitter + MARGIN + CYCLE_NS or delay < bounds.shortest + CYCLE_NS


@pytest.mark.parametrize("phase", [0, 700_000, 2_000_000, 3_999_999])
def test_velocity_is_continuous_over_lost_commands(phase):
    played_out = playout(DELAY + phase)

    def q(stamp):
        return (math.sin((stamp - T0) * 2e-9),)

    played = []
    for k in range(500):
        if k % 7 not in (2, 3):
            played_out.push(T0 + k * CYCLE_NS, q(T0 + k * CYCLE_NS))
        played.append(played_out.advance(CYCLE_NS))
    worst = max(abs(value[0] - q(stamp)[0]) for stamp, value in played[20:])
    assert worst < 2e-7
    steps = [b[1][0] - a[1][0] for a, b in zip(played[20:], played[21:])]
    # 4 rad/s^2 at the most; linear interpolation over 12 ms would triple that
    assert max(abs(b - a) for a, b in zip(steps, steps[1:])) < 4.1 * 0.004**2


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


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(-60_000_000, 60_000_000), st.integers(0, 400)), min_size=1, max_size=6),
    st.booleans(),
)
def test_a_shift_of_playout_time_is_carried_out_whole_and_within_its_pace_also_when_it_is_changed_on_the_way(
    changes, urgent
):
    pace, rate, shifts = URGENT if urgent else CALM, playout().rate, [0]

    def step():
        shifts.append(rate.advance(CYCLE_NS, (), begun=True, rests=False, target=lambda _: (0.0, 0.0)) - CYCLE_NS)

    for wanted, cycles in changes:
        rate.move(wanted, urgent)
        for _ in range(cycles):
            step()
    while (rate.remaining or rate.shift) and len(shifts) < 40_000:
        step()
    assert sum(shifts) == sum(wanted for wanted, _ in changes)
    assert all(-pace.back <= shift / CYCLE_NS <= pace.ahead for shift in shifts)
    change = (URGENT_CHANGE if urgent else CALM_CHANGE) * CYCLE_NS
    assert all(abs(b - a) <= change + 1e-9 for a, b in zip(shifts, [*shifts[1:], 0]))
