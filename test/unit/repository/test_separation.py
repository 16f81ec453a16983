"""From a distance to a speed limit."""

from __future__ import annotations

import math

import pytest
from distance_to_speed import SeparationLimit, SpeedTable
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS

T0 = 1_790_000_000 * NANOSECONDS
DEADLINE = 300_000_000
ROWS = [[1.0, 0.1], [2.0, 0.5], [4.0, 1.0]]


def separation() -> SeparationLimit:
    return SeparationLimit(SpeedTable(ROWS), DEADLINE / NANOSECONDS)


class TestTable:
    @pytest.mark.parametrize(
        "distance, fraction",
        [(0.0, 0.1), (1.0, 0.1), (1.5, 0.3), (2.0, 0.5), (3.0, 0.75), (4.0, 1.0), (9.0, 1.0), (math.inf, 1.0)],
    )
    def test_is_linear_between_its_rows_and_constant_beyond(self, distance, fraction):
        assert SpeedTable(ROWS).fraction(distance) == pytest.approx(fraction, abs=1e-15)

    @given(st.lists(st.tuples(st.floats(0.01, 5.0), st.floats(0.0, 0.2)), min_size=1, max_size=6), st.data())
    def test_never_allows_more_nearer_by(self, steps, data):
        rows, distance, fraction = [], 0.0, 0.0
        for way, rise in steps:
            distance, fraction = distance + way, min(1.0, fraction + rise)
            rows.append((distance, fraction))
        table = SpeedTable(rows)
        near, far = sorted(data.draw(st.tuples(*[st.floats(0.0, 40.0)] * 2)))
        assert table.lowest <= table.fraction(near) <= table.fraction(far) + 1e-12 <= rows[-1][1] + 2e-12


class TestLimit:
    def test_before_the_first_distance_and_after_the_deadline_the_lowest_share_holds(self):
        limit = separation()
        assert limit.update(T0) == (0.1, "no separation distance was measured yet")
        limit.on_range(3.0, 0.1, 10.0, 0, T0)
        assert limit.update(T0 + DEADLINE) == (0.75, "separation 3.00 m")
        fraction, reason = limit.update(T0 + DEADLINE + 1)
        assert fraction == 0.1 and "0.3 s" in reason

    @pytest.mark.parametrize("distance, fraction", [(math.inf, 1.0), (-math.inf, 0.1), (0.1, 0.1), (10.0, 1.0)])
    def test_nothing_in_reach_and_too_near_to_tell(self, distance, fraction):
        limit = separation()
        limit.on_range(distance, 0.1, 10.0, 0, T0)
        assert limit.update(T0)[0] == fraction

    @pytest.mark.parametrize("distance", [math.nan, -1.0, 10.1])
    def test_what_the_sensor_cannot_measure_is_refused(self, distance):
        limit = separation()
        limit.on_range(3.0, 0.1, 10.0, 0, T0)
        with pytest.raises(PayloadError, match="0.1 to 10 m") as caught:
            limit.on_range(distance, 0.1, 10.0, 0, T0 + DEADLINE)
        assert caught.value.reason == "distance"
        assert limit.update(T0 + DEADLINE)[0] == 0.75 and limit.update(T0 + DEADLINE + 1)[0] == 0.1

    def test_an_older_measurement_counts_only_of_a_sensor_that_was_silent(self):
        limit = separation()
        limit.on_range(3.0, 0.1, 10.0, T0, T0)
        with pytest.raises(PayloadError):
            limit.on_range(4.0, 0.1, 10.0, T0 - 1, T0 + 1)
        limit.on_range(4.0, 0.1, 10.0, T0 - 1, T0 + DEADLINE + 1)
        assert limit.update(T0 + DEADLINE + 1)[0] == 1.0
