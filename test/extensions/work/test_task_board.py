"""The task board: what can be planned, what is refused and why, what stands where. With invented elements, without a model file."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from construction_twin.extensions.work import decisions
from construction_twin.extensions.work.layout import Slot, StockPlan
from construction_twin.extensions.work.ledger import Ledger
from construction_twin.extensions.work.loaded_model import (
    ElementFacts,
    LoadedModel,
    as_built,
    deviation,
    pose_tuple,
    scene_change,
)
from construction_twin.extensions.work.schedule import Job, Schedule, Wait
from construction_twin.extensions.work.task_board import TaskBoard, WorkRefused
from construction_twin.extensions.work.task_memory import Entry, TaskState
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.tool import read_tool
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.scene_change import SceneChange

ROOT = Path(__file__).parents[3]
TOOL = read_tool(ROOT / "config/tools/vacuum_frame.yaml").tool
MINUTE = 60 * 10**9


def at(x: float, y: float = 0.0, z: float = 0.0, turn: float = 0.0) -> Pose:
    c, s = np.cos(turn), np.sin(turn)
    return Pose(np.array([x, y, z]), np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


JOBS = (
    Job("T1", "T1", "Place plate", "E1", (), ()),
    Job("T2", "T2", "Place stud", "E2", (), (Wait("T1", True, 60.0),)),
    Job("T3", "T3", "Place board", "E3", ("other",), (Wait("T2", True, 0.0),)),
)
HELD = at(0.0, 0.0, 0.3)
STUD = "'Place stud'"


class Clock:
    def __init__(self):
        self.now = 10**18

    def __call__(self) -> int:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def loaded_model(proposed: bool = False) -> LoadedModel:
    elements, slots = {}, {}
    for number, job in zip(count(1), JOBS):
        body = SceneObject(f"{job.element}/0", "box", (0.1, 0.1, 0.1))
        elements[job.element] = ElementFacts(f"element {number}", (body,), at(number, 1.0), np.zeros((1, 3, 3)))
        # the third lies in the slot of the second, when that has been taken
        slots[job.element] = Slot(job.element, "rack", min(number, 2), int(number == 3), at(number, -1.0), "")
    tool = (SceneObject("tool/post", "box", (0.1, 0.1, 0.1), link="tool0"),)
    schedule = Schedule(JOBS, (), proposed)
    return LoadedModel("panel.ifc", "a" * 64, "/cell.yaml", schedule, "s" * 64, elements, StockPlan(slots), TOOL, tool)


def board(tmp_path: Path, clock: Clock, proposed: bool = False, robot: str = "kr120") -> TaskBoard:
    ready = loaded_model(proposed)
    return TaskBoard(ready, Ledger(tmp_path / "ledger", ready.predecessors, ready.digest, clock), robot, "tool0")


def build(one: TaskBoard, task: str, until: str = "finished", stands: Pose | None = None) -> None:
    for event in ("offered", "planned", "begun", "gripping", "gripped", "releasing", "released", "finished"):
        pose = {"offered": pose_tuple(HELD), "released": pose_tuple(stands or one.built.element(task).base_T_goal)}.get(
            event, ()
        )
        one.add(Entry(event, task, plan="p", offer="o", pose=pose))
        if event == until:
            return


def test_a_proposed_schedule_must_be_accepted_by_a_person_first(tmp_path, clock):
    one = board(tmp_path, clock, proposed=True)
    assert one.schedule_word == "proposed" and one.next(clock()) == ""
    assert "the schedule is a proposal from the geometry" in one.obstacle("T1", clock())
    with pytest.raises(WorkRefused, match=r"who says so\?"):
        decisions.accept(one, " ", "")
    decisions.accept(one, "eva", "looks right")
    assert one.schedule_word == "accepted" and one.next(clock()) == "T1"
    with pytest.raises(WorkRefused, match="the schedule is accepted already"):
        decisions.accept(one, "eva", "")


def test_an_accepted_schedule_that_has_changed_is_a_proposal_again(tmp_path, clock):
    one = board(tmp_path, clock, proposed=True)
    one.ledger.add(Entry("accept_schedule", schedule="other", person="eva"))
    assert one.schedule_word == "proposed"


def test_out_of_order_is_refused_with_the_predecessor_named(tmp_path, clock):
    one = board(tmp_path, clock)
    assert one.obstacle("T2", clock()) == f"{STUD} waits for 'Place plate'"
    assert one.obstacle("T9", clock()) == "there is no task 'T9'; `twin work list` names them"


def test_a_lag_is_waited_for(tmp_path, clock):
    one = board(tmp_path, clock)
    build(one, "T1")
    lag = "60 s from now, its lag after 'Place plate' has finished"
    assert one.obstacle("T2", clock()) == f"{STUD} waits {lag}"
    clock.now += MINUTE + 1
    assert one.obstacle("T2", clock()) == "" and one.next(clock()) == "T2"


def test_another_robots_task_is_left_alone(tmp_path, clock):
    not_mine = "'Place board' is for other, not for kr120"
    for robot, why in (("kr120", not_mine), ("other", "")):
        folder = tmp_path / robot
        folder.mkdir()
        one = board(folder, clock, robot=robot)
        build(one, "T1")
        clock.now += MINUTE + 1
        build(one, "T2")
        assert one.obstacle("T3", clock()) == why


def test_one_task_at_a_time(tmp_path, clock):
    one = board(tmp_path, clock)
    one.ledger.add(Entry("offered", "T1", "E1", offer="o"))
    assert one.states.busy == "T1" and "is under review" in one.obstacle("T2", clock())
    with pytest.raises(WorkRefused, match="and cannot be skipped"):
        decisions.skip(one, "T1", "eva", "")


def test_a_question_comes_before_everything_else(tmp_path, clock):
    one = board(tmp_path, clock)
    build(one, "T1", until="gripped")
    one.ledger.add(Entry("stopped", "T1", "E1"))
    row = one.state_report(clock()).tasks[0]
    assert row.state == "asks" and "where is " in row.question and "in_grip" in row.answers
    assert row.question in one.obstacle("T1", clock())
    for refused in (
        lambda: decisions.skip(one, "T1", "eva", ""),
        lambda: decisions.answer(one, "T1", "perhaps", "eva", ""),
    ):
        with pytest.raises(WorkRefused):
            refused()
    decisions.answer(one, "T1", "in_grip", "eva", "")
    assert one.next(clock()) == "T1"
    with pytest.raises(WorkRefused, match="and asks nothing"):
        decisions.answer(one, "T1", "in_grip", "eva", "")


def test_an_answer_to_a_question_that_is_no_longer_open_is_refused(tmp_path, clock):
    one = board(tmp_path, clock)
    build(one, "T1", until="gripped")
    one.ledger.add(Entry("stopped", "T1", "E1"))
    question = one.state_report(clock()).tasks[0].question
    with pytest.raises(WorkRefused, match="another question is open by now"):
        decisions.answer(one, "T1", "in_grip", "eva", "", "where was it yesterday?")
    decisions.answer(one, "T1", "in_grip", "eva", "", question)


def test_what_is_in_the_grip_comes_first(tmp_path, clock):
    one = board(tmp_path, clock)
    build(one, "T1")
    clock.now += MINUTE + 1
    build(one, "T2", until="gripped")
    one.ledger.add(Entry("stopped", "T2", "E2"))
    decisions.answer(one, "T2", "in_grip", "eva", "")
    decisions.redo(one, "T1", "eva", "") if not one.ledger.states.followers("T1") else None
    assert "is in the grip" in one.obstacle("T1", clock())


@pytest.mark.parametrize("by_person", [True, False])
def test_what_counts_as_carried_can_be_doubted(tmp_path, clock, by_person):
    one = board(tmp_path, clock)
    assert decisions.ask_about_carried(one) == ""
    build(one, "T1", until="gripped")
    one.ledger.add(Entry("stopped", "T1", "E1"))
    decisions.answer(one, "T1", "in_grip", "eva", "")
    sentence = decisions.redo(one, "T1", "eva", "it fell") if by_person else decisions.ask_about_carried(one)
    assert "where is element 1 now?" in sentence
    assert one.ledger.states.tasks["T1"].possible_answers() == ("in_stock", "in_grip", "placed", "gone")
    decisions.answer(one, "T1", "gone", "eva", "")
    assert one.ledger.states.in_state(TaskState.HELD) == ("T1",)


def test_what_others_came_after_is_not_done_again_before_them(tmp_path, clock):
    one = board(tmp_path, clock)
    build(one, "T1")
    clock.now += MINUTE + 1
    build(one, "T2")
    with pytest.raises(WorkRefused, match="'Place stud' came after"):
        decisions.redo(one, "T1", "eva", "")
    # the third counts as delivered where the second lay
    decisions.skip(one, "T3", "eva", "")
    decisions.redo(one, "T2", "eva", "")
    decisions.redo(one, "T1", "eva", "")
    assert one.ledger.states.in_state(TaskState.READY) == ("T1",)
    with pytest.raises(WorkRefused, match="it was not done or skipped yet"):
        decisions.redo(one, "T1", "eva", "")


def test_a_measured_pose_replaces_the_arms(tmp_path, clock):
    one = board(tmp_path, clock)
    with pytest.raises(WorkRefused, match="is not placed yet"):
        decisions.record_measured(one, "E1", one.built.element("T1").base_T_goal, "eva", "tape")
    build(one, "T1")
    assert one.built.deviation("T1").distance == pytest.approx(0.0, abs=1e-12)
    found = decisions.record_measured(
        one, "E1", product(one.built.element("T1").base_T_goal, at(0.003, 0.0, 0.0, 0.01)), "eva", "tape"
    )
    assert (found.distance, found.angle) == (pytest.approx(0.003), pytest.approx(0.01))
    row = one.state_report(clock()).tasks[0]
    assert row.deviation_mm == pytest.approx(found.distance * 1e3)
    assert row.deviation_deg == pytest.approx(math.degrees(found.angle))
    assert row.reason == "placed, measured by eva"
    for wrong in (at(50.0), at(float("nan"))):
        with pytest.raises(WorkRefused, match="m from where the model has"):
            decisions.record_measured(one, "E1", wrong, "eva", "")
    with pytest.raises(WorkRefused, match="`twin work list` names them"):
        decisions.record_measured(one, "E9", one.built.element("T1").base_T_goal, "eva", "")


def test_an_element_that_can_never_be_planned_stops_only_what_waits_for_it(tmp_path, clock):
    ready = loaded_model()
    slots = {element: slot for element, slot in ready.stock.slots.items() if element != "E2"}
    bodiless = replace(ready.elements["E2"], bodies=(), triangles=np.empty((0, 3, 3)))
    ready = replace(
        ready, stock=StockPlan(slots), elements={**ready.elements, "E2": bodiless}, unplannable={"E2": "no body"}
    )
    one = TaskBoard(ready, Ledger(tmp_path / "ledger", ready.predecessors, ready.digest, clock), "other", "tool0")
    build(one, "T1")
    clock.now += MINUTE + 1
    assert one.obstacle("T2", clock()) == f"{STUD} cannot be planned: no body; skip it when it stands"
    assert " waits for " in one.obstacle("T3", clock())
    assert {row.id: row.state for row in one.state_report(clock()).tasks} == {
        "T1": "done",
        "T2": "ready",
        "T3": "waiting",
    }
    assert not any(name.startswith("E2") for name in scene_of(one, Scene()).names)
    decisions.skip(one, "T2", "eva", "stands already")
    assert one.next(clock()) == "T3"


# -- the scene


def scene_of(one: TaskBoard, scene: Scene) -> Scene:
    wanted, alone = one.built.wanted_scene()
    wrong = scene_change(scene, wanted, alone)
    for name in wrong.remove:
        scene = scene.without([name])
    for item in wrong.put:
        scene = scene.add(item, True)
    assert scene_change(scene, *one.built.wanted_scene()) == SceneChange()
    return scene


def test_the_scene_follows_the_ledger(tmp_path, clock):
    one = board(tmp_path, clock)
    scene = scene_of(one, Scene((SceneObject("table", "box", (1.0, 1.0, 1.0)), SceneObject("old/0", "sphere", (1.0,)))))
    # the third is not delivered yet, what is no work of ours stays, what a former model left goes
    assert set(scene.names) == {"table", "tool/post", "E1/0", "E2/0"}
    assert scene.get("E1/0").position == (1.0, -1.0, 0.0)
    build(one, "T1", until="gripped")
    scene = scene_of(one, scene)
    assert (scene.get("E1/0").link, scene.get("E1/0").position) == ("tool0", (0.0, 0.0, 0.3))
    one.ledger.add(Entry("stopped", "T1", "E1"))
    assert scene_of(one, scene).hash == scene.hash, "what is asked about is left as it is"
    decisions.answer(one, "T1", "gone", "eva", "")
    assert "E1/0" not in scene_of(one, scene).names


def test_a_planned_pose_is_not_told_as_measured(tmp_path, clock):
    one = board(tmp_path, clock)
    build(one, "T1", until="releasing")
    one.ledger.add(
        Entry("released", "T1", "E1", pose=pose_tuple(one.built.element("T1").base_T_goal), source="planned")
    )
    one.ledger.add(Entry("finished", "T1", "E1"))
    assert (
        one.built.deviation("T1") is None
        and "placed; as planned, not measured" in one.state_report(clock()).tasks[0].reason
    )
    decisions.record_measured(one, "E1", one.built.element("T1").base_T_goal, "eva", "tape")
    assert one.built.deviation("T1").distance == pytest.approx(0.0, abs=1e-12)


def test_a_skipped_element_is_taken_out_and_the_next_delivered(tmp_path, clock):
    one = board(tmp_path, clock)
    decisions.skip(one, "T1", "eva", "")
    assert "take its element out of the stock" in decisions.skip(one, "T2", "eva", "")
    assert set(scene_of(one, Scene()).names) == {"tool/post", "E3/0"}


@pytest.mark.parametrize("asked", [True, False])
def test_nothing_comes_back_into_a_slot_that_was_filled_again(tmp_path, clock, asked):
    one = board(tmp_path, clock)
    build(one, "T1")
    clock.now += MINUTE + 1
    build(one, "T2", until="gripped" if asked else "finished")
    if asked:
        one.ledger.add(Entry("stopped", "T2", "E2"))

    def back() -> None:
        decisions.answer(one, "T2", "in_stock", "eva", "") if asked else decisions.redo(one, "T2", "eva", "")

    with pytest.raises(WorkRefused, match="element 3 counts as delivered in the slot of element 2"):
        back()
    decisions.skip(one, "T3", "eva", "")
    back()
    decisions.redo(one, "T3", "eva", "")
    names = scene_of(one, Scene()).names
    assert "E2/0" in names and "E3/0" not in names


def test_what_stands_and_is_no_longer_in_the_model_is_not_tidied_away(tmp_path, clock):
    ready = loaded_model()
    former = Ledger(tmp_path / "ledger", {"T9": ()}, "b" * 64, clock, "/cell.yaml", {"E9": "T9"})
    for event in ("offered", "begun", "gripping", "gripped", "releasing", "released", "finished"):
        former.add(Entry(event, "T9", "E9", pose=pose_tuple(at(1.0))))
    former.close()
    ledger = Ledger(tmp_path / "ledger", ready.predecessors, ready.digest, clock, "/cell.yaml", ready.schedule.placing)
    one = TaskBoard(ready, ledger, "kr120", "tool0")
    scene = Scene((SceneObject("E9/0", "sphere", (1.0,)), SceneObject("old/0", "sphere", (1.0,))))
    assert {"E9/0", "E1/0"} <= set(scene_of(one, scene).names) and "old/0" not in scene_of(one, scene).names


# -- as built


def test_an_element_that_was_turned_by_its_symmetry_is_not_wrong():
    goal, turn = at(1.0, 2.0, 0.5), at(0.0, 0.0, 0.0, np.pi)
    held = at(0.1, 0.0, 0.3)
    flange = product(product(goal, turn), Pose(-held.rotation.T @ held.position, held.rotation.T))
    off = Pose(flange.position + np.array([0.001, 0.0, 0.0]), flange.rotation)
    built = as_built(off, flange, held, goal)
    assert deviation(built, goal).distance == pytest.approx(0.001)
    assert deviation(built, goal).angle == pytest.approx(0.0, abs=1e-9)


# -- what people take down


def with_removal(tmp_path: Path, clock: Clock) -> TaskBoard:
    """A task board whose first job waits for an element to be taken down."""
    ready = loaded_model()
    down = Job("D1", "D1", "Take down wall", "W1", (), ())
    jobs = (replace(JOBS[0], after=(Wait("D1", True, 0.0),)), *JOBS[1:])
    wall = SceneObject("W1/0", "box", (1.0, 0.1, 1.0), fixed=True)
    facts = ElementFacts("wall", (), at(0.0), np.zeros((1, 3, 3)))
    ready = replace(
        ready,
        schedule=Schedule(jobs, (), False, (down,)),
        elements={**ready.elements, "W1": facts},
        standing=(wall, SceneObject("W2/0", "box", (1.0, 0.1, 1.0), fixed=True)),
    )
    return TaskBoard(ready, Ledger(tmp_path / "ledger", ready.predecessors, ready.digest, clock), "kr120", "tool0")


def test_what_is_to_be_taken_down_stands_and_holds_up_until_a_person_says_that_it_is_gone(tmp_path, clock):
    one = with_removal(tmp_path, clock)
    assert one.next(clock()) == "" and one.obstacle("T1", clock()).endswith("waits for 'Take down wall'")
    assert "`twin work removed D1`" in one.obstacle("D1", clock())
    assert "`twin work removed D1`" in one.summary(clock())
    assert "W1/0" in one.built.wanted_scene()[0]
    with pytest.raises(WorkRefused, match=r"who says so\?"):
        decisions.removed(one, "D1", "", "")
    with pytest.raises(WorkRefused, match="has placed nothing"):
        decisions.removed(one, "T1", "eva", "")
    assert "is gone: it is no obstacle" in decisions.removed(one, "D1", "eva", "seen")
    scene = Scene((*one.loaded.standing, *one.loaded.tool_objects), 0.01)
    wanted, alone = one.built.wanted_scene()
    assert "W1/0" not in wanted and "W2/0" in wanted and scene_change(scene, wanted, alone).remove == ("W1/0",)
    assert one.next(clock()) == "T1"
    row = next(row for row in one.state_report(clock()).tasks if row.id == "D1")
    assert (row.state, row.reason) == ("done", "taken down, as a person says")
    with pytest.raises(WorkRefused, match="is gone already"):
        decisions.removed(one, "D1", "eva", "")


def test_that_it_is_gone_is_remembered_whatever_model_comes_and_can_be_taken_back(tmp_path, clock):
    one = with_removal(tmp_path, clock)
    decisions.removed(one, "D1", "eva", "")
    one.ledger.close()
    again = Ledger(tmp_path / "ledger", one.loaded.predecessors, "b" * 64, clock, "", one.loaded.schedule.placing)
    other = TaskBoard(one.loaded, again, "kr120", "tool0")
    assert "W1/0" not in other.built.wanted_scene()[0] and again.states.in_state(TaskState.ASKS) == ()
    assert "standing again" in decisions.redo(other, "D1", "eva", "wrong wall")
    assert "W1/0" in other.built.wanted_scene()[0] and other.next(clock()) == ""
    assert "wall stays" in decisions.skip(other, "D1", "eva", "it may stay")
    assert "W1/0" in other.built.wanted_scene()[0] and other.next(clock()) == "T1"


def test_what_the_arm_placed_stands_as_built_when_the_model_calls_it_completed(tmp_path, clock):
    one = board(tmp_path, clock)
    built = at(1.003, 1.0)
    build(one, "T1", stands=built)
    one.ledger.close()
    new = replace(
        one.loaded,
        schedule=Schedule(JOBS[1:2], ()),
        digest="b" * 64,
        elements={"E2": one.loaded.elements["E2"]},
        standing=(SceneObject("E1/0", "box", (0.1, 0.1, 0.1), (1.0, 1.0, 0.0), fixed=True),),
    )
    ledger = Ledger(tmp_path / "ledger", new.predecessors, new.digest, clock, "", {"E2": "T2"}, new.standing_elements)
    again = TaskBoard(new, ledger, "kr120", "tool0")
    assert again.states.asking == () and np.allclose(again.built.wanted_scene()[0]["E1/0"].position, (1.003, 1.0, 0.0))
