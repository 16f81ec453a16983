"""The services an operator uses of one robot, as calls; the command line and the marker in rviz use the same ones."""

from __future__ import annotations

from collections.abc import Sequence

import rospy
from geometry_msgs.msg import Point, PoseStamped, Quaternion
from geometry_msgs.msg import Pose as PoseMsg
from std_srvs.srv import Trigger

from construction_twin.core.errors import RequestRefused, SilenceError
from construction_twin.kinematics.chain import Pose
from construction_twin.msg import CartesianWaypoint
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.ros.transport.persistent_service import PersistentService
from construction_twin.srv import (
    PlanCartesian,
    PlanFromCsv,
    PlanToJoints,
    PlanToPose,
    PreviewPlan,
    ReviewPlan,
    TakeResponsibility,
)


class OperatorClient:
    """Calls the services of one robot. Every method returns the answer's sentence.

    Every method raises `RequestRefused` with the system's sentence when the answer is no, and `SilenceError` when there is no
    answer.

    Args:
        namespace: Of the robot, absolute: ``/kr120``.
        timeout: How long to wait until a service is there [s]; an answer may take longer.
        source: Who asks, for the reviewer.
    """

    def __init__(self, namespace: str, timeout: float, source: str):
        self._namespace = namespace.rstrip("/")
        self._stop = PersistentService(f"{self._namespace}/stop", Trigger)
        self._timeout = timeout
        self._source = source

    def plan_to_joints(self, goal: Sequence[float], duration: float = 0.0, speed_scale: float = 0.0) -> str:
        """Have a motion to joint values [rad, or m] planned; 0 stands for the planner's defaults."""
        request = {"goal": list(goal), "duration": duration, "speed_scale": speed_scale}
        return self._call("plan_to_joints", PlanToJoints, source=self._source, **request)

    def plan_to_pose(
        self, pose: Pose, frame: str = "", configuration: str = "", duration: float = 0.0, speed_scale: float = 0.0
    ) -> str:
        """Have a motion planned that brings the tool to a pose in a tf frame; empty: the robot's base."""
        goal = PoseStamped(pose=pose_to_msg(pose))
        goal.header.frame_id = frame
        request = {"goal": goal, "configuration": configuration, "duration": duration, "speed_scale": speed_scale}
        return self._call("plan_to_pose", PlanToPose, source=self._source, **request)

    def plan_line(self, pose: Pose, frame: str = "", speed: float = 0.0, speed_scale: float = 0.0) -> str:
        """Have a straight line of the tool to a pose planned; `speed` of the tool [m/s], 0: as fast as the limits allow."""
        request = {"waypoints": [CartesianWaypoint(pose=pose_to_msg(pose))], "speed": speed, "speed_scale": speed_scale}
        return self._call("plan_cartesian", PlanCartesian, source=self._source, frame_id=frame, **request)

    def plan_from_csv(self, path: str, speed_scale: float = 0.0, columns: str = "") -> str:
        """Have the waypoints of a file, an absolute path on the planner's machine, checked and timed; see `waypoint_file`."""
        request = {"path": path, "speed_scale": speed_scale, "columns": columns}
        return self._call("plan_from_csv", PlanFromCsv, source=self._source, **request)

    def preview(self, speed: float = 1.0) -> str:
        """Let the ghost play the plan under review; 1: as fast as the plan."""
        return self._call("preview_plan", PreviewPlan, speed=speed, loop=False)

    def review(self, plan_id: str, plan_hash: str, approve: bool, reviewer: str, reason: str = "") -> str:
        """Approve (and so start) or reject a plan."""
        request = {"plan_id": plan_id, "plan_hash": plan_hash, "approve": approve}
        return self._call("review_plan", ReviewPlan, reviewer=reviewer, reason=reason, **request)

    def trigger(self, service: str) -> str:
        """Call `stop`, `pause`, `resume`, `reset` or `plan_way_back`.

        A stop is called at once, without waiting for the service to appear.
        """
        if service == "stop":
            try:
                return _sentence(self._stop())
            except rospy.ServiceException as error:
                rospy.logwarn("stop: no answer at once (%s); trying again", error)
        return self._call(service, Trigger)

    def arm(self, responsible: str) -> str:
        """Arm a bare PLC in the name of the person who is responsible for what is not checked."""
        return self._call("arm", TakeResponsibility, responsible=responsible)

    def _call(self, name: str, kind: type, **request) -> str:
        service = f"{self._namespace}/{name}"
        try:
            rospy.wait_for_service(service, self._timeout)
        except rospy.ROSException as error:
            problem = f"no node offers this service (waited {self._timeout:g} s)"
            raise SilenceError(service, problem, "start bringup, or see why the node is down") from error
        try:
            answer = rospy.ServiceProxy(service, kind)(**request)
        except rospy.ServiceException as error:
            raise SilenceError(service, f"the node gave no answer ({error})", "look at its log") from error
        return _sentence(answer)


def _sentence(answer) -> str:
    if not answer.success:
        raise RequestRefused(answer.message)
    return answer.message


def pose_to_msg(pose: Pose) -> PoseMsg:
    """Return the message of a pose."""
    quaternion = rotation_to_quaternion(pose.rotation).tolist()
    return PoseMsg(Point(*map(float, pose.position)), Quaternion(*quaternion))
