"""The cell PC's program between MQTT and a robot controller: the last line before the controller.

In: commands and control messages by MQTT, one telegram every cycle. Out: one reply per telegram, the measured state and
the gateway's status by MQTT. May import ``core``, ``controller``, ``mqtt`` and paho-mqtt. Runs on the cell PC without ROS.
"""
