"""`new_arm`: everything that an arm needs besides its URDF, written into one folder. Needs no ROS master."""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
import rospy
import yaml

from construction_twin.controller.port import DEFAULT_MAKE, MODULES, make_of
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, command_message
from construction_twin.core.files import check_writable, write_atomically
from construction_twin.core.share import share_file, share_folder
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import inverse_kinematics
from construction_twin.robot.description import ESTIMATES, RobotModel, load_robot, other_joints_text, read_robot_files
from construction_twin.robot.new_robot import find_ends, new_description, robot_name, robot_yaml, with_home
from construction_twin.robot.urdf import expand_xacro, read_text, xacro_arguments
from construction_twin.ros.nodes.rsi_gateway import gateway_config
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.home import Home, find_home
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import (
    SAMPLES,
    SEED,
    SelfCollision,
    read_pairs,
    read_self_collision,
    sample_self_collision,
    self_collision_yaml,
)


def launch_text(values: Mapping[str, str], make: str) -> str:
    """Return a launch file that starts everything for one arm; every other argument of bringup.launch can be given to it."""
    bringup = ElementTree.parse(share_folder() / "launch" / "bringup.launch")
    docs = {arg.get("name"): arg.get("doc", "") for arg in bringup.iter("arg")}
    lines = [
        "<launch>",
        f"  <!-- {values['robot']}, its twin, and what is between them. Written by new_arm; the command stands in the robot YAML.",
        "       Takes every argument of construction_twin's bringup.launch, e.g. arm:=real, gui:=true. -->",
        *(
            f"  <arg name={quoteattr(name)} default={quoteattr(value)}\n       doc={quoteattr(docs[name])}/>"
            for name, value in values.items()
        ),
        "",
        '  <include file="$(find construction_twin)/launch/bringup.launch" pass_all_args="true"/>',
        *(
            f'  <param name="$(arg robot)/{node}/make" value={quoteattr(make)}/>'
            for node in ("gateway", "mock_rsi")
            if make != DEFAULT_MAKE
        ),
        "</launch>",
    ]
    return "\n".join([*lines, ""])


def summary(robot: RobotModel, home: Home) -> list[str]:
    """Return what was found out about an arm."""
    axes = ", ".join(f"{joint} {axis.name}" for joint, axis in zip(robot.joint_names, robot.axes))
    values = zip(robot.home, robot.linear)
    pose = ", ".join(f"{value * 1e3:g} mm" if linear else f"{math.degrees(value):.4g}" for value, linear in values)
    nearest = f"; closest {home.clearance:.3f} m ({home.between[0]} to {home.between[1]})" if home.between else ""
    others = other_joints_text(robot.other_joints, robot.base_link, robot.tip_link)
    kind = inverse_kinematics(Chain(robot)).kind
    return [
        f"{robot.name}: {len(robot.joint_names)} joints from {robot.base_link} to {robot.tip_link}: {axes}",
        *([others] if others else []),
        f"home [deg]: {pose}{nearest}",
        f"inverse kinematics: {kind.name}, because {kind.why}",
    ]


def to_do(robot: RobotModel, files: Mapping[str, Path], to_fill: str, scene_left_out: str) -> list[str]:
    """Return what a person must still fill in; `scene_left_out`: why the launch file starts without a scene, or ""."""
    reasons = {
        "accelerations": "from the maker's data sheet or controller, with your load",
        "axes": "which of the controller's axes each joint is, and which way it counts: compare with the pendant",
        "couplings": "move one joint at a time by the pendant: no other axis may change its angle there. Where one does, as with "
        "parallel linkages, this package cannot drive the arm",
        "home": "a pose that is free in your cell",
        "jerks": "from the maker, where there are any",
        "ranges": "from the maker, with hoses and cables; the joint stays inside, also where it could turn without end",
    }
    lines = [
        f"{files['robot_config'].name}, {ESTIMATES[word]}: {reasons[word]}; then take `{word}` out of `estimates`"
        for word in robot.estimates
    ]
    if "ethernet_xml" in files:
        lines.append(f"{files['ethernet_xml'].name}: {to_fill}")
    scene = "a floor at the height of the base, nothing else"
    if scene_left_out:
        scene = f"{scene_left_out}, so the launch file begins with scene:=none"
    return [*lines, f"scene: {scene}: write your own (docs/planning.md)"]


#: Poses of the first, coarse look at the arm, by which home is found.
_COARSE = 500
#: How often home is sought again after the full sampling has found pairs that the coarse one had not.
_ATTEMPTS = 5


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files of a new arm."""
    words = rospy.myargv(sys.argv)[1:] if arguments is None else list(arguments)
    if words[:1] == ["self_collision"]:
        sample_pairs(words[1:])
        return 0
    options = _parser().parse_args(words)
    try:
        for line in _write_files(options, f"rosrun construction_twin new_arm {shlex.join(words)}"):
            print(line)
    except (ConstructionTwinError, OSError) as error:
        print(f"new_arm: {command_message(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="new_arm",
        description="Write what an arm needs besides its URDF into one folder: robot YAML, the controller's file (RSI Ethernet "
        "XML), self_collision and a launch file that starts everything; say what a person must still fill in. "
        "`new_arm self_collision` makes that file again.",
    )
    parser.add_argument("urdf", type=Path, help="URDF or xacro")
    parser.add_argument("--tip", default="", metavar="LINK", help="the tool's end of the arm [tool0]")
    parser.add_argument("--base", default="", metavar="LINK", help="the other end [base_link, else the URDF's root]")
    parser.add_argument("--name", default="", help="of the robot, in ROS and MQTT: [a-z0-9_] [the URDF's]")
    parser.add_argument("--xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    parser.add_argument(
        "--controller-make", choices=tuple(MODULES), default=DEFAULT_MAKE, help="its controller [%(default)s]"
    )
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for the files [./NAME]")
    parser.add_argument(
        "--full-speed-in", type=float, default=1.0, metavar="S",
        help="estimate of the accelerations: every joint reaches its full speed in so many seconds [%(default)s]",
    )  # fmt: skip
    parser.add_argument("--samples", type=int, default=SAMPLES, help="random poses for self_collision [%(default)s]")
    parser.add_argument("--force", action="store_true", help="write over files that are there")
    return parser


def _write_files(options: argparse.Namespace, command: str) -> list[str]:
    if not 0 < options.full_speed_in < float("inf") or options.samples < 1:
        given = options.full_speed_in, options.samples
        raise ConfigurationError("--full-speed-in, --samples", given, "positive numbers")
    path = options.urdf.absolute()
    urdf = expand_xacro(path, xacro_arguments(options.xacro_args))
    base, tip = find_ends(urdf, options.base, options.tip)
    description = new_description(urdf, options.name or robot_name(urdf), base, tip, options.full_speed_in)
    robot = load_robot(urdf, description)
    folder = (options.output or Path(robot.name)).absolute()
    make = make_of(options.controller_make)
    files = {
        "robot_config": folder / f"{robot.name}.yaml",
        **({"ethernet_xml": folder / f"{robot.name}{make.file.ending}"} if make.file else {}),
        "self_collision": folder / f"{robot.name}_self_collision.yaml",
        "launch": folder / f"{robot.name}.launch",
    }
    _check_folder(folder, files, options.force)
    shipped = share_file("config/scene.yaml")
    described = {"ethernet_xml": make.file.write([axis.name for axis in robot.axes])} if make.file else {}
    # what the gateway would refuse comes before the long part
    cycle = min(make.cycles)
    settings = yaml.safe_load(read_text(share_file("config/gateway.yaml"))) | {"cycle": cycle, "make": make.name}
    gateway_config(robot, settings | described)
    coarse = sample_self_collision(robot, min(_COARSE, options.samples))
    print("looking for a home pose", file=sys.stderr, flush=True)
    scene, left_out, home = _scene(robot, coarse, read_scene(shipped))
    robot, description, pairs, home = _settle(robot, description, home, scene, options.samples)
    texts = {
        "robot_config": robot_yaml(description, command, options.full_speed_in),
        **described,
        "self_collision": self_collision_yaml(robot, pairs, options.samples, SEED),
        "launch": launch_text(
            {
                "robot": robot.name,
                "robot_xacro": str(path),
                "robot_xacro_args": options.xacro_args,
                "robot_config": f"$(dirname)/{files['robot_config'].name}",
                "ethernet_xml": f"$(dirname)/{files['ethernet_xml'].name}" if make.file else "none",
                **({"rsi_cycle": str(cycle)} if make.name != DEFAULT_MAKE else {}),
                "scene": "none" if left_out else "$(find construction_twin)/config/scene.yaml",
            },
            make.name,
        ),
    }
    for name, text in texts.items():
        files[name].write_text(text, encoding="utf-8")
    # what was written is read as everything else will read it
    read_self_collision(files["self_collision"], read_robot_files(path, files["robot_config"], options.xacro_args))
    lines = [*summary(robot, home), "written:", *(f"  {file}" for file in files.values())]
    return [
        *lines,
        "start it with the mock:",
        f"  roslaunch {shlex.quote(str(files['launch']))}",
        "a person must still fill in, before arm:=real (which is refused while `estimates` holds a word):",
        *(f"  - {line}" for line in to_do(robot, files, make.file.to_fill if make.file else "", left_out)),
    ]


def _check_folder(folder: Path, files: Mapping[str, Path], force: bool) -> None:
    check_writable(folder)
    folder.mkdir(parents=True, exist_ok=True)
    there = [file for file in files.values() if file.exists()]
    if there and not force:
        expected = (
            "a folder without these files: what a person has filled in would be lost; give another one, or --force"
        )
        raise ConfigurationError("--output", str(there[0]), expected)


def _scene(robot: RobotModel, pairs: SelfCollision, floor: Scene) -> tuple[Scene, str, Home]:
    """Return the scene that the launch file begins with, why it is empty (no pose is free with the floor), and a home in it."""
    try:
        return floor, "", find_home(CollisionWorld(robot, floor, pairs), np.random.default_rng(SEED))
    except ConfigurationError as error:
        # in contact without a floor, too: then it is not the floor's fault, and the search says so
        home = find_home(CollisionWorld(robot, Scene(), pairs), np.random.default_rng(SEED))
        return Scene(), f"no pose is free with a floor at the height of {robot.base_link} ({error.value})", home


def _settle(
    robot: RobotModel, description: dict[str, Any], home: Home, scene: Scene, samples: int
) -> tuple[RobotModel, dict[str, Any], SelfCollision, Home]:
    """Sample the arm with its home, and seek another home while the pairs that this finds are in contact there."""
    for _ in range(_ATTEMPTS):
        description = with_home(description, home.q)
        robot = load_robot(robot.urdf, description)
        pairs = sample_self_collision(robot, samples, SEED)
        world = CollisionWorld(robot, scene, pairs)
        if world.is_free(robot.home):
            measured = world.clearance(robot.home)
            home = replace(home, clearance=measured.distance, between=measured.between)
            return robot, description, pairs, home
        home = find_home(world, np.random.default_rng(SEED))
    raise ConfigurationError("home pose", home.q, f"one that {samples} samples leave free, within {_ATTEMPTS} attempts")


def sample_pairs(arguments: Sequence[str]) -> None:
    """Sample a robot's self collisions and write the file."""
    options = _pair_parser().parse_args(arguments)
    if options.samples < 1 or options.seed < 0:
        sys.exit(f"self_collision: found {options.samples} samples, seed {options.seed}; expected 1 or more, 0 or more")
    output = None if options.output == "-" else Path(options.output).absolute()
    try:
        if output is not None:
            if not output.parent.is_dir():
                raise ConfigurationError("--output", str(output), "a file in a folder that exists")
            check_writable(output.parent)
        robot = read_robot_files(options.urdf, options.robot, options.robot_xacro_args)
        _check_owner(output, robot)
        print(f"sampling {options.samples} poses", file=sys.stderr, flush=True)
        found = sample_self_collision(robot, options.samples, options.seed)
        text = self_collision_yaml(robot, found, options.samples, options.seed)
        if output is None:
            print(text, end="")
            return
        write_atomically(output, text)
        print(f"{output}: {len(found.ignored)} pairs left out, geometry {found.geometry_hash[:12]} of {robot.name}")
    except (ConstructionTwinError, OSError) as error:
        sys.exit(f"self_collision: {error}")
    except KeyboardInterrupt:
        sys.exit(130)


def _pair_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="new_arm self_collision",
        description="Find the pairs of links that need no check against each other, and write them to a YAML file.",
    )
    parser.add_argument("urdf", help="URDF or xacro")
    parser.add_argument("robot", help="robot YAML, e.g. config/kr120.yaml")
    parser.add_argument("output", help="file to write; - for the terminal")
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="random poses [%(default)s]")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the random numbers [%(default)s]")
    return parser


def _check_owner(output: Path | None, robot: RobotModel) -> None:
    """Refuse to write over the file of another arm, which would no longer start."""
    if output is None or not output.exists():
        return
    try:
        owner = read_pairs(output).robot
    except ConfigurationError:
        # half a file, or one of an older version: that it is to be written is what was asked for
        return
    if owner != robot.name:
        raise ConfigurationError(
            str(output), f"the file of robot {owner}", f"a new file for {robot.name}, or one of its own"
        )
