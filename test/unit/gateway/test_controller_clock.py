"""What a session's telegrams show of the controller's clock, and that jitter, stalls and lost telegrams do not pass for a cycle."""

from __future__ import annotations

import dataclasses
import random

import pytest
from gateway_cell import CONFIG, START, Cell, slow

from construction_twin.gateway.controller_clock import (
    FIRST,
    LOSSES,
    PATIENT,
    SHORTER,
    TOLERANCE,
    ControllerClock,
)
from construction_twin.gateway.states import State
from construction_twin.rsi.make import MAKE as RSI

MS = 1_000_000


def judged(telegrams, cycle_ms=4):
    """Return the first thing that a clock says of (IPOC [ms], arrival [ms]), and after how many telegrams; None when nothing."""
    clock = ControllerClock(RSI, cycle_ms)
    for count, (ipoc, arrived) in enumerate(telegrams, 1):
        clock.on_telegram(ipoc, round(arrived * MS))
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
    "step, every, expected, said",
    [
        (12, 12.0, 4, ("cycle is 12 ms", "expected 4 ms: RSI_ON(..., #IPO_FAST)")),
        (4, 4.0, 12, ("cycle is 4 ms", "expected 12 ms: RSI_ON(..., #IPO)")),
        (1, 4.0, 4, ("cycle is 1 ms (IPOC steps of 1); expected 4 ms",)),
        (4, 2.0, 4, ("runs 2.00 times as fast as real time",)),
        (4, 12.0, 4, ("runs 0.33 times as fast as real time",)),
    ],
)
def test_another_clock_is_named(step, every, expected, said):
    found, count = judged(regular(step, every), expected)
    assert all(words in found for words in said)
    assert count == (FIRST if step != expected else PATIENT) // expected


@pytest.mark.parametrize("rate", [1 - 2 * TOLERANCE, 1 + 2 * TOLERANCE])
def test_a_clock_that_is_a_little_wrong_is_judged_late_but_it_is(rate):
    said, count = judged(regular(4, 4.0 / rate))
    assert said.startswith(f"the controller's clock runs {rate:.2f} times") and count == PATIENT // 4


def troubled(seed, cycle_ms=4, off=0.0, seconds=90):
    """Telegrams of a clock that is `off`, between machines and over a path that are worse than any cell's.

    Jitter; stalls up to 0.3 s after which everything comes at once, many of them for some seconds; losses; a path that becomes
    15 ms longer; a queue that grows and is emptied again; a wall clock that is set.
    """
    rng, sent, free, route, stall_until = random.Random(seed), [], 0.0, 0.0, 0.0
    longer, queue, is_set = (rng.uniform(10.0, seconds - 10.0) * 1e3 for _ in range(3))
    burst = rng.uniform(0.0, seconds) * 1e3
    for k in range(seconds * 1000 // cycle_ms):
        at = k * cycle_ms / (1.0 + off)
        if at > longer and not route:
            route = 15.0
        if rng.random() < (0.05 if burst < at < burst + 3e3 else 0.002):
            stall_until = at + rng.uniform(5.0, 300.0)
        grown = 0.01 * (at - queue) if queue < at < queue + 4e3 else 0.0
        free = max(at + route + grown + rng.expovariate(1 / 0.8), stall_until, free)
        if rng.random() > 0.05:
            sent.append((10**9 + k * cycle_ms, free + (250.0 if at > is_set else 0.0)))
    return sent


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_jitter_stalls_and_losses_are_never_called_another_clock(seed, cycle_ms):
    assert judged(troubled(seed, cycle_ms, seconds=25), cycle_ms)[0] == ""


def test_another_session_is_measured_anew():
    clock = ControllerClock(RSI, 4)
    for ipoc, at in regular(12, 12.0, 90):
        clock.on_telegram(ipoc, round(at * MS))
    # RSI was started again, with a count of its own
    for ipoc, at in regular(4, 4.0, FIRST // 4 - 1, first=5000):
        clock.on_telegram(ipoc, round(at * MS))
        assert clock.judge() is None
    clock.on_telegram(5000 + FIRST - 4, (FIRST - 4) * MS)
    assert clock.judge() == ""


@pytest.mark.parametrize("expected, other, needed", [(4, 12, LOSSES), (12, 4, SHORTER)])
def test_a_change_of_the_cycle_within_a_session_is_seen_in_a_few_telegrams(expected, other, needed):
    clock = ControllerClock(RSI, expected)
    for ipoc, at in regular(expected, float(expected), 500):
        clock.on_telegram(ipoc, round(at * MS))
    assert clock.judge() == "" and not clock.changed
    # RSI was off for 100 ms
    last = ipoc + 100
    clock.on_telegram(last, round((at + 100.0) * MS))
    for k in range(1, needed + 1):
        assert not clock.changed
        clock.on_telegram(last + k * other, round((at + 100.0 + k * other) * MS))
    assert clock.changed.startswith(
        f"the controller's cycle is {other} ms (IPOC steps of {other}); expected {expected} ms"
    )


def bursts(seed, cycle_ms=4):
    """Telegrams over a path that loses half of them, and as the machine pauses many at once, and swaps every second pair."""
    rng, ipoc, sent = random.Random(seed), 10**9, []
    for _ in range(20_000):
        ipoc += cycle_ms
        if rng.random() < 0.001:
            ipoc += cycle_ms * rng.randrange(1, 30)
        if rng.random() < 0.5:
            sent.append((ipoc, ipoc + rng.expovariate(0.5)))
    for k in range(0, len(sent) - 1, 4):
        sent[k], sent[k + 1] = sent[k + 1], sent[k]
    return sent


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_losses_pauses_and_swapped_telegrams_never_look_like_a_change_of_the_cycle(seed, cycle_ms):
    for telegrams in (troubled(seed, cycle_ms, seconds=25), bursts(seed, cycle_ms)):
        clock = ControllerClock(RSI, cycle_ms)
        for ipoc, arrived in telegrams:
            clock.on_telegram(ipoc, round(arrived * MS))
            assert not clock.changed


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


TWELVE = "the controller's cycle is 12 ms (IPOC steps of 12); expected 4 ms: RSI_ON(..., #IPO_FAST)"
FOUR = "the controller's cycle is 4 ms (IPOC steps of 4); expected 12 ms: RSI_ON(..., #IPO)"


def measured(cycle=4, **changes):
    cell = Cell(measures=True, cycle=cycle, **changes)
    cell.cycle(FIRST // cycle + 1)
    assert cell.state is State.READY
    return cell


@pytest.mark.parametrize("cycle, other, said", [(4, 12, TWELVE), (12, 4, FOUR)])
def test_rsi_switched_on_anew_in_the_other_mode_within_the_timeout_is_never_armed(cycle, other, said):
    cell = measured(cycle)
    # RSI_OFF, RSI_ON in the other mode, from the same port; the correction is zero, so nothing else shows it
    cell.cycle(step_ms=200)
    cell.cycle(LOSSES + 1, step_ms=other)
    assert cell.count("rsi_sessions") == 1
    assert cell.state is State.OTHER_CYCLE and cell.gateway.reason.startswith(said)
    ok, why = cell.arm()
    assert not ok and why.startswith(f"gateway is other_cycle: {said}")
    assert set(cell.replies) == {(0.0, 0.0)}
    # and back
    cell.cycle(step_ms=200)
    cell.cycle(1200)
    assert cell.state is State.READY and cell.arm() == (True, "armed")


@pytest.mark.parametrize("cycle, other, said", [(4, 12, TWELVE), (12, 4, FOUR)])
def test_an_arm_between_two_polls_asks_the_clock_too(cycle, other, said):
    cell = measured(cycle)
    cell.cycle(step_ms=200)
    for _ in range(LOSSES):
        cell.now += other * MS
        cell.ipoc += other
        cell.telegram()
    assert cell.state is State.READY
    ok, why = cell.arm()
    assert not ok and why.startswith(said)


@pytest.mark.parametrize("cycle, other, said", [(4, 12, TWELVE), (12, 4, FOUR)])
@pytest.mark.parametrize("state", [State.ARMED, State.FOLLOWING])
def test_an_arm_that_is_commanded_brakes_when_the_cycle_changes(cycle, other, said, state):
    cell = measured(cycle)
    assert cell.arm()[0]
    if state is State.FOLLOWING:
        cell.stream(START for _ in range(60))
    assert cell.state is state
    cell.cycle(step_ms=40)
    needed = LOSSES if other > cycle else SHORTER
    for _ in range(needed):
        for _ in range(3 if state is State.FOLLOWING else 0):
            cell.send(START)
        cell.cycle(step_ms=other)
    assert cell.state is State.BRAKING and cell.gateway.reason.startswith(f"cycle: {said}")
    assert (cell.gateway.fault, cell.gateway.command_session, cell.count("stops_cycle")) == (True, "", 1)
    cell.cycle(20, step_ms=other)
    assert cell.state is State.HOLDING and cell.gateway.status()["stop"]["cause"] == "cycle"
    # a reset leads to no armed session as long as the cycle is the other one
    assert cell.control("reset")[0] and not cell.arm("s2")[0]
    cell.cycle(step_ms=other)
    assert cell.state is State.OTHER_CYCLE and cell.gateway.reason.startswith(said)


def test_of_a_controller_that_takes_no_corrections_the_sentence_goes_with_its_clock():
    cell = Cell(measures=True, layout=dataclasses.replace(Cell().config.layout, onlysend=True))
    cell.cycle(FIRST // 4 + 1)
    plain = cell.gateway.reason
    assert "the controller's cycle is" not in plain
    cell.gateway.pop_change()
    # the program begins RSI anew in the other mode
    cell.cycle(1200, step_ms=12)
    assert f"; {TWELVE}" in cell.gateway.reason and cell.gateway.pop_change()
    cell.cycle(1200, step_ms=12)
    assert not cell.gateway.pop_change()
    cell.cycle(1200)
    assert cell.state is State.READ_ONLY and cell.gateway.reason == plain and cell.gateway.pop_change()
    cell.cycle(1200)
    assert not cell.gateway.pop_change()


@pytest.mark.parametrize("gap_ms", [4, 16, 60])
@pytest.mark.parametrize("at", [60, 90, 120])
def test_telegrams_of_a_shorter_cycle_move_the_arm_no_faster_and_brake_it_no_harder(gap_ms, at):
    cell = measured(12, decimals=6)
    assert cell.arm()[0]
    cell.stream(slow(k, 4.0) for k in range(3 * at))
    assert cell.state is State.FOLLOWING and cell.count("settling") == 0
    at_rest = gap_ms > 12
    before = 0.0 if at_rest else cell.replies[-1][0] - cell.replies[-2][0]
    assert at_rest or abs(before) > 1e-3
    told = len(cell.replies) - 1
    cell.cycle(step_ms=gap_ms)
    cell.cycle(300, step_ms=4)
    assert cell.count("stops_cycle") == 1 and cell.state is State.HOLDING
    steps = [b[0] - a[0] for a, b in zip(cell.replies[told:], cell.replies[told + 1 :])]
    # a telegram after a gap is answered with a whole step, those of 4 ms with a third of one each
    first = 0 if gap_ms == 4 else 1
    whole = [before, *steps[:first], *(sum(steps[k : k + 3]) for k in range(first, len(steps) - 2, 3))]
    allowed = (CONFIG.acceleration[0] + 0.1) * 0.012**2
    assert max(abs(b - a) for a, b in zip(whole, whole[1:])) <= allowed
    # no third is larger than the others
    assert all(3.0 * max(map(abs, steps[k : k + 3])) <= abs(sum(steps[k : k + 3])) + 1e-9 for k in range(first, 200, 3))
    assert steps[-1] == 0.0
