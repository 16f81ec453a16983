"""ros.commands.new_arm: one command per arm; what it writes loads, passes the checks of a start, and can be planned with."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from launch_files import refusals
from roslaunch.substitution_args import resolve_args

from construction_twin.core.freshness import Moment
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlannerSettings, PlanRequest
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.new_robot import ESTIMATED
from construction_twin.ros.commands.new_arm import main
from construction_twin.rsi.ethernet_xml import load_ethernet_xml
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision

_HALF = math.pi / 2


@dataclass(frozen=True)
class Arm:
    """An arm to be written.

    Attributes:
        base, tip: Ends of the chain.
        axes: RSI axes that its joints should get.
        joints: Per joint: type, origin [m], rpy [rad], axis, lower, upper, speed [rad] or [m], and the box of its link: size,
            centre [m].
    """

    name: str
    base: str
    tip: str
    axes: list[str]
    joints: tuple


def _turn(origin, axis, lower, upper, speed, size, centre, rpy="0 0 0") -> tuple:
    return ("revolute", origin, rpy, axis, math.radians(lower), math.radians(upper), speed, size, centre)


_SIX = [f"A{number}" for number in range(1, 7)]
#: An industrial arm with a spherical wrist: 1.5 m of reach, its zero is straight up and forward.
LIGHT = Arm("light_16", "base_link", "tool0", _SIX, (
    _turn("0 0 0.35", "0 0 1", -180, 180, 2.6, "0.4 0.4 0.3", "0 0 0.1"),
    _turn("0.1 0 0.265", "0 1 0", -100, 110, 2.6, "0.2 0.2 0.7", "0 0.15 0.35"),
    _turn("0 0 0.7", "0 1 0", -60, 65, 2.6, "0.3 0.2 0.3", "0 -0.05 0.07"),
    _turn("0.25 0 0.135", "1 0 0", -200, 200, 6.2, "0.4 0.15 0.15", "0.2 0 0"),
    _turn("0.5 0 0", "0 1 0", -120, 120, 6.2, "0.12 0.1 0.1", "0 0 0"),
    _turn("0.085 0 0", "1 0 0", -400, 400, 7.8, "0.02 0.1 0.1", "0 0 0"),
))  # fmt: skip
#: A collaborative arm without a spherical wrist, 1.3 m of reach, two turns everywhere; it lies down at zero.
TEN = Arm("ten_kilos", "base_link", "tool0", _SIX, (
    _turn("0 0 0.13", "0 0 1", -360, 360, 2.1, "0.15 0.15 0.16", "0 0 0"),
    _turn("0 0.22 0", "0 1 0", -360, 360, 2.1, "0.7 0.12 0.12", "0.3 0 0"),
    _turn("0.61 -0.17 0", "0 1 0", -180, 180, 3.1, "0.62 0.1 0.1", "0.28 0 0"),
    _turn("0.57 0 0", "0 1 0", -360, 360, 3.1, "0.09 0.1 0.09", "0 0.08 0"),
    _turn("0 0.13 0", "0 0 1", -360, 360, 3.1, "0.09 0.09 0.1", "0 0 0.05"),
    _turn("0 0 0.12", "0 1 0", -360, 360, 3.1, "0.08 0.04 0.08", "0 0.06 0"),
))  # fmt: skip
#: Seven joints, whose elbow must stay bent: zero is out of range; base and tip have other names than usual.
SEVEN = Arm("seven", "seven_link0", "seven_link8", [*_SIX, "E1"], (
    _turn("0 0 0.33", "0 0 1", -165, 165, 2.2, "0.14 0.14 0.16", "0 0 -0.1"),
    _turn("0 0 0", "0 0 1", -100, 100, 2.2, "0.14 0.16 0.14", "0 -0.08 0", f"{-_HALF} 0 0"),
    _turn("0 -0.316 0", "0 0 1", -165, 165, 2.2, "0.13 0.13 0.15", "0.03 0 -0.07", f"{_HALF} 0 0"),
    _turn("0.08 0 0", "0 0 1", -175, -4, 2.2, "0.13 0.15 0.13", "-0.04 0.05 0", f"{_HALF} 0 0"),
    _turn("-0.08 0.384 0", "0 0 1", -165, 165, 2.6, "0.11 0.11 0.22", "0 0.02 -0.17", f"{-_HALF} 0 0"),
    _turn("0 0 0", "0 0 1", -1, 215, 2.6, "0.12 0.12 0.12", "0.03 0 0", f"{_HALF} 0 0"),
    _turn("0.088 0 0", "0 0 1", -165, 165, 2.6, "0.1 0.1 0.05", "0 0 0.08", f"{_HALF} 0 0"),
))  # fmt: skip
#: The light arm on a rail of 3 m: the first joint is a track.
RAIL = Arm("light_on_rail", "base_link", "tool0", ["E1", *_SIX], (
    ("prismatic", "0 0 0.3", "0 0 0", "0 1 0", -1.5, 1.5, 1.2, "0.6 0.6 0.2", "0 0 0"),
    *LIGHT.joints,
))  # fmt: skip
ARMS = (LIGHT, TEN, SEVEN, RAIL)


def write_arm(folder: Path, arm: Arm) -> Path:
    """Write an arm's URDF into a folder; return its path."""
    parts = [f'<link name="{arm.base}"/>']
    parent = arm.base
    for number, (kind, origin, rpy, axis, lower, upper, speed, size, centre) in enumerate(arm.joints, 1):
        link = f"{arm.name}_link_{number}"
        shape = f'<origin xyz="{centre}"/><geometry><box size="{size}"/></geometry>'
        parts += [
            f'<joint name="joint_{number}" type="{kind}"><parent link="{parent}"/><child link="{link}"/>',
            f'  <origin xyz="{origin}" rpy="{rpy}"/><axis xyz="{axis}"/>',
            f'  <limit lower="{lower}" upper="{upper}" velocity="{speed}" effort="100"/></joint>',
            f'<link name="{link}"><visual>{shape}</visual><collision>{shape}</collision></link>',
        ]
        parent = link
    # Z out of the flange, as KUKA's $TOOL
    flange = {"light_16": f"0 {_HALF} 0", "light_on_rail": f"0 {_HALF} 0", "ten_kilos": f"{-_HALF} 0 0"}
    parts += [
        f'<joint name="flange" type="fixed"><parent link="{parent}"/><child link="{arm.tip}"/>',
        f'  <origin xyz="0 0 0" rpy="{flange.get(arm.name, "0 0 0")}"/></joint>',
        f'<link name="{arm.tip}"/>',
    ]
    path = folder / f"{arm.name}.urdf"
    path.write_text("\n".join([f'<robot name="{arm.name}">', *parts, "</robot>", ""]))
    return path


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


def pairs_of(given: dict[str, str]) -> Path:
    """Return the file of link pairs, which lies beside the robot YAML."""
    config = Path(given["robot_config"])
    return config.with_name(f"{config.stem}_self_collision.yaml")


def robot_estimates(given: dict[str, str]) -> tuple[str, ...]:
    return read_robot_files(given["robot_xacro"], given["robot_config"]).estimates


def check_home(robot: RobotModel, given: dict[str, str]) -> None:
    """Home is free of contact with arm and floor, away from the ends of the ranges, and not singular."""
    world = CollisionWorld(robot, read_scene(given["scene"]), read_self_collision(pairs_of(given), robot))
    assert world.contact(robot.home) is None and world.clearance(robot.home).distance > 0.01
    home, lower, upper = map(np.array, (robot.home, robot.lower, robot.upper))
    assert (np.minimum(home - lower, upper - home) > 0.05 * (upper - lower)).all()
    jacobian = Chain(robot).jacobian(robot.home)
    assert np.linalg.svd(jacobian, compute_uv=False)[min(jacobian.shape) - 1] > 0.02
    assert Chain(robot).forward(robot.home).position[2] > 0


def check_start(given: dict[str, str]) -> None:
    """What the nodes of bringup.launch ask of the files before anything starts."""
    words = [f"{name}:={value}" for name, value in given.items() if value]
    words += ["broker:=false", "gateway:=false", "anonymous_broker_is_meant:=true"]
    assert refusals("bringup", *words) == {}
    (said,) = refusals("bringup", *words, "arm:=real")
    assert said.startswith(f"estimates: found {list(robot_estimates(given))}")
    entered = yaml.safe_load(Path(given["robot_config"]).read_text()) | {"estimates": []}
    file = Path(given["robot_config"]).with_name("entered.yaml")
    shutil.copy(pairs_of(given), file.with_name("entered_self_collision.yaml"))
    file.write_text(yaml.safe_dump(entered, sort_keys=False))
    assert refusals("bringup", *words, "arm:=real", f"robot_config:={file}") == {}


def check_planning(robot: RobotModel, given: dict[str, str]) -> None:
    """A motion from home of 20 degrees (50 mm) of the first joint."""
    chain = Chain(robot)
    times = iter(np.arange(0.0, 1e4, 1e-3))
    solver = inverse_kinematics(chain, IkSettings(), np.random.default_rng(0), lambda: float(next(times)))
    settings = PlannerSettings(
        planner="RRTConnect", planning_budget=5.0, edge_step=0.1, speed_scale=1.0, max_waypoints=2000,
        max_duration=600.0, seed=1,
    )  # fmt: skip
    pairs = read_self_collision(pairs_of(given), robot)
    pipeline = PlanningPipeline(robot, solver, settings, pairs, lambda: float(next(times)))
    pipeline.set_scene(read_scene(given["scene"]))
    goal = np.array(robot.home)
    goal[0] += 0.05 if robot.linear[0] else np.radians(20)
    plan = pipeline.to_joints(robot.home, goal, PlanRequest(plan_id="p1", asked=Moment("c0ffee00", 1)))
    assert plan.trajectory.positions[-1] == pytest.approx(goal, abs=1e-9)


def test_the_folder_can_be_moved_and_the_rest_of_bringup_given(tmp_path):
    arm = ARMS[0]
    made(tmp_path / "made", write_arm(tmp_path, arm), "--tip", arm.tip, "--name", "renamed")
    moved = (tmp_path / "made").rename(tmp_path / "moved with a space")
    given = arguments(moved / "renamed.launch")
    assert {Path(given[name]).parent for name in ("robot_config", "ethernet_xml")} == {moved}
    assert given["robot"] == "renamed" and given["scene"].endswith("/config/scene.yaml")


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
        ([], ('velocity="', 'velocity="0" was="'), "above 0 [rad/s]"),
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
