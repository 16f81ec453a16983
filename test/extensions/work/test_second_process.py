"""A second process, which touches a point of an element and goes back: from its recipe to the ledger, on the way of every task."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
import touch_process
import work_bench
import yaml
from construction_twin.msg import Execution
from touch_process import recipes_file
from work_bench import Bench
from work_samples import (
    RECIPES,
    ROOT,
    building,
    layout,
    pairs,
    planner,
    robot,
    work_cell,
)

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work import decisions, process
from construction_twin.extensions.work.layout import StockPlan
from construction_twin.extensions.work.ledger import Ledger, LedgerError
from construction_twin.extensions.work.loaded_model import LoadedModel
from construction_twin.extensions.work.process import read_recipes
from construction_twin.extensions.work.received_messages import GripReading
from construction_twin.extensions.work.schedule import Job, Schedule
from construction_twin.extensions.work.task_memory import Entry, NotNow, TaskMemory, TaskState
from construction_twin.extensions.work.task_recorder import events_after_restart
from construction_twin.extensions.work.worker_functions import PlanningContext
from construction_twin.planning.planner import PlanRequest
from construction_twin.planning.request_limits import PlanBounds
from construction_twin.planning.work_plan import plan_work
from construction_twin.review.record import PlanRecord
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import product
from construction_twin.scene.scene_change import SceneChange

HOME = np.array(robot().home)
PLANNER = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
known_process = pytest.fixture(touch_process.known, scope="module", autouse=True)


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """Three bricks, the first of which stands and is touched."""
    folder = tmp_path_factory.mktemp("cell")
    return layout(work_cell(folder, {"recipes": str(recipes_file(folder))}), building())


@pytest.fixture(scope="module")
def plan(work):
    scene = work.scene()
    return planner(work.work_cell.recipes).plan(work.job_for("brick0", scene, "T1"), HOME, scene)


# -- its recipe


def test_a_recipe_names_the_process_and_a_file_of_before_places(work):
    processes_of = [work.work_cell.recipes.process(work.building.element(one)) for one in work.order]
    assert processes_of == ["touch", "place", "place"]
    assert {recipe.process for recipe in read_recipes(RECIPES).recipes.values()} == {"place"}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"process": "weld"}, "recipes/probe/process: found 'weld', expected one of place.*, touch"),
        ({"process": ["touch"]}, "recipes/probe/process"),
        ({"gaps": 0.1}, "recipes/probe/gaps.*no such key; did you mean gap"),
        ({"points": []}, "recipes/probe/points"),
        ({"grips": {"touching": ["cups"]}}, "recipes/probe/grips.*no such key"),
    ],
)
def test_a_wrong_key_of_its_recipe_is_named(tmp_path, change, sentence):
    with pytest.raises(ConfigurationError, match=sentence):
        read_recipes(recipes_file(tmp_path, **change))


# -- where its element is


def test_what_is_not_moved_has_no_slot_and_stands_at_its_place_from_the_beginning(work):
    assert "brick0" not in work.stock.slots and work.stays == ("brick0",)
    assert work.stock.slots["brick1"].number == 0
    there = work.scene().get("brick0/0").pose.position
    assert np.allclose(there, product(work.base_T_goal("brick0"), work.pieces["brick0"][0].pose).position)
    assert work.job_for("brick0", work.scene()).base_T_stock is None


# -- its plan


def test_it_is_planned_as_every_task_and_changes_no_scene(plan, work):
    assert [part.name for part in plan.segments] == ["to point", "touch", "back"]
    assert [part.engaged for part in plan.segments] == [False, True, True]
    assert all(part.change == SceneChange() for part in plan.segments)
    assert {scene.hash for scene in plan.scenes} == {work.scene().hash}
    assert plan.method == "point 50 0 71 mm" and plan.tool0_T_element is None and plan.clearance > 0.02


def test_whoever_checks_it_for_review_takes_it(plan, work):
    world = CollisionWorld(robot(), work.scene(), pairs())
    checked = plan_work("T1", plan.segments, HOME, PlanRequest("test", 0), world, PlanBounds(), lambda: 0.0)
    assert [part.scene_after for part in checked.segments] == [work.scene().hash] * 3


def test_the_check_before_the_work_plans_it_too(work):
    schedule = Schedule((Job("T1", "T1", "Probe brick", "brick0", (), (), "touch"),), ())
    found = PlanningContext(robot(), planner(work.work_cell.recipes), work, schedule, {}).check(0)
    assert found.possible and found.grip == "point 50 0 71 mm" and found.track is not None


# -- its ledger


def loaded_model() -> LoadedModel:
    """Return the bench's model, whose one element is touched where it stands."""
    made = work_bench.loaded_model()
    touched = replace(made.schedule.job(work_bench.TASK), process="touch")
    return replace(made, stock=StockPlan({}), schedule=Schedule((touched,), ()))


def segments():
    """Return what the worker plans: to the point, touch (engaged), back."""
    fetch, grip, _, leave = work_bench.segments()
    same = {"switches": (), "change": SceneChange()}
    back = replace(leave, name="back", trajectory=work_bench.reach(work_bench.AT_STOCK, work_bench.HOME, 1.0, 9))
    return tuple(
        replace(part, **same)
        for part in (replace(fetch, name="to point"), replace(grip, name="touch", engaged=True), back)
    )


@pytest.fixture
def bench(monkeypatch, tmp_path) -> Bench:
    one = Bench(monkeypatch, tmp_path)
    begin(one)
    return one


def begin(one: Bench) -> None:
    """Start the node of a bench with this model."""
    plan = lambda *_, **__: SimpleNamespace(  # noqa: E731
        method="point 0 0 0 mm", segments=segments(), tool0_T_element=None
    )
    one.start(SimpleNamespace(ask_first=lambda *_, **__: loaded_model(), ask=plan, close=None))


@pytest.mark.parametrize(("answer", "state"), [("done", "done"), ("not_done", "ready")])
def test_a_stop_at_the_element_asks_whether_it_was_done(bench, answer, state):
    bench.planned().play(0).play(1)
    bench.execution(Execution.IDLE, 1, plan_id=bench.plan.id, outcome="stopped")
    bench.run()
    assert bench.row.state == "asks" and tuple(bench.row.answers) == ("done", "not_done")
    assert "carried out?" in bench.row.question
    assert work_bench.PLACED.name in bench.scene.names
    board = bench.board
    decisions.answer(board, work_bench.TASK, answer, "eva", "looked")
    assert board.states.tasks[work_bench.TASK].state.value == state


def test_an_open_grip_says_nothing_of_what_was_done(tmp_path):
    offered = TaskMemory("T", TaskState.READY).with_entry(Entry("offered", "T", "E", offer="o", process="touch"))
    begun = offered.with_entry(Entry("begun", "T", "E", plan="p"))
    for memory in (offered, begun):
        (entry,) = events_after_restart(memory, PlanRecord("p", None), GripReading(True, False))
        assert entry.event == "unknown" and "carried out?" in memory.with_entry(entry).question("stud")


def test_what_is_placed_is_not_done_before_it_was_let_go():
    placing = (
        TaskMemory("T", TaskState.READY)
        .with_entry(Entry("offered", "T", "E", offer="o"))
        .with_entry(Entry("begun", "T"))
    )
    with pytest.raises(NotNow):
        placing.with_entry(Entry("finished", "T", "E"))
    again = (
        TaskMemory("T", TaskState.READY)
        .with_entry(Entry("offered", "T", process="touch"))
        .with_entry(Entry("dropped", "T"))
    )
    assert again.stays and not again.with_entry(Entry("offered", "T")).stays


def ledger(path, model="a" * 64) -> Ledger:
    times = count(1_800_000_000_000_000_000)
    return Ledger(path, {"T": ()}, model, lambda: next(times), "/cell.yaml")


def test_another_model_asks_whether_it_was_done_and_leaves_nothing_behind_where_its_task_is_gone(tmp_path):
    first = ledger(tmp_path / "l")
    for event, said in (("offered", {"process": "touch"}), ("planned", {}), ("begun", {}), ("finished", {})):
        first.add(Entry(event, "T", "E", plan="p", **said))
    first.close()
    again = ledger(tmp_path / "l", "b" * 64)
    memory = again.states.tasks["T"]
    assert memory.possible_answers() == ("done", "not_done")
    assert "it was done, for another version of the model" in memory.question("stud")
    again.close()
    times = count(1_800_000_000_000_000_000)
    other = Ledger(tmp_path / "l", {"U": ()}, "c" * 64, lambda: next(times), "/cell.yaml")
    assert other.states.former == {} and other.states.tasks["U"].state is TaskState.READY
    other.close()


def test_a_process_that_this_program_does_not_have_is_refused_with_its_line(tmp_path, monkeypatch):
    one = ledger(tmp_path / "l")
    one.add(Entry("offered", "T", "E", offer="o", process="touch"))
    one.close()
    monkeypatch.delitem(process.MODULES, "touch")
    with pytest.raises(LedgerError, match="line 2 is none of a ledger: process 'touch'; expected one of place"):
        ledger(tmp_path / "l")
