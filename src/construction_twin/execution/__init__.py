"""From an approved plan to setpoints every 4 ms: start, pause, resume, stop, hold and speed limit.

In: an approved plan, the twin's pose, reports of gate, link, scene and neighbour, speed limits. Out: one setpoint per cycle,
the executor's state and the outcome of each plan. May import ``core``, ``robot``, ``review`` and
``monitor``.
"""
