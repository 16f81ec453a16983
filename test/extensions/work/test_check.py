"""What is found out about each task before anything starts, and how it is told."""

import io
import itertools
import os
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from building_models import box, building, element
from processes import wait_until
from rich.console import Console
from work_samples import robot

from construction_twin.extensions.work import worker_functions
from construction_twin.extensions.work.building import Task
from construction_twin.extensions.work.commands.work_check import cell_picture, check_all

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Three tasks: a stud that can be placed, one far beyond the track, one without geometry, of another robot."""
    body = box((-0.5, -0.03, 0.0), (0.5, 0.03, 0.12))
    elements = [
        element("near", body, at=(1.2, 0.3, 0.0), name="Stud near"),
        element("far", body, at=(1.2, 9.0, 0.0), name="Stud far"),
        element("empty", name="Stud empty"),
    ]
    robots = {"empty": ("kr120",), "near": ("other",)}
    tasks = [
        Task(f"t{one.id}", f"Place {one.id}", products=(one.id,), robots=robots.get(one.id, ())) for one in elements
    ]
    return {
        "model": building(*(replace(one, mass=5.0, type_name="Stud 60x120") for one in elements), tasks=tasks),
        "cell": str(ROOT / "config/work/timber_panel.yaml"),
        "robot": robot(),
        "self_collision": str(ROOT / "config/kr120_track_self_collision.yaml"),
        "planner": {**yaml.safe_load((ROOT / "config/planner.yaml").read_text()), "seed": 1},
        "cache": str(tmp_path_factory.mktemp("cache")),
    }


@pytest.fixture(scope="module")
def found(given):
    shown = io.StringIO()
    return check_all(2, Console(file=shown, force_terminal=True, width=80), **given), shown.getvalue()


def test_each_task_is_told_in_the_schedules_order_whenever_it_was_found(found):
    checked, shown = found
    assert [task.name for task in checked.tasks] == ["Place near", "Place far", "Place empty"]
    assert "checking" in shown and "100%" in shown and checked.rss_mb > 0.0


def test_a_possible_task_has_grip_track_clearance_and_time(found):
    task = found[0].tasks[0]
    assert task.possible and task.reason == "" and task.grip
    assert -2.0 <= task.track <= 2.0 and 0.0 < task.clearance and 1.0 < task.duration < 60.0


def test_what_is_out_of_reach_or_without_geometry_says_so(found):
    _, far, empty = found[0].tasks
    assert not far.possible and far.stage == "reach"
    assert not empty.possible and "found no geometry" in empty.reason


def test_the_picture_shows_what_is_possible(found):
    prepared, tasks = found[0].loaded, found[0].tasks
    picture, without = (cell_picture(shown, prepared) for shown in (tasks, [replace(tasks[0], possible=False)]))
    assert picture.startswith(b"\x89PNG") and picture != without


def test_of_another_robots_tasks_none_is_checked(given):
    checked = check_all(1, robot_name="kr121", **given)
    assert [(task.name, task.number) for task in checked.tasks] == [("Place far", 1)]


def test_a_machine_that_does_other_things_too_finds_the_same(given, found, monkeypatch):
    hours = itertools.count(0, 3600)
    clocks = SimpleNamespace(monotonic=lambda: next(hours), thread_time=time.thread_time)
    monkeypatch.setattr(worker_functions, "time", clocks)
    monkeypatch.setattr(worker_functions, "_CONTEXTS", [])
    worker_functions.load_model(**given)
    checked, _, _ = worker_functions.check(0)
    # the last digits of a distance depend on what was measured before
    clearance = pytest.approx(found[0].tasks[0].clearance, abs=1e-9)
    assert checked == replace(found[0].tasks[0], planning=checked.planning, clearance=clearance)
    assert checked.planning >= 3600


#: Checks nothing, and writes which process it is; the tenth task ends the process where that is wanted.
PROCESS = """
    import os, time
    from types import SimpleNamespace
    from construction_twin.core.worker import serve_parent

    def load_model(dies):
        schedule = SimpleNamespace(jobs=[SimpleNamespace(robots=())] * 100_000)
        return SimpleNamespace(schedule=schedule)

    def check(number):
        os.write(2, b"%d\\n" % os.getpid())
        time.sleep(0.02)
        if number == 10 and DIES:
            os.kill(os.getpid(), 9)
        return SimpleNamespace(number=number), os.getpid(), 1.0

    serve_parent({"load_model": load_model, "check": check})
"""
#: Checks with such processes for ever, or until one of them dies.
CHECK = """
    import sys
    from construction_twin.extensions.work.commands import work_check
    from construction_twin.core.worker import Worker, WorkerError

    program = (sys.executable, "-c", sys.argv[1])
    work_check.Worker = lambda _program: Worker(program)
    try:
        work_check.check_all(2, dies=True)
    except WorkerError as error:
        print(repr(error.kind), error)
"""


def alive(process: int) -> bool:
    """Return whether a process runs; one that has ended and is not waited for by whoever inherited it does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("dies", [False, True])
def test_the_processes_end_when_the_check_is_killed_or_one_of_them_is(dies):
    own = textwrap.dedent(PROCESS).replace("DIES", str(dies))
    program = [sys.executable, "-c", textwrap.dedent(CHECK), own]
    check = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    seen: set[int] = set()
    try:
        while len(seen) < 2:
            seen.add(int(check.stderr.readline()))
        if dies:
            said, _ = check.communicate(timeout=60)
            assert said.startswith("''") and "has ended" in said
    finally:
        os.kill(check.pid, signal.SIGKILL) if check.poll() is None else None
        check.communicate()
    wait_until(lambda: not any(map(alive, seen)), 20.0, "the processes to end")
