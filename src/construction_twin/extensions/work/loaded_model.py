"""A building model in its cell, loaded: what is to be done, with what, and where everything is. Poses in the base_link [m]."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from construction_twin.extensions.work.ledger import ModelElement, bodies_digest
from construction_twin.extensions.work.names import labels
from construction_twin.extensions.work.schedule import Schedule
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rpy_to_rotation
from construction_twin.robot.tool import Tool
from construction_twin.scene.objects import SceneObject

if TYPE_CHECKING:
    # whoever only draws elements waits for no library of shapes
    from construction_twin.extensions.work.layout import StockPlan

#: The process that reads the model and plans tasks, see `core.worker`.
WORKER = (sys.executable, "-m", "construction_twin.extensions.work.worker_functions")


@dataclass(frozen=True, eq=False)
class ElementFacts:
    """An element that is to be worked on.

    Attributes:
        bodies: Convex pieces ``<GlobalId>/0``, ..., in the element's frame.
        triangles: Shape (t, 3, 3), in the element's frame [m].
        mass: [kg]
    """

    name: str
    bodies: tuple[SceneObject, ...]
    base_T_goal: Pose
    triangles: np.ndarray
    mass: float | None = None
    ifc_class: str = ""


@dataclass(frozen=True)
class Scheduled:
    """When the model's schedule has a job: ISO 8601, and [s]."""

    start: str = ""
    duration: float | None = None


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """A loaded model.

    Attributes:
        unplannable: By GlobalId, why an element can never be planned.
        standing: What stands where the model has it, and no task makes.
        comes_after: By GlobalId, the elements that are placed before one is there.
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
        """The jobs that each removal and job waits for, in the schedule's order."""
        return {
            job.id: tuple(dict.fromkeys(wait.job for wait in job.after))
            for job in (*self.schedule.removals, *self.schedule.jobs)
        }

    @cached_property
    def titles(self) -> dict[str, str]:
        """What each job and removal is called in sentences."""
        every = {job.id: job.name for job in (*self.schedule.jobs, *self.schedule.removals)}
        return {**{job: job for job in every}, **labels(every)}

    @cached_property
    def model_elements(self) -> dict[str, ModelElement]:
        """What the model says of the element of each job and removal."""
        jobs = (*self.schedule.jobs, *self.schedule.removals)
        return {job.id: _model_element(job.element, self.elements[job.element]) for job in jobs}

    @property
    def standing_elements(self) -> frozenset[str]:
        """The elements that no task places."""
        worked_on = (job.element for job in self.schedule.jobs if not job.moves)
        return frozenset((*map(element_in, self.standing), *worked_on)) - {*self.schedule.placing}

    def stays(self, job: str) -> bool:
        """Return whether the process of a job leaves its element where it stands."""
        return not self.schedule.job(job).moves

    @property
    def removals(self) -> dict[str, str]:
        """The element that each removal takes down."""
        return {job.id: job.element for job in self.schedule.removals}


def glb(elements: Mapping[str, ElementFacts], model_hash: str) -> bytes:
    """Return the elements as binary glTF for the console's page: a node each, y up."""
    # slow to import
    import trimesh
    from trimesh.exchange.gltf import export_glb

    scene, upright = trimesh.Scene(), np.eye(4)
    upright[:3, :3] = rpy_to_rotation((-90.0, 0.0, 0.0))
    for name, facts in elements.items():
        if not len(facts.triangles):
            continue
        base_T_goal, corners = np.eye(4), facts.triangles.reshape(-1, 3)
        base_T_goal[:3] = np.column_stack((facts.base_T_goal.rotation, facts.base_T_goal.position))
        mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
        extras = {"element": name, "label": facts.name}
        scene.add_geometry(mesh, node_name=name, transform=upright @ base_T_goal, metadata=extras)

    def add_hash(document: dict) -> None:
        document["asset"]["extras"] = {"model_hash": model_hash}

    return bytes(export_glb(scene, include_normals=False, tree_postprocessor=add_hash))


def _model_element(element: str, facts: ElementFacts) -> ModelElement:
    """Return what the model says of an element; its place to 0.1 mm, as files round numbers."""
    digest = ""
    if facts.bodies:
        goal = np.column_stack((facts.base_T_goal.rotation, facts.base_T_goal.position))
        # no -0.0 beside 0.0
        place = (np.round(goal, 4) + 0.0).tolist()
        said = [element, facts.name, facts.ifc_class, bodies_digest(facts.bodies), place]
        digest = hashlib.sha256(json.dumps(said).encode()).hexdigest()
    return ModelElement(element, facts.name, facts.ifc_class, digest)


def element_in(item: SceneObject) -> str:
    """Return the GlobalId of the element that a body of the scene is of."""
    return item.name.split("/", 1)[0]
