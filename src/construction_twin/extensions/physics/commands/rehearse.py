"""Command line: rehearses a plan with the simulated arm that has mass, and says what it found. Runs without a ROS master."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import rospy

from construction_twin.core.errors import ConstructionTwinError, command_message
from construction_twin.core.extensions import check_extras, import_extension
from construction_twin.core.freshness import Moment
from construction_twin.core.records import json_value
from construction_twin.core.share import share_file
from construction_twin.evaluation.tables import table_console
from construction_twin.extensions.physics.known_mass import TOOL, body_of, masses_of
from construction_twin.extensions.physics.process import digest, file_digest, load_rehearsal
from construction_twin.planning.waypoints import plan_waypoints
from construction_twin.review import rehearsal_report as states
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.plan import Clearance, LimitUsage, Plan, PlanReport
from construction_twin.robot.tool import read_tool
from construction_twin.robot.trajectory import Trajectory
from construction_twin.ros.commands.evaluate import read_plans
from construction_twin.scene.objects import Scene, tool_objects
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.views.rehearsal_table import rehearsal_table

#: Exit codes: the rehearsal passed, failed, or could not be made.
PASSED, FAILED, BROKEN = 0, 1, 2


def main(arguments: list[str] | None = None) -> int:
    """Rehearse the plan named on the command line; return the exit code, `BROKEN` after a sentence on standard error."""
    options = _parser().parse_args(rospy.myargv()[1:] if arguments is None else arguments)
    try:
        check_extras("physics")
        return _rehearse(options)
    # the last two: MuJoCo is not what this machine can load
    except (ConstructionTwinError, OSError, ImportError, RuntimeError) as error:
        print(f"rehearse: {command_message(error)}", file=sys.stderr)
        return BROKEN


def _rehearse(options: argparse.Namespace) -> int:
    if options.plan_id and options.plan.suffix != ".bag":
        raise _wrong("--plan-id", options.plan_id, "a bag: a file of waypoints is one plan")
    options.drives = options.drives or _drives_beside(options.robot_config)
    robot = read_robot_files(options.robot_xacro, options.robot_config, options.robot_xacro_args)
    drives = "" if options.drives == "none" else options.drives
    payload = _numbers("--payload", options.payload, "MASS or MASS,X,Y,Z [kg], [m]") if options.payload else []
    arm = load_rehearsal(robot, options.self_collision, drives, options.tool, tuple(payload))
    tool = read_tool(options.tool) if options.tool else None
    scene = read_scene(options.scene)
    if tool is not None:
        for item in tool_objects(tool, robot.tip_link):
            scene = scene.add(item)
    given_masses = dict(map(_mass, options.mass))
    bodies = {body_of(name) for name in scene.names}
    if unknown := given_masses.keys() - bodies:
        raise _wrong(
            "--mass", ", ".join(sorted(unknown)), f"bodies of the scene: {', '.join(sorted(bodies)) or 'none'}"
        )
    known = given_masses if tool is None else given_masses | {TOOL: tool.tool.mass}
    masses = masses_of(known, (scene,), arm.bodies, standing=given_masses)
    rehearsal = replace(arm, masses=masses, inputs=_inputs(options, masses))
    plan = _plan(*_trajectory(options, robot), scene)
    report = rehearsal.of_plan(plan, {scene.hash: scene}, time.perf_counter)
    if options.json:
        print(json.dumps(json_value(report), indent=2, sort_keys=True))
    else:
        table_console().print(rehearsal_table(report), soft_wrap=True)
    return {states.PASSED: PASSED, states.FAILED: FAILED}.get(report.state, BROKEN)


def _drives_beside(robot_config: str) -> str:
    """Return the drives' file beside a robot YAML, or ``none``."""
    file = Path(robot_config)
    drives = file.with_name(f"{file.stem}_drives.yaml")
    return str(drives) if drives.is_file() else "none"


def _inputs(options: argparse.Namespace, masses: Mapping[str, float]) -> str:
    """Return the hash of all inputs beside plan, scene and tool."""
    files = [file_digest(file if file != "none" else "") for file in (options.drives, options.self_collision)]
    return digest(*files, dict(sorted(masses.items())), options.payload)


def _trajectory(options: argparse.Namespace, robot: RobotModel) -> tuple[Trajectory, str]:
    """Return the motion to rehearse, and the id of its plan in the bag; empty for a file."""
    if options.plan.suffix == ".bag":
        plans = read_plans(options.plan, options.robot)
        if options.plan_id:
            plans = [plan for plan in plans if plan.id == options.plan_id]
        if not plans:
            raise ConstructionTwinError(f"no plan in {options.plan}")
        plan = plans[-1]
        if plan.trajectory.joint_names != robot.joint_names:
            raise ConstructionTwinError(
                f"plan {plan.id} has other joints than {robot.name}; give --robot-xacro and --robot-config"
            )
        return plan.trajectory, plan.id
    waypoints = import_extension("planners.waypoint_file").read_waypoints(str(options.plan.absolute()), robot)
    start = waypoints.positions[0] if len(waypoints.positions) > 1 else np.array(robot.home)
    return plan_waypoints(waypoints, start, robot), ""


def _plan(trajectory: Trajectory, plan_id: str, scene: Scene) -> Plan:
    """Return the plan of a motion, unchecked for contacts: the rehearsal checks them."""
    unknown = (float("nan"),) * len(trajectory.joint_names)
    report = PlanReport(Clearance(float("nan")), LimitUsage(unknown, unknown, unknown), 0.0)
    found = trajectory.content_hash()
    return Plan(
        plan_id or found[:12], found, "rehearse", "waypoints", scene.hash, Moment("", 0), 0.0, trajectory, report
    )


def _mass(text: str) -> tuple[str, float]:
    name, equals, mass = text.rpartition("=")
    numbers = _numbers("--mass", mass, "NAME=KG") if equals else []
    if not name or not numbers[0] > 0.0:
        raise _wrong("--mass", text, "NAME=KG")
    return name, numbers[0]


def _numbers(option: str, text: str, expected: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise _wrong(option, text, expected) from error
    if not np.isfinite(numbers).all():
        raise _wrong(option, text, expected)
    return numbers


def _wrong(option: str, found: str, expected: str) -> ConstructionTwinError:
    return ConstructionTwinError(f"{option} {found!r}: expected {expected}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evaluate rehearse",
        description="Rehearse a plan with a simulated arm that has mass: torques, payload, contacts, braking. "
        "Exit code 0: passed, 1: failed, 2: the rehearsal could not be made.",
    )
    parser.add_argument(
        "plan", type=Path, help="CSV file of waypoints, or a bag with a plan (the newest; its path alone)"
    )
    parser.add_argument("--plan-id", default="", metavar="ID", help="which plan of the bag")
    parser.add_argument("--robot", metavar="NAMESPACE", help="which robot, when the bag holds several, e.g. /kr120")
    parser.add_argument("--scene", default="none", metavar="FILE", help="scene YAML (default: nothing stands around)")
    parser.add_argument("--payload", default="", metavar="KG[,X,Y,Z]", help="mass at the flange, and its centre [m]")
    parser.add_argument(
        "--mass", action="append", default=[], metavar="NAME=KG", help="mass of a body, which can then be moved"
    )
    parser.add_argument(
        "--tool",
        default="",
        metavar="FILE",
        help="tool file: what is at the flange, what it weighs, what its cups hold",
    )
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    files = {
        "--robot-xacro": ("urdf/kr120r2500.urdf.xacro", "URDF or xacro"),
        "--robot-config": ("config/kr120.yaml", "robot YAML"),
        "--self-collision": ("config/kr120_self_collision.yaml", "YAML of the link pairs that are not checked"),
    }
    for option, (file, meaning) in files.items():
        parser.add_argument(
            option, default=str(share_file(file)), metavar="FILE", help=f"{meaning} (default: {Path(file).name})"
        )
    parser.add_argument(
        "--drives",
        metavar="FILE",
        help="YAML of the drives; none: what the URDF says (default: *_drives.yaml beside the robot YAML, else none)",
    )
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    return parser
