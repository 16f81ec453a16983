"""Whether the arm can do each task of a building model, before anything starts.

Each is planned in the scene that its turn finds if everything before it stands as designed, from the arm's home pose: so each can
be checked on its own. SI; time is an argument.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.extensions.work.motions import TaskPlanner
from construction_twin.extensions.work.process import TaskMotions, WorkJob, process_of
from construction_twin.extensions.work.recipe import DEFAULT
from construction_twin.extensions.work.schedule import Schedule
from construction_twin.extensions.work.site import pose_of
from construction_twin.extensions.work.site_scene import Layout, WorkState
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import RobotModel
from construction_twin.scene.objects import Scene, product

#: Points of the tool's path that are kept are this far apart [s].
_PATH_STEP = 0.1


@dataclass(frozen=True)
class CheckedTask:
    """What was found for one job.

    Attributes:
        grip: How it is done, see `TaskMotions.method`, or the method that came furthest; empty: none.
        track: Value of the first linear joint where the process acts at the element's place [m]; None: the robot has none, or
            there is no plan.
        clearance: [m], see `TaskMotions`.
        duration: Of all motions [s], without the waiting for the tool.
        planning: Time it took to find out [s].
        stage, reason: What was not possible, and why; empty if it is possible.
        remarks: What a person should know of the task or its element, as the model was read.
        path: Length 3. The tool's centre point in the base [m].
    """

    number: int
    job: str
    name: str
    element: str
    element_name: str
    ifc_class: str
    possible: bool
    grip: str = ""
    track: float | None = None
    clearance: float | None = None
    duration: float | None = None
    planning: float = 0.0
    stage: str = ""
    reason: str = ""
    remarks: tuple[str, ...] = ()
    path: tuple[tuple[float, float, float], ...] = field(default=(), repr=False)
    process: str = DEFAULT


class Checker:
    """Plans every job of a schedule on its own. Not for use from several threads at once.

    `unplannable`: Why an element can never be planned, by GlobalId.
    """

    def __init__(
        self,
        robot: RobotModel,
        planner: TaskPlanner,
        layout: Layout,
        schedule: Schedule,
        unplannable: Mapping[str, str],
        clock: Callable[[], float],
    ):
        self._robot, self._planner, self._layout, self._clock = robot, planner, layout, clock
        self._schedule, self._unplannable = schedule, unplannable
        self._jobs = schedule.jobs
        self._chain = Chain(robot)
        self._tool0_T_tcp = pose_of(layout.site.tool.tool.tool0_T_tcp)

    def check(self, number: int) -> CheckedTask:
        """Return what was found for one job of the schedule, by its number from 0."""
        job = self._jobs[number]
        element = self._layout.building.element(job.element)
        began = self._clock()
        remarks = self._schedule.remarks.get(job.id, ())
        about = number, job.id, job.name, job.element, element.name, element.ifc_class
        found = CheckedTask(*about, False, remarks=remarks, process=job.process)
        if job.element in self._unplannable:
            return replace(found, reason=self._unplannable[job.element])
        scene, place = self._turn(number)
        try:
            plan = self._planner.plan(place, self._robot.home, scene)
        except ConstructionTwinError as error:
            found = replace(found, planning=self._clock() - began, reason=str(error))
            if isinstance(error, TaskPlanningError):
                found = replace(found, stage=error.stage, grip=error.method, reason=error.reason)
            return replace(found, reason=self._layout.building.called(found.reason, job.element))
        return replace(self._described(found, plan), planning=self._clock() - began)

    def _before(self, number: int) -> set[str]:
        """Return the elements that a job waits for, at first or second hand."""
        open_jobs, elements = [self._jobs[number]], set()
        while open_jobs:
            for wait in open_jobs.pop().after:
                other = self._schedule.job(wait.job)
                if other.element not in elements:
                    elements.add(other.element)
                    open_jobs.append(other)
        return elements

    def _turn(self, number: int) -> tuple[Scene, WorkJob]:
        """Return scene and job when everything before it stands, of what has geometry."""
        before = [job.element for job in self._jobs[:number] if job.element in self._layout.order]
        gone = frozenset(job.element for job in self._schedule.removals) & self._before(number)
        scene = self._layout.scene(WorkState({one: self._layout.base_T_goal(one) for one in before}, gone))
        return scene, self._layout.job_for(self._jobs[number].element, scene, self._jobs[number].id)

    def _described(self, found: CheckedTask, plan: TaskMotions) -> CheckedTask:
        acts = process_of(found.process).acts
        at = next(segment for segment in plan.segments if segment.name == acts).trajectory.positions[-1]
        linear = [float(value) for value, is_linear in zip(at, self._robot.linear, strict=True) if is_linear]
        return replace(
            found,
            possible=True,
            grip=plan.method,
            track=linear[0] if linear else None,
            clearance=float(plan.clearance),
            duration=float(plan.duration),
            path=tuple(self._path(plan)),
        )

    def _path(self, plan: TaskMotions) -> Iterator[tuple[float, float, float]]:
        for segment in plan.segments:
            count = max(2, int(segment.trajectory.duration / _PATH_STEP))
            for q in segment.trajectory.sample_many(np.linspace(0.0, segment.trajectory.duration, count))[0]:
                x, y, z = product(self._chain.forward(q), self._tool0_T_tcp).position
                yield round(float(x), 3), round(float(y), 3), round(float(z), 3)
