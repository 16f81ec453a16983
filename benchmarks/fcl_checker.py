"""Collision check for the planning benchmark, by python-fcl on KDL's transforms: shares no code with what it checks.

It reads the URDF's collision shapes and the scene's YAML itself. What it takes from the library: the URDF's joints as a
KDL chain, and from the configuration which pairs of links are not checked. Capsules that the URDF declares for
Pinocchio are the cylinders here that they enclose.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import fcl
import numpy as np
import PyKDL
from scipy.spatial.transform import Rotation

from construction_twin.kinematics.chain import to_kdl
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import chain_joints, parse_urdf


@dataclass(eq=False)
class Shape:
    """A body of fcl with half the size of the box that encloses it, placed in a link or in the base."""

    owner: str
    collider: fcl.CollisionObject
    half: np.ndarray
    position: np.ndarray
    rotation: np.ndarray


def _shape(owner: str, kind: str, size, position, rotation: np.ndarray) -> Shape:
    if kind == "box":
        geometry, half = fcl.Box(*size), np.array(size) / 2.0
    elif kind == "cylinder":
        geometry, half = fcl.Cylinder(*size), np.array((size[0], size[0], size[1] / 2.0))
    elif kind == "sphere":
        geometry, half = fcl.Sphere(*size), np.full(3, size[0])
    else:
        raise ValueError(f"{owner}: shape {kind!r}; this checker knows box, cylinder and sphere")
    position = np.array(position, dtype=float)
    return Shape(owner, fcl.CollisionObject(geometry, fcl.Transform(rotation, position)), half, position, rotation)


def _link_shapes(link) -> list[Shape]:
    shapes = []
    for collision in link.collisions:
        geometry = collision.geometry
        kind = type(geometry).__name__.lower()
        size = {
            "box": lambda: geometry.size,
            "cylinder": lambda: (geometry.radius, geometry.length),
            "sphere": lambda: (geometry.radius,),
        }[kind]()
        origin = collision.origin
        rotation = Rotation.from_euler("xyz", (origin.rpy or (0, 0, 0)) if origin else (0, 0, 0)).as_matrix()
        shapes.append(_shape(link.name, kind, size, (origin.xyz or (0, 0, 0)) if origin else (0, 0, 0), rotation))
    return shapes


def _scene_shapes(scene: dict) -> list[Shape]:
    shapes = []
    for name, item in scene["objects"].items():
        rotation = Rotation.from_euler("xyz", item.get("rpy_deg", (0, 0, 0)), degrees=True).as_matrix()
        shapes.append(_shape(name, item["shape"], item["size"], item.get("position", (0, 0, 0)), rotation))
    return shapes


class FclChecker:
    """Contacts of a robot with itself and with a scene. Padding is not counted: contact is contact.

    Args:
        scene: The parsed scene YAML; boxes, cylinders and spheres that stand in the world.
        ignored: Pairs of links that are not checked.
    """

    def __init__(self, robot: RobotModel, scene: dict, ignored: set[frozenset[str]]):
        model = parse_urdf(robot.urdf)
        joints = chain_joints(model, robot.base_link, robot.tip_link)
        chain = to_kdl(joints)
        segments = [chain.getSegment(index) for index in range(chain.getNrOfSegments())]
        self._segments = [(segment, segment.getJoint().getType() == PyKDL.Joint.Fixed) for segment in segments]
        links = [robot.base_link, *(segment.getName() for segment in segments)]
        moving, self._shapes, self._row = 0, [], []
        standing = set()
        for row, link in enumerate(links):
            moving += row > 0 and joints[row - 1].joint_type != "fixed"
            standing |= set() if moving else {link}
            for shape in _link_shapes(model.link_map[link]):
                self._shapes.append(shape)
                self._row.append(row)
        arm = len(self._shapes)
        self._shapes += _scene_shapes(scene)
        self._row += [0] * (len(self._shapes) - arm)
        self._pairs = [
            (one, two)
            for one, two in combinations(range(len(self._shapes)), 2)
            if self._checked(one, two, arm, standing, ignored)
        ]
        self._request = fcl.CollisionRequest()

    def _checked(self, one: int, two: int, arm: int, standing: set[str], ignored: set[frozenset[str]]) -> bool:
        first, second = self._shapes[one].owner, self._shapes[two].owner
        if two >= arm:  # what stands on the floor may touch it
            return one < arm and first not in standing
        return first != second and frozenset((first, second)) not in ignored

    def contacts(self, qs: np.ndarray) -> list[tuple[int, str, str]]:
        """Return every contact as row, and names of the two.

        Args:
            qs: Shape (m, n). [rad] or [m]
        """
        positions, rotations = self._frames(qs)
        at, turned, reach = [], [], []
        for shape, row in zip(self._shapes, self._row):
            at.append(positions[:, row] + rotations[:, row] @ shape.position)
            turned.append(rotations[:, row] @ shape.rotation)
            reach.append(np.abs(turned[-1]) @ shape.half)
        found = []
        for one, two in self._pairs:
            # bodies whose axis-aligned boxes do not overlap need no exact check
            near = (np.abs(at[one] - at[two]) <= reach[one] + reach[two]).all(axis=1)
            for row in np.flatnonzero(near):
                for index in (one, two):
                    self._shapes[index].collider.setTransform(fcl.Transform(turned[index][row], at[index][row]))
                first, second = self._shapes[one], self._shapes[two]
                if fcl.collide(first.collider, second.collider, self._request, fcl.CollisionResult()):
                    found.append((int(row), first.owner, second.owner))
        return found

    def _frames(self, qs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return every link's position (m, links, 3) and rotation (m, links, 3, 3) in the base, the base's first."""
        rows = []
        for q in qs.tolist():
            frame, joints = PyKDL.Frame(), iter(q)
            row = [(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)]
            for segment, fixed in self._segments:
                frame = frame * segment.pose(0.0 if fixed else next(joints))
                # not *frame.p: iterating over a KDL vector takes ten times as long as its three elements
                p = frame.p
                row.append((p[0], p[1], p[2], *frame.M.GetQuaternion()))
            rows.append(row)
        values = np.array(rows)
        rotations = Rotation.from_quat(values[..., 3:].reshape(-1, 4)).as_matrix()
        return values[..., :3], rotations.reshape(*values.shape[:2], 3, 3)
