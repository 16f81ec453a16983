"""What the wizard `new_arm` writes and says besides the robot's own files: a launch file, and what a person must still fill in."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from construction_twin.robot.description import ESTIMATES, RobotModel
from construction_twin.robot.other_joints import other_joints_text
from construction_twin.scene.home import Home

#: What the launch file sets, with the explanation that `roslaunch --ros-args` prints.
ARGUMENTS = {
    "robot": "namespace of the robot, and its name in MQTT topics: [a-z0-9_]",
    "robot_xacro": "URDF or xacro of the arm: absolute path",
    "robot_xacro_args": "arguments of the xacro: words name=value",
    "robot_config": "robot YAML of the arm: absolute path",
    "self_collision": "YAML of the link pairs that are not checked against each other: absolute path",
    "controller_make": "make of the controller, for gateway, bridge and mock",
    "rsi_cycle": "the controller's cycle, for gateway, bridge and mock [ms]",
    "ethernet_xml": "RSI Ethernet XML of the controller, for gateway, bridge and mock: absolute path",
    "scene": "YAML of the scene, what the arm must not touch: absolute path; none: nothing but itself",
}


def launch_text(values: Mapping[str, str]) -> str:
    """Return a launch file that starts everything for one arm; every other argument of bringup.launch can be given to it.

    Args:
        values: Of those of `ARGUMENTS` that it sets.
    """
    lines = [
        "<launch>",
        f"  <!-- {values['robot']}, its twin, and what is between them. Written by new_arm; the command stands in the robot YAML.",
        "       Takes every argument of construction_twin's bringup.launch, e.g. arm:=real, gui:=true. -->",
        *(
            f"  <arg name={quoteattr(name)} default={quoteattr(values[name])}\n       doc={quoteattr(doc)}/>"
            for name, doc in ARGUMENTS.items()
            if name in values
        ),
        "",
        '  <include file="$(find construction_twin)/launch/bringup.launch" pass_all_args="true"/>',
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
    return [
        f"{robot.name}: {len(robot.joint_names)} joints from {robot.base_link} to {robot.tip_link}: {axes}",
        *([others] if others else []),
        f"home [deg]: {pose}{nearest}",
    ]


def to_do(robot: RobotModel, files: Mapping[str, Path], to_fill: str, scene_left_out: str) -> list[str]:
    """Return what a person must still fill in, one line each.

    Args:
        files: ``robot_config``, and ``ethernet_xml`` where the controller has such a file.
        to_fill: What is missing in that one.
        scene_left_out: Why the launch file starts without a scene; empty: it has one.
    """
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
    if scene_left_out:
        lines.append(
            f"scene: {scene_left_out}, so the launch file begins with scene:=none: write your own (docs/planning.md)"
        )
    else:
        lines.append("scene: a floor at the height of the base, nothing else: write your own (docs/planning.md)")
    return lines


def closing(launch: Path, lines: Sequence[str]) -> list[str]:
    """Return the last lines: how to start it, and what is missing for a real arm."""
    return [
        "start it with the mock:",
        f"  roslaunch {shlex.quote(str(launch))}",
        "a person must still fill in, before arm:=real (which is refused while `estimates` holds a word):",
        *(f"  - {line}" for line in lines),
    ]
