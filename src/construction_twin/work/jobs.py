"""What is asked of the arm for one task, and the segments with which it does it. Records only.

SI; poses in the robot's base_link unless the name says otherwise; joint vectors in the order of `RobotModel.joint_names`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from construction_twin.kinematics.chain import Pose
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.work.building import Element, Value


@dataclass(frozen=True, eq=False)
class WorkJob:
    """What is to be done with one element. By which process, its recipe says.

    Attributes:
        bodies: Convex pieces ``<GlobalId>/0``, ``<GlobalId>/1``, ..., their poses in the element's frame, `link` empty.
        base_T_stock: ``base_T_element`` in its stock; None: its process does not move it, it stands at its place.
        base_T_goal: ``base_T_element`` at its place: as designed where it is placed, as built where it stands.
        supports: Names of scene objects that the element may touch where it is put down, and of those that it lies on in the stock.
        up: Length 3. Against gravity, a unit vector: the model's z axis.
        task_properties: Of the task's own `CTwin_RobotTask`, which come before the element's.
    """

    task: str
    element: Element
    bodies: tuple[SceneObject, ...] = ()
    base_T_stock: Pose | None = None
    base_T_goal: Pose = Pose(np.zeros(3), np.eye(3))
    supports: tuple[str, ...] = ()
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    task_properties: Mapping[str, Value] = field(default_factory=dict)

    @property
    def called(self) -> str:
        """The element in a sentence."""
        return (
            f"element {self.element.name!r} ({self.element.id})" if self.element.name else f"element {self.element.id}"
        )


@dataclass(frozen=True, eq=False)
class TaskMotions:
    """A whole task, planned.

    Attributes:
        method: Name of the way in which the process does it, of those that it found: of `place` the grip.
        scenes: One more than segments: the scene in which each is carried out, and the one after the last.
        planning_time: [s]
        clearance: Smallest over all segments, without what they approach on purpose [m].
        tool0_T_element: How the element is held; None: it is not moved.
    """

    job: WorkJob
    method: str
    segments: tuple[WorkSegment, ...]
    scenes: tuple[Scene, ...]
    planning_time: float
    clearance: float
    tool0_T_element: Pose | None = None

    @property
    def duration(self) -> float:
        """Time of all motions [s], without the waiting for switches."""
        return sum(segment.trajectory.duration for segment in self.segments)
