"""What is asked of the arm for one task, and the segments with which it does it. Records only.

SI; poses in the robot's base_link unless the name says otherwise; joint vectors in the order of `RobotModel.joint_names`.
"""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import Scene, SceneObject


@dataclass(frozen=True, eq=False)
class PlaceJob:
    """One element from its stock to its place.

    Attributes:
        task: Id of the task.
        element: GlobalId of the element; its scene objects are called ``<element>/0``, ``<element>/1``, ...
        properties: The element's property sets, for recipes and ``CTwin_RobotTask``.
        bodies: The element's convex pieces, named as above, their poses in the element's frame, `link` empty.
        mass: [kg]
        base_T_stock, base_T_goal: ``base_T_element`` before and after.
        supports: Names of scene objects that the element may touch where it is put down, and of those that it lies on in the stock.
        up: Length 3. Against gravity, a unit vector: the model's z axis.
    """

    task: str
    element: str
    element_name: str
    ifc_class: str
    type_name: str
    properties: dict
    bodies: tuple[SceneObject, ...]
    mass: float | None
    base_T_stock: Pose
    base_T_goal: Pose
    supports: tuple[str, ...] = ()
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class WorkSegment:
    """One motion from rest to rest, and what happens at its end.

    Attributes:
        put: Added or replaced after the switches.
    """

    name: str
    trajectory: Trajectory
    engaged: bool
    requires: tuple[Signal, ...]
    switches: tuple[Switch, ...]
    put: tuple[SceneObject, ...]
    remove: tuple[str, ...]
    scene: Scene
    scene_after: Scene


@dataclass(frozen=True, eq=False)
class WorkPlan:
    """A whole task, planned.

    Attributes:
        grip: Name of the grip candidate that is used.
        planning_time: [s]
        clearance: Smallest over all segments, without what they approach on purpose [m].
        tool0_T_element: How the element is held.
    """

    job: PlaceJob
    grip: str
    segments: tuple[WorkSegment, ...]
    planning_time: float
    clearance: float
    tool0_T_element: Pose

    @property
    def duration(self) -> float:
        """Time of all motions [s], without the waiting for switches."""
        return sum(segment.trajectory.duration for segment in self.segments)
