"""A mock robot controller, a KR C4 by default: a client of the gateway with its own clock, servo model, limits, faults on demand.

In: replies, the file that describes them, faults. Out: telegrams and the true joint positions. May import ``core``,
``controller``, ``robot``, ``kinematics``, ``physics`` and ``scene``; the last two only with the servo `physics`.
"""
