"""Several tasks on one element, as to place it, then to drill it: in order, each in the ledger, the element placed once."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
import touch_process
import work_bench
import yaml
from building_models import box
from building_models import building as of_boxes
from building_models import element as of_box
from construction_twin.msg import Execution
from ifc_models import IfcModel
from touch_process import TOP, recipes_file
from work_bench import CARRY, ELEMENT, LEAVE, Bench
from work_samples import BRICK, ROOT, element, job, robot, work_cell

from construction_twin.extensions.work import decisions, worker_functions
from construction_twin.extensions.work.building import ScheduleError, Sequence, Task
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.extensions.work.ledger import Ledger, read_entries
from construction_twin.extensions.work.loaded_model import pose_tuple, scene_change
from construction_twin.extensions.work.schedule import Job, Schedule, Wait
from construction_twin.extensions.work.task_board import TaskBoard, WorkRefused
from construction_twin.extensions.work.task_memory import Entry
from construction_twin.extensions.work.work_cell import pose_of
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.scene.objects import Scene, product
from construction_twin.scene.scene_change import SceneChange

PLANNER = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
PLACE, TOUCH = "T1", "T2"
#: Later than all that is written in a test.
NOW = 2 * 10**18
known_process = pytest.fixture(touch_process.known, scope="module", autouse=True)


# -- the schedule


def by_recipe(_, task: Task) -> str:
    """Return the process of a task whose recipes are called as their processes."""
    return str(task.properties.get("Recipe", "place"))


def touching(name: str, *products: str, **fields) -> Task:
    return Task(name, name, products=products, properties={"Recipe": "touch"}, **fields)


def placing(name: str, *products: str, **fields) -> Task:
    return Task(name, name, products=products, **fields)


def schedule(*of: Task, sequences=(), elements=()) -> Schedule:
    cube = box((0, 0, 0), (1, 1, 1))
    names = dict.fromkeys(product for task in of for product in task.products)
    found = [next((one for one in elements if one.id == name), of_box(name, cube)) for name in names]
    return Schedule.of(of_boxes(*found, tasks=of, sequences=sequences), process=by_recipe)


def test_what_works_on_an_element_comes_after_its_placing_wherever_the_file_has_it():
    made = schedule(touching("fasten", "e"), touching("drill", "e"), placing("place", "e"), placing("other", "f"))
    assert [one.id for one in made.jobs] == ["place", "fasten", "drill", "other"]
    assert [one.process for one in made.jobs] == ["place", "touch", "touch", "place"]
    assert made.job("drill").after == (Wait("place", True, 0.0),) and made.placing == {"e": "place", "f": "other"}


def test_the_files_order_of_what_works_on_it_is_kept_with_its_lag():
    of = touching("fasten", "e"), touching("drill", "e"), placing("place", "e")
    made = schedule(*of, sequences=[Sequence("place", "drill", lag=60.0), Sequence("drill", "fasten")])
    assert [one.id for one in made.jobs] == ["place", "drill", "fasten"]
    assert made.job("drill").after == (Wait("place", True, 60.0),)
    assert {wait.job for wait in made.job("fasten").after} == {"place", "drill"}


def test_of_several_elements_each_is_placed_before_any_is_worked_on():
    made = schedule(touching("drill", "e", "f"), placing("place", "f", "e"))
    assert [(one.id, one.element) for one in made.jobs] == [
        ("place/1", "f"), ("place/2", "e"), ("drill/1", "e"), ("drill/2", "f"),
    ]  # fmt: skip
    assert made.job("drill/1").after == (Wait("place/2", True, 0.0),)


def test_an_element_is_still_placed_once():
    with pytest.raises(ScheduleError, match="made twice, by tasks place and again; it can be placed once"):
        schedule(placing("place", "e"), touching("drill", "e"), placing("again", "e"))


def test_a_file_that_has_it_worked_on_before_it_is_placed_is_refused_with_both():
    with pytest.raises(ScheduleError, match="circle.*(place.*drill|drill.*place)"):
        schedule(placing("place", "e"), touching("drill", "e"), sequences=[Sequence("drill", "place")])


def test_a_part_that_another_task_works_on_is_still_placed_with_its_assembly():
    cube = box((0, 0, 0), (1, 1, 1))
    whole, part = of_box("whole"), replace(of_box("part", cube), assembly="whole")
    of = placing("place", "whole"), touching("drill", "part")
    made = Schedule.of(of_boxes(whole, part, tasks=of), process=by_recipe)
    assert [(one.id, one.element) for one in made.jobs] == [("place", "part"), ("drill", "part")]


# -- which recipe


def test_a_tasks_own_recipe_comes_before_its_elements(tmp_path):
    recipes = work_cell(tmp_path, {"recipes": str(recipes_file(tmp_path))}).recipes
    one = element("b", properties={"CTwin_RobotTask": {"Recipe": "brick"}})
    task = Task("t", "t", properties={"Recipe": "probe"})
    assert (recipes.process(one), recipes.process(one, task)) == ("place", "touch")
    asked = replace(job(one), task_properties=task.properties)
    assert recipes.of(asked)[0] == "probe"


@pytest.mark.parametrize("schema", ["IFC2X3", "IFC4", "IFC4X3"])
def test_the_file_says_it_of_a_task(tmp_path, schema):
    model = IfcModel(schema)
    brick = model.box("brick", BRICK, (0.0, 0.0, 0.0), "IfcBeam")
    named = {"ObjectType": "drilling"} if schema == "IFC2X3" else {"PredefinedType": "OPERATION"}
    drill = model.task("drill", **named)
    model.root("IfcRelAssignsToProcess", RelatedObjects=[brick], RelatingProcess=drill)
    model.properties(drill, "CTwin_RobotTask", Recipe="probe")
    found = read_building(model.save(tmp_path / "m.ifc"), tmp_path / "cache")
    again = read_building(tmp_path / "m.ifc", tmp_path / "cache")
    for read in (found, again):
        task = read.tasks[drill.GlobalId]
        assert task.properties == {"Recipe": "probe"}
        assert (task.kind, task.products, task.inputs) == ("makes", (brick.GlobalId,), ())
        assert not any("places nothing" in note or "as inputs only" in note for note in read.notes)


# -- from the file to the ledger


@pytest.fixture
def work(tmp_path):
    """Two bricks of an IFC file; the first is placed, then touched, which the file lists the other way round."""
    model = IfcModel()
    bricks = [model.box(f"brick{number}", BRICK, (0.25 * number, 0.0, 0.0), "IfcBeam") for number in range(2)]
    for brick in bricks:
        model.properties(brick, "CTwin_RobotTask", Recipe="brick")
        model.weigh(brick, 3.5)
    touch = model.task("touch first", [bricks[0]])
    model.properties(touch, "CTwin_RobotTask", Recipe="probe")
    place, other = model.task("place first", [bricks[0]]), model.task("place second", [bricks[1]])
    work_cell(tmp_path, {"recipes": str(recipes_file(tmp_path, match={"elements": ["none"]}))})
    made = worker_functions.load_model(
        model=str(model.save(tmp_path / "m.ifc")), cell=str(tmp_path / "cell.yaml"), robot=robot(),
        self_collision=str(ROOT / "config/kr120_track_self_collision.yaml"), planner={**PLANNER, "seed": 1}, cache=str(tmp_path),
    )  # fmt: skip
    return SimpleNamespace(
        made=made, place=place.GlobalId, touch=touch.GlobalId, other=other.GlobalId, element=bricks[0].GlobalId
    )


def test_an_element_is_placed_then_touched_where_it_stands_and_each_is_in_the_ledger(tmp_path, work):
    made, element_id = work.made, work.element
    assert [one.id for one in made.schedule.jobs] == [work.place, work.touch, work.other]
    assert list(made.stock.slots) == [element_id, made.schedule.job(work.other).element]
    board = TaskBoard(
        made, Ledger(tmp_path / "l", made.predecessors, made.digest, count(10**18).__next__), "kr120", robot().tip_link
    )
    surroundings = work_cell(tmp_path, {"recipes": str(recipes_file(tmp_path))}).scene

    def scene() -> Scene:
        wanted, alone = board.built.wanted_scene()
        assert not alone and sum(name.startswith(f"{element_id}/") for name in wanted) == 1
        return Scene((*surroundings.objects, *wanted.values()), surroundings.padding)

    def planned(task: str):
        plan = worker_functions.plan(task=task, element=element_id, start=robot().home, scene=scene())
        held = () if plan.tool0_T_element is None else pose_tuple(plan.tool0_T_element)
        process = "" if (name := made.schedule.job(task).process) == "place" else name
        board.ledger.add(Entry("offered", task, element_id, offer="o", grip=plan.method, pose=held, process=process))
        board.ledger.add(Entry("begun", task, element_id, plan=f"plan of {task}"))
        return plan

    assert board.next(NOW) == work.place and "waits for" in board.obstacle(work.touch, NOW)
    assert planned(work.place).segments[-1].name == "retreat"
    # it is let go 4 mm beside where the model has it
    built = Pose(
        board.built.element(work.place).base_T_goal.position + (0.004, 0.0, 0.0),
        board.built.element(work.place).base_T_goal.rotation,
    )
    for event in ("gripping", "gripped", "releasing"):
        board.ledger.add(Entry(event, work.place, element_id))
    board.ledger.add(Entry("released", work.place, element_id, pose=pose_tuple(built), source="measured"))
    board.ledger.add(Entry("finished", work.place, element_id))
    assert board.next(NOW) == work.touch
    plan = planned(work.touch)
    assert [part.name for part in plan.segments] == ["to point", "touch", "back"]
    tcp = product(Chain(robot()).forward(plan.segments[1].trajectory.positions[-1]), pose_of(made.tool.tool0_T_tcp))
    assert np.allclose(tcp.position, built.position + built.rotation @ np.array(TOP) + (0.0, 0.0, 0.04), atol=2e-4)
    board.ledger.add(Entry("finished", work.touch, element_id))
    assert board.next(NOW) == work.other and scene_change(scene(), *board.built.wanted_scene()) == SceneChange()
    states = [(row.name, row.element_name, row.state) for row in board.state_report(NOW).tasks]
    assert states[:2] == [("place first", "brick0", "done"), ("touch first", "brick0", "done")]
    board.ledger.close()
    written = [
        (entry.task, entry.event, entry.process) for entry in read_entries(tmp_path / "l") if entry.event == "offered"
    ]
    assert written == [(work.place, "offered", ""), (work.touch, "offered", "touch")]
    again = Ledger(tmp_path / "l", made.predecessors, made.digest, lambda: 1)
    assert again.states.tasks[work.place].placed and again.states.open == (work.other,)
    again.close()


# -- what people say and see


def of_two(tmp_path, model="a" * 64) -> TaskBoard:
    """A task board whose one element is placed, then touched."""
    ready = loaded_model()
    times = count(10**18)
    ledger = Ledger(tmp_path / "l", ready.predecessors, model, times.__next__, "", ready.schedule.placing)
    return TaskBoard(ready, ledger, "kr120", "tool0")


def loaded_model():
    """Return the bench's model, with a second task that touches its element."""
    made = work_bench.loaded_model()
    touch = Job(TOUCH, TOUCH, "Touch stud", ELEMENT, (), (Wait(PLACE, True, 0.0),), "touch")
    return replace(made, schedule=Schedule((*made.schedule.jobs, touch), ()))


def done(one: TaskBoard, task: str, until: str = "finished") -> None:
    """Write what is written while a task is carried out."""
    moves = one.loaded.schedule.job(task).moves
    between = ("gripping", "gripped", "releasing", "released") if moves else ()
    for event in ("offered", "begun", *between, "finished"):
        pose = pose_tuple(one.built.element(task).base_T_goal) if event in ("offered", "released") and moves else ()
        process = "touch" if event == "offered" and not moves else ""
        one.ledger.add(Entry(event, task, ELEMENT, plan="p", offer="o", pose=pose, process=process))
        if event == until:
            return


def test_what_was_skipped_stands_only_when_a_person_says_where(tmp_path):
    one = of_two(tmp_path)
    decisions.skip(one, PLACE, "eva", "")
    assert not [name for name in one.built.wanted_scene()[0] if name.startswith(ELEMENT)]
    assert "does not count as placed: 'Place stud' is skipped" in one.obstacle(TOUCH, NOW) and one.next(NOW) == ""
    decisions.record_measured(one, ELEMENT, one.built.element(PLACE).base_T_goal, "eva", "by hand")
    assert one.next(NOW) == TOUCH and f"{ELEMENT}/0" in one.built.wanted_scene()[0]


def test_it_is_placed_again_only_after_what_came_after_was_taken_back(tmp_path):
    one = of_two(tmp_path)
    done(one, PLACE)
    done(one, TOUCH)
    with pytest.raises(WorkRefused, match="'Touch stud' came after"):
        decisions.redo(one, PLACE, "eva", "")
    decisions.redo(one, TOUCH, "eva", "")
    assert f"{ELEMENT}/0" in one.built.wanted_scene()[0]
    decisions.redo(one, PLACE, "eva", "")
    assert one.next(NOW) == PLACE
    assert one.built.forms(TOUCH) == one.built.forms(PLACE)


def test_another_model_asks_of_each_task_what_it_can_have_done(tmp_path):
    one = of_two(tmp_path)
    done(one, PLACE)
    done(one, TOUCH)
    one.ledger.close()
    again = of_two(tmp_path, "b" * 64)
    assert [row.answers for row in again.state_report(NOW).tasks] == [
        ("in_stock", "placed", "gone"),
        ("done", "not_done"),
    ]
    assert {entry.element for entry in read_entries(tmp_path / "l") if entry.event == "unknown"} == {ELEMENT}


def test_what_a_former_task_placed_is_touched_there_and_only_what_moves_it_is_asked_about(tmp_path):
    one = of_two(tmp_path)
    done(one, PLACE)
    decisions.record_measured(
        one,
        ELEMENT,
        Pose(
            one.built.element(PLACE).base_T_goal.position + (0.05, 0.0, 0.0),
            one.built.element(PLACE).base_T_goal.rotation,
        ),
        "eva",
        "",
    )
    stands = one.built.wanted_scene()[0][f"{ELEMENT}/0"]
    one.ledger.close()
    ready = loaded_model()
    alone = replace(ready.schedule.job(TOUCH), after=())
    ready = replace(ready, schedule=Schedule((alone,), ()), digest="b" * 64)
    ledger = Ledger(tmp_path / "l", ready.predecessors, ready.digest, lambda: 1, "", {}, ready.standing_elements)
    again = TaskBoard(ready, ledger, "kr120", "tool0")
    assert again.next(NOW) == TOUCH and again.built.wanted_scene()[0][f"{ELEMENT}/0"] == stands
    done(again, TOUCH)
    assert again.built.wanted_scene()[0][f"{ELEMENT}/0"] == stands
    ledger.close()


def test_what_was_taken_down_is_not_worked_on(tmp_path):
    ready = loaded_model()
    removal = Job("D", "D", "Take down", ELEMENT, (), ())
    touch = replace(ready.schedule.job(TOUCH), after=())
    ready = replace(ready, schedule=Schedule((touch,), (), False, (removal,)))
    one = TaskBoard(ready, Ledger(tmp_path / "l", ready.predecessors, ready.digest, lambda: 1), "kr120", "tool0")
    assert one.next(NOW) == TOUCH and f"{ELEMENT}/0" in one.built.wanted_scene()[0]
    decisions.removed(one, "D", "eva", "")
    assert "was taken down" in one.obstacle(TOUCH, NOW) and f"{ELEMENT}/0" not in one.built.wanted_scene()[0]


# -- the node


def test_the_node_has_both_planned_and_follows_them_one_after_the_other(monkeypatch, tmp_path):
    bench = Bench(monkeypatch, tmp_path)

    def plan(*_, task: str, **__) -> SimpleNamespace:
        parts = work_bench.segments()
        if task == PLACE:
            return SimpleNamespace(method="top", segments=parts, tool0_T_element=work_bench.HELD)
        same = {"switches": (), "change": SceneChange()}
        there = work_bench.reach(work_bench.HOME, work_bench.AT_GOAL, 1.0, 9)
        touch = replace(parts[CARRY], name="touch", trajectory=there, **same)
        return SimpleNamespace(method="point", segments=(touch, replace(parts[LEAVE], **same)), tool0_T_element=None)

    bench.start(SimpleNamespace(ask_first=lambda *_, **__: loaded_model(), ask=plan, close=None))
    bench.carrying().play(CARRY, True).tool(False)
    bench.play(CARRY, True, True).play(LEAVE)
    bench.execution(Execution.IDLE, plan_id=bench.plan.id, outcome="finished")
    bench.run()
    assert [row.state for row in bench.tasks[-1].tasks] == ["done", "ready"] and bench.tasks[-1].next == TOUCH
    stands = bench.scene.hash
    answer = bench.ask("")
    assert answer.success and answer.task == TOUCH, answer.message
    assert "by touch, point" in bench.plan.source
    bench.play(0).play(1)
    bench.execution(Execution.IDLE, plan_id=bench.plan.id, outcome="finished")
    bench.run()
    assert [row.state for row in bench.tasks[-1].tasks] == ["done", "done"] and bench.scene.hash == stands
    lines = [json.loads(line) for line in bench.ledger_lines]
    assert [(line["task"], line.get("process")) for line in lines if line["event"] == "offered"] == [
        (PLACE, None), (TOUCH, "touch"),
    ]  # fmt: skip
    assert sum(line["event"] == "released" for line in lines) == 1
