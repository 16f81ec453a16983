"""Moving playout time under a plan at the limits: what is played stays inside them, and the follower has nothing to settle."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_cell import ROBOT

from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE, CYCLE_NS, format_allowance
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.player import Player
from construction_twin.gateway.playout_rate import CALM, CATCH_UP, URGENT, PlayoutRate
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.planning.timing import time_path

LIMITS = MotionLimits.of(ROBOT)
#: Commands that are there before playing begins: what is moved meanwhile never runs dry.
AHEAD = 150
#: At rest before and after the motion [cycles].
REST = 60
T0 = 1_764_000_000_000_000_000
PACES = (CALM, URGENT, CATCH_UP)

places = st.lists(st.floats(0.05, 0.95), min_size=6, max_size=6)
#: When playout time is to be moved [cycles], by how much [ns], and at which pace.
moves = st.lists(
    st.tuples(st.integers(0, 250), st.integers(-60_000_000, 60_000_000), st.sampled_from(PACES)), max_size=8
)
#: When which fraction of the speed is allowed [cycles].
fractions = st.lists(st.tuples(st.integers(0, 250), st.sampled_from((0.1, 0.3, 0.6, 0.9, 1.0))), max_size=3)


def commands(points, decimals: int) -> list[tuple[float, ...]]:
    lower, upper = np.array(ROBOT.lower), np.array(ROBOT.upper)
    motion = time_path(lower + np.array(points) * (upper - lower), ROBOT, corner_fraction=1.0)
    times = np.arange(-REST * CYCLE, motion.duration + REST * CYCLE, CYCLE)
    codec = JointStringCodec(6, decimals)
    rows = motion.sample_many(np.clip(times, 0.0, motion.duration))[0].tolist()
    return [codec.quantise(tuple(row)) for row in rows]


def at_cycles(changes) -> dict[int, list[tuple]]:
    """Return what is to happen in which cycle of the motion."""
    due, begin = {}, 0
    for wait, *what in changes:
        begin += wait
        due.setdefault(begin, []).append(tuple(what))
    return due


def play(rows, decimals: int, changes=(), limits=()) -> tuple[np.ndarray, Counter]:
    """Play rows of which `AHEAD` are always there, with changes of time and speed limits; return what was sent, and counted."""
    counted = Counter()
    config = GatewayConfig(
        "arm", tuple(axis.name for axis in ROBOT.axes), LIMITS.lower, LIMITS.upper, LIMITS.velocity, LIMITS.acceleration,
        decimals=decimals, playout_delay=AHEAD * CYCLE, playout_delay_max=2 * AHEAD * CYCLE, max_age=10.0,
    )  # fmt: skip
    player = Player(config, counted)
    follower = player.place(rows[0])
    ahead = iter(enumerate([rows[0]] * AHEAD + rows + [rows[-1]] * 3 * AHEAD))
    due, limited, sent = at_cycles(changes), at_cycles(limits), []
    for cycle, (number, row) in enumerate(ahead):
        player.push(T0 + number * CYCLE_NS, row, 0)
        playout = player.playout
        # the delay is the test's to move
        playout._choose_delay = lambda now: None
        for shift, pace in due.get(cycle - 2 * AHEAD - REST, ()):
            playout.rate.remaining += shift
            playout.rate._pace = playout.rate._paces[pace]
        for (fraction,) in limited.get(cycle - 2 * AHEAD - REST, ()):
            player.limit(fraction)
        sent.append(player.play(follower, CYCLE_NS, ()))
    return np.array(sent), counted


@pytest.mark.parametrize("decimals", [3, 6])
@settings(max_examples=40, deadline=None)
@given(points=st.lists(places, min_size=2, max_size=4), changes=moves, limits=fractions)
def test_whatever_moves_playout_time_the_limits_hold_in_every_cycle(decimals, points, changes, limits):
    if np.max(np.abs(np.diff(points, axis=0))) <= 1e-3:
        return
    sent, counted = play(commands(points, decimals), decimals, changes, limits)
    assert counted["settling"] == counted["cycles_without_command"] == 0
    velocity = np.array(LIMITS.velocity) + np.radians(10.0**-decimals) / CYCLE
    acceleration = np.array(LIMITS.acceleration) + format_allowance(decimals)
    assert np.all(np.abs(np.diff(sent, axis=0)) / CYCLE <= velocity + 1e-9)
    assert np.all(np.abs(np.diff(sent, 2, axis=0)) / CYCLE**2 <= acceleration + 1e-6)


def test_without_the_room_that_is_left_the_pace_would_be_too_much(monkeypatch):
    points = [[0.1, 0.1, 0.1, 0.5, 0.5, 0.5], [0.9, 0.9, 0.9, 0.5, 0.5, 0.5]]
    rows = commands(points, 6)
    changes = [(20 * k, -3_000_000 * (-1) ** k, URGENT) for k in range(30)]
    assert play(rows, 6, changes)[1]["settling"] == 0
    monkeypatch.setattr(PlayoutRate, "_fit", lambda self, wanted, steady, target: wanted)
    assert play(rows, 6, changes)[1]["settling"] > 0
