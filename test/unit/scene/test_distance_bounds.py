"""What the search for contacts rests on: how far bodies move at most."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene_samples import kr120, kr120_pairs, track7, track7_pairs

from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.distance_bounds import TOLERANCE, Motion, Travel, pair_levers
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.pair_checks import checked_pairs

#: Of all pairs [m].
MARGIN = 0.01
#: A long bar in the hand, walls, a ball and a post beside the arm.
SCENE = Scene(
    (
        SceneObject("bar", "box", (3.0, 0.02, 0.02), (-1.55, 0.0, 0.1), link="tool0"),
        SceneObject("wall", "box", (0.2, 6.0, 3.0), (2.6, 0.0, 1.5), (0.0, 0.0, 0.199, 0.98)),
        SceneObject("ball", "sphere", (0.3,), (1.4, 1.2, 1.0)),
        SceneObject("post", "cylinder", (0.1, 2.5), (-1.0, -1.8, 1.25), (0.148, 0.098, -0.015, 0.984)),
    ),
    0.0,
)


class Cell:
    """A robot in the scene, with the bounds of its pairs."""

    def __init__(self, robot, self_collision):
        self.robot = robot
        self.world = CollisionWorld(robot, SCENE, self_collision)
        bodies_of = RobotBodies(robot)
        bodies = (*bodies_of.bodies, *bodies_of.place_all(SCENE))
        pairs = checked_pairs(bodies, 0.0, self_collision)
        self.levers = pair_levers(bodies_of, bodies, pairs)
        self.rows_of = bodies_of.rows

    def distances(self, q: np.ndarray) -> np.ndarray:
        return np.array([pair.distance for pair in self.world.distances(q)])


CELLS = {"kr120": Cell(kr120(), kr120_pairs()), "kr120_track": Cell(track7(), track7_pairs())}


@pytest.mark.parametrize("name", CELLS)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(2, 60), size=st.sampled_from([1e-3, 0.02, 0.2, 1.0]))
def test_no_distance_changes_by_more_than_the_bodies_travel(name, seed, rows, size):
    cell = CELLS[name]
    rng = np.random.default_rng(seed)
    lower, upper = np.array(cell.robot.lower), np.array(cell.robot.upper)
    # a motion whose steps keep their direction for a while, with some noise, as plans and worse
    steps = np.repeat(rng.normal(size=(-(-rows // 9), len(lower))), 9, axis=0)[: rows - 1]
    steps = size * (steps + rng.choice([0.0, 0.5]) * rng.normal(size=steps.shape))
    qs = rng.uniform(0.5 * lower, 0.5 * upper) + np.concatenate((np.zeros((1, len(lower))), np.cumsum(steps, axis=0)))
    travel = Travel(cell.rows_of(qs), cell.levers)
    places = np.sort(np.concatenate((rng.uniform(0.0, rows - 1, 6), [0.0, rows - 1.0])))
    rest = places - np.minimum(places.astype(int), rows - 2)
    at = places.astype(int).clip(max=rows - 2)
    distances = np.array([cell.distances(q) for q in qs[at] + rest[:, None] * (qs[at + 1] - qs[at])])
    pairs = np.arange(distances.shape[1])
    moved = np.array([travel.at(np.full(len(pairs), place), pairs) for place in places])
    for first in range(len(places)):
        for last in range(first + 1, len(places)):
            changed = np.abs(distances[last] - distances[first])
            assert np.all(changed <= moved[last] - moved[first] + 2.0 * TOLERANCE)


def test_the_bounds_are_worth_something():
    # where they say nothing, every pair is measured: right, but slow
    cell = CELLS["kr120"]
    qs = np.array(cell.robot.home) + np.linspace(0.0, 0.4, 51)[:, None] * np.eye(6)[0]
    pairs = np.arange(len(cell.levers))
    ways = Travel(cell.rows_of(qs), cell.levers).at(np.full(len(pairs), 50.0), pairs)
    # nothing of arm and bar is further than 8 m from the first axis, as a chain; what it turns together stays together
    assert 0.5 < ways.max() < 0.4 * 8.0 and (ways == 0.0).any()


@st.composite
def distances_on_a_motion(draw):
    """Draw the distances of some pairs in successive rows, often exactly at the margin."""
    rows, pairs = draw(st.integers(1, 140)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    steps = MARGIN * rng.choice([0.0, 1e-4, 0.25, 1.0], pairs)
    found = (
        MARGIN * rng.integers(1, 8, pairs)
        + rng.choice([0.0, 3e-6])
        + np.cumsum(steps * rng.integers(-1, 2, (rows, pairs)), axis=0)
    )
    standing = rng.random() < 0.3
    return np.broadcast_to(found[0], found.shape).copy() if standing else np.abs(found)


@given(found=distances_on_a_motion(), short=st.sampled_from([-5e-7, 0.0, 1e-7, 1e-6]))
def test_the_first_contact_is_found_or_left_to_the_rows(found, short):
    rows, pairs = found.shape
    measured = 0

    def distance(place, pair):
        return float(np.interp(place, np.arange(rows), found[:, pair]))

    def touches(place, pair):
        # Coal's check and Coal's measurement of a distance differ by their rounding
        return distance(place, pair) <= MARGIN - short

    def measure(places, wanted):
        nonlocal measured
        measured += len(places)
        assert measured < 20_000, "it does not come to an end"
        return np.array([distance(*asked) for asked in zip(places, wanted)])

    ways = np.abs(np.diff(found, axis=0)).max(axis=1, initial=0.0)
    travel = Travel(np.concatenate(([0.0], np.cumsum(ways)))[:, None], np.ones((pairs, 1)))
    motion = Motion(travel, rows - 1, pairs, measure)
    first, doubtful = motion.first_contact(np.full(pairs, MARGIN), touches)
    in_contact = np.flatnonzero([any(touches(row, pair) for pair in range(pairs)) for row in range(rows)])
    if first is not None:
        assert touches(*first)
        assert all(row < first[0] for row in doubtful)
    # whatever is in contact in a row is found there or before, or the row is named
    for row in in_contact:
        assert (first is not None and first[0] <= row) or row in doubtful
