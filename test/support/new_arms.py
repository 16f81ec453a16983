"""URDFs of arms of the proportions of well-known ones, with round dimensions and simple shapes, for the wizard."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

_HALF = math.pi / 2


@dataclass(frozen=True)
class Arm:
    """An arm to be written.

    Attributes:
        base, tip: Ends of the chain.
        axes: RSI axes that its joints should get.
        joints: Per joint: type, origin [m], rpy [rad], axis, lower, upper, speed [rad] or [m], and the box of its link: size,
            centre [m].
    """

    name: str
    base: str
    tip: str
    axes: list[str]
    joints: tuple


def _turn(origin, axis, lower, upper, speed, size, centre, rpy="0 0 0") -> tuple:
    return ("revolute", origin, rpy, axis, math.radians(lower), math.radians(upper), speed, size, centre)


_SIX = [f"A{number}" for number in range(1, 7)]
#: An industrial arm with a spherical wrist: 1.5 m of reach, its zero is straight up and forward.
LIGHT = Arm("light_16", "base_link", "tool0", _SIX, (
    _turn("0 0 0.35", "0 0 1", -180, 180, 2.6, "0.4 0.4 0.3", "0 0 0.1"),
    _turn("0.1 0 0.265", "0 1 0", -100, 110, 2.6, "0.2 0.2 0.7", "0 0.15 0.35"),
    _turn("0 0 0.7", "0 1 0", -60, 65, 2.6, "0.3 0.2 0.3", "0 -0.05 0.07"),
    _turn("0.25 0 0.135", "1 0 0", -200, 200, 6.2, "0.4 0.15 0.15", "0.2 0 0"),
    _turn("0.5 0 0", "0 1 0", -120, 120, 6.2, "0.12 0.1 0.1", "0 0 0"),
    _turn("0.085 0 0", "1 0 0", -400, 400, 7.8, "0.02 0.1 0.1", "0 0 0"),
))  # fmt: skip
#: A collaborative arm without a spherical wrist, 1.3 m of reach, two turns everywhere; it lies down at zero.
TEN = Arm("ten_kilos", "base_link", "tool0", _SIX, (
    _turn("0 0 0.13", "0 0 1", -360, 360, 2.1, "0.15 0.15 0.16", "0 0 0"),
    _turn("0 0.22 0", "0 1 0", -360, 360, 2.1, "0.7 0.12 0.12", "0.3 0 0"),
    _turn("0.61 -0.17 0", "0 1 0", -180, 180, 3.1, "0.62 0.1 0.1", "0.28 0 0"),
    _turn("0.57 0 0", "0 1 0", -360, 360, 3.1, "0.09 0.1 0.09", "0 0.08 0"),
    _turn("0 0.13 0", "0 0 1", -360, 360, 3.1, "0.09 0.09 0.1", "0 0 0.05"),
    _turn("0 0 0.12", "0 1 0", -360, 360, 3.1, "0.08 0.04 0.08", "0 0.06 0"),
))  # fmt: skip
#: Seven joints, whose elbow must stay bent: zero is out of range; base and tip have other names than usual.
SEVEN = Arm("seven", "seven_link0", "seven_link8", [*_SIX, "E1"], (
    _turn("0 0 0.33", "0 0 1", -165, 165, 2.2, "0.14 0.14 0.16", "0 0 -0.1"),
    _turn("0 0 0", "0 0 1", -100, 100, 2.2, "0.14 0.16 0.14", "0 -0.08 0", f"{-_HALF} 0 0"),
    _turn("0 -0.316 0", "0 0 1", -165, 165, 2.2, "0.13 0.13 0.15", "0.03 0 -0.07", f"{_HALF} 0 0"),
    _turn("0.08 0 0", "0 0 1", -175, -4, 2.2, "0.13 0.15 0.13", "-0.04 0.05 0", f"{_HALF} 0 0"),
    _turn("-0.08 0.384 0", "0 0 1", -165, 165, 2.6, "0.11 0.11 0.22", "0 0.02 -0.17", f"{-_HALF} 0 0"),
    _turn("0 0 0", "0 0 1", -1, 215, 2.6, "0.12 0.12 0.12", "0.03 0 0", f"{_HALF} 0 0"),
    _turn("0.088 0 0", "0 0 1", -165, 165, 2.6, "0.1 0.1 0.05", "0 0 0.08", f"{_HALF} 0 0"),
))  # fmt: skip
#: The light arm on a rail of 3 m: the first joint is a track.
RAIL = Arm("light_on_rail", "base_link", "tool0", ["E1", *_SIX], (
    ("prismatic", "0 0 0.3", "0 0 0", "0 1 0", -1.5, 1.5, 1.2, "0.6 0.6 0.2", "0 0 0"),
    *LIGHT.joints,
))  # fmt: skip
ARMS = (LIGHT, TEN, SEVEN, RAIL)


def write_arm(folder: Path, arm: Arm) -> Path:
    """Write an arm's URDF into a folder; return its path."""
    parts = [f'<link name="{arm.base}"/>']
    parent = arm.base
    for number, (kind, origin, rpy, axis, lower, upper, speed, size, centre) in enumerate(arm.joints, 1):
        link = f"{arm.name}_link_{number}"
        shape = f'<origin xyz="{centre}"/><geometry><box size="{size}"/></geometry>'
        parts += [
            f'<joint name="joint_{number}" type="{kind}"><parent link="{parent}"/><child link="{link}"/>',
            f'  <origin xyz="{origin}" rpy="{rpy}"/><axis xyz="{axis}"/>',
            f'  <limit lower="{lower}" upper="{upper}" velocity="{speed}" effort="100"/></joint>',
            f'<link name="{link}"><visual>{shape}</visual><collision>{shape}</collision></link>',
        ]
        parent = link
    # Z out of the flange, as KUKA's $TOOL
    flange = {"light_16": f"0 {_HALF} 0", "light_on_rail": f"0 {_HALF} 0", "ten_kilos": f"{-_HALF} 0 0"}
    parts += [
        f'<joint name="flange" type="fixed"><parent link="{parent}"/><child link="{arm.tip}"/>',
        f'  <origin xyz="0 0 0" rpy="{flange.get(arm.name, "0 0 0")}"/></joint>',
        f'<link name="{arm.tip}"/>',
    ]
    path = folder / f"{arm.name}.urdf"
    path.write_text("\n".join([f'<robot name="{arm.name}">', *parts, "</robot>", ""]))
    return path
