"""The parts of `console_node`: the robot's state and requests by MQTT.

In: reports of the robot on ROS, requests by MQTT. Out: `view`, `plan` and what else is retained; calls of services, and
answers. May import the rest of ``console``, ``ros.shared`` and what that may.
"""
