"""What was placed stands, whatever model comes: another version, other ids."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from construction_twin.extensions.work import decisions
from construction_twin.extensions.work.layout import Slot, StockPlan
from construction_twin.extensions.work.ledger import Ledger, LedgerError, read_entries
from construction_twin.extensions.work.loaded_model import ElementFacts, LoadedModel, pose_tuple
from construction_twin.extensions.work.schedule import Job, Schedule
from construction_twin.extensions.work.task_board import TaskBoard, WorkRefused
from construction_twin.extensions.work.task_memory import Entry, TaskState
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.tool import read_tool
from construction_twin.scene.objects import SceneObject

TOOL = read_tool(Path(__file__).parents[3] / "config/tools/vacuum_frame.yaml").tool
NOW = 10**18
SIZE = (0.1, 1.2, 0.1)
HELD = pose_tuple(Pose(np.array([0.0, 0.0, 0.3]), np.eye(3)))
EVENTS = ("offered", "planned", "begun", "gripping", "gripped", "releasing", "released", "finished")


def at(x: float) -> Pose:
    return Pose(np.array([x, 1.0, 0.6]), np.eye(3))


def model(ids: str, *names: str, digest: str = "a", shifted: float = 0.0, folder: Path | None = None) -> LoadedModel:
    """Return sleepers 0.6 m apart; `ids`: beginning of their GlobalIds; with a folder they are meshes in it."""
    elements, slots, jobs = {}, {}, []
    for number, name in enumerate(names):
        element = f"{ids}{name}"
        body = SceneObject(f"{element}/0", "box", SIZE)
        if folder is not None:
            mesh = folder / "sleeper.obj"
            corners = [f"v {x} {y} {z}" for x in (-0.6, 0.6) for y in (-0.05, 0.05) for z in (-0.05, 0.05)]
            mesh.write_text("\n".join([*corners, "f 1 2 3", "f 5 6 7", "f 1 4 8", ""]))
            body = SceneObject(f"{element}/0", "mesh", mesh=str(mesh))
        goal = at(0.6 * number + shifted)
        elements[element] = ElementFacts(name, (body,), goal, np.zeros((1, 3, 3)))
        slots[element] = Slot(element, "rack", number, 0, at(-5.0 - number), "")
        jobs.append(Job(f"T{element}", f"T{element}", f"Place {name}", element, (), ()))
    schedule = Schedule(tuple(jobs), ())
    return LoadedModel("deck.ifc", digest * 64, "/deck.yaml", schedule, "s" * 64, elements, StockPlan(slots), TOOL, ())


def opened(folder: Path, ready: LoadedModel, name: str = "kr120_deck", robot: str = "kr120") -> TaskBoard:
    """Return the board as the node opens it."""
    times = count(NOW)
    ledger = Ledger(
        folder / f"{name}.jsonl", ready.predecessors, ready.digest, times.__next__, ready.cell, ready.schedule.placing,
        ready.standing_elements, robot, ready.model_elements,
    )  # fmt: skip
    board = TaskBoard(ready, ledger, robot, "tool0")
    return board


def place(board: TaskBoard, *tasks: str, off: float = 0.0) -> None:
    for task in tasks:
        stands = pose_tuple(Pose(board.built.element(task).base_T_goal.position + (0.0, off, 0.0), np.eye(3)))
        for event in EVENTS:
            pose = {"offered": HELD, "released": stands}.get(event, ())
            board.add(Entry(event, task, plan="p", offer="o", pose=pose))


@pytest.fixture
def two_placed(tmp_path) -> Path:
    """The folder of a ledger of four sleepers, two of them placed 1 mm beside their place."""
    board = opened(tmp_path, model("old", "A", "B", "C", "D"))
    place(board, "ToldA", "ToldB", off=0.001)
    board.ledger.close()
    return tmp_path


def row(board: TaskBoard, name: str):
    (found,) = [row for row in board.state_report(NOW).tasks if name in (row.id, row.name)]
    return found


def standing_object(board: TaskBoard, element: str) -> SceneObject | None:
    return board.built.wanted_scene()[0].get(f"{element}/0")


def of_b(board: TaskBoard) -> SceneObject:
    """Return B's body in the scene, which must be where it was placed."""
    found = standing_object(board, "oldB")
    assert found is not None and found.size == SIZE and np.allclose(found.position, (0.6, 1.001, 0.6))
    return found


# -- an element that is not in the model any more


def test_what_was_deleted_from_the_model_stands_and_is_asked_about_before_anything_is_planned(two_placed):
    board = opened(two_placed, model("old", "A", "X", "C", "D", digest="b"))
    of_b(board)
    assert board.next(NOW) == "" and board.states.asking == ("ToldB",)
    assert "still stand? The model does not have it." in row(board, "B").question
    assert row(board, "B").answers == ("stands", "taken_away")
    assert "asks first" in board.obstacle("ToldX", NOW) and "B" in board.obstacle("ToldX", NOW)
    decisions.answer(board, "ToldB", "stands", "eva", "")
    of_b(board)
    assert board.next(NOW) == "ToldX" and "placed, and not in the model" in row(board, "B").reason


def test_it_is_asked_once_for_each_version_and_stands_over_every_start(two_placed):
    changed = model("old", "A", "X", "C", "D", digest="b")
    board = opened(two_placed, changed)
    decisions.answer(board, "ToldB", "stands", "eva", "")
    for _ in range(2):
        lines = board.ledger.lines
        board.ledger.close()
        board = opened(two_placed, changed)
        assert board.states.asking == () and board.ledger.lines == lines
        of_b(board)


@pytest.mark.parametrize("asked", [True, False])
def test_it_is_no_obstacle_when_a_person_has_taken_it_away(two_placed, asked):
    changed = model("old", "A", "X", "C", "D", digest="b")
    board = opened(two_placed, changed)
    if asked:
        decisions.answer(board, "ToldB", "taken_away", "eva", "")
    else:
        decisions.answer(board, "ToldB", "stands", "eva", "")
        assert "is gone: it is no obstacle" in decisions.removed(board, "ToldB", "eva", "rotten")
    board.ledger.close()
    again = opened(two_placed, changed)
    assert standing_object(again, "oldB") is None and "ToldB" not in again.states.former
    with pytest.raises(WorkRefused, match="`twin work list` names them"):
        decisions.removed(again, "ToldB", "eva", "")


def test_what_stands_in_the_models_own_version_can_be_taken_away_too(two_placed):
    board = opened(two_placed, model("old", "A", "B", "C", "D"))
    assert board.next(NOW) == "ToldC"
    decisions.removed(board, "ToldB", "eva", "rotten")
    assert standing_object(board, "oldB") is None and board.states.tasks["ToldB"].state is TaskState.HELD
    with pytest.raises(WorkRefused, match="has placed nothing"):
        decisions.removed(board, "ToldC", "eva", "")


def test_an_element_that_is_asked_about_is_in_the_scene_of_a_node_that_starts(two_placed):
    board = opened(two_placed, model("old", "A", "B", "C", "D", digest="b", shifted=0.3))
    assert board.states.asking == ("ToldA", "ToldB")
    of_b(board)


def test_it_stands_with_the_shape_that_it_was_placed_with(two_placed):
    changed = model("old", "A", "B", "C", "D", digest="b")
    slim = (SceneObject("oldB/0", "box", (0.1, 0.1, 0.1)),)
    changed = replace(changed, elements={**changed.elements, "oldB": replace(changed.elements["oldB"], bodies=slim)})
    board = opened(two_placed, changed)
    decisions.answer(board, "ToldB", "placed", "eva", "")
    of_b(board)


# -- what is not asked again


def shifted(ready: LoadedModel, element: str, by: float) -> LoadedModel:
    """Return a model with one element elsewhere."""
    facts = ready.elements[element]
    moved = replace(facts, base_T_goal=Pose(facts.base_T_goal.position + (by, 0.0, 0.0), np.eye(3)))
    return replace(ready, elements={**ready.elements, element: moved})


def test_what_a_new_version_has_as_it_was_placed_is_not_asked_about(two_placed):
    board = opened(two_placed, model("old", "A", "B", "C", digest="b"))
    assert board.states.asking == () and board.next(NOW) == "ToldC"
    of_b(board)


def test_an_answer_counts_for_later_versions_that_say_the_same_and_for_no_other(two_placed):
    def asked(*names: str, digest: str, by: float = 0.0) -> TaskBoard:
        return opened(two_placed, shifted(model("old", *names, digest=digest), f"old{names[0]}", by))

    board = asked("A", "X", "C", digest="b", by=0.2)
    assert board.states.asking == ("ToldA", "ToldB")
    decisions.answer(board, "ToldA", "placed", "eva", "")
    decisions.answer(board, "ToldB", "stands", "eva", "")
    assert board.states.asking == ()
    board.ledger.close()
    later = asked("A", "X", "C", "D", digest="c", by=0.2)
    assert (
        later.states.asking == () and later.next(NOW) == "ToldX" and standing_object(later, "oldA").position[0] == 0.0
    )
    of_b(later)
    later.ledger.close()
    again = asked("A", "X", "C", digest="d", by=0.1)
    assert again.states.asking == ("ToldA",)
    again.ledger.close()
    back = opened(two_placed, model("new", "B", digest="e"))
    of_b(back)


def test_the_same_element_with_a_new_task_is_not_asked_about_and_not_placed_twice(two_placed):
    ready = model("old", "A", "B", "C", digest="b")
    jobs = tuple(replace(job, id=f"N{job.id}", task=f"N{job.task}") for job in ready.schedule.jobs)
    board = opened(two_placed, replace(ready, schedule=Schedule(jobs, ())))
    assert board.states.asking == () and board.states.former == {} and board.next(NOW) == "NToldC"
    of_b(board)
    assert board.built.deviation("NToldB").distance == pytest.approx(0.001)


# -- an id that is used for something else


@pytest.mark.parametrize("answer", ["stands", "taken_away"])
def test_a_task_that_has_another_element_now_does_not_take_over_what_it_has_placed(two_placed, answer):
    ready = model("old", "A", "X", "C", "D", digest="b")
    jobs = tuple(
        replace(job, id="ToldB", task="ToldB") if job.element == "oldX" else job for job in ready.schedule.jobs
    )
    ready = replace(ready, schedule=Schedule(jobs, ()))
    board = opened(two_placed, ready)
    of_b(board)
    assert board.states.asking == ("oldB ToldB",) and row(board, "B").answers == ("stands", "taken_away")
    board.ledger.close()
    again = opened(two_placed, ready)
    assert again.states.asking == ("oldB ToldB",)
    decisions.answer(again, "oldB ToldB", answer, "eva", "")
    assert again.next(NOW) == "ToldB" and again.element_of("ToldB") == "oldX"
    assert (standing_object(again, "oldB") is not None) == (answer == "stands")


def test_tasks_that_have_changed_their_elements_leave_them_where_they_stand(two_placed):
    ready = model("old", "A", "B", "C", "D", digest="b")
    other = {"oldA": "ToldB", "oldB": "ToldA"}
    jobs = tuple(replace(job, id=other.get(job.element, job.id)) for job in ready.schedule.jobs)
    board = opened(two_placed, replace(ready, schedule=Schedule(jobs, ())))
    of_b(board)
    assert standing_object(board, "oldA").position[0] == 0.0 and {
        task for task, memory in board.states.tasks.items() if memory.placed
    } == {"ToldA", "ToldB"}
    assert board.element_of("ToldA") == "oldB" == board.states.tasks["ToldA"].element


def test_what_a_removal_has_taken_down_says_nothing_of_its_next_element(tmp_path):
    def takes_down(element: str, digest: str) -> LoadedModel:
        ready = model("old", "A", digest=digest)
        removal = Job("TR", "TR", "Take down", element, (), ())
        body = SceneObject(f"{element}/0", "box", SIZE, (3.0, 1.0, 0.6))
        facts = ElementFacts(element, (), at(3.0), np.zeros((1, 3, 3)))
        return replace(
            ready, schedule=Schedule(ready.schedule.jobs, (), removals=(removal,)), standing=(body,),
            elements={**ready.elements, element: facts},
        )  # fmt: skip

    board = opened(tmp_path, takes_down("old wall", "a"))
    decisions.removed(board, "TR", "eva", "")
    assert standing_object(board, "old wall") is None
    board.ledger.close()
    again = opened(tmp_path, takes_down("other wall", "b"))
    assert standing_object(again, "other wall") is not None and again.states.tasks["TR"].state is TaskState.READY


# -- the same element under another id


def test_an_element_that_has_another_id_now_is_an_obstacle_until_a_person_skips_its_new_task(two_placed):
    board = opened(two_placed, model("new", "A", "B", "C", "D", digest="b"))
    assert board.next(NOW) == "" and row(board, "ToldA").answers == ("stands", "taken_away")
    for task in ("ToldA", "ToldB"):
        decisions.answer(board, task, "stands", "eva", "it has another id")
        decisions.skip(board, task.replace("old", "new"), "eva", "it stands")
    of_b(board)
    assert board.next(NOW) == "TnewC" and standing_object(board, "newB") is None


def test_a_kill_after_any_line_of_the_questions_asks_again_and_forgets_nothing(two_placed):
    path, changed = two_placed / "kr120_deck.jsonl", model("old", "X", "Y", "C", "D", digest="b")
    before = len(path.read_bytes().splitlines())
    board = opened(two_placed, changed)
    decisions.answer(board, "ToldA", "taken_away", "eva", "")
    decisions.answer(board, "ToldB", "stands", "eva", "")
    board.ledger.close()
    lines = path.read_bytes().splitlines(keepends=True)
    for left in range(before, len(lines) + 1):
        path.write_bytes(b"".join(lines[:left]))
        again = opened(two_placed, changed)
        of_b(again)
        assert (standing_object(again, "oldA") is not None) == (left < len(lines) - 1)
        assert again.next(NOW) == ("" if left < len(lines) else "ToldX")
        again.ledger.close()


# -- bodies


def test_meshes_are_kept_beside_the_ledger_and_outlive_the_cache(tmp_path):
    cache = tmp_path / "cache"
    cache.mkdir()
    ready = model("old", "A", "B", folder=cache)
    board = opened(tmp_path, ready)
    place(board, "ToldA")
    board.ledger.close()
    (cache / "sleeper.obj").unlink()
    again = opened(tmp_path, model("new", "X", digest="b"))
    found = standing_object(again, "oldA")
    assert found.mesh_digest == ready.elements["oldA"].bodies[0].mesh_digest
    assert Path(found.mesh).parent == tmp_path / "standing"


@pytest.mark.parametrize("damage", ["gone", "changed"])
def test_without_the_body_of_what_stands_nothing_is_opened(two_placed, damage):
    for path in (two_placed / "standing").iterdir():
        path.unlink() if damage == "gone" else path.write_text("[]")
    with pytest.raises(LedgerError, match="standing"):
        opened(two_placed, model("new", "A", digest="b"))


def test_the_body_is_on_the_disk_before_the_line_that_names_it(tmp_path):
    board = opened(tmp_path, model("old", "A"))
    (tmp_path / "standing").write_text("in the way")
    with pytest.raises(LedgerError, match="standing"):
        board.add(Entry("offered", "ToldA", offer="o"))
    assert [entry.event for entry in read_entries(board.ledger.path)] == ["opened"]
