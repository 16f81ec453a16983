"""Ways found before: tried in the present world, never taken for granted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning_cell import LEFT, REQUEST, RIGHT, WALL, planner, world

from construction_twin.core.motion_errors import DurationError, NoPathError
from construction_twin.planning.motion_validator import MotionValidator
from construction_twin.planning.path_memory import DETOUR, KEPT, TRIED, PathMemory
from construction_twin.planning.path_search import PathQuery
from construction_twin.planning.path_searches import path_search

LEVERS = np.ones(2)


class Disc:
    """A world of two joints in which a disc around the origin must not be entered; it counts what it is asked."""

    def __init__(self, radius: float = 1.0):
        self.radius, self.asked = radius, 0

    def is_free(self, q) -> bool:
        self.asked += 1
        return bool(np.hypot(*q) > self.radius)

    def all_free(self, qs) -> int | None:
        return next((row for row, q in enumerate(qs) if not self.is_free(q)), None)


class Search:
    """A search that finds what it is given; it notes what it is asked."""

    name = "test"

    def __init__(self, *inner):
        self.inner, self.asked = inner, []

    def find(self, query: PathQuery, budget: float) -> np.ndarray:
        self.asked.append((query.start.tolist(), [goal.tolist() for goal in query.goals], budget))
        if not self.inner:
            raise NoPathError(self.name, budget)
        return np.array([query.start, *self.inner, query.goals[0]])


def find(memory: PathMemory, wanted: PathQuery, search: Search | None = None) -> np.ndarray | None:
    found = memory.find(wanted, search or Search(), 0.5)
    return None if found is None else found.path


def query(start, goals, world: Disc) -> PathQuery:
    edges = MotionValidator(world, LEVERS, 0.02)
    goals = [np.array(goal, dtype=float) for goal in goals]
    return PathQuery(np.array(start, dtype=float), goals, edges, -5.0 * np.ones(2), 5.0 * np.ones(2), seed=1)


def kept(*paths) -> PathMemory:
    memory = PathMemory()
    for path in paths:
        memory.keep(np.array(path, dtype=float))
    return memory


OVER = [(-2.0, 0.1), (-1.0, 1.3), (1.0, 1.3), (2.0, 0.0)]


@pytest.mark.parametrize("start, goal", [((-2.2, 0.0), (2.1, 0.3)), ((2.1, 0.3), (-2.2, 0.0))])
def test_a_way_serves_other_ends_in_both_directions(start, goal):
    world = Disc()
    wanted = query(start, [goal], world)
    path = find(kept(OVER), wanted)
    assert path[0].tobytes() == wanted.start.tobytes() and path[-1].tobytes() == wanted.goals[0].tobytes()
    assert all(wanted.validator.free(a, b) for a, b in zip(path, path[1:]))
    # shortened, too: it is no longer than through the points that were kept
    through = np.vstack((start, OVER[1:-1] if start[0] < 0 else OVER[2:0:-1], goal))
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() <= np.linalg.norm(np.diff(through, axis=0), axis=1).sum()


def test_what_is_no_longer_free_is_not_taken():
    # the disc has grown since: the edge between the kept points, or those to the ends, are in it
    assert find(kept(OVER), query((-2.0, 0.1), [(2.0, 0.0)], Disc(1.4))) is None
    thin = [(-2.0, 0.1), (-1.0, 1.3), (0.0, 0.5), (1.0, 1.3), (2.0, 0.0)]
    assert find(kept(thin), query((-2.0, 0.1), [(2.0, 0.0)], Disc(0.6))) is None


def test_the_shortest_way_to_any_goal_is_taken_first():
    under = [(x, -y) for x, y in OVER]
    far = [(-2.0, 0.1), (-1.0, 1.9), (1.0, 1.9), (2.0, 0.0)]
    path = find(kept(far, OVER, under), query((-2.0, -0.4), [(2.0, 4.0), (2.0, -0.4)], Disc()))
    assert path[-1][1] == -0.4 and path[1][1] < 0.0


def test_long_ways_and_straight_ones_are_not_tried():
    world = Disc()
    assert find(PathMemory(), query((-2, 0), [(2, 0)], world)) is None
    assert find(kept([(-2.0, 2.0), (2.0, 2.0)]), query((-2, 0), [(2, 0)], world)) is None
    # a short path high above: to farther ends it is a detour, whatever the way it came of was
    high = 2.0 * np.sqrt(DETOUR**2 - 1.0)
    above = [[(-0.1, high + more), (0.0, high + more), (0.1, high + more)] for more in (0.01, -0.01)]
    assert find(kept(above[0]), query((-2, 0), [(2, 0)], world)) is None
    assert world.asked == 0
    assert find(kept(above[1]), query((-2, 0), [(2, 0)], world)) is not None
    # for ends like its own a path is no detour, however long it is
    long_way = [(-2.0, 0.0), (0.0, 2.0 * high), (2.0, 0.0)]
    assert find(kept(long_way), query((-2, 0.1), [(2, 0.1)], world)) is not None


def test_a_request_tries_few_of_many_and_forgets_the_oldest():
    world = Disc()
    blocked = [[(-2.0, 0.0), (0.0, 0.001 * k), (2.0, 0.0)] for k in range(KEPT)]
    assert find(kept(*blocked), query((-2, 0), [(2, 0)], world)) is None
    # a blocked way costs little: its first state is the kept point
    assert 0 < world.asked <= 3 * TRIED
    assert find(kept(OVER, *blocked[: KEPT - 1]), query((-2, 0.1), [(2, 0)], Disc(0.0005))) is not None
    assert find(kept(OVER, *blocked), query((-2, 0.1), [(2, 0)], Disc())) is None


def test_a_path_that_serves_again_and_again_pushes_no_other_out():
    under = [(x, -y) for x, y in OVER]
    memory, wanted = kept(under, OVER), query((-2.0, 0.1), [(2.0, 0.0)], Disc())
    for _ in range(2 * KEPT):
        found = memory.find(wanted, Search(), 0.5)
        memory.served(found)
    assert find(memory, query((-2.0, -0.1), [(2.0, 0.0)], Disc()))[1][1] < 0.0


def test_what_became_no_plan_is_not_tried_again():
    far = [(-2.0, 0.1), (-1.0, 1.6), (1.0, 1.6), (2.0, 0.0)]
    memory, wanted = kept(far, OVER), query((-2.0, 0.1), [(2.0, 0.0)], Disc())
    memory.forget(memory.find(wanted, Search(), 0.5))
    found = memory.find(wanted, Search(), 0.5)
    np.testing.assert_array_equal(found.kept, far[1:-1])
    memory.forget(found)
    assert memory.find(wanted, Search(), 0.5) is None
    # the other direction is forgotten, too
    assert memory.find(query((2.0, 0.0), [(-2.0, 0.1)], Disc()), Search(), 0.5) is None


def test_a_path_that_a_search_completed_is_kept():
    memory, wanted = kept(OVER), query((-2.0, 0.1), [(2.2, -0.5)], Hidden())
    found = memory.find(wanted, Search((1.8, 1.0)), 0.5)
    memory.served(found)
    # without a search this time
    np.testing.assert_array_equal(memory.find(wanted, Search(), 0.5).path, found.path)


def test_kept_points_out_of_the_bounds_of_a_request_are_left_out():
    world = Disc()
    narrow = replace(query((-2.0, 0.1), [(2.0, 0.0)], world), upper=np.array([5.0, 1.2]))
    assert find(kept(OVER), narrow) is None and world.asked == 0


class Hidden(Disc):
    """Beside the disc a sheet stands before what lies on the right."""

    def is_free(self, q) -> bool:
        return super().is_free(q) and not (1.5 < q[0] < 1.7 and q[1] < 0.9)


@pytest.mark.parametrize("turned", [False, True])
def test_a_way_that_fits_at_one_end_is_completed_by_a_search_for_the_other(turned):
    ends = [(-2.0, 0.1), (2.2, -0.5)]
    search = Search((1.8, 1.0))
    wanted = query(ends[turned], [ends[not turned]], Hidden())
    path = find(kept(OVER), wanted, search)
    near = list(OVER[2])
    asked = (near, [list(ends[1])]) if not turned else (list(ends[1]), [near])
    assert search.asked == [(*asked, 0.5)]
    assert path[0].tobytes() == wanted.start.tobytes() and path[-1].tobytes() == wanted.goals[0].tobytes()
    assert all(wanted.validator.free(a, b) for a, b in zip(path, path[1:]))
    # a search that finds nothing, or a way that is not free by the request's own check, is no answer
    assert find(kept(OVER), wanted, Search()) is None
    assert find(kept(OVER), wanted, Search((1.6, 0.5))) is None


@given(st.integers(0, 2**32 - 1))
def test_whatever_is_kept_what_comes_out_is_a_free_path(seed):
    rng = np.random.default_rng(seed)
    memory = kept(*(rng.uniform(-3.0, 3.0, (rng.integers(2, 6), 2)) for _ in range(rng.integers(1, 30))))
    world = Disc(0.8)
    ends = rng.uniform(-3.0, 3.0, (3, 2))
    ends = ends[[world.is_free(q) for q in ends]]
    if len(ends) < 2:
        return
    wanted = query(ends[0], ends[1:], world)
    path = find(memory, wanted)
    if path is not None:
        assert path[0].tobytes() == wanted.start.tobytes()
        assert path[-1].tobytes() in [goal.tobytes() for goal in wanted.goals]
        assert all(wanted.validator.free(a, b) for a, b in zip(path, path[1:]))


class Counted:
    """OMPL's search; it counts."""

    name = "RRTConnect"

    def __init__(self):
        self.asked = 0

    def find(self, query: PathQuery, budget: float) -> np.ndarray:
        self.asked += 1
        return path_search("RRTConnect").find(query, budget)


def test_a_planner_takes_a_way_that_it_found_before_unless_its_seed_is_fixed():
    search, cell = Counted(), world(WALL)
    remembers = planner(search=search, seed=0)
    found = remembers.plan_to_joints(RIGHT, LEFT, REQUEST, cell)
    assert search.asked == 1
    beside = RIGHT + np.radians([2.0, 1.0, 0.0, 5.0, 0.0, -5.0])
    again = remembers.plan_to_joints(LEFT, beside, REQUEST, cell)
    assert search.asked == 1 and again.planner == "RRTConnect"
    assert again.trajectory.positions[0].tobytes() == LEFT.tobytes()
    assert again.trajectory.positions[-1].tobytes() == beside.tobytes()
    assert cell.all_free(again.trajectory.positions) is None
    # another wall stands in that way: nothing is taken for granted
    higher = world(replace(WALL, size=(1.6, 0.1, 2.4), position=(1.6, 0.0, 1.2)))
    other = remembers.plan_to_joints(RIGHT, LEFT, REQUEST, higher)
    assert search.asked == 2 and higher.all_free(other.trajectory.positions) is None
    # what is too long for the duration that is asked for is no answer: a search is asked
    with pytest.raises(DurationError):
        hurried = replace(REQUEST, duration=0.5 * found.trajectory.duration)
        remembers.plan_to_joints(RIGHT, LEFT, hurried, cell)
    assert search.asked >= 3

    fixed, counted = Counted(), planner(search=Counted(), seed=1)
    plans = [planner(search=fixed, seed=1).plan_to_joints(RIGHT, LEFT, REQUEST, cell).hash]
    plans += [counted.plan_to_joints(RIGHT, LEFT, REQUEST, cell).hash for _ in range(2)]
    assert fixed.asked == 1 and len(set(plans)) == 1
