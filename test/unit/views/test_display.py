"""display and screenshot: when there is no display it is one sentence; a view fits a robot of any name; what a picture shows."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib import image
from screenshot import COLOURS, VirtualDisplay, bare_view, fraction, read_picture

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Chain
from construction_twin.monitor.states import SyncState
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.nodes.view import connect_display, display_problem, view_for
from construction_twin.views.sync_picture import COLOURS as STATES
from construction_twin.views.sync_picture import headline_height

ROOT = Path(__file__).parents[3]
VIEWS = sorted((ROOT / "rviz").glob("*.rviz"))
#: Characters of a display's name that rviz's panel shows at its shipped width.
LONGEST_NAME = 20


def answers(_host: str, _number: int) -> None:
    """A display that is there."""


def test_without_display_one_sentence_says_so():
    problem = display_problem("", answers)
    assert problem == Sentence("view.display.none")


@pytest.mark.parametrize(
    "display, host, number",
    [(":0", "", 0), (":99.0", "", 99), ("pc:1", "pc", 1), ("localhost:10.0", "localhost", 10), ("unix:3", "", 3)],
)
def test_a_display_is_asked(display, host, number):
    asked = []
    assert display_problem(display, lambda *where: asked.append(where)) == ""
    assert asked == [(host, number)]


@pytest.mark.parametrize("display", ["0", "pc", ":x", "::1", "a:1:2"])
def test_a_display_that_makes_no_sense_is_named(display):
    assert repr(display) in display_problem(display, answers)


def test_a_display_that_does_not_answer_is_named():
    def refuses(_host, _number):
        raise ConnectionRefusedError("refused")

    assert display_problem(":7", refuses) == Sentence("view.display.silent", display=":7", problem="refused")


def test_nothing_listens_on_a_display_that_nobody_started():
    with pytest.raises(OSError):
        connect_display("", 9753)
    with pytest.raises(OSError):
        connect_display("127.0.0.1", 53000)


def test_a_virtual_display_answers_and_can_be_photographed(tmp_path):
    with VirtualDisplay((64, 48)) as display:
        name = display.environment["DISPLAY"]
        assert display_problem(name, connect_display) == ""
        assert display.capture(tmp_path / "empty.png").shape == (48, 64, 3)
    assert display_problem(name, connect_display).key == "view.display.silent"


def test_the_node_ends_well_without_a_display():
    environment = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
    run = subprocess.run(
        [sys.executable, str(ROOT / "nodes/view"), "--config", str(VIEWS[0]), "__name:=view"],
        env=environment, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert run.returncode == 0
    assert (
        run.stdout
        == "view: there is no display (DISPLAY is not set): rviz is not started, everything else goes on without it\n"
    )


def test_a_view_follows_the_robot_s_name():
    text = (ROOT / "rviz/twin.rviz").read_text()
    for word in ("/kr120/robot_description", "kr120/twin/tool0"):
        assert word in text and word.replace("kr120", "my_arm") in view_for(text, "my_arm")
    assert "kr120" not in view_for(text, "my_arm")
    two = (ROOT / "rviz/two_robots.rviz").read_text()
    assert "kr120_1/twin" in two and view_for(two, "my_arm").count("kr120_1/") == two.count("kr120_1/")


@pytest.mark.parametrize("path", VIEWS, ids=lambda path: path.stem)
def test_a_view_shows_twin_state_plan_and_scene_of_each_robot(path):
    settings = yaml.safe_load(path.read_text())["Visualization Manager"]
    groups = [display for display in settings["Displays"] if display["Class"] == "rviz/Group"]
    names = ["kr120"] if path.stem == "twin" else ["kr120_1", "kr120_2"]
    assert len(groups) == len(names)
    for name, group in zip(names, groups):
        enabled = [display for display in group["Displays"] if display["Enabled"]]
        topics = {display["Marker Topic"] for display in enabled if "Marker Topic" in display}
        assert {f"/{name}/sync_markers", f"/{name}/plan_markers", f"/{name}/scene_markers"} <= topics
        models = {display["TF Prefix"]: display["Alpha"] for display in enabled if "TF Prefix" in display}
        assert models[f"{name}/twin"] == 1 and 0 < models[f"{name}/preview"] < 1
    saved = [view["Name"] for view in settings["Views"]["Saved"]]
    assert saved[0] == "Cell" and any(view.startswith("Tool") for view in saved)


@pytest.mark.parametrize("path", VIEWS, ids=lambda path: path.stem)
def test_a_view_can_be_read(path):
    manager = yaml.safe_load(path.read_text())["Visualization Manager"]
    groups = [display for display in manager["Displays"] if display["Class"] == "rviz/Group"]
    names = [display["Name"] for group in groups for display in group["Displays"]]
    assert names and max(map(len, names)) <= LONGEST_NAME
    first = manager["Views"]["Current"]
    top = first["Focal Point"]["Z"] + first["Distance"] * math.tan(first["Field of View"] / 2)
    # the text of the sync state, the highest thing there is
    chain = Chain(read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml"))
    assert headline_height(float(chain.shoulder[2]), chain.arm_length) + 0.3 < top


def test_a_bare_view_takes_a_saved_camera_and_no_panels():
    text = (ROOT / "rviz/twin.rviz").read_text()
    bare = yaml.safe_load(bare_view(text, (640, 480), "Tool", {"Distance": 2.5}))
    current = bare["Visualization Manager"]["Views"]["Current"]
    assert (current["Target Frame"], current["Distance"]) == ("kr120/twin/tool0", 2.5)
    assert bare["Panels"] == [] and bare["Window Geometry"]["Width"] == 640
    assert bare["Visualization Manager"]["Displays"] == yaml.safe_load(text)["Visualization Manager"]["Displays"]
    with pytest.raises(ConfigurationError, match="Cell"):
        bare_view(text, (640, 480), "Nowhere")


@pytest.mark.parametrize(
    "colour, pixel",
    [
        ("orange", (0.93, 0.37, 0.05)),
        ("orange", (0.5, 0.2, 0.03)),
        ("pink", (1.0, 0.25, 0.65)),
        ("red", (0.8, 0.1, 0.12)),
        ("green", (0.3, 0.7, 0.35)),
    ],
)
def test_colours_are_told_apart(colour, pixel):
    picture = np.full((10, 10, 3), (0.92, 0.93, 0.95))
    assert all(fraction(picture, name) == 0 for name in COLOURS)
    picture[:5, :4] = pixel
    assert {name: fraction(picture, name) for name in COLOURS if fraction(picture, name)} == {colour: 0.2}


def test_states_are_looked_for_in_their_own_colours():
    for state, name in (
        (SyncState.HOLDING, "yellow"),
        (SyncState.REPLANNING, "violet"),
        (SyncState.FAULT, "red"),
        (SyncState.IN_SYNC, "green"),
    ):
        assert fraction(np.full((2, 2, 3), STATES[state][:3]), name) == 1.0


def test_a_grey_picture_has_three_channels(tmp_path):
    image.imsave(tmp_path / "grey.png", np.eye(4), cmap="gray")
    assert read_picture(tmp_path / "grey.png").shape == (4, 4, 3)
