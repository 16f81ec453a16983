"""The node `neighbour`: what it publishes when, and what a failure does. And the other arm when something about it is not known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from construction_twin.msg import Conflict
from neighbour_cell import AWAY, BESIDE, CLEAR, NEAR, STEP, other, plan
from planning_cell import ROBOT
from sentence_checks import says

from construction_twin.coordination.path_judge import Judgement, PlanUnknownError
from construction_twin.coordination.path_sweep import PathSweep
from construction_twin.core.errors import PoseUnknownError
from construction_twin.core.motion_errors import NeighbourUnknownError, SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.ros.nodes import neighbour as neighbour_node
from construction_twin.ros.nodes.neighbour import NeighbourNode
from construction_twin.ros.shared import arm_listener
from construction_twin.ros.shared.arm_listener import ArmPlans, OtherArm
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN
from construction_twin.scene.neighbour import Neighbour
from construction_twin.scene.objects import Scene, SceneObject

EMPTY = Scene((), 0.0)
FREE = Judgement(False, -1.0, "its path is free")
STAMP = rospy.Time(100, 5)


class Bench:
    """The node without its topics; notes in order what it does."""

    def __init__(self, monkeypatch):
        self.did: list = []
        settings = SimpleNamespace(name="b", watch_padding=0.1)
        self.own = SimpleNamespace(plans=self.plans, scene=EMPTY, poses=lambda _: (AWAY, AWAY))
        self.other = SimpleNamespace(occupied=self.occupied, claim=None, unknown="", complete=True)
        self.judge = SimpleNamespace(followed=self.followed, waiting=self.waiting, forget=lambda _: None)
        monkeypatch.setattr(neighbour_node.rospy.Time, "now", staticmethod(self._now))
        monkeypatch.setattr(neighbour_node.rospy, "loginfo", lambda *_: None)
        conflict = SimpleNamespace(publish=self.did.append)
        self.node = NeighbourNode(settings, self.own, self.other, self.judge, 2.9, conflict)

    def _now(self):
        self.did.append("time")
        return STAMP

    def plans(self):
        return ArmPlans(plan(CLEAR, NEAR, "played"), 5, plan(CLEAR, NEAR, "waiting"))

    def occupied(self, horizon):
        assert horizon == 2.9
        self.did.append("read")
        return other().between(AWAY, AWAY)

    def followed(self, *_):
        self.did.append("judge played")
        return FREE

    def waiting(self, *_):
        self.did.append("judge waiting")
        return FREE

    def check(self) -> dict[str, Conflict]:
        self.node.check()
        return {item.plan_id: item for item in self.did if isinstance(item, Conflict)}


@pytest.fixture
def bench(monkeypatch) -> Bench:
    return Bench(monkeypatch)


def test_the_verdict_on_the_plan_that_runs_is_out_before_the_one_that_waits_is_judged(bench):
    bench.check()
    names = [item.plan_id if isinstance(item, Conflict) else item for item in bench.did]
    assert names == ["time", "read", "judge played", "played", "judge waiting", "waiting"]
    assert bench.node.report().level == OK


def test_a_plan_that_began_while_it_was_judged_is_not_stopped_by_what_keeps_others_from_starting(bench):
    waiting, calls = plan(CLEAR, NEAR, "waiting"), iter(range(9))
    bench.own.plans = lambda: ArmPlans(None, 0, waiting) if next(calls) % 2 == 0 else ArmPlans(waiting, 5, None)
    bench.judge.waiting = lambda *_: Judgement(True, 0.0, "40% of its path has been checked so far")
    assert not bench.check()
    bench.own.plans = lambda: ArmPlans(None, 0, waiting)
    assert bench.check()["waiting"].conflict


def test_a_verdict_bears_the_time_before_the_poses_were_read(bench):
    assert {message.header.stamp for message in bench.check().values()} == {STAMP}


def test_a_load_that_cannot_be_used_blocks_its_plan_and_is_an_error_on_diagnostics(bench):
    def broken(*_):
        raise SceneError("mesh", "/gone.stl", "a readable file")

    bench.judge.waiting = broken
    verdicts = bench.check()
    assert not verdicts["played"].conflict
    assert verdicts["waiting"].conflict and "/gone.stl" in verdicts["waiting"].reason
    state = bench.node.report()
    assert state.level == ERROR and "/gone.stl" in state.sentence
    bench.judge.waiting = lambda *_: FREE
    assert not bench.check()["waiting"].conflict
    assert bench.node.report().level == OK


def test_an_arm_of_unknown_shape_blocks_every_plan_and_is_an_error_on_diagnostics(bench):
    def unknown(horizon):
        raise NeighbourUnknownError("b", "what it carries cannot be used")

    bench.other.occupied = unknown
    verdicts = bench.check()
    assert all(message.conflict and "cannot be used" in message.reason for message in verdicts.values())
    assert set(verdicts) == {"played", "waiting"} and bench.node.report().level == ERROR


def test_an_arm_of_unknown_pose_is_a_warning(bench):
    bench.other.unknown = "where b is, is not known"
    bench.check()
    assert (bench.node.report().level, bench.node.report().sentence) == (WARN, "where b is, is not known")


def test_an_unexpected_exception_ends_the_process(bench, monkeypatch):
    """`run` is the main thread's work: see `run_node`."""

    def broken(*_):
        raise ZeroDivisionError

    bench.judge.followed = broken
    monkeypatch.setattr(neighbour_node.rospy, "Rate", lambda _: None)
    with pytest.raises(ZeroDivisionError):
        bench.node.run()


def listener(poses, plans=lambda: ArmPlans(None, 0, None), scene=EMPTY) -> SimpleNamespace:
    return SimpleNamespace(poses=poses, plans=plans, scene=scene, robot=ROBOT)


def heard(listens: SimpleNamespace) -> OtherArm:
    return OtherArm(listens, Neighbour("b", ROBOT, BESIDE, STEP), 0.5)


def arm(*known, **more) -> OtherArm:
    return heard(listener(*known, **more))


@pytest.fixture
def sweeps(monkeypatch) -> list[PathSweep]:
    """The sweeps that the other arm makes of its paths."""
    made: list[PathSweep] = []

    def make(*given) -> PathSweep:
        made.append(PathSweep(*given))
        return made[-1]

    monkeypatch.setattr(arm_listener, "PathSweep", make)
    return made


def here(*_):
    return AWAY, AWAY


def nowhere(*_):
    raise PoseUnknownError("/b/physical/joint_states", 3.0, 0.5)


def without_plan():
    raise PlanUnknownError("its executor has said nothing yet")


@pytest.mark.parametrize("found", [arm(nowhere), arm(here, without_plan)])
def test_of_an_arm_whose_pose_or_path_nobody_knows_the_whole_reach_counts(found):
    (ball,) = found.occupied()
    assert ball.owner == "b/whole reach" and found.claim is None
    assert found.unknown.startswith("where b is, or goes, is not known")
    # the same again: who has looked at it need not look again
    assert found.occupied() == (ball,)


def test_an_arm_that_is_found_again_takes_up_where_it_is():
    listens = listener(nowhere)
    found = heard(listens)
    found.occupied()
    listens.poses = here
    assert len(found.occupied()) > 1 and found.unknown == ""


def test_the_reach_holds_what_the_arm_carries():
    pole = SceneObject("pole", "box", (0.1, 0.1, 4.0), (0.0, 0.0, 2.0), link="tool0", touch=("link_6",))
    (bare,), (long,) = arm(nowhere).occupied(), arm(nowhere, scene=Scene((pole,), 0.0)).occupied()
    assert long.geometry.radius > bare.geometry.radius + 3.0


LONG = plan(AWAY, AWAY + 0.3, "long", 40.0)


def test_a_long_path_is_known_until_beyond_the_horizon_at_once_and_to_its_end_after_some_looks(sweeps):
    found = arm(here, lambda: ArmPlans(LONG, 5, None))
    counts = [len(found.occupied(horizon=3.0))]
    assert not found.complete
    ends = [sweeps[0].fraction * 40.0]
    while not found.complete:
        counts.append(len(found.occupied(horizon=3.0)))
        ends.append(sweeps[0].fraction * 40.0)
    assert ends[0] < 10.0 and all(0.0 < later - sooner <= 5.1 for sooner, later in zip(ends, ends[1:]))
    assert counts == sorted(counts) and found.claim.since == 5


def test_the_horizon_goes_with_the_arm(sweeps):
    found = arm(lambda *_: (q, q), lambda: ArmPlans(LONG, 5, None))
    for at in (0.0, 6.0, 11.0, 19.0):
        q = LONG.trajectory.sample_many(np.array([at]))[0][0]
        found.occupied(horizon=9.0)
        assert sweeps[0].fraction * 40.0 >= at + 9.0


def test_a_planner_asks_for_the_whole_path():
    found = arm(here, lambda: ArmPlans(LONG, 5, None))
    found.occupied()
    assert found.complete


def test_a_path_is_prepared_while_its_plan_waits(sweeps):
    listens = listener(here, lambda: ArmPlans(None, 0, LONG))
    found = heard(listens)
    for _ in range(9):
        assert found.claim is None and found.occupied(horizon=3.0)
    assert sweeps[0].complete
    listens.plans = lambda: ArmPlans(LONG, 5, None)
    found.occupied(horizon=3.0)
    assert len(sweeps) == 1 and found.complete


@pytest.mark.parametrize("poses", [here, nowhere])
def test_without_knowing_what_it_carries_nobody_knows_how_far_it_reaches(poses):
    with pytest.raises(
        NeighbourUnknownError, check=says("motion.neighbour", problem=Sentence("motion.neighbour.no_scene"))
    ):
        arm(poses, scene=None).occupied()
    foreign = SceneObject("pole", "box", (0.1, 0.1, 4.0), (0.0, 0.0, 2.0), link="no_such_link")
    with pytest.raises(NeighbourUnknownError, check=says("motion.neighbour", neighbour="b")) as caught:
        arm(poses, scene=Scene((foreign,), 0.0)).occupied()
    problem = caught.value.sentence.values["problem"]
    assert (problem.key, problem.values["problem"].values["found"]) == ("motion.neighbour.load", "'no_such_link'")
