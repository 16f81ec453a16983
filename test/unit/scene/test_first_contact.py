"""A motion between its rows: nothing passes anything, and the clearance that is told holds between the rows too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import ROOT, kr120, kr120_pairs, track7, track7_pairs

from construction_twin.core.units import CYCLE
from construction_twin.kinematics.chain import Chain
from construction_twin.planning.recheck import CollisionError, recheck
from construction_twin.planning.timing import time_path
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.distance_bounds import RESOLUTION
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import sample_self_collision

ROBOT = kr120()
CHAIN = Chain(ROBOT)
HOME = np.array(ROBOT.home)
#: Held at one end; at home it points away from the arm.
BAR = SceneObject("bar", "box", (4.0, 0.02, 0.02), (-2.05, 0.0, 0.1), link="tool0")
#: So much finer than the rows the reference looks.
FINER = 64


def cell(*objects: SceneObject, padding: float = 0.0) -> CollisionWorld:
    return CollisionWorld(ROBOT, Scene(objects, padding), kr120_pairs())


def rows_of(trajectory: Trajectory) -> np.ndarray:
    return trajectory.sample_many(np.append(np.arange(0.0, trajectory.duration, CYCLE), trajectory.duration))[0]


def between(rows: np.ndarray, finer: int = FINER) -> np.ndarray:
    """Return the rows and what lies between them, looked at `finer` times as densely."""
    fractions = np.arange(finer)[:, None] / finer
    return np.concatenate([*(a + fractions * (b - a) for a, b in zip(rows, rows[1:])), rows[-1:]])


def post_between(rows: np.ndarray, row: int, size: float = 0.01) -> SceneObject:
    """Return a post that the bar meets, 5 cm from its end, half way between two rows."""
    pose = CHAIN.forward(0.5 * (rows[row] + rows[row + 1]))
    end = pose.position + pose.rotation @ np.array([-4.0, 0.0, 0.1])
    return SceneObject("post", "box", (size, size, 0.6), tuple(end))


def test_a_bar_does_not_pass_a_post_between_two_samples():
    # the bar's end moves 55 mm from one row to the next: bar and post together are 30 mm
    rows = HOME + np.linspace(-0.2, 0.2, 40)[:, None] * np.eye(6)[0]
    world = cell(BAR, post_between(rows, 19))
    assert world.all_free(rows) is None, "the samples alone must not show it, or this test shows nothing"
    place, contact = world.first_contact(rows)
    assert 19.0 < place < 20.0 and set(contact.between) == {"bar", "post"}
    clearance, where = world.clearance_of(rows)
    assert clearance.distance < 0.0 and 19.0 < where < 20.0


def test_a_plan_that_passes_a_post_between_two_samples_is_refused():
    motion = time_path(HOME + np.array([[-1.2], [1.2]]) * np.eye(6)[0], ROBOT)
    samples = rows_of(motion)
    fastest = int(np.argmax(np.abs(np.diff(samples[:, 0]))))
    world = cell(BAR, post_between(samples, fastest))
    assert world.all_free(samples) is None
    with pytest.raises(CollisionError) as caught:
        recheck(motion, ROBOT, world, lambda: 0.0)
    assert set(caught.value.between) == {"bar", "post"}
    assert float(caught.value.where.split()[1]) == pytest.approx((fastest + 0.5) * CYCLE, abs=0.75 * CYCLE)


def test_what_stays_just_free_is_not_refused_and_its_clearance_is_told():
    rows = HOME + np.linspace(-0.2, 0.2, 40)[:, None] * np.eye(6)[0]
    pose = CHAIN.forward(HOME)
    for gap in (1e-4, 1e-3, 0.02):
        # beyond the bar's end, which passes it half way between two rows
        at = pose.position + pose.rotation @ np.array([-4.05 - 0.01 - gap, 0.0, 0.1])
        world = cell(BAR, SceneObject("ball", "sphere", (0.01,), tuple(at)))
        reference = min(world.clearance(q).distance for q in between(rows[15:25]))
        assert reference > 0.0
        assert world.first_contact(rows) is None
        found, _ = world.clearance_of(rows)
        assert reference - 1e-4 <= found.distance <= reference + 1.1e-4


def test_the_first_contact_is_the_first():
    rows = HOME + np.linspace(-0.4, 0.4, 30)[:, None] * np.eye(6)[0]
    early, late = post_between(rows, 7), post_between(rows, 21)
    late = SceneObject("later", late.shape, late.size, late.position)
    place, contact = cell(BAR, late, early).first_contact(rows)
    assert 7.0 < place < 8.0 and set(contact.between) == {"bar", "post"}


def test_a_row_in_contact_is_found_at_the_first_row_and_alone():
    rows = HOME + np.linspace(0.0, 0.2, 5)[:, None] * np.eye(6)[0]
    pose = CHAIN.forward(HOME)
    world = cell(SceneObject("block", "box", (0.1, 0.1, 0.1), tuple(pose.position)))
    place, contact = world.first_contact(rows)
    assert place == 0.0 and "block" in contact.between
    assert world.first_contact(rows[:1])[0] == 0.0
    assert cell().first_contact(rows[:1]) is None


@st.composite
def cases(draw):
    """Draw a load, posts near its way, a padding and a coarse motion."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    length, thick = rng.uniform(0.5, 4.0), rng.uniform(0.002, 0.05)
    load = SceneObject("load", "box", (length, thick, thick), (-0.5 * length - 0.05, 0.0, 0.1), link="tool0")
    step = rng.normal(size=6) * rng.choice([0.0, 0.002, 0.01, 0.03], 6)
    start = HOME + rng.uniform(-0.6, 0.6, 6)
    rows = start + np.arange(12)[:, None] * step
    posts = []
    for number in range(3):
        pose = CHAIN.forward(rows[rng.integers(0, 11)] + rng.uniform(0.0, 1.0) * step)
        at = pose.position + pose.rotation @ np.array([-0.05 - rng.uniform(0.1, 1.05) * length, 0.0, 0.1])
        size = tuple(rng.uniform(0.002, 0.03, 2)) + (rng.uniform(0.05, 0.6),)
        posts.append(SceneObject(f"post{number}", "box", size, tuple(at + rng.normal(0.0, 0.02, 3))))
    return cell(load, *posts, padding=float(rng.choice([0.0, 0.005]))), rows


found_free, found_between = [], []


@settings(max_examples=60, deadline=None)
@given(cases())
def test_nothing_is_passed_and_nothing_free_is_refused(case):
    world, rows = case
    found = world.first_contact(rows)
    fine = between(rows)
    if found is None:
        # deeper than half the resolution nothing may be in its margin: looked at finely, and measured
        for pairs in map(world.distances, fine[:: 1 + len(fine) // 400]):
            assert all(pair.distance > pair.margin - 0.5 * RESOLUTION - 2e-6 for pair in pairs)
        row = world.all_free(fine)
        if row is not None:
            deepest = min(pair.distance - pair.margin for pair in world.distances(fine[row]))
            assert deepest > -0.5 * RESOLUTION - 2e-6
        clearance, _ = world.clearance_of(rows)
        assert clearance.distance <= min(world.clearance(q).distance for q in fine[::16]) + 1.1e-4
        found_free.append(rows)
    else:
        place, contact = found
        row = int(place)
        q = rows[row] + (place - row) * (rows[min(row + 1, len(rows) - 1)] - rows[row])
        assert set(contact.between) in [set(each.between) for each in world.contacts(q)]
        if world.all_free(rows) is None:
            found_between.append(rows)
        # nothing that touches is earlier
        earlier = fine[: int(place * FINER)]
        first = world.all_free(earlier) if len(earlier) else None
        if first is not None:
            deepest = min(pair.distance - pair.margin for pair in world.distances(earlier[first]))
            assert deepest > -0.5 * RESOLUTION - 2e-6


def redundant() -> RobotModel:
    return read_robot_files(ROOT / "test/data/iiwa_like.urdf", ROOT / "test/data/iiwa_like.yaml")


@pytest.mark.parametrize(
    "robot, pairs, away", [(track7, track7_pairs, (-1.0, 0.0, 0.0)), (redundant, None, (0.0, 0.0, 1.0))]
)
def test_the_same_holds_on_a_rail_and_for_a_redundant_arm_with_a_load(robot, pairs, away):
    arm = robot()
    checked = pairs() if pairs else sample_self_collision(arm, samples=300)
    chain, rng = Chain(arm), np.random.default_rng(3)
    # where the load points away from the arm at home, in the frame of the tool
    outwards = np.array(away)
    size = tuple(np.where(outwards != 0.0, 3.0, 0.02))
    load = SceneObject("load", "box", size, tuple(1.6 * outwards + (0.0, 0.0, 0.1)), link=arm.tip_link)
    free = between_only = 0
    for _ in range(60):
        step = rng.normal(size=7) * rng.choice([0.0, 0.01, 0.03], 7)
        rows = np.array(arm.home) + rng.uniform(-0.3, 0.3, 7) + np.arange(8)[:, None] * step
        pose = chain.forward(rows[rng.integers(0, 7)] + rng.uniform() * step)
        at = pose.position + pose.rotation @ (rng.uniform(0.8, 3.1) * outwards + (0.0, 0.0, 0.1))
        at += rng.normal(0.0, 0.03, 3)
        post = SceneObject("post", "box", (0.006, 0.006, 0.2), tuple(at))
        world = CollisionWorld(arm, Scene((load, post)), checked)
        fine = between(rows)
        if world.first_contact(rows) is None:
            free += 1
            row = world.all_free(fine)
            if row is not None:
                deepest = min(pair.distance - pair.margin for pair in world.distances(fine[row]))
                assert deepest > -0.5 * RESOLUTION - 2e-6
        else:
            between_only += world.all_free(rows) is None
    assert free >= 5 and between_only >= 3


def test_the_plan_s_own_curve_is_beside_the_line_by_less_than_any_padding():
    """The bound is the time between two setpoints squared, times an eighth of all joints' acceleration limits at once."""
    for objects, cycle, word in (
        ((), CYCLE, "0.1 mm"),
        ((BAR,), CYCLE, "0.4 mm"),
        ((), 3 * CYCLE, "0.6 mm"),
        ((BAR,), 3 * CYCLE, "3.7 mm"),
    ):
        beside = cycle**2 / 8.0 * np.array(ROBOT.acceleration) @ cell(*objects).levers
        assert f"{1e3 * beside:.1f} mm" == word


def test_the_cases_were_of_both_kinds():
    test_nothing_is_passed_and_nothing_free_is_refused()
    assert found_free and found_between
