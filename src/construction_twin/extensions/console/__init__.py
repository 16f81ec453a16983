"""The console: the page's server with its pipe to the broker, and the node from which the page gets what it shows.

In: requests of browsers and by MQTT, reports of the robot on ROS. Out: files, MQTT bytes unchanged; `view`, `plan` and what else is
retained, calls of services, answers. It has no rights of its own: the broker decides who may do what. May import the core.
"""
