"""From a job to a work plan: what all processes have alike, and the motions that they make their plans of.

Every segment begins and ends at rest, is checked at each 4 ms sample and between them in the scene that the segments before it
leave, and lasts a whole number of cycles. Joint vectors in the order of `RobotModel.joint_names`, SI; poses in the robot's
base_link. Not for use from several threads at once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from construction_twin.core.clock import Clock
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.extensions.work.contacts import Shapes, difference
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.extensions.work.process import REACH, TaskMotions, WorkJob, process_of
from construction_twin.extensions.work.recipe import Recipe
from construction_twin.extensions.work.recipes import Recipes
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics, UnreachableError
from construction_twin.planning.cartesian import plan_cartesian
from construction_twin.planning.limit_usage import cycle_times
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.planning.recheck import check_free, check_limits
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.motion_errors import KinematicsError, PlanningError
from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.tool import ToolFile
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, tool_objects
from construction_twin.scene.self_collision import SelfCollision

#: Largest distance of an arm's wrist from its flange that is reckoned with [m].
_WRIST = 0.5


@dataclass(frozen=True)
class TaskLimits:
    """How long and how widely is searched.

    Attributes:
        budget: After this time no other method or way is begun [s].
        solutions: Most joint solutions of a pose that are tried.
        pairs: Most combinations of a first and a second straight way that are tried with one method.
        free_budget: Time for the search of one free way [s].
    """

    budget: float = 1.2
    solutions: int = 8
    pairs: int = 6
    free_budget: float = 0.7


class Failed(Exception):
    """One attempt was not possible.

    Attributes:
        stage: What was not possible: a segment, `process.REACH`, or another word of the process.
        method: Of the attempt, which the process adds; empty: none.
    """

    def __init__(self, stage: str, reason: str, hopeless: bool = False):
        self.stage, self.reason, self.hopeless, self.method = stage, reason, hopeless, ""


@dataclass(frozen=True, eq=False)
class Free:
    """A free way, and the clearance on it [m]."""

    trajectory: Trajectory
    clearance: float


@dataclass(frozen=True, eq=False)
class Search:
    """One planning: what is asked, what it is planned with, and the motions that an attempt is made of.

    Attributes:
        start: Shape (n,). Where the arm stands.
        held: ``tool0_T_element`` of an element that is in the grip already; None: it is where the job has it.
        began: By the clock [s].
    """

    job: WorkJob
    name: str
    recipe: Any
    start: np.ndarray
    scene: Scene
    held: Pose | None
    began: float
    robot: RobotModel
    solver: InverseKinematics
    planner: Planner
    settings: PlannerSettings
    tool: ToolFile
    limits: TaskLimits
    clock: Clock
    make_world: Callable[[Scene], CollisionWorld]
    shapes: Shapes = field(repr=False)
    _worlds: dict[str, CollisionWorld] = field(default_factory=dict, repr=False)

    @property
    def late(self) -> bool:
        """Whether the time for another attempt is over."""
        return self.clock() - self.began > self.limits.budget

    def world(self, scene: Scene) -> CollisionWorld:
        """Return the collision world of a scene, which is made once."""
        if scene.hash not in self._worlds:
            self._worlds[scene.hash] = self.make_world(scene)
        return self._worlds[scene.hash]

    def demand_reach(self, pose: Pose, where: str, room: Callable[[], float] = float) -> None:
        """Refuse a pose of the flange that the arm does not reach at all.

        `room`: Returns how far the flange may be from there with another method [m].
        """
        try:
            self.solver.nearest(pose, self.start)
        except UnreachableError as error:
            # how far the tool's centre point can be from the arm's wrist
            size = float(np.linalg.norm(self.tool.tool.tool0_T_tcp.xyz)) + _WRIST
            hopeless = not error.too_close and error.missing > 2.0 * (room() + size)
            raise Failed(REACH, f"{where}: {error}", hopeless) from error
        except KinematicsError as error:
            raise Failed(REACH, f"{where}: {error}") from error

    def solutions(self, pose: Pose, seed: np.ndarray, scene: Scene, stage: str, where: str) -> list[np.ndarray]:
        """Return joint solutions of a pose of the flange that touch nothing, the nearest first."""
        world = self.world(scene)
        try:
            found = [solution.q for solution in self.solver.all(pose, seed)]
        except KinematicsError as error:
            raise Failed(REACH, f"{where}: {error}") from error
        free = list(itertools.islice((q for q in found if world.is_free(q)), self.limits.solutions))
        if not free:
            self.demand_free(found[0], scene, stage, where)
        return free

    def demand_free(self, q: np.ndarray, scene: Scene, stage: str, where: str) -> None:
        """Refuse joint values at which something touches."""
        contact = self.world(scene).contact(q)
        if contact is not None:
            one, other = contact.between
            raise Failed(
                stage,
                Sentence(
                    "{where}, {first} touches {second} or is closer than the padding",
                    where=where,
                    first=one,
                    second=other,
                ),
            )

    def line(self, start: np.ndarray, pose: Pose, scale: float, scene: Scene, stage: str) -> Trajectory:
        """Return the straight way of the flange to a pose, checked for limits, contacts and depth of what may touch."""
        recipe: Recipe = self.recipe
        try:
            motion = plan_cartesian(
                start, [ToolWaypoint(pose)], self.solver, None, recipe.speed, scale, bounds=self.settings.bounds
            )
            trajectory, world = whole_cycles(motion.trajectory), self.world(scene)
            samples = self._checked(trajectory, world)
        except (PlanningError, KinematicsError) as error:
            raise Failed(stage, str(error)) from error
        touching = world.of_touching()
        found = None if touching is None else touching.clearance_of(samples)[0]
        if found is not None and found.distance < -recipe.penetration:
            one, other = found.between
            depth, most = -1e3 * found.distance, 1e3 * recipe.penetration
            raise Failed(stage, f"{one} would be {depth:.1f} mm inside of {other}; at most {most:g} mm are allowed")
        return trajectory

    def free(self, start: np.ndarray, goal: np.ndarray, scale: float, scene: Scene, stage: str) -> Free:
        """Return a free way between two joint vectors."""
        world = self.world(scene)
        try:
            plan = self.planner.plan_to_joints(start, goal, PlanRequest("work", speed_scale=scale), world)
            trajectory = whole_cycles(plan.trajectory)
            self._checked(trajectory, world)
        except (PlanningError, KinematicsError) as error:
            raise Failed(stage, str(error)) from error
        return Free(trajectory, plan.report.clearance.distance)

    def nearest(self, solutions: Sequence[np.ndarray]) -> list[int]:
        """Return the numbers of joint solutions, those that the arm gets to soonest first."""
        pace = np.array(self.robot.velocity)
        return sorted(
            range(len(solutions)), key=lambda one: round(float(np.max(np.abs(solutions[one] - self.start) / pace)), 9)
        )

    def _checked(self, trajectory: Trajectory, world: CollisionWorld) -> np.ndarray:
        """Check every 4 ms sample for limits, and the motion through them for contacts; return the samples."""
        check_limits(trajectory, self.robot)
        times = cycle_times(trajectory)
        samples = trajectory.sample_many(times)[0]
        check_free(samples, times, world)
        return samples


class PlanBuilder:
    """A work plan in the making: segments one after the other; `scene`: in which the first one begins."""

    def __init__(self, search: Search, scene: Scene):
        self._search = search
        self._segments: list[WorkSegment] = []
        self._scenes = [scene]
        self._clearances: list[float | None] = []

    def add(
        self, name: str, trajectory: Trajectory, engaged: bool, requires: tuple[Signal, ...], switches: tuple[Switch, ...],
        after: Scene, clearance: float | None = None,
    ) -> None:  # fmt: skip
        """Add a segment; `clearance`: of a free way [m], None: to be computed."""
        change = difference(self._scenes[-1], after)
        self._segments.append(WorkSegment(name, trajectory, engaged, requires, switches, change))
        self._scenes.append(after)
        self._clearances.append(clearance)

    def plan(self, method: str, tool0_T_element: Pose | None = None) -> TaskMotions:
        """Return the plan; arguments as of `TaskMotions`."""
        search = self._search
        planning_time = search.clock() - search.began
        clearance = min(map(self._clearance, self._segments, self._scenes, self._clearances))
        segments, scenes = tuple(self._segments), tuple(self._scenes)
        return TaskMotions(search.job, method, segments, scenes, planning_time, clearance, tool0_T_element)

    def _clearance(self, segment: WorkSegment, scene: Scene, known: float | None) -> float:
        if known is not None:
            return known
        samples = segment.trajectory.sample_many(cycle_times(segment.trajectory))[0]
        return self._search.world(scene).clearance_of(samples)[0].distance


def whole_cycles(trajectory: Trajectory) -> Trajectory:
    """Return the same motion slowed down by so little that it lasts a whole number of cycles."""
    cycles = math.ceil(trajectory.duration / CYCLE - 1e-6)
    factor = cycles * CYCLE / trajectory.duration
    if abs(factor - 1.0) < 1e-12:
        return trajectory
    times = trajectory.times * factor
    return Trajectory(
        trajectory.joint_names, times, trajectory.positions, trajectory.velocities / factor,
        trajectory.accelerations / factor**2,
    )  # fmt: skip


class TaskPlanner:
    """Plans tasks of one robot with one tool.

    The same job from the same pose in the same scene gives the same plan, unless a budget runs out. `clock`: Returns seconds from
    any fixed origin.
    """

    def __init__(
        self,
        robot: RobotModel,
        solver: InverseKinematics,
        settings: PlannerSettings,
        self_collision: SelfCollision,
        tool: ToolFile,
        recipes: Recipes,
        clock: Clock,
        limits: TaskLimits = TaskLimits(),
    ):
        self._robot, self._solver, self._tool, self._recipes = robot, solver, tool, recipes
        self._self_collision, self._clock, self._limits = self_collision, clock, limits
        self._settings = settings
        budget = min(settings.planning_budget, limits.free_budget)
        self._planner = Planner(robot, solver, settings.model_copy(update={"planning_budget": budget}), clock)
        self._shapes = Shapes()
        self._world: CollisionWorld | None = None

    def plan(self, job: WorkJob, start: JointValues, scene: Scene, held: Pose | None = None) -> TaskMotions:
        """Plan a task.

        Args:
            start: Length n. Where the arm stands.
            held: ``tool0_T_element`` of an element that is in the grip already, as `TaskMotions.tool0_T_element` of the plan that
                gripped it: the rest of the task is planned.
        """
        began = self._clock()
        name, recipe = self._recipes.of(job)
        process = process_of(recipe.process)
        q = np.array(start, dtype=float)
        search = Search(
            job, name, recipe, q, scene, held, began, self._robot, self._solver, self._planner, self._settings,
            self._tool, self._limits, self._clock, self._world_of, self._shapes,
        )  # fmt: skip
        process.check(search)
        self._check_tool(job, scene)
        try:
            self._robot.check_range(q)
        except KinematicsError as error:
            raise TaskPlanningError(job.task, Sentence("the arm's pose: {problem}", problem=str(error))) from error
        try:
            search.demand_free(q, scene, "", "where the arm stands")
            return process.plan(search)
        except Failed as failed:
            raise TaskPlanningError(job.task, failed.reason, failed.stage, failed.method) from failed

    def _world_of(self, scene: Scene) -> CollisionWorld:
        if self._world is None:
            self._world = CollisionWorld(self._robot, scene, self._self_collision)
        else:
            self._world = self._world.with_scene(scene)
        return self._world

    def _check_tool(self, job: WorkJob, scene: Scene) -> None:
        """Refuse a scene without the tool as its file has it."""
        present = {item.name: item.contents() for item in scene.objects}
        for item in tool_objects(self._tool, self._robot.tip_link):
            if present.get(item.name) != item.contents():
                how = "in the scene, but not as the tool file has it" if item.name in present else "not in the scene"
                raise TaskPlanningError(
                    job.task, f"the tool's {item.name!r} is {how}; put the tool into the scene first"
                )
