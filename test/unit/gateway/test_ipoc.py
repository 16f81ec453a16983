"""What an IPOC may be: any count of 64 bits, which may also be one of 32 bits that goes past its end."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from gateway_cell import CONFIG, DELAY_CYCLES, Cell, slow
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.controller.telegram import STAMP_WRAP, stamp_step
from construction_twin.gateway.gateway import State
from construction_twin.gateway.trace import TraceWriter, read_trace
from construction_twin.scenario.judge import trace_excesses


def moving(ipoc, cycles=100, trace=None):
    """Return a cell in the middle of a motion of A1, whose next telegram carries `ipoc`."""
    cell = Cell()
    cell.gateway.trace = trace
    cell.ipoc = ipoc - 4 * (cycles + 4)
    cell.cycle(3)
    assert cell.arm()[0]
    cell.stream(slow(k) for k in range(cycles))
    cell.ipoc = cell.ipoc % STAMP_WRAP if ipoc < STAMP_WRAP else cell.ipoc
    assert cell.state is State.FOLLOWING
    return cell


def wrap(cell):
    """The next telegram is the first one past 2^32."""
    assert cell.ipoc + 4 >= STAMP_WRAP
    cell.ipoc -= STAMP_WRAP


class TestTheStep:
    @given(st.integers(0, STAMP_WRAP - 1), st.integers(-400, 400))
    def test_is_the_same_wherever_the_count_stands(self, before, step):
        assert stamp_step(before, (before + step) % STAMP_WRAP, 400) == step


@pytest.mark.parametrize("offset", [0, 1, 2, 3])
def test_a_wrap_in_mid_motion_is_a_cycle_like_any_other(offset):
    cell = moving(STAMP_WRAP - 4 * 50 + offset)
    before = cell.measured[0]
    for k in range(100, 300):
        if cell.ipoc + 4 >= STAMP_WRAP:
            wrap(cell)
        cell.stream([slow(k)])
        assert abs(cell.measured[0] - before) < 2e-3
        before = cell.measured[0]
    assert cell.ipoc < 2000, "it has wrapped"
    assert cell.measured[0] == pytest.approx(slow(300 - DELAY_CYCLES)[0], abs=math.radians(0.001))
    assert (cell.state, cell.count("rsi_sessions"), cell.count("ipoc_steps_irregular")) == (State.FOLLOWING, 1, 0)
    assert cell.count("settling") == 0


@pytest.mark.parametrize(
    "last, ipoc",
    [
        (STAMP_WRAP, 404),  # one ms longer than the timeout, and on
        (STAMP_WRAP, 10_000),
        (4_208_163_634, 0),  # far from the end of 32 bits
        (1_000_000, 996),
        (STAMP_WRAP + 4_000, 4),  # a count that did not stop there
        (2**63 + 4_000, 4),
        (2**64 - 4, 0),
    ],
)
def test_any_other_ipoc_that_goes_back_is_a_new_session(last, ipoc):
    cell = moving(last)
    cell.ipoc = ipoc - 4
    cell.cycle()
    assert cell.state is State.JOINED, "in the middle of a correction, it is not answered"
    assert (cell.count("rsi_sessions"), cell.count("sessions_by_ipoc_jump")) == (2, 1)


@pytest.mark.parametrize("ipoc", [2**63 - 400, 2**63 + 4, 2**64 - 4_000])
def test_a_count_of_64_bits_is_followed_and_recorded(tmp_path, ipoc):
    writer = TraceWriter(str(tmp_path / "trace"), 2)
    cell = moving(ipoc, trace=writer.record)
    cell.stream(slow(k) for k in range(100, 300))
    writer.close()
    entries = read_trace(str(tmp_path / "trace"))
    assert [entry.ipoc for entry in entries] == list(range(cell.ipoc - 4 * 302, cell.ipoc + 1, 4))
    assert trace_excesses(entries, cell.config.limits, 3) == []
    assert all(entry.time_since(before) == 4 for before, entry in pairwise(entries))
    assert cell.count("settling") == 0 and cell.state is State.FOLLOWING


PEER = ("192.168.1.20", 49152)


def telegram(ipoc):
    return b'<Rob Type="KUKA"><AIPos A1="0"/><IPOC>%d</IPOC></Rob>' % ipoc


@pytest.mark.parametrize("last", [1400, STAMP_WRAP - 4, 2**63 - 4, 2**63, 2**64 - 8])
def test_the_last_resort_answers_the_same_telegrams(last):
    resort = CONFIG.make.last_resort(CONFIG)
    resort.on_reply_sent(last, PEER, (0.004, -0.004), (0.0, 0.0), 0)
    resort.begin()
    following = 0 if last == STAMP_WRAP - 4 else last + 4
    found = resort.stamp_of(telegram(following), PEER)
    assert found == following
    before = resort.target
    reply = resort.answer(found)
    assert reply is not None and b"<IPOC>%d</IPOC>" % following in reply
    assert resort.target != before, "it brakes on, it does not take the arm to be standing"
    for late in (last, last - 4, following, 2**64):
        assert resort.stamp_of(telegram(late), PEER) is None
