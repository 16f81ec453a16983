"""Numbers that every simulation of the arm has in common. SI."""

from __future__ import annotations

#: Length of a step [s]: a quarter of a cycle.
STEP = 0.001
#: Acceleration of gravity, along -z of the root [m/s^2] (DIN 1305).
GRAVITY = 9.80665
#: Friction of two bodies [1] of which nobody says more: wood, brick and steel lie between 0.3 and 0.6.
FRICTION = 0.4
