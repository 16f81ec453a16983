"""stop, stop_plan, pause and reject are carried out and answered whatever fails beside them, and whatever the wall clock does.

Each act on the executor's node, with everything that reports or records failing in turn; halt is in test_bridge_halt, the
gateway's own stop in test_gateway_stop_beside, the way over MQTT in test_acts.
"""

from __future__ import annotations

import numpy as np
import pytest
import rospy
from construction_twin.srv import StopPlanRequest
from executor_bench import make_plan
from executor_world import World, records

from construction_twin.core.errors import RecordError
from construction_twin.core.side_effects import SideEffects
from construction_twin.execution import machine as library
from construction_twin.execution.executor import ExecutorState
from construction_twin.execution.upkeep import ExecutionReporter
from construction_twin.review.record import ReviewLog
from construction_twin.ros.nodes import executor as module
from construction_twin.ros.shared.diagnostics import WARN, DeferredLog

ACTS = ("stop", "stop_plan", "pause", "reject")


class Unforeseen(Exception):
    """What no handler names."""


def fail(*_given, **_named):
    raise Unforeseen("nobody foresaw this")


def full_disk(*_given):
    raise RecordError("/full/reviews.jsonl", "no space left on device")


@pytest.fixture
def world(monkeypatch, tmp_path):
    return World(monkeypatch, tmp_path)


def act(world: World, which: str):
    """Have an act carried out while a plan is played, or for a rejection while one waits; return the answer."""
    if which == "stop":
        return world.ask("stop")
    if which == "pause":
        return world.ask("pause")
    if which == "stop_plan":
        request = StopPlanRequest(plan_id="p")
        request._connection_header = {"callerid": "/client"}
        return world.ask("stop_plan", request)
    plan = world.executor.under_review.plan
    return world.review(plan, False, reason="too close to the wall")


def prepared(world: World, which: str) -> World:
    """Play a plan; for a rejection another one waits for review."""
    world.playing()
    if which == "reject":
        world.executor.offer(make_plan("q", asked_ns=world.booted))
    return world


def is_carried_out(world: World, which: str) -> None:
    """Check that the act has had its effect, to its end."""
    executor = world.executor
    if which == "reject":
        assert executor.under_review.plan is None and executor.state is ExecutorState.PLAYING
        return
    assert executor.state in (ExecutorState.STOPPING, ExecutorState.PAUSING)
    begin = len(setpoints(world))
    world.run(150)
    poses = setpoints(world)
    # every cycle had its setpoint, and the last ones rest
    assert len(poses) == begin + 150
    np.testing.assert_array_equal(poses[-1], poses[-20])
    assert executor.state is (ExecutorState.PAUSED if which == "pause" else ExecutorState.IDLE)
    assert (executor.outcome == "stopped") is (which != "pause")


def setpoints(world: World) -> list[tuple[float, ...]]:
    return [message[1] for name, message in world.said if name == "next/joint_states"]


#: What reports or records: where it is, and the acts that come by it.
HELPERS = {
    "how far it went": (library, "distance_along", ("stop", "stop_plan")),
    "the name of the caller": (module, "caller_of", ("stop_plan",)),
    "the verdict on a waiting plan": (library.ExecutorMachine, "record_withdrawal", ("stop",)),
    "the record's queue": (ReviewLog, "defer", ("stop", "stop_plan", "reject")),
    "the record": (ReviewLog, "flush", ACTS),
    "the log's queue": (DeferredLog, "add", ACTS),
    "the log": (rospy, "logwarn", ("stop", "stop_plan")),
    "the log of a pause": (rospy, "loginfo", ("pause",)),
    "the topic's message": (module.msg, "Execution", ("stop", "stop_plan", "pause")),
    "the verdict's message": (module.msg, "Review", ("reject",)),
}


@pytest.mark.parametrize("which, helper", [(each, name) for name, (*_, acts) in HELPERS.items() for each in acts])
def test_with_a_helper_that_fails_as_nobody_foresaw(world, monkeypatch, which, helper):
    prepared(world, which)
    place, name, _ = HELPERS[helper]
    with monkeypatch.context() as broken:
        broken.setattr(place, name, fail)
        assert act(world, which).success
        is_carried_out(world, which)
        world.run(1)
        world.node.do_background_work()
    # counted, said, and shown
    assert sum(world.node.side_effects.counts().values()) > 0
    world.node.do_background_work()
    assert any("Unforeseen" in line and "Traceback" in line for _, line in world.logged) or place is rospy
    report = world.node.diagnose()
    assert report.level == WARN and "nobody foresaw this" in report.sentence
    assert any(key.startswith("failed beside an act") for key in report.values)


@pytest.mark.parametrize("topic", ["execution", "review"])
@pytest.mark.parametrize("which", ACTS)
def test_with_a_topic_that_cannot_be_published(world, monkeypatch, which, topic):
    prepared(world, which)

    def publish(name, message):
        if name == topic:
            fail()
        world.said.append((name, message))

    world.publish = publish
    assert act(world, which).success
    is_carried_out(world, which)
    world.run(1)


@pytest.mark.parametrize("which", ACTS)
def test_with_a_full_disk_the_record_comes_later(world, monkeypatch, tmp_path, which):
    prepared(world, which)
    with monkeypatch.context() as full:
        full.setattr(ReviewLog, "flush", full_disk)
        full.setattr(ReviewLog, "append", full_disk)
        assert act(world, which).success
        is_carried_out(world, which)
        world.run(1).node.do_background_work()
        assert "no space left on device" in world.node.diagnose().sentence
    world.node.do_background_work()
    written = [line.get("outcome", line.get("verdict")) for line in records(tmp_path)]
    assert (
        written
        == {
            "stop": ["approved", "stopped"],
            "stop_plan": ["approved", "stopped"],
            "pause": ["approved"],
            "reject": ["approved", "rejected"],
        }[which]
    )


def test_a_rejection_is_on_record_and_told(world, tmp_path):
    prepared(world, "reject")
    assert act(world, "reject").message == "plan q rejected by Ada"
    world.run(1).node.do_background_work()
    assert [(line["verdict"], line["plan"], line["reason"]) for line in records(tmp_path)[1:]] == [
        ("rejected", "q", "too close to the wall")
    ]
    told = [message[0] for name, message in world.said if name == "review"]
    assert [(each.plan_id, each.approved, each.reviewer) for each in told[1:]] == [("q", False, "Ada")]


def test_a_rejection_that_was_answered_is_on_record_once_although_the_node_ends_before_its_next_cycle(world, tmp_path):
    prepared(world, "reject")
    assert act(world, "reject").success
    # as rospy does at its shutdown
    world.node.write_records()
    assert [line["verdict"] for line in records(tmp_path)] == ["approved", "rejected"]
    world.run(2).node.write_records()
    assert [line["verdict"] for line in records(tmp_path)] == ["approved", "rejected"]


def test_what_fails_when_nobody_has_asked_for_anything_still_ends_the_node(world, monkeypatch):
    world.playing()
    monkeypatch.setattr(ExecutionReporter, "_report_key", fail)
    with pytest.raises(Unforeseen):
        world.run(1)


@pytest.mark.parametrize("which", ["stop", "stop_plan", "pause"])
def test_and_of_what_goes_on_failing_not_before_the_arm_is_at_rest(world, monkeypatch, which):
    prepared(world, which)
    monkeypatch.setattr(ExecutionReporter, "_report_key", fail)
    assert act(world, which).success
    begin = len(setpoints(world))
    with pytest.raises(Unforeseen):
        world.run(150)
    assert world.executor.state is (ExecutorState.PAUSED if which == "pause" else ExecutorState.IDLE)
    assert len(setpoints(world)) > begin + 3
    assert world.node.side_effects.counts() == {"the executor's state": len(setpoints(world)) - begin - 1}


def test_a_log_that_fails_while_it_is_told_of_is_counted_and_not_told_of_again():
    side_effects = SideEffects()
    assert side_effects.run("the record", fail) is None and side_effects.run("the sum", sum, (1, 2)) == 3
    for _ in range(3):
        side_effects.write(fail)
    assert side_effects.counts() == {"the record": 1, "the log": 1}
    assert side_effects.sentence.startswith("the log failed beside an act") and "(2 so far)" in side_effects.sentence


class Mute(Exception):
    """An exception whose own text cannot be made."""

    def __str__(self):
        raise ValueError


def test_an_exception_without_a_text_is_told_all_the_same():
    side_effects, told = SideEffects(), []

    def mute():
        raise Mute

    side_effects.run("the record", mute)
    side_effects.write(lambda form, text: told.append(form % text))
    assert "the record failed beside an act that was carried out in mute" in told[0] and "Mute" in told[0]
