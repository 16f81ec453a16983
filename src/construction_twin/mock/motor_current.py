"""What the motors of the mock arm take for the torque that its axes give. Standard library only."""

from __future__ import annotations

import math
from collections.abc import Sequence

#: INVENTED constants: the torque at each axis that one percent of the most that its amplifier gives makes [N m]. Nobody has
#: published them of a KR 120; with these the torques of config/kr120_drives.yaml take about 80 %. That the friction of a real motor
#: takes current, too, is not simulated.
TORQUE_PER_PERCENT = {"A1": 90.0, "A2": 110.0, "A3": 95.0, "A4": 30.0, "A5": 18.0, "A6": 11.0}


def motor_currents(axes: Sequence[str], torques: Sequence[float]) -> tuple[float, ...]:
    """Return the currents of the axes' motors [%], length n; 0 for an external axis, of which no telegram tells any.

    Args:
        axes: Length n. Their names in the telegrams.
        torques: Length n. [N m], [N]
    """
    return tuple([torque / TORQUE_PER_PERCENT.get(axis, math.inf) for axis, torque in zip(axes, torques)])
