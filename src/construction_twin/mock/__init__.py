"""A mock robot controller, a KR C4 by default: a client of the gateway with its own clock, servo model, limits, faults on demand.

In: replies, the file that describes them, faults. Out: telegrams and the true joint positions. May import ``core``,
``servo``, ``robot``, ``kinematics``, ``controller`` and ``scene``; the servo `physics` is found by its name (`core/extensions.py`).
"""
