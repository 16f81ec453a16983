"""How far orientations are apart, for assertions."""

from __future__ import annotations

import math

import numpy as np


def rotation_angle(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle between two orientations, exact also where it is tiny.

    Args:
        first, second: Shape (3, 3)

    Returns:
        [rad], 0 to pi.
    """
    # |R1 - R2|_F = 2 sqrt(2) sin(angle / 2); the usual arccos of the trace loses half the digits near 0
    chord = float(np.linalg.norm(np.asarray(first) - np.asarray(second)))
    return 2.0 * math.asin(min(1.0, chord / (2.0 * math.sqrt(2.0))))
