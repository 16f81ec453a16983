"""From a job to a work plan: fetch an element from its stock, grip it, carry it, set it down, let go, go away.

Every part of the plan begins and ends at rest, is checked at each 4 ms sample and between them in the scene that the parts
before it leave, and lasts a whole number of cycles. Joint vectors in the order of `RobotModel.joint_names`, SI; poses in the
robot's base_link. Not for use from several threads at once. Knows no ROS; time and randomness are arguments.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np

from construction_twin.core.clock import Clock
from construction_twin.core.motion_errors import KinematicsError, PlanningError, SceneError, UnreachableError
from construction_twin.core.units import CYCLE
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.planning.cartesian import plan_cartesian
from construction_twin.planning.limit_usage import cycle_times
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.planning.recheck import check_free, check_limits
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.segments import Signal, Switch
from construction_twin.robot.tool import ToolFile
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, product
from construction_twin.scene.self_collision import SelfCollision
from construction_twin.work.contacts import FALL, Shapes, deepest, difference, tool_objects
from construction_twin.work.grips import Grip, find_grips
from construction_twin.work.jobs import PlaceJob, WorkPlan, WorkSegment
from construction_twin.work.phases import Scenes, Ways, direction, scenes, ways
from construction_twin.work.pieces import Pieces
from construction_twin.work.recipes import Chosen, Recipe, Recipes
from construction_twin.work.site import inverse, pose_of

#: Names of the parts of a plan, in their order. `END` is planned only if it is asked for.
TO_STOCK, APPROACH, LIFT, CARRY, SET_DOWN, RETREAT, END = PARTS = (
    "to stock", "approach", "lift", "carry", "set down", "retreat", "home"
)  # fmt: skip
#: Before the first part: what is looked at to choose a grip.
GRIP, REACH = "grip", "reach"
_STAGES = (GRIP, REACH, APPROACH, LIFT, TO_STOCK, SET_DOWN, RETREAT, CARRY, END)
#: Pieces of the element further than this from where the job has them are somewhere else [m].
_ELSEWHERE = 1e-3
#: Largest distance of an arm's wrist from its flange that is reckoned with [m].
_WRIST = 0.5
#: Joint solutions within this fraction of a range from its end come after all others.
_NEAR_LIMIT = 0.01


@dataclass(frozen=True)
class TaskLimits:
    """How long and how widely is searched.

    Attributes:
        budget: After this time no other grip or way is begun [s].
        solutions: Most joint solutions of a pose that are tried.
        pairs: Most combinations of a way from the stock and a way to the place that are tried with one grip.
        free_budget: Time for the search of one free way [s].
    """

    budget: float = 20.0
    solutions: int = 8
    pairs: int = 6
    free_budget: float = 3.0


class TaskPlanner:
    """Plans tasks of one robot with one tool.

    With a seed in the settings, the same job from the same pose in the same scene gives the same plan, unless a budget runs out.

    Args:
        settings: Of the free ways.
        clock: Returns seconds from any fixed origin.
        rng: Source of seeds if the settings give none.
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
        rng: np.random.Generator,
        limits: TaskLimits = TaskLimits(),
    ):
        self._robot, self._solver, self._tool, self._recipes = robot, solver, tool, recipes
        self._self_collision, self._clock, self._limits = self_collision, clock, limits
        self._settings, self._rng = settings, rng
        budget = min(settings.planning_budget, limits.free_budget)
        self._planner = Planner(robot, solver, settings.model_copy(update={"planning_budget": budget}), clock, rng)
        self._shapes = Shapes()
        self._size = float(np.linalg.norm(tool.tool.tool0_T_tcp.xyz)) + _WRIST
        self._world: CollisionWorld | None = None

    def with_recipes(self, recipes: Recipes) -> TaskPlanner:
        """Return a planner of the same robot and tool with other recipes."""
        other = TaskPlanner(
            self._robot, self._solver, self._settings, self._self_collision, self._tool, recipes, self._clock, self._rng,
            self._limits,
        )  # fmt: skip
        other._world = self._world
        return other

    @property
    def recipes(self) -> Recipes:
        """The recipes that it plans with."""
        return self._recipes

    def plan(self, job: PlaceJob, start: JointValues, scene: Scene, end: JointValues | None = None) -> WorkPlan:
        """Plan a task.

        Args:
            start: Length n. Where the arm stands.
            scene: The present one: with the tool (`contacts.tool_objects`) and the element in stock.
            end: Length n. Where the arm goes afterwards. Default: it stays where it has let go.

        Raises:
            TaskPlanningError: With the part that was not possible with the grip that came furthest, and why.
        """
        began = self._clock()
        chosen = self._recipes.choose(job, self._tool.tool)
        self._check_scene(job, scene)
        worlds = _Worlds(self._world_of)
        start = np.array(start, dtype=float)
        self._check_start(job, start, worlds.of(scene))
        search = _Search(job, start, None if end is None else np.array(end, dtype=float), scene, chosen, worlds)
        furthest = _Failed(GRIP, "", "no grip")
        try:
            grips = find_grips(
                Pieces(job.bodies), job.base_T_stock.rotation.T[:, 2], chosen.mass, chosen.recipe, self._tool.tool
            )
        except SceneError as error:
            raise TaskPlanningError(job.task, str(error), GRIP) from error
        if not grips.grips:
            raise TaskPlanningError(job.task, f"recipe {chosen.name!r} finds no grip: {grips.reason}", GRIP)
        tried = 0
        for grip in grips.grips:
            if tried and self._clock() - began > self._limits.budget:
                furthest = furthest.after(tried, len(grips.grips), self._limits.budget)
                break
            tried += 1
            try:
                return self._with_grip(search, grip, began)
            except _Failed as failed:
                furthest = max(furthest, failed, key=lambda one: one.rank)
                if failed.hopeless:
                    break
        raise TaskPlanningError(job.task, furthest.reason, furthest.stage, furthest.grip)

    def plan_carried(self, job: PlaceJob, start: JointValues, scene: Scene, tool0_T_element: Pose) -> WorkPlan:
        """Plan the rest of a task whose element is in the grip: carry, set down, let go, go away.

        Args:
            start: Length n. Where the arm stands.
            scene: The present one: with the tool, and the element carried by the robot's tip link.
            tool0_T_element: How it is held; as `WorkPlan.tool0_T_element` of the plan that gripped it.

        Raises:
            TaskPlanningError: As `plan`.
        """
        began = self._clock()
        chosen = self._recipes.choose(job, self._tool.tool)
        self._check_tool(job, scene)
        carried = {item.name for item in scene.objects if item.link}
        for item in job.bodies:
            if item.name not in carried:
                raise TaskPlanningError(job.task, f"{item.name} is not carried in the scene; expected it in the grip")
        if falls := self._falls(job, scene, chosen.recipe):
            raise TaskPlanningError(job.task, falls, SET_DOWN)
        worlds = _Worlds(self._world_of)
        q = np.array(start, dtype=float)
        self._check_start(job, q, worlds.of(scene))
        search = _Search(job, q, None, scene, chosen, worlds)
        tcp = pose_of(self._tool.tool.tool0_T_tcp)
        element_T_tcp = product(inverse(tool0_T_element), tcp)
        grip = Grip("the grip it is held with", element_T_tcp, Pose(np.zeros(3), np.eye(3)), 0)
        failed: _Failed | None = None
        for arrive in _options(chosen.recipe.place.arrive, chosen.recipe.place.lengths, job.base_T_goal):
            if failed is not None and self._clock() - began > self._limits.budget:
                break
            at = ways(job, grip, chosen.recipe, self._tool, np.zeros(3), arrive)
            there = scenes(scene, job, chosen.recipe, self._tool, self._robot.tip_link, at, self._shapes)
            try:
                return _OneWay(self._parts(), search, grip, at, there, self._limits).plan_carried(began)
            except _Failed as one:
                failed = one if failed is None or one.rank > failed.rank else failed
        assert failed is not None
        raise TaskPlanningError(job.task, failed.reason, failed.stage, failed.grip)

    def _world_of(self, scene: Scene) -> CollisionWorld:
        if self._world is None:
            self._world = CollisionWorld(self._robot, scene, self._self_collision)
        else:
            self._world = self._world.with_scene(scene)
        return self._world

    def _check_scene(self, job: PlaceJob, scene: Scene) -> None:
        """Refuse a scene that is not that of a task's start: the tool's shapes carried, the element in its stock."""
        self._check_tool(job, scene)
        present = {item.name: item for item in scene.objects}
        if not job.bodies:
            raise TaskPlanningError(job.task, f"element {job.element} has no bodies; it cannot be gripped")
        for item in job.bodies:
            found = present.get(item.name)
            if found is None:
                raise TaskPlanningError(job.task, f"{item.name} is not in the scene; the element has to be in stock")
            away = float(np.linalg.norm(product(job.base_T_stock, item.pose).position - found.pose.position))
            if found.link or away > _ELSEWHERE:
                where = f"carried by {found.link}" if found.link else f"{1e3 * away:.1f} mm from its place in stock"
                raise TaskPlanningError(job.task, f"{item.name} is {where}; expected in stock")

    def _check_tool(self, job: PlaceJob, scene: Scene) -> None:
        present = {item.name: item for item in scene.objects}
        for item in tool_objects(self._tool, self._robot.tip_link):
            found = present.get(item.name)
            if found is None or found.contents() != item.contents():
                problem = "is not in the scene" if found is None else "is in the scene, but not as the tool file has it"
                raise TaskPlanningError(
                    job.task, f"the tool's {item.name!r} {problem}; put the tool into the scene first"
                )

    def _falls(self, job: PlaceJob, scene: Scene, recipe: Recipe) -> str:
        """Return why the element would fall when the tool lets go of it at its place; empty: something is under it."""
        own = {item.name for item in job.bodies}
        others = [item for item in scene.objects if not item.link and item.name not in own]
        if recipe.place.fastened or self._shapes.holder(job.bodies, job.base_T_goal, others, np.array(job.up)):
            return ""
        return (
            f"nothing holds {job.element_name or job.element} when the tool lets go: nothing that stands is under it within "
            f"{1e3 * FALL:.0f} mm. If it is fastened before, by what the model does not show, say so: `fastened: true` in the "
            "recipe's `place`, or the property CTwin_RobotTask.Fastened"
        )

    def _check_start(self, job: PlaceJob, start: np.ndarray, world: CollisionWorld) -> None:
        try:
            self._robot.check_range(start)
        except KinematicsError as error:
            raise TaskPlanningError(job.task, f"the arm's pose: {error}") from error
        contact = world.contact(start)
        if contact is not None:
            one, other = contact.between
            raise TaskPlanningError(
                job.task, f"where the arm stands {one} touches {other}, or is closer than the padding"
            )

    def _with_grip(self, search: _Search, grip: Grip, began: float) -> WorkPlan:
        """Return the plan with one grip; the ways from the stock and to the place in the recipe's order."""
        recipe, job = search.chosen.recipe, search.job
        failed: _Failed | None = None
        falls = self._falls(job, search.scene, recipe)
        for leave, arrive in itertools.product(
            _options(recipe.stock.leave, recipe.stock.lengths, job.base_T_stock),
            _options(recipe.place.arrive, recipe.place.lengths, job.base_T_goal),
        ):
            if failed is not None and self._clock() - began > self._limits.budget:
                break
            at = ways(job, grip, recipe, self._tool, leave, arrive)
            try:
                self._check_reach(at, grip, search)
                if falls:
                    raise _Failed(SET_DOWN, grip.name, falls, True)
                there = scenes(search.scene, job, recipe, self._tool, self._robot.tip_link, at, self._shapes)
                self._check_bodies(at, there, grip)
                return _OneWay(self._parts(), search, grip, at, there, self._limits).plan(began)
            except _Failed as one:
                failed = one if failed is None or one.rank > failed.rank else failed
                if one.stage == REACH and "gripping" in one.reason:
                    break  # another way of the element does not change where it is gripped
        assert failed is not None
        raise failed

    def _check_reach(self, at: Ways, grip: Grip, search: _Search) -> None:
        places = (
            ("gripping", at.stock),
            ("letting go", at.goal),
            ("gripping: before the element", at.before),
            ("lifted", at.lifted),
            ("above its place", at.above),
            ("after letting go", at.after),
        )
        for name, pose in places:
            try:
                self._solver.nearest(pose, search.start)
            except UnreachableError as error:
                hopeless = not error.too_close and error.missing > 2.0 * (search.size + self._size)
                raise _Failed(REACH, grip.name, f"{name}: {error}", hopeless) from error
            except KinematicsError as error:
                raise _Failed(REACH, grip.name, f"{name}: {error}") from error

    def _check_bodies(self, at: Ways, there: Scenes, grip: Grip) -> None:
        """Refuse what tool and element cannot do, with whatever joint solution."""
        places = (
            (APPROACH, there.fetch, at.before), (APPROACH, there.approach, at.stock), (LIFT, there.carry, at.lifted),
            (SET_DOWN, there.carry, at.above), (SET_DOWN, there.set_down, at.goal), (RETREAT, there.done, at.after),
        )  # fmt: skip
        for stage, scene, pose in places:
            found = self._shapes.obstruction(scene, pose)
            if found is not None:
                raise _Failed(stage, grip.name, f"{found[0]} would touch {found[1]}, or come closer than the padding")

    def _parts(self) -> _Parts:
        return _Parts(self._robot, self._solver, self._planner, self._settings, self._tool, self._clock)


def _options(directions: tuple, lengths: tuple[float, ...], base_T_element: Pose) -> list[np.ndarray]:
    return [length * direction(asked, base_T_element) for asked in directions for length in lengths]


class _Failed(Exception):
    """One attempt was not possible."""

    def __init__(self, stage: str, grip: str, reason: str, hopeless: bool = False):
        self.stage, self.grip, self.reason = stage, grip, reason
        #: no other grip of the element can do better
        self.hopeless = hopeless
        self.rank = _STAGES.index(stage)
        super().__init__(reason)

    def after(self, tried: int, count: int, budget: float) -> _Failed:
        """Return the same failure, saying that not everything was tried."""
        return _Failed(self.stage, self.grip, f"{self.reason} ({tried} of {count} grips tried in {budget:g} s)")


class _Worlds:
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
class _Search:
    """What one planning is about."""

    job: PlaceJob
    start: np.ndarray
    end: np.ndarray | None
    scene: Scene
    chosen: Chosen
    worlds: _Worlds

    @cached_property
    def size(self) -> float:
        """How far the element reaches from its middle [m]."""
        points = Pieces(self.job.bodies).points
        return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


@dataclass(frozen=True, eq=False)
class _Free:
    """A free way, and the clearance on it."""

    trajectory: Trajectory
    clearance: float


@dataclass(frozen=True, eq=False)
class _Parts:
    """Makes single motions."""

    robot: RobotModel
    solver: InverseKinematics
    planner: Planner
    settings: PlannerSettings
    tool: ToolFile
    clock: Clock

    def line(self, start: np.ndarray, pose: Pose, recipe: Recipe, scale: float, world: CollisionWorld) -> Trajectory:
        """Return the straight way of the flange to a pose, checked for limits, contacts and depth of what may touch."""
        motion = plan_cartesian(
            start, [ToolWaypoint(pose)], self.solver, None, recipe.speed, scale, bounds=self.settings.bounds
        )
        trajectory = whole_cycles(motion.trajectory)
        samples = self.checked(trajectory, world)
        found = deepest(world, samples)
        if found is not None and found[0].distance < -recipe.penetration:
            one, other = found[0].between
            raise PlanningError(
                f"{one} would be {-1e3 * found[0].distance:.1f} mm inside of {other}; at most {1e3 * recipe.penetration:g} mm are "
                "allowed"
            )
        return trajectory

    def free(self, start: np.ndarray, goal: np.ndarray, scale: float, world: CollisionWorld) -> _Free:
        """Return a free way between two joint vectors."""
        plan = self.planner.plan_to_joints(start, goal, PlanRequest("work", 0, speed_scale=scale), world)
        trajectory = whole_cycles(plan.trajectory)
        self.checked(trajectory, world)
        return _Free(trajectory, plan.report.clearance.distance)

    def checked(self, trajectory: Trajectory, world: CollisionWorld) -> np.ndarray:
        """Check every 4 ms sample for limits, and the motion through them for contacts; return the samples."""
        check_limits(trajectory, self.robot)
        times = cycle_times(trajectory)
        samples = trajectory.sample_many(times)[0]
        check_free(samples, times, world)
        return samples


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


_Made = TypeVar("_Made")


def _once(made: dict[int, _Made | _Failed], number: int, make: Callable[[], _Made]) -> _Made:
    """Return what was made for a number, made at the first call; a failure is kept and raised again too."""
    if number not in made:
        try:
            made[number] = make()
        except _Failed as failed:
            made[number] = failed
    found = made[number]
    if isinstance(found, _Failed):
        raise found
    return found


@dataclass(eq=False)
class _Stock:
    """The way of a tool to the element and off with it, from one joint solution."""

    before: np.ndarray
    approach: Trajectory
    lift: Trajectory


@dataclass(eq=False)
class _Goal:
    """The way of an element to its place and of the tool away from it, from one joint solution."""

    above: np.ndarray
    set_down: Trajectory
    retreat: Trajectory


@dataclass(eq=False)
class _OneWay:
    """The attempt with one grip and one pair of straight ways."""

    parts: _Parts
    search: _Search
    grip: Grip
    at: Ways
    scenes: Scenes
    limits: TaskLimits
    _stocks: dict[int, _Stock | _Failed] = field(default_factory=dict)
    _goals: dict[int, _Goal | _Failed] = field(default_factory=dict)

    def plan(self, began: float) -> WorkPlan:
        """Return the plan; the combinations of joint solutions with the shortest free ways first."""
        befores = self._solutions(self.at.before, self.search.start, self.scenes.fetch, APPROACH, "before gripping")
        aboves = self._solutions(self.at.above, befores[0], self.scenes.carry, SET_DOWN, "above its place")
        furthest: _Failed | None = None
        tried = 0
        for one, other in self._combinations(befores, aboves):
            if tried >= self.limits.pairs or (tried and self.parts.clock() - began > self.limits.budget):
                break
            try:
                stock = self._stock(one, befores[one])
                goal = self._goal(other, aboves[other])
                tried += 1
                return self._joined(stock, goal, began)
            except _Failed as failed:
                furthest = failed if furthest is None or failed.rank > furthest.rank else furthest
        assert furthest is not None
        raise furthest

    def plan_carried(self, began: float) -> WorkPlan:
        """Return the rest of a plan whose element is held already."""
        recipe, search, there = self._recipe, self.search, self.scenes
        aboves = self._solutions(self.at.above, search.start, there.carry, SET_DOWN, "above its place")
        pace = np.array(self.parts.robot.velocity)
        nearest = sorted(
            range(len(aboves)), key=lambda one: round(float(np.max(np.abs(aboves[one] - search.start) / pace)), 9)
        )
        furthest: _Failed | None = None
        for number in nearest[: self.limits.pairs]:
            if furthest is not None and self.parts.clock() - began > self.limits.budget:
                break
            try:
                goal = self._goal(number, aboves[number])
                carry = self._free(CARRY, search.start, goal.above, recipe.carry_speed_scale, there.carry)
            except _Failed as failed:
                furthest = failed if furthest is None or failed.rank > furthest.rank else furthest
                continue
            tool = self.parts.tool.tool
            held, empty = tool.grip.signals(), tool.release.signals()
            rows = [
                _Row(
                    CARRY,
                    carry.trajectory,
                    recipe.carry_engaged,
                    held,
                    (),
                    search.scene,
                    there.set_down,
                    carry.clearance,
                ),
                _Row(SET_DOWN, goal.set_down, True, held, tool.release.switches(), there.set_down, there.retreat),
                _Row(RETREAT, goal.retreat, True, empty, (), there.retreat, there.done),
            ]
            clearance = min(self._clearance(row) for row in rows)
            return WorkPlan(
                search.job, self.grip.name, tuple(row.segment() for row in rows), self.parts.clock() - began, clearance,
                self.at.tool0_T_element,
            )  # fmt: skip
        assert furthest is not None
        raise furthest

    def _solutions(self, pose: Pose, seed: np.ndarray, scene: Scene, stage: str, where: str) -> list[np.ndarray]:
        """Return joint solutions of a pose that touch nothing, the nearest first."""
        world = self.search.worlds.of(scene)
        try:
            found = [solution.q for solution in self.parts.solver.all(pose, seed)]
        except KinematicsError as error:
            raise _Failed(REACH, self.grip.name, f"{where}: {error}") from error
        free = list(itertools.islice((q for q in found if world.is_free(q)), self.limits.solutions))
        if not free:
            contact = world.contact(found[0])
            assert contact is not None
            one, other = contact.between
            raise _Failed(stage, self.grip.name, f"{where}, {one} touches {other} or is closer than the padding")
        return free

    def _combinations(self, befores: list[np.ndarray], aboves: list[np.ndarray]) -> Iterator[tuple[int, int]]:
        pace = np.array(self.parts.robot.velocity)

        def time(first: np.ndarray, second: np.ndarray) -> float:
            return float(np.max(np.abs(second - first) / pace))

        lower, upper = np.array(self.parts.robot.lower), np.array(self.parts.robot.upper)
        edge = _NEAR_LIMIT * (upper - lower)

        def limited(q: np.ndarray) -> bool:
            """Return whether a straight way from there may well leave the range."""
            return bool(np.any((q < lower + edge) | (q > upper - edge)))

        pairs = [
            (
                limited(before) + limited(above),
                round(time(self.search.start, before) + time(before, above), 9),
                one,
                other,
            )
            for one, before in enumerate(befores)
            for other, above in enumerate(aboves)
        ]
        for _, _, one, other in sorted(pairs):
            # what has failed alone fails in every combination
            if not (isinstance(self._stocks.get(one), _Failed) or isinstance(self._goals.get(other), _Failed)):
                yield one, other

    def _stock(self, number: int, before: np.ndarray) -> _Stock:
        return _once(self._stocks, number, lambda: self._make_stock(before))

    def _goal(self, number: int, above: np.ndarray) -> _Goal:
        return _once(self._goals, number, lambda: self._make_goal(above))

    def _make_stock(self, before: np.ndarray) -> _Stock:
        recipe = self._recipe
        approach = self._line(APPROACH, before, self.at.stock, recipe.free_speed_scale, self.scenes.approach)
        lift = self._line(LIFT, approach.positions[-1], self.at.lifted, recipe.carry_speed_scale, self.scenes.lift)
        self._demand_free(lift.positions[-1], self.scenes.carry, LIFT, "lifted, where it is carried freely from,")
        return _Stock(before, approach, lift)

    def _make_goal(self, above: np.ndarray) -> _Goal:
        recipe = self._recipe
        set_down = self._line(SET_DOWN, above, self.at.goal, recipe.carry_speed_scale, self.scenes.set_down)
        retreat = self._line(
            RETREAT, set_down.positions[-1], self.at.after, recipe.free_speed_scale, self.scenes.retreat
        )
        self._demand_free(retreat.positions[-1], self.scenes.done, RETREAT, "after letting go")
        return _Goal(above, set_down, retreat)

    def _demand_free(self, q: np.ndarray, scene: Scene, stage: str, where: str) -> None:
        contact = self.search.worlds.of(scene).contact(q)
        if contact is not None:
            one, other = contact.between
            raise _Failed(stage, self.grip.name, f"{where} {one} touches {other} or is closer than the padding")

    def _line(self, stage: str, start: np.ndarray, pose: Pose, scale: float, scene: Scene) -> Trajectory:
        try:
            return self.parts.line(start, pose, self._recipe, scale, self.search.worlds.of(scene))
        except (PlanningError, KinematicsError) as error:
            raise _Failed(stage, self.grip.name, str(error)) from error

    def _free(self, stage: str, start: np.ndarray, goal: np.ndarray, scale: float, scene: Scene) -> _Free:
        try:
            return self.parts.free(start, goal, scale, self.search.worlds.of(scene))
        except (PlanningError, KinematicsError) as error:
            raise _Failed(stage, self.grip.name, str(error)) from error

    def _joined(self, stock: _Stock, goal: _Goal, began: float) -> WorkPlan:
        recipe, search, there = self._recipe, self.search, self.scenes
        fetch = self._free(TO_STOCK, search.start, stock.before, recipe.free_speed_scale, there.fetch)
        carry = self._free(CARRY, stock.lift.positions[-1], goal.above, recipe.carry_speed_scale, there.carry)
        grip, release = self.parts.tool.tool.grip, self.parts.tool.tool.release
        # a sensor that is stuck, or a scrap on the cups, is found before anything is gripped
        held, empty = grip.signals(), release.signals()
        rows: list[_Row] = [
            _Row(TO_STOCK, fetch.trajectory, False, empty, (), there.fetch, there.approach, fetch.clearance),
            _Row(APPROACH, stock.approach, True, empty, grip.switches(), there.approach, there.lift),
            _Row(LIFT, stock.lift, True, held, (), there.lift, there.carry),
            _Row(CARRY, carry.trajectory, recipe.carry_engaged, held, (), there.carry, there.set_down, carry.clearance),
            _Row(SET_DOWN, goal.set_down, True, held, release.switches(), there.set_down, there.retreat),
            _Row(RETREAT, goal.retreat, True, empty, (), there.retreat, there.done),
        ]
        if search.end is not None:
            home = self._free(END, goal.retreat.positions[-1], search.end, recipe.free_speed_scale, there.done)
            rows.append(_Row(END, home.trajectory, False, empty, (), there.done, there.done, home.clearance))
        planning_time = self.parts.clock() - began
        clearance = min(self._clearance(row) for row in rows)
        return WorkPlan(
            search.job, self.grip.name, tuple(row.segment() for row in rows), planning_time, clearance,
            self.at.tool0_T_element,
        )  # fmt: skip

    def _clearance(self, row: _Row) -> float:
        if row.clearance is not None:
            return row.clearance
        samples = row.trajectory.sample_many(cycle_times(row.trajectory))[0]
        return self.search.worlds.of(row.scene).clearance_of(samples)[0].distance

    @property
    def _recipe(self) -> Recipe:
        return self.search.chosen.recipe


@dataclass(frozen=True, eq=False)
class _Row:
    """One part, before its changes of the scene are computed."""

    name: str
    trajectory: Trajectory
    engaged: bool
    requires: tuple[Signal, ...]
    switches: tuple[Switch, ...]
    scene: Scene
    after: Scene
    clearance: float | None = None

    def segment(self) -> WorkSegment:
        """Return it as a part of the plan."""
        return WorkSegment(
            self.name, self.trajectory, self.engaged, self.requires, self.switches,
            difference(self.scene, self.after), (), self.scene, self.after,
        )  # fmt: skip
