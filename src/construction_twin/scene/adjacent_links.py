"""Links whose shapes overlap because a joint holds them together: their contact says nothing.

A joint holds two links: the nearest ones with a shape on its two sides. What else is fixed to them, such as a gripper behind a
flange or a carriage below a pedestal, is not held by it.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from urdf_parser_py.urdf import URDF

from construction_twin.robot.urdf import parse_urdf
from construction_twin.scene.collision_bodies import RobotBodies


def adjacent_links(bodies: RobotBodies) -> set[frozenset[str]]:
    """Return the pairs of links that one joint holds which moves, or two joints with one origin, like A5 and A6 of the KR 120.

    Their ranges keep the castings apart; shapes that enclose them overlap.

    Parameters
    ----------
    bodies : RobotBodies
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
    return pairs


def _nearest(urdf: URDF, start: str, chain: Collection[str], shaped: Collection[str]) -> set[str]:
    """Return the links with a shape that are fewest joints away from a link and move with it."""
    seen, layer = {start}, {start}
    while layer and not layer & set(shaped):
        joints = [joint for joint in urdf.joints if joint.name not in chain]
        reached = {joint.child for joint in joints if joint.parent in layer}
        layer = (reached | {joint.parent for joint in joints if joint.child in layer}) - seen
        seen |= layer
    return layer & set(shaped)
