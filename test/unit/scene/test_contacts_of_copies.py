"""The first contact between copies of bodies: what is concluded from one measured pair is what measuring every pair says."""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.coordination.conflict import copies, first_contact
from construction_twin.scene.neighbour import ROUNDING, Obstacle

BAR, POST = coal.Box(1.0, 0.02, 0.02), coal.Box(0.02, 0.02, 0.3)


def bar(turn: float, x: float = 0.0, y: float = 0.0) -> Obstacle:
    """A bar around the origin, turned about the vertical [rad]."""
    return Obstacle("own/bar", pinocchio.SE3(pinocchio.utils.rotate("z", turn), np.array([x, y, 0.0])), BAR)


def post(x: float, y: float) -> Obstacle:
    return Obstacle("other/post", pinocchio.SE3(np.eye(3), np.array([x, y, 0.0])), POST)


def measured(own: list[Obstacle], others: list[Obstacle], padding: float) -> int | None:
    """Measure every pair; return the first of `own` that touches."""

    def touches(one: Obstacle, other: Obstacle) -> bool:
        first, second = (coal.Transform3s(each.placement.rotation, each.placement.translation) for each in (one, other))
        distance = coal.distance(
            one.geometry, first, other.geometry, second, coal.DistanceRequest(), coal.DistanceResult()
        )
        return distance <= padding

    return next((place for place, one in enumerate(own) if any(touches(one, other) for other in others)), None)


def test_a_bar_that_turns_in_place_meets_the_post_beside_it():
    own, others = [bar(math.radians(angle)) for angle in (0, 30, 60, 90)], [post(0.0, 0.4)]
    assert first_contact(copies(own), copies(others), ROUNDING) == (3, others[0])
    assert first_contact(copies(own[:3]), copies(others), ROUNDING) is None


TURNS = st.lists(st.tuples(st.floats(0.0, math.pi), st.floats(-0.2, 0.2)), min_size=1, max_size=12)
PLACES = st.lists(st.tuples(st.floats(-0.8, 0.8), st.floats(0.1, 0.8)), min_size=1, max_size=4)


@settings(max_examples=100, deadline=None)
@given(TURNS, PLACES, st.sampled_from([ROUNDING, 0.05]))
def test_it_is_the_contact_that_measuring_every_pair_finds(turns, places, padding):
    own, others = [bar(turn, x) for turn, x in turns], [post(*place) for place in places]
    found = first_contact(copies(own), copies(others), padding)
    assert (None if found is None else found[0]) == measured(own, others, padding)
