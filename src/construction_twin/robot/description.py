"""One robot: joints, limits, home pose and its joints on the wire and in RSI.

From the URDF, and from one YAML file, whose keys carry their unit: deg, mm for prismatic joints. Inside everything is SI: rad, or m
where `RobotModel.linear` is True.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from urdf_parser_py.urdf import URDF, Joint

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import radians
from construction_twin.robot.motion_errors import JointRangeError
from construction_twin.robot.urdf import chain_joints, expand_xacro, parse_urdf, read_yaml, xacro_arguments
from construction_twin.validation import StrictModel

#: A joint vector, shape (n,), as callers may pass it; functions that calculate with it convert it.
JointValues = Sequence[float] | np.ndarray

#: What the robot YAML's `estimates` may name, with the keys of a joint that it is about.
ESTIMATES = {
    "accelerations": "acceleration_deg_s2 (or _mm_s2)",
    "jerks": "jerk_deg_s3 (or _mm_s3)",
    "ranges": "range_deg of the joints that the URDF lets turn without end",
    "axes": "rsi, sign and offset_deg (or _mm)",
    "couplings": "rsi of axes that are coupled at the controller",
    "home": "home_deg (or _mm)",
}
#: Largest range of a joint that turns without end: angles further from zero lose digits on the wire [deg].
_MOST_TURNED = 3600.0

#: What no revolute joint reaches [rad]: the joint string carries less than 1000 deg.
_MOST_RADIANS = math.radians(1000.0)
#: The types that have one position, and its unit.
_UNITS = {"revolute": "rad", "continuous": "rad", "prismatic": "m"}

_Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
_Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]
_Turned = Annotated[float, pydantic.Field(ge=-_MOST_TURNED, le=_MOST_TURNED)]


@dataclass(frozen=True)
class Following:
    """How a joint moves with a joint of the chain: ``position = factor * leader + offset`` [rad], [m]."""

    leader: str
    factor: float
    offset: float


@dataclass(frozen=True)
class OtherJoint:
    """A movable joint outside of the chain; `position` None: it moves as `following` says. `follows`: the joint a mimic names."""

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


@dataclass(frozen=True)
class AxisMapping:
    """How a joint appears on the wire and in RSI, as axis ``A1``, or ``E1``: ``rsi_value = sign * q + offset`` [rad], [m]."""

    name: str
    sign: int
    offset: float


@dataclass(frozen=True)
class RobotModel:
    """A robot's description; joint tuples in the order of `joint_names`, from base to tip, m for rad where `linear` is True.

    Attributes:
        urdf: Expanded XML text.
        velocity, acceleration, jerk: [rad/s], [rad/s^2], [rad/s^3]
        estimates: Which values are estimates, some of `ESTIMATES`: a real arm must not move by them.
    """

    name: str
    urdf: str = field(repr=False)
    base_link: str
    tip_link: str
    joint_names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]
    home: tuple[float, ...]
    axes: tuple[AxisMapping, ...]
    linear: tuple[bool, ...]
    other_joints: tuple[OtherJoint, ...] = ()
    estimates: tuple[str, ...] = ()

    @property
    def axis_ranges(self) -> list[list[float]]:
        """Lower and upper end of each of the controller's axes [rad], [m]."""
        return [sorted(ends) for ends in zip(self.to_axes(self.lower), self.to_axes(self.upper))]

    def to_axes(self, q: Sequence[float]) -> tuple[float, ...]:
        """Convert joint values to positions of the controller's axes [rad], [m]."""
        return tuple(axis.sign * value + axis.offset for axis, value in zip(self.axes, q))

    def from_axes(self, positions: Sequence[float]) -> tuple[float, ...]:
        """Convert positions of the controller's axes to joint values [rad], [m]."""
        return tuple(axis.sign * (value - axis.offset) for axis, value in zip(self.axes, positions))

    def check_range(self, q: JointValues, beyond: tuple[float, float] = (0.0, 0.0)) -> None:
        """Raise JointRangeError for the first joint outside its range by more than `beyond` [rad], [m], or nan."""
        if len(q) != len(self.joint_names):
            raise ValueError(f"{len(q)} joint values for {len(self.joint_names)} joints of {self.name}")
        for joint, value, lower, upper, linear in zip(self.joint_names, q, self.lower, self.upper, self.linear):
            if not lower - beyond[linear] <= value <= upper + beyond[linear]:
                raise JointRangeError(joint, float(value), lower, upper, linear)


class _JointDescription(StrictModel):
    """The keys that revolute and prismatic joints have in common; see the comments in config/kr120.yaml for every key's meaning."""

    rsi: Annotated[str, pydantic.Field(pattern=r"^[AE][1-6]$")]
    sign: Literal[1, -1]


class _RevoluteJoint(_JointDescription):
    range_deg: tuple[_Turned, _Turned] | None = None
    home_deg: _Finite
    acceleration_deg_s2: _Positive
    jerk_deg_s3: _Positive
    offset_deg: _Finite

    @property
    def si(self) -> tuple[float, ...]:
        """Home, acceleration, jerk and offset in rad."""
        return radians((self.home_deg, self.acceleration_deg_s2, self.jerk_deg_s3, self.offset_deg))


class _PrismaticJoint(_JointDescription):
    home_mm: _Finite
    acceleration_mm_s2: _Positive
    jerk_mm_s3: _Positive
    offset_mm: _Finite

    @property
    def si(self) -> tuple[float, ...]:
        """Home, acceleration, jerk and offset in m."""
        return tuple(mm / 1e3 for mm in (self.home_mm, self.acceleration_mm_s2, self.jerk_mm_s3, self.offset_mm))


class _RobotDescription(StrictModel):
    name: Annotated[str, pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$")]
    base_link: str
    tip_link: str
    joints: dict[str, dict[str, Any]]
    #: [rad], [m]; the one place of the file in SI: which unit a joint has, the URDF says
    other_joints: dict[str, _Finite] = {}
    estimates: tuple[Literal["accelerations", "jerks", "ranges", "axes", "couplings", "home"], ...] = ()


def load_robot(urdf: str, description: Mapping) -> RobotModel:
    """Build a robot, the movable joints from `base_link` to `tip_link`, from its URDF text and the mapping of its robot YAML."""
    parsed = _RobotDescription.read(dict(description), "robot")
    model = parse_urdf(urdf)
    joints = [joint for joint in chain_joints(model, parsed.base_link, parsed.tip_link) if joint.joint_type != "fixed"]
    for joint in joints:
        check_joint(joint)
    described = _describe_joints(parsed, joints)
    home, acceleration, jerk, offsets = zip(*(joint.si for joint in described))
    lower, upper = zip(*(_range(joint, described_joint) for joint, described_joint in zip(joints, described)))
    robot = RobotModel(
        name=parsed.name,
        urdf=urdf,
        base_link=parsed.base_link,
        tip_link=parsed.tip_link,
        joint_names=tuple(joint.name for joint in joints),
        lower=lower,
        upper=upper,
        velocity=tuple(float(joint.limit.velocity) for joint in joints),
        acceleration=acceleration,
        jerk=jerk,
        home=home,
        axes=tuple(AxisMapping(joint.rsi, joint.sign, offset) for joint, offset in zip(described, offsets)),
        linear=tuple(joint.joint_type == "prismatic" for joint in joints),
        other_joints=find_other_joints(model, [joint.name for joint in joints], parsed.other_joints),
        estimates=parsed.estimates,
    )
    _check_home(robot)
    return robot


def read_robot_files(urdf_path: str | Path, yaml_path: str | Path, xacro_args: str = "") -> RobotModel:
    """Build a robot from files, without ROS."""
    description = read_yaml(yaml_path)
    if not isinstance(description, dict):
        raise ConfigurationError(str(yaml_path), description, "a mapping of the robot's keys")
    return load_robot(expand_xacro(urdf_path, xacro_arguments(xacro_args)), description)


def check_joint(joint: Joint) -> None:
    """Raise ConfigurationError for a joint that this package cannot move."""
    where = f"URDF joint {joint.name}"
    if joint.joint_type not in ("revolute", "continuous", "prismatic") or joint.mimic is not None:
        found = "a mimic joint" if joint.mimic is not None else joint.joint_type
        raise ConfigurationError(where, found, "an independent revolute, continuous or prismatic joint")
    unit = "m" if joint.joint_type == "prismatic" else "rad"
    positive = f"the full speed that the maker states, above 0 [{unit}/s]"
    limit = joint.limit
    if joint.joint_type == "continuous":
        if limit is None or not 0 < limit.velocity < math.inf:
            found = None if limit is None else limit.velocity
            raise ConfigurationError(f"{where} limit velocity", found, positive)
        return
    if (
        limit is None
        or limit.lower is None
        or limit.upper is None
        or not -math.inf < limit.lower < limit.upper < math.inf
    ):
        found = None if limit is None else f"lower {limit.lower}, upper {limit.upper}"
        raise ConfigurationError(f"{where} limit", found, f"finite ones, lower < upper [{unit}]")
    if unit == "rad" and max(abs(limit.lower), abs(limit.upper)) >= _MOST_RADIANS:
        lower, upper = radians((limit.lower, limit.upper))
        expected = f'radians, below {_MOST_RADIANS:.1f} (1000 deg); of degrees lower="{lower:.6g}" upper="{upper:.6g}"'
        raise ConfigurationError(f"{where} limit", f"lower {limit.lower:g}, upper {limit.upper:g}", expected)
    if not 0 < limit.velocity < math.inf:
        raise ConfigurationError(f"{where} limit velocity", limit.velocity, positive)


def urdf_range(joint: Joint) -> tuple[float, float]:
    """Return lower and upper end of a joint that has both [rad], [m]: the safety_controller's where they are narrower."""
    lower, upper, soft = float(joint.limit.lower), float(joint.limit.upper), joint.safety_controller
    # both are optional, and 0 where they are left out
    if soft is None or not soft.soft_lower_limit < soft.soft_upper_limit:
        return lower, upper
    return max(lower, float(soft.soft_lower_limit)), min(upper, float(soft.soft_upper_limit))


def _range(joint: Joint, described: _RevoluteJoint | _PrismaticJoint) -> tuple[float, float]:
    """Return lower and upper end [rad], [m]: the URDF's, of a joint that turns without end the YAML's."""
    range_deg = described.range_deg if isinstance(described, _RevoluteJoint) else None
    where = f"robot/joints/{joint.name}/range_deg"
    if joint.joint_type != "continuous":
        if range_deg is not None:
            raise ConfigurationError(where, list(range_deg), "no range: the URDF has this joint's")
        return urdf_range(joint)
    if range_deg is None or not range_deg[0] < range_deg[1]:
        raise ConfigurationError(
            where,
            range_deg and list(range_deg),
            "[lower, upper] with lower < upper: the URDF lets this joint turn without end",
        )
    lower, upper = radians(range_deg)
    return lower, upper


def _describe_joints(parsed: _RobotDescription, joints: Sequence[Joint]) -> list[_RevoluteJoint | _PrismaticJoint]:
    """Return the YAML's entry for each joint, in their order, with the keys that fit its type."""
    names = [joint.name for joint in joints]
    if not names:
        expected = f"a link that at least one joint moves relative to {parsed.base_link}"
        raise ConfigurationError("robot/tip_link", parsed.tip_link, expected)
    if set(parsed.joints) != set(names):
        raise ConfigurationError("robot/joints", sorted(parsed.joints), f"one entry for each of {names}")
    described: list[_RevoluteJoint | _PrismaticJoint] = []
    for joint in joints:
        kind: type[_RevoluteJoint | _PrismaticJoint]
        kind = _PrismaticJoint if joint.joint_type == "prismatic" else _RevoluteJoint
        described.append(kind.read(parsed.joints[joint.name], f"robot/joints/{joint.name}"))
    rsi_axes = [joint.rsi for joint in described]
    for number, axis in enumerate(rsi_axes):
        if axis in rsi_axes[:number]:
            expected = f"a different RSI axis for each joint; {names[rsi_axes.index(axis)]} has this one"
            raise ConfigurationError(f"robot/joints/{names[number]}/rsi", axis, expected)
    return described


def _check_home(robot: RobotModel) -> None:
    try:
        robot.check_range(robot.home)
    except JointRangeError as error:
        linear = robot.linear[robot.joint_names.index(error.joint)]
        key = f"robot/joints/{error.joint}/{'home_mm' if linear else 'home_deg'}"
        found = error.value * 1e3 if linear else math.degrees(error.value)
        raise ConfigurationError(key, found, f"a pose in range: {error}") from error


def find_other_joints(model: URDF, chain: Collection[str], positions: Mapping[str, float]) -> tuple[OtherJoint, ...]:
    """Return the movable joints outside of the chain, in the URDF's order.

    They stand at `positions` [rad], [m], else at zero, or in the middle of a range without zero; mimic joints follow.
    """
    others = {joint.name: joint for joint in model.joints if joint.joint_type != "fixed" and joint.name not in chain}
    settable = [name for name, joint in others.items() if joint.mimic is None and joint.joint_type in _UNITS]
    for name, value in positions.items():
        _check_settable(name, value, others, settable)
    found = []
    for name, joint in others.items():
        place = _position(joint, others, chain, positions)
        still, follows = (None, place) if isinstance(place, Following) else (place, None)
        found.append(OtherJoint(name, joint.joint_type, still, joint.mimic.joint if joint.mimic else "", follows))
    return tuple(found)


def other_joints_text(others: Sequence[OtherJoint], base_link: str, tip_link: str) -> str:
    """Return the sentence about the joints outside of the chain; empty without any."""
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


def _check_settable(name: str, value: float, others: Mapping[str, Joint], settable: Sequence[str]) -> None:
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
    joint: Joint, others: Mapping[str, Joint], chain: Collection[str], positions: Mapping[str, float]
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
    return factor * _checked_position(joint, positions.get(joint.name)) + offset


def _checked_position(joint: Joint, position: float | None) -> float:
    if joint.joint_type not in _UNITS:
        return 0.0
    if joint.joint_type == "continuous":
        return position or 0.0
    unit, limit = _UNITS[joint.joint_type], joint.limit
    where = f"URDF joint {joint.name} limit"
    if limit is None:
        raise ConfigurationError(where, None, f"lower and upper [{unit}]")
    lower, upper = float(limit.lower or 0.0), float(limit.upper or 0.0)
    if not (math.isfinite(lower) and math.isfinite(upper) and lower <= upper):
        raise ConfigurationError(where, f"lower {lower}, upper {upper}", f"finite ones, lower <= upper [{unit}]")
    if position is None:
        # as joint_state_publisher, which shows the twin's
        return 0.0 if lower <= 0.0 <= upper else (lower + upper) / 2.0
    if not lower <= position <= upper:
        raise ConfigurationError(f"robot/other_joints/{joint.name}", position, f"{lower:g} to {upper:g} [{unit}]")
    return position
