"""The folder moveit/: true to our limits and pairs, accepted by roslaunch, and complete by what MoveIt 1's setup assistant writes.

MoveIt is not installed here. Its packages are stood in for by empty ones; names of arguments, parameters and keys are compared with
lists that were taken from moveit 1.1 (moveit_setup_assistant/templates, moveit_ros, moveit_plugins) and panda_moveit_config.
"""

from __future__ import annotations

import ast
import os
import subprocess
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from construction_twin.kinematics.chain import Chain
from construction_twin.planning.waypoints import START_TOLERANCE_M, START_TOLERANCE_RAD
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.urdf import chain_joints, parse_urdf
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import checked_pairs
from construction_twin.scene.self_collision import read_self_collision

ROOT = Path(__file__).resolve().parents[3]
MOVEIT = ROOT / "moveit"
LAUNCHES = sorted((MOVEIT / "launch").glob("*.launch*"))
XACROS = {"kr120": "urdf/kr120r2500.urdf.xacro", "kr120_track": "urdf/kr120_track.urdf.xacro"}
OURS = tuple(XACROS)
#: The groups of each SRDF with their chains, base to tip; the one of all joints last.
GROUPS = {
    "kr120": {"manipulator": ("base_link", "tool0")},
    "kr120_track": {"manipulator": ("base_link", "tool0"), "manipulator_track": ("track_base", "tool0")},
}
#: MoveIt's word for each reason of a self_collision file.
REASONS = {"adjacent": "Adjacent", "always": "Always", "never": "Never"}
#: Programs of packages that a PC with MoveIt has.
STAND_INS = {
    "moveit_ros_move_group": ("move_group",),
    "rviz": ("rviz",),
    "joint_state_publisher": ("joint_state_publisher",),
    "robot_state_publisher": ("robot_state_publisher",),
}

#: Arguments of the setup assistant's launch files that a user may give, and those that ours do not have, with the reason.
ASSISTANT_ARGUMENTS = {
    "move_group.launch": {
        "debug", "info", "pipeline", "allow_trajectory_execution", "moveit_controller_manager", "fake_execution_type",
        "max_safe_path_cost", "publish_monitored_planning_scene", "capabilities", "disable_capabilities", "load_robot_description",
    },
    "demo.launch": {
        "pipeline", "db", "db_path", "debug", "load_robot_description", "moveit_controller_manager", "fake_execution_type",
        "use_gui", "use_rviz",
    },
    "planning_context.launch": {"load_robot_description", "robot_description"},
    "trajectory_execution.launch.xml": {"moveit_controller_manager", "fake_execution_type", "moveit_manage_controllers"},
    "moveit_rviz.launch": {"debug", "rviz_config"},
}  # fmt: skip
NOT_TAKEN = {
    "debug": "starts gdb",
    "db": "the warehouse is no part of this package",
    "db_path": "the same",
    "use_gui": "sliders for the joints",
    "max_safe_path_cost": "for planners with costs of sensors, of which there are none",
    "moveit_manage_controllers": "the simple manager has nothing to switch",
    ("demo.launch", "load_robot_description"): "the demo has no bringup that would",
    ("demo.launch", "moveit_controller_manager"): "the demo is the fake one",
}
#: Parameters of move_group's namespace in the assistant's files; without those of sensors.
ASSISTANT_PARAMETERS = {
    "allow_trajectory_execution", "sense_for_plan/max_safe_path_cost", "default_planning_pipeline", "capabilities",
    "disable_capabilities", "monitor_dynamics", "planning_scene_monitor/publish_planning_scene",
    "planning_scene_monitor/publish_geometry_updates", "planning_scene_monitor/publish_state_updates",
    "planning_scene_monitor/publish_transforms_updates", "moveit_manage_controllers", "moveit_controller_manager",
    "trajectory_execution/allowed_execution_duration_scaling", "trajectory_execution/allowed_goal_duration_margin",
    "trajectory_execution/allowed_start_tolerance", "controller_list", "planning_pipelines/ompl/planning_plugin",
    "planning_pipelines/ompl/request_adapters", "planning_pipelines/ompl/start_state_max_bounds_error",
}  # fmt: skip
#: Of trajectory_execution's settings (moveit_ros_planning, TrajectoryExecutionDynamicReconfigure).
EXECUTION_SETTINGS = {
    "execution_duration_monitoring", "allowed_execution_duration_scaling", "allowed_goal_duration_margin",
    "execution_velocity_scaling", "allowed_start_tolerance", "wait_for_trajectory_completion",
}  # fmt: skip
#: Keys of a joint that MoveIt or Pilz reads, of a controller's entry, of a solver, of Cartesian limits.
LIMIT_KEYS = {
    "has_position_limits", "min_position", "max_position", "has_velocity_limits", "max_velocity", "has_acceleration_limits",
    "max_acceleration",
}  # fmt: skip
CONTROLLER_KEYS = {"name", "action_ns", "type", "default", "joints"}
SOLVER_KEYS = {"kinematics_solver", "kinematics_solver_search_resolution", "kinematics_solver_timeout"}
CARTESIAN_KEYS = {"max_trans_vel", "max_trans_acc", "max_trans_dec", "max_rot_vel"}
#: Properties of the panel, as the assistant's moveit.rviz and the plug-in name them.
PANEL_PROPERTIES = {
    "Class", "Name", "Enabled", "Value", "Move Group Namespace", "Planned Path", "Planning Request", "Planning Scene Topic",
    "Robot Description", "Scene Geometry", "Scene Robot", "Velocity_Scaling_Factor", "Acceleration_Scaling_Factor",
}  # fmt: skip
#: OMPL's planners by the names that MoveIt's plug-in registers.
OMPL_PLANNERS = {
    "RRTConnect", "RRT", "RRTstar", "BiTRRT", "KPIECE", "LBKPIECE", "EST", "PRM", "PRMstar", "BITstar", "TRRT", "SBL", "STRIDE",
}  # fmt: skip


def robot_of(name: str) -> RobotModel:
    return read_robot_files(ROOT / XACROS[name], ROOT / f"config/{name}.yaml")


def srdf_of(name: str) -> ElementTree.Element:
    return ElementTree.parse(MOVEIT / "config" / name / "robot.srdf").getroot()


def joints_of(robot: RobotModel, base: str, tip: str) -> tuple[str, ...]:
    joints = chain_joints(parse_urdf(robot.urdf), base, tip)
    return tuple(joint.name for joint in joints if joint.joint_type != "fixed")


def pairs_of(root: ElementTree.Element, tag: str) -> dict[frozenset[str], str]:
    rows = [row.attrib for row in root.findall(tag)]
    pairs = {frozenset((row["link1"], row["link2"])): row.get("reason", "") for row in rows}
    assert len(pairs) == len(rows)
    return pairs


@pytest.fixture(scope="module")
def with_moveit(tmp_path_factory) -> dict[str, str]:
    """Return the environment of a PC on which MoveIt's packages are found."""
    folder = tmp_path_factory.mktemp("packages")
    for package, programs in STAND_INS.items():
        (folder / package).mkdir()
        (folder / package / "package.xml").write_text(
            f"<package format='2'><name>{package}</name><version>0.0.0</version><description>-</description>"
            "<maintainer email='a@b.invalid'>-</maintainer><license>-</license></package>"
        )
        for program in programs:
            file = folder / package / program
            file.write_text("#!/bin/sh\nexit 1\n")
            file.chmod(0o755)
    return os.environ | {"ROS_PACKAGE_PATH": f"{folder}:{os.environ['ROS_PACKAGE_PATH']}"}


def roslaunch(environment: dict[str, str], *words: str) -> str:
    command = ["roslaunch", *words]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert run.returncode == 0 and "Invalid" not in run.stderr, run.stderr
    return run.stdout


def parameters(environment: dict[str, str], *words: str) -> dict:
    return yaml.safe_load(roslaunch(environment, "--dump-params", "construction_twin", *words))


def arguments(path: Path) -> dict[str, ElementTree.Element]:
    return {arg.get("name", ""): arg for arg in ElementTree.parse(path).getroot().findall("arg")}


# -- true to our files


@pytest.mark.parametrize("name", OURS)
def test_joint_limits_are_the_robot_s(name):
    robot = robot_of(name)
    limits = yaml.safe_load((MOVEIT / "config" / name / "joint_limits.yaml").read_text())
    assert set(limits) == {"default_velocity_scaling_factor", "default_acceleration_scaling_factor", "joint_limits"}
    joints = limits["joint_limits"]
    assert list(joints) == list(robot.joint_names)
    for index, entry in enumerate(joints.values()):
        assert set(entry) == LIMIT_KEYS
        assert (entry["min_position"], entry["max_position"]) == (robot.lower[index], robot.upper[index])
        assert (entry["max_velocity"], entry["max_acceleration"]) == (robot.velocity[index], robot.acceleration[index])


@pytest.mark.parametrize("name", OURS)
def test_every_group_of_the_srdf_has_a_solver_and_planners(name):
    folder = MOVEIT / "config" / name
    groups = {group.get("name") for group in srdf_of(name).findall("group")}
    kinematics = yaml.safe_load((folder / "kinematics.yaml").read_text())
    assert set(kinematics) == groups and all(set(solver) == SOLVER_KEYS for solver in kinematics.values())
    ompl = yaml.safe_load((folder / "ompl_planning.yaml").read_text())
    planners = ompl.pop("planner_configs")
    assert set(planners) <= OMPL_PLANNERS
    assert all(settings["type"] == f"geometric::{planner}" for planner, settings in planners.items())
    assert set(ompl) == groups
    for group, chain in GROUPS[name].items():
        first, second, *_ = joints_of(robot_of(name), *chain)
        assert set(ompl[group]["planner_configs"]) == set(planners)
        assert ompl[group]["default_planner_config"] in planners
        assert ompl[group]["projection_evaluator"] == f"joints({first},{second})"


@pytest.mark.parametrize("name", OURS)
def test_groups_are_chains_of_the_urdf_and_home_is_the_robot_yaml_s(name):
    robot, root = robot_of(name), srdf_of(name)
    assert root.get("name") == parse_urdf(robot.urdf).name
    chains = {group.get("name"): group.find("chain").attrib for group in root.findall("group")}
    assert chains == {group: {"base_link": base, "tip_link": tip} for group, (base, tip) in GROUPS[name].items()}
    home = dict(zip(robot.joint_names, robot.home))
    states = {state.get("group"): state for state in root.findall("group_state")}
    for group, chain in GROUPS[name].items():
        values = {joint.get("name"): float(joint.get("value")) for joint in states[group]}
        assert states[group].get("name") == "home"
        assert values == pytest.approx({joint: home[joint] for joint in joints_of(robot, *chain)}, abs=1e-11)
    assert len(states) == len(GROUPS[name])
    (joint,) = root.findall("virtual_joint")
    assert joint.get("child_link") == parse_urdf(robot.urdf).get_root()


@pytest.mark.parametrize("name", OURS)
def test_disabled_pairs_are_those_of_the_self_collision_file(name):
    """Besides them only pairs of links that nothing moves against each other, which our check leaves out by itself."""
    robot = robot_of(name)
    ignored = read_self_collision(ROOT / f"config/{name}_self_collision.yaml", robot).ignored
    disabled = pairs_of(srdf_of(name), "disable_collisions")
    assert {pair: disabled.get(pair) for pair in ignored} == {pair: REASONS[ignored[pair]] for pair in ignored}
    joint = {body.owner: body.joint for body in RobotBodies(robot).bodies}
    assert all(len({joint[link] for link in pair}) == 1 for pair in set(disabled) - set(ignored))


@pytest.mark.parametrize("name", OURS)
def test_moveit_checks_the_pairs_of_links_that_we_check(name):
    """Its allowed collision matrix, built as MoveIt builds it: defaults, then enabled pairs, then disabled ones."""
    robot, root = robot_of(name), srdf_of(name)
    bodies = RobotBodies(robot).bodies
    defaults = {row.get("link") for row in root.findall("disable_default_collisions")}
    # they may stand on objects
    assert defaults == {body.owner for body in bodies if body.joint == 0}
    enabled, disabled = set(pairs_of(root, "enable_collisions")), set(pairs_of(root, "disable_collisions"))
    assert not enabled & disabled
    links = [link.name for link in parse_urdf(robot.urdf).links if link.collisions]
    theirs = {
        pair
        for pair in map(frozenset, combinations(links, 2))
        if pair not in disabled and (pair in enabled or not pair & defaults)
    }
    pairs = read_self_collision(ROOT / f"config/{name}_self_collision.yaml", robot)
    ours = {frozenset((bodies[one].owner, bodies[other].owner)) for one, other, _ in checked_pairs(bodies, 0.0, pairs)}
    assert theirs == ours


@pytest.mark.parametrize("name", OURS)
def test_moveit_checks_a_motion_in_steps_that_find_what_stands_in_a_cell(name):
    """MoveIt's step is this fraction of the sum of a group's ranges; joint_a1 alone sweeps the stretched arm through it."""
    robot = robot_of(name)
    ranges = dict(zip(robot.joint_names, np.subtract(robot.upper, robot.lower)))
    stretched = Chain(robot).forward([0.0] * len(ranges)).position[0]
    assert stretched > 2.5
    ompl = yaml.safe_load((MOVEIT / "config" / name / "ompl_planning.yaml").read_text())
    groups = {"manipulator": robot.joint_names[-6:], "manipulator_track": robot.joint_names}
    for group, settings in ompl.items():
        if "longest_valid_segment_fraction" in settings:
            extent = sum(ranges[joint] for joint in groups[group])
            assert settings["longest_valid_segment_fraction"] * extent * stretched < 0.25


def test_the_srdf_is_the_one_of_bringup():
    for name, words in (("kr120", []), ("kr120_track", ["track:=true"])):
        loaded = parameters(dict(os.environ), "bringup.launch", *words)["/kr120/robot_description_semantic"]
        assert loaded == (MOVEIT / "config" / name / "robot.srdf").read_text()


def test_another_arm_is_not_given_the_srdf_of_ours():
    loaded = parameters(dict(os.environ), "robot.launch", f"robot_xacro:={ROOT / 'test/data/ur_like.urdf'}")
    assert "/robot_description" in loaded and "/robot_description_semantic" not in loaded


def test_cartesian_limits_have_the_keys_of_pilz():
    limits = yaml.safe_load((MOVEIT / "config/cartesian_limits.yaml").read_text())["cartesian_limits"]
    assert set(limits) == CARTESIAN_KEYS and limits["max_trans_dec"] < 0 < limits["max_trans_acc"]


# -- started beside bringup


@pytest.mark.parametrize("path", LAUNCHES, ids=lambda path: path.name)
def test_every_argument_is_explained(path):
    assert [name for name, arg in arguments(path).items() if not arg.get("doc")] == []


@pytest.mark.parametrize("file", ["move_group.launch", "demo.launch"])
def test_ros_args_lists_them(file, with_moveit):
    said = roslaunch(with_moveit | {"COLUMNS": "80"}, "--ros-args", "construction_twin", file)
    given = [name for name, arg in arguments(MOVEIT / "launch" / file).items() if "value" not in arg.attrib]
    assert all(name in said for name in given) and "undocumented" not in said


@pytest.mark.parametrize("file", sorted(ASSISTANT_ARGUMENTS))
def test_arguments_of_the_setup_assistant_are_there(file):
    own = set(arguments(MOVEIT / "launch" / file))
    missing = ASSISTANT_ARGUMENTS[file] - own
    assert [name for name in sorted(missing) if name not in NOT_TAKEN and (file, name) not in NOT_TAKEN] == []


def test_one_command_starts_move_group_and_rviz_in_the_robot_s_namespace(with_moveit):
    nodes = roslaunch(with_moveit, "--nodes", "construction_twin", "move_group.launch", "robot:=left").split()
    assert nodes[:2] == ["/left/move_group", "/left/moveit_frame"] and len(nodes) == 3
    assert nodes[2].startswith("/left/moveit_rviz")
    without = roslaunch(with_moveit, "--nodes", "construction_twin", "move_group.launch", "use_rviz:=false").split()
    assert without == ["/kr120/move_group", "/kr120/moveit_frame"]
    assert roslaunch(with_moveit, "--args", "/left/move_group", "construction_twin", "move_group.launch", "robot:=left")


@pytest.mark.parametrize("track, root", [("false", "base_link"), ("true", "track_base")])
def test_tf_gets_the_frame_that_moveit_plans_in(track, root, with_moveit):
    words = ["--args", "/kr120/moveit_frame", "construction_twin", "move_group.launch", f"track:={track}"]
    assert f"/moveit/scripts/fixed_frame kr120/twin/{root} {root} " in roslaunch(with_moveit, *words)
    joint = srdf_of("kr120_track" if track == "true" else "kr120").find("virtual_joint")
    assert joint is not None and joint.get("child_link") == root


@pytest.fixture(scope="module")
def beside_bringup(with_moveit) -> dict:
    return parameters(with_moveit, "move_group.launch")


def below(values: dict, prefix: str) -> set[str]:
    return {name.removeprefix(prefix) for name in values if name.startswith(prefix)}


def test_move_group_gets_the_parameters_that_the_setup_assistant_gives(beside_bringup):
    given = below(beside_bringup, "/kr120/move_group/")
    assert ASSISTANT_PARAMETERS - given == set()
    assert "planning_pipelines/ompl/planner_configs/RRTConnect/type" in given
    execution = {name.split("/")[1] for name in given if name.startswith("trajectory_execution/")}
    assert execution <= EXECUTION_SETTINGS


def test_the_robot_s_description_is_left_to_bringup(beside_bringup):
    robot = {name.split("/")[2] for name in beside_bringup if name.startswith("/kr120/")}
    assert robot == {"move_group", "robot_description_planning", "robot_description_kinematics"}
    planning = below(beside_bringup, "/kr120/robot_description_planning/")
    assert "joint_limits/joint_a6/max_acceleration" in planning and "cartesian_limits/max_trans_vel" in planning
    assert "manipulator/kinematics_solver" in below(beside_bringup, "/kr120/robot_description_kinematics/")


def test_moveit_waits_for_a_person_and_begins_where_the_planner_takes_it(beside_bringup, with_moveit):
    prefix = "/kr120/move_group/trajectory_execution/"
    assert beside_bringup[f"{prefix}execution_duration_monitoring"] is False
    assert beside_bringup[f"{prefix}wait_for_trajectory_completion"] is True
    assert 0.9 * START_TOLERANCE_RAD < beside_bringup[f"{prefix}allowed_start_tolerance"] <= START_TOLERANCE_RAD
    # MoveIt has one number for all joints: on the track it is the one of metres
    on_track = parameters(with_moveit, "move_group.launch", "track:=true")
    assert on_track[f"{prefix}allowed_start_tolerance"] == START_TOLERANCE_M < START_TOLERANCE_RAD


def test_plans_are_always_timed(beside_bringup):
    """MoveIt 1.1.12 and later skips a plan without times, and says SUCCESS."""
    name = "/kr120/move_group/planning_pipelines/ompl/request_adapters"
    first, *others = beside_bringup[name].split()
    assert first == "default_planner_request_adapters/AddTimeOptimalParameterization"
    assert "default_planner_request_adapters/FixWorkspaceBounds" in others
    for file in LAUNCHES:
        assert "time_parameterization" not in arguments(file), file


@pytest.mark.parametrize("name, words", [("kr120", []), ("kr120_track", ["track:=true"])])
def test_the_controller_is_the_action_of_the_running_robot(name, words, with_moveit):
    given = parameters(with_moveit, "move_group.launch", "robot:=left", *words)
    (controller,) = given["/left/move_group/controller_list"]
    assert set(controller) == CONTROLLER_KEYS and controller["default"] is True
    # MoveIt joins the two; the name begins with a slash, so that its own namespace does not matter
    assert f"{controller['name']}/{controller['action_ns']}" == "/left/follow_joint_trajectory"
    assert controller["type"] == "FollowJointTrajectory"
    assert tuple(controller["joints"]) == robot_of(name).joint_names
    assert (
        given["/left/move_group/moveit_controller_manager"]
        == "moveit_simple_controller_manager/MoveItSimpleControllerManager"
    )


def test_pilz_is_a_pipeline_of_its_own(with_moveit):
    given = parameters(with_moveit, "move_group.launch", "pipeline:=pilz_industrial_motion_planner")
    prefix = "/kr120/move_group/planning_pipelines/"
    assert (
        given[f"{prefix}pilz_industrial_motion_planner/planning_plugin"]
        == "pilz_industrial_motion_planner::CommandPlanner"
    )
    assert given[f"{prefix}ompl/planning_plugin"] == "ompl_interface/OMPLPlanner"
    assert given["/kr120/move_group/default_planning_pipeline"] == "pilz_industrial_motion_planner"


def test_nothing_in_it_needs_this_package_to_be_built():
    """The other PC's Python is an older one; roslaunch and a checkout are all that it needs."""
    ours = {
        node.get("type")
        for path in LAUNCHES
        for node in ElementTree.parse(path).iter("node")
        if node.get("pkg") == "construction_twin"
    }
    assert ours == {"fixed_frame"} and all("rosrun" not in path.read_text() for path in LAUNCHES)
    program = MOVEIT / "scripts/fixed_frame"
    tree = ast.parse(program.read_text(), feature_version=(3, 8))
    imported = {name.name for each in ast.walk(tree) if isinstance(each, ast.Import) for name in each.names}
    imported |= {str(each.module) for each in ast.walk(tree) if isinstance(each, ast.ImportFrom)}
    assert imported == {"sys", "rospy", "geometry_msgs.msg", "tf2_msgs.msg"} and os.access(program, os.X_OK)


@pytest.mark.parametrize("file", ["move_group.launch", "demo.launch"])
def test_nothing_is_started_that_debian_12_does_not_have(file, with_moveit):
    """tf2_ros is there as a library; its programs are not."""
    for path in LAUNCHES:
        assert {node.get("pkg") for node in ElementTree.parse(path).iter("node")} <= {*STAND_INS, "construction_twin"}
    for node in roslaunch(with_moveit, "--nodes", "construction_twin", file, "use_rviz:=false").split():
        assert roslaunch(with_moveit, "--args", node, "construction_twin", file, "use_rviz:=false").split()[0]


# -- alone


@pytest.mark.parametrize("track", ["false", "true"])
def test_the_demo_brings_everything_itself(track, with_moveit):
    given = parameters(with_moveit, "demo.launch", f"track:={track}")
    name = "kr120_track" if track == "true" else "kr120"
    robot = robot_of(name)
    described, semantic = (
        ElementTree.fromstring(given[f"/kr120/robot_description{part}"]) for part in ("", "_semantic")
    )
    assert described.get("name") == semantic.get("name") and described.find("link") is not None
    assert given["/kr120/robot_description_semantic"] == (MOVEIT / "config" / name / "robot.srdf").read_text()
    (controller,) = given["/kr120/move_group/controller_list"]
    assert tuple(controller["joints"]) == robot.joint_names and controller["type"] == "interpolate"
    assert given["/kr120/move_group/initial"] == [{"group": [*GROUPS[name]][-1], "pose": "home"}]
    assert given["/kr120/joint_state_publisher/source_list"] == ["move_group/fake_controller_joint_states"]
    nodes = roslaunch(
        with_moveit, "--nodes", "construction_twin", "demo.launch", f"track:={track}", "use_rviz:=false"
    ).split()
    assert {node.split("/")[2] for node in nodes} == {
        "move_group", "joint_state_publisher", "robot_state_publisher", "world_joint",
    }  # fmt: skip


# -- the panel


def test_rviz_shows_the_panel_with_names_of_the_robot_s_namespace():
    view = yaml.safe_load((MOVEIT / "launch/moveit.rviz").read_text())["Visualization Manager"]
    (panel,) = [item for item in view["Displays"] if item["Class"] == "moveit_rviz_plugin/MotionPlanning"]
    assert set(panel) <= PANEL_PROPERTIES
    assert panel["Robot Description"] == "robot_description" and panel["Move Group Namespace"] == ""
    topics = [panel["Planning Scene Topic"], panel["Planned Path"]["Trajectory Topic"]]
    topics += [item["Marker Topic"] for item in view["Displays"] if "Marker Topic" in item]
    assert topics and not any(topic.startswith("/") for topic in topics)
    # with one robot or with two in a cell: tf knows it, and leads to the frame that MoveIt plans in
    assert view["Global Options"]["Fixed Frame"] == "world"


def test_the_folder_is_installed():
    (line,) = [
        line for line in (ROOT / "CMakeLists.txt").read_text().splitlines() if line.startswith("install(DIRECTORY")
    ]
    assert " moveit " in line
