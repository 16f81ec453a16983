"""How an element is placed: fetch it from its stock, grip it, carry it, set it down, let go, go away."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, TypeVar

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.contacts import FALL, straight_poses
from construction_twin.extensions.work.element_bodies import ElementPieces
from construction_twin.extensions.work.motions import PAIRS, AttemptFailed, PlanBuilder, Search
from construction_twin.extensions.work.place.grips import (
    AXES,
    Direction,
    Grip,
    PlaceRecipe,
    check_tool,
    find_grips,
    mass_of,
)
from construction_twin.extensions.work.process import REACH, Process, TaskMotions, TaskPlanningError
from construction_twin.extensions.work.work_cell import inverse, pose_of
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import TOOL, Scene, SceneObject, product, tool_objects
from construction_twin.scene.scene_change import SceneChange

#: Names of the segments of a plan, in their order.
TO_STOCK, APPROACH, LIFT, CARRY, SET_DOWN, RETREAT = "to stock", "approach", "lift", "carry", "set down", "retreat"
#: Before the first segment: what is looked at to choose a grip.
GRIP = "grip"
#: In the order in which an attempt gets there.
STAGES = (GRIP, REACH, APPROACH, LIFT, TO_STOCK, SET_DOWN, RETREAT, CARRY)

#: Joint solutions within this fraction of a range from its end come after all others.
_NEAR_LIMIT = 0.01


def plan(search: Search) -> TaskMotions:
    """Return the plan of a task, with the element held of the rest; raise the failure that came furthest."""
    mass = mass_of(search.job, search.name, search.recipe, search.tool.tool)
    return _whole_plan(search, mass) if search.held is None else _rest_of_plan(search, search.held)


def _whole_plan(search: Search, mass: float) -> TaskMotions:
    job = search.job
    assert job.base_T_stock is not None
    try:
        grips = find_grips(
            ElementPieces(job.bodies), job.base_T_stock.rotation.T[:, 2], mass, search.recipe, search.tool.tool
        )
    except SceneError as error:
        raise TaskPlanningError(job.task, str(error), GRIP) from error
    if not grips.grips:
        raise TaskPlanningError(job.task, f"recipe {search.name!r} finds no grip: {grips.reason}", GRIP)
    tried = 0

    def with_grip(grip: Grip) -> TaskMotions:
        nonlocal tried
        tried += 1
        return _with_grip(search, grip)

    try:
        return _first_success(search, grips.grips, with_grip)
    except AttemptFailed as failed:
        if tried < len(grips.grips) and search.is_out_of_time:
            failed.reason = Sentence(
                "{reason} ({tried} of {count} grips tried in {seconds:g} s)",
                reason=failed.reason,
                tried=tried,
                count=len(grips.grips),
                seconds=search.budget,
            )
        raise


def _rest_of_plan(search: Search, tool0_T_element: Pose) -> TaskMotions:
    job, recipe = search.job, search.recipe
    _require_support(search)
    element_T_tcp = product(inverse(tool0_T_element), pose_of(search.tool.tool.tool0_T_tcp))
    grip = Grip("the grip it is held with", element_T_tcp, Pose(np.zeros(3), np.eye(3)), 0)

    def arriving(arrive: np.ndarray) -> TaskMotions:
        at = flange_poses(search, grip, np.zeros(3), arrive)
        return _Attempt(search, grip, at, scenes(search, at)).plan_carried()

    options = _straight_ways(recipe.place.arrive, recipe.place.lengths, job.base_T_goal)
    return _first_success(search, options, arriving, method=grip.name)


_Tried = TypeVar("_Tried")


def _first_success(
    search: Search,
    options: Iterable[_Tried],
    attempt: Callable[[_Tried], TaskMotions],
    ends: Callable[[AttemptFailed], bool] = lambda failed: False,
    method: str = "",
) -> TaskMotions:
    """Return the first plan that can be made in time; raise the failure that came furthest."""
    furthest: AttemptFailed | None = None
    for option in options:
        if furthest is not None and search.is_out_of_time:
            break
        try:
            return attempt(option)
        except AttemptFailed as failed:
            failed.method = method or failed.method
            furthest = _furthest(furthest, failed)
            if ends(failed):
                break
    assert furthest is not None
    raise furthest


def _require_support(search: Search) -> None:
    """Refuse an element that would fall at its place."""
    job, recipe = search.job, search.recipe
    own = {item.name for item in job.bodies}
    others = [item for item in search.scene.objects if not item.link and item.name not in own]
    if recipe.place.fastened or search.shapes.support_below(job.bodies, job.base_T_goal, others, np.array(job.up)):
        return
    falls = Sentence(
        "nothing holds {element} when the tool lets go: nothing is under it within {gap:.0f} mm. If something else holds it "
        "then, say so: `fastened: true` in the recipe's `place`",
        element=job.element.name or job.element.id,
        gap=1e3 * FALL,
    )
    raise AttemptFailed(SET_DOWN, falls)


def _with_grip(search: Search, grip: Grip) -> TaskMotions:
    recipe, job = search.recipe, search.job
    assert job.base_T_stock is not None

    def by(leave_arrive: tuple[np.ndarray, np.ndarray]) -> TaskMotions:
        at = flange_poses(search, grip, *leave_arrive)
        _check_reach(at, search)
        _require_support(search)
        there = scenes(search, at)
        _check_bodies(search, at, there)
        return _Attempt(search, grip, at, there).plan()

    options = itertools.product(
        _straight_ways(recipe.stock.leave, recipe.stock.lengths, job.base_T_stock),
        _straight_ways(recipe.place.arrive, recipe.place.lengths, job.base_T_goal),
    )
    # another way of the element does not change where it is gripped
    return _first_success(
        search, options, by, lambda failed: failed.stage == REACH and "gripping" in failed.reason, grip.name
    )


def _check_reach(at: FlangePoses, search: Search) -> None:
    for where, pose in (
        ("gripping", at.stock),
        ("letting go", at.goal),
        ("gripping: before the element", at.before),
        ("lifted", at.lifted),
        ("above its place", at.above),
        ("after letting go", at.after),
    ):
        search.require_reach(pose, where)


def _check_bodies(search: Search, at: FlangePoses, there: Scenes) -> None:
    """Refuse what tool and element cannot do, with whatever joint solution."""
    places = (
        (APPROACH, there.fetch, at.before), (APPROACH, there.approach, at.stock), (LIFT, there.carry, at.lifted),
        (SET_DOWN, there.carry, at.above), (SET_DOWN, there.set_down, at.goal), (RETREAT, there.done, at.after),
    )  # fmt: skip
    for stage, scene, pose in places:
        found = search.shapes.obstruction(scene, pose)
        if found is not None:
            one, other = found
            problem = Sentence("{first} would touch {second}, or come closer than the padding", first=one, second=other)
            raise AttemptFailed(stage, problem)


def _straight_ways(
    directions: tuple[Direction, ...], lengths: tuple[float, ...], base_T_element: Pose
) -> list[np.ndarray]:
    units = {"up": np.array([0.0, 0.0, 1.0])} | {name: base_T_element.rotation @ axis for name, axis in AXES.items()}
    ways_of = [
        units[asked] if isinstance(asked, str) else np.array(asked) / np.linalg.norm(asked) for asked in directions
    ]
    return [length * way for way in ways_of for length in lengths]


def _furthest(one: AttemptFailed | None, other: AttemptFailed) -> AttemptFailed:
    return other if one is None or STAGES.index(other.stage) > STAGES.index(one.stage) else one


def _attempted(compute: Callable[..., _Tried], *arguments: Any) -> _Tried | AttemptFailed:
    try:
        return compute(*arguments)
    except AttemptFailed as failed:
        return failed


@dataclass(frozen=True, eq=False)
class FlangePoses:
    """``base_T_tool0`` at the ends of the straight ways of one task; `lifted`, `above`: ends of the free way with the element."""

    before: Pose
    stock: Pose
    lifted: Pose
    above: Pose
    goal: Pose
    after: Pose
    tool0_T_element: Pose


@dataclass(frozen=True, eq=False)
class Scenes:
    """The scene of each part of a task."""

    fetch: Scene
    approach: Scene
    lift: Scene
    carry: Scene
    set_down: Scene
    retreat: Scene
    done: Scene


def flange_poses(search: Search, grip: Grip, leave: np.ndarray, arrive: np.ndarray) -> FlangePoses:
    """Return where the flange goes, with the element's straight ways."""
    job, recipe = search.job, search.recipe
    assert job.base_T_stock is not None
    tcp_T_tool0 = inverse(pose_of(search.tool.tool.tool0_T_tcp))
    turned_T_tcp = product(inverse(grip.element_T_turned), grip.element_T_tcp)
    base_T_stock_tcp, base_T_goal_tcp = (
        product(job.base_T_stock, grip.element_T_tcp),
        product(job.base_T_goal, turned_T_tcp),
    )
    stock, goal = product(base_T_stock_tcp, tcp_T_tool0), product(base_T_goal_tcp, tcp_T_tool0)
    # the tool's z points into the face
    out, away = -base_T_stock_tcp.rotation[:, 2], -base_T_goal_tcp.rotation[:, 2]
    return FlangePoses(
        _moved(stock, recipe.stock.approach * out),
        stock,
        _moved(stock, leave),
        _moved(goal, arrive),
        goal,
        _moved(goal, recipe.place.retreat * away),
        product(inverse(tcp_T_tool0), inverse(turned_T_tcp)),
    )


def _moved(pose: Pose, by: np.ndarray) -> Pose:
    return Pose(pose.position + by, pose.rotation)


def scenes(search: Search, at: FlangePoses) -> Scenes:
    """Return the scene of each part of a task, with exactly the contacts allowed that its straight way needs."""
    scene, job, grips, link = search.scene, search.job, search.recipe.grips, search.robot.tip_link
    bare = tool_objects(search.tool, link)
    own = {item.name for item in job.bodies}
    supports = [item for item in scene.objects if item.name in job.supports and item.name not in own and not item.link]
    held = [item.moved(product(at.tool0_T_element, item.pose)) for item in job.bodies]
    beside = [item for item in bare if item.name.removeprefix(TOOL) in grips.beside]

    def near(moving: Sequence[SceneObject], *ends: Pose) -> tuple[str, ...]:
        places = [pose for start, end in zip(ends, ends[1:]) for pose in straight_poses(start, end)]
        return search.shapes.near(moving, places, supports, scene.padding) if moving else ()

    stock_tool, stock_held = near(beside, at.before, at.stock, at.lifted), near(held, at.stock, at.lifted)
    goal_tool, goal_held = near(beside, at.above, at.goal, at.after), near(held, at.above, at.goal)

    def tools(beside_names: Iterable[str], gripping: bool) -> list[SceneObject]:
        items = []
        for item in bare:
            shape, names = item.name.removeprefix(TOOL), []
            if gripping and shape in grips.touching:
                names += sorted(own)
            if shape in grips.beside:
                names += list(beside_names)
            items.append(replace(item, touch=(*item.touch, *names)))
        return items

    def carried(names: Iterable[str]) -> list[SceneObject]:
        return [body.moved(item.pose, link, names) for body, item in zip(job.bodies, held)]

    placed = [item.moved(product(job.base_T_goal, item.pose)) for item in job.bodies]
    after = (
        tools(stock_tool, True),
        [*tools(stock_tool, False), *carried(stock_held)],
        [*bare, *carried(())],
        [*tools(goal_tool, False), *carried(goal_held)],
        [*tools(goal_tool, True), *placed],
        [*bare, *placed],
    )
    return Scenes(scene, *(SceneChange(tuple(items)).apply(scene) for items in after))


class _Stock(NamedTuple):
    before: np.ndarray
    approach: Trajectory
    lift: Trajectory


class _Goal(NamedTuple):
    above: np.ndarray
    set_down: Trajectory
    retreat: Trajectory


@dataclass(frozen=True, eq=False)
class _Attempt:
    search: Search
    grip: Grip
    at: FlangePoses
    scenes: Scenes

    def plan(self) -> TaskMotions:
        """Return the plan; the joint solutions with the shortest free ways first."""
        search, at, there = self.search, self.at, self.scenes
        befores = search.solutions(at.before, search.start, there.fetch, APPROACH, "before gripping")
        aboves = search.solutions(at.above, befores[0], there.carry, SET_DOWN, "above its place")
        # what has failed alone fails in every pair
        stock_of = cache(lambda number: _attempted(self._stock_motions, befores[number]))
        goal_of = cache(lambda number: _attempted(self._goal_motions, aboves[number]))
        pairs = itertools.product(range(len(befores)), range(len(aboves)))
        furthest: AttemptFailed | None = None
        tried = 0
        for one, other in sorted(pairs, key=lambda pair: (*self._order(befores[pair[0]], aboves[pair[1]]), pair)):
            if tried >= PAIRS or (tried and search.is_out_of_time):
                break
            stock = stock_of(one)
            found: _Goal | TaskMotions | AttemptFailed = stock if isinstance(stock, AttemptFailed) else goal_of(other)
            if isinstance(found, _Goal):
                tried += 1
                found = _attempted(self._joined, stock, found)
            if isinstance(found, TaskMotions):
                return found
            assert not isinstance(found, _Goal)
            furthest = _furthest(furthest, found)
        assert furthest is not None
        raise furthest

    def _order(self, before: np.ndarray, above: np.ndarray) -> tuple[int, float]:
        """Return how many joint solutions are near an end of the range, and the time of the free ways [s]."""
        robot = self.search.robot
        lower, upper, pace = np.array(robot.lower), np.array(robot.upper), np.array(robot.velocity)
        edge = _NEAR_LIMIT * (upper - lower)
        limited = sum(bool(np.any((q < lower + edge) | (q > upper - edge))) for q in (before, above))
        ways = (before - self.search.start, above - before)
        return limited, round(sum(float(np.max(np.abs(way) / pace)) for way in ways), 9)

    def plan_carried(self) -> TaskMotions:
        """Return the rest of a plan whose element is held."""
        search, there, scale = self.search, self.scenes, self.search.recipe.carry_speed_scale
        aboves = search.solutions(self.at.above, search.start, there.carry, SET_DOWN, "above its place")

        def above(number: int) -> TaskMotions:
            goal = self._goal_motions(aboves[number])
            carry = search.free_motion(search.start, goal.above, scale, there.carry, CARRY)
            return self._carried(PlanBuilder(search, search.scene), carry, goal)

        return _first_success(search, search.nearest(aboves)[:PAIRS], above)

    def _stock_motions(self, before: np.ndarray) -> _Stock:
        search, recipe, at, there = self.search, self.search.recipe, self.at, self.scenes
        approach = search.line_motion(before, at.stock, recipe.free_speed_scale, there.approach, APPROACH)
        lift = search.line_motion(approach.positions[-1], at.lifted, recipe.carry_speed_scale, there.lift, LIFT)
        search.require_free(lift.positions[-1], there.carry, LIFT, "lifted, where it is carried freely from")
        return _Stock(before, approach, lift)

    def _goal_motions(self, above: np.ndarray) -> _Goal:
        search, recipe, at, there = self.search, self.search.recipe, self.at, self.scenes
        set_down = search.line_motion(above, at.goal, recipe.carry_speed_scale, there.set_down, SET_DOWN)
        retreat = search.line_motion(set_down.positions[-1], at.after, recipe.free_speed_scale, there.retreat, RETREAT)
        search.require_free(retreat.positions[-1], there.done, RETREAT, "after letting go")
        return _Goal(above, set_down, retreat)

    def _joined(self, stock: _Stock, goal: _Goal) -> TaskMotions:
        search, recipe, there = self.search, self.search.recipe, self.scenes
        fetch, clearance = search.free_motion(
            search.start, stock.before, recipe.free_speed_scale, there.fetch, TO_STOCK
        )
        carry = search.free_motion(stock.lift.positions[-1], goal.above, recipe.carry_speed_scale, there.carry, CARRY)
        grip, release = search.tool.tool.grip, search.tool.tool.release
        # a sensor that is stuck, or a scrap on the cups, is found before anything is gripped
        held, empty = grip.signals(), release.signals()
        builder = PlanBuilder(search, there.fetch)
        builder.add(TO_STOCK, fetch, False, empty, (), there.approach, clearance)
        builder.add(APPROACH, stock.approach, True, empty, grip.switches(), there.lift)
        builder.add(LIFT, stock.lift, True, held, (), there.carry)
        return self._carried(builder, carry, goal)

    def _carried(self, builder: PlanBuilder, carry: tuple[Trajectory, float], goal: _Goal) -> TaskMotions:
        there, tool = self.scenes, self.search.tool.tool
        held, empty = tool.grip.signals(), tool.release.signals()
        engaged = self.search.recipe.carry_engaged
        builder.add(CARRY, carry[0], engaged, held, (), there.set_down, carry[1])
        builder.add(SET_DOWN, goal.set_down, True, held, tool.release.switches(), there.retreat)
        builder.add(RETREAT, goal.retreat, True, empty, (), there.done)
        return builder.plan(self.grip.name, self.at.tool0_T_element)


PROCESS = Process(
    moves=True,
    recipe=PlaceRecipe,
    check_recipe=check_tool,
    mass=mass_of,
    acts=SET_DOWN,
    plan=plan,
)
