"""The parts of an arm that planners such as MoveIt plan for: the arm alone, the arm on its rail, and what is mounted on it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from urdf_parser_py.urdf import URDF

from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import chain_joints, parse_urdf

#: The arm; on a rail the arm alone.
ARM = "manipulator"
#: The arm together with the rail that it stands on.
ARM_AND_RAIL = "manipulator_track"
END_EFFECTOR = "end_effector"
_BASE = "base_link"


@dataclass(frozen=True)
class PlanningGroup:
    """A chain of joints.

    Attributes:
        joints: The joints of the robot in it, base to tip.
    """

    name: str
    base_link: str
    tip_link: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class EndEffector:
    """Links behind the arm that are not on its way to the tip: a gripper, a camera, or the tool behind the flange.

    Attributes:
        parent_link: The link of the arm that carries them.
        links: In the URDF's order.
    """

    name: str
    parent_link: str
    links: tuple[str, ...]


def planning_groups(robot: RobotModel) -> tuple[PlanningGroup, ...]:
    """Return the groups, the one of all joints last.

    A rail is one or more prismatic joints before the first revolute one. Without one there is one group.
    """
    rail = next((index for index, linear in enumerate(robot.linear) if not linear), 0)
    whole = PlanningGroup(ARM_AND_RAIL if rail else ARM, robot.base_link, robot.tip_link, robot.joint_names)
    if not rail:
        return (whole,)
    joints = chain_joints(parse_urdf(robot.urdf), robot.base_link, robot.tip_link)
    names = [joint.name for joint in joints]
    behind = joints[names.index(robot.joint_names[rail - 1]) + 1 : names.index(robot.joint_names[rail]) + 1]
    carried = [joint.parent for joint in behind]
    # the arm's own base, where ROS-Industrial's name for it is there; otherwise the link that the rail moves
    base = _BASE if _BASE in carried else carried[0]
    return PlanningGroup(ARM, base, robot.tip_link, robot.joint_names[rail:]), whole


def end_effectors(robot: RobotModel) -> tuple[EndEffector, ...]:
    """Return what the last link of the arm carries, one for each link that carries something with a shape."""
    model = parse_urdf(robot.urdf)
    chain = chain_joints(model, robot.base_link, robot.tip_link)
    last = [joint.name for joint in chain].index(robot.joint_names[-1])
    carriers = [joint.child for joint in chain[last:]]
    found: list[EndEffector] = []
    for carrier in carriers:
        links = _behind(model, carrier, carriers)
        if any(model.link_map[link].visuals or model.link_map[link].collisions for link in links):
            name = END_EFFECTOR if not found else f"{END_EFFECTOR}_{carrier}"
            found.append(EndEffector(name, carrier, tuple(link.name for link in model.links if link.name in links)))
    return tuple(found)


def moving_joint(model: URDF, link: str, moving: Collection[str]) -> str:
    """Return which of the joints `moving` carries a link, the nearest one; empty when none does."""
    while link in model.parent_map:
        joint, link = model.parent_map[link]
        if joint in moving:
            return joint
    return ""


def moving_joints(robot: RobotModel) -> set[str]:
    """Return the joints that move: those of the chain, and mimic joints that follow one of them."""
    return {*robot.joint_names, *(other.name for other in robot.other_joints if other.position is None)}


def _behind(model: URDF, start: str, without: Collection[str]) -> set[str]:
    children: Mapping[str, list[tuple[str, str]]] = model.child_map
    links: set[str] = set()
    open_links = [start]
    while open_links:
        for _, child in children.get(open_links.pop(), []):
            if child not in without:
                links.add(child)
                open_links.append(child)
    return links
