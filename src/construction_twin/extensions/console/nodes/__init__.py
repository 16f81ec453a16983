"""The parts of `console_node`: what operators and programs elsewhere get to see by MQTT, and what they may ask for.

In: reports of the robot on ROS, requests by MQTT. Out: `view`, `plan` and what else is retained; calls of services, and
answers. May import the rest of ``console``, ``ros.shared`` and what that may.
"""
