"""What stands where: elements as built against the model, and the scene's objects of tool, stock and placed elements.

Metres, radians; poses in the robot's base_link unless the name says otherwise. As tuples: x, y, z and quaternion x, y, z, w.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.extensions.work.task_memory import TaskMemory, TaskState
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import quaternion_to_rotation, rotation_to_quaternion
from construction_twin.scene.objects import Scene, SceneObject, product, relative
from construction_twin.scene.scene_change import SceneChange

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
    """
    planned = product(base_T_tool0_planned, tool0_T_element)
    built = product(base_T_tool0, tool0_T_element)
    found = deviation(planned, base_T_goal)
    if found.distance <= _TURNED_BY and found.angle <= _TURNED_ABOUT:
        return built
    return product(built, relative(planned, base_T_goal))


def placed_at(memory: TaskMemory, base_T_goal: Pose) -> Pose:
    """Return where a placed element stands: as built, as far as that is known, else where the model has it, or had it then."""
    return pose_of_tuple(memory.base_T_element or memory.goal) if memory.base_T_element or memory.goal else base_T_goal


def objects_of(
    bodies: Sequence[SceneObject], memory: TaskMemory | None, base_T_stock: Pose | None, base_T_goal: Pose, link: str
) -> tuple[SceneObject, ...] | None:
    """Return the scene's objects of one element as the ledger has it; None: what is there is left as it is.

    Args:
        bodies: Convex pieces ``<GlobalId>/0``, ..., in the element's frame; of a placed element as it was placed.
        memory: Of the task that places it; None: no task does, it stands where the model has it.
        base_T_stock: None: it does not lie in its stock, even if it was not taken.
    """
    if memory is None:
        return at(bodies, base_T_goal)
    if memory.placed:
        # also while it is asked about: it stands until a person says that it does not
        return at(bodies, placed_at(memory, base_T_goal))
    if memory.state is TaskState.ASKS:
        return None
    if memory.in_grip:
        return at(bodies, pose_of_tuple(memory.tool0_T_element), link)
    return () if memory.gone or base_T_stock is None else at(bodies, base_T_stock)


def at(bodies: Sequence[SceneObject], pose: Pose, link: str = "") -> tuple[SceneObject, ...]:
    """Return bodies in an element's frame at the element's pose: in the robot's base_link, or on a link."""
    return tuple(item.moved(product(pose, item.pose), link) for item in bodies)


def change(scene: Scene, wanted: Mapping[str, SceneObject], left_alone: Collection[str]) -> SceneChange:
    """Return what has to change so that the work's objects are the wanted ones; others are not touched."""
    there = {item.name: item for item in scene.objects}
    put = tuple(item for name, item in wanted.items() if name not in there or there[name].contents() != item.contents())
    mine = [name for name in there if "/" in name and name.split("/", 1)[0] not in left_alone]
    return SceneChange(put, tuple(name for name in mine if name not in wanted))
