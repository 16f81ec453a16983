"""The executor's node without ROS around it: what its cycle waits for, and by which clock others fall silent."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import pydantic
import pytest
import rospy
from construction_twin.msg import (
    Execution,
    Link,
    Scene,
    SessionRequest,
    SpeedChange,
    SpeedLimitInForce,
    ToolCommand,
    ToolState,
)
from construction_twin.srv import ActAsSeenRequest, ReleaseEngagementRequest, StopPlanRequest
from executor_bench import ROBOT, SCENE, Gripper, make_plan, make_work_plan, motion_back, plan_back, reach
from executor_world import GIVEN, World, records

from construction_twin.core.freshness import Moment
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.execution.executor import ExecutorState
from construction_twin.execution.segment_run import ToolOrder
from construction_twin.robot.segments import Switch
from construction_twin.ros.nodes import executor as module
from construction_twin.ros.shared.diagnostics import ERROR, MAX_LINES, DeferredLog


@pytest.fixture
def world(monkeypatch, tmp_path):
    return World(monkeypatch, tmp_path)


def limit(fraction: float) -> SpeedLimitInForce:
    message = SpeedLimitInForce(limit=fraction, reason=f"speed limit {fraction:g} by /sensor: somebody is near")
    message._connection_header = {"callerid": "/kr120/pca_monitor"}
    return message


def test_who_has_armed_a_bare_plc_is_recorded_once_and_with_the_verdict(world, tmp_path):
    bare = {"gateway_kind": "plc", "responsible": "Grace", "not_checked": ["age: not known"]}
    for _ in range(3):
        world.node.on_link(Link(state=Link.RESYNC, session="s", **bare))
    node = world.node
    node.on_link(Link(state=Link.ARMED, session="s", **bare))
    node.on_scene(Scene(hash=SCENE))
    world.run(5)
    plan = make_plan(asked_ns=world.booted)
    world.executor.offer(plan)
    assert world.review(plan).success
    armed, verdict = records(tmp_path)[:2]
    assert (armed["record"], armed["responsible"], armed["not_checked"]) == (
        "responsibility",
        "Grace",
        ["age: not known"],
    )
    assert (verdict["reviewer"], verdict["responsible"], verdict["not_checked"]) == ("Ada", "Grace", ["age: not known"])
    # armed anew, in another session, is another record; not armed is none
    node.on_link(Link(state=Link.NEEDS_RESET, session="s", gateway_kind="plc", not_checked=bare["not_checked"]))
    node.on_link(Link(state=Link.ARMED, session="t", **bare))
    node.do_background_work()
    assert [line["session"] for line in records(tmp_path) if line["record"] == "responsibility"] == ["s", "t"]


def test_who_has_asked_for_a_session_or_set_the_speed_limit_is_recorded(world, tmp_path):
    world.receive("session_request", SessionRequest(verb="reset", person="ada", lifts="stop 3"))
    world.receive("speed_change", SpeedChange(person="dora", limit=0.6, before=0.3, whose="bob"))
    world.node.do_background_work()
    session, speed = records(tmp_path)
    assert (session["record"], session["verb"], session["person"], session["lifts"]) == (
        "session",
        "reset",
        "ada",
        "stop 3",
    )
    assert (speed["record"], speed["person"], speed["limit"], speed["before"], speed["whose"]) == (
        "speed",
        "dora",
        0.6,
        0.3,
        "bob",
    )


def test_why_the_plan_under_review_could_not_be_approved_is_told_as_soon_as_it_is_so(world):
    world.waiting()
    world.node.do_background_work()
    world.run(1)

    def told() -> str:
        return [message.approval_obstacle for name, (message, *_) in world.said if name == "execution"][-1]

    assert told() == ""
    world.node.on_link(Link(state=Link.RESYNC, text="RESYNC", session="s", reason="the arm moves"))
    world.node.do_background_work()
    world.run(1)
    assert told() == "the arm is not armed (RESYNC: the arm moves); approve when it is"


class TestCycle:
    def test_writes_no_log_the_background_does(self, world):
        world.playing()
        world.ask("stop")
        world.run(100)
        assert world.logged == []
        world.node.do_background_work()
        lines = [line for _, line in world.logged]
        assert "PLAYING: approved by Ada" in lines and any(line.startswith("stop: braking plan p") for line in lines)
        assert lines.index("PLAYING: approved by Ada") < lines.index("STOPPING: stop requested")

    def test_says_what_it_does_before_what_became_of_plans(self, world):
        world.playing()
        world.executor.offer(make_plan("q", asked_ns=world.booted))
        world.said.clear()
        world.executor.stop(world.wall)
        world.run(1)
        assert [name for name, _ in world.said if name != "next/joint_states"] == ["execution", "review"]

    def test_a_limit_that_follows_a_sensor_fills_no_log(self, world):
        world.playing()
        world.node.do_background_work()
        world.logged.clear()
        for k in range(20):
            world.node.on_limit(limit(0.5 + 0.01 * k))
            world.run(2)
        world.node.do_background_work()
        assert [line for _, line in world.logged] == ["speed limit 0.5 by /sensor: somebody is near"]
        assert world.executor.reason.startswith("approved by Ada; at 69% of the planned speed: speed limit 0.69")


def stop_plan(world, plan_id: str):
    request = StopPlanRequest(plan_id=plan_id)
    request._connection_header = {"callerid": "/client"}
    return world.ask("stop_plan", request)


def test_a_stop_of_one_plan_names_who_asked_for_it_and_no_other_is_stopped(world):
    world.playing()
    answer = stop_plan(world, "another")
    assert not answer.success and answer.message == "plan 'another' is not played: the executor plays plan p"
    assert world.run(1).executor.state is ExecutorState.PLAYING
    answer = stop_plan(world, "p")
    assert answer.success and answer.message == "braking plan p"
    assert world.run(1).executor.reason == "stop requested by /client"
    # a plan that somebody asked for before is not void
    world.executor.offer(make_plan("q", asked_ns=world.booted - NANOSECONDS // 100))
    assert world.executor.under_review.plan.id == "q"


class TestClocks:
    def test_a_wall_clock_set_back_does_not_let_a_silent_source_of_the_limit_speak(self, world):
        world.playing()
        world.node.on_limit(limit(0.9))
        world.run(10)
        world.wall -= 10 * NANOSECONDS
        world.run(130)
        assert world.executor.limit.fraction == 0.1 and "silent" in world.executor.limit.reason

    def test_nor_a_monitor_that_is_silent(self, world):
        world.playing()
        world.wall -= 10 * NANOSECONDS
        world.run(130, speaks=False)
        assert world.executor.outcome == "held"


class TestPlansThatAreTurnedDown:
    """Whoever shows a plan as waiting must hear that nobody can approve it."""

    def offered(self, world, plan) -> list[tuple[str, bool, str]]:
        world.said.clear()
        world.offer(plan)
        world.run(1)
        return [(m[0].plan_id, m[0].approved, m[0].reason) for name, m in world.said if name == "review"]

    @pytest.mark.parametrize("step", [-0.05, -1.0, -10.0, -29.0, -60.0, -600.0, 10.0])
    @pytest.mark.parametrize("stop", ["stop", "pause"])
    def test_one_that_was_asked_for_before_a_stop_on_a_clock_that_was_set_since(self, world, step, stop):
        asked = world.playing().booted - CYCLE_NS
        world.node.do_background_work()
        world.wall += round(step * NANOSECONDS)
        world.run(10)
        world.ask(stop)
        world.run(150)
        # a stop voids, a pause also
        said = self.offered(world, make_plan("late", asked_ns=asked))
        assert [(plan_id, approved) for plan_id, approved, _ in said if plan_id == "late"] == [("late", False)]

    @pytest.mark.parametrize("stop", ["stop", "pause"])
    def test_none_that_was_asked_for_after_a_stop_on_a_clock_that_was_ahead(self, world, stop):
        world.playing()
        world.wall += 3600 * NANOSECONDS
        world.run(5)
        world.ask(stop)
        world.wall -= 3600 * NANOSECONDS
        world.run(150)
        assert self.offered(world, make_plan("new", asked_ns=world.booted)) == []
        assert world.executor.under_review.plan.id == "new"

    def test_one_of_another_computer(self, world):
        plan = replace(make_plan("elsewhere"), asked=Moment("deadbeef", world.booted))
        ((plan_id, _, reason),) = self.offered(world, plan)
        assert plan_id == "elsewhere" and "on another computer" in reason

    def test_one_from_before_this_executor(self, world):
        ((plan_id, _, reason),) = self.offered(world, make_plan("old", asked_ns=world.booted - NANOSECONDS))
        assert plan_id == "old" and "older than this executor" in reason

    def test_one_that_comes_twice_is_not(self, world):
        plan = make_plan("p2", asked_ns=world.run(5).booted)
        assert self.offered(world, plan) == self.offered(world, plan) == []


@pytest.mark.parametrize("approve", [True, False])
def test_a_verdict_on_another_content_than_the_plan_s_is_refused(world, approve):
    plan = world.waiting()
    seen = SimpleNamespace(id=plan.id, hash="0" * 64)
    for answer in (world.review(seen, approve), world.from_screen(seen, world.shown(), approve)):
        assert not answer.success and plan.hash in answer.message
    assert world.executor.under_review.plan is plan


@pytest.mark.parametrize("reviewer", ["executor", "auto_approve", " executor "])
def test_nobody_reviews_under_the_names_that_the_executor_writes(world, reviewer):
    world.playing()
    plan = make_plan("q", asked_ns=world.booted)
    world.executor.offer(plan)
    answer = world.review(plan, False, reviewer)
    assert not answer.success and "the name of a person" in answer.message
    assert world.review(plan, False).success


def test_every_request_of_a_person_that_is_turned_down_is_counted_beside_its_answer(world):
    _node, plan = world.node, world.waiting()
    assert world.review(plan, False).success
    answers = [
        world.review(plan),
        world.ask("pause"),
        world.ask("resume"),
        world.resume_from_screen(world.shown()),
        world.ask("stop_plan", StopPlanRequest("of another one")),
        world.ask("release_engagement", ReleaseEngagementRequest("Ada", "by hand")),
    ]
    assert not any(answer.success for answer in answers)
    assert world.refused == [
        (name, answer.message)
        for name, answer in zip(("review", "pause", "resume", "resume", "stop_plan", "release_engagement"), answers)
    ]


class TestAge:
    """What a person at a screen starts is void 3 s after what the screen had shown, and the person is told."""

    @pytest.mark.parametrize("age", [3.1, 6.0, 120.0, -1.0])
    def test_a_verdict_that_lay_on_its_way_or_is_of_no_view_is_refused_counted_and_recorded(self, world, tmp_path, age):
        plan = world.waiting()
        answer = world.from_screen(plan, world.shown(age))
        assert not answer.success and answer.expired and "look again" in answer.message
        assert [reason for reason, _ in world.refused] == ["too_old"]
        world.run(50)
        assert world.executor.plan is None and world.executor.under_review.plan is plan
        (refused,) = records(tmp_path)
        assert (refused["verdict"], refused["reviewer"]) == ("refused", "kr120-reviewer-ada")

    @pytest.mark.parametrize("wall", [120.0, 0.0, -10.0, -120.0, 10_000.0])
    @pytest.mark.parametrize("by_screen", [True, False])
    def test_a_disk_that_hung_starts_nothing_whatever_the_wall_clock_did(self, world, tmp_path, by_screen, wall):
        plan = world.waiting()
        world.slow_disk(120.0, wall)
        if by_screen:
            answer = world.from_screen(plan, world.shown())
            assert answer.expired
        else:
            answer = world.review(plan)
        assert not answer.success and "too old: it is of 120.0 s ago" in answer.message
        world.run(50)
        assert world.executor.plan is None and world.executor.under_review.plan is plan
        approved, ended = records(tmp_path)
        assert approved["verdict"] == "approved" and ended["outcome"] == "dropped" and "not started" in ended["reason"]

    @pytest.mark.parametrize("moment", ["c0ffee00", "1795369597.396", "deadbeef-7000000"])
    def test_without_a_moment_of_this_robot_nothing_is_approved(self, world, moment):
        answer = world.from_screen(world.waiting(), moment)
        assert not answer.success and len(world.refused) == 1 and world.executor.under_review.plan is not None

    @pytest.mark.parametrize("moment", ["", "of an old screen", "c0ffee00-1"])
    def test_a_rejection_is_never_too_old(self, world, moment):
        assert world.from_screen(world.waiting(), moment, approve=False).success

    def test_a_resume_counts_as_an_approval_does(self, world):
        world.playing()
        world.ask("pause")
        while world.executor.state is not ExecutorState.PAUSED:
            world.run(5)
        for age, expired in ((3.1, True), (6.0, True), (-1.0, True)):
            answer = world.resume_from_screen(world.shown(age))
            assert not answer.success and answer.expired is expired and "look again" in answer.message
        answers = [
            world.resume_from_screen(""),
            world.ask("~act_as_seen", ActAsSeenRequest("reset", "ada", world.shown())),
        ]
        assert [(answer.success, answer.expired) for answer in answers] == [(False, False)] * 2
        assert [reason for reason, _ in world.refused] == ["too_old"] * 3 + ["moment", "act"]
        assert world.run(50).executor.state is ExecutorState.PAUSED
        assert world.resume_from_screen(world.shown(0.1)).success
        assert world.run(5).executor.state is ExecutorState.PLAYING
        again = world.resume_from_screen(world.shown(0.1))
        assert not again.success and not again.expired and "nothing to resume" in again.message

    @pytest.mark.parametrize("act, state", [("stop", ExecutorState.STOPPING), ("pause", ExecutorState.PAUSING)])
    def test_a_stop_and_a_pause_are_never_too_old_and_can_be_said_in_another_language(self, world, act, state):
        world.playing()
        answer = world.ask("~act_as_seen", ActAsSeenRequest(act, "ada", ""))
        assert answer.success and answer.message in json.loads(answer.said)
        assert world.executor.state is state

    @pytest.mark.parametrize("before", ["PLAYING", "PAUSING", "PAUSED"])
    def test_a_resume_that_is_older_than_a_pause_does_not_undo_it(self, world, before):
        world.playing()
        if before != "PLAYING":
            assert world.ask("pause").success
            world.run(1 if before == "PAUSING" else 100)
        assert world.executor.state is ExecutorState[before]
        # one person presses resume, and it hangs in the network; another one presses pause, and is answered
        pressed = world.shown()
        world.booted += NANOSECONDS // 2
        assert world.ask("pause").success
        world.run(100)
        answer = world.resume_from_screen(pressed)
        assert not answer.success and answer.expired and "paused or stopped since" in answer.message
        assert [reason for reason, _ in world.refused] == ["too_old"]
        assert world.run(50).executor.state is ExecutorState.PAUSED
        # who has seen the pause may undo it
        assert world.resume_from_screen(world.shown()).success
        assert world.run(5).executor.state is ExecutorState.PLAYING

    @pytest.mark.parametrize("age, begins", [(0.5, True), (2.5, False)])
    def test_what_a_resume_starts_has_begun_within_3_s_of_what_its_screen_had_shown(self, world, age, begins):
        plan, node = world.waiting(), world.node
        node.on_limit(limit(0.0))
        assert world.from_screen(plan, world.shown()).success
        world.run(5)
        assert world.ask("pause").success
        world.run(5)
        world.booted += 3 * NANOSECONDS
        assert world.resume_from_screen(world.shown(age)).success
        for _ in range(4):
            # 1 s, in which somebody stands before the sensor
            node.on_limit(limit(0.0))
            world.run(63)
        assert (world.executor.state is ExecutorState.PLAYING) is begins
        node.on_limit(limit(1.0))
        world.run(50)
        assert (world.executor.rate > 0.0) is begins

    def test_a_pause_whose_moment_cannot_be_read_is_carried_out_and_no_screen_undoes_it(self, world, monkeypatch):
        world.playing()
        with monkeypatch.context() as broken:
            broken.setattr(module, "present_moment", lambda: 1 // 0)
            assert world.ask("pause").success
            world.run(1)
        world.run(1)
        assert [message[0].text for name, message in world.said if name == "execution"][-1] == "PAUSING"
        world.run(100)
        assert not world.resume_from_screen(world.shown()).success
        assert world.executor.state is ExecutorState.PAUSED and world.ask("resume").success

    def test_a_stop_a_pause_and_the_resume_of_this_graph_need_no_moment(self, world):
        world.playing()
        assert world.ask("pause").success
        while world.executor.state is not ExecutorState.PAUSED:
            world.run(5)
        assert world.ask("resume").success and world.ask("stop").success


def test_a_full_log_forgets_the_oldest_lines():
    log, lines = DeferredLog(), []
    for k in range(MAX_LINES + 5):
        log.add(lines.append, k)
    log.flush()
    assert lines[0] == 5 and log.flush() is None


def test_a_verdict_is_published_with_its_reason(world):
    world.run(5).executor.offer(make_plan("p", asked_ns=world.booted))
    world.executor.offer(make_plan("q", asked_ns=world.booted))
    world.run(1)
    (verdict,) = [message[0] for name, message in world.said if name == "review"]
    assert (verdict.plan_id, verdict.approved, verdict.reviewer) == ("p", False, "executor")
    assert verdict.reason == "replaced by plan q"


def test_an_approval_without_a_reason_is_no_warning(world, monkeypatch):
    warned, told = [], []
    monkeypatch.setattr(rospy, "logwarn", lambda *words: warned.append(words[0] % words[1:]))
    monkeypatch.setattr(rospy, "loginfo", lambda *words: told.append(words[0] % words[1:]))
    world.playing()
    assert world.ask("pause").success
    world.node.write_records()
    assert warned == []
    assert [line for line in told if line.endswith(" approved by Ada")] and [
        line for line in told if line.startswith("pause: ")
    ]


def test_no_client_is_trusted_with_a_real_arm():
    given = GIVEN | {"review_file": "r.jsonl"}
    trusted = given | {"auto_approve_sources": ["/move_group"]}
    assert module.Settings(arm="mock", **trusted).auto_approve_sources == ("/move_group",)
    with pytest.raises(pydantic.ValidationError, match="the name of a client proves nothing, a person has to approve"):
        module.Settings(arm="real", **trusted)
    assert module.Settings(arm="real", **given).auto_approve_sources == ()


@pytest.mark.parametrize(
    "settings, links, missing",
    [
        ({}, [], "no report of the link yet"),
        ({"rehearsal": "require"}, [Link.ARMED], "plan p was not rehearsed yet, and it must be"),
        ({"rehearsal": "advise"}, [Link.ARMED], ""),
    ],
)
def test_at_the_start_the_arm_is_not_armed_and_a_rehearsal_is_required_as_was_set(world, settings, links, missing):
    world.log.close()
    world.open(**settings)
    for state in links:
        world.node.on_link(Link(state=state, session="s"))
    world.node.on_scene(Scene(hash=SCENE))
    world.run(5)
    plan = make_plan(asked_ns=world.booted)
    world.offer(plan)
    answer = world.review(plan)
    assert answer.success is not bool(missing) and missing in answer.message


def test_a_new_session_drops_what_is_played_and_what_waits(world):
    world.playing()
    world.executor.offer(make_plan("q", asked_ns=world.booted))
    world.node.on_link(Link(state=Link.ARMED, session="t"))
    assert world.executor.outcome == "dropped" and world.executor.under_review.plan is None
    assert world.executor.state is ExecutorState.WAITING
    # nor is one reviewed that was asked for before, and comes late
    world.offer(make_plan("late", asked_ns=world.booted - 1))
    assert world.executor.under_review.plan is None and "before the last stop, pause or reset" in world.refused[-1][1]


def tool_message(tool: Gripper) -> ToolState:
    """Return what the bridge says of a tool."""
    report = tool.report()
    return ToolState(
        known=report.known,
        tool=report.tool,
        outputs=list(report.outputs),
        output_values=[False] * len(report.outputs),
        inputs=list(report.inputs),
        input_values=list(report.inputs.values()),
        switch_ids=list(report.switches),
        switch_states=[switch.state.value for switch in report.switches.values()],
        switch_reasons=[switch.reason for switch in report.switches.values()],
        reason=report.reason,
    )


class WorkWorld(World):
    """A world with a tool and a node that changes the scene; the disk is served between the cycles, as by the timer."""

    def __init__(self, monkeypatch, tmp_path):
        super().__init__(monkeypatch, tmp_path)
        self.tool = Gripper()
        self.last: ToolState | None = None
        self.edits = True

    def grid(self):
        """Serve what a work plan asks for, between the cycles."""
        for stamp, stalled in super().grid():
            yield stamp, stalled
            commands = self.messages("tool_command")
            for command in commands[len(self.tool.orders) :]:
                self.tool.take(ordered(command))
            self.tool.cycle(stamp)
            message = tool_message(self.tool)
            if message != self.last:
                self.last = message
                self.node.on_tool(message)
            said = self.messages("execution")
            if self.edits and said and said[-1].wants_scene:
                self.node.on_scene(Scene(hash=said[-1].expected_scene))
            self.node.save_engagement()

    def messages(self, topic: str) -> list:
        """Return what was published on a topic."""
        return [message[0] for name, message in self.said if name == topic]

    def approved(self, plan=None) -> WorkWorld:
        """Approve a work plan."""
        self.node.on_link(Link(state=Link.ARMED, session="s"))
        self.node.on_scene(Scene(hash=SCENE))
        self.run(5)
        plan = plan or make_work_plan(asked_ns=self.booted)
        self.offer(plan)
        answer = self.review(plan)
        assert answer.success, answer.message
        return self

    def until(self, holds, most: int = 3000) -> WorkWorld:
        """Run until something holds."""
        for _ in range(most // 5):
            if holds():
                return self
            self.run(5)
        raise AssertionError(self.executor.reason)

    def left_in_lift(self) -> WorkWorld:
        """Stop in the engaged segment in which the element is lifted."""
        self.approved().until(lambda: self.executor.segment_run is not None and self.executor.segment_run.number == 2)
        self.run(60)
        self.ask("stop")
        return self.until(lambda: self.executor.state is ExecutorState.IDLE)

    def goes_back(self) -> None:
        """Approve the way back."""
        left = self.executor.engagement.present
        pose = [message[1] for name, message in self.said if name == "next/joint_states"][-1]
        motion = motion_back(left.path, left.path.nearest_point(pose).time)
        self.offer(plan_back(motion, left.requires(self.executor.tool), "5ce1e", asked_ns=self.booted + NANOSECONDS))
        assert self.review(self.executor.under_review.plan).success


def ordered(command: ToolCommand) -> ToolOrder:
    """Return what a command asks for."""
    if command.verb == ToolCommand.VOID:
        return ToolOrder("", command.plan_id)
    switch = Switch(command.output, command.value, (), 1.0)
    return ToolOrder(command.id, command.plan_id, switch, command.stamp.to_nsec())


@pytest.fixture
def work(monkeypatch, tmp_path):
    return WorkWorld(monkeypatch, tmp_path)


class TestWorkPlan:
    def test_is_played_to_its_end_and_says_where_it_is(self, work):
        work.approved().until(lambda: work.executor.outcome == "finished")
        said = work.messages("execution")
        seen = list(dict.fromkeys((message.segment, message.segment_name) for message in said if message.segment >= 0))
        assert seen == [(0, "to stock"), (1, "approach"), (2, "lift"), (3, "carry")]
        wanted = [message for message in said if message.wants_scene]
        assert {message.expected_scene for message in wanted} == {"5ce1e", "5ce2e"}
        assert all(message.at_boundary and message.state == Execution.AT_BOUNDARY for message in wanted)
        assert (said[-1].at_boundary, said[-1].segment, said[-1].engaged) == (False, 3, False)
        assert work.tool.fired == [("vacuum", True), ("vacuum", False)]

    def test_its_commands_carry_stamps_of_setpoints_to_come(self, work):
        work.approved().until(lambda: work.tool.fired)
        (command,) = work.messages("tool_command")
        assert (command.verb, command.id, command.output, command.value) == (ToolCommand.ARM, "w/1/0/1", "vacuum", True)
        stamps = [message[0] for name, message in work.said if name == "next/joint_states"]
        assert command.stamp.to_nsec() in stamps and command.header.stamp < command.stamp

    def test_the_verdict_names_task_and_segments(self, work, tmp_path):
        plan = make_work_plan(asked_ns=work.booted + NANOSECONDS)
        work.approved(plan)
        (verdict,) = [line for line in records(tmp_path) if line["record"] == "verdict"]
        assert (verdict["task"], verdict["segments"]) == ("t1", ["to stock", "approach", "lift", "carry"])
        assert verdict["trajectory"] == plan.hash != plan.trajectory.content_hash()

    def test_a_report_that_makes_no_sense_is_refused_and_counted(self, work):
        work.receive("tool", ToolState(known=True, inputs=["gripped"]))
        work.receive("tool", ToolState(known=True, switch_ids=["a"], switch_states=[9], switch_reasons=[""]))
        assert [reason for reason, _ in work.refused] == ["tool", "tool"] and not work.executor.tool.known

    def test_in_an_engaged_segment_the_disk_knows_it_and_outside_not(self, work, tmp_path):
        file = tmp_path / "reviews_engagement.json"
        work.approved().until(lambda: work.executor.segment_run is not None and work.executor.segment_run.number == 0)
        assert not file.exists()
        work.until(lambda: work.executor.segment_run.number == 1)
        assert json.loads(file.read_text())["segment"] == "approach"
        work.until(lambda: work.executor.segment_run.number == 3)
        assert not file.exists()


class TestEngaged:
    def test_the_planner_is_told_of_the_executed_path(self, work):
        work.left_in_lift().run(3)
        message = work.messages("engagement")[-1]
        assert message.engaged and (message.plan_id, message.task, message.segment) == ("w", "t1", "lift")
        assert [(signal.name, signal.value) for signal in message.requires] == [("gripped", True)]
        assert 0.8 < message.end < 1.6 and "stop requested" in message.reason
        assert work.messages("execution")[-1].engaged

    def test_no_other_plan_waits_for_review(self, work):
        work.left_in_lift()
        pose = [message[1] for name, message in work.said if name == "next/joint_states"][-1]
        plan = make_plan("other", reach(pose, ROBOT.home), "5ce1e", work.booted + NANOSECONDS)
        work.offer(plan)
        assert work.executor.under_review.plan is None and "is not the way back" in work.refused[-1][1]

    def test_the_way_back_leads_out_and_the_file_goes(self, work, tmp_path):
        work.left_in_lift().run(3)
        work.goes_back()
        work.until(lambda: work.executor.outcome == "finished").run(3)
        assert not (tmp_path / "reviews_engagement.json").exists() and not work.messages("engagement")[-1].engaged

    def test_survives_a_kill(self, work, monkeypatch, tmp_path):
        work.approved().until(lambda: work.executor.segment_run is not None and work.executor.segment_run.number == 2)
        work.node.write_records()
        # a killed process closes nothing by itself; the kernel does
        work.log.close()
        again = WorkWorld(monkeypatch, tmp_path)
        assert again.executor.engagement.engaged
        assert again.executor.engagement.present.reason == "the executor ended before the plan did"
        again.node.save_engagement()
        assert again.messages("engagement")[-1].engaged
        assert again.node.diagnose().sentence.startswith("the arm was left in engaged segment 'lift' of plan w")

    def test_is_released_in_a_person_s_name_and_recorded(self, work, tmp_path):
        work.left_in_lift()
        for person, reason in (("", "by hand"), ("Ada", " ")):
            answer = work.ask("release_engagement", ReleaseEngagementRequest(person=person, reason=reason))
            assert not answer.success and "needs the name of a person" in answer.message
        answer = work.ask("release_engagement", ReleaseEngagementRequest(person="Ada", reason="jogged free in T1"))
        assert answer.success and not work.executor.engagement.engaged
        work.run(3)
        (line,) = [line for line in records(tmp_path) if line["record"] == "release"]
        assert (line["person"], line["reason"], line["segment"], line["refused"]) == (
            "Ada",
            "jogged free in T1",
            "lift",
            "",
        )
        assert not (tmp_path / "reviews_engagement.json").exists() and not work.messages("engagement")[-1].engaged
        again = work.ask("release_engagement", ReleaseEngagementRequest(person="Ada", reason="again"))
        assert not again.success and "not engaged" in again.message

    def test_is_not_released_by_a_word_that_the_disk_kept_for_long(self, work, tmp_path):
        work.left_in_lift()
        work.slow_disk(120.0)
        answer = work.ask("release_engagement", ReleaseEngagementRequest(person="Ada", reason="jogged free in T1"))
        assert not answer.success and "too old" in answer.message and work.executor.engagement.engaged
        kept, corrected = (line for line in records(tmp_path) if line["record"] == "release")
        assert kept["refused"] == "" and "too old" in corrected["refused"]

    def test_is_not_released_while_the_arm_moves(self, work, tmp_path):
        work.left_in_lift().run(3)
        work.goes_back()
        work.run(20)
        answer = work.ask("release_engagement", ReleaseEngagementRequest(person="Ada", reason="by hand"))
        assert not answer.success and "release the arm when it is at rest" in answer.message
        assert [line for line in records(tmp_path) if line["record"] == "release"] == []

    def test_a_disk_that_fails_is_said_and_keeps_the_arm_out(self, work, tmp_path):
        (tmp_path / "reviews_engagement.json").mkdir()
        work.approved().until(
            lambda: work.executor.state is ExecutorState.AT_BOUNDARY and work.executor.segment_run.number == 0
        )
        work.run(100)
        assert work.executor.state is ExecutorState.AT_BOUNDARY and work.executor.segment_run.number == 0
        report = work.node.diagnose()
        assert report.level == ERROR and str(tmp_path / "reviews_engagement.json") in report.sentence
