"""An installation without extensions: a program that needs one says so in one sentence, and everything else works."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
#: Without programs that look at ports, so that tests may run beside each other.
QUIET = ("broker:=false", "gateway:=false")
FOR_MOVEIT = "from construction_twin.ros.nodes.scene import SceneNode; print(SceneNode._for_moveit(None, object()))"


def run(folder: Path, *words: str | Path) -> tuple[int, str, list[str]]:
    """Run a Python program; return its exit code, what it printed, and its lines of errors."""
    path = os.pathsep.join([str(ROOT / "test/support/without_extensions"), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "ROS_HOME": str(folder), "ROS_MASTER_URI": "http://127.0.0.1:1"}
    environment.pop("CONSTRUCTION_TWIN_LAUNCH", None)
    done = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True, timeout=120)
    return done.returncode, done.stdout, done.stderr.splitlines()


@pytest.mark.parametrize("words", ["work", "console", "evaluate rehearse", "evaluate identify", "experiment build"])
def test_a_program_of_an_extension_says_which_it_lacks(tmp_path, words):
    name, *rest = words.split()
    code, _, (sentence,) = run(tmp_path, ROOT / "nodes" / name, *rest)
    assert code != 0 and "which this installation is without" in sentence


@pytest.mark.parametrize("words", [(), ("console:=true", "twin:=mujoco", "rehearsal:=require")])
def test_preflight_says_ok_or_what_a_start_lacks(tmp_path, words):
    """Only what an argument asks of an extension refuses a start."""
    code, out, errors = run(tmp_path, ROOT / "nodes" / "preflight", *QUIET, *words)
    if not words:
        assert (code, out, errors) == (0, "ok\n", [])
    else:
        assert code == 1 and out == "" and len(errors) == 2
        for error, of in zip(errors, ("extension console", "(/kr120/executor, /kr120/virtual_robot)")):
            assert error.startswith("cannot start: ") and "which this installation is without" in error and of in error


def test_the_scene_is_not_published_for_moveit_without_the_planners(tmp_path):
    """Whether or not its message types are installed."""
    assert run(tmp_path, "-c", FOR_MOVEIT) == (0, "None\n", [])
