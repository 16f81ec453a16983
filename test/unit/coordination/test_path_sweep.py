"""A path in sections takes up what the whole path takes up, and an arm is found on it wherever it is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from neighbour_cell import AWAY, BESIDE, TOWARDS, body_points, other, plan
from neighbour_distance import distance_to

from construction_twin.coordination import path_sweep
from construction_twin.coordination.path_sweep import PathSweep

PLAN = plan(AWAY, TOWARDS)


@pytest.fixture(autouse=True, scope="module")
def short_sections():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(path_sweep, "CHUNK", 150)
        yield


def sweep(standing: bool = True) -> PathSweep:
    return PathSweep(other(), PLAN.trajectory, standing)


def test_it_grows_by_sections_and_until_a_row_to_its_end():
    made = sweep()
    fractions = []
    while not made.complete:
        made.grow()
        fractions.append(made.fraction)
    assert fractions == sorted(set(fractions)) and fractions[-1] == 1.0 and len(fractions) == -(-1000 // 150)
    again = sweep()
    again.grow(400)
    assert again.fraction == 450 / 1000
    again.grow(10**6)
    assert again.complete and len(again.copies) == len(made.copies)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 1000), st.floats(0.0, 1.0))
def test_the_rest_of_its_sections_encloses_what_is_still_to_come(row, later):
    made = sweep()
    made.grow(len(made.times))
    at = row + int(later * (len(made.times) - 1 - row))
    q = PLAN.trajectory.sample_many(made.times[[at]])[0][0]
    rest = made.rest(row)
    for owner, points in body_points(BESIDE, q).items():
        for point in points:
            assert min(distance_to(copy, point) for copy in rest if copy.owner == owner) <= 1e-5


def test_copies_come_in_the_order_in_which_they_are_needed():
    made = sweep()
    made.grow(len(made.times))
    firsts = [first for first, _, _ in made.copies]
    assert firsts == sorted(firsts)
    count = made.copies_before(500)
    assert firsts[count - 1] < 500 <= firsts[count]


def test_the_pedestal_is_there_once_or_not_at_all():
    for standing in (True, False):
        made = sweep(standing)
        made.grow(len(made.times))
        pedestals = [obstacle for _, _, obstacle in made.copies if obstacle.owner == "other/link_0"]
        assert len(pedestals) == len({id(obstacle.geometry) for obstacle in pedestals})
        assert bool(pedestals) == standing
        if standing:
            assert set(pedestals) <= set(made.rest(990))


def test_an_arm_far_along_is_found_by_making_the_sections_until_there():
    made = sweep()
    q = PLAN.trajectory.sample_many(np.array([2.0]))[0][0]
    assert 450 < made.row_of(q) <= 500
    assert made.fraction < 0.7
    assert made.row_of(q + 1.0) is None and made.complete
