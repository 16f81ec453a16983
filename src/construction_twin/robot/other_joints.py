"""Joints outside of the chain: a gripper's fingers, a camera's hinge, a lift below the base stand still; a mimic joint that follows
one of the chain, such as that of a piston beside the arm, moves with it.

Positions in rad, or m for prismatic joints.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from urdf_parser_py.urdf import URDF, Joint

from construction_twin.core.errors import ConfigurationError

#: The types that have one position, and its unit.
_UNITS = {"revolute": "rad", "continuous": "rad", "prismatic": "m"}


@dataclass(frozen=True)
class Following:
    """How a joint moves with a joint of the chain: ``position = factor * leader + offset``.

    Attributes:
        leader: A joint of the chain.
        factor, offset: [rad], [m]
    """

    leader: str
    factor: float
    offset: float


@dataclass(frozen=True)
class OtherJoint:
    """A movable joint of the URDF that is not between base and tip.

    Attributes:
        kind: The URDF's type.
        position: Where it stands [rad], [m]; None for a mimic joint that moves with a joint of the chain.
        follows: For a mimic joint the joint it names, which may itself follow another; otherwise empty.
        following: How it moves, where `position` is None.
    """

    name: str
    kind: str
    position: float | None
    follows: str
    following: Following | None = None

    def __str__(self) -> str:
        if self.position is None:
            return f"{self.name} ({self.kind}, moves with {self.follows})"
        place = f", at {self.position:.6g} {_UNITS[self.kind]}" if self.kind in _UNITS else ""
        return f"{self.name} ({self.kind}{place}{f', follows {self.follows}' if self.follows else ''})"


def find_other_joints(model: URDF, chain: Collection[str], given: Mapping[str, float]) -> tuple[OtherJoint, ...]:
    """Return the movable joints outside of the chain, in the URDF's order.

    Args:
        chain: The joints of the chain, fixed ones need not be among them.
        given: Where they stand [rad], [m], by name: ``other_joints`` of the robot YAML. Others stand at zero, or, where their range
            does not hold it, in its middle; mimic joints follow.
    """
    others = {joint.name: joint for joint in model.joints if joint.joint_type != "fixed" and joint.name not in chain}
    settable = [name for name, joint in others.items() if joint.mimic is None and joint.joint_type in _UNITS]
    for name, value in given.items():
        _check_taker(name, value, others, settable)
    found = []
    for name, joint in others.items():
        place = _position(joint, others, chain, given)
        still, follows = (None, place) if isinstance(place, Following) else (place, None)
        found.append(OtherJoint(name, joint.joint_type, still, joint.mimic.joint if joint.mimic else "", follows))
    return tuple(found)


def other_joints_text(others: Sequence[OtherJoint], base_link: str, tip_link: str) -> str:
    """Return the sentence that tells a person about them; empty when there are none."""
    still = [str(joint) for joint in others if joint.position is not None]
    moving = [str(joint) for joint in others if joint.position is None]
    if not others:
        return ""
    parts = []
    if still:
        parts.append(f"stand still: {', '.join(still)}; `other_joints` of the robot YAML says where")
    if moving:
        parts.append(f"{'others ' * bool(still)}move with it: {', '.join(moving)}")
    return f"joints outside of the chain from {base_link} to {tip_link} {'; '.join(parts)}"


def _check_taker(name: str, value: float, others: Mapping[str, Joint], settable: Sequence[str]) -> None:
    where = f"robot/other_joints/{name}"
    if name not in others:
        expected = f"one of the joints outside of the chain that take a value: {list(settable)}"
        raise ConfigurationError(where, value, expected)
    joint = others[name]
    if joint.mimic is not None:
        raise ConfigurationError(where, value, f"no value: it follows {joint.mimic.joint}")
    if joint.joint_type not in _UNITS:
        raise ConfigurationError(where, value, f"no value: a {joint.joint_type} joint stands at zero")


def _position(
    joint: Joint, others: Mapping[str, Joint], chain: Collection[str], given: Mapping[str, float]
) -> float | Following:
    factor, offset, passed = 1.0, 0.0, [joint.name]
    while joint.mimic is not None:
        leader = joint.mimic.joint
        where = f"URDF joint {joint.name} mimic"
        if leader in passed:
            raise ConfigurationError(where, leader, "a joint that does not follow it")
        if leader not in others and leader not in chain:
            raise ConfigurationError(where, leader, "a movable joint of the URDF")
        # the attributes are optional
        offset += factor * float(joint.mimic.offset or 0.0)
        factor *= 1.0 if joint.mimic.multiplier is None else float(joint.mimic.multiplier)
        if leader in chain:
            return Following(leader, factor, offset)
        passed.append(leader)
        joint = others[leader]
    return factor * _stands_at(joint, given.get(joint.name)) + offset


def _stands_at(joint: Joint, given: float | None) -> float:
    if joint.joint_type not in _UNITS:
        return 0.0
    if joint.joint_type == "continuous":
        return given or 0.0
    unit, limit = _UNITS[joint.joint_type], joint.limit
    where = f"URDF joint {joint.name} limit"
    if limit is None:
        raise ConfigurationError(where, None, f"lower and upper [{unit}]")
    lower, upper = float(limit.lower or 0.0), float(limit.upper or 0.0)
    if not (math.isfinite(lower) and math.isfinite(upper) and lower <= upper):
        raise ConfigurationError(where, f"lower {lower}, upper {upper}", f"finite ones, lower <= upper [{unit}]")
    if given is None:
        # as joint_state_publisher, which shows the twin's
        return 0.0 if lower <= 0.0 <= upper else (lower + upper) / 2.0
    if not lower <= given <= upper:
        raise ConfigurationError(
            f"robot/other_joints/{joint.name}",
            given,
            f"{lower:g} to {upper:g} [{unit}]",
        )
    return given
