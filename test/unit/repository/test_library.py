"""The examples of docs/library.md: each runs as it stands, without ROS, and prints what the page says."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import genpy
import pytest
import rosbag
from construction_twin.msg import Feedback
from evaluation_samples import run
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

import construction_twin
from construction_twin.core.share import share_file
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.robot.description import read_robot_files
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.work.ifc.reading import read_building

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs/library.md").read_text()
#: Code and output of each example, by its heading.
EXAMPLES = {
    section.partition("\n")[0]: found.groups()
    for section in PAGE.split("\n## ")
    if (found := re.search(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```$", section, re.M | re.S))
}
#: Runs every example in a name space of its own, where ROS cannot be imported, and prints what each printed.
RUNNER = """
import contextlib, importlib.abc, io, json, sys, traceback

class NoRos(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top.startswith(("ros", "gen", "tf2_")) and top not in ("rosbags", "rospkg") or top.endswith("_msgs"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        if name in ("construction_twin.msg", "construction_twin.srv", "construction_twin.ros"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NoRos())
printed = {}
for heading, code in json.load(sys.stdin).items():
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        try:
            exec(compile(code, heading, "exec"), {"__name__": "example"})
        except Exception:
            traceback.print_exc(file=out)
    printed[heading] = out.getvalue()
print(json.dumps(printed))
"""


def write_bag(path: Path) -> None:
    """Write a recorded motion of 3 s whose arm lags 12 ms behind."""
    recording = run(duration=3.0)
    with rosbag.Bag(str(path), "w") as bag:
        for side in ("twin", "physical"):
            stream = getattr(recording, side)
            for stamp, position, received in zip(stream.stamps, stream.positions, stream.received):
                header = Header(stamp=genpy.Time(0, int(stamp)))
                message = JointState(header=header, name=list(recording.joint_names), position=position.tolist())
                bag.write(f"/kr120/{side}/joint_states", message, genpy.Time(0, int(received)))
        told = recording.feedback
        for stamp, position, received, seq, command in zip(
            told.stamps, told.positions, told.received, told.seq, told.command_stamps
        ):
            header, names = Header(stamp=genpy.Time(0, int(stamp))), list(recording.joint_names)
            message = Feedback(header, names, position.tolist(), int(seq), genpy.Time(0, int(command)))
            bag.write("/kr120/physical/feedback", message, genpy.Time(0, int(received)))


@pytest.fixture(scope="module")
def printed(tmp_path_factory) -> dict[str, str]:
    """What each example prints in a folder that holds `arm.urdf` and `run.bag`."""
    folder = tmp_path_factory.mktemp("elsewhere")
    shutil.copy(ROOT / "test/data/ur_like.urdf", folder / "arm.urdf")
    write_bag(folder / "run.bag")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ROS")}
    done = subprocess.run(
        [sys.executable, "-c", RUNNER],
        input=json.dumps({heading: code for heading, (code, _) in EXAMPLES.items()}),
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment | {"PYTHONPATH": str(ROOT / "src")},
        timeout=300.0,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_every_block_of_python_is_an_example_with_its_output():
    assert len(EXAMPLES) == PAGE.count("```python") == 8


@pytest.mark.parametrize("heading", EXAMPLES)
def test_an_example_prints_what_the_page_says(printed, heading):
    assert printed[heading] == EXAMPLES[heading][1]


def test_what_a_notebook_shows_of_an_object_is_short():
    robot = read_robot_files(share_file("urdf/kr120r2500.urdf.xacro"), share_file("config/kr120.yaml"))
    pipeline = PlanningPipeline(
        robot, self_collision=read_self_collision(share_file("config/kr120_self_collision.yaml"), robot)
    )
    pipeline.set_scene(Scene())
    plan = pipeline.to_joints(robot.home, [0.5, *robot.home[1:]])
    building = read_building(share_file("models/timber_panel.ifc"))
    shown = {repr(each): len(repr(each)) for each in (robot, plan, plan.trajectory, building)}
    assert max(shown.values()) < 2500, shown
    assert "kr120" in repr(robot) and f"{plan.trajectory.duration:.3f} s" in repr(plan)


def test_the_version_is_that_of_the_package():
    assert construction_twin.__version__ == ElementTree.parse(ROOT / "package.xml").findtext("version")
