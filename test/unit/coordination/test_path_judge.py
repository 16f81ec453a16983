"""The watch's verdicts: who must wait, who may go on while the rest is still being compared, and what an unknown arm means."""

from __future__ import annotations

import numpy as np
import pytest
from neighbour_cell import AWAY, CLEAR, NEAR, TOWARDS, line, other, plan
from planning_cell import HOME, ROBOT
from sentence_checks import says

from construction_twin.coordination import conflict, path_judge
from construction_twin.coordination.conflict import Claim
from construction_twin.coordination.path_judge import Others, PathJudge
from construction_twin.core.motion_errors import SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.scene.objects import Scene, SceneObject

HORIZON = 1.0
EMPTY = Scene((), 0.0)
STANDS_AWAY, STANDS_TOWARDS = Others(other().between(AWAY, AWAY)), Others(other().between(TOWARDS, TOWARDS))
PLAN = plan(CLEAR, NEAR)
CLEAR_PLAN = plan(CLEAR, CLEAR + np.radians([-60, 0, 0, 0, 0, 0]), "p2")


@pytest.fixture
def judge(monkeypatch) -> PathJudge:
    monkeypatch.setattr(path_judge, "BUDGET", 1)
    monkeypatch.setattr(conflict, "BLOCK", 16)
    return PathJudge(ROBOT, "other", 0.03, 0.1, HORIZON)


def pose(made, at: float) -> tuple[np.ndarray, np.ndarray]:
    q = made.trajectory.sample_many(np.array([at]))[0][0]
    return q, q


CHECKING = ("reason.neighbour.checking", "reason.neighbour.checking_first_part")


def settled(judged):
    """Look until nothing more is being compared."""
    verdict = judged()
    for _ in range(200):
        if verdict.sentence.key not in CHECKING:
            return verdict
        assert verdict.blocked
        verdict = judged()
    raise AssertionError(verdict.sentence)


def test_a_waiting_plan_may_not_start_before_its_whole_way_was_compared(judge):
    first = judge.waiting(CLEAR_PLAN, EMPTY, STANDS_AWAY)
    assert first.blocked and first.sentence.key == "reason.neighbour.checking"
    assert 0 <= first.sentence.values["percent"] < 100 and first.sentence.values["neighbour"] == "other"
    verdict = settled(lambda: judge.waiting(CLEAR_PLAN, EMPTY, STANDS_AWAY))
    assert (verdict.blocked, verdict.time, verdict.sentence) == (False, -1.0, Sentence("reason.neighbour.free"))


def test_a_plan_that_runs_goes_on_while_what_is_far_ahead_is_still_being_compared(judge):
    """The other arm's plan begins: no pause in the verdicts, and no stop."""
    settled(lambda: judge.waiting(CLEAR_PLAN, EMPTY, STANDS_AWAY))
    moving = Others(other().along(line(AWAY, AWAY + 0.3)).rest(), Claim(9, "other"))
    verdict = judge.followed(CLEAR_PLAN, EMPTY, moving, 5, pose(CLEAR_PLAN, 0.5))
    assert not verdict.blocked
    # the same path, asked for as a whole: it is still being compared
    assert judge.waiting(CLEAR_PLAN, EMPTY, moving).sentence.key in CHECKING


def test_a_conflict_far_ahead_is_found_as_the_looks_go_on(judge):
    verdicts = [judge.followed(PLAN, EMPTY, STANDS_TOWARDS, 5, pose(PLAN, 0.0)) for _ in range(60)]
    blocked = [verdict.blocked for verdict in verdicts]
    assert not blocked[0] and blocked[-1] and blocked == sorted(blocked)
    assert verdicts[-1].sentence.key == "reason.neighbour.stands"


def test_a_conflict_within_the_horizon_is_found_at_once(judge):
    contact = settled(lambda: judge.waiting(PLAN, EMPTY, STANDS_TOWARDS)).time
    fresh = PathJudge(ROBOT, "other", 0.03, 0.1, HORIZON)
    at = contact - HORIZON + 0.1
    verdict = fresh.followed(PLAN, EMPTY, Others(STANDS_TOWARDS.obstacles, Claim(9, "other")), 5, pose(PLAN, at))
    assert verdict.blocked and verdict.time <= HORIZON


def test_before_one_that_began_later_it_goes_on_until_the_horizon(judge):
    later = Others(STANDS_TOWARDS.obstacles, Claim(9, "other"))
    contact = settled(lambda: judge.waiting(PLAN, EMPTY, later)).time
    assert contact > HORIZON + 0.2
    far = judge.followed(PLAN, EMPTY, later, 5, pose(PLAN, 0.0))
    assert not far.blocked and far.sentence.key == "reason.neighbour.gives_way"


def test_who_does_not_know_where_he_is_takes_every_conflict_for_near(judge):
    later = Others(STANDS_TOWARDS.obstacles, Claim(9, "other"))
    settled(lambda: judge.waiting(PLAN, EMPTY, later))
    assert not judge.followed(PLAN, EMPTY, later, 5, pose(PLAN, 0.0)).blocked
    lost = judge.followed(PLAN, EMPTY, later, 5, ())
    assert lost.blocked and lost.time == 0.0
    fresh = judge.followed(CLEAR_PLAN, EMPTY, STANDS_AWAY, 5, ())
    assert fresh.blocked and fresh.sentence.key in CHECKING


def test_a_plan_begins_at_its_first_row_wherever_the_last_one_ended(judge):
    judge.followed(PLAN, EMPTY, STANDS_AWAY, 5, pose(PLAN, 3.5))
    back = plan(NEAR, CLEAR, "back")
    verdict = judge.followed(back, EMPTY, STANDS_TOWARDS, 6, pose(back, 0.0))
    assert verdict.blocked and verdict.time == 0.0


def test_an_arm_that_is_nowhere_takes_up_all_that_it_can_reach_and_the_sentence_says_so(judge):
    unknown = "where other is, or goes, is not known: no message"
    lost = Others(other().anywhere(), None, unknown)
    verdict = settled(lambda: judge.waiting(PLAN, EMPTY, lost))
    assert verdict.blocked
    assert verdict.sentence.key == "reason.neighbour.whole_reach"
    assert verdict.sentence.values.items() >= {"neighbour": "other", "unknown": unknown}.items()
    far = Others(other("far").anywhere(), None, unknown)
    assert not settled(lambda: judge.waiting(PLAN, EMPTY, far)).blocked


def test_no_scene_is_no_free_way(judge):
    assert judge.waiting(PLAN, None, STANDS_AWAY).blocked


def test_what_the_arm_carries_counts_and_a_load_that_cannot_be_used_is_an_error(judge):
    load = SceneObject("load", "box", (0.2, 0.2, 3.0), (0.0, 0.0, 1.5), link="tool0", touch=("link_6",))
    beside = plan(HOME + np.radians([-90, 0, 0, 0, -90, 0]), HOME + np.radians([-90, 0, 0, 10, -90, 0]), "beside")
    assert not settled(lambda: judge.waiting(beside, EMPTY, STANDS_AWAY)).blocked
    verdict = settled(lambda: judge.waiting(beside, Scene((load,), 0.0), STANDS_AWAY))
    contact = verdict.sentence.values["contact"]
    assert verdict.blocked and contact.key == "reason.neighbour.too_close"
    assert contact.values["mine"] == "load" and contact.values["theirs"].startswith("other/")
    foreign = SceneObject("load", "box", (0.2, 0.2, 3.0), (0.0, 0.0, 1.5), link="no_such_link")
    with pytest.raises(SceneError, check=says("motion.scene", found="'no_such_link'")):
        judge.waiting(beside, Scene((foreign,), 0.0), STANDS_AWAY)


def test_plans_that_are_over_are_forgotten(judge):
    for one in (PLAN, CLEAR_PLAN):
        settled(lambda: judge.waiting(one, EMPTY, STANDS_AWAY))
    judge.forget({"p2"})
    assert not judge.waiting(CLEAR_PLAN, EMPTY, STANDS_AWAY).blocked
    assert judge.waiting(PLAN, EMPTY, STANDS_AWAY).sentence.key in CHECKING
