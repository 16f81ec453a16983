"""What the processes make their work plans of: motions from rest to rest that are checked in a scene, and how an attempt fails.

Joint vectors in the order of `RobotModel.joint_names`, SI; poses in the robot's base_link. Not for use from several threads at
once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from construction_twin.core.clock import Clock
from construction_twin.core.motion_errors import KinematicsError, PlanningError, UnreachableError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.planning.cartesian import plan_cartesian
from construction_twin.planning.limit_usage import cycle_times
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.planning.recheck import check_free, check_limits
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import RobotModel
from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.tool import ToolFile
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene
from construction_twin.work.contacts import Shapes, deepest, difference
from construction_twin.work.jobs import TaskMotions, WorkJob
from construction_twin.work.process import REACH
from construction_twin.work.recipe import Recipe

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
        method: Of the attempt; empty: none.
    """

    def __init__(self, stage: str, method: str, reason: str, hopeless: bool = False):
        self.stage, self.method, self.reason = stage, method, reason
        self.hopeless = hopeless


class Worlds:
    """The collision worlds of one planning, each made once."""

    def __init__(self, make: Callable[[Scene], CollisionWorld]):
        self._make = make
        self._worlds: dict[str, CollisionWorld] = {}

    def of(self, scene: Scene) -> CollisionWorld:
        """Return the world of a scene."""
        if scene.hash not in self._worlds:
            self._worlds[scene.hash] = self._make(scene)
        return self._worlds[scene.hash]


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
    worlds: Worlds
    shapes: Shapes = field(repr=False)

    @property
    def late(self) -> bool:
        """Whether the time for another attempt is over."""
        return self.clock() - self.began > self.limits.budget

    @property
    def size(self) -> float:
        """How far the tool's centre point can be from the arm's wrist [m]."""
        return float(np.linalg.norm(self.tool.tool.tool0_T_tcp.xyz)) + _WRIST

    def demand_reach(self, pose: Pose, method: str, where: str, room: Callable[[], float] = float) -> None:
        """Refuse a pose of the flange that the arm does not reach at all.

        Args:
            room: Returns how far the flange may be from there with another method [m].
        """
        try:
            self.solver.nearest(pose, self.start)
        except UnreachableError as error:
            hopeless = not error.too_close and error.missing > 2.0 * (room() + self.size)
            raise Failed(REACH, method, f"{where}: {error}", hopeless) from error
        except KinematicsError as error:
            raise Failed(REACH, method, f"{where}: {error}") from error

    def solutions(
        self, pose: Pose, seed: np.ndarray, scene: Scene, stage: str, method: str, where: str
    ) -> list[np.ndarray]:
        """Return joint solutions of a pose of the flange that touch nothing, the nearest first."""
        world = self.worlds.of(scene)
        try:
            found = [solution.q for solution in self.solver.all(pose, seed)]
        except KinematicsError as error:
            raise Failed(REACH, method, f"{where}: {error}") from error
        free = list(itertools.islice((q for q in found if world.is_free(q)), self.limits.solutions))
        if not free:
            contact = world.contact(found[0])
            assert contact is not None
            one, other = contact.between
            raise Failed(
                stage,
                method,
                Sentence(
                    "{where}, {first} touches {second} or is closer than the padding",
                    where=where,
                    first=one,
                    second=other,
                ),
            )
        return free

    def line(self, start: np.ndarray, pose: Pose, scale: float, scene: Scene, stage: str, method: str) -> Trajectory:
        """Return the straight way of the flange to a pose, checked for limits, contacts and depth of what may touch."""
        try:
            return self._line(start, pose, scale, self.worlds.of(scene))
        except (PlanningError, KinematicsError) as error:
            raise Failed(stage, method, str(error)) from error

    def free(self, start: np.ndarray, goal: np.ndarray, scale: float, scene: Scene, stage: str, method: str) -> Free:
        """Return a free way between two joint vectors."""
        world = self.worlds.of(scene)
        try:
            plan = self.planner.plan_to_joints(start, goal, PlanRequest("work", speed_scale=scale), world)
            trajectory = whole_cycles(plan.trajectory)
            self._checked(trajectory, world)
        except (PlanningError, KinematicsError) as error:
            raise Failed(stage, method, str(error)) from error
        return Free(trajectory, plan.report.clearance.distance)

    def demand_free(self, q: np.ndarray, scene: Scene, stage: str, method: str, where: str) -> None:
        """Refuse joint values at which something touches."""
        contact = self.worlds.of(scene).contact(q)
        if contact is not None:
            one, other = contact.between
            raise Failed(
                stage,
                method,
                Sentence(
                    "{where} {first} touches {second} or is closer than the padding",
                    where=where,
                    first=one,
                    second=other,
                ),
            )

    def nearest(self, solutions: Sequence[np.ndarray]) -> list[int]:
        """Return the numbers of joint solutions, those that the arm gets to soonest first."""
        pace = np.array(self.robot.velocity)
        return sorted(
            range(len(solutions)), key=lambda one: round(float(np.max(np.abs(solutions[one] - self.start) / pace)), 9)
        )

    def _line(self, start: np.ndarray, pose: Pose, scale: float, world: CollisionWorld) -> Trajectory:
        recipe: Recipe = self.recipe
        motion = plan_cartesian(
            start, [ToolWaypoint(pose)], self.solver, None, recipe.speed, scale, bounds=self.settings.bounds
        )
        trajectory = whole_cycles(motion.trajectory)
        found = deepest(world, self._checked(trajectory, world))
        if found is not None and found[0].distance < -recipe.penetration:
            one, other = found[0].between
            raise PlanningError(
                f"{one} would be {-1e3 * found[0].distance:.1f} mm inside of {other}; at most "
                f"{1e3 * recipe.penetration:g} mm are allowed"
            )
        return trajectory

    def _checked(self, trajectory: Trajectory, world: CollisionWorld) -> np.ndarray:
        """Check every 4 ms sample for limits, and the motion through them for contacts; return the samples."""
        check_limits(trajectory, self.robot)
        times = cycle_times(trajectory)
        samples = trajectory.sample_many(times)[0]
        check_free(samples, times, world)
        return samples


class PlanBuilder:
    """A work plan in the making: segments one after the other.

    Args:
        scene: In which the first one begins.
    """

    def __init__(self, search: Search, scene: Scene):
        self._search = search
        self._segments: list[WorkSegment] = []
        self._scenes = [scene]
        self._clearances: list[float | None] = []

    def add(
        self,
        name: str,
        trajectory: Trajectory,
        engaged: bool,
        requires: tuple[Signal, ...],
        switches: tuple[Switch, ...],
        after: Scene,
        clearance: float | None = None,
    ) -> None:
        """Add a segment.

        Args:
            clearance: Of a free way [m]; None: to be computed.
        """
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
        return self._search.worlds.of(scene).clearance_of(samples)[0].distance


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
