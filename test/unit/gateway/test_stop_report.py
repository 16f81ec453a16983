"""Stops: the way to rest is stated when braking begins, and the arm never goes further."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace

from gateway_cell import CONFIG, Cell, following
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE, format_allowance
from construction_twin.gateway.gateway import State
from construction_twin.gateway.player import StopReport


def stop(cell: Cell, verb: str = "stop") -> tuple[list, dict]:
    """Stop a cell's arm and follow it to rest; return its positions from the last one before the stop, and the report."""
    before = cell.measured
    assert cell.control(verb, "anybody")[0]
    stated = cell.gateway.status()["stop"]
    positions = [before]
    while cell.state is State.BRAKING:
        cell.cycle()
        positions.append(cell.measured)
    assert stated["moved_deg"] == [] and stated["took_s"] is None
    report = cell.gateway.status()["stop"]
    assert report["distance_deg"] == stated["distance_deg"] and report["time_s"] == stated["time_s"]
    return positions, report


@settings(max_examples=40, deadline=None)
@given(
    cycles=st.integers(1, 300),
    rate=st.floats(0.5, 4.0),
    decimals=st.sampled_from([3, 6]),
    start=st.floats(-0.45, 0.2),
)
def test_motion_after_a_stop_never_exceeds_what_was_stated(cycles, rate, decimals, start):
    size = min(0.05 + 0.4 * abs(start), 0.9 * 2.0 / rate, 0.9 * 2.34 / rate**2)
    cell = Cell(start=(start, -1.0), decimals=decimals)
    cell.cycle(3)
    assert cell.arm()[0]
    cell.stream(
        (start + size * (1 - math.cos(rate * k * CYCLE)), -1.0 - size * (1 - math.cos(k * CYCLE)))
        for k in range(cycles)
    )
    if cell.state is not State.FOLLOWING:
        return
    earlier = cell.measured
    cell.cycle()
    positions, report = stop(cell)
    for axis in range(2):
        # from where the gateway last heard that the arm was, which is behind what it was told since
        way = math.degrees(abs(positions[-1][axis] - earlier[axis]))
        assert way <= report["distance_deg"][axis] + 1e-9
        assert abs(way - report["moved_deg"][axis]) <= 1.1e-6
        allowed = (CONFIG.acceleration[axis] + format_allowance(decimals)) * CYCLE**2 + 1e-12
        moves = [b[axis] - a[axis] for a, b in itertools.pairwise([earlier, *positions])]
        assert all(abs(b - a) <= allowed for a, b in itertools.pairwise(moves))
    assert report["took_s"] <= report["time_s"] + 1e-9 or report["time_s"] == 0.0
    held = cell.held()
    assert held == positions[-1]


def test_the_report_names_the_cause_and_is_exact_on_a_free_way():
    cell = following()
    positions, report = stop(cell)
    assert report["cause"] == "stop" and report["took_s"] == report["time_s"] > 0.05
    assert report["moved_deg"] == report["distance_deg"]
    assert len(positions) - 1 == round(report["time_s"] / CYCLE)


def test_linear_axes_are_told_in_mm_and_rounded_up():
    report = StopReport((False, True))
    stated = (math.radians(1.0000001), 0.0012345678)
    report._braking = SimpleNamespace(distance=stated, time=0.1, moved=(), took=None)
    assert report.status_fields()["distance_deg"] == [1.000001, 1.234568]


def test_a_stop_by_silence_contains_the_braking_before_anybody_called_it_one():
    cell = following(decimals=6)
    # playout runs dry after the delay; from then on the arm brakes
    before = cell.measured
    while not cell.count("cycles_without_command"):
        earlier, before = before, cell.measured
        cell.cycle()
    steps = round(abs(before[0] - earlier[0]) / (CONFIG.acceleration[0] * CYCLE**2) + 0.5)
    while cell.state is not State.HOLDING:
        cell.cycle()
    report = cell.gateway.status()["stop"]
    assert report["cause"] == "silence"
    assert abs(report["moved_deg"][0] - math.degrees(abs(cell.measured[0] - before[0]))) <= 1.1e-6
    assert 0.1 < report["moved_deg"][0] <= report["distance_deg"][0]
    assert report["took_s"] <= report["time_s"] + 1e-9 and abs(report["took_s"] / CYCLE - steps) <= 1
