"""What stands where: elements as built against the model, and the scene's objects of tool, stock and placed elements.

Metres, radians; poses in the robot's base_link unless the name says otherwise. As tuples: x, y, z and quaternion x, y, z, w.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import quaternion_to_rotation, rotation_to_quaternion
from construction_twin.scene.objects import Scene, SceneObject, product, relative
from construction_twin.work.task_memory import TaskMemory
from construction_twin.work.task_states import TaskState

#: Further than this from where the model has it, an element was turned by a symmetry of its own [m], [rad].
_TURNED_BY, _TURNED_ABOUT = 1e-3, math.radians(1.0)


@dataclass(frozen=True)
class Deviation:
    """How far an element stands from where the model has it: of its frame's origin [m], and turned [rad]."""

    distance: float
    angle: float


def pose_tuple(pose: Pose) -> tuple[float, ...]:
    """Return a pose as seven numbers."""
    return (*map(float, pose.position), *map(float, rotation_to_quaternion(pose.rotation)))


def pose_of_tuple(values: tuple[float, ...]) -> Pose:
    """Return a pose from seven numbers."""
    x, y, z, w = values[3:]
    return Pose(np.array(values[:3]), quaternion_to_rotation((x, y, z, w)))


def deviation(base_T_built: Pose, base_T_goal: Pose) -> Deviation:
    """Return how far a pose is from another."""
    goal_T_built = relative(base_T_goal, base_T_built)
    sine = np.linalg.norm(
        [
            goal_T_built.rotation[2, 1] - goal_T_built.rotation[1, 2],
            goal_T_built.rotation[0, 2] - goal_T_built.rotation[2, 0],
            goal_T_built.rotation[1, 0] - goal_T_built.rotation[0, 1],
        ]
    )
    # of small angles the cosine tells nothing, the sine all
    angle = math.atan2(float(sine), float(np.trace(goal_T_built.rotation)) - 1.0)
    return Deviation(float(np.linalg.norm(goal_T_built.position)), angle)


def as_built(base_T_tool0: Pose, base_T_tool0_planned: Pose, tool0_T_element: Pose, base_T_goal: Pose) -> Pose:
    """Return where an element stands that the arm let go of.

    An element that was planned to be set down turned by a symmetry of its shape is one that is not turned: its frame is told as if.

    Args:
        base_T_tool0, base_T_tool0_planned: Of the flange when it let go: measured, and planned.
        base_T_goal: Where the model has it.
    """
    planned = product(base_T_tool0_planned, tool0_T_element)
    built = product(base_T_tool0, tool0_T_element)
    found = deviation(planned, base_T_goal)
    if found.distance <= _TURNED_BY and found.angle <= _TURNED_ABOUT:
        return built
    return product(built, relative(planned, base_T_goal))


@dataclass(frozen=True, eq=False)
class Piece:
    """An element as the scene has it.

    Attributes:
        bodies: Convex pieces ``<GlobalId>/0``, ..., in the element's frame.
        base_T_stock: None: it is in no rack.
    """

    bodies: tuple[SceneObject, ...]
    base_T_stock: Pose | None
    base_T_goal: Pose


def objects_of(
    element: Piece, memory: TaskMemory | None, in_stock: bool, tip_link: str
) -> tuple[SceneObject, ...] | None:
    """Return the scene's objects of one element as the ledger has it; None: what is there is left as it is.

    Args:
        memory: Of the task that places it; None: no task does, it stands where the model has it.
        in_stock: It has been delivered, if it was not taken.
        tip_link: What carries the tool.
    """
    if memory is None:
        return _at(element, element.base_T_goal)
    if memory.state is TaskState.ASKS:
        return None
    if memory.placed:
        where = pose_of_tuple(memory.base_T_element) if memory.base_T_element else element.base_T_goal
        return _at(element, where)
    if memory.in_grip:
        held = pose_of_tuple(memory.tool0_T_element)
        return tuple(item.moved(product(held, item.pose), tip_link) for item in element.bodies)
    if memory.gone or not in_stock or element.base_T_stock is None:
        return ()
    return _at(element, element.base_T_stock)


def _at(element: Piece, base_T_element: Pose) -> tuple[SceneObject, ...]:
    return tuple(item.moved(product(base_T_element, item.pose)) for item in element.bodies)


@dataclass(frozen=True)
class Change:
    """What makes one scene of another: objects that are put, and names that are removed."""

    put: tuple[SceneObject, ...]
    remove: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.put or self.remove)


def change(scene: Scene, wanted: Mapping[str, SceneObject], left_alone: Collection[str]) -> Change:
    """Return what has to change so that the work's objects are the wanted ones; others are not touched.

    Args:
        wanted: By name.
        left_alone: GlobalIds of elements whose objects stay as they are.
    """
    there = {item.name: item for item in scene.objects}
    put = tuple(item for name, item in wanted.items() if name not in there or not _same(there[name], item))
    mine = [name for name in there if "/" in name and name.split("/", 1)[0] not in left_alone]
    return Change(put, tuple(name for name in mine if name not in wanted))


def _same(one: SceneObject, other: SceneObject) -> bool:
    return one.contents() == other.contents()
