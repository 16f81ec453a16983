"""The robot YAML of an arm that has none yet: what a URDF says, and stated estimates of what it cannot say."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from urdf_parser_py.urdf import URDF, Joint

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import ESTIMATES, RobotModel, check_joint, load_robot, urdf_range
from construction_twin.robot.urdf import chain_joints, expand_xacro, parse_urdf, xacro_arguments

_LOG = logging.getLogger(__name__)
#: What is an estimate in every file that is written here; `RANGES` as well, where the URDF has a joint without a range.
ESTIMATED = ("accelerations", "jerks", "axes", "couplings")
#: An estimate until `with_home` has put in a reviewed pose.
HOME = "home"
RANGES = "ranges"
#: Range of a joint that the URDF lets turn without end [deg]: a turn to each side, which most such joints allow.
CONTINUOUS_DEG = 360.0
#: Full acceleration is reached within this time [s].
_JERK_TIME = 0.1
_DEGREES = 180.0 / math.pi
#: More joints than RSI has axes for.
_MOST_JOINTS = 12
#: Beyond this [rad], a turn and a bit, whole numbers are probably degrees; no industrial arm's joint is as fast as this [rad/s].
_FAR, _FAST = 6.5, 30.0


def robot_name(urdf: str) -> str:
    """Return a name for ROS and MQTT from a URDF's name: small letters, digits and _."""
    words = re.sub(r"[^a-z0-9]+", "_", (parse_urdf(urdf).name or "").lower()).strip("_").removesuffix("_robot")
    return words if re.match(r"[a-z]", words) else f"arm_{words}".rstrip("_")


def find_ends(urdf: str, base_link: str = "", tip_link: str = "") -> tuple[str, str]:
    """Return the ends of an arm's chain: by default ``tool0``, and ``base_link`` above it or the URDF's root (after ``world``)."""
    model = parse_urdf(urdf)
    tip_link = tip_link or "tool0"
    if tip_link not in model.link_map:
        ends = sorted(set(model.link_map) - set(model.child_map))
        raise ConfigurationError(
            "tip link", tip_link, f"a link of the URDF; links at an end of its tree: {', '.join(ends)}"
        )
    if not base_link:
        path = _path(model, tip_link)
        base_link = "base_link" if "base_link" in path else path[1 if path[0] == "world" and len(path) > 1 else 0]
    if base_link not in model.link_map:
        raise ConfigurationError(
            "base link", base_link, f"one of the URDF's links: {', '.join(sorted(model.link_map))}"
        )
    chain_joints(model, base_link, tip_link)
    return base_link, tip_link


def _path(model: URDF, link: str) -> list[str]:
    """Return the links from the root to a link."""
    path = [link]
    while path[-1] in model.parent_map and len(path) <= len(model.links):
        path.append(model.parent_map[path[-1]][1])
    return path[::-1]


def new_description(urdf: str, name: str, base_link: str, tip_link: str, full_speed_in: float) -> dict[str, Any]:
    """Return a robot YAML's mapping: home in mid-range, accelerations that reach full speed in `full_speed_in` [s]."""
    joints = [joint for joint in chain_joints(parse_urdf(urdf), base_link, tip_link) if joint.joint_type != "fixed"]
    if not 0 < len(joints) <= _MOST_JOINTS:
        raise ConfigurationError("tip link", tip_link, f"a link that 1 to {_MOST_JOINTS} joints move; {len(joints)} do")
    axes = rsi_axes([joint.joint_type == "prismatic" for joint in joints])
    endless = any(joint.joint_type == "continuous" for joint in joints)
    described = {joint.name: _joint(joint, axis, full_speed_in) for joint, axis in zip(joints, axes)}
    for remark in _remarks(joints):
        _LOG.warning("%s", remark)
    return {
        "name": name,
        "base_link": base_link,
        "tip_link": tip_link,
        "estimates": [word for word in ESTIMATES if word in (*ESTIMATED, HOME) or (endless and word == RANGES)],
        "joints": described,
    }


def robot_of_urdf(
    path: str | Path, base_link: str = "", tip_link: str = "", full_speed_in: float = 1.0, xacro_args: str = ""
) -> RobotModel:
    """Build a robot from a URDF alone, by `new_description`; `RobotModel.estimates` says what of it is an estimate."""
    urdf = expand_xacro(path, xacro_arguments(xacro_args))
    base_link, tip_link = find_ends(urdf, base_link, tip_link)
    return load_robot(urdf, new_description(urdf, robot_name(urdf), base_link, tip_link, full_speed_in))


def rsi_axes(linear: Sequence[bool]) -> list[str]:
    """Return the RSI axis of each joint: prismatic ones before the first revolute one E1 on, then A1 to A6, then E again."""
    tracks = next((index for index, prismatic in enumerate(linear) if not prismatic), 0)
    external = iter(f"E{number}" for number in range(1, _MOST_JOINTS))
    own = range(-tracks, len(linear) - tracks)
    return [f"A{index + 1}" if 0 <= index < 6 else next(external) for index in own]


def _remarks(joints: Sequence[Joint]) -> list[str]:
    """Return what a person should know of a chain's limits that are accepted: probably degrees, and narrower soft limits."""
    remarks, narrowed = [], []
    for joint in joints:
        where, limit = f"URDF joint {joint.name} limit", joint.limit
        if joint.joint_type == "revolute":
            ends = (limit.lower, limit.upper)
            if max(map(abs, ends)) > _FAR and all(float(end).is_integer() for end in ends):
                in_degrees = " to ".join(f"{math.degrees(end):.0f}" for end in ends)
                remarks.append(
                    f"{where}: lower {ends[0]:g}, upper {ends[1]:g} are radians in a URDF, here {in_degrees} deg; if they are "
                    f'meant as degrees, write lower="{math.radians(ends[0]):.6g}" upper="{math.radians(ends[1]):.6g}"'
                )
        if joint.joint_type != "prismatic" and limit.velocity > _FAST:
            remarks.append(
                f"{where}: velocity {limit.velocity:g} is in rad/s in a URDF, here {math.degrees(limit.velocity):.0f} deg/s; if it "
                f'is meant in degrees, write velocity="{math.radians(limit.velocity):.6g}"'
            )
        if joint.joint_type != "continuous" and urdf_range(joint) != (limit.lower, limit.upper):
            narrowed.append(joint.name)
    if narrowed:
        remarks.append(f"the soft limits of the URDF's safety_controller are the range of {', '.join(narrowed)}")
    return remarks


def _joint(joint: Joint, axis: str, full_speed_in: float) -> dict[str, Any]:
    check_joint(joint)
    limit, endless = joint.limit, joint.joint_type == "continuous"
    unit, per_unit = ("mm", 1e3) if joint.joint_type == "prismatic" else ("deg", _DEGREES)
    acceleration = _rounded(limit.velocity * per_unit / full_speed_in)
    middle = 0.0 if endless else sum(urdf_range(joint)) / 2 * per_unit
    return {
        **({"range_deg": [-CONTINUOUS_DEG, CONTINUOUS_DEG]} if endless else {}),
        f"home_{unit}": round(middle, 3) + 0.0,
        f"acceleration_{unit}_s2": acceleration,
        f"jerk_{unit}_s3": _rounded(acceleration / _JERK_TIME),
        "rsi": axis,
        "sign": 1,
        f"offset_{unit}": 0.0,
    }


def _rounded(value: float) -> float:
    """Return a value with three digits: an estimate has no more."""
    return float(f"{value:.3g}")


def with_home(description: Mapping[str, Any], home: Sequence[float]) -> dict[str, Any]:
    """Return a robot YAML's mapping with a confirmed home pose [rad], [m], in the order of its joints."""
    joints = {}
    for (name, joint), value in zip(description["joints"].items(), home):
        key, per_unit = ("home_mm", 1e3) if "home_mm" in joint else ("home_deg", _DEGREES)
        joints[name] = {**joint, key: round(value * per_unit, 3) + 0.0}
    estimates = [word for word in description["estimates"] if word != HOME]
    return {**description, "joints": joints, "estimates": estimates}


def robot_yaml(description: Mapping[str, Any], command: str, full_speed_in: float) -> str:
    """Return the text of a robot YAML of `new_description`, with what a person must know of its values."""
    lines = [
        f"# {description['name']}: what its URDF cannot carry. Every key is explained in config/kr120.yaml. Written by",
        f"#   {' '.join(command.split())}",
        "",
        f"name: {description['name']}",
        f"base_link: {description['base_link']}",
        f"tip_link: {description['tip_link']}",
        "",
        "# What below is an estimate. arm:=real is refused while a word stands here: put in the right values, then take it out.",
        f"#   accelerations ({ESTIMATES['accelerations']}): full speed within {full_speed_in:g} s. From the maker, with your load.",
        f"#   jerks ({ESTIMATES['jerks']}): full acceleration within {_JERK_TIME:g} s.",
        *(
            [
                "#   ranges (range_deg): a turn to each side, where the URDF has no range. From the maker, with hoses and cables;",
                "#     a joint that does turn without end is moved within the range that stands here.",
            ]
            if RANGES in description["estimates"]
            else []
        ),
        f"#   axes ({ESTIMATES['axes']}): the controller's axes in the order of the chain, turning as in the URDF.",
        "#     Compare each with the pendant: rsi_angle = sign * joint_angle + offset.",
        "#   couplings: each axis is taken to follow its own joint alone. Where the pendant's angle of one axis changes while",
        "#     another joint moves (parallel linkages, J2 and J3 of some makers, some wrists), this package cannot drive the arm.",
        f"estimates: [{', '.join(description['estimates'])}]",
        "",
        "# Home: free of contact with the arm itself and the launch file's scene.",
        "joints:",
    ]
    for name, joint in description["joints"].items():
        values = ", ".join(f"{key}: {_number(value)}" for key, value in joint.items())
        lines.append(f"  {name}: {{{values}}}")
    return "\n".join([*lines, ""])


def _number(value: object) -> str:
    return repr(value) if isinstance(value, float) else str(value)
