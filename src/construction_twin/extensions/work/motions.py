"""From a job to a work plan: what all processes have alike, and the motions that they make their plans of.

Every segment rests at both ends, is checked in the scene that the segments before it leave, and lasts whole cycles. SI units, poses
in the base_link. For one thread.
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
from construction_twin.extensions.work.contacts import ShapeDistances, change_between
from construction_twin.extensions.work.process import (
    REACH,
    Recipe,
    Recipes,
    TaskMotions,
    TaskPlanningError,
    WorkJob,
    process_of,
)
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics
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
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision

#: Time after which no other method or way is begun, and for the search of one free way, by the clock of the `TaskPlanner` [s].
BUDGET, FREE_BUDGET = 1.2, 0.7
#: Most joint solutions of a pose that are tried, and combinations of two straight ways with one method.
SOLUTIONS, PAIRS = 8, 6


class AttemptFailed(Exception):
    """One attempt was not possible; `stage`: a segment, `process.REACH`, or another word of the process."""

    def __init__(self, stage: str, reason: str):
        self.stage, self.reason, self.method = stage, reason, ""


@dataclass(frozen=True, eq=False)
class Search:
    """One planning, and the motions that an attempt is made of; `held`: ``tool0_T_element`` of an element in the grip."""

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
    budget: float
    clock: Clock
    build_world: Callable[[Scene], CollisionWorld]
    shapes: ShapeDistances = field(repr=False)
    _worlds: dict[str, CollisionWorld] = field(default_factory=dict, repr=False)

    @property
    def is_out_of_time(self) -> bool:
        """Whether the time for another attempt is over."""
        return self.clock() - self.began > self.budget

    def world(self, scene: Scene) -> CollisionWorld:
        """Return the collision world of a scene."""
        if scene.hash not in self._worlds:
            self._worlds[scene.hash] = self.build_world(scene)
        return self._worlds[scene.hash]

    def require_reach(self, pose: Pose, where: str) -> None:
        """Refuse a pose of the flange out of reach."""
        try:
            self.solver.nearest(pose, self.start)
        except KinematicsError as error:
            raise AttemptFailed(REACH, f"{where}: {error}") from error

    def solutions(self, pose: Pose, seed: np.ndarray, scene: Scene, stage: str, where: str) -> list[np.ndarray]:
        """Return collision-free joint solutions of a pose of the flange, the nearest first."""
        world = self.world(scene)
        try:
            found = [solution.q for solution in self.solver.all(pose, seed)]
        except KinematicsError as error:
            raise AttemptFailed(REACH, f"{where}: {error}") from error
        free = list(itertools.islice((q for q in found if world.is_free(q)), SOLUTIONS))
        if not free:
            self.require_free(found[0], scene, stage, where)
        return free

    def require_free(self, q: np.ndarray, scene: Scene, stage: str, where: str) -> None:
        """Refuse joint values at which something touches."""
        contact = self.world(scene).contact(q)
        if contact is not None:
            one, other = contact.between
            raise AttemptFailed(
                stage,
                Sentence(
                    "{where}, {first} touches {second} or is closer than the padding",
                    where=where,
                    first=one,
                    second=other,
                ),
            )

    def line_motion(self, start: np.ndarray, pose: Pose, scale: float, scene: Scene, stage: str) -> Trajectory:
        """Return a checked straight way of the flange to a pose."""
        recipe: Recipe = self.recipe
        try:
            motion = plan_cartesian(
                start, [ToolWaypoint(pose)], self.solver, None, recipe.speed, scale, bounds=self.settings.bounds
            )
            trajectory, world = whole_cycles(motion.trajectory), self.world(scene)
            samples = self._checked(trajectory, world)
        except (PlanningError, KinematicsError) as error:
            raise AttemptFailed(stage, str(error)) from error
        touching = world.touching_world()
        found = None if touching is None else touching.clearance_of(samples)[0]
        if found is not None and found.distance < -recipe.penetration:
            one, other = found.between
            depth, most = -1e3 * found.distance, 1e3 * recipe.penetration
            raise AttemptFailed(
                stage, f"{one} would be {depth:.1f} mm inside of {other}; at most {most:g} mm are allowed"
            )
        return trajectory

    def free_motion(
        self, start: np.ndarray, goal: np.ndarray, scale: float, scene: Scene, stage: str
    ) -> tuple[Trajectory, float]:
        """Return a free way between two joint vectors, and the clearance on it [m]."""
        world = self.world(scene)
        try:
            plan = self.planner.plan_to_joints(start, goal, PlanRequest("work", speed_scale=scale), world)
            trajectory = whole_cycles(plan.trajectory)
            self._checked(trajectory, world)
        except (PlanningError, KinematicsError) as error:
            raise AttemptFailed(stage, str(error)) from error
        return trajectory, plan.report.clearance.distance

    def nearest(self, solutions: Sequence[np.ndarray]) -> list[int]:
        """Return the numbers of joint solutions, the soonest reached first."""
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
    """A work plan in the making; `scene`: at its beginning."""

    def __init__(self, search: Search, scene: Scene):
        self._search = search
        self._segments: list[WorkSegment] = []
        self._scenes = [scene]
        self._clearance = math.inf

    def add(
        self, name: str, trajectory: Trajectory, engaged: bool, requires: tuple[Signal, ...], switches: tuple[Switch, ...],
        after: Scene, clearance: float | None = None,
    ) -> None:  # fmt: skip
        """Add a segment; `clearance`: [m], None: to be computed."""
        scene = self._scenes[-1]
        if clearance is None:
            samples = trajectory.sample_many(cycle_times(trajectory))[0]
            clearance = self._search.world(scene).clearance_of(samples)[0].distance
        self._clearance = min(self._clearance, clearance)
        self._segments.append(WorkSegment(name, trajectory, engaged, requires, switches, change_between(scene, after)))
        self._scenes.append(after)

    def plan(self, method: str, tool0_T_element: Pose | None = None) -> TaskMotions:
        """Return the plan."""
        search, segments, scenes = self._search, tuple(self._segments), tuple(self._scenes)
        planning_time = search.clock() - search.began
        return TaskMotions(search.job, method, segments, scenes, planning_time, self._clearance, tool0_T_element)


def whole_cycles(trajectory: Trajectory) -> Trajectory:
    """Return the same motion, slowed down to a whole number of cycles."""
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
    """Plans tasks of one robot with one tool, the same plan for the same request unless a budget runs out."""

    def __init__(
        self,
        robot: RobotModel,
        solver: InverseKinematics,
        settings: PlannerSettings,
        self_collision: SelfCollision,
        tool: ToolFile,
        recipes: Recipes,
        clock: Clock,
        budget: float = BUDGET,
    ):
        self._robot, self._solver, self._tool, self._recipes = robot, solver, tool, recipes
        self._self_collision, self._clock, self._budget = self_collision, clock, budget
        self._settings = settings
        free = settings.model_copy(update={"planning_budget": min(settings.planning_budget, FREE_BUDGET)})
        self._planner = Planner(robot, solver, free, clock)
        self._shapes = ShapeDistances()
        self._world: CollisionWorld | None = None

    def plan(self, job: WorkJob, start: JointValues, scene: Scene, held: Pose | None = None) -> TaskMotions:
        """Plan a task; `held`: as of `Search`, of which the rest is planned."""
        began = self._clock()
        name, recipe = self._recipes.of(job)
        process = process_of(recipe.process)
        q = np.array(start, dtype=float)
        search = Search(
            job, name, recipe, q, scene, held, began, self._robot, self._solver, self._planner, self._settings,
            self._tool, self._budget, self._clock, self._world_of, self._shapes,
        )  # fmt: skip
        try:
            self._robot.check_range(q)
        except KinematicsError as error:
            raise TaskPlanningError(job.task, Sentence("the arm's pose: {problem}", problem=str(error))) from error
        try:
            search.require_free(q, scene, "", "where the arm stands")
            return process.plan(search)
        except AttemptFailed as failed:
            raise TaskPlanningError(job.task, failed.reason, failed.stage, failed.method) from failed

    def _world_of(self, scene: Scene) -> CollisionWorld:
        if self._world is None:
            self._world = CollisionWorld(self._robot, scene, self._self_collision)
        else:
            self._world = self._world.with_scene(scene)
        return self._world
