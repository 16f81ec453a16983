"""A building model in its cell, read: what is to be done, with what, and where everything is. Records only.

Times in s, poses in the robot's base_link [m].
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from construction_twin.extensions.work.ledger import Present, body_digest
from construction_twin.extensions.work.names import labels
from construction_twin.extensions.work.schedule import Schedule
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.tool import Tool
from construction_twin.scene.objects import SceneObject

if TYPE_CHECKING:
    # whoever only draws elements waits for no library of shapes
    from construction_twin.extensions.work.site_scene import StockPlan

#: The process that reads the model and plans tasks, see `core.worker`.
WORKER = (sys.executable, "-m", "construction_twin.extensions.work.worker_functions")


@dataclass(frozen=True, eq=False)
class ElementFacts:
    """What is known of an element that is to be placed.

    Attributes:
        bodies: Convex pieces ``<GlobalId>/0``, ..., in the element's frame.
        ifc_class: ``IfcMember``.
        triangles: Shape (t, 3, 3). For pictures, in the element's frame [m].
        mass: That is planned with [kg]; None: nobody says.
    """

    name: str
    bodies: tuple[SceneObject, ...]
    base_T_goal: Pose
    triangles: np.ndarray
    mass: float | None = None
    ifc_class: str = ""


@dataclass(frozen=True)
class Scheduled:
    """When a schedule has a job.

    Attributes:
        start: ISO 8601; empty: not said.
        duration: [s]; None: not said.
    """

    start: str = ""
    duration: float | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A model in its cell, read.

    Attributes:
        tool_objects: The tool's shapes, carried by the arm's tip link.
        unplannable: Why an element can never be planned, by GlobalId; it has no slot.
        standing: What stands where the model has it, and no task makes.
        comes_after: Elements that are placed before such an element is there, by its GlobalId, of those that wait for any.
    """

    model: str
    digest: str
    cell: str
    schedule: Schedule
    schedule_digest: str
    elements: Mapping[str, ElementFacts]
    stock: StockPlan
    tool: Tool
    tool_objects: tuple[SceneObject, ...]
    notes: tuple[str, ...] = ()
    unplannable: Mapping[str, str] = field(default_factory=dict)
    standing: tuple[SceneObject, ...] = ()
    scheduled: Mapping[str, Scheduled] = field(default_factory=dict)
    comes_after: Mapping[str, frozenset[str]] = field(default_factory=dict)

    @property
    def after(self) -> dict[str, tuple[str, ...]]:
        """What each removal and job waits for, in the schedule's order."""
        return {
            job.id: tuple(dict.fromkeys(wait.job for wait in job.after))
            for job in (*self.schedule.removals, *self.schedule.jobs)
        }

    @cached_property
    def titles(self) -> dict[str, str]:
        """Return what each job and removal is called in sentences."""
        every = {job.id: job.name for job in (*self.schedule.jobs, *self.schedule.removals)}
        return {**{job: job for job in every}, **labels(every)}

    @cached_property
    def present(self) -> dict[str, Present]:
        """Return what the model says of the element of each job and removal."""
        jobs = (*self.schedule.jobs, *self.schedule.removals)
        return {job.id: _present(job.element, self.elements[job.element]) for job in jobs}

    @property
    def standing_elements(self) -> frozenset[str]:
        """GlobalIds of what stands where the model has it, as no task places it."""
        worked_on = (job.element for job in self.schedule.jobs if not job.moves)
        return frozenset((*map(element_in, self.standing), *worked_on)) - {*self.schedule.placing}

    def stays(self, job: str) -> bool:
        """Return whether the process of a job leaves its element where it stands."""
        return not self.schedule.job(job).moves

    @property
    def removals(self) -> dict[str, str]:
        """The element that each removal takes down."""
        return {job.id: job.element for job in self.schedule.removals}


def _present(element: str, facts: ElementFacts) -> Present:
    """Return what the model says of an element; where it is to 0.1 mm, so that how a file writes its numbers is no change."""
    digest = ""
    if facts.bodies:
        goal = np.column_stack((facts.base_T_goal.rotation, facts.base_T_goal.position))
        # no -0.0 beside 0.0
        place = (np.round(goal, 4) + 0.0).tolist()
        said = [element, facts.name, facts.ifc_class, body_digest(facts.bodies), place]
        digest = hashlib.sha256(json.dumps(said).encode()).hexdigest()
    return Present(element, facts.name, facts.ifc_class, digest)


def element_in(item: SceneObject) -> str:
    """Return the GlobalId of the element that a body of the scene is of."""
    return item.name.split("/", 1)[0]
