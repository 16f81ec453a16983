"""The bridge's side of the link: who may command, mirror mode, speed limits, and review by MQTT.

In: the gateway's status and states, requests of people, the gate's command stream. Out: the link's state, sessions, control
messages for the gateway, plans and verdicts as JSON. May import ``core``, ``mqtt`` and ``gateway``.
"""
