"""The pairs of a robot's links that need no collision check, and why. Found by sampling, kept in a YAML file.

A pair is left out when it is ``adjacent`` (`adjacent_links`), ``always`` in contact in the sampled poses (then the check is
useless), or ``never`` in contact nor close to it. The file is refused for any other geometry than the one whose hash it carries.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pinocchio
import pydantic
from urdf_parser_py.urdf import URDF

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf, read_yaml
from construction_twin.scene.collision_bodies import RobotBodies, configure_coal, shape_contents
from construction_twin.validation import StrictModel

#: Pair of link names.
Pair = tuple[str, str]


class PairFile(StrictModel):
    """The YAML file; its comments explain the keys."""

    robot: str
    geometry: Annotated[str, pydantic.Field(pattern="^[0-9a-f]{64}$")]
    samples: Annotated[int, pydantic.Field(ge=1)]
    seed: Annotated[int, pydantic.Field(ge=0)]
    ignored: tuple[tuple[str, str, Literal["adjacent", "always", "never"]], ...]


def read_pairs(path: str | Path) -> PairFile:
    """Return what a file says, without asking which robot it is for."""
    description = read_yaml(path, " of self collision pairs")
    if not isinstance(description, dict):
        raise ConfigurationError(str(path), description, "a mapping with the keys that `self_collision` writes")
    return PairFile.read(description, str(path))


def adjacent_links(bodies: RobotBodies) -> set[frozenset[str]]:
    """Return the pairs of links held by one moving joint, two with one origin (A5 and A6), or one with those that follow it.

    Their ranges keep the castings apart; shapes that enclose them overlap. Held are the nearest links with a shape on both sides.
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
    visited, layer = {start}, {start}
    while layer and not layer & set(shaped):
        joints = [joint for joint in urdf.joints if joint.name not in chain]
        reached = {joint.child for joint in joints if joint.parent in layer}
        layer = (reached | {joint.parent for joint in joints if joint.child in layer}) - visited
        visited |= layer
    return layer & set(shaped)


#: Poses that are sampled by default, and the seed of their random numbers.
SAMPLES, SEED = 20000, 0
#: A pair that came this close [m] in a sample is checked: a contact may lie between the samples.
NEAR = 0.05

_HEADER = """\
# Pairs of links that are not checked against each other. Written by
#   rosrun construction_twin new_arm self_collision <urdf or xacro> <robot.yaml> <this file>
# from {samples} random poses within the joint ranges (seed {seed}); run it again when a collision shape, a joint or a range
# of the robot changes.
#   adjacent: joined by one joint, or by two joints with one origin{followers}
#   always: in contact in every sample: the check would say nothing
#   never: in no sample closer than {near_mm:g} mm
"""


@dataclass(frozen=True)
class SelfCollision:
    """The pairs of links that are not checked, each with its reason, and the `geometry_hash` of the robot they were found with."""

    ignored: Mapping[frozenset[str], str]
    geometry_hash: str

    def ignores(self, first: str, second: str) -> bool:
        """Return whether two links are not checked against each other."""
        return frozenset((first, second)) in self.ignored


def geometry_hash(bodies: RobotBodies) -> str:
    """Return the SHA-256 of everything that decides which links can touch: shapes, joints and ranges, to 1e-9."""
    shapes = [
        [body.link, body.joint, _rounded(body.placement.homogeneous), shape_contents(body.geometry)]
        for body in bodies.bodies
    ]
    joints = [
        [
            name,
            bodies.model.parents[index],
            bodies.model.joints[index].shortname(),
            _rounded(bodies.model.jointPlacements[index].homogeneous),
        ]
        for index, name in enumerate(bodies.model.names)
        if index
    ]
    ranges = [_rounded(bodies.robot.lower), _rounded(bodies.robot.upper)]
    following = [[at, leader, *_rounded([factor, offset])] for at, leader, factor, offset in bodies.followers]
    contents = [shapes, joints, ranges, following] if following else [shapes, joints, ranges]
    return hashlib.sha256(json.dumps(contents).encode()).hexdigest()


def _rounded(values) -> list[float]:
    # + 0.0 turns minus zero into zero
    return (np.round(np.asarray(values, dtype=float), 9) + 0.0).ravel().tolist()


def sample_self_collision(robot: RobotModel, samples: int = SAMPLES, seed: int = SEED) -> SelfCollision:
    """Find the pairs of links that need no check, by the home pose and random ones within the ranges."""
    bodies = RobotBodies(robot)
    pairs, adjacent = _link_pairs(bodies)
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    random = np.random.default_rng(seed).uniform(lower, upper, (samples - 1, len(lower)))
    always, never = _open_pairs(bodies, pairs, bodies.rows(np.vstack([robot.home, random])))
    ignored = {frozenset(pair): "adjacent" for pair in adjacent}
    ignored |= {frozenset(pair): "never" for pair in never}
    ignored |= {frozenset(pair): "always" for pair in always}
    return SelfCollision(ignored, geometry_hash(bodies))


def _open_pairs(bodies: RobotBodies, pairs: Sequence[Pair], poses: np.ndarray) -> tuple[Iterable[Pair], Iterable[Pair]]:
    """Return the pairs of links that are in contact in all poses, and those that are close in none.

    A pair is not asked again once its answer can no longer change: few are left after the first poses.
    """
    geometry = pinocchio.GeometryModel()
    for index, body in enumerate(bodies.bodies):
        geometry.addGeometryObject(pinocchio.GeometryObject(str(index), body.joint, body.placement, body.geometry))
    # of each pair of links, the pairs of their shapes
    parts: dict[Pair, list[int]] = {pair: [] for pair in pairs}
    for second, other in enumerate(bodies.bodies):
        for first, one in enumerate(bodies.bodies[:second]):
            if (one.link, other.link) in parts:
                parts[one.link, other.link].append(len(geometry.collisionPairs))
                geometry.addCollisionPair(pinocchio.CollisionPair(first, second))
    data, contact, close = bodies.model.createData(), geometry.createData(), geometry.createData()
    configure_coal(contact)
    configure_coal(close, [NEAR] * len(close.collisionRequests))
    always, never = dict(parts), dict(parts)
    for q in poses:
        if never and pinocchio.computeCollisions(bodies.model, data, geometry, close, q, False):
            for pair in [
                pair for pair in never if any(close.collisionResults[part].isCollision() for part in parts[pair])
            ]:
                del never[pair]
                for part in parts[pair]:
                    close.deactivateCollisionPair(part)
        if always:
            pinocchio.updateGeometryPlacements(bodies.model, data, geometry, contact, q)
            for pair in list(always):
                if not any(pinocchio.computeCollision(geometry, contact, part) for part in parts[pair]):
                    del always[pair]
        if not always and not never:
            break
    return always, never


#: How a robot gets its file. The name is the person's to choose: over another arm's file it would take away what that arm needs.
WRITE = "rosrun construction_twin new_arm self_collision <urdf or xacro> <robot.yaml> <new file>"


def _link_pairs(bodies: RobotBodies) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Return the pairs of links that move against each other: those to sample, and the adjacent ones."""
    joints = {body.link: body.joint for body in bodies.bodies}
    held = adjacent_links(bodies)
    links = list(joints)
    pairs: list[tuple[str, str]] = []
    adjacent: list[tuple[str, str]] = []
    for index, second in enumerate(links):
        for first in links[:index]:
            if joints[first] != joints[second]:
                (adjacent if frozenset((first, second)) in held else pairs).append((first, second))
    return pairs, adjacent


def self_collision_yaml(robot: RobotModel, found: SelfCollision, samples: int, seed: int) -> str:
    """Return the text of the file: the same to the byte for the same robot, samples and seed."""
    lines = [
        _HEADER.format(
            samples=samples,
            seed=seed,
            near_mm=NEAR * 1e3,
            followers=", or by a joint and those that follow it"
            if any(j.following for j in robot.other_joints)
            else "",
        ),
        f"robot: {robot.name}",
        "# SHA-256 of the shapes, joints and ranges these pairs were found with",
        f"geometry: {found.geometry_hash}",
        f"samples: {samples}",
        f"seed: {seed}",
        "ignored:" if found.ignored else "ignored: []",
    ]
    rows = sorted((*sorted(pair), reason) for pair, reason in found.ignored.items())
    return "\n".join([*lines, *(f"  - [{first}, {second}, {reason}]" for first, second, reason in rows), ""])


def read_self_collision(path: str | Path, robot: RobotModel) -> SelfCollision:
    """Return what a file says, if it was made for this robot."""
    read, found = read_pairs(path), geometry_hash(RobotBodies(robot))
    if read.geometry != found:
        raise ConfigurationError(
            f"{path} geometry", read.geometry,
            f"{found}, that of robot {robot.name}: the file is of another arm, which keeps it, or shapes, joints or ranges have "
            f"changed since. Write a file for the arm as it is, under a name of its own, and give that: `{WRITE}`",
        )  # fmt: skip
    return SelfCollision({frozenset((first, second)): why for first, second, why in read.ignored}, found)
