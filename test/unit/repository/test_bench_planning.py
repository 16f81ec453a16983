"""The planning benchmark: its problems, its independent checker, and a small run."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import numpy as np
import pytest
import yaml
from planning_cell import CHAIN, ROBOT, ROOT, SELF_COLLISION, bench_world

from construction_twin.planning.motion_validator import MotionValidator

FOLDER = ROOT / "benchmarks"
FIGURES = {
    "problems", "success", "median_ms", "p95_ms", "recheck_ms", "review_ms", "collisions", "length", "length_ratio", "duration",
    "duration_ratio", "jerk_exceeded", "jerk_usage",
}  # fmt: skip


@pytest.fixture
def bench_modules(monkeypatch):
    """Import a module of the benchmarks' folder."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


@pytest.fixture
def checker(bench_modules):
    """Return the independent checker of a scene; without python-fcl there is none."""
    pytest.importorskip("fcl", reason="python-fcl is installed by `make bench` only (setup/bench-requirements.txt)")

    def make(name: str):
        scene = yaml.safe_load((FOLDER / "problems" / f"{name}.yaml").read_text())
        return bench_modules("fcl_checker").FclChecker(ROBOT, scene, set(SELF_COLLISION.ignored))

    return make


@pytest.mark.parametrize("name", ["free", "window", "cluttered"])
def test_a_scene_has_a_hundred_different_problems_with_free_ends(bench_modules, name):
    problems = bench_modules("planning_problems").read(name)
    assert len({(*start, *goal) for start, goal in problems}) == 100
    world = bench_world(name)
    for start, goal in problems:
        ROBOT.check_range(start)
        ROBOT.check_range(goal)
        assert world.is_free(start) and world.is_free(goal)


def test_most_window_problems_go_through_the_window(bench_modules):
    problems = bench_modules("planning_problems").read("window")
    sides = [[CHAIN.forward(q).position[0] > 1.6 for q in pair] for pair in problems]
    assert sum(start != goal for start, goal in sides) >= 50
    assert sum(start and not goal for start, goal in sides) > 10  # in both directions
    assert sum(goal and not start for start, goal in sides) > 10


def test_most_straight_motions_in_the_cell_are_blocked(bench_modules):
    edges = MotionValidator(world := bench_world("cluttered"), world.levers, 0.02)
    problems = bench_modules("planning_problems").read("cluttered")
    assert sum(not edges.free(start, goal) for start, goal in problems) >= 75


@pytest.mark.parametrize("name", ["free", "window", "cluttered"])
def test_both_checkers_see_the_same_contacts(checker, name):
    world = bench_world(name)
    loose = world.with_scene(type(world.scene)(world.scene.objects, 0.0))
    qs = np.random.default_rng(3).uniform(ROBOT.lower, ROBOT.upper, (400, 6))
    touching = {row for row, _, _ in checker(name).contacts(qs)}
    assert 5 < len(touching) < 380
    free = {row for row, q in enumerate(qs) if loose.is_free(q)}
    # the world's capsules are longer than the cylinders they stand for, so it may see contacts that the checker does not
    assert not touching & free
    assert len(touching) + len(free) >= 0.95 * len(qs)


def test_a_small_run_writes_every_figure(checker, tmp_path):
    output = tmp_path / "planning.json"
    command = [sys.executable, str(FOLDER / "planning.py"), "--problems", "3", "--runs", "2", "--output", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    figures = json.loads(output.read_text())
    assert set(figures) == {"free", "window", "cluttered", "environment"}
    assert {"cpu", "packages"} <= set(figures.pop("environment"))
    for name, row in figures.items():
        assert set(row) == FIGURES and name in done.stdout
        assert (row["problems"], row["success"], row["collisions"]) == (3, 1.0, 0)
        assert row["length_ratio"] >= 1.0 and row["duration_ratio"] >= 1.0
        assert 0.0 < row["median_ms"] <= row["p95_ms"] and row["recheck_ms"] > 0.0
        assert row["median_ms"] < row["review_ms"]["median"] <= row["review_ms"]["p95"]
        assert row["jerk_exceeded"] == 0 and 0.5 < row["jerk_usage"] <= 1.0
