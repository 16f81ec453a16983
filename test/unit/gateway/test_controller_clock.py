"""What a session's telegrams show of the controller's clock, and that jitter, stalls and lost telegrams do not pass for a cycle."""

from __future__ import annotations

import dataclasses
import random

import pytest
from gateway_cell import Cell, gap

from construction_twin.gateway.controller_clock import FIRST, PATIENT, TOLERANCE, ControllerClock
from construction_twin.gateway.states import State

MS = 1_000_000


def judged(telegrams, cycle_ms=4):
    """Return the first thing that a clock says of (IPOC [ms], arrival [ms]), and after how many telegrams; None when nothing."""
    clock = ControllerClock(cycle_ms)
    for count, (ipoc, arrived) in enumerate(telegrams, 1):
        clock.note(ipoc, round(arrived * MS))
        said = clock.judge()
        if said is not None:
            return said, count
    return None, count


def regular(step=4, every=4.0, count=2000, first=10**9):
    return [(first + k * step, k * every) for k in range(count)]


def test_the_expected_cycle_is_known_after_a_short_while():
    assert judged(regular()) == ("", FIRST // 4)
    assert judged(regular(12, 12.0), 12) == ("", FIRST // 12)


@pytest.mark.parametrize(
    "step, every, expected, sentence",
    [
        (12, 12.0, 4, "the controller's cycle is 12 ms (IPOC steps of 12); expected 4 ms: RSI_ON(..., #IPO_FAST); "
                     "or set the gateway's cycle to 12 (rsi_cycle:=12)"),
        (4, 4.0, 12, "the controller's cycle is 4 ms (IPOC steps of 4); expected 12 ms: RSI_ON(..., #IPO); "
                    "or set the gateway's cycle to 4 (rsi_cycle:=4)"),
        (8, 8.0, 4, "the controller's cycle is 8 ms (IPOC steps of 8); expected 4 ms: RSI_ON(..., #IPO_FAST)"),
        (1, 4.0, 4, "the controller's clock runs 0.25 times as fast as real time (IPOC steps of 1, a telegram every 4.0 ms); "
                    "expected IPOC to count milliseconds, 4 per telegram: what sends is no controller in real time"),
        (4, 2.0, 4, "the controller's clock runs 2.00 times as fast as real time (IPOC steps of 4, a telegram every 2.0 ms); "
                    "expected IPOC to count milliseconds, 4 per telegram: what sends is no controller in real time"),
        (4, 12.0, 4, "the controller's clock runs 0.33 times as fast as real time (IPOC steps of 4, a telegram every 12.0 ms); "
                     "expected IPOC to count milliseconds, 4 per telegram: what sends is no controller in real time"),
    ],
)  # fmt: skip
def test_another_clock_is_named(step, every, expected, sentence):
    said, count = judged(regular(step, every), expected)
    assert said == sentence
    assert count == (FIRST if step != expected else PATIENT) // expected


@pytest.mark.parametrize("rate", [1 - 2 * TOLERANCE, 1 + 2 * TOLERANCE])
def test_a_clock_that_is_a_little_wrong_is_judged_late_but_it_is(rate):
    said, count = judged(regular(4, 4.0 / rate))
    assert said.startswith(f"the controller's clock runs {rate:.2f} times") and count == PATIENT // 4


@pytest.mark.parametrize("rate", [1 - TOLERANCE / 2, 1 + TOLERANCE / 2])
def test_a_clock_within_the_tolerance_is_none_of_this_one_s_business(rate):
    assert judged(regular(4, 4.0 / rate))[0] == ""


def disturbed(seed, cycle_ms=4):
    """A real controller's telegrams over a noisy network, between machines that stall: some lost, some in bursts, some twice."""
    rng = random.Random(seed)
    arrivals, free, k = [], 0.0, 0
    stall_until = 0.0
    for k in range(3000):
        sent = k * cycle_ms
        if rng.random() < 0.01:
            stall_until = sent + rng.uniform(5.0, 150.0)
        free = max(sent + rng.expovariate(1 / 1.5), stall_until, free)
        if rng.random() < 0.1:
            continue
        arrivals.append((10**9 + sent, free))
        if rng.random() < 0.05:
            arrivals.append((10**9 + sent, free + 0.2))
    return arrivals


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_jitter_stalls_and_losses_are_never_called_another_clock(seed, cycle_ms):
    assert judged(disturbed(seed, cycle_ms), cycle_ms)[0] == ""


@pytest.mark.parametrize("seed", range(10))
def test_nor_do_they_hide_one(seed):
    said, _ = judged(disturbed(seed, 12), 4)
    assert said.startswith("the controller's cycle is 12 ms (IPOC steps of 12); expected 4 ms")


def test_the_wall_clock_may_be_set_meanwhile():
    telegrams = [(ipoc, at + (3.6e6 if k > 40 else 0.0)) for k, (ipoc, at) in enumerate(regular())]
    assert judged(telegrams)[0] == ""


def test_another_session_is_measured_anew():
    clock = ControllerClock(4)
    for ipoc, at in regular(12, 12.0, 90):
        clock.note(ipoc, round(at * MS))
    # RSI was started again, with a count of its own
    for ipoc, at in regular(4, 4.0, FIRST // 4 - 1, first=5000):
        clock.note(ipoc, round(at * MS))
        assert clock.judge() is None
    clock.note(5000 + FIRST - 4, (FIRST - 4) * MS)
    assert clock.judge() == ""


def test_figures_are_reported_once_they_are_known():
    clock = ControllerClock(4)
    unknown = {"expected_ms": 4, "ipoc_step_ms": None, "telegram_ms": None, "rate": None}
    assert clock.report() == unknown
    for ipoc, at in regular(4, 2.0, 100):
        clock.note(ipoc, round(at * MS))
    assert clock.report() == {"expected_ms": 4, "ipoc_step_ms": 4, "telegram_ms": 2.0, "rate": 2.0}
    clock.restart()
    assert clock.report() == unknown


# -- the gateway -------------------------------------------------------------------------------------------------------


def test_a_session_can_be_armed_once_its_cycle_is_known_and_not_before():
    cell = Cell(measures=True)
    cell.cycle(3)
    assert cell.state is State.MEASURING
    assert cell.gateway.reason.startswith("RSI session began at IPOC 1000004")
    assert cell.gateway.reason.endswith("; measuring the controller's cycle")
    ok, why = cell.arm()
    assert not ok and why == f"gateway is measuring: {cell.gateway.reason}"
    cell.cycle(FIRST // 4)
    assert cell.state is State.READY and "measuring" not in cell.gateway.reason
    assert cell.arm() == (True, "armed")
    assert set(cell.replies) == {(0.0, 0.0)}


def test_a_controller_of_another_cycle_is_answered_and_held_but_never_armed():
    cell = Cell(measures=True)
    cell.cycle(200, step_ms=12)
    assert cell.state is State.OTHER_CYCLE
    said = "the controller's cycle is 12 ms (IPOC steps of 12); expected 4 ms: RSI_ON(..., #IPO_FAST)"
    assert cell.gateway.reason.startswith(said)
    ok, why = cell.arm()
    assert not ok and why.startswith(f"gateway is other_cycle: {said}")
    assert cell.gateway.status()["cycle"] == {
        "expected_ms": 4, "ipoc_step_ms": 12, "telegram_ms": 12.0, "rate": 1.0,
    }  # fmt: skip
    assert set(cell.replies) == {(0.0, 0.0)}
    # nor does a stop and reset lead around it
    assert cell.control("stop")[0] and cell.gateway.fault
    assert cell.control("reset")[0] and not cell.gateway.fault
    assert cell.state is State.OTHER_CYCLE and not cell.arm("s2")[0]


def test_the_next_session_is_judged_by_itself():
    cell = Cell(measures=True)
    cell.cycle(200, step_ms=12)
    gap(cell)
    cell.cycle(FIRST // 4 + 1)
    assert cell.state is State.READY and cell.arm() == (True, "armed")


def test_while_it_is_measured_the_held_pose_follows_a_program_of_the_controller():
    cell = Cell(measures=True)
    for k in range(FIRST // 4 + 1):
        cell.setpoint = (0.1 + 1e-4 * k, -1.0)
        cell.measured = cell.setpoint
        cell.cycle()
    assert cell.state is State.READY and set(cell.replies) == {(0.0, 0.0)}
    assert cell.arm() == (True, "armed")


def test_of_a_controller_that_takes_no_corrections_another_cycle_is_named_too():
    cell = Cell(measures=True, layout=dataclasses.replace(Cell().config.layout, onlysend=True))
    cell.cycle(200, step_ms=12)
    assert cell.state is State.READ_ONLY and cell.gateway.reason.startswith("RSI session began at IPOC ")
    said = "; the controller's cycle is 12 ms (IPOC steps of 12); expected 4 ms: RSI_ON(..., #IPO_FAST)"
    assert said in cell.gateway.reason
    gap(cell)
    cell.cycle(FIRST // 4 + 1)
    assert cell.state is State.READ_ONLY and "the controller's cycle is" not in cell.gateway.reason


def test_the_end_of_the_program_is_told_to_a_controller_of_another_cycle_too():
    plain = Cell().config.layout
    layout = dataclasses.replace(plain, receive=("Stop", *plain.receive), holdon=(False, *plain.holdon))
    cell = Cell(measures=True, layout=layout)
    cell.cycle(200, step_ms=12)
    assert not cell.gateway.ends
    cell.gateway.end("the gateway is ending")
    assert cell.gateway.ends
