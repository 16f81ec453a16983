"""The executor's node without ROS around it: what its cycle waits for, and by which clock others fall silent."""

from __future__ import annotations

import json
import threading
from types import SimpleNamespace

import numpy as np
import pydantic
import pytest
import rospy
from construction_twin.msg import Conflict, Link, Scene, SpeedLimit, Sync
from construction_twin.srv import ReviewPlanRequest, StopPlanRequest
from executor_bench import ROBOT, SCENE, make_plan

from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.execution.conflict_verdicts import ConflictVerdicts
from construction_twin.execution.executor import Executor, ExecutorState
from construction_twin.execution.speed_limit import SpeedLimit as SpeedLimitState
from construction_twin.review.record import ReviewLog
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.ros.nodes import executor as module
from construction_twin.ros.shared.deferred_log import KEPT, DeferredLog
from construction_twin.ros.transport.joint_stream import to_time


class World:
    """What the node finds around itself: clocks, topics, services, its log."""

    def __init__(self, monkeypatch, tmp_path):
        self.wall, self.steady = 1000 * NANOSECONDS, 50 * NANOSECONDS
        self.said: list[tuple[str, object]] = []
        self.logged: list[tuple[str, str]] = []
        self.refused: list[tuple[str, str]] = []
        self.cycles = 0
        patch = monkeypatch.setattr
        patch(module, "now_ns", lambda: self.wall)
        patch(module.time, "monotonic_ns", lambda: self.steady)
        patch(module, "Cycles", self.grid)
        patch(rospy, "get_time", lambda: self.wall / NANOSECONDS)
        patch(rospy.Time, "now", lambda: to_time(self.wall))
        for level in ("loginfo", "logwarn", "logerr"):
            patch(rospy, level, self.logger(level))
        self.executor, self.limit = Executor(ROBOT), SpeedLimitState(0.5, 0.1, False)
        self.executor.on_link(False, "no report of the link yet")
        self.node = module.ExecutorNode(
            ROBOT,
            self.executor,
            self.limit,
            ReviewLog(tmp_path / "reviews.jsonl", lambda: self.wall),
            module.Outputs(self.topic("next/joint_states"), self.topic("execution"), self.topic("review")),
            lambda _: SimpleNamespace(refuse=lambda *said: self.refused.append(said)),
        )

    def logger(self, level: str):
        """Return a log function that says which thread called it."""
        return lambda *words: self.logged.append((threading.current_thread().name, words[0] % words[1:]))

    def topic(self, name: str):
        """Return a publisher."""
        return SimpleNamespace(publish=lambda *message: self.said.append((name, message)))

    def grid(self):
        """Let both clocks run; the twin follows at once and the monitor is content."""
        for _ in range(self.cycles):
            self.wall, self.steady = self.wall + CYCLE_NS, self.steady + CYCLE_NS
            if self.speaks:
                self.node.on_sync(Sync(state=Sync.IN_SYNC, agreed=True, policy="replan"))
            yield self.wall, 0
            setpoints = [message for name, message in self.said if name == "next/joint_states"]
            self.node.on_twin(*(setpoints[-1] if setpoints else (self.wall, ROBOT.home)))

    def run(self, cycles: int, speaks: bool = True) -> World:
        """Run some cycles, while the monitor speaks or not."""
        self.cycles, self.speaks = cycles, speaks
        self.node.run()
        return self

    def playing(self) -> World:
        """Play a plan."""
        node = self.node
        node.on_link(Link(state=Link.ARMED, session="s"))
        node.on_scene(Scene(hash=SCENE))
        self.run(5)
        plan = make_plan(created_ns=self.wall)
        self.executor.offer(plan)
        assert node.on_review(ReviewPlanRequest(plan.id, plan.hash, True, "Ada", "")).success
        return self.run(50)

    def states(self) -> list[str]:
        """Return what was published on `execution`."""
        return [message[0].text for name, message in self.said if name == "execution"]


@pytest.fixture
def world(monkeypatch, tmp_path):
    return World(monkeypatch, tmp_path)


def limit(fraction: float) -> SpeedLimit:
    message = SpeedLimit(limit=fraction, reason="somebody is near")
    message._connection_header = {"callerid": "/sensor"}
    return message


@pytest.mark.parametrize("age, refused", [(0.2, 0), (0.6, 1), (-0.5, 1)])
def test_a_verdict_on_the_other_arm_counts_by_its_stamp(world, monkeypatch, age, refused):
    watch, taken = ConflictVerdicts("b"), []
    on_verdict = watch.on_verdict
    monkeypatch.setattr(watch, "on_verdict", lambda *given: taken.append(given[3]) or on_verdict(*given))
    world.executor.neighbour = watch
    message = Conflict(plan_id="p1", conflict=False, reason="its path is free")
    message.header.stamp = to_time(world.wall) - rospy.Duration(age)
    world.node.on_conflict(message)
    assert [reason for reason, _ in world.refused] == ["conflict_age"] * refused
    np.testing.assert_allclose(taken[0] / 1e9, age, atol=1e-8)


def records(tmp_path) -> list[dict]:
    return [json.loads(line) for line in (tmp_path / "reviews.jsonl").read_text().splitlines()]


def test_who_has_armed_a_bare_plc_is_recorded_once_and_with_the_verdict(world, tmp_path):
    bare = {"gateway_kind": "plc", "responsible": "Grace", "not_checked": ["age: not known"]}
    for _ in range(3):
        world.node.on_link(Link(state=Link.RESYNC, session="s", **bare))
    node = world.node
    node.on_link(Link(state=Link.ARMED, session="s", **bare))
    node.on_scene(Scene(hash=SCENE))
    world.run(5)
    plan = make_plan(created_ns=world.wall)
    world.executor.offer(plan)
    assert node.on_review(ReviewPlanRequest(plan.id, plan.hash, True, "Ada", "")).success
    armed, verdict = records(tmp_path)[:2]
    assert (armed["record"], armed["responsible"], armed["not_checked"]) == (
        "responsibility", "Grace", ["age: not known"],
    )  # fmt: skip
    assert (verdict["reviewer"], verdict["responsible"], verdict["not_checked"]) == ("Ada", "Grace", ["age: not known"])
    # armed anew, in another session, is another record; not armed is none
    node.on_link(Link(state=Link.NEEDS_RESET, session="s", gateway_kind="plc", not_checked=bare["not_checked"]))
    node.on_link(Link(state=Link.ARMED, session="t", **bare))
    node.work_off(True)
    assert [line["session"] for line in records(tmp_path) if line["record"] == "responsibility"] == ["s", "t"]


class TestCycle:
    def test_writes_no_log_the_background_does(self, world):
        world.playing()
        world.node.on_stop(None)
        world.run(100)
        assert world.logged == []
        world.node.work_off(True)
        lines = [line for _, line in world.logged]
        assert "PLAYING: approved by Ada" in lines and any(line.startswith("stop: braking plan p") for line in lines)
        assert lines.index("PLAYING: approved by Ada") < lines.index("STOPPING: stop requested")

    def test_says_what_it_does_before_what_became_of_plans(self, world):
        world.playing()
        world.executor.offer(make_plan("q", created_ns=world.wall))
        world.said.clear()
        world.executor.stop(world.wall)
        world.run(1)
        assert [name for name, _ in world.said if name != "next/joint_states"] == ["execution", "review"]

    def test_a_limit_that_follows_a_sensor_fills_no_log(self, world):
        world.playing()
        world.node.work_off(True)
        world.logged.clear()
        for k in range(20):
            world.node.on_limit(limit(0.5 + 0.01 * k))
            world.run(2)
        world.node.work_off(True)
        assert [line for _, line in world.logged] == ["speed limit 0.5 by /sensor: somebody is near"]
        assert world.executor.reason.startswith("approved by Ada; at 69% of the planned speed: speed limit 0.69")


def stop_plan(world, plan_id: str):
    request = StopPlanRequest(plan_id=plan_id)
    request._connection_header = {"callerid": "/client"}
    return world.node.on_stop_plan(request)


def test_a_stop_of_one_plan_names_who_asked_for_it_and_no_other_is_stopped(world):
    world.playing()
    answer = stop_plan(world, "another")
    assert not answer.success and answer.message == "plan 'another' is not played: the executor plays plan p"
    assert world.run(1).executor.state is ExecutorState.PLAYING
    answer = stop_plan(world, "p")
    assert answer.success and answer.message == "braking plan p"
    assert world.run(1).executor.reason == "stop requested by /client"
    # a plan that somebody asked for before is not void
    world.executor.offer(make_plan("q", created_ns=world.wall - NANOSECONDS // 100))
    assert world.executor.queue.plan.id == "q"


class TestClocks:
    def test_a_wall_clock_set_back_does_not_let_a_silent_source_of_the_limit_speak(self, world):
        world.playing()
        world.node.on_limit(limit(0.9))
        world.run(10)
        world.wall -= 10 * NANOSECONDS
        world.run(130)
        assert world.limit.limit == 0.1 and "silent" in world.limit.reason

    def test_nor_a_monitor_that_is_silent(self, world):
        world.playing()
        world.wall -= 10 * NANOSECONDS
        world.run(130, speaks=False)
        assert world.executor.outcome == "held"

    @pytest.mark.parametrize("step", [-10.0, 10.0])
    def test_a_wall_clock_that_is_set_ends_no_plan(self, world, step):
        world.playing()
        world.wall += round(step * NANOSECONDS)
        world.run(30)
        assert world.states()[-1] == "PLAYING"


class TestPlansThatAreTurnedDown:
    """Whoever shows a plan as waiting must hear that nobody can approve it."""

    def offered(self, world, plan) -> list[tuple[str, bool, str]]:
        message = plan_to_msg(plan, "base_link", np.zeros((len(plan.trajectory.times), 3)))
        world.said.clear()
        world.node.on_plan(message)
        world.run(1)
        return [(m[0].plan_id, m[0].approved, m[0].reason) for name, m in world.said if name == "review"]

    def test_one_that_was_asked_for_before_a_stop(self, world):
        asked = world.playing().wall - CYCLE_NS
        world.node.on_stop(None)
        world.run(100)
        ((plan_id, approved, reason),) = self.offered(world, make_plan("late", created_ns=asked))
        assert (plan_id, approved) == ("late", False) and "before the last stop" in reason

    def test_one_from_before_this_executor(self, world):
        ((plan_id, _, reason),) = self.offered(world, make_plan("old", created_ns=world.wall - NANOSECONDS))
        assert plan_id == "old" and "older than this executor" in reason

    def test_one_that_comes_twice_is_not(self, world):
        plan = make_plan("p2", created_ns=world.run(5).wall)
        assert self.offered(world, plan) == self.offered(world, plan) == []


@pytest.mark.parametrize("reviewer", ["executor", "auto_approve", " executor "])
def test_nobody_reviews_under_the_names_that_the_executor_writes(world, reviewer):
    world.playing()
    plan = make_plan("q", created_ns=world.wall)
    world.executor.offer(plan)
    answer = world.node.on_review(ReviewPlanRequest(plan.id, plan.hash, False, reviewer, ""))
    assert not answer.success and "the name of a person" in answer.message
    assert world.node.on_review(ReviewPlanRequest(plan.id, plan.hash, False, "Ada", "")).success


def test_a_full_log_forgets_the_oldest_lines():
    log, lines = DeferredLog(), []
    for k in range(KEPT + 5):
        log.add(lines.append, k)
    log.flush()
    assert lines[0] == 5 and log.flush() is None


def test_a_verdict_is_published_with_its_reason(world):
    world.run(5).executor.offer(make_plan("p", created_ns=world.wall))
    world.executor.offer(make_plan("q", created_ns=world.wall))
    world.run(1)
    (verdict,) = [message[0] for name, message in world.said if name == "review"]
    assert (verdict.plan_id, verdict.approved, verdict.reviewer) == ("p", False, "executor")
    assert verdict.reason == "replaced by plan q"


def test_an_approval_without_a_reason_is_no_warning(world, monkeypatch):
    warned, told = [], []
    monkeypatch.setattr(rospy, "logwarn", lambda *words: warned.append(words[0] % words[1:]))
    monkeypatch.setattr(rospy, "loginfo", lambda *words: told.append(words[0] % words[1:]))
    world.playing()
    assert world.node.on_pause(None).success
    world.node.write_records()
    assert warned == []
    assert [line for line in told if line.endswith(" approved by Ada")] and [
        line for line in told if line.startswith("pause: ")
    ]


def test_no_client_is_trusted_with_a_real_arm():
    given = {
        "review_file": "r.jsonl",
        "speed_limit_deadline": 0.5,
        "speed_limit_silent": 0.1,
        "speed_limit_required": False,
    }
    trusted = given | {"auto_approve_sources": ["/move_group"]}
    assert module.Settings(arm="mock", **trusted).auto_approve_sources == ("/move_group",)
    with pytest.raises(pydantic.ValidationError, match="the name of a client proves nothing, a person has to approve"):
        module.Settings(arm="real", **trusted)
    assert module.Settings(arm="real", **given).auto_approve_sources == ()
