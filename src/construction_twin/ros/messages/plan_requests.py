"""Requests of the planner's services and topic, converted to the library's values; no parameters, no clock."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from construction_twin.core.files import read_file
from construction_twin.core.freshness import Moment, parse_moment
from construction_twin.core.motion_errors import PlanningError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.planner import PlanRequest
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.waypoint_file import parse_waypoints
from construction_twin.planning.waypoints import Waypoints, from_points
from construction_twin.planning.work_plan import in_segment
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.convert import pose_from_msg, work_segment_from_msg
from construction_twin.scene.objects import product

#: Largest CSV file [bytes]: 20000 waypoints with velocities, 15 columns of 20 characters, are 6 MiB.
_LARGEST_FILE = 16 * 2**20


def plan_request(request, plan_id: str, arrived: Moment, source: str = "request") -> PlanRequest:
    """Return the request behind any of the services'; zero and empty mean the default.

    Args:
        request: Request of PlanToJoints, PlanToPose, PlanCartesian, PlanFromCsv or PlanTrajectory
        plan_id: Of the plan to be made.
        arrived: When the request arrived; used if it does not say when it was asked for.
        source: Name of the requester if the request does not give one.

    Raises:
        PayloadError: ``moment``, of when it was asked for.
        PlanningError: If that is not before it arrived, on the same clock: then a stop between the two would not void it.
    """
    asked = parse_moment(request.asked) if getattr(request, "asked", "") else arrived
    if asked.origin != arrived.origin or asked.at > arrived.at:
        raise PlanningError(Sentence("motion.asked.elsewhere", asked=str(asked), arrived=str(arrived)))
    return PlanRequest(
        plan_id=plan_id,
        asked=asked,
        source=request.source or source,
        duration=getattr(request, "duration", None) or None,
        speed_scale=request.speed_scale or None,
        acceleration_scale=request.acceleration_scale or None,
        waypoints=getattr(request, "waypoints", None) or None,
    )


def tool_waypoints(waypoints: Iterable, base_T_frame: Pose) -> list[ToolWaypoint]:
    """Return a Cartesian path in the robot's base.

    Args:
        base_T_frame: The frame that they are given in.

    Raises:
        KinematicsError: If an orientation is not a unit quaternion.
    """
    path = []
    for msg in waypoints:
        via = base_T_frame.position + base_T_frame.rotation @ np.array((msg.via.x, msg.via.y, msg.via.z))
        pose = product(base_T_frame, pose_from_msg(msg.pose))
        path.append(ToolWaypoint(pose, via if msg.arc else None, msg.blend))
    return path


def work_segments(messages: Iterable) -> list[WorkSegment]:
    """Return the segments of a work plan that is asked for.

    Raises:
        SegmentError: If one is not a trajectory with velocities and accelerations, or its objects do not make sense; names the
            segment.
    """
    segments = []
    for number, msg in enumerate(messages):
        with in_segment(number, msg.name):
            segments.append(work_segment_from_msg(msg))
    return segments


def read_waypoints(path: str, robot: RobotModel, columns: str = "") -> Waypoints:
    """Read a CSV file of joint waypoints, whose columns are told if it does not name them; see `waypoint_file`.

    Raises:
        WaypointsError: Naming the line, the column, what was found and what was expected.
        PlanningError: If the file cannot be read.
    """
    if not Path(path).is_absolute():
        raise PlanningError(Sentence("motion.file.relative", path=repr(path)))
    try:
        text = read_file(path, _LARGEST_FILE).decode("utf-8")
    except OSError as error:
        found = Sentence("motion.file.unreadable", path=str(path), problem=str(error.strerror))
        raise PlanningError(found) from error
    except UnicodeDecodeError as error:
        raise PlanningError(Sentence("motion.file.no_text", path=str(path))) from error
    except ValueError as error:  # a null character in the path
        raise PlanningError(Sentence("motion.file.bad_path", path=repr(path), problem=str(error))) from error
    return parse_waypoints(text, robot, columns)


def trajectory_waypoints(msg: JointTrajectory, robot: RobotModel) -> Waypoints:
    """Return the waypoints of a trajectory message; raises like `waypoints.from_points`."""
    points = msg.points
    return from_points(
        robot,
        msg.joint_names,
        [point.positions for point in points],
        [point.velocities for point in points],
        [point.accelerations for point in points],
        [point.time_from_start.to_nsec() / NANOSECONDS for point in points],
    )
