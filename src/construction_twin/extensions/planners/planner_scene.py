"""The scene as other planners know it: shapes grown by their padding, what carried objects may touch, who is checked with whom.

Other planners have no padding per object, so it is put into the shape: what stands is larger by the scene's padding and its own,
what is carried by its own (the standing objects have the scene's already). A box, cylinder or sphere that is grown holds every
point within the padding. A mesh is given as it is. Metres.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import Scene, SceneObject, product, read_mesh_file
from construction_twin.scene.pair_checks import checked_pairs
from construction_twin.scene.self_collision import SelfCollision


@dataclass(frozen=True, eq=False)
class PlannerObject:
    """One object of the scene, grown by its padding.

    Attributes:
        dimensions: [m] box: x, y, z; cylinder: radius, length; sphere: radius; mesh: empty.
        vertices, triangles: Shape (v, 3) and (t, 3). Of a mesh [m]; otherwise empty.
        frame: The link that it stands in: the one that carries it, or the robot's base_link.
        touch_links: Links that a carried object may touch: those that move with it, and those it names.
    """

    name: str
    shape: str
    dimensions: tuple[float, ...]
    vertices: np.ndarray
    triangles: np.ndarray
    frame: str
    pose: Pose
    carried: bool
    touch_links: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PlannerScene:
    """A scene as another planner receives it.

    Attributes:
        names: Links with a shape, then objects.
        allowed: Shape (n, n), true or false. For each two of the names: they are not checked against each other.
        fixed_links: Links with a shape that nothing moves: objects that only the other planner knows are not checked against them.
        root_T_base: The robot's base_link in the root of its URDF.
        remarks: What could not be expressed, one sentence each.
    """

    objects: tuple[PlannerObject, ...]
    names: tuple[str, ...]
    allowed: np.ndarray
    fixed_links: tuple[str, ...]
    root_T_base: Pose
    remarks: tuple[str, ...]


def planner_scene(bodies: RobotBodies, scene: Scene, self_collision: SelfCollision) -> PlannerScene:
    """Return a scene as other planners know it."""
    own = (*bodies.bodies, *bodies.place_all(scene))
    names = tuple(dict.fromkeys(body.owner for body in own))
    index = {name: number for number, name in enumerate(names)}
    allowed = np.ones((len(names), len(names)), dtype=bool)
    for first, second, _ in checked_pairs(own, scene.padding, self_collision):
        one, other = index[own[first].owner], index[own[second].owner]
        allowed[one, other] = allowed[other, one] = False
    shaped = dict.fromkeys(body.link for body in bodies.bodies)
    links = {link: bodies.link_joints[link] for link in shaped}
    root_T_base = bodies.root_T_base
    return PlannerScene(
        tuple(_grown(item, scene, bodies) for item in scene.objects),
        names,
        allowed,
        tuple(link for link, joint in links.items() if joint == 0),
        Pose(root_T_base.translation.copy(), root_T_base.rotation.copy()),
        tuple(_remarks(scene)),
    )


def scene_text(scene: PlannerScene, name: str) -> tuple[str, tuple[str, ...]]:
    """Return the objects that stand, in the text format that MoveIt's panel imports (`.scene`), and remarks: what is not in it.

    The format is MoveIt 1.1's, with the object's pose and subframes; poses are in the root of the URDF. It knows neither carried
    objects nor pairs that may touch.
    """
    lines, own = [name], Pose(np.zeros(3), np.eye(3))
    for item in scene.objects:
        if item.carried:
            continue
        lines += [f"* {item.name}", *_pose_lines(product(scene.root_T_base, item.pose)), "1", item.shape]
        if item.shape == "mesh":
            lines += [
                f"{len(item.vertices)} {len(item.triangles)}",
                *map(_line, item.vertices),
                *map(_line, item.triangles),
            ]
        else:
            lines.append(_line(item.dimensions))
        # the shape is in the object's frame; no colour of its own, no subframes
        lines += [*_pose_lines(own), "0 0 0 0", "0"]
    left_out = tuple(
        f"{item.name!r} is carried by {item.frame}: the format has no carried objects, attach it in the panel"
        for item in scene.objects
        if item.carried
    )
    return "\n".join([*lines, ".", ""]), (*scene.remarks, *left_out)


def _pose_lines(pose: Pose) -> tuple[str, str]:
    return _line(pose.position), _line(rotation_to_quaternion(pose.rotation))


def _line(values: Iterable[float]) -> str:
    # + 0.0 turns minus zero into zero
    return " ".join(f"{float(value) + 0.0:.9g}" for value in values)


def _grown(item: SceneObject, scene: Scene, bodies: RobotBodies) -> PlannerObject:
    margin = item.padding + (0.0 if item.link else scene.padding)
    dimensions: tuple[float, ...] = ()
    vertices, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=int)
    if item.shape == "mesh":
        x, y, z = item.size
        contents = read_mesh_file(item.name, item.mesh)
        vertices, triangles = parse_mesh(f"object {item.name!r} mesh", item.mesh, contents, (x, y, z))
    elif item.shape == "box":
        dimensions = tuple(size + 2.0 * margin for size in item.size)
    elif item.shape == "cylinder":
        radius, length = item.size
        dimensions = radius + margin, length + 2.0 * margin
    else:
        dimensions = (item.size[0] + margin,)
    return PlannerObject(
        item.name, item.shape, dimensions, vertices, triangles, item.link or bodies.robot.base_link, item.pose, bool(item.link),
        _touch_links(item, bodies),
    )  # fmt: skip


def _touch_links(item: SceneObject, bodies: RobotBodies) -> tuple[str, ...]:
    if not item.link:
        return ()
    moves = bodies.model.frames[bodies.model.getFrameId(item.link, pinocchio.FrameType.BODY)].parentJoint
    with_it = {link for link, joint in bodies.link_joints.items() if joint == moves}
    return tuple(sorted(with_it | (set(item.touch) & set(bodies.link_joints))))


def _remarks(scene: Scene) -> Iterable[str]:
    for item in scene.objects:
        margin = item.padding + (0.0 if item.link else scene.padding)
        if item.shape == "mesh" and margin > 0.0:
            yield f"{item.name!r} is a mesh: its padding of {margin * 1e3:g} mm is not in it"
