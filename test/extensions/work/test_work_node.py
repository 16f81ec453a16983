"""The work node without ROS around it: ledger before scene, an arm left engaged, and what a restart or a refusal leaves."""

from __future__ import annotations

import pytest
from construction_twin.msg import Engagement, Execution, Plan, Scene, SceneObject, Segment
from construction_twin.srv import WorkDecideRequest
from executor_bench import ROBOT, ROOT
from ifc_models import IfcModel
from work_bench import (
    AT_GOAL,
    CARRY,
    ELEMENT,
    FETCH,
    GRIP,
    GRIPPED,
    IN_STOCK,
    LEAVE,
    PLACED,
    TASK,
    Bench,
    Killed,
)

from construction_twin.core.worker import Worker
from construction_twin.extensions.work.ledger import Ledger, LedgerError
from construction_twin.extensions.work.loaded_model import WORKER, pose_of_tuple
from construction_twin.scene.objects import SceneObject as Body

FENCE = Body("fence", "box", (0.1, 0.1, 0.1), (-3.0, 0.0, 0.5))
UP_TO_GRIPPED = ["offered", "planned", "begun", "gripping", "gripped"]


@pytest.fixture
def bench(monkeypatch, tmp_path) -> Bench:
    return Bench(monkeypatch, tmp_path)


def gripping(bench: Bench) -> Bench:
    """Play until the switch that grips has been set: the scene still has the element in its stock."""
    bench.planned().play(FETCH).play(GRIP).tool(True)
    return bench.play(GRIP, True)


def stopped(bench: Bench, segment: int, at_boundary: bool = False) -> None:
    """Have the executor say that a person's stop left the arm engaged, but not yet where."""
    bench.execution(
        Execution.IDLE,
        segment,
        plan_id=bench.plan.id,
        outcome="stopped",
        reason="a person",
        at_boundary=at_boundary,
        engaged=True,
    )


def stopped_before_the_scene(bench: Bench) -> Bench:
    """Have the arm stopped when the grip was confirmed, and the scene had not changed yet."""
    stopped(gripping(bench), GRIP, at_boundary=True)
    bench.left_engaged("grip", after(bench, GRIP))
    return bench


def after(bench: Bench, segment: int) -> str:
    """Return the hash of the scene after a segment of the plan."""
    return bench.plan.segments[segment].scene_after


class TestLedgerBeforeScene:
    def test_each_change_of_the_scene_finds_its_line_on_the_disk(self, bench):
        bench.carrying()
        assert bench.noted == [("edit_scene", "gripped")]
        assert bench.scene.hash == after(bench, GRIP) and bench.scene.get(f"{ELEMENT}/0").link == GRIPPED.link
        bench.play(CARRY, True).tool(False)
        bench.play(CARRY, True, True)
        assert bench.noted == [("edit_scene", "gripped"), ("edit_scene", "released")]
        assert bench.scene.hash == after(bench, CARRY) and bench.scene.get(f"{ELEMENT}/0") == PLACED

    def test_a_switch_that_is_not_confirmed_changes_nothing(self, bench):
        gripping(bench)
        assert bench.events == UP_TO_GRIPPED[:-1] and bench.noted == []

    def test_a_report_that_comes_while_another_is_written_waits_for_its_own_lines(self, bench):
        bench.carrying()
        bench.noted.clear()

        def pose_meanwhile() -> tuple[float, ...]:
            bench.execution(Execution.AT_BOUNDARY, CARRY, at_boundary=True, wants_scene=True)
            return AT_GOAL

        bench.arm_pose = pose_meanwhile
        bench.execution(Execution.AT_BOUNDARY, CARRY, at_boundary=True)
        bench.run(1)
        assert (bench.events[-1], bench.noted) == ("releasing", [])
        bench.run(1)
        assert bench.noted == [("edit_scene", "released")]

    def test_without_the_line_the_scene_stays_and_the_work_ends(self, bench, monkeypatch):
        gripping(bench)
        before = bench.scene

        def full(*_):
            raise LedgerError("ledger", "no space left on device")

        monkeypatch.setattr(Ledger, "add", full)
        bench.play(GRIP, True, True)
        assert bench.noted == [] and bench.scene is before
        assert "no space left" in bench.tasks[-1].reason and bench.tasks[-1].tasks == []
        assert "no space left" in bench.ask().message

    def test_a_change_that_was_refused_is_tried_again_until_it_is_taken(self, bench):
        gripping(bench)
        bench.scene_refuses = "locked"
        bench.play(GRIP, True, True)
        assert len(bench.noted) > 1 and set(bench.noted) == {("edit_scene", "gripped")}
        assert bench.refused and {reason for reason, _ in bench.refused} == {"edit_scene"}
        bench.scene_refuses = ""
        bench.run(1)
        assert bench.scene.hash == after(bench, GRIP)
        taken = len(bench.noted)
        bench.run()
        assert len(bench.noted) == taken

    def test_what_another_plan_waits_for_changes_nothing_while_this_one_is_under_review(self, bench):
        bench.planned()
        bench.execution(Execution.AT_BOUNDARY, GRIP, plan_id="another", at_boundary=True, wants_scene=True)
        bench.run()
        assert bench.noted == [] and bench.events == ["offered", "planned"]

    def test_the_pose_at_which_it_was_let_go_is_the_arms_own(self, bench):
        bench.carrying()
        bench.arm_pose = lambda: (AT_GOAL[0] + 0.001, *AT_GOAL[1:])
        bench.play(CARRY, True).play(CARRY, True, True)
        line = bench.entries[-1]
        moved = pose_of_tuple(line.pose).position - PLACED.pose.position
        assert (line.event, line.source) == ("released", "measured") and 0.001 < abs(moved).max() < 0.01


class TestEngaged:
    def test_nothing_is_written_or_changed_before_it_is_known_where_the_arm_was_left(self, bench):
        gripping(bench)
        written = bench.events
        stopped(bench, GRIP, at_boundary=True)
        bench.run()
        assert bench.events == written and bench.noted == []
        answer = bench.ask()
        assert not answer.success and "the executor has not said yet where the arm was left" in answer.message
        assert bench.noted == []

    def test_the_ledger_takes_the_stop_then_the_scene_changes_then_the_way_back_is_planned(self, bench):
        stopped_before_the_scene(bench).run()
        assert bench.events == [*UP_TO_GRIPPED, "stopped"]
        assert bench.noted == [("edit_scene", "stopped")] and bench.scene.hash == after(bench, GRIP)
        answer = bench.ask()
        assert answer.success and "the way back comes first" in answer.message and answer.plan_id != bench.plan.id
        assert bench.noted[1:] == [("plan_way_back", "stopped")]

    def test_whoever_asks_before_the_node_has_followed_gets_the_same_order(self, bench):
        answer = stopped_before_the_scene(bench).ask()
        assert answer.success, answer.message
        assert bench.events == [*UP_TO_GRIPPED, "stopped"]
        assert bench.noted == [("edit_scene", "stopped"), ("plan_way_back", "stopped")]

    def test_in_a_scene_that_is_right_the_way_back_is_planned_at_once(self, bench):
        bench.carrying()
        bench.noted.clear()
        stopped(bench, CARRY)
        bench.left_engaged("carry", after(bench, GRIP))
        bench.run()
        assert bench.noted == [] and bench.events[-1] == "stopped"
        assert bench.ask().success and bench.noted == [("plan_way_back", "stopped")]

    def test_what_blocks_the_way_back_is_said_once_and_kept_until_it_is_gone(self, bench):
        gripping(bench)
        right = bench.scene
        bench.show(bench.scene.add(FENCE))
        stopped(bench, GRIP, at_boundary=True)
        bench.left_engaged("grip", after(bench, GRIP))
        bench.run()
        ((reason, sentence),) = bench.refused
        assert reason == "engagement" and "beside the work it has floor, fence" in sentence
        assert bench.tasks[-1].reason.endswith(f"only the way back can be planned, and not yet: {sentence}")
        answer = bench.ask()
        assert not answer.success and answer.message.endswith(f"not yet: {sentence}")
        bench.run()
        assert [each for each in bench.refused if each[0] == "engagement"] == [(reason, sentence)]
        assert bench.noted == [] and bench.events[-1] == "stopped"
        bench.show(right)
        bench.run()
        assert bench.noted == [("edit_scene", "stopped")] and bench.scene.hash == after(bench, GRIP)
        assert bench.tasks[-1].reason == "the arm is engaged: only the way back can be planned"
        assert bench.ask().success

    def test_another_obstacle_is_another_sentence(self, bench):
        gripping(bench)
        right = bench.scene
        stopped(bench, GRIP, at_boundary=True)
        bench.show(right.add(FENCE))
        bench.left_engaged("grip", after(bench, GRIP))
        bench.run()
        bench.show(right.add(Body("pallet", "box", (0.1, 0.1, 0.1), (-3.0, 0.0, 0.5))))
        bench.run()
        assert ["fence" in said or "pallet" in said for _, said in bench.refused] == [True, True]
        assert "pallet" in bench.tasks[-1].reason and "fence" not in bench.tasks[-1].reason

    def test_a_scene_that_the_scene_node_refuses_is_tried_again(self, bench):
        gripping(bench)
        bench.scene_refuses = "locked"
        stopped(bench, GRIP, at_boundary=True)
        bench.left_engaged("grip", after(bench, GRIP))
        bench.run(4)
        tried = len(bench.noted)
        assert tried > 1 and "locked" in bench.tasks[-1].reason
        answer = bench.ask()
        assert not answer.success and "locked" in answer.message and len(bench.noted) == tried + 1
        assert "plan_way_back" not in dict(bench.noted)
        bench.scene_refuses = ""
        bench.run()
        assert bench.scene.hash == after(bench, GRIP) and bench.ask().success

    def test_an_arm_that_was_freed_by_hand_is_not_blocked_any_more(self, bench):
        gripping(bench)
        bench.show(bench.scene.add(FENCE))
        stopped(bench, GRIP, at_boundary=True)
        bench.left_engaged("grip", after(bench, GRIP))
        bench.run()
        assert "fence" in bench.tasks[-1].reason
        bench.hear("engagement", Engagement())
        bench.execution(Execution.IDLE, plan_id=bench.plan.id, outcome="stopped")
        bench.run()
        assert not bench.tasks[-1].engaged and "asks first" in bench.tasks[-1].reason
        # engaged there once more, it is looked at anew
        stopped(bench, GRIP, at_boundary=True)
        bench.left_engaged("grip", after(bench, GRIP))
        bench.run()
        assert len(bench.refused) == 2

    def test_a_restarted_node_finds_the_scene_for_the_way_back_in_the_ledger(self, bench):
        gripping(bench)
        bench.kill()
        bench.start()
        stopped(bench, GRIP, at_boundary=True)
        bench.left_engaged("grip", after(bench, GRIP))
        bench.show()
        bench.tool(True)
        bench.node.open()
        bench.run()
        assert bench.received.work_plan(bench.plan.id) is None
        assert bench.events[-1] == "stopped" and bench.noted == [("edit_scene", "stopped")]
        assert bench.scene.hash == after(bench, GRIP) and bench.ask().success

    def test_while_it_is_not_written_how_the_plan_ended_the_scene_stays(self, bench):
        gripping(bench).kill()
        bench.start()
        bench.show()
        bench.left_engaged("grip", after(bench, GRIP))
        bench.execution(Execution.IDLE, plan_id=bench.plan.id, engaged=True)
        bench.node.open()
        answer = bench.ask()
        assert not answer.success and "how its plan ended is not written yet" in answer.message
        assert bench.run().noted == []
        stopped(bench, GRIP)
        assert bench.run().noted == [("edit_scene", "stopped")]

    def test_a_tidy_scene_is_not_made_under_an_engaged_arm(self, bench):
        bench.ready()
        bench.noted.clear()
        bench.execution(Execution.IDLE, engaged=True)
        bench.show(bench.scene.without([f"{ELEMENT}/0"]))
        bench.run()
        assert bench.noted == []
        bench.execution(Execution.IDLE)
        bench.run()
        assert [what for what, _ in bench.noted] == ["edit_scene"] and bench.scene.get(f"{ELEMENT}/0") == IN_STOCK


def restarted(bench: Bench, closed: bool = False, offered: bool = False) -> Bench:
    """Have node and executor ended and started anew; the tool is read again, the plan only where it is still offered."""
    bench.kill()
    bench.start()
    bench.show()
    bench.execution(Execution.IDLE)
    bench.tool(closed)
    if offered:
        bench.publish_plan()
    bench.node.open()
    return bench.run()


class TestRestart:
    def test_a_plan_that_was_never_approved_is_dropped(self, bench):
        bench.planned().review_file.touch()
        restarted(bench)
        assert bench.events == ["offered", "planned", "dropped"]
        assert bench.entries[-1].reason == "it was never approved" and bench.row.state == "ready"

    def test_a_plan_that_was_rejected_is_dropped(self, bench):
        bench.planned().record(False)
        restarted(bench)
        assert bench.events[-1] == "dropped" and bench.row.state == "ready"

    def test_a_plan_that_was_carried_out_meanwhile_is_done(self, bench):
        bench.planned().record(True, "finished")
        restarted(bench)
        assert bench.events == [*UP_TO_GRIPPED, "releasing", "released", "finished"]
        assert bench.row.state == "done" and bench.row.reason == "placed; where exactly is not known"

    def test_of_a_plan_that_is_still_known_it_is_also_known_where_the_element_was_to_be(self, bench):
        bench.planned().record(True, "finished")
        bench.kill()
        bench.start()
        bench.show()
        bench.execution(Execution.IDLE)
        bench.publish_plan()
        bench.verdict(True)
        bench.node.open()
        (line,) = (entry for entry in bench.entries if entry.event == "released")
        assert line.source == "planned" and pose_of_tuple(line.pose).position == pytest.approx(PLACED.pose.position)

    def test_of_an_approval_without_an_end_an_open_tool_says_that_nothing_was_gripped(self, bench):
        bench.planned().record(True)
        restarted(bench)
        assert (bench.events[-1], bench.entries[-1].reason) == ("dropped", "nothing was gripped")

    def test_of_an_approval_without_an_end_a_closed_tool_has_a_person_asked(self, bench):
        bench.planned().record(True)
        restarted(bench, closed=True)
        assert bench.events[-1] == "unknown" and bench.row.state == "asks" and "where is" in bench.row.question

    def test_a_record_that_cannot_be_read_has_a_person_asked(self, bench):
        bench.planned()
        bench.review_file.write_text("no record\n")
        restarted(bench, closed=True)
        assert bench.events[-1] == "unknown" and bench.row.state == "asks"

    def test_a_plan_that_is_still_offered_waits_on(self, bench):
        restarted(bench.planned(), offered=True)
        assert bench.events == ["offered", "planned"] and bench.row.plan_id == bench.plan.id

    @pytest.mark.parametrize("outcome, last", [("finished", "finished"), ("", "dropped")])
    def test_a_plan_whose_id_was_never_learnt_is_known_by_its_offer(self, bench, outcome, last):
        bench.ready()
        bench.planner_dies = "node"
        with pytest.raises(Killed):
            bench.ask()
        assert bench.events == ["offered"]
        bench.record(True, outcome)
        restarted(bench)
        assert bench.events[-1] == last and {entry.plan for entry in bench.entries[1:]} == {bench.plan.id}

    def test_a_carrying_arm_that_went_on_is_followed_on(self, bench):
        bench.carrying().kill()
        bench.start()
        bench.show()
        bench.publish_plan()
        bench.tool(True)
        bench.execution(Execution.PLAYING, CARRY)
        bench.node.open()
        bench.run()
        assert bench.events == UP_TO_GRIPPED
        bench.play(CARRY, True).play(CARRY, True, True).play(LEAVE)
        bench.execution(Execution.IDLE, plan_id=bench.plan.id, outcome="finished")
        bench.run()
        assert bench.events[-3:] == ["releasing", "released", "finished"] and bench.row.state == "done"


class TestTurnedDown:
    def test_a_plan_is_dropped_with_the_reviewers_words_and_can_be_planned_again(self, bench):
        bench.planned().verdict(False, reason="too close to the rack")
        bench.run()
        line = bench.entries[-1]
        assert (line.event, line.plan, line.reason) == ("dropped", bench.plan.id, "Ada: too close to the rack")
        assert bench.row.state == "ready"
        assert bench.row.reason == "its plan was turned down by Ada: too close to the rack"
        assert bench.ask().success and bench.events[-2:] == ["offered", "planned"]

    def test_an_approval_and_a_verdict_on_another_plan_drop_nothing(self, bench):
        bench.planned().verdict(True)
        bench.verdict(False, plan_id="another")
        bench.run()
        assert bench.events == ["offered", "planned"] and bench.row.state == "planned"

    def test_a_plan_that_is_played_is_not_turned_down_any_more(self, bench):
        bench.planned().play(FETCH).verdict(False)
        bench.run()
        assert bench.events == UP_TO_GRIPPED[:3]

    def test_what_planner_and_executor_took_with_them_is_dropped(self, bench):
        bench.planned()
        bench.publishers["plan"] = 0
        bench.run()
        assert bench.events == ["offered", "planned"], "the executor has it"
        bench.publishers["execution"] = 0
        bench.run()
        assert bench.events[-1] == "dropped" and bench.row.state == "ready"


class TestOffer:
    def test_the_ledger_knows_of_it_before_the_planner(self, bench):
        bench.ready()
        bench.noted.clear()
        assert bench.ask().success and bench.noted == [("plan_work", "offered")]
        assert [entry.plan for entry in bench.entries] == ["", bench.plan.id]
        assert bench.ask().message == "'Place stud' is under review"

    def test_a_planner_that_went_away_before_it_published_leaves_nothing_to_wait_for(self, bench):
        bench.ready()
        bench.planner_dies = "before"
        answer = bench.ask()
        assert not answer.success and "does not answer" in answer.message
        bench.run()
        assert bench.events == ["offered", "dropped"] and bench.row.reason == "the planner does not answer"

    def test_a_planner_that_went_away_after_it_published_leaves_its_plan_under_review(self, bench):
        bench.ready()
        bench.planner_dies = "after"
        assert not bench.ask().success
        assert bench.events == ["offered", "planned"] and bench.entries[-1].plan == bench.plan.id


class TestTool:
    def test_an_element_that_an_open_tool_cannot_hold_is_asked_about(self, bench):
        bench.carrying()
        bench.execution(Execution.IDLE, CARRY, plan_id=bench.plan.id, outcome="held")
        bench.run()
        bench.call("work/decide", answered("in_grip"))
        bench.run()
        assert bench.row.state == "carried"
        bench.tool(False)
        bench.run()
        assert bench.events[-1] == "unknown" and bench.row.state == "asks"

    def test_a_tool_that_nobody_reads_says_nothing(self, bench):
        bench.carrying()
        bench.execution(Execution.IDLE, CARRY, plan_id=bench.plan.id, outcome="held")
        bench.run()
        bench.call("work/decide", answered("in_grip"))
        bench.publishers["tool"] = 0
        bench.tool(False)
        bench.run()
        assert bench.row.state == "carried"

    @pytest.mark.parametrize("answer", ["in_stock", "gone"])
    def test_the_way_out_after_a_grip_that_was_not_confirmed_is_named_and_works(self, bench, answer):
        bench.planned().play(FETCH).play(GRIP).tool(False, commanded=True)
        bench.play(GRIP, True)
        bench.execution(Execution.IDLE, GRIP, plan_id=bench.plan.id, outcome="tool", reason="was not confirmed")
        bench.run()
        assert bench.row.state == "asks"
        said, by_hand = bench.call("work/decide", answered(answer)), "switch vacuum off by hand"
        assert said.success and "commanded to grip (vacuum)" in said.message and by_hand in said.message
        bench.run()
        for read in (False, True):
            # whether the cups have caught the element meanwhile or not
            bench.tool(read, commanded=True)
            refused = bench.ask()
            assert not refused.success and by_hand in refused.message
        # nor is it moved back while it may hang on the cups
        bench.left_engaged("grip", bench.scene.hash)
        assert not bench.ask().success and "plan_way_back" not in dict(bench.noted)
        bench.tool(False)
        assert "the way back comes first" in bench.ask().message

    def test_a_grip_that_holds_an_element_is_no_problem(self, bench):
        bench.carrying()
        bench.execution(Execution.IDLE, CARRY, plan_id=bench.plan.id, outcome="held")
        bench.run()
        said = bench.call("work/decide", answered("in_grip"))
        assert said.success and "it is in the grip" in said.message
        assert bench.ask().success


def answered(answer: str) -> WorkDecideRequest:
    return WorkDecideRequest(task=TASK, decision="answer", answer=answer, person="Ada")


def test_messages_that_cannot_be_read_are_refused_and_change_nothing(bench):
    bench.ready()
    scene = bench.received.scene
    bench.hear("scene", Scene(objects=[SceneObject(name="a", shape="cube")]))
    bench.hear("plan", Plan(id="p", segments=[Segment(put=[SceneObject(name="a", shape="cube")])]))
    assert [reason for reason, _ in bench.refused] == ["scene", "plan"]
    assert bench.received.scene is scene and bench.received.plan is None


def test_a_ledger_belongs_to_robot_and_site_whatever_the_models_file_is_called(bench):
    assert bench.ready().board.ledger.path.name == f"{ROBOT.name}_cell.jsonl"


def test_before_the_model_is_read_the_node_says_so(bench):
    assert [message.reason for message in bench.tasks] == ["the model is being read"]
    assert bench.ask().message == "the model is being read"


def test_tasks_that_wait_for_each_other_are_one_sentence_and_the_node_lives(bench, tmp_path):
    model = IfcModel()
    studs = [model.box(name, (0.1, 0.1, 1.0), at=(1.0 + k, 0, 0)) for k, name in enumerate("abc")]
    tasks = [model.task(f"place {stud.Name}", [stud]) for stud in studs]
    for before, after in zip(tasks, (*tasks[1:], tasks[0])):
        model.sequence(before, after)
    path = model.save(tmp_path / "cycle.ifc")
    worker = Worker(WORKER)
    bench.start(worker, model=str(path), cell=str(ROOT / "config/work/timber_panel.yaml"))
    try:
        bench.node.open()
        bench.node.run_once()
        answer = bench.ask()
    finally:
        worker.close()
    assert bench.tasks[-1].reason.startswith("tasks wait for each other in a circle: ")
    assert not answer.success and answer.message == bench.tasks[-1].reason


def test_a_person_says_by_the_service_what_is_gone_and_where_an_element_is(bench):
    bench.ready()
    answer = bench.call("work/decide", WorkDecideRequest(task=TASK, decision="removed", person="eva"))
    assert not answer.success and "has placed nothing" in answer.message
    said = bench.call("work/decide", WorkDecideRequest(task=TASK, decision="x", person="eva")).message
    assert said == "decision 'x'; expected skip, redo, answer, removed, measured or accept_schedule"
    measured = WorkDecideRequest(task=ELEMENT, decision="measured", person="eva")
    measured.pose.pose.orientation.w = 1.0
    assert "is not placed yet" in bench.call("work/decide", measured).message
