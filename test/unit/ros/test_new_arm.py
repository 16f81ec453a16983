"""ros.commands.new_arm: one command per arm; what it writes loads, passes the checks of a start, and can be planned with."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from mesh_arm import write_mesh_arm
from new_arms import ARMS, write_arm
from roslaunch.substitution_args import resolve_args

from construction_twin.controller import makes
from construction_twin.core.freshness import Moment
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlannerSettings, PlanRequest
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.new_robot import ESTIMATED
from construction_twin.ros.commands import preflight
from construction_twin.ros.commands.new_arm import main
from construction_twin.rsi.ethernet_xml import load_ethernet_xml
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision

DATA = Path(__file__).parents[2] / "data"
QUICK = ("--samples", "400")


def made(folder: Path, urdf: Path, *options: str) -> dict[str, str]:
    """Run the command; return the values of the launch file's arguments, as roslaunch has them."""
    assert main([str(urdf), *QUICK, "--output", str(folder), *options]) == 0
    (launch,) = folder.glob("*.launch")
    return arguments(launch)


def arguments(launch: Path) -> dict[str, str]:
    """Return the launch file's arguments, with their substitutions made by roslaunch."""
    root = ElementTree.parse(launch).getroot()
    (include,) = root.findall("include")
    assert include.attrib == {"file": "$(find construction_twin)/launch/bringup.launch", "pass_all_args": "true"}
    assert all(arg.get("doc") for arg in root.findall("arg"))
    return {
        arg.get("name", ""): resolve_args(arg.get("default"), {"filename": str(launch)}) for arg in root.findall("arg")
    }


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_one_command_per_arm(arm, tmp_path, capsys):
    urdf = write_arm(tmp_path, arm)
    folder = tmp_path / "made"
    given = made(folder, urdf, "--tip", arm.tip)
    robot = read_robot_files(given["robot_xacro"], given["robot_config"])
    assert (robot.name, robot.tip_link, given["robot"]) == (arm.name, arm.tip, arm.name)
    assert [axis.name for axis in robot.axes] == arm.axes
    assert robot.estimates == ESTIMATED
    # full speed within a second, to three digits
    assert robot.acceleration == pytest.approx(robot.velocity, rel=0.005)
    assert [jerk / 10 for jerk in robot.jerk] == pytest.approx(robot.acceleration, rel=0.005)
    layout = load_ethernet_xml(given["ethernet_xml"]).layout
    assert {channel.partition(".")[2] for channel in layout.receive} - {""} == set(arm.axes)
    check_home(robot, given)
    check_start(given)
    check_planning(robot, given)
    said = capsys.readouterr().out
    assert f"{robot.name}: {len(arm.axes)} joints from {arm.base} to {arm.tip}" in said
    assert f"  roslaunch {folder / arm.name}.launch" in said and "inverse kinematics: " in said
    for key in (
        "acceleration_deg_s2",
        "jerk_deg_s3",
        "rsi, sign and offset_deg",
        "no other axis",
        "IP_NUMBER",
        "scene",
    ):
        assert key in said[said.index("a person must still fill in") :]


def test_an_arm_of_another_make_gets_no_file_that_this_one_has_not(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(makes.MODULES, "frames", "frames_make")
    folder, arm = tmp_path / "made", ARMS[0]
    given = made(folder, write_arm(tmp_path, arm), "--tip", arm.tip, "--controller-make", "frames")
    assert (given["controller_make"], given["rsi_cycle"], given.get("ethernet_xml")) == ("frames", "8", None)
    assert not list(folder.glob("*_ethernet.xml")) and "IP_NUMBER" not in capsys.readouterr().out


def robot_estimates(given: dict[str, str]) -> tuple[str, ...]:
    return read_robot_files(given["robot_xacro"], given["robot_config"]).estimates


def test_an_arm_with_a_counterbalance_that_mimic_joints_move(tmp_path, capsys):
    given = made(tmp_path / "made", DATA / "balanced_like.urdf")
    robot = read_robot_files(given["robot_xacro"], given["robot_config"])
    pairs = read_self_collision(given["self_collision"], robot)
    assert {"cylinder", "piston"} <= {link for pair in pairs.ignored for link in pair}
    said = capsys.readouterr().out
    assert "move with it: balance_cylinder (continuous, moves with shoulder), balance_piston" in said
    check_home(robot, given)
    check_start(given)
    check_planning(robot, given)


def test_an_arm_whose_joints_turn_without_end(tmp_path, capsys):
    given = made(tmp_path / "made", DATA / "endless_like.urdf")
    robot = read_robot_files(given["robot_xacro"], given["robot_config"])
    assert robot.estimates == ("accelerations", "jerks", "ranges", "axes", "couplings")
    turn = 2 * np.pi
    assert robot.lower == pytest.approx([-turn, -2.2, -turn, -2.5, -turn, -2.0, -turn])
    assert robot.upper == pytest.approx([turn, 2.2, turn, 2.5, turn, 2.0, turn])
    said = capsys.readouterr().out
    assert "range_deg of the joints that the URDF lets turn without end: from the maker" in said
    check_home(robot, given)
    check_start(given)
    check_planning(robot, given)


def check_home(robot: RobotModel, given: dict[str, str]) -> None:
    """Home is free of contact with arm and floor, away from the ends of the ranges, and not singular."""
    world = CollisionWorld(robot, read_scene(given["scene"]), read_self_collision(given["self_collision"], robot))
    assert world.contact(robot.home) is None and world.clearance(robot.home).distance > 0.01
    home, lower, upper = map(np.array, (robot.home, robot.lower, robot.upper))
    assert (np.minimum(home - lower, upper - home) > 0.05 * (upper - lower)).all()
    jacobian = Chain(robot).jacobian(robot.home)
    assert np.linalg.svd(jacobian, compute_uv=False)[min(jacobian.shape) - 1] > 0.02
    assert Chain(robot).forward(robot.home).position[2] > 0


def check_start(given: dict[str, str]) -> None:
    """What bringup.launch asks of the files before anything starts."""
    asked = given | {
        "arm": "mock",
        "decimals": "3",
        "cell": "",
        "neighbour": "",
        "bridge_account": "",
        "gateway_account": "",
    }
    assert preflight.contents_problem(asked) == ""
    assert f"estimates: found {list(robot_estimates(given))}" in preflight.contents_problem(asked | {"arm": "real"})
    entered = yaml.safe_load(Path(given["robot_config"]).read_text()) | {"estimates": []}
    file = Path(given["robot_config"]).with_name("entered.yaml")
    file.write_text(yaml.safe_dump(entered, sort_keys=False))
    assert preflight.contents_problem(asked | {"arm": "real", "robot_config": str(file)}) == ""


def check_planning(robot: RobotModel, given: dict[str, str]) -> None:
    """A motion from home of 20 degrees (50 mm) of the first joint."""
    chain = Chain(robot)
    times = iter(np.arange(0.0, 1e4, 1e-3))
    solver = inverse_kinematics(chain, IkSettings(), np.random.default_rng(0), lambda: float(next(times)))
    settings = PlannerSettings(
        planner="RRTConnect", planning_budget=5.0, edge_step=0.1, speed_scale=1.0, max_waypoints=2000,
        max_duration=600.0, seed=1,
    )  # fmt: skip
    pairs = read_self_collision(given["self_collision"], robot)
    pipeline = PlanningPipeline(robot, solver, settings, pairs, lambda: float(next(times)))
    pipeline.set_scene(read_scene(given["scene"]))
    goal = np.array(robot.home)
    goal[0] += 0.05 if robot.linear[0] else np.radians(20)
    plan = pipeline.to_joints(robot.home, goal, PlanRequest(plan_id="p1", asked=Moment("c0ffee00", 1)))
    assert plan.trajectory.positions[-1] == pytest.approx(goal, abs=1e-9)


def test_roslaunch_loads_the_whole_start(tmp_path):
    """With all that bringup.launch includes, and the commands that run while it is read: preflight, the URDF's expansion."""
    (arm,) = (arm for arm in ARMS if arm.name == "ten_kilos")
    made(tmp_path / "made", write_arm(tmp_path, arm), "--tip", arm.tip)
    run = subprocess.run(
        ["roslaunch", "--dump-params", str(tmp_path / "made/ten_kilos.launch"), "broker_port:=18977"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    loaded = yaml.safe_load(run.stdout)
    assert loaded["/preflight"] is True
    assert loaded["/ten_kilos/robot/estimates"] == list(ESTIMATED)
    assert loaded["/ten_kilos/scene/self_collision"] == f"{tmp_path}/made/ten_kilos_self_collision.yaml"
    assert "AK.A6" in loaded["/ten_kilos/gateway/ethernet_xml"]


def test_the_folder_can_be_moved_and_the_rest_of_bringup_given(tmp_path):
    arm = ARMS[0]
    made(tmp_path / "made", write_arm(tmp_path, arm), "--tip", arm.tip, "--name", "renamed")
    moved = (tmp_path / "made").rename(tmp_path / "moved with a space")
    given = arguments(moved / "renamed.launch")
    assert {Path(given[name]).parent for name in ("robot_config", "self_collision", "ethernet_xml")} == {moved}
    assert given["robot"] == "renamed" and given["scene"].endswith("/config/scene.yaml")


def test_arguments_of_a_xacro_reach_the_launch_file(tmp_path):
    urdf = write_arm(tmp_path, ARMS[0]).read_text()
    xacro = tmp_path / "arm.xacro"
    xacro.write_text(
        urdf.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1)
        .replace("<link", '<xacro:arg name="side" default="none"/>\n<link', 1)
        .replace('"joint_1"', '"$(arg side)_joint_1"')
    )
    given = made(tmp_path / "made", xacro, "--tip", ARMS[0].tip, "--xacro-args", "side=left")
    assert given["robot_xacro_args"] == "side=left"
    robot = read_robot_files(given["robot_xacro"], given["robot_config"], given["robot_xacro_args"])
    assert robot.joint_names[0] == "left_joint_1"


def test_what_a_person_has_filled_in_is_not_written_over(tmp_path, capsys):
    urdf, folder = write_arm(tmp_path, ARMS[0]), tmp_path / "made"
    made(folder, urdf, "--tip", ARMS[0].tip)
    config = folder / f"{ARMS[0].name}.yaml"
    config.write_text("mine")
    assert main([str(urdf), *QUICK, "--output", str(folder), "--tip", ARMS[0].tip]) == 1
    assert config.read_text() == "mine"
    assert f"found '{config}', expected a folder without these files" in capsys.readouterr().err
    made(folder, urdf, "--tip", ARMS[0].tip, "--force")
    assert "estimates" in config.read_text()


def test_a_floor_in_which_the_arm_cannot_stand_is_left_out_and_said(tmp_path, capsys):
    urdf = write_arm(tmp_path, ARMS[0])
    sunk = urdf.read_text().replace("<link", '<link name="plinth"/>\n<joint name="sunk" type="fixed"><parent link="plinth"/>'
        '<child link="base_link"/><origin xyz="0 0 -0.5"/></joint>\n<link', 1)  # fmt: skip
    urdf.write_text(sunk)
    given = made(tmp_path / "made", urdf, "--tip", ARMS[0].tip, "--base", "plinth")
    assert given["scene"] == "none"
    assert "scene: no pose is free with a floor at the height of plinth" in capsys.readouterr().out


def test_a_mesh_arm_comes_with_its_hulls(tmp_path, capsys):
    made(tmp_path / "made", write_mesh_arm(tmp_path))
    assert (tmp_path / "made/mesh_arm_hulls/robot.urdf").is_file()
    assert "a proposal, convex hulls in place of 5 meshes" in capsys.readouterr().out


@pytest.mark.parametrize(
    "options, change, sentence",
    [
        (
            ["--tip", "hand"],
            ("", ""),
            "tip link: found 'hand', expected a link of the URDF; links at an end of its tree: tool0",
        ),
        (["--base", "foot"], ("", ""), "base link: found 'foot', expected one of the URDF's links"),
        (["--base", "tool0", "--tip", "base_link"], ("", ""), "expected a descendant of tool0"),
        (["--tip", "base_link"], ("", ""), "expected a link that 1 to 12 joints move; 0 do"),
        ([], ('type="revolute"', 'type="floating"'), "an independent revolute, continuous or prismatic joint"),
        ([], ('velocity="', 'velocity="0" was="'), "a positive number"),
        (["--full-speed-in", "0"], ("", ""), "expected positive numbers"),
        (["--name", "My Arm"], ("", ""), "name"),
        (["--xacro-args", "a"], ("", ""), "expected words name=value"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_nothing_is_written(tmp_path, capsys, options, change, sentence):
    urdf = write_arm(tmp_path, next(arm for arm in ARMS if arm.name == "ten_kilos"))
    urdf.write_text(urdf.read_text().replace(*change) if change[0] else urdf.read_text())
    assert main([str(urdf), *QUICK, "--output", str(tmp_path / "made"), *options]) == 1
    said = capsys.readouterr().err
    assert said.startswith("new_arm: ") and sentence in said and len(said.splitlines()) == 1
    assert not list(tmp_path.glob("made/*"))


def test_a_file_that_is_not_there(capsys):
    assert main(["/nowhere.urdf"]) == 1
    assert capsys.readouterr().err.startswith("new_arm: /nowhere.urdf: ")


def test_the_command_that_it_prints_works_in_a_folder_with_a_space(tmp_path, capsys):
    urdf = write_arm(tmp_path, ARMS[0])
    folder = tmp_path / "my arms"
    made(folder, urdf, "--tip", ARMS[0].tip)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  roslaunch ")]
    assert shlex.split(line) == ["roslaunch", str(folder / f"{ARMS[0].name}.launch")]


def test_a_folder_that_takes_no_files_is_found_before_anything_is_computed(tmp_path, capsys):
    urdf = write_arm(tmp_path, ARMS[0])
    (tmp_path / "file").write_text("")
    assert main([str(urdf), "--tip", ARMS[0].tip, "--output", str(tmp_path / "file" / "made")]) == 1
    said = capsys.readouterr()
    assert said.out == "" and "expected a folder that files can be written into" in said.err
    assert said.err.count("\n") == 1
