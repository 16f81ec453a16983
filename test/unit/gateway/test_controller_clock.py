"""What a session's telegrams show of the controller's clock, and that jitter, stalls and lost telegrams do not pass for a cycle."""

from __future__ import annotations

import dataclasses
import random

import pytest
from gateway_cell import START, Cell, gap

from construction_twin.gateway.controller_clock import (
    FIRST,
    LOSSES,
    PATIENT,
    SHORTER,
    TOLERANCE,
    ControllerClock,
)
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


@pytest.mark.parametrize("expected, other, needed", [(4, 12, LOSSES), (12, 4, SHORTER)])
def test_a_change_of_the_cycle_within_a_session_is_seen_in_a_few_telegrams(expected, other, needed):
    clock = ControllerClock(expected)
    for ipoc, at in regular(expected, float(expected), 500):
        clock.note(ipoc, round(at * MS))
    assert clock.judge() == "" and not clock.changed
    # RSI was off for 100 ms
    last = ipoc + 100
    clock.note(last, round((at + 100.0) * MS))
    for k in range(1, needed + 1):
        assert not clock.changed
        clock.note(last + k * other, round((at + 100.0 + k * other) * MS))
    assert clock.changed.startswith(
        f"the controller's cycle is {other} ms (IPOC steps of {other}); expected {expected} ms"
    )


def test_a_changed_cycle_is_forgotten_once_the_expected_one_is_back():
    clock, ipoc = ControllerClock(4), 10**9
    for step, count in ((4, 500), (12, 30), (4, 200)):
        for _ in range(count):
            ipoc += step
            clock.note(ipoc, ipoc * MS)
        assert bool(clock.changed) is (step == 12 or count == 200)
    assert clock.judge(rates=False) == "" and not clock.changed


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


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_losses_pauses_and_swapped_telegrams_never_look_like_a_change_of_the_cycle(seed, cycle_ms):
    for telegrams in (disturbed(seed, cycle_ms), bursts(seed, cycle_ms)):
        clock = ControllerClock(cycle_ms)
        for ipoc, arrived in telegrams:
            clock.note(ipoc, round(arrived * MS))
            assert not clock.changed


def test_every_second_telegram_lost_is_no_change_either():
    # steps of 8, as exact as another cycle: but no controller has one of 8 ms
    clock = ControllerClock(4)
    for ipoc, at in regular(8, 8.0):
        clock.note(ipoc, round(at * MS))
    assert not clock.changed


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
    assert (cell.gateway.fault, cell.gateway.session, cell.count("stops_cycle")) == (True, "", 1)
    cell.cycle(20, step_ms=other)
    assert cell.state is State.HOLDING and cell.gateway.status()["stop"]["cause"] == "cycle"
    # a reset leads to no armed session as long as the cycle is the other one
    assert cell.control("reset")[0] and not cell.arm("s2")[0]
    cell.cycle(step_ms=other)
    assert cell.state is State.OTHER_CYCLE and cell.gateway.reason.startswith(said)


@pytest.mark.parametrize("cycle", [4, 12])
def test_a_motion_over_a_noisy_path_is_never_stopped_for_its_cycle(cycle):
    cell, rng = measured(cycle), random.Random(1)
    assert cell.arm()[0]
    for _ in range(4000):
        cell.send(START)
        if cycle == 4 or rng.random() < 0.3:
            cell.cycle(step_ms=cycle * rng.choice((1, 1, 2, 2, 3)))
    assert cell.count("stops_cycle") == 0 and cell.state is not State.OTHER_CYCLE


def test_a_clock_that_is_not_measured_is_not_judged_later_either():
    cell = Cell()
    cell.cycle(3)
    cell.cycle(100, step_ms=12)
    assert cell.state is State.READY and cell.arm()[0]


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
