"""The port to a process, a way of working on an element such as `place`: one folder beside this module, found by its name.

See docs/architecture.md, "The port to a process". Motions' checks, review, switches and ledger are alike for each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.building import Element, Value
from construction_twin.extensions.work.recipe import DEFAULT, Override, Recipe
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.tool import Tool
from construction_twin.scene.objects import Scene, SceneObject


@dataclass(frozen=True, eq=False)
class WorkJob:
    """What is to be done with one element.

    Attributes:
        bodies: Convex pieces ``<GlobalId>/0``, ..., in the element's frame, `link` empty.
        base_T_stock: ``base_T_element`` in its stock; None: it stands at its place and is not moved.
        base_T_goal: ``base_T_element`` at its place: as designed where it is placed, as built where it stands.
        supports: Names of scene objects that the element may touch at its place and in the stock.
        up: Length 3. Against gravity, a unit vector.
        task_properties: Of the task's own `recipe.PROPERTY_SET`, which come before the element's.
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
        method: Name of the way in which the process does it: of `place` the grip.
        scenes: Before each segment, and after the last.
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


#: The stage of every process at which the arm does not get there at all.
REACH = "reach"


@dataclass(frozen=True)
class Process:
    """One process.

    Attributes:
        moves: It takes the element from its stock to its place; else the element stands at its place all the time.
        overrides: Properties of an element in the model that replace a key of its recipe, by their names.
        check_recipe: Takes a recipe, the tool, and where the recipe stands; raises ConfigurationError.
        mass: Takes a job, name of its recipe, the recipe and the tool; returns the mass to plan with [kg], None: unknown. Raises
            TaskPlanningError.
        acts: Name of the segment at whose end it acts at the element's place.
        check: Takes a `motions.Search`; raises TaskPlanningError when job or scene are not what it needs.
        plan: Takes the same; returns the plan, or raises `motions.Failed` with the attempt that came furthest.
    """

    moves: bool
    recipe: type[Recipe]
    overrides: Mapping[str, Override]
    check_recipe: Callable[[Any, Tool, str], None]
    mass: Callable[[WorkJob, str, Any, Tool], float | None]
    acts: str
    check: Callable[[Any], None]
    plan: Callable[[Any], TaskMotions]


#: Module of each process; its `PROCESS` is the process.
MODULES = {DEFAULT: "construction_twin.extensions.work.place.planner"}


@cache
def process_of(name: str) -> Process:
    """Return a process by its name; ConfigurationError for one that is not known."""
    if name not in MODULES:
        raise ConfigurationError("process", name, f"one of {', '.join(MODULES)}")
    return import_module(MODULES[name]).PROCESS
