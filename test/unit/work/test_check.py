"""What is found out about each task before anything starts, and how it is told."""

import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from building_models import box, building, element
from processes import wait_until
from work_samples import box_pieces

from construction_twin.ros.commands import work_check_pool
from construction_twin.ros.commands.work_check_pool import Arm, Setup, check_all
from construction_twin.work.building import Task
from construction_twin.work.check_report import cell_picture
from construction_twin.work.schedule import Schedule
from construction_twin.work.site import read_site
from construction_twin.work.site_scene import Layout
from construction_twin.work.worker import WorkerError

ROOT = Path(__file__).resolve().parents[3]
ARM = Arm(
    ROOT / "urdf/kr120_track.urdf.xacro",
    ROOT / "config/kr120_track.yaml",
    ROOT / "config/kr120_track_self_collision.yaml",
    ROOT / "config/planner.yaml",
)
CELL = ROOT / "config/work/timber_panel.yaml"


@pytest.fixture(scope="module")
def found():
    """Three tasks: a stud that can be placed, one far beyond the track, one without geometry."""
    body = box((-0.5, -0.03, 0.0), (0.5, 0.03, 0.12))
    elements = [
        element("near", body, at=(1.2, 0.3, 0.0), name="Stud near"),
        element("far", body, at=(1.2, 9.0, 0.0), name="Stud far"),
        element("empty", name="Stud empty"),
    ]
    tasks = [Task(f"t{one.id}", f"Place {one.id}", products=(one.id,)) for one in elements]
    model = building(*(replace(one, mass=5.0, type_name="Stud 60x120") for one in elements), tasks=tasks)
    pieces = {one.id: box_pieces(one) for one in elements if one.bodies}
    setup = Setup(ARM, CELL, model, pieces, Schedule.of(model).jobs)
    seen = []
    checked = check_all(setup, 2, seen.append)
    return setup, checked, seen


def test_each_task_is_told_in_the_schedules_order_whenever_it_was_found(found):
    _, checked, seen = found
    assert [task.name for task in checked.tasks] == ["Place near", "Place far", "Place empty"]
    assert sorted(task.number for task in seen) == [0, 1, 2] and checked.rss_mb > 0.0


def test_a_possible_task_has_grip_track_clearance_time_and_path(found):
    _, checked, _ = found
    task = checked.tasks[0]
    assert task.possible and task.reason == "" and task.grip
    assert -2.0 <= task.track <= 2.0 and 0.0 < task.clearance and 1.0 < task.duration < 60.0
    # the path comes by the place: model (1.2, 0.3, 0.12) is the middle of its upper face
    goal = np.array([0.0, 1.4, 0.72])
    assert np.linalg.norm(np.array(task.path) - goal, axis=1).min() < 0.02


def test_what_is_out_of_reach_or_without_geometry_says_so(found):
    _, checked, _ = found
    _, far, empty = checked.tasks
    assert not far.possible and far.stage == "reach"
    assert not empty.possible and empty.reason == "the element has no geometry"


def test_the_picture_has_the_path_of_what_is_possible(found):
    setup, checked, _ = found
    layout = Layout(read_site(CELL), setup.building, setup.pieces, list(setup.pieces), ARM.robot().tip_link)
    picture, without = (cell_picture(tasks, layout) for tasks in (checked.tasks, [replace(checked.tasks[0], path=())]))
    assert picture.startswith(b"\x89PNG") and picture != without


def test_of_another_robots_tasks_none_is_checked_but_their_elements_stand_in_the_scene(found):
    setup, _, _ = found
    own = replace(setup, jobs=(replace(setup.jobs[0], robots=("other",)), replace(setup.jobs[2], robots=("kr120",))))
    checked = check_all(replace(own, robot="kr120"), 1)
    assert [task.name for task in checked.tasks] == ["Place empty"] and checked.tasks[0].number == 1
    assert "near/0" in own.layout(ARM.robot()).scene().names


#: Checks nothing, and tells as name of the task which process it is; a task of a negative number ends it.
PROCESS = """
    import os, time
    from types import SimpleNamespace
    from construction_twin.work.worker import serve_parent

    def check(number):
        if number < 0:
            os.kill(os.getpid(), 9)
        time.sleep(0.02)
        return SimpleNamespace(number=number, name=os.getpid(), possible=True), os.getpid(), 1.0

    serve_parent({"prepare": lambda setup: None, "check": check})
"""
#: Checks for ever with such processes.
CHECK = """
    import sys
    from types import SimpleNamespace
    from construction_twin.ros.commands import work_check_pool

    work_check_pool.PROGRAM = (sys.executable, "-c", sys.argv[1])
    setup = SimpleNamespace(numbers=range(100_000))
    work_check_pool.check_all(setup, 2, lambda task: print(task.name, flush=True))
"""


def alive(process: int) -> bool:
    """Return whether a process runs; one that has ended and is not waited for by whoever inherited it does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_the_processes_end_when_the_check_is_killed():
    own = textwrap.dedent(PROCESS)
    check = subprocess.Popen([sys.executable, "-c", textwrap.dedent(CHECK), own], stdout=subprocess.PIPE, text=True)
    try:
        seen: set[int] = set()
        while len(seen) < 2:
            seen.add(int(check.stdout.readline()))
        assert all(map(alive, seen))
    finally:
        os.kill(check.pid, signal.SIGKILL)
        check.wait()
        check.stdout.close()
    wait_until(lambda: not any(map(alive, seen)), 20.0, "the processes to end")


def test_a_process_that_is_ended_ends_the_check_and_the_others(monkeypatch, found):
    setup, _, _ = found
    monkeypatch.setattr(work_check_pool, "PROGRAM", (sys.executable, "-c", textwrap.dedent(PROCESS)))
    jobs = replace(setup, jobs=setup.jobs[:1] * 5)
    seen = []
    assert len(check_all(jobs, 2, seen.append).tasks) == 5
    monkeypatch.setattr(Setup, "numbers", (0, 1, -1, 2))
    with pytest.raises(WorkerError, match="has ended") as caught:
        check_all(jobs, 2, seen.append)
    assert caught.value.kind == ""
    wait_until(lambda: not any(alive(task.name) for task in seen), 20.0, "the processes to end")
