"""The cell PC's program between MQTT and RSI: the last line before the controller.

In: commands and control messages by MQTT, one RSI telegram every 4 ms. Out: one RSI reply per telegram, the measured state and
the gateway's status by MQTT. May import ``core``, ``mqtt``, ``rsi`` and paho-mqtt. Runs on the cell PC without ROS.
"""
