"""A mock KR C4: an RSI client with its own 4 ms clock, servo model, limits, and faults on demand.

In: RSI replies, an Ethernet XML, faults. Out: RSI telegrams and the true joint positions. May import ``core``, ``robot``,
``kinematics`` and ``rsi``.
"""
