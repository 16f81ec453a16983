#!/usr/bin/env python3
"""A client of the action in a process and under a name of its own: sends one goal, prints state and result as JSON.

Usage: goal_client.py NAME ACTION GOAL, where GOAL is JSON: {"joints": [names], "points": [[seconds, [positions]], ...]}.
"""

import json
import sys

import actionlib
import rospy
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from trajectory_msgs.msg import JointTrajectoryPoint


def goal_message(joints, points) -> FollowJointTrajectoryGoal:
    """Return a goal through points, each a pair of time [s] and positions [rad]."""
    goal = FollowJointTrajectoryGoal()
    goal.trajectory.joint_names = list(joints)
    goal.trajectory.points = [
        JointTrajectoryPoint(positions=list(positions), time_from_start=rospy.Duration(seconds))
        for seconds, positions in points
    ]
    return goal


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
