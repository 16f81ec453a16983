"""What the arm is: its description, its frames, and the trajectory and plan that it can be given.

In: URDF text and robot YAML; times and joint positions. Out: frozen records of joints, limits, poses, trajectories and plans,
and the hash by which an approval names a trajectory. May import ``core``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.robot.description import AxisMapping as AxisMapping
    from construction_twin.robot.description import JointValues as JointValues
    from construction_twin.robot.description import RobotModel as RobotModel
    from construction_twin.robot.description import home_positions as home_positions
    from construction_twin.robot.description import load_robot as load_robot
    from construction_twin.robot.description import read_robot_files as read_robot_files
    from construction_twin.robot.executed_path import ExecutedPath as ExecutedPath
    from construction_twin.robot.frames import abc_to_rotation as abc_to_rotation
    from construction_twin.robot.frames import quaternion_to_rotation as quaternion_to_rotation
    from construction_twin.robot.frames import rotation_to_abc as rotation_to_abc
    from construction_twin.robot.frames import rotation_to_quaternion as rotation_to_quaternion
    from construction_twin.robot.joint_velocities import JointVelocities as JointVelocities
    from construction_twin.robot.moveit_config import moveit_files as moveit_files
    from construction_twin.robot.new_robot import find_ends as find_ends
    from construction_twin.robot.new_robot import new_description as new_description
    from construction_twin.robot.new_robot import robot_name as robot_name
    from construction_twin.robot.new_robot import robot_of_urdf as robot_of_urdf
    from construction_twin.robot.new_robot import robot_yaml as robot_yaml
    from construction_twin.robot.new_robot import rsi_axes as rsi_axes
    from construction_twin.robot.new_robot import with_home as with_home
    from construction_twin.robot.other_joints import OtherJoint as OtherJoint
    from construction_twin.robot.packages import Packages as Packages
    from construction_twin.robot.packages import with_mesh_files as with_mesh_files
    from construction_twin.robot.plan import Clearance as Clearance
    from construction_twin.robot.plan import LimitUsage as LimitUsage
    from construction_twin.robot.plan import Plan as Plan
    from construction_twin.robot.plan import PlanReport as PlanReport
    from construction_twin.robot.plan import content_hash as content_hash
    from construction_twin.robot.segments import Segment as Segment
    from construction_twin.robot.segments import Signal as Signal
    from construction_twin.robot.segments import Switch as Switch
    from construction_twin.robot.tool import Cups as Cups
    from construction_twin.robot.tool import Place as Place
    from construction_twin.robot.tool import Tool as Tool
    from construction_twin.robot.tool import ToolFile as ToolFile
    from construction_twin.robot.tool import ToolShape as ToolShape
    from construction_twin.robot.tool import read_tool as read_tool
    from construction_twin.robot.tool import tool_of as tool_of
    from construction_twin.robot.trajectory import Trajectory as Trajectory
    from construction_twin.robot.urdf import chain_joints as chain_joints
    from construction_twin.robot.urdf import expand_xacro as expand_xacro
    from construction_twin.robot.urdf import parse_urdf as parse_urdf
    from construction_twin.robot.urdf import xacro_arguments as xacro_arguments
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
