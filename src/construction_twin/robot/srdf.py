"""The SRDF: what MoveIt and others need besides the URDF. Groups, home, end effectors, pairs of links that are not checked.

The format is srdfdom's. Values in rad, m for prismatic joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from xml.etree import ElementTree

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.robot.description import RobotModel
from construction_twin.robot.planning_groups import end_effectors, moving_joint, moving_joints, planning_groups
from construction_twin.robot.urdf import parse_urdf

#: MoveIt's word for each reason of a self_collision file.
REASONS = {"adjacent": "Adjacent", "always": "Always", "never": "Never"}
#: MoveIt's words for two links that nothing moves against each other: joined by a joint, or further apart.
_JOINED, _RIGID = "Adjacent", "User"
#: What a fixed robot stands in. MoveIt plans in the URDF's root whatever this says.
WORLD = "world"


def srdf(robot: RobotModel, ignored: Mapping[frozenset[str], str]) -> str:
    """Return the SRDF of a robot: the same text for the same robot and pairs.

    Links that nothing moves (a pedestal, a rail) are not checked against objects, as in our own scene: MoveIt would otherwise find
    the pedestal in contact with the floor that it stands on. They are checked against the links that move.

    Args:
        ignored: Pairs of links that are not checked, with the reason ``adjacent``, ``always`` or ``never``.

    Returns:
        Indented XML.

    Raises:
        ConfigurationError: If a pair names a link that the URDF does not have, or another reason.
    """
    model = parse_urdf(robot.urdf)
    root = ElementTree.Element("robot", name=model.name)
    root.append(
        ElementTree.Comment(" Made by `rosrun construction_twin srdf` from URDF, robot YAML and self_collision file. ")
    )
    _add_groups(root, robot)
    ElementTree.SubElement(
        root, "virtual_joint", name="world_joint", type="fixed", parent_frame=WORLD, child_link=model.get_root()
    )
    for other in robot.other_joints:
        # they stand where the robot YAML says: nobody plans for them
        if not other.follows:
            ElementTree.SubElement(root, "passive_joint", name=other.name)
    _add_collisions(root, robot, ignored)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_groups(root: ElementTree.Element, robot: RobotModel) -> None:
    groups = planning_groups(robot)
    for group in groups:
        element = ElementTree.SubElement(root, "group", name=group.name)
        ElementTree.SubElement(element, "chain", base_link=group.base_link, tip_link=group.tip_link)
    effectors = end_effectors(robot)
    for effector in effectors:
        element = ElementTree.SubElement(root, "group", name=effector.name)
        for link in effector.links:
            ElementTree.SubElement(element, "link", name=link)
    home = dict(zip(robot.joint_names, robot.home))
    for group in groups:
        state = ElementTree.SubElement(root, "group_state", name="home", group=group.name)
        for joint in group.joints:
            ElementTree.SubElement(state, "joint", name=joint, value=f"{home[joint]:.12g}")
    for effector in effectors:
        ElementTree.SubElement(
            root,
            "end_effector",
            name=effector.name,
            parent_link=effector.parent_link,
            group=effector.name,
            parent_group=groups[-1].name,
        )


def _add_collisions(root: ElementTree.Element, robot: RobotModel, ignored: Mapping[frozenset[str], str]) -> None:
    model = parse_urdf(robot.urdf)
    links = [link.name for link in model.links if link.collisions]
    unknown = sorted({link for pair in ignored for link in pair} - set(model.link_map))
    if unknown:
        raise ConfigurationError("self_collision ignored", unknown[0], Sentence("expected.robot.link_anew"))
    moving = moving_joints(robot)
    carrier = {link: moving_joint(model, link, moving) for link in links}
    joined = {frozenset((joint.parent, joint.child)) for joint in model.joints}
    fixed = [link for link in links if not carrier[link]]
    for link in fixed:
        ElementTree.SubElement(root, "disable_default_collisions", link=link)
    disabled = dict(_words(ignored))
    for first, second in combinations(links, 2):
        pair = frozenset((first, second))
        if carrier[first] == carrier[second]:
            disabled[pair] = _JOINED if pair in joined else _RIGID
        elif (first in fixed or second in fixed) and pair not in disabled:
            ElementTree.SubElement(root, "enable_collisions", link1=first, link2=second)
    for one, other, reason in sorted((*sorted(pair), reason) for pair, reason in disabled.items()):
        ElementTree.SubElement(root, "disable_collisions", link1=one, link2=other, reason=reason)


def _words(ignored: Mapping[frozenset[str], str]):
    for pair, reason in ignored.items():
        if reason not in REASONS:
            raise ConfigurationError(
                "self_collision ignored", reason, Sentence("expected.robot.reasons", reasons=str(sorted(REASONS)))
            )
        yield pair, REASONS[reason]
