"""The paper's figures as data, for comparison with those of a run.

Source: Liang, McGee, Menassa and Kamat, "Bi-Directional Communication Bridge for State Synchronization between Digital
Twin Simulations and Physical Construction Robots", section 4 and Table 1. The paper does not say how it aligned the two
streams, so none of our three alignments is "the" comparable one.
"""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class PaperError:
    """One column pair of the paper's Table 1.

    Attributes:
        average, maximum: Absolute joint angle error between virtual and physical robot [rad], as printed.
    """

    average: float
    maximum: float


TABLE_1 = {
    "A1": PaperError(1.5269e-06, 1.7232e-06),
    "A2": PaperError(1.9848e-06, 2.2391e-06),
    "A3": PaperError(2.2334e-05, 2.0717e-05),
    "A4": PaperError(2.2993e-07, 2.8146e-07),
    "A5": PaperError(6.2252e-06, 7.0128e-06),
    "A6": PaperError(4.3442e-06, 3.9486e-06),
}
#: Waypoints of the virtual robot and samples of the physical robot (section 4.2).
WAYPOINTS = 1500
SAMPLES = 18802
NOTE = "the paper's Table 1 prints averages above the maxima for A3 and A6, so those two columns cannot both be right"


def axis_name(joint: str) -> str | None:
    """Return the paper's name of a joint (``joint_a1`` is ``A1``), or None when the paper has no such joint."""
    match = re.search(r"a([1-6])$", joint)
    return f"A{match.group(1)}" if match else None


def paper_error(joint: str) -> PaperError | None:
    """Return the paper's Table 1 figures of a joint, or None when the paper has no such joint."""
    axis = axis_name(joint)
    return TABLE_1[axis] if axis else None
