"""MoveIt's configuration of one robot, as the texts of its files. What is the same for every robot is in ``moveit/`` as it is.

Values in rad, m for prismatic joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from construction_twin.robot.description import RobotModel
from construction_twin.robot.planning_groups import PlanningGroup, planning_groups
from construction_twin.robot.srdf import srdf

#: OMPL's planners that are offered in rviz; the first is the default. `range: 0` lets OMPL choose.
PLANNERS: dict[str, dict[str, Any]] = {
    "RRTConnect": {"type": "geometric::RRTConnect", "range": 0.0},
    "RRT": {"type": "geometric::RRT", "range": 0.0, "goal_bias": 0.05},
    "RRTstar": {"type": "geometric::RRTstar", "range": 0.0, "goal_bias": 0.05, "delay_collision_checking": 1},
    "BiTRRT": {"type": "geometric::BiTRRT", "range": 0.0},
    "KPIECE": {"type": "geometric::KPIECE", "range": 0.0, "goal_bias": 0.05, "border_fraction": 0.9},
    "LBKPIECE": {"type": "geometric::LBKPIECE", "range": 0.0, "border_fraction": 0.9},
    "EST": {"type": "geometric::EST", "range": 0.0, "goal_bias": 0.05},
    "PRM": {"type": "geometric::PRM", "max_nearest_neighbors": 10},
    "PRMstar": {"type": "geometric::PRMstar"},
    "BITstar": {"type": "geometric::BITstar"},
}
#: Steps in which MoveIt checks a motion, as a part of the space's extent; the plan is checked here again, without gaps.
_SEGMENT = 0.002
_SEGMENT_COMMENT = (
    "longest_valid_segment_fraction: MoveIt looks for contacts at steps of this part of the sum of the joints' ranges, and\n"
    "sees nothing between them. For the KR 120 0.002 is 0.085 rad, 0.23 m at the tool where A1 alone turns the stretched arm,\n"
    "0.02 m in the median of random motions; the usual 0.005 is 0.56 m. Past clutter and through a window 84 % of its plans\n"
    "came to a review with 0.005, 92 % with 0.002, 94 % with 0.001, which takes nearly twice as long to plan\n"
    "(docs/tutorials/moveit.md)."
)
#: The action of `follow_joint_trajectory`, below the robot's name. The launch file puts the robot's namespace in.
_ACTION = "follow_joint_trajectory"


def moveit_files(robot: RobotModel, ignored: Mapping[frozenset[str], str]) -> dict[str, str]:
    """Return the files of a robot's folder below ``moveit/config``, by name.

    Args:
        ignored: As for `srdf.srdf`.

    Raises:
        ConfigurationError: As `srdf.srdf`.
    """
    groups = planning_groups(robot)
    return {
        "robot.srdf": srdf(robot, ignored),
        "joint_limits.yaml": _joint_limits(robot),
        "kinematics.yaml": _kinematics(groups),
        "ompl_planning.yaml": _ompl(groups),
        "simple_moveit_controllers.yaml": _controllers(robot),
        "fake_controllers.yaml": _fake_controllers(robot, groups),
    }


def _text(whose: str, comment: str, content: Mapping) -> str:
    head = f"# Made by `rosrun construction_twin moveit_config`{whose}; edits are lost when it is run again.\n"
    lines = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + lines + yaml.safe_dump(dict(content), sort_keys=False, width=120)


def _joint_limits(robot: RobotModel) -> str:
    rows = zip(robot.joint_names, robot.lower, robot.upper, robot.velocity, robot.acceleration)
    limits = {
        name: {
            "has_position_limits": True,
            "min_position": lower,
            "max_position": upper,
            "has_velocity_limits": True,
            "max_velocity": velocity,
            "has_acceleration_limits": True,
            "max_acceleration": acceleration,
        }
        for name, lower, upper, velocity, acceleration in rows
    }
    content = {
        "default_velocity_scaling_factor": 0.1,
        "default_acceleration_scaling_factor": 0.1,
        "joint_limits": limits,
    }
    comment = (
        "Ranges and velocities are the URDF's, accelerations the robot YAML's, in rad, m and s. MoveIt 1 knows no jerk limit: the\n"
        "planner of the twin times MoveIt's plans anew where that is too large, never faster (docs/tutorials/moveit.md)."
    )
    return _text(f" for {robot.name}", comment, content)


def _kinematics(groups: tuple[PlanningGroup, ...]) -> str:
    solver = {
        "kinematics_solver": "kdl_kinematics_plugin/KDLKinematicsPlugin",
        "kinematics_solver_search_resolution": 0.005,
        "kinematics_solver_timeout": 0.05,
    }
    return _text("", "KDL comes with MoveIt and solves any chain.", {group.name: dict(solver) for group in groups})


def _ompl(groups: tuple[PlanningGroup, ...]) -> str:
    content: dict[str, Any] = {"planner_configs": {name: dict(settings) for name, settings in PLANNERS.items()}}
    for group in groups:
        content[group.name] = {
            "default_planner_config": next(iter(PLANNERS)),
            "planner_configs": list(PLANNERS),
            "projection_evaluator": f"joints({','.join(group.joints[:2])})",
            "longest_valid_segment_fraction": _SEGMENT,
        }
    return _text("", f"Planners of OMPL, and which of them each group may use.\n{_SEGMENT_COMMENT}", content)


def _controllers(robot: RobotModel) -> str:
    controller = {
        "name": "/$(arg robot)",
        "action_ns": _ACTION,
        "type": "FollowJointTrajectory",
        "default": True,
        "joints": list(robot.joint_names),
    }
    comment = "The action server of the running robot; $(arg robot) is its namespace."
    return _text(f" for {robot.name}", comment, {"controller_list": [controller]})


def _fake_controllers(robot: RobotModel, groups: tuple[PlanningGroup, ...]) -> str:
    controller = {"name": "fake_controller", "type": "$(arg fake_execution_type)", "joints": list(robot.joint_names)}
    content = {"controller_list": [controller], "initial": [{"group": groups[-1].name, "pose": "home"}]}
    return _text(f" for {robot.name}", "For demo.launch: MoveIt alone, without robot and twin.", content)
