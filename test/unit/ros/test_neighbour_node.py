"""The node `neighbour`: verdicts on our newest plan, from the topics of both arms."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from construction_twin.msg import Conflict, Execution, Scene
from neighbour_cell import AWAY, BESIDE, CLEAR, NEAR, STRETCHED, TOWARDS, empty_world, plan
from planning_cell import HOME, ROBOT

from construction_twin.core.errors import PoseUnknownError
from construction_twin.execution.states import ExecutorState
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.ros.nodes import neighbour as module
from construction_twin.ros.nodes.neighbour import ArmListener, NeighbourNode, OtherArm
from construction_twin.ros.shared.diagnostics import OK, WARN
from construction_twin.ros.transport.joint_stream import to_time
from construction_twin.scene.neighbour import Neighbour
from construction_twin.scene.objects import Scene as SceneValue
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.scene_change import SceneChange

#: Of ours: it reaches to the other's side; of the other's: it stretches out to ours.
OURS, THEIRS = plan(CLEAR, NEAR, "ours"), plan(AWAY, STRETCHED, "theirs")
#: Low and stretched out on either side of STRETCHED: what is between is free where the other arm stands turned away.
PASSES = plan(HOME + np.radians([-20, 45, -45, 0, 0, 0]), HOME + np.radians([-100, 45, -45, 0, 0, 0]), "ours")


class Arm:
    """An arm's topics, and what listens to them."""

    def __init__(self, name: str, monkeypatch):
        self._takes: dict[str, object] = {}
        self.refused: list[tuple[str, str]] = []
        monkeypatch.setattr(
            module, "Subscriber", lambda topic, _kind, take, *_, **__: self._takes.update({topic: take})
        )
        self.listener = ArmListener(dataclasses.replace(ROBOT, name=name), "/", lambda *said: self.refused.append(said))
        self._name = name
        self.publish("scene", scene_to_msg(SceneValue((), 0.0), to_time(0), "base_link"))
        self.follow(ExecutorState.IDLE)

    def publish(self, topic: str, message) -> None:
        self._takes[f"/{self._name}/{topic}"](message)

    def offer(self, made: Plan, *changes: SceneChange) -> None:
        self.publish("plan", plan_to_msg(made, "base_link", np.zeros((0, 3)), changes))

    def follow(self, state: ExecutorState, made: Plan | None = None, since: int = 0) -> None:
        plan_id = "" if made is None else made.id
        self.publish("execution", Execution(state=state.value, plan_id=plan_id, plan_start=to_time(since)))


class Bench:
    """The node between two arms; the other one stands turned away."""

    def __init__(self, monkeypatch):
        self.own, self.other = Arm("a", monkeypatch), Arm("b", monkeypatch)
        self.pose, self.said = AWAY, []
        for level in ("loginfo", "logwarn"):
            monkeypatch.setattr(module.rospy, level, lambda *words: None)
        stands = OtherArm(self.other.listener, (SimpleNamespace(pose=self._pose),), Neighbour("b", ROBOT, BESIDE))
        said = SimpleNamespace(publish=self.said.append)
        self.node = NeighbourNode(self.own.listener, stands, empty_world(), 0.1, said)

    def _pose(self, oldest: float):
        if self.pose is None:
            raise PoseUnknownError("/b/twin/joint_states", 3.0, oldest)
        return self.pose

    def verdict(self) -> Conflict:
        self.node.check()
        return self.said[-1]


@pytest.fixture
def bench(monkeypatch) -> Bench:
    return Bench(monkeypatch)


def test_without_a_plan_there_is_no_verdict(bench):
    bench.node.check()
    assert not bench.said and bench.node.diagnose().level == WARN


def test_a_plan_beside_an_arm_that_stands_is_free_until_that_arm_stands_in_its_path(bench):
    bench.own.offer(OURS)
    assert (bench.verdict().plan_id, bench.verdict().conflict, bench.verdict().reason) == ("ours", False, "")
    assert bench.node.diagnose().level == OK
    bench.pose = TOWARDS
    found = bench.verdict()
    assert found.conflict and "b/link_" in found.reason and "stands there" in found.reason
    assert (bench.node.diagnose().level, bench.node.diagnose().sentence) == (WARN, found.reason)


def test_a_plan_waits_until_the_plan_that_it_meets_has_ended(bench):
    bench.own.offer(PASSES)
    bench.other.offer(THEIRS)
    assert not bench.verdict().conflict, "a plan that only waits for review occupies nothing"
    for state, since in ((ExecutorState.PLAYING, 0), (ExecutorState.PLAYING, 10), (ExecutorState.PAUSED, 10)):
        bench.other.follow(state, THEIRS, since)
        found = bench.verdict()
        assert found.conflict and "follows an approved plan" in found.reason, state
    # before the word on a comparison that takes its time nothing starts by the word of before
    assert ["is being compared" in said.reason for said in bench.said] == [False, True, False, False, False]
    bench.other.follow(ExecutorState.IDLE, THEIRS, 10)
    assert not bench.verdict().conflict


def test_of_two_plans_approved_at_the_same_moment_the_later_one_stops(bench):
    bench.own.offer(PASSES)
    bench.other.offer(THEIRS)
    bench.own.follow(ExecutorState.PLAYING, PASSES, 20)
    for other, stops in ((10, True), (20, False), (30, False), (0, False)):
        bench.other.follow(ExecutorState.PLAYING, THEIRS, other)
        assert bench.verdict().conflict == stops, other
    bench.own.follow(ExecutorState.PLAYING, PASSES, 0)
    assert not bench.verdict().conflict, "neither has begun: a comes before b"
    bench.own.offer(plan(CLEAR, NEAR, "next"))
    bench.own.follow(ExecutorState.PLAYING, PASSES, 20)
    bench.other.follow(ExecutorState.PLAYING, THEIRS, 10)
    found = bench.verdict()
    assert (found.plan_id, found.conflict) == (PASSES.id, True), "a newer plan waits for its end"


def test_what_is_not_known_stops_no_plan_that_is_played_and_what_stands_in_its_path_does(bench):
    """The later one of two may come to rest in the path of the earlier one."""
    bench.own.offer(OURS)
    bench.own.follow(ExecutorState.PLAYING, OURS, 20)
    bench.pose = None
    assert not bench.verdict().conflict
    for bench.pose, stops in ((AWAY, False), (TOWARDS, True)):
        assert bench.verdict().conflict == stops
    bench.own.publish("scene", Scene(hash="wrong"))
    assert not bench.verdict().conflict, "as of a node that was started again"
    bench.own.follow(ExecutorState.IDLE, OURS, 20)
    assert bench.verdict().conflict


def test_a_node_that_was_started_again_stops_nothing_before_it_knows_what_is_played(bench):
    bench.own.listener._execution = None
    bench.own.offer(OURS)
    bench.node.check()
    assert not bench.said and bench.node.diagnose().level == WARN
    bench.own.follow(ExecutorState.PLAYING, OURS, 20)
    assert not bench.verdict().conflict


def test_a_plan_that_was_approved_during_the_comparison_counts(bench, monkeypatch):
    compare = module.first_meeting

    def slow(*given):
        found = compare(*given)
        bench.other.follow(ExecutorState.PLAYING, THEIRS, 10)
        return found

    monkeypatch.setattr(module, "first_meeting", slow)
    bench.own.offer(PASSES)
    bench.other.offer(THEIRS)
    assert "follows an approved plan" in bench.verdict().reason


def test_an_arm_whose_plan_is_held_while_it_is_beside_its_path_or_silent_lets_nothing_start(bench):
    bench.own.offer(OURS)
    away = plan(AWAY, AWAY - np.radians([20, 0, 0, 0, 0, 0]), "away")
    bench.other.offer(away)
    bench.other.follow(ExecutorState.HELD, away, 10)
    assert not bench.verdict().conflict
    for bench.pose, why in ((AWAY + 0.02, "0.020 beside the path of plan away"), (None, "/b/twin/joint_states")):
        assert why in bench.verdict().reason


def test_while_the_other_arm_is_not_known_nothing_starts(bench):
    bench.own.offer(OURS)
    bench.pose = None
    assert "/b/twin/joint_states" in bench.verdict().reason
    bench.pose = AWAY
    bench.other.follow(ExecutorState.PLAYING, THEIRS, 10)
    assert "theirs" in bench.verdict().reason, "a plan that was never received"
    bench.other.follow(ExecutorState.IDLE)
    assert not bench.verdict().conflict
    bench.other.publish("scene", Scene(hash="wrong"))
    assert bench.other.refused and bench.verdict().conflict
    assert bench.node.diagnose().level == WARN


def test_before_the_first_word_of_an_executor_nothing_starts(bench, monkeypatch):
    bench.own.offer(OURS)
    silent = ArmListener(ROBOT, "/", lambda *_: None)
    silent.scene = SceneValue((), 0.0)
    stands = OtherArm(silent, (), Neighbour("b", ROBOT, BESIDE))
    with pytest.raises(module.NeighbourUnknownError, match="executor"):
        stands.occupied()


PLATE = SceneObject("plate", "box", (16.0, 16.0, 0.1), (0.0, 0.0, 0.1), link="tool0", touch=("link_6",))


def gripping(made: Plan) -> Plan:
    """Return a plan as a work plan of one segment, at whose end the plate is gripped."""
    segments = (Segment("grip", made.trajectory.duration, False, (), (), "0" * 64, "1" * 64),)
    content = content_hash(made.trajectory, "t", segments)
    return dataclasses.replace(made, id=f"{made.id} gripping", hash=content, task="t", segments=segments)


def test_what_either_arm_carries_later_on_its_way_counts_from_the_start(bench):
    turn = plan(CLEAR, CLEAR + np.radians([-60, 0, 0, 0, 0, 0]), "turn")
    bench.own.offer(turn)
    bench.other.offer(THEIRS)
    bench.other.follow(ExecutorState.PLAYING, THEIRS, 10)
    assert not bench.verdict().conflict
    bench.own.offer(gripping(turn), SceneChange((PLATE,)))
    assert "plate" in bench.verdict().reason
    bench.own.offer(turn)
    assert not bench.verdict().conflict
    bench.other.offer(gripping(THEIRS), SceneChange((PLATE,)))
    bench.other.follow(ExecutorState.PLAYING, gripping(THEIRS), 10)
    assert "b/plate" in bench.verdict().reason


def test_a_plan_is_compared_once_with_the_same_space(bench, monkeypatch):
    compared = []
    made = module.first_meeting
    monkeypatch.setattr(module, "first_meeting", lambda *given: compared.append(1) or made(*given))
    bench.own.offer(PASSES)
    bench.other.offer(THEIRS)
    for since in (0, 10):
        bench.other.follow(ExecutorState.PLAYING, THEIRS, since)
        assert bench.verdict().conflict and bench.verdict().conflict
    assert len(compared) == 1


def test_a_load_that_cannot_be_used_lets_nothing_start(bench):
    foreign = SceneObject("pole", "box", (0.1, 0.1, 4.0), (0.0, 0.0, 2.0), link="no_such_link")
    bench.own.offer(OURS)
    for arm in (bench.other, bench.own):
        arm.publish("scene", scene_to_msg(SceneValue((foreign,), 0.0), to_time(0), "base_link"))
        assert "no_such_link" in bench.verdict().reason
        arm.publish("scene", scene_to_msg(SceneValue((), 0.0), to_time(0), "base_link"))
        assert not bench.verdict().conflict


def test_an_unexpected_exception_ends_the_process(bench, monkeypatch):
    """`run` is the main thread's work: see `run_node`."""
    monkeypatch.setattr(module, "first_meeting", lambda *_: 1 / 0)
    monkeypatch.setattr(module.rospy, "Rate", lambda _: None)
    bench.own.offer(OURS)
    with pytest.raises(ZeroDivisionError):
        bench.node.run()
