"""control_msgs/FollowJointTrajectory on the wire: its server, and its goals and feedback as the library's values.

control_msgs is in ROS Noetic, and not in Debian 12: there `setup/setup.sh` builds a package of that name from setup/control_msgs,
whose messages have the same md5 sums. It is imported only when a node needs it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType

import genpy
import rospy
from actionlib import ActionServer, ServerGoalHandle
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.planners.joint_tolerances import GoalError, Tolerances, check_joint_names
from construction_twin.extensions.planners.tracking import Motion, Sample
from construction_twin.extensions.planners.trajectory_goals import TrajectoryGoal
from construction_twin.robot.description import RobotModel
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber, caller_of

#: Messages kept for a client, and of clients, that are busy.
QUEUE = 50
#: How often the status of all goals is published [Hz], and how long that of a goal which has ended [s]: actionlib's own values.
STATUS_RATE, STATUS_KEPT = 5.0, 5.0


class GoalServer(ActionServer):
    """An `actionlib.ActionServer` in which an error in a callback ends the node, and a slow client holds up nothing.

    Args:
        on_goal, on_cancel: Take the goal's handle; in rospy's threads, with the server's lock held.
        recalled: Returns the result of a goal that was cancelled before it came, from a sentence.
    """

    def __init__(
        self,
        name: str,
        kind: type,
        on_goal: Callable[[ServerGoalHandle], None],
        on_cancel: Callable[[ServerGoalHandle], None],
        refused: Callable[[str, str], None],
        recalled: Callable[[str], genpy.Message],
    ):
        super().__init__(name, kind, on_goal, on_cancel, auto_start=False)
        self._refused, self._recalled = refused, recalled

    def initialize(self) -> None:
        """Connect to the five topics; called by `start`."""
        self.status_pub = Publisher(f"{self.ns}/status", GoalStatusArray, queue_size=QUEUE, latch=True)
        self.result_pub = Publisher(f"{self.ns}/result", self.ActionResult, queue_size=QUEUE)
        self.feedback_pub = Publisher(f"{self.ns}/feedback", self.ActionFeedback, queue_size=QUEUE)
        self.goal_sub = self._subscribe("goal", self.ActionGoal, self.internal_goal_callback)
        self.cancel_sub = self._subscribe("cancel", GoalID, self.internal_cancel_callback)
        self.status_list_timeout = rospy.Duration(STATUS_KEPT)
        self.status_timer = rospy.Timer(rospy.Duration(1.0 / STATUS_RATE), self.publish_status_async)

    def is_connected(self, node: str) -> bool:
        """Return whether a node still subscribes to the status; one that was cut off, for as long as TCP believes in it."""
        return any(connection.endpoint_id == node for connection in self.status_pub.impl.connections)

    def internal_cancel_callback(self, goal_id: GoalID) -> None:
        """Cancel present goals, and reset actionlib's `last_cancel`.

        actionlib drops every goal whose stamp is not later than the cancel's: a client whose clock is ahead locks the others out.
        """
        # in one: a goal that comes between the two would be dropped
        with self.lock:
            super().internal_cancel_callback(goal_id)
            self.last_cancel = rospy.Time()

    def internal_goal_callback(self, goal) -> None:
        """Accept a goal; refuse and count a repeated id.

        actionlib drops it silently; where its cancel came first, it sends a result without an error code, which means success.
        """
        with self.lock:
            there = [each for each in self.status_list if each.status.goal_id.id == goal.goal_id.id]
            if self.started and there:
                status = there[0].status
                if status.status == GoalStatus.RECALLING:
                    sentence = "cancelled before it came"
                    status.status, status.text = GoalStatus.RECALLED, sentence
                    self.publish_result(status, self._recalled(sentence))
                else:
                    sentence = "its id is that of a goal that is there; expected a new one for each goal"
                self._refused("repeated goal", f"goal {goal.goal_id.id!r} of {caller_of(goal)} dropped: {sentence}")
            super().internal_goal_callback(goal)

    def _subscribe(self, topic: str, kind: type, callback: Callable) -> Subscriber:
        return Subscriber(f"{self.ns}/{topic}", kind, callback, self._refused, queue_size=QUEUE, tcp_nodelay=True)


#: How much later than planned an arm may be allowed to reach its goal [s].
LONGEST = 600.0
#: md5 sum of FollowJointTrajectoryAction of control_msgs 1.5 (ROS Noetic), which covers all messages in it.
OFFICIAL_MD5 = "bc4f9b743838566551c0390c65f1a248"


@dataclass(frozen=True)
class GoalDefaults:
    """Defaults: tolerances at the goal, and of the time [s]."""

    goal: Tolerances
    time_tolerance: float


def control_messages() -> ModuleType:
    """Return `control_msgs.msg`: the official one where it is installed, else the one made from setup/control_msgs."""
    to_do = (
        "the package of ROS (apt-get install ros-noetic-control-msgs), or ours: cp -r $(rospack find "
        "construction_twin)/setup/control_msgs into the src folder of your workspace, and "
        "catkin_make"
    )
    try:
        messages = importlib.import_module("control_msgs.msg")
    except ImportError as error:
        raise ConfigurationError("the Python package control_msgs", f"missing ({error})", to_do) from error
    found = messages.FollowJointTrajectoryAction._md5sum
    if found != OFFICIAL_MD5:
        where = f"one in {messages.__file__} whose FollowJointTrajectoryAction has the md5 sum {found}"
        raise ConfigurationError("the Python package control_msgs", where, f"the md5 sum {OFFICIAL_MD5}: {to_do}")
    return messages


def trajectory_goal(goal, goal_id: str, client: str, robot: RobotModel, defaults: GoalDefaults) -> TrajectoryGoal:
    """Return a control_msgs/FollowJointTrajectoryGoal whose joints and tolerances were checked; its header's stamp is not used."""
    check_joint_names(robot, goal.trajectory.joint_names)
    for one in goal.path_tolerance:
        # 0 is the default, below 0 no bound: there is none
        if not (one.position <= 0.0 and one.velocity <= 0.0 and one.acceleration <= 0.0):
            raise GoalError(
                Sentence(
                    "path_tolerance asks for a bound on the path of {joint}; expected none: the gate watches the path",
                    joint=one.name,
                )
            )
    seconds = goal.goal_time_tolerance.to_nsec() / NANOSECONDS
    if not 0.0 <= seconds <= LONGEST:
        raise GoalError(
            Sentence(
                "goal_time_tolerance is {seconds:g} s; expected 0 (the default) to {longest:g}",
                seconds=seconds,
                longest=LONGEST,
            )
        )
    return TrajectoryGoal(
        goal_id,
        client,
        defaults.goal.overridden_by(robot, goal.goal_tolerance),
        seconds or defaults.time_tolerance,
        (goal.trajectory.joint_names, goal.trajectory.points),
    )


def asked_duration(trajectory: JointTrajectory) -> float:
    """Return the requested duration of a trajectory [s]; 0: none. A single point's time counts from now."""
    times = [point.time_from_start.to_nsec() / NANOSECONDS for point in trajectory.points]
    return times[-1] - (times[0] if len(times) > 1 else 0.0)


def fill_feedback(feedback, sample: Sample, plan_start: int, order: Sequence[int]) -> None:
    """Fill a control_msgs/FollowJointTrajectoryFeedback, whose joint names are set, with positions and velocities.

    `plan_start`: Stamp of the plan's first setpoint [ns]; 0: it has not begun. `order`: The goal's joints in the robot's order.
    """
    since = max(0, sample.stamp - plan_start) if plan_start else 0
    time = genpy.Duration(*divmod(since, NANOSECONDS))
    feedback.desired = _point(sample.desired, order, time)
    feedback.actual = _point(sample.actual, order, time)
    feedback.error = _point(sample.error, order, time)


def _point(motion: Motion, order: Sequence[int], time: genpy.Duration) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(
        positions=[motion.position[index] for index in order],
        velocities=[motion.velocity[index] for index in order],
        time_from_start=time,
    )
