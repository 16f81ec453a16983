"""What a person at the arm calls a joint. Standard library only."""

from __future__ import annotations

import re

#: An axis as KUKA and ROS-Industrial name it.
_AXIS = re.compile(r"joint_([ae][1-9])")


def axis_name(joint: str) -> str:
    """Return what a person at the arm calls a joint: ``A3`` for ``joint_a3``; another name stays."""
    found = _AXIS.fullmatch(joint)
    return found[1].upper() if found else joint
