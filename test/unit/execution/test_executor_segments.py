"""A work plan: played segment by segment; what a boundary waits for, and what drops the rest."""

from __future__ import annotations

import numpy as np
import pytest
from executor_bench import (
    GRIPPED,
    LATER,
    ROBOT,
    SCENE,
    Bench,
    between,
    make_plan,
    make_work_plan,
    plan_of,
    reach,
    within_acceleration,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.errors import ExecutionError, ReviewError
from construction_twin.core.freshness import LIFETIME
from construction_twin.core.reports import ToolReport
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.execution.executor import ExecutorState
from construction_twin.execution.segment_run import (
    FIRE_TIMEOUT,
    LEAD,
    NO_ARM,
    RECORD_TIMEOUT,
    SCENE_TIMEOUT,
    SegmentRun,
    ToolOrder,
)
from construction_twin.execution.states import ACTIVE
from construction_twin.monitor.settings import RESUME
from construction_twin.monitor.states import SyncState
from construction_twin.review.plan_under_review import Verdict
from construction_twin.robot.segments import Segment, Switch


@pytest.fixture
def bench() -> Bench:
    return Bench().ready().with_tool()


def at_end(bench: Bench, plan, segment: int) -> np.ndarray:
    """Return the pose at the end of a segment."""
    return plan.trajectory.sample(plan.segments[segment].end)[0]


class TestPlayedThrough:
    def test_every_segment_in_order_and_each_switch_once(self, bench):
        plan = make_work_plan()
        bench.approve(plan)
        bench.run_until_idle()
        assert bench.executor.outcome == "finished" and bench.tool.fired == [("vacuum", True), ("vacuum", False)]
        np.testing.assert_allclose(bench.twin, plan.trajectory.positions[-1], atol=1e-12)
        assert within_acceleration(bench.outputs)

    def test_at_full_speed_a_segment_is_the_trajectory_on_the_grid(self, bench):
        plan = make_work_plan()
        bench.approve(plan)
        bench.run_into(1, 0)
        begin = plan.segments[0].end
        expected = plan.trajectory.sample_many(begin + CYCLE * np.arange(1, 31))[0]
        np.testing.assert_allclose(bench.run(30), expected, atol=1e-12)

    @pytest.mark.parametrize("fraction", [0.3, 0.77])
    def test_under_a_speed_limit_it_rests_exactly_at_each_end(self, bench, fraction):
        plan = make_work_plan()
        bench.executor.limit.set_fraction(fraction)
        bench.approve(plan)
        for number in range(4):
            bench.run_to_end_of(number)
            np.testing.assert_allclose(bench.outputs[-1], at_end(bench, plan, number), atol=1e-12)
        bench.run_until_idle()
        assert bench.executor.outcome == "finished" and within_acceleration(bench.outputs)

    def test_an_end_beside_the_grid_of_cycles_is_not_passed(self, bench):
        motion = between(0.0, 0.1, 0.2, 0.3, 0.4, duration=0.8337)
        plan = make_work_plan(motion=motion)
        bench.tool.answers = False
        bench.approve(plan)
        bench.run_to_end_of(1)
        bench.run(20)
        assert set(bench.outputs[-20:]) == {tuple(at_end(bench, plan, 1))}

    def test_a_plan_after_it_is_no_work_plan(self, bench):
        bench.approve(make_work_plan())
        bench.run_until_idle()
        bench.run(5)
        bench.executor.on_scene(SCENE)
        work = bench.executor.segment_run
        bench.approve(make_plan("next", bench_motion(bench)))
        assert work is not None and bench.executor.segment_run is None
        bench.run_until_idle()
        assert bench.executor.outcome == "finished"


def bench_motion(bench: Bench):
    return reach(bench.twin, ROBOT.home)


class TestApproval:
    def refused(self, bench: Bench, plan) -> str:
        with pytest.raises(ReviewError) as refusal:
            bench.approve(plan)
        assert bench.state is ExecutorState.IDLE
        return str(refusal.value)

    def test_without_an_arm_there_is_no_tool(self, bench):
        bench.executor.on_tool(ToolReport(reason=NO_ARM), 0)
        assert "there is no physical arm (`arm:=none`)" in self.refused(bench, make_work_plan())

    def test_a_tool_whose_outputs_were_not_read_back_is_unknown(self, bench):
        bench.tool.known = False
        bench.tell()
        assert "the tool's state is not known: no session" in self.refused(bench, make_work_plan())

    def test_before_the_first_report(self):
        assert "no report of the tool yet" in self.refused(Bench().ready(), make_work_plan())

    @pytest.mark.parametrize(
        "report, missing",
        [
            (ToolReport(True, ""), "names no tool"),
            (ToolReport(True, "frame", {}, {"gripped": False}), "no output 'vacuum'"),
            (ToolReport(True, "frame", {"vacuum": False}, {}), "no input 'gripped'"),
        ],
    )
    def test_a_tool_that_lacks_something(self, bench, report, missing):
        bench.executor.on_tool(report, 0)
        assert missing in self.refused(bench, make_work_plan())

    def test_the_first_segment_must_have_what_it_requires(self, bench):
        plan = make_work_plan(segment_0={"requires": GRIPPED})
        assert "gripped reads off, not on" in self.refused(bench, plan)

    def test_the_scene_must_be_that_of_the_first_segment(self, bench):
        bench.executor.on_scene(LATER[0])
        assert "was made for scene 5ce0e" in self.refused(bench, make_work_plan())

    def test_a_plan_without_switches_needs_no_tool(self):
        bench = Bench().ready()
        motion = between(0.0, 0.3, 0.5)
        ends = [0.8, motion.duration]
        bench.approve(plan_of(motion, tuple(Segment(str(end), end, False, (), (), SCENE, SCENE) for end in ends), "w"))
        bench.run_until_idle()
        assert bench.executor.outcome == "finished"

    @pytest.mark.parametrize("end", [0.25, 0.3])
    def test_a_segment_that_does_not_end_at_rest_is_refused(self, bench, end):
        plan = make_work_plan(segment_0={"end": end})
        assert "does not rest at the end of segment 'to stock'" in self.refused(bench, plan)


#: What drops the rest at the end of the segment that grips: cycles after it arrived, what happens then, and the reason.
DROPS = {
    "not confirmed": (
        0, lambda bench: setattr(bench.tool, "works", False),
        "the switch of vacuum to on has fired, but was not confirmed within 1 s: gripped reads off",
    ),
    "refused": (
        0, lambda bench: setattr(bench.tool, "refuses", "no such output"),
        "the gateway has refused the switch of vacuum to on: no such output",
    ),
    "forgotten": (
        3, lambda bench: bench.tool.void("the playout has braked"),
        "has forgotten the switch of vacuum to on: the playout has braked",
    ),
    "silence": (0, lambda bench: setattr(bench.tool, "answers", False), "was not reported as fired within 3 s"),
    "tool unknown": (0, lambda bench: setattr(bench.tool, "known", False), "the tool's state is not known: no session"),
    "no scene": (0, lambda bench: None, f"the scene did not become {LATER[0]} within 30 s"),
    "another scene": (0, lambda bench: bench.executor.on_scene("0ther"), "which was not planned at the end of"),
    "grip lost": (100, lambda bench: setattr(bench.tool, "inputs", {"gripped": False}), "gripped reads off, not on"),
}  # fmt: skip
#: Of those that wait, how long [ns].
WAITS = {"silence": FIRE_TIMEOUT, "no scene": SCENE_TIMEOUT}


class TestBoundary:
    @pytest.mark.parametrize("name", DROPS)
    def test_what_drops_the_rest_voids_the_switch_and_leaves_the_arm_engaged(self, bench, name):
        cycles, happens, reason = DROPS[name]
        bench.edits = False
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(cycles)
        happens(bench)
        waited = len(bench.run_until_idle())
        assert bench.executor.outcome == "stopped" and reason in bench.executor.reason
        assert "the arm is engaged" in bench.executor.reason and bench.executor.engagement.engaged
        assert waited > WAITS.get(name, 0) / CYCLE_NS - 5
        assert name != "silence" or bench.tool.orders[-1] == ToolOrder("", "w")
        assert bench.tool.fired == [("vacuum", True)] * (name in ("not confirmed", "silence", "no scene", "grip lost"))

    def test_a_switch_is_armed_for_a_setpoint_ahead_on_the_grid(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.step()
        (order,) = bench.tool.orders
        assert order.stamp - bench.stamp == LEAD and LEAD % CYCLE_NS == 0
        assert (order.id, order.plan_id, order.switch.value) == ("w/1/0/1", "w", True)

    def test_nothing_moves_until_the_grip_is_confirmed(self, bench):
        plan = make_work_plan()
        bench.tool.works = False
        bench.approve(plan)
        bench.run_to_end_of(1)
        bench.run(150)
        assert bench.tool.fired == [("vacuum", True)] and bench.state is ExecutorState.AT_BOUNDARY
        assert set(bench.outputs[-150:]) == {tuple(at_end(bench, plan, 1))}
        assert bench.executor.reason == "stands at the end of segment 2 ('approach'), waits for the tool"

    def test_the_scene_is_waited_for_after_the_confirmation_only(self, bench):
        bench.edits = False
        plan = make_work_plan()
        bench.approve(plan)
        bench.run_to_end_of(1)
        work = bench.executor.segment_run
        assert not work.wants_scene and work.expected_scene == ""
        bench.run(100)
        assert work.wants_scene and work.expected_scene == LATER[0] and bench.tool.inputs["gripped"]
        assert set(bench.outputs[-80:]) == {tuple(at_end(bench, plan, 1))}
        bench.executor.on_scene(LATER[0])
        bench.run_into(2)
        assert not work.wants_scene

    def test_the_next_segment_needs_what_it_requires(self, bench):
        plan = make_work_plan(
            segment_1={"switches": (), "scene_after": SCENE},
            segment_2={"scene": SCENE, "scene_after": SCENE},
            segment_3={"scene": SCENE},
        )
        bench.approve(plan)
        bench.run_until_idle()
        assert "segment 'lift' cannot begin: gripped reads off, not on" in bench.executor.reason

    @pytest.mark.parametrize(
        "stands, goes_on",
        [
            (
                lambda executor: executor.limit.set_fraction(0.0, "somebody is near"),
                lambda executor: executor.limit.set_fraction(1.0),
            ),
            (lambda executor: executor.limit.on_lag(2.0), lambda executor: executor.limit.on_lag(0.1)),
        ],
        ids=["speed limit of 0", "arm that trails"],
    )
    def test_no_switch_is_armed_while_the_arm_is_kept_still_or_waited_for(self, bench, stands, goes_on):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        stands(bench.executor)
        bench.run(1500)
        assert bench.tool.orders == [] and bench.state is ExecutorState.AT_BOUNDARY
        goes_on(bench.executor)
        bench.run_into(2)
        assert bench.tool.fired == [("vacuum", True)]

    def test_one_that_is_armed_already_is_void_then_and_armed_anew_after_it(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(3)
        bench.executor.limit.set_fraction(0.0, "somebody is near")
        bench.run(1500)
        assert bench.tool.fired == [] and bench.state is ExecutorState.AT_BOUNDARY
        bench.executor.limit.set_fraction(1.0)
        bench.run_into(2)
        assert [order.id for order in bench.tool.orders] == ["w/1/0/1", "", "w/1/0/2"]
        assert bench.tool.fired == [("vacuum", True)]

    def test_a_tool_that_is_not_known_yet_is_waited_for(self, bench):
        bench.run(1)
        plan = make_work_plan()
        bench.executor.offer(plan)
        known = bench.executor.tool
        assert known.known and bench.approval.is_ready()
        bench.executor.on_tool(ToolReport(), bench.stamp)
        assert not bench.approval.is_ready()
        bench.executor.on_tool(known, bench.stamp)
        assert bench.approval.is_ready()
        # without an arm it will never be known: then it is refused, not waited for
        bench.executor.on_tool(ToolReport(reason=NO_ARM), bench.stamp)
        assert bench.approval.is_ready()

    def test_a_confirmation_that_reads_so_before_the_switch_confirms_nothing(self, bench):
        bench.approve(make_work_plan(segment_1={"requires": ()}))
        bench.run_into(1)
        bench.tool.inputs = {"gripped": True}
        bench.run_until_idle()
        assert "reads so already" in bench.executor.reason
        assert bench.tool.fired == [] and bench.executor.outcome == "stopped"

    def test_several_switches_fire_together(self, bench):
        two = (Switch("vacuum", True, GRIPPED, 1.0), Switch("blow", False, (), 1.0))
        bench.tool.outputs = {"vacuum": False, "blow": False}
        bench.run(1)
        bench.approve(make_work_plan(segment_1={"switches": two}))
        bench.run_to_end_of(1)
        bench.step()
        assert [order.id for order in bench.tool.orders] == ["w/1/0/1", "w/1/1/1"]
        assert len({order.stamp for order in bench.tool.orders}) == 1
        bench.run_into(2)
        assert bench.tool.fired == [("vacuum", True), ("blow", False)]

    def test_after_a_pause_only_unfired_switches_are_armed_again(self, bench):
        two = (Switch("vacuum", True, GRIPPED, 1.0), Switch("blow", False, (), 1.0))
        bench.tool.outputs, bench.tool.jams = ("vacuum", "blow"), "blow"
        bench.run(1)
        bench.approve(make_work_plan(segment_1={"switches": two}))
        bench.run_to_end_of(1)
        bench.run(60)
        assert bench.tool.fired == [("vacuum", True)] and bench.state is ExecutorState.AT_BOUNDARY
        bench.executor.pause(bench.stamp)
        bench.tool.jams = ""
        bench.run(20)
        bench.executor.resume()
        bench.run_into(2)
        assert [order.id for order in bench.tool.orders] == ["w/1/0/1", "w/1/1/1", "", "w/1/1/2"]
        assert bench.tool.fired == [("vacuum", True), ("blow", False)]

    def test_an_id_is_short_enough_for_the_gateway(self, bench):
        long = "4f1d1d0e-8f43-4d2e-9f57-6f0b6d1b5a11"
        bench.approve(make_work_plan(long))
        bench.run_to_end_of(1)
        bench.step()
        assert len(bench.tool.orders[0].id) + len("1234") <= 64

    @pytest.mark.parametrize("policy", ["replan", RESUME])
    def test_a_hold_of_the_gate_drops_the_rest_and_voids(self, bench, policy):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(3)
        bench.executor.on_sync(SyncState.HOLDING, False, policy, bench.stamp)
        bench.step()
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "held")
        bench.executor.on_sync(SyncState.IN_SYNC, True, policy)
        bench.run(400)
        assert bench.tool.fired == [] and bench.tool.orders[-1].id == ""

    def test_a_disk_that_takes_nothing_keeps_it_out_of_an_engaged_segment(self, bench):
        bench.writes = False
        plan = make_work_plan()
        bench.approve(plan)
        outputs = bench.run_until_idle()
        assert len(outputs) > RECORD_TIMEOUT / CYCLE_NS and "the disk did not take" in bench.executor.reason
        np.testing.assert_allclose(bench.twin, at_end(bench, plan, 0), atol=1e-12)
        assert not bench.executor.engagement.engaged


class TestInASegment:
    @pytest.mark.parametrize("segment, state", [(3, ExecutorState.STOPPING), (0, ExecutorState.PLAYING)])
    def test_an_unknown_tool_stops_a_segment_that_needs_it_and_no_other(self, bench, segment, state):
        bench.approve(make_work_plan())
        bench.run_into(segment)
        bench.tool.known = False
        bench.run(2)
        assert bench.state is state

    def test_a_lost_grip_brakes_along_the_path_and_drops_the_rest(self, bench):
        plan = make_work_plan()
        bench.approve(plan)
        bench.run_into(3)
        bench.tool.inputs = {"gripped": False}
        bench.run(2)
        assert bench.state is ExecutorState.STOPPING
        bench.run_until_idle()
        reason = bench.executor.reason
        assert bench.executor.outcome == "stopped" and reason.startswith("gripped reads off, not on; at rest after")
        assert "in segment 4 ('carry') the rest is dropped" in reason and "look at arm and tool" in reason
        assert within_acceleration(bench.outputs)

    @pytest.mark.parametrize("scene", ["0ther", LATER[0]])
    def test_any_other_scene_stops_it_that_of_the_end_too(self, bench, scene):
        bench.approve(make_work_plan())
        bench.run_into(1)
        bench.executor.on_scene(scene)
        assert bench.state is ExecutorState.STOPPING and "which was not planned in segment 2" in bench.executor.reason

    @pytest.mark.parametrize("policy", ["replan", RESUME])
    def test_a_hold_of_the_gate_drops_the_rest_whatever_the_policy(self, bench, policy):
        bench.approve(make_work_plan())
        bench.run_into(3)
        bench.executor.on_sync(SyncState.HOLDING, False, policy, bench.stamp)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "held")

    def test_a_stop_that_runs_into_the_end_of_a_segment_fires_nothing(self, bench):
        bench.approve(make_work_plan())
        bench.run_into(1)
        while bench.executor.plan.segments[1].end - elapsed(bench) > 3 * CYCLE:
            bench.step()
        bench.executor.stop(bench.stamp)
        bench.run_until_idle()
        bench.run(200)
        assert bench.executor.outcome == "stopped" and bench.tool.orders == []


def elapsed(bench: Bench) -> float:
    """Return where on the trajectory it is, from the last setpoint [s]: its path is straight, so one joint tells."""
    trajectory = bench.executor.plan.trajectory
    times = np.arange(0.0, trajectory.duration, CYCLE / 4)
    points = trajectory.sample_many(times)[0]
    begin = (
        bench.executor.plan.segments[bench.executor.segment_run.number - 1].end
        if bench.executor.segment_run.number > 0
        else 0.0
    )
    return float(times[np.argmin(np.abs(points - bench.outputs[-1]).max(axis=1) + 10.0 * (times < begin))])


class TestPause:
    def test_in_a_segment_it_goes_on_to_the_same_end(self, bench):
        plan = make_work_plan()
        bench.approve(plan)
        bench.run_into(1)
        bench.executor.pause(bench.stamp)
        bench.run_until(ExecutorState.PAUSED)
        bench.run(50)
        bench.executor.resume()
        bench.run_to_end_of(1)
        np.testing.assert_allclose(bench.outputs[-1], at_end(bench, plan, 1), atol=1e-12)
        assert within_acceleration(bench.outputs)

    def test_that_runs_into_the_end_of_a_segment_rests_there_and_arms_nothing(self, bench):
        bench.approve(make_work_plan())
        bench.run_into(1)
        while bench.executor.plan.segments[1].end - elapsed(bench) > 5 * CYCLE:
            bench.step()
        bench.executor.pause(bench.stamp)
        bench.run_until(ExecutorState.PAUSED)
        bench.run(300)
        assert bench.tool.orders == []
        bench.executor.resume()
        assert bench.state in (ExecutorState.AT_BOUNDARY, ExecutorState.PLAYING)
        bench.run_into(2)
        assert bench.tool.fired == [("vacuum", True)]

    def test_an_armed_switch_is_void_and_armed_anew_once(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(3)
        answer = bench.executor.pause(bench.stamp)
        assert answer == "plan w rests at the end of segment 2 ('approach'); resume goes on"
        bench.run(200)
        assert bench.state is ExecutorState.PAUSED and bench.tool.fired == []
        assert [order.id for order in bench.tool.orders] == ["w/1/0/1", ""]
        bench.executor.resume()
        bench.run_into(2)
        assert [order.id for order in bench.tool.orders] == ["w/1/0/1", "", "w/1/0/2"]
        assert bench.tool.fired == [("vacuum", True)]

    def test_one_that_has_fired_never_fires_again(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.tool.works = False
        while not bench.tool.fired:
            bench.step()
        bench.executor.pause(bench.stamp)
        bench.tool.works = True
        bench.tool.inputs = {"gripped": True}
        bench.run(300)
        bench.executor.resume()
        bench.run_into(2)
        assert bench.tool.fired == [("vacuum", True)]

    def test_without_word_from_the_gateway_it_is_not_armed_again(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(3)
        bench.executor.pause(bench.stamp)
        bench.tool.answers = False
        bench.run(10)
        bench.executor.resume()
        bench.run_until_idle()
        assert "was not reported as fired within 3 s" in bench.executor.reason
        assert [order.id for order in bench.tool.orders] == ["w/1/0/1", ""]

    def test_a_grip_lost_meanwhile_drops_the_rest(self, bench):
        bench.approve(make_work_plan())
        bench.run_into(3)
        bench.executor.pause(bench.stamp)
        bench.run_until(ExecutorState.PAUSED)
        bench.tool.inputs = {"gripped": False}
        bench.run(2)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "stopped")

    def test_while_it_waits_for_the_scene(self, bench):
        bench.edits = False
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(100)
        bench.executor.pause(bench.stamp)
        bench.executor.on_scene(LATER[0])
        bench.run(50)
        assert bench.state is ExecutorState.PAUSED
        bench.executor.resume()
        bench.run_into(2)


def test_a_stop_at_a_boundary_voids_what_is_armed(bench):
    bench.approve(make_work_plan())
    bench.run_to_end_of(1)
    bench.run(3)
    bench.executor.stop(bench.stamp)
    bench.run(300)
    assert bench.executor.outcome == "stopped" and bench.tool.fired == []
    assert [order.id for order in bench.tool.orders] == ["w/1/0/1", ""]


@pytest.mark.parametrize("at_boundary", [True, False])
def test_a_stop_is_carried_out_although_where_it_stands_cannot_be_told(bench, monkeypatch, at_boundary):
    def fail(_run):
        raise RuntimeError("nobody foresaw this")

    bench.approve(make_work_plan())
    if at_boundary:
        bench.run_to_end_of(1)
        bench.run(3)
    else:
        bench.run_into(1)
    monkeypatch.setattr(SegmentRun, "where", property(fail))
    bench.executor.stop(bench.stamp)
    bench.run(300)
    assert bench.executor.outcome == "stopped" and bench.state is ExecutorState.IDLE and bench.tool.fired == []
    assert ([order.id for order in bench.tool.orders] == ["w/1/0/1", ""]) is at_boundary
    assert bench.executor.side_effects.counts()["where a work plan ends"] == 1


class TestBeforeTheFirstSegment:
    """An approval starts motion within its lifetime, or it starts none."""

    @pytest.mark.parametrize("disk", [0.0, 2.0])
    def test_what_is_waited_for_too_long_ends_the_plan_and_says_so(self, bench, disk):
        def record(record):
            bench.records.append(record)
            bench.clock += round(disk * NANOSECONDS)

        bench.record = record
        bench.approve(make_work_plan())
        bench.executor.under_review.scene_alive = False
        waited = bench.run_until_idle()
        assert set(waited) == {ROBOT.home} and bench.executor.outcome == "stopped"
        assert "not begun, waits for the scene 5ce0e: an approval is void after 3 s" in bench.executor.reason
        assert len(waited) == pytest.approx((LIFETIME / NANOSECONDS - disk) / CYCLE, abs=3)

    def test_a_resume_there_counts_anew(self, bench):
        bench.approve(make_work_plan())
        bench.executor.pause(bench.stamp)
        bench.run(round(60.0 / CYCLE))
        assert bench.state is ExecutorState.PAUSED
        bench.executor.resume()
        bench.run_into(0)
        assert bench.executor.outcome == ""

    def test_later_boundaries_wait_for_a_scene_of_a_node_that_is_there_as_long_as_before(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(0)
        bench.executor.under_review.scene_alive = False
        bench.run(round(10.0 / CYCLE))
        assert bench.state is ExecutorState.AT_BOUNDARY
        bench.executor.under_review.scene_alive = True
        bench.run_into(1)


EVENTS = {
    "step": lambda bench: bench.run(7),
    "pause": lambda bench: call(lambda: bench.executor.pause(bench.stamp)),
    "resume": lambda bench: call(bench.executor.resume),
    "stop": lambda bench: bench.executor.stop(bench.stamp),
    "hold": lambda bench: bench.executor.on_sync(SyncState.HOLDING, False, RESUME, bench.stamp),
    "agree": lambda bench: bench.executor.on_sync(SyncState.IN_SYNC, True, RESUME),
    "disarm": lambda bench: bench.executor.on_link(False, "by the test"),
    "scene": lambda bench: bench.executor.on_scene("0ther"),
    "void": lambda bench: bench.tool.void("braked"),
    "silent": lambda bench: setattr(bench.tool, "answers", False),
    "speaks": lambda bench: setattr(bench.tool, "answers", True),
    "lost": lambda bench: setattr(bench.tool, "inputs", {"gripped": False}),
    "broken": lambda bench: setattr(bench.tool, "works", False),
    "unknown": lambda bench: setattr(bench.tool, "known", False),
    "slow": lambda bench: bench.executor.limit.set_fraction(0.3),
    "still": lambda bench: bench.executor.limit.set_fraction(0.0),
    "fast": lambda bench: bench.executor.limit.set_fraction(1.0),
}
#: Most of what happens is that time passes.
HAPPENINGS = st.lists(st.tuples(st.integers(0, 260), st.sampled_from(sorted(EVENTS))), min_size=1, max_size=12)


def call(action) -> None:
    try:
        action()
    except ExecutionError:
        pass


@settings(max_examples=40, deadline=None)
@given(HAPPENINGS)
def test_whatever_happens_no_switch_fires_twice_and_no_boundary_is_passed_early(happenings):
    bench = Bench().ready().with_tool()
    plan = make_work_plan()
    bench.approve(plan)
    executor, passed = bench.executor, -1
    ends = [segment.end for segment in plan.segments]
    poses = plan.trajectory.sample_many(np.array([0.0, *ends]))[0]
    for cycles, name in [*happenings, (2500, "step")]:
        for _ in range(cycles):
            if executor.state not in ACTIVE:
                break
            before = np.array(bench.outputs[-1])
            setpoint = np.array(bench.step())
            # in joint space every segment is a straight line: between the two ends, and not beyond the second
            number = executor.segment_run.number
            low, high = np.sort(poses[[number, number + 1]] if number >= 0 else poses[[0, 0]], axis=0)
            assert (setpoint >= low - 1e-9).all() and (setpoint <= high + 1e-9).all()
            assert np.abs(setpoint - before).max() < 0.02
            if number > passed:
                passed = number
                if executor.state is not ExecutorState.PLAYING:
                    # it was lost right after it began
                    continue
                # entered only with the tool and the scene that it needs
                segment = plan.segments[number]
                assert not executor.tool.mismatch(segment.requires) and executor.under_review.scene == segment.scene
        EVENTS[name](bench)
    counted = [value for _, value in bench.tool.fired]
    assert counted in ([], [True], [True, False])
    # a slow plan may be under way still, and goes on below
    under_way = executor.state in ACTIVE
    if not under_way:
        inside = executor.outcome != "finished" and executor.segment_run.number in (1, 2)
        # at the very beginning of the engaged segments the arm is free
        if inside and np.abs(np.array(bench.outputs[-1]) - poses[1]).max() > 1e-6:
            assert executor.engagement.engaged
        if executor.outcome == "finished":
            assert counted == [True, False] and not executor.engagement.engaged
    bench.run(400)
    fired = [value for _, value in bench.tool.fired]
    assert fired[: len(counted)] == counted and (fired == counted or under_way) and fired in ([], [True], [True, False])


def test_a_dropped_work_plan_withdraws_what_was_waiting_when_the_arm_is_engaged(bench):
    bench.approve(make_work_plan())
    bench.run_into(2)
    bench.executor.offer(make_plan("waiting", scene=LATER[0]))
    bench.executor.on_sync(SyncState.HOLDING, False)
    (verdict,) = [event for event in bench.executor.pop_events() if isinstance(event, Verdict)]
    assert verdict.plan_id == "waiting" and "plan_way_back" in verdict.reason
