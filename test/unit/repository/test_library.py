"""What the library shows of itself to whoever works with it in a notebook."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import construction_twin
from construction_twin.core.share import share_file
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.robot.description import read_robot_files
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import read_self_collision

ROOT = Path(__file__).resolve().parents[3]


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
