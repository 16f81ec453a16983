"""Links whose shapes overlap because a joint holds them together: their contact says nothing.

A joint holds two links: the nearest ones with a shape on its two sides. What else is fixed to them, such as a gripper behind a
flange or a carriage below a pedestal, is not held by it.

A joint and the mimic joints that follow it are a linkage that the URDF, a tree, cannot close: the piston of a counterbalance hangs
on the arm that it carries, and there their shapes overlap. So the links that they hold are all held together.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import combinations

import numpy as np
from urdf_parser_py.urdf import URDF

from construction_twin.robot.urdf import parse_urdf
from construction_twin.scene.collision_bodies import RobotBodies


def adjacent_links(bodies: RobotBodies) -> set[frozenset[str]]:
    """Return the pairs of links that one joint holds which moves, or two joints with one origin, like A5 and A6 of the KR 120, or a
    joint together with those that follow it.

    Their ranges keep the castings apart; shapes that enclose them overlap.
    """
    urdf = parse_urdf(bodies.robot.urdf)
    chain = set(bodies.model.names)
    shaped = {body.link for body in bodies.bodies}
    model = bodies.model
    pairs: set[frozenset[str]] = set()
    for index, name in enumerate(model.names):
        if not index:
            continue
        behind = _nearest(urdf, urdf.joint_map[name].child, chain, shaped)
        before = _nearest(urdf, urdf.joint_map[name].parent, chain, shaped)
        parent = model.parents[index]
        if parent and not np.any(np.round(model.jointPlacements[index].translation, 9)):
            before = before | _nearest(urdf, urdf.joint_map[model.names[parent]].parent, chain, shaped)
        pairs |= {frozenset((one, other)) for one in before for other in behind}
    for linkage in _linkages(bodies):
        ends = [getattr(urdf.joint_map[model.names[index]], side) for index in linkage for side in ("parent", "child")]
        held = sorted(set().union(*(_nearest(urdf, end, chain, shaped) for end in ends)))
        supports = {link: set(model.supports[bodies.link_joints[link]]) for link in held}
        # only what no other joint moves against each other
        pairs |= {frozenset(pair) for pair in combinations(held, 2) if supports[pair[0]] ^ supports[pair[1]] <= linkage}
    return pairs


def _linkages(bodies: RobotBodies) -> list[set[int]]:
    """Return each joint of the chain that others follow, with those, as indices of Pinocchio's joints."""
    index = {joint.idx_q: number for number, joint in enumerate(bodies.model.joints) if number}
    linkages: dict[int, set[int]] = {}
    for at, leader, _, _ in bodies.followers:
        linkages.setdefault(leader, {index[leader]}).add(index[at])
    return list(linkages.values())


def _nearest(urdf: URDF, start: str, chain: Collection[str], shaped: Collection[str]) -> set[str]:
    """Return the links with a shape that are fewest joints away from a link and move with it."""
    seen, layer = {start}, {start}
    while layer and not layer & set(shaped):
        joints = [joint for joint in urdf.joints if joint.name not in chain]
        reached = {joint.child for joint in joints if joint.parent in layer}
        layer = (reached | {joint.parent for joint in joints if joint.child in layer}) - seen
        seen |= layer
    return layer & set(shaped)
