"""What an approval covers: one execution of one path, from one pose, in one scene; and that each is recorded first."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from executor_bench import GOAL, ROBOT, SCENE, Bench, between, make_plan, make_work_plan, reach

from construction_twin.core.errors import ExpiredError, RecordError, ReviewError
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.execution.approval import AUTO_APPROVE, SCENE_DELAY, Approval, AutoApproval
from construction_twin.execution.executor import ExecutorState
from construction_twin.execution.playback import START_TOLERANCE
from construction_twin.monitor.states import SyncState
from construction_twin.robot.trajectory import Trajectory

#: Cycles in a second.
SECOND = NANOSECONDS // CYCLE_NS


@pytest.fixture
def bench() -> Bench:
    return Bench().ready()


class TestApproval:
    def test_nothing_moves_without_it(self, bench):
        bench.executor.offer(make_plan())
        assert set(bench.run(1000)) == {ROBOT.home} and bench.executor.plan is None

    def test_starts_the_plan_with_the_next_cycle_and_records_who_approved(self, bench):
        plan = make_plan()
        assert "2.000 s" in bench.approve(plan)
        assert bench.state is ExecutorState.PLAYING
        bench.step()
        assert bench.executor.plan_start == bench.stamp
        (verdict,) = bench.records
        assert (verdict.plan_id, verdict.plan_hash, verdict.verdict, verdict.reviewer) == (
            "p",
            plan.hash,
            "approved",
            "Ada",
        )
        assert verdict.plan is plan

    def test_covers_one_execution(self, bench):
        plan = make_plan(motion=reach(goal=ROBOT.home))
        bench.approve(plan)
        bench.run_until_idle()
        with pytest.raises(ReviewError, match="was decided already or withdrawn"):
            bench.approve(plan)
        assert bench.state is ExecutorState.IDLE

    def test_a_rejected_plan_is_not_played_and_cannot_be_approved(self, bench):
        plan = make_plan()
        bench.executor.offer(plan)
        bench.review("p", plan.hash, False, "Ada", "too close to the wall")
        assert [(v.verdict, v.reason) for v in bench.executor.pop_events()] == [("rejected", "too close to the wall")]
        with pytest.raises(ReviewError, match="was decided already or withdrawn"):
            bench.approve(plan)
        assert set(bench.run(10)) == {ROBOT.home}

    @pytest.mark.parametrize("joint", range(6))
    @pytest.mark.parametrize("fraction, accepted", [(0.99, True), (1.01, False), (-1.01, False)])
    def test_only_from_the_pose_it_was_planned_from(self, bench, joint, fraction, accepted):
        start = tuple(q + fraction * START_TOLERANCE * (i == joint) for i, q in enumerate(ROBOT.home))
        plan = make_plan(motion=reach(start=start))
        if accepted:
            bench.approve(plan)
            assert bench.state is ExecutorState.PLAYING
            return
        with pytest.raises(ReviewError, match=f"from the present pose at {ROBOT.joint_names[joint]}; plan again"):
            bench.approve(plan)
        assert bench.state is ExecutorState.IDLE and bench.executor.under_review.plan is plan

    @pytest.mark.parametrize("sync", [state for state in SyncState if state is not SyncState.IN_SYNC])
    def test_only_in_sync(self, bench, sync):
        bench.executor.on_sync(sync, True)
        bench.approval.update_obstacle()
        assert bench.approval.obstacle == "", "no plan waits"
        with pytest.raises(ReviewError, match=rf"twin and physical arm are not in sync \({sync.name}\)") as refused:
            bench.approve(make_plan())
        bench.approval.update_obstacle()
        assert bench.approval.obstacle == str(refused.value)
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        bench.approval.update_obstacle()
        assert bench.approval.obstacle == ""
        bench.review("p", "", True, "Ada")
        assert bench.state is ExecutorState.PLAYING

    def test_only_while_the_arm_is_armed(self, bench):
        bench.executor.on_link(False, "gateway is holding")
        with pytest.raises(ReviewError, match=r"the arm is not armed \(gateway is holding\)"):
            bench.approve(make_plan())
        bench.executor.on_link(True, "session 2")
        bench.review("p", "", True, "Ada")
        assert bench.state is ExecutorState.PLAYING

    def test_not_while_another_plan_is_played(self, bench):
        bench.approve(make_plan())
        bench.run(10)
        with pytest.raises(ReviewError, match=r"the executor is PLAYING \("):
            bench.approve(make_plan("q", reach(start=bench.twin)))
        assert bench.executor.plan.id == "p"

    def test_not_before_twin_and_arm_agree(self):
        with pytest.raises(ReviewError, match=r"the executor is WAITING \("):
            Bench().approve(make_plan())

    def test_a_refused_approval_is_recorded_with_the_reason(self, bench):
        plan = make_plan(motion=reach(start=GOAL, goal=ROBOT.home))
        for plan_id, reviewer in (("p", "Ada"), ("unknown", "Ada"), ("p", "")):
            bench.executor.offer(plan)
            with pytest.raises(ReviewError) as error:
                bench.review(plan_id, plan.hash, True, reviewer)
            record = bench.records.pop()
            assert (record.verdict, record.plan_id, record.reviewer) == ("refused", plan_id, reviewer)
            assert record.reason == str(error.value)
            assert record.plan is (plan if plan_id == "p" else None)

    def test_a_refused_rejection_leaves_no_record(self, bench):
        with pytest.raises(ReviewError, match="is not under review; no plan is"):
            bench.review("p", "", False, "Ada")
        assert bench.records == []

    def test_what_was_changed_after_its_hash_was_made_is_refused(self, bench):
        plan = make_plan()
        bench.executor.offer(plan)
        velocities = plan.trajectory.velocities.copy()
        velocities[0, 0] = 1e-12
        object.__setattr__(plan.trajectory, "velocities", velocities)
        with pytest.raises(ReviewError, match="is no longer what its hash"):
            bench.review("p", "", True, "Ada")
        assert set(bench.run(50)) == {ROBOT.home}

    def test_a_hash_is_proven_once_and_never_under_the_lock_of_the_cycle(self, bench, monkeypatch):
        held, proven = [], []
        lock = threading.RLock()

        class Lock:
            def __enter__(self):
                held.append(lock.acquire())

            def __exit__(self, *_):
                held.pop()
                lock.release()

        plan = make_plan()
        bench.executor.offer(plan)
        compute = Trajectory.content_hash
        monkeypatch.setattr(Trajectory, "content_hash", lambda self: (proven.append(len(held)), compute(self))[1])
        Approval(bench.executor, bench.records.append, Lock(), bench.present).review("p", plan.hash, True, "Ada")
        assert proven == [0] and bench.run(3)[-1] is not None and bench.state is ExecutorState.PLAYING


class TestRecordFirst:
    @staticmethod
    def refuse(_record):
        raise RecordError("/full/reviews.jsonl", "no space left on device")

    def test_an_approval_that_cannot_be_recorded_changes_nothing(self, bench):
        plan = make_plan()
        bench.executor.offer(plan)
        bench.record = self.refuse
        with pytest.raises(RecordError, match="nothing is approved without a record"):
            bench.review("p", plan.hash, True, "Ada")
        assert set(bench.run(100)) == {ROBOT.home}
        assert bench.executor.under_review.plan is plan and bench.executor.plan is None

    def test_no_disk_is_waited_for_under_the_lock_of_the_cycle(self, bench):
        held, written = [], []

        class Lock:
            def __enter__(self):
                held.append(1)

            def __exit__(self, *_):
                held.pop()

        def record(record):
            written.append((record.verdict, len(held)))

        approval = Approval(bench.executor, record, Lock(), bench.present)
        plans = {name: make_plan(name) for name in "pqr"}
        bench.executor.offer(plans["p"])
        with pytest.raises(ReviewError, match="has hash .*, not 0+; look at it again"):
            approval.review("p", "0" * 64, True, "Ada")
        approval.review("p", plans["p"].hash, False, "Ada")
        bench.executor.offer(plans["q"])
        approval.review("q", plans["q"].hash, True, "Ada")
        bench.run_until_idle()
        bench.executor.offer(make_plan("r", reach(start=bench.twin, goal=ROBOT.home), asked_ns=bench.stamp))
        assert approval.approve_automatically(bench.stamp)
        assert written == [("refused", 0), ("approved", 0), ("approved", 0)]

    def test_a_rejection_waits_for_no_record(self, bench):
        plan = make_plan()
        bench.executor.offer(plan)
        bench.record = self.refuse
        assert bench.review("p", plan.hash, False, "Ada") == "plan p rejected by Ada"
        assert bench.executor.under_review.plan is None
        assert [event.verdict for event in bench.executor.pop_events()] == ["rejected"]

    def test_a_rejection_while_an_approval_is_written_down_is_carried_out_at_once(self, bench):
        plan = make_plan()
        bench.executor.offer(plan)
        writes, hangs = threading.Event(), threading.Event()

        def hung_disk(record):
            bench.records.append(record)
            writes.set()
            assert hangs.wait(10.0)

        def approve():
            with pytest.raises(ReviewError, match="was decided already or withdrawn"):
                bench.review("p", plan.hash, True, "Ada")
            refused.append(True)

        refused: list[bool] = []
        bench.record = hung_disk
        thread = threading.Thread(target=approve)
        thread.start()
        assert writes.wait(10.0)
        assert bench.review("p", plan.hash, False, "Bob") == "plan p rejected by Bob"
        assert not hangs.is_set() and bench.executor.under_review.plan is None
        hangs.set()
        thread.join(10.0)
        assert refused == [True] and set(bench.run(50)) == {ROBOT.home} and bench.executor.plan is None
        approval, ending = bench.records
        assert approval.verdict == "approved" and ending.outcome == "dropped"
        assert ending.reason.startswith("not started: plan p was decided already")

    def test_a_hold_while_the_record_is_written_keeps_it_from_starting_and_that_is_recorded_too(self, bench):
        bench.executor.offer(make_plan())

        def record_slowly(record):
            bench.records.append(record)
            bench.executor.on_sync(SyncState.HOLDING, False)

        bench.record = record_slowly
        with pytest.raises(ReviewError, match=r"twin and physical arm are not in sync \(HOLDING\)"):
            bench.review("p", "", True, "Ada")
        approval, ending = bench.records
        assert approval.verdict == "approved" and ending.outcome == "dropped"
        assert "not started" in ending.reason and "HOLDING" in ending.reason
        assert bench.executor.plan is None

    def test_an_automatic_approval_that_cannot_be_recorded_withdraws_the_plan(self, bench):
        bench.executor.offer(make_plan())
        bench.record = self.refuse
        with pytest.raises(RecordError):
            bench.approval.approve_automatically(bench.stamp)
        assert bench.executor.under_review.plan is None
        assert set(bench.run(100)) == {ROBOT.home}


class TestAge:
    """What starts a plan is void 3 s after the newest that its screen had shown, wherever it lay all the while."""

    def slow(self, bench, seconds: float):
        """Let the disk take so long for each approval."""

        def record(record):
            bench.records.append(record)
            if getattr(record, "approved", False):
                bench.clock += round(seconds * NANOSECONDS)

        bench.record = record

    def test_the_way_and_the_disk_together_may_take_no_longer(self, bench):
        plan, seen = make_plan(), bench.present()
        bench.executor.offer(plan)
        bench.clock += 2 * NANOSECONDS
        self.slow(bench, 2.0)
        with pytest.raises(
            ExpiredError,
            match=r"the approval is too old: it is of 4\.0 s ago, after 3 s",
        ):
            bench.review("p", plan.hash, True, "Ada", seen=seen)

    def test_an_approval_that_waits_for_another_verdicts_disk_counts_from_its_call(self, bench):
        plan = make_plan()
        bench.executor.offer(plan)
        called, end, failed = threading.Event(), threading.Event(), []

        def hang(record):
            bench.records.append(record)
            called.set()
            assert end.wait(10.0)

        def second():
            try:
                bench.review("p", plan.hash, True, "Bob")
            except ReviewError as error:
                failed.append(error)

        bench.record = hang

        # refused, and that is recorded too; a rejection would wait for no disk
        def refused():
            with pytest.raises(ReviewError, match="plan another is not under review"):
                bench.review("another", plan.hash, True, "Ada")

        first = threading.Thread(target=refused)
        first.start()
        assert called.wait(10.0)
        asked, present = threading.Event(), bench.present
        bench.present = lambda: (present(), asked.set())[0]
        other = threading.Thread(target=second)
        other.start()
        assert asked.wait(10.0)
        bench.clock += 10 * NANOSECONDS
        end.set()
        first.join(10.0), other.join(10.0)
        assert [type(error) for error in failed] == [ExpiredError]

    @pytest.mark.parametrize("work", [False, True])
    def test_what_an_arm_that_trails_kept_from_beginning_never_begins_by_itself(self, bench, work):
        bench.with_tool()
        bench.executor.limit.on_lag(2.0)
        bench.play(make_work_plan() if work else make_plan(), SECOND * 34 // 10)
        assert bench.state is ExecutorState.IDLE and bench.executor.outcome == "stopped"
        assert "not begun, waits on the path until the arm has caught up" in bench.executor.reason

    @pytest.mark.parametrize("limit", [0.0, 1e-9, 1e-3])
    @pytest.mark.parametrize("work", [False, True])
    def test_what_a_speed_limit_kept_from_moving_never_begins_by_itself(self, bench, work, limit):
        plan = make_work_plan() if work else make_plan()
        bench.with_tool()
        bench.executor.limit.set_fraction(limit, "speed limit 0 by /scanner: somebody is near")
        bench.play(plan, SECOND * 29 // 10)
        assert bench.state is ExecutorState.PLAYING
        bench.run(SECOND // 2)
        assert bench.state is ExecutorState.IDLE and bench.executor.outcome == "stopped"
        assert "not begun, speed limit 0 by /scanner: somebody is near: an approval is void after 3 s" in (
            bench.executor.reason
        )
        bench.executor.limit.set_fraction(1.0)
        bench.run(SECOND)
        assert np.abs(np.array(bench.outputs[3:]) - ROBOT.home).max() < START_TOLERANCE

    @pytest.mark.parametrize("limit", [0.005, 0.02])
    def test_what_moves_slowly_goes_on(self, bench, limit):
        bench.executor.limit.set_fraction(limit, "somebody is near")
        bench.play(make_plan(), 4 * SECOND)
        assert bench.state is ExecutorState.PLAYING
        bench.executor.limit.set_fraction(1.0)
        bench.run_until_idle()
        assert bench.executor.outcome == "finished"

    def test_where_it_began_and_passes_again_it_has_begun(self, bench):
        bench.with_tool()
        bench.approve(make_work_plan(motion=between(0.0, 0.3, 0.0, 0.3, 0.6)))
        bench.run_into(1, 10)
        # nobody changes the scene at its end
        bench.edits = False
        bench.run_to_end_of(1)
        assert np.allclose(bench.step(), ROBOT.home, atol=1e-9)
        bench.run(5 * SECOND)
        assert bench.state is ExecutorState.AT_BOUNDARY and bench.executor.outcome == ""

    @pytest.mark.parametrize("duration", [0.8, 0.803])
    def test_a_first_segment_that_stays_where_it_is_has_begun_when_it_ends(self, bench, duration):
        bench.with_tool()
        bench.approve(make_work_plan(motion=between(0.0, 0.0, 0.3, 0.4, 0.6, duration=duration)))
        bench.run_to_end_of(0)
        bench.executor.under_review.scene_alive = False
        bench.run(5 * SECOND)
        assert bench.state is ExecutorState.AT_BOUNDARY and bench.executor.outcome == ""
        bench.executor.under_review.scene_alive = True
        bench.run_into(1)
        bench.run(10)
        assert bench.state is ExecutorState.PLAYING

    def test_what_has_begun_to_move_within_its_time_goes_on_after_it(self, bench):
        bench.executor.limit.set_fraction(0.0, "somebody is near")
        bench.play(make_plan(), SECOND * 29 // 10)
        bench.executor.limit.set_fraction(1.0)
        bench.run(10)
        bench.executor.limit.set_fraction(0.0, "somebody is near")
        bench.run(5 * SECOND)
        assert bench.state is ExecutorState.PLAYING and bench.executor.limit.standing
        bench.executor.limit.set_fraction(1.0)
        bench.run_until_idle()
        assert bench.executor.outcome == "finished"

    def test_nothing_is_approved_by_itself_long_after_it_could(self, bench):
        bench.executor.offer(make_plan())
        self.slow(bench, 120.0)
        assert bench.approval.approve_automatically(bench.stamp) is None
        (event,) = bench.executor.pop_events()
        assert event.verdict == "withdrawn" and "too old" in event.reason and bench.state is ExecutorState.IDLE


class TestScene:
    def test_a_plan_for_another_scene_cannot_be_approved(self, bench):
        with pytest.raises(ReviewError, match="plan p was made for scene 0ther, the present one is 5ce0e"):
            bench.approve(make_plan(scene="0ther"))
        assert bench.executor.under_review.plan is not None
        bench.executor.on_scene("0ther")
        bench.review("p", "", True, "Ada")
        assert bench.state is ExecutorState.PLAYING

    def test_nothing_can_be_approved_before_a_scene_is_known(self):
        bench = Bench()
        bench.executor.under_review.scene = ""
        bench.ready()
        with pytest.raises(ReviewError, match="cannot be approved: no scene is known yet"):
            bench.approve(make_plan())

    def test_a_change_takes_the_waiting_plan_out_of_review_and_says_so(self, bench):
        plan = make_plan()
        bench.executor.offer(plan)
        bench.executor.on_scene("0ther")
        (event,) = bench.executor.pop_events()
        assert (event.verdict, event.plan, event.reviewer) == ("withdrawn", plan, "executor")
        assert event.reason == "the scene changed from 5ce0e to 0ther; plan again"
        bench.executor.on_scene(SCENE)
        with pytest.raises(ReviewError, match="was decided already or withdrawn"):
            bench.approve(plan)

    def test_not_while_nobody_tells_of_the_scene(self, bench):
        bench.executor.offer(make_plan())
        bench.executor.under_review.scene_alive = False
        assert bench.approval.approve_automatically(bench.stamp) is None
        with pytest.raises(ReviewError, match="plan p cannot be approved: the scene is not published"):
            bench.review("p", "", True, "Ada")
        bench.executor.under_review.scene_alive = True
        assert "approved" in bench.review("p", "", True, "Ada")

    def test_a_rejection_needs_no_scene(self, bench):
        bench.executor.offer(make_plan(scene="0ther"))
        assert "rejected" in bench.review("p", "", False, "Ada")


class TestOrder:
    @pytest.mark.parametrize("others", [1, 2])
    def test_the_record_tells_of_approvals_that_come_together_in_the_order_in_which_they_were_carried_out(
        self, bench, others
    ):
        """While the first one is being written to the disk, further ones arrive in threads of their own."""
        plan = make_plan()
        bench.executor.offer(plan)
        started, threads = threading.Event(), []
        write = bench.record

        def slow_disk(record):
            if not threads:
                for _ in range(others):
                    threads.append(threading.Thread(target=judge))
                    threads[-1].start()
                started.set()
            write(record)

        def judge():
            with pytest.raises(ReviewError):
                bench.review("p", plan.hash, True, "Carl")

        bench.record = slow_disk
        bench.review("p", plan.hash, True, "Ada")
        assert started.is_set()
        for thread in threads:
            thread.join(10.0)
        assert bench.state is ExecutorState.PLAYING
        assert [record.verdict for record in bench.records] == ["approved"] + ["refused"] * others


class TestWithdrawn:
    @pytest.mark.parametrize(
        "action, reason",
        [
            (lambda bench: bench.executor.stop(bench.stamp), "stop requested"),
            (lambda bench: bench.executor.restart("new command session", bench.stamp), "new command session"),
            (lambda bench: bench.executor.offer(make_plan("q")), "replaced by plan q"),
        ],
        ids=["stop", "restart", "replaced"],
    )
    def test_a_plan_that_leaves_the_desk_by_itself_is_reported(self, bench, action, reason):
        bench.executor.offer(make_plan())
        action(bench)
        (event,) = bench.executor.pop_events()
        assert (event.plan_id, event.verdict, event.reason) == ("p", "withdrawn", reason)
        assert bench.executor.pop_events() == []


class TestAutoApprove:
    def test_plays_by_itself_and_leaves_a_verdict(self, bench):
        bench.executor.offer(make_plan())
        verdict = bench.approval.approve_automatically(bench.stamp)
        assert bench.state is ExecutorState.PLAYING and bench.records == [verdict]
        assert (verdict.verdict, verdict.reviewer) == ("approved", AUTO_APPROVE)
        assert bench.approval.approve_automatically(bench.stamp) is None

    def test_waits_until_in_sync(self, bench):
        bench.executor.on_sync(SyncState.HOLDING, False)
        bench.executor.offer(make_plan())
        assert bench.approval.approve_automatically(bench.stamp) is None
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        assert bench.approval.approve_automatically(bench.stamp) is not None

    def test_drops_a_plan_from_another_pose_and_says_why_once(self, bench):
        bench.executor.offer(make_plan(motion=reach(start=GOAL, goal=ROBOT.home)))
        for _ in range(3):
            assert bench.approval.approve_automatically(bench.stamp) is None
        assert [record.verdict for record in bench.records] == ["refused"]
        (event,) = bench.executor.pop_events()
        assert event.verdict == "withdrawn" and "from the present pose" in event.reason
        assert set(bench.run(100)) == {ROBOT.home}

    def test_waits_a_moment_for_the_scene_that_the_plan_was_made_for(self, bench):
        bench.executor.offer(make_plan(scene="n3w"))
        assert bench.approval.approve_automatically(0) is None
        assert bench.approval.approve_automatically(SCENE_DELAY) is None
        bench.executor.on_scene("n3w")
        assert bench.approval.approve_automatically(SCENE_DELAY) is not None

    def test_drops_a_plan_whose_scene_never_comes(self, bench):
        bench.executor.offer(make_plan(scene="n3w"))
        assert bench.approval.approve_automatically(0) is None
        assert bench.approval.approve_automatically(SCENE_DELAY + 1) is None
        assert "made for scene n3w" in bench.executor.pop_events()[0].reason
        assert bench.executor.under_review.plan is None


class TestAutoApproveSources:
    TRUSTED = AutoApproval(sources=("/move_group", "our own program"))

    @pytest.mark.parametrize(
        ("source", "named"),
        [("follow_joint_trajectory from /move_group", "/move_group"), ("our own program", "our own program")],
    )
    def test_plans_of_a_named_client_need_no_person_and_the_record_says_why(self, bench, source, named):
        bench.executor.offer(replace(make_plan(), source=source))
        verdict = bench.approval.approve_automatically(bench.stamp, self.TRUSTED)
        assert bench.state is ExecutorState.PLAYING and bench.records == [verdict]
        assert (verdict.reviewer, verdict.reason) == (
            AUTO_APPROVE,
            f"auto_approve_sources names {named}, and the plan is of {source!r}",
        )

    @pytest.mark.parametrize(
        "source",
        ["request", "", "follow_joint_trajectory from /move_group_2", "x from /kr120/move_group", "/move_group says"],
    )
    def test_all_others_wait_for_a_person(self, bench, source):
        bench.executor.offer(replace(make_plan(), source=source))
        assert bench.approval.approve_automatically(bench.stamp, self.TRUSTED) is None
        assert bench.approval.approve_automatically(bench.stamp, AutoApproval()) is None
        assert (
            bench.state is ExecutorState.IDLE and bench.executor.under_review.plan is not None and bench.records == []
        )
