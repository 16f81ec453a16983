"""Moving playout time: the whole shift, within its pace."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.gateway.playout import CALM, URGENT, Slew


def carry_out(slew, pace, most=20_000):
    shifts = []
    while slew.moving:
        shifts.append(slew.step(pace))
        assert len(shifts) <= most
    return shifts


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
