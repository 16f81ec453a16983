#!/usr/bin/env python3
"""Goals of the action as other planners send them; and a client in a process and under a name of its own.

It sends one goal and prints state and result as JSON.

Usage: goal_client.py NAME ACTION GOAL, where GOAL is JSON: {"joints": [names], "points": [[seconds, [positions]], ...]}.
"""

import json
import sys

import actionlib
import rospy
from actionlib_msgs.msg import GoalStatus
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from trajectory_msgs.msg import JointTrajectoryPoint
from twin_client import TwinClient


def goal_message(joints, points) -> FollowJointTrajectoryGoal:
    """Return a goal through points, each a pair of time [s] and positions [rad]."""
    goal = FollowJointTrajectoryGoal()
    goal.trajectory.joint_names = list(joints)
    goal.trajectory.points = [
        JointTrajectoryPoint(positions=list(positions), time_from_start=rospy.Duration(seconds))
        for seconds, positions in points
    ]
    return goal


def reach(robot: TwinClient, goal) -> None:
    """Send a goal as another planner does, approve its plan, and wait until the client hears that it succeeded."""
    action = actionlib.SimpleActionClient("follow_joint_trajectory", FollowJointTrajectoryAction)
    assert action.wait_for_server(rospy.Duration(20.0))
    count = len(robot.plans)
    action.send_goal(goal)
    # a refusal ends the goal, and has its reason in the status
    robot.wait(lambda: len(robot.plans) > count or action.get_state() > GoalStatus.ACTIVE, "a plan")
    assert len(robot.plans) > count, action.get_goal_status_text()
    robot.approve(robot.plans[-1])
    assert action.wait_for_result(rospy.Duration(30.0)), action.get_goal_status_text()
    assert action.get_state() == GoalStatus.SUCCEEDED, action.get_goal_status_text()


def main() -> None:
    """Send the goal and wait for its result."""
    name, action, text = sys.argv[1:4]
    rospy.init_node(name)
    client = actionlib.SimpleActionClient(action, FollowJointTrajectoryAction)
    client.wait_for_server()
    given = json.loads(text)
    client.send_goal(goal_message(given["joints"], given["points"]))
    client.wait_for_result()
    result = client.get_result()
    answer = {"state": client.get_state(), "code": result.error_code, "sentence": result.error_string}
    print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
