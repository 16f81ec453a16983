"""Moving playout time: the whole shift, within its pace."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE_NS
from construction_twin.gateway.playout import CALM, URGENT, Slew

_SHIFT = st.integers(-300_000_000, 300_000_000)


def carry_out(slew, pace, most=20_000):
    shifts = []
    while slew.moving:
        shifts.append(slew.step(pace))
        assert len(shifts) <= most
    return shifts


@settings(deadline=None)
@given(_SHIFT, st.sampled_from((CALM, URGENT)))
def test_the_sum_is_exactly_what_was_asked_for_and_the_pace_is_kept(wanted, pace):
    slew = Slew()
    slew.remaining = wanted
    shifts = carry_out(slew, pace)
    assert sum(shifts) == wanted
    assert all(-pace.back <= shift <= pace.ahead for shift in shifts)
    assert all(abs(b - a) <= pace.change for a, b in zip([0, *shifts], [*shifts, 0]))


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(-60_000_000, 60_000_000), st.integers(0, 400)), min_size=1, max_size=6),
    st.sampled_from((CALM, URGENT)),
)
def test_a_shift_that_is_changed_on_the_way_is_carried_out_too(changes, pace):
    slew, shifts = Slew(), [0]
    for wanted, cycles in changes:
        slew.remaining += wanted
        shifts += [slew.step(pace) for _ in range(cycles)]
    shifts += carry_out(slew, pace, 40_000)
    assert sum(shifts) == sum(wanted for wanted, _ in changes)
    assert all(abs(b - a) <= pace.change for a, b in zip(shifts, [*shifts[1:], 0]))


def test_the_paces_are_what_their_comments_say():
    assert (CALM.back / CYCLE_NS, CALM.ahead / CYCLE_NS) == (0.005, 0.005)
    assert (URGENT.back / CYCLE_NS, URGENT.ahead / CYCLE_NS) == (0.05, 0.005)
    # largest acceleration at 2 rad/s [rad/s^2]: velocity times change of rate per cycle over the cycle
    assert [round(2.0 * pace.change / CYCLE_NS / 0.004, 6) for pace in (CALM, URGENT)] == [0.01, 0.2]
    durations = []
    for pace, shift in ((CALM, CYCLE_NS), (URGENT, -30_000_000)):
        slew = Slew()
        slew.remaining = shift
        durations.append(len(carry_out(slew, pace)) * 0.004)
    assert [round(duration, 1) for duration in durations] == [1.8, 1.1]
