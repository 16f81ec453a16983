"""display and screenshot: when there is no display it is one sentence; a view fits a robot of any name; what a picture shows."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from construction_twin.ros.nodes.view import rviz_config_for

ROOT = Path(__file__).parents[3]
VIEWS = sorted((ROOT / "rviz").glob("*.rviz"))


def test_the_node_ends_well_without_a_display():
    environment = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
    run = subprocess.run(
        [sys.executable, str(ROOT / "nodes/view"), "--config", str(VIEWS[0]), "__name:=view"],
        env=environment, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert run.returncode == 0
    assert run.stdout == "view: DISPLAY is not set: rviz is not started, everything else goes on without it\n"


def test_a_view_follows_the_robot_s_name():
    text = (ROOT / "rviz/twin.rviz").read_text()
    for word in ("/kr120/robot_description", "kr120/twin/tool0"):
        assert word in text and word.replace("kr120", "my_arm") in rviz_config_for(text, "my_arm")
    assert "kr120" not in rviz_config_for(text, "my_arm")
    below = rviz_config_for(text, "my_arm", "/cell/")
    assert (
        "Marker Topic: /cell/my_arm/sync_markers\n" in below
        and "TF Prefix: my_arm/twin\n" in below
        and ": /my_arm/" not in below
    )
    two = (ROOT / "rviz/two_robots.rviz").read_text()
    assert "kr120_1/twin" in two and rviz_config_for(two, "my_arm").count("kr120_1/") == two.count("kr120_1/")


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
