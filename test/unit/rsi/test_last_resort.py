"""The last resort: brakes from what was sent last inside the limits, echoes IPOC, and never makes the arm jump."""

from __future__ import annotations

import dataclasses
import math

import pytest
from gateway_cell import CONFIG

from construction_twin.controller.last_resort import LONGEST_GAP_MS, LastResort
from construction_twin.core.units import CYCLE
from construction_twin.rsi.controller_codec import SensorDecoder
from construction_twin.rsi.gateway_codec import SensorEncoder
from construction_twin.rsi.layout import RsiLayout
from construction_twin.rsi.make import last_resort

PEER = ("192.168.1.20", 49152)
AXES = CONFIG.axes
BUDGET = [a * CYCLE * CYCLE for a in CONFIG.acceleration]
#: Six decimals of a degree, twice: a step is the difference of two rounded values, a change of the step that of three.
ROUNDED = math.radians(2e-6)


def made(layout=None):
    return last_resort(dataclasses.replace(CONFIG, layout=layout or CONFIG.layout))


def taken_over(speed=(1.0, -2.0), cycles=100, **options):
    """A last resort that takes over from an arm that moves at `speed` [rad/s]."""
    resort = made(**options)
    for k in range(1, cycles + 1):
        resort.on_reply_sent(1000 + 4 * k, PEER, *(tuple(v * CYCLE * n for v in speed) for n in (k, k - 1)), 0)
    resort.begin()
    return resort


def telegram(ipoc):
    return b'<Rob Type="KUKA"><AIPos A1="0"/><IPOC>%d</IPOC></Rob>' % ipoc


def ask(resort, ipoc, source=PEER):
    """Return the reply's correction, or None when there is none."""
    found = resort.stamp_of(telegram(ipoc), source)
    reply = None if found is None else resort.answer(found)
    if reply is None:
        return None
    read = SensorDecoder("ImFree", AXES).parse(reply)
    assert read.controller_ms == ipoc
    return read.target


def test_it_brakes_with_every_axis_acceleration_limit_and_holds():
    resort = taken_over()
    before, last = [v * CYCLE * 99 for v in (1.0, -2.0)], [v * CYCLE * 100 for v in (1.0, -2.0)]
    for k in range(300):
        correction = ask(resort, resort.stamp + 4)
        for axis, budget in enumerate(BUDGET):
            change = (correction[axis] - last[axis]) - (last[axis] - before[axis])
            assert abs(change) <= budget + 2 * ROUNDED
        before, last = last, correction
    assert resort.at_rest and last == before
    # v^2 / 2a, less half a cycle's step
    assert last[0] - 0.4 == pytest.approx(1.0 / (2 * CONFIG.acceleration[0]), abs=CYCLE)


def test_a_repeated_telegram_an_older_one_and_one_of_somebody_else_get_no_answer():
    resort = taken_over()
    last = resort.stamp
    assert ask(resort, last) is None and ask(resort, last - 4) is None
    assert ask(resort, last + 4, ("192.168.1.21", 49152)) is None
    assert resort.stamp_of(b"garbage", PEER) is None
    assert resort.stamp_of(b"<IPOC>" + b"9" * 9000 + b"</IPOC>", PEER) is None
    assert ask(resort, last + 4) is not None


def test_after_missed_telegrams_the_arm_stands_and_is_held_where_it_stands():
    resort = taken_over()
    where = resort.target
    assert ask(resort, resort.stamp + 16) == pytest.approx(where, abs=ROUNDED)
    assert resort.at_rest


def test_after_a_long_gap_a_correction_would_be_a_jump_and_is_not_sent():
    resort = taken_over()
    assert ask(resort, resort.stamp + LONGEST_GAP_MS + 4) is None
    assert ask(resort, resort.stamp + 4) is None
    still = taken_over(speed=(0.0, 0.0))
    assert ask(still, still.stamp + LONGEST_GAP_MS + 4) == (0.0, 0.0)


def test_a_correction_of_another_session_is_no_speed():
    resort = made()
    resort.on_reply_sent(1000, PEER, (0.3, 0.3), (0.2, 0.2), 0)
    resort.on_reply_sent(900_000, PEER, (0.0, 0.0), (), 0)
    resort.begin()
    assert resort.at_rest and ask(resort, 900_004) == (0.0, 0.0)


def test_who_was_never_answered_gets_no_answer():
    resort = made()
    resort.begin()
    assert ask(resort, 1000) is None and not resort.ends_program
    without = LastResort(CONFIG.limits, None, 4)
    without.begin()
    assert ask(without, 1000) is None and without.at_rest


def test_it_ends_the_program_only_once_the_arm_is_at_rest():
    channels = (*RsiLayout.plain(AXES).receive, "Stop")
    layout = RsiLayout("ImFree", 49152, False, ("AIPos", "ASPos", "Delay"), channels, (True,) * len(channels))
    resort = made(layout)
    for k in range(1, 50):
        resort.on_reply_sent(4 * k, PEER, (0.004 * k, 0.0), (0.004 * (k - 1), 0.0), 0)
    resort.begin()
    resort.ending = True
    ends = []
    for _ in range(300):
        moving = not resort.at_rest
        reply = resort.answer(resort.stamp + 4)
        ends.append((moving, b"<Stop>1</Stop>" in reply))
    assert ends[0] == (True, False) and ends[-1] == (False, True)


def test_replies_leave_a_tool_s_outputs_as_they_were_sent_last():
    resort = taken_over()
    encoder = SensorEncoder("ImFree", AXES, (), (), ("Enable", "vacuum"))
    resort.set_templates(*(encoder.template(end, (True, True)) for end in (None, True)))
    assert b'<Set Enable="1" vacuum="1"/>' in resort.answer(resort.stamp + 4)


def counted(ipoc, delay):
    return b'<Rob Type="KUKA"><AIPos A1="0"/><Delay D="%d"/><IPOC>%d</IPOC></Rob>' % (delay, ipoc)


def ask_counted(resort, ipoc, delay):
    """Return the correction of the reply to a telegram with `Delay`."""
    assert resort.stamp_of(counted(ipoc, delay), PEER) == ipoc
    resort.rewind_if_lost(ipoc, counted(ipoc, delay))
    return SensorDecoder("ImFree", AXES).parse(resort.answer(ipoc)).target


@pytest.mark.parametrize("lost", [1, 3])
@pytest.mark.parametrize("braked", [0, 5])
def test_after_replies_that_did_not_arrive_it_holds_the_last_one_that_did(braked, lost):
    resort = taken_over()
    for _ in range(braked):
        ask_counted(resort, resort.stamp + 4, 0)
    arrived = ask_counted(resort, resort.stamp + 4, 0)
    held = [ask_counted(resort, resort.stamp + 4, number) for number in range(lost + 1)]
    # the first of these arrived where `braked` of them did; those after it are counted as missed, one by one
    assert held[0] != arrived
    assert all(correction == pytest.approx(arrived, abs=ROUNDED) for correction in held[1:])
    assert resort.at_rest
    assert ask_counted(resort, resort.stamp + 4, 0) == pytest.approx(arrived, abs=ROUNDED)
