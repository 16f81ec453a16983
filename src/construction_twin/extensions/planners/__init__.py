"""Motions that are planned elsewhere: the action FollowJointTrajectory, MoveIt's planning scene, trajectories by MQTT, CSV files.

Imports the core. The planner checks what comes in as it checks its own.
"""
