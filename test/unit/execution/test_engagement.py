"""Engaged: what is kept of the path, who may leave it, and that nothing but the way back leads out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from executor_bench import (
    FREE,
    GRIPPED,
    LATER,
    ROBOT,
    SCENE,
    Bench,
    between,
    joined,
    make_plan,
    make_work_plan,
    motion_back,
    plan_back,
    reach,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.errors import ConfigurationError, ExecutionError, ReviewError
from construction_twin.core.reports import ToolReport
from construction_twin.core.units import CYCLE
from construction_twin.execution.engagement import (
    Engagement,
    check_way_back,
    engagement_of,
    first_deviation,
    read_engagement,
    write_engagement,
)
from construction_twin.monitor.states import SyncState
from construction_twin.review.rehearsal_report import RehearsalCheck
from construction_twin.robot.executed_path import LARGEST_ENTRY, WAY_BACK_TOLERANCE, ExecutedPath
from construction_twin.robot.segments import Switch


@pytest.fixture
def bench() -> Bench:
    return Bench().ready().with_tool()


def stopped_in(bench: Bench, segment: int, cycles: int = 60, plan=None) -> Engagement | None:
    """Play a work plan into a segment and stop there; return the engagement."""
    bench.approve(plan or make_work_plan())
    bench.run_into(segment, cycles)
    bench.executor.stop(bench.stamp)
    bench.run_until_idle()
    bench.run(3)
    return bench.executor.engagement.present


def way_back(bench: Bench, name: str = "back", **fields):
    """Return the plan of the way back, from where the arm stands."""
    left = bench.executor.engagement.present
    begin = left.path.nearest_point(bench.twin).time
    fields = {"requires": left.requires(bench.executor.tool), "scene": bench.executor.under_review.scene} | fields
    return plan_back(motion_back(left.path, begin), name=name, asked_ns=bench.stamp, **fields)


def offer_back(bench: Bench, plan) -> None:
    """Offer a plan as the node does: checked, then under review."""
    left = bench.executor.engagement.present
    check_way_back(plan, left)
    bench.executor.offer(plan, left)


class TestLeft:
    def test_inside_an_engaged_segment(self, bench):
        left = stopped_in(bench, 2)
        keeper = bench.executor.engagement
        assert keeper.engaged and (left.plan_id, left.task, left.segment) == ("w", "t1", "lift")
        assert left.holding == ((GRIPPED, LATER[0]),)
        assert "in segment 3 ('lift') the rest is dropped" in left.reason
        # from the beginning of `approach`, the first of the engaged segments that follow each other
        np.testing.assert_allclose(left.path.trajectory.positions[0], pose_at(0.3), atol=1e-12)
        np.testing.assert_allclose(left.path.points()[-1], bench.twin, atol=1e-12)

    @pytest.mark.parametrize("segment", [0, 3])
    def test_not_in_one_that_is_not_engaged(self, bench, segment):
        assert stopped_in(bench, segment) is None and not bench.executor.engagement.engaged

    def test_at_the_end_of_an_engaged_segment_before_its_switch(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.executor.stop(bench.stamp)
        keeper = bench.executor.engagement
        assert keeper.engaged and keeper.present.holding == ((FREE, SCENE),)

    def test_while_nobody_knows_whether_it_has_fired(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(3)
        bench.executor.stop(bench.stamp)
        left = bench.executor.engagement.present
        assert left.holding == ((FREE, SCENE), (GRIPPED, LATER[0]))
        assert left.requires(ToolReport(True, "t", {}, {"gripped": True})) == GRIPPED
        assert left.requires(ToolReport()) == FREE

    def test_at_the_end_of_the_last_engaged_segment_when_the_next_cannot_begin(self, bench):
        plan = make_work_plan(segment_3={"requires": FREE})
        bench.approve(plan)
        bench.run_until_idle()
        assert "segment 'carry' cannot begin" in bench.executor.reason and bench.executor.engagement.engaged

    def test_not_after_it_is_finished(self, bench):
        bench.approve(make_work_plan(segment_3={"engaged": True}))
        bench.run_until_idle()
        assert bench.executor.outcome == "finished" and not bench.executor.engagement.engaged

    @pytest.mark.parametrize(
        "end",
        [
            lambda bench: bench.executor.on_sync(SyncState.HOLDING, False),
            lambda bench: bench.executor.on_link(False, "by the test"),
            lambda bench: bench.executor.stall("not run"),
            lambda bench: bench.executor.restart("new session", bench.stamp),
            lambda bench: bench.executor.on_scene("0ther"),
        ],
        ids=["hold", "disarmed", "stalled", "new session", "scene"],
    )
    def test_whatever_ended_it(self, bench, end):
        bench.approve(make_work_plan())
        bench.run_into(2)
        end(bench)
        bench.run(100)
        keeper = bench.executor.engagement
        assert keeper.engaged and (keeper.present.plan_id, keeper.present.segment) == ("w", "lift")


def pose_at(share: float) -> np.ndarray:
    return between(0.0, share).positions[-1]


class TestEngaged:
    def test_nor_started_by_an_approval_that_came_first(self, bench):
        stopped_in(bench, 2)
        plan = way_back(bench)
        offer_back(bench, plan)
        # freed, and left in another one: what was found for the first says nothing of the second
        keeper = bench.executor.engagement
        keeper.mark_engaged(replace(keeper.present, reason="again"))
        with pytest.raises(
            ReviewError,
            match=r"may not start: the arm was left in engaged segment 'lift' of plan w \(again\)",
        ):
            bench.review(plan.id, plan.hash, True, "Ada")

    def test_a_required_rehearsal_never_blocks_it(self, bench):
        stopped_in(bench, 2)
        bench.approval.rehearsal = RehearsalCheck(required=True)
        plan = way_back(bench)
        offer_back(bench, plan)
        bench.approval.update_obstacle()
        assert bench.approval.obstacle == ""
        bench.review(plan.id, plan.hash, True, "Ada")
        bench.run_until_idle()
        assert bench.executor.outcome == "finished" and not bench.executor.engagement.engaged

    def test_stopped_on_the_way_back_it_stays_engaged_and_goes_back_from_there(self, bench):
        left = stopped_in(bench, 2)
        plan = way_back(bench)
        offer_back(bench, plan)
        bench.review(plan.id, plan.hash, True, "Ada")
        bench.run(200)
        bench.executor.stop(bench.stamp)
        bench.run_until_idle()
        bench.run(3)
        assert bench.executor.engagement.present is left and bench.executor.engagement.engaged
        again = way_back(bench, "again")
        offer_back(bench, again)
        bench.review(again.id, again.hash, True, "Ada")
        bench.run_until_idle()
        assert not bench.executor.engagement.engaged

    def test_a_grip_lost_on_the_way_back_stops_it(self, bench):
        stopped_in(bench, 2)
        plan = way_back(bench)
        offer_back(bench, plan)
        bench.review(plan.id, plan.hash, True, "Ada")
        bench.run(100)
        bench.tool.inputs = {"gripped": False}
        bench.run_until_idle()
        assert bench.executor.outcome == "stopped" and bench.executor.engagement.engaged

    def test_with_a_grip_that_is_lost_already_a_person_has_to_free_it(self, bench):
        stopped_in(bench, 2)
        bench.tool.inputs = {"gripped": False}
        bench.run(2)
        plan = way_back(bench)
        offer_back(bench, plan)
        with pytest.raises(
            ReviewError,
            match="may not start: gripped reads off, not on",
        ):
            bench.review(plan.id, plan.hash, True, "Ada")

    def test_a_new_session_does_not_lead_out(self, bench):
        stopped_in(bench, 2)
        bench.executor.restart("new command session", bench.stamp)
        assert bench.executor.engagement.engaged

    def test_a_person_frees_no_other_engagement_than_was_looked_at(self, bench):
        left = stopped_in(bench, 2)
        bench.record = lambda record: (
            bench.records.append(record) or bench.executor.engagement.mark_engaged(replace(left))
        )
        with pytest.raises(ExecutionError, match="left in another engaged segment meanwhile"):
            bench.approval.release("Ada", "by hand")
        assert [record.refused == "" for record in bench.records[-2:]] == [True, False]

    def test_an_executor_that_is_started_again_is_still_engaged(self, bench, tmp_path):
        write_engagement(tmp_path / "file", stopped_in(bench, 2))
        other = Bench(read_engagement(tmp_path / "file", ROBOT.joint_names))
        other.twin = bench.twin
        other.executor.on_scene(LATER[0])
        other.with_tool().ready()
        other.tool.inputs = {"gripped": True}
        other.tell()
        assert other.executor.engagement.engaged and other.executor.engagement.saved
        plan = way_back(other)
        offer_back(other, plan)
        other.review(plan.id, plan.hash, True, "Ada")
        other.run_until_idle()
        assert not other.executor.engagement.engaged

    @pytest.mark.parametrize("share, engaged", [(0.0, False), (0.02, True), (1.0, True)])
    def test_a_restarted_one_is_not_when_the_arm_never_left_the_beginning(self, share, engaged):
        motion = between(0.3, 0.4)
        left = Engagement("w", "t", "s", ExecutedPath(motion, motion.duration), ((FREE, SCENE),), "killed")
        assert self.restarted(left, pose_at(0.3 + share * 0.1)) is engaged

    def test_but_is_when_its_path_comes_by_there_again(self):
        motion = between(0.3, 0.4, 0.3)
        left = Engagement("w", "t", "s", ExecutedPath(motion, motion.duration), ((FREE, SCENE),), "killed")
        assert self.restarted(left, pose_at(0.3))

    def restarted(self, left: Engagement, pose) -> bool:
        bench = Bench(left)
        bench.writes = False
        bench.twin = tuple(pose)
        bench.ready()
        return bench.executor.engagement.engaged


class TestWayBack:
    """The pure check."""

    def left(self, bench: Bench) -> Engagement:
        return stopped_in(bench, 2)

    def refused(self, plan, left: Engagement) -> str:
        with pytest.raises(ReviewError) as refusal:
            check_way_back(plan, left)
        return str(refusal.value)

    def test_the_way_back_is_accepted_in_one_motion(self, bench):
        left = self.left(bench)
        check_way_back(way_back(bench), left)

    def test_not_in_a_scene_that_does_not_know_what_is_gripped(self, bench):
        bench.edits = False
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(100)
        bench.executor.stop(bench.stamp)
        left = bench.executor.engagement.present
        assert left.holding == ((GRIPPED, LATER[0]),)
        motion = motion_back(left.path, left.path.end)
        refused = self.refused(plan_back(motion, GRIPPED, SCENE), left)
        assert f"it must become {LATER[0]} first" in refused and "release_engagement" in refused
        check_way_back(plan_back(motion, GRIPPED, LATER[0]), left)

    def test_each_alternative_only_in_its_scene(self, bench):
        bench.approve(make_work_plan())
        bench.run_to_end_of(1)
        bench.run(3)
        bench.executor.stop(bench.stamp)
        left = bench.executor.engagement.present
        motion = motion_back(left.path, left.path.end)
        for requires, scene, other in ((FREE, SCENE, LATER[0]), (GRIPPED, LATER[0], SCENE)):
            check_way_back(plan_back(motion, requires, scene), left)
            assert "it must become" in self.refused(plan_back(motion, requires, other), left)

    def test_a_switch_that_fired_unconfirmed_leaves_nothing_that_always_holds(self, bench):
        bench.tool.works = False
        bench.approve(make_work_plan(segment_1={"requires": ()}))
        bench.run_until_idle()
        left = bench.executor.engagement.present
        assert "has fired, but was not confirmed" in bench.executor.reason
        assert left.holding == ((GRIPPED, LATER[0]),)

    def test_not_to_a_place_before_its_end(self, bench):
        left = self.left(bench)
        short = plan_back(motion_back(left.path, left.path.end, until=0.3), GRIPPED, LATER[0])
        assert "leaves the executed path" in self.refused(short, left)

    def test_not_forward(self):
        motion = between(0.0, 0.5)
        left = Engagement("w", "t", "s", ExecutedPath(motion, motion.duration), (((), SCENE),))
        assert "leaves the executed path" in self.refused(plan_back(motion), left)

    def test_not_straight_across(self, bench):
        left = self.left(bench)
        straight = reach(bench.twin, left.path.trajectory.positions[0])
        # there and back lie on one line here: straight across leaves out the way to its turning point
        assert "leaves the executed path" in self.refused(plan_back(straight, GRIPPED, LATER[0]), left)

    @pytest.mark.parametrize(
        "fields",
        [
            {"requires": FREE},
            {"requires": ()},
            {"scene_after": "0ther"},
            {"switches": (Switch("vacuum", False, FREE, 1.0),)},
        ],
    )
    def test_not_with_anything_done_to_tool_or_scene(self, bench, fields):
        left = self.left(bench)
        motion = motion_back(left.path, left.path.end)
        plan = plan_back(motion, **({"requires": GRIPPED, "scene": LATER[0]} | fields))
        assert "release_engagement" in self.refused(plan, left)

    def test_not_without_a_segment(self, bench):
        left = self.left(bench)
        assert "is not the way back" in self.refused(make_plan("p", motion_back(left.path, left.path.end)), left)

    @pytest.mark.parametrize("share, fits", [(0.9, True), (3.0, False)])
    def test_from_beside_the_path_only_when_it_is_near(self, bench, share, fits):
        left = self.left(bench)
        way = pose_at(1.0) - pose_at(0.0)
        side = np.array([1.0, 0, 0, 0, 0, 0])
        side -= way * (side @ way) / (way @ way)
        beside = np.array(bench.twin) + share * LARGEST_ENTRY * side / np.abs(side).max()
        entry = left.path.nearest_point(beside)
        there = left.path.trajectory.sample(entry.time)[0]
        plan = plan_back(joined(reach(beside, there, 0.5), motion_back(left.path, entry.time)), GRIPPED, LATER[0])
        if fits:
            check_way_back(plan, left)
        else:
            assert "beside the executed path" in self.refused(plan, left)

    @settings(max_examples=30, deadline=None)
    @given(st.integers(0, 2**32), st.floats(0.05, 1.0), st.floats(1.0, 5.0), st.floats(1.5, 8.0))
    def test_the_exact_way_back_is_accepted_and_one_with_a_bump_is_not(self, seed, share, pace, bump):
        rng = np.random.default_rng(seed)
        poses = np.array(ROBOT.home) + np.cumsum(rng.uniform(-0.2, 0.2, (4, 6)), axis=0)
        path = ExecutedPath(smooth(poses), 0.0)
        path = ExecutedPath(path.trajectory, share * path.trajectory.duration)
        left = Engagement("w", "t", "s", path, (((), SCENE),))
        plan = plan_back(motion_back(path, path.nearest_point(path.points()[-1]).time, pace=pace))
        check_way_back(plan, left)
        motion = plan.trajectory
        positions = motion.positions.copy()
        middle = len(positions) // 2
        # beside the line, not along it
        way = positions[min(middle + 1, len(positions) - 1)] - positions[middle - 1]
        side = rng.normal(size=6)
        side -= way * (side @ way) / max(way @ way, 1e-12)
        positions[middle] += bump * 2.0 * WAY_BACK_TOLERANCE * side / np.abs(side).max()
        bent = type(motion)(motion.joint_names, motion.times, positions, motion.velocities, motion.accelerations)
        with pytest.raises(ReviewError, match="leaves the executed path .* after its start: call plan_way_back"):
            check_way_back(plan_back(bent), left)


def smooth(poses: np.ndarray):
    """Return a motion through some poses, at rest at each."""
    return joined(*(reach(a, b, 0.6, 30) for a, b in zip(poses, poses[1:])))


def test_a_polyline_is_followed_corner_by_corner():
    way = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    along = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]])
    assert first_deviation(way, along) is None
    # backwards, beside it, and not to the end
    assert first_deviation(way, along[[0, 1, 2, 1]]) == 3
    assert first_deviation(way, along + [[0.0, 0.0], [0.0, 3 * WAY_BACK_TOLERANCE], [0, 0], [0, 0], [0, 0]]) == 1
    assert first_deviation(way, along[:4]) == 3


def test_a_way_there_and_back_is_not_left_out():
    way = np.array([[0.0, 0.0], [1.0, 0.0], [0.2, 0.0]])
    assert first_deviation(way, np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]])) == 2
    assert first_deviation(way, np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [0.6, 0.0], [0.2, 0.0]])) is None


class TestExecutedPath:
    def test_of_a_pose_that_is_passed_twice_the_last_time_counts(self):
        motion = between(0.0, 0.5, 0.0)
        path = ExecutedPath(motion, motion.duration)
        pose = motion.sample(0.4)[0]
        entry = path.nearest_point(pose)
        assert abs(entry.time - 1.2) < 1e-6 and entry.distance < 1e-9
        # before it was reached a second time there is one passage
        assert abs(ExecutedPath(motion, 1.0).nearest_point(pose).time - 0.4) < 1e-3

    def test_beside_it_the_nearest_place(self):
        motion = between(0.0, 1.0)
        beside = motion.sample(0.4)[0] + 0.01 * np.array([1.0, 0, 0, 0, 0, 0])
        entry = ExecutedPath(motion, motion.duration).nearest_point(beside)
        assert 0.0 < entry.distance <= 0.01 and abs(entry.time - 0.4) < 0.05

    def test_a_path_of_no_length(self):
        motion = between(0.0, 1.0)
        entry = ExecutedPath(motion, 0.0).nearest_point(motion.positions[0])
        assert (entry.time, entry.distance) == (0.0, 0.0)


class TestFile:
    def test_comes_back_as_it_was(self, tmp_path):
        inside = engagement_of(make_work_plan(), 1)
        left = replace(inside, path=replace(inside.path, end=0.5 + CYCLE / 3), reason="stop requested")
        write_engagement(tmp_path / "file", left)
        found = read_engagement(tmp_path / "file", ROBOT.joint_names)
        assert found.path.trajectory.content_hash() == left.path.trajectory.content_hash()
        names = ("plan_id", "task", "segment", "holding", "reason")
        assert [getattr(found, name) for name in names] == [getattr(left, name) for name in names]
        assert found.path.end == left.path.end
        write_engagement(tmp_path / "file", None)
        assert read_engagement(tmp_path / "file", ROBOT.joint_names) is None

    def test_of_a_segment_that_is_entered_holds_both_states_of_the_tool(self):
        assert engagement_of(make_work_plan(), 1).holding == ((FREE, SCENE), (GRIPPED, LATER[0]))
        assert engagement_of(make_work_plan(), 2).holding == ((GRIPPED, LATER[0]),)

    @pytest.mark.parametrize(
        "spoil",
        [
            lambda fields: fields.update(version=1),
            lambda fields: fields.update(joints=["a"]),
            lambda fields: fields.update(end=-1.0),
            lambda fields: fields.update(end="x"),
            lambda fields: fields.update(holding=[]),
            lambda fields: fields.update(plan_id=7),
            lambda fields: fields.pop("waypoints"),
            lambda fields: fields["waypoints"][0].pop(),
            lambda fields: fields["waypoints"].clear(),
        ],
    )
    def test_another_file_is_refused_in_one_sentence(self, tmp_path, spoil):
        write_engagement(tmp_path / "file", engagement_of(make_work_plan(), 1))
        fields = json.loads((tmp_path / "file").read_text())
        spoil(fields)
        self.refuses(tmp_path / "file", json.dumps(fields).encode())

    @pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"7", b"\xff"])
    def test_so_is_what_is_no_such_object(self, tmp_path, content):
        self.refuses(tmp_path / "file", content)

    def refuses(self, file, content: bytes) -> None:
        file.write_bytes(content)
        with pytest.raises(ConfigurationError, match="free the arm, and only then"):
            read_engagement(file, ROBOT.joint_names)


def test_the_scene_of_the_stop_is_that_of_the_segment(bench):
    stopped_in(bench, 1)
    assert bench.executor.under_review.scene == SCENE
