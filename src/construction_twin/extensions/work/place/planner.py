"""How an element is placed: fetch it from its stock, grip it, carry it, set it down, let go, go away.

Joint vectors in the order of `RobotModel.joint_names`, SI; poses in the robot's base_link.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.contacts import FALL
from construction_twin.extensions.work.convex_bodies import Pieces
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.extensions.work.motions import Failed, Free, PlanBuilder, Search
from construction_twin.extensions.work.place.grips import Grip, find_grips
from construction_twin.extensions.work.place.phases import Scenes, Ways, direction, scenes, ways
from construction_twin.extensions.work.place.recipe import OVERRIDES, PlaceRecipe, check_tool, mass_of
from construction_twin.extensions.work.process import REACH, Process, TaskMotions
from construction_twin.extensions.work.site import inverse, pose_of
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import product

#: Names of the segments of a plan, in their order.
TO_STOCK, APPROACH, LIFT, CARRY, SET_DOWN, RETREAT = "to stock", "approach", "lift", "carry", "set down", "retreat"
#: Before the first segment: what is looked at to choose a grip.
GRIP = "grip"
#: In the order in which an attempt gets there.
STAGES = (GRIP, REACH, APPROACH, LIFT, TO_STOCK, SET_DOWN, RETREAT, CARRY)

#: Pieces of the element further than this from where the job has them are somewhere else [m].
_ELSEWHERE = 1e-3
#: Joint solutions within this fraction of a range from its end come after all others.
_NEAR_LIMIT = 0.01


def check(search: Search) -> None:
    """Refuse what cannot be placed at all: by its mass, or because it is neither in its stock nor, if held, in the grip."""
    job = search.job
    mass_of(job, search.name, search.recipe, search.tool.tool)
    if job.base_T_stock is None:
        raise TaskPlanningError(job.task, f"{job.called} has no place in stock")
    present = {item.name: item for item in search.scene.objects}
    if search.held is not None:
        for item in job.bodies:
            if item.name not in present or not present[item.name].link:
                raise TaskPlanningError(job.task, f"{item.name} is not carried in the scene; expected it in the grip")
        if falls := _falls(search):
            raise TaskPlanningError(job.task, falls, SET_DOWN)
        return
    if not job.bodies:
        raise TaskPlanningError(job.task, f"element {job.element.id} has no bodies; it cannot be gripped")
    for item in job.bodies:
        found = present.get(item.name)
        if found is None:
            raise TaskPlanningError(job.task, f"{item.name} is not in the scene; the element has to be in stock")
        if found.link:
            raise TaskPlanningError(job.task, f"{item.name} is carried by {found.link}; expected in stock")
        away = float(np.linalg.norm(product(job.base_T_stock, item.pose).position - found.pose.position))
        if away > _ELSEWHERE:
            where = f"{1e3 * away:.1f} mm from its place in stock"
            raise TaskPlanningError(job.task, f"{item.name} is {where}; expected in stock")


def plan(search: Search) -> TaskMotions:
    """Return the plan of a task; of one whose element is held already, its rest: carry, set down, let go, go away.

    Raises:
        Failed: The attempt that came furthest.
        TaskPlanningError: When there is no grip.
    """
    return _whole(search) if search.held is None else _rest(search, search.held)


def _whole(search: Search) -> TaskMotions:
    job = search.job
    assert job.base_T_stock is not None
    mass = mass_of(job, search.name, search.recipe, search.tool.tool)
    try:
        grips = find_grips(Pieces(job.bodies), job.base_T_stock.rotation.T[:, 2], mass, search.recipe, search.tool.tool)
    except SceneError as error:
        raise TaskPlanningError(job.task, str(error), GRIP) from error
    if not grips.grips:
        raise TaskPlanningError(job.task, f"recipe {search.name!r} finds no grip: {grips.reason}", GRIP)
    furthest: Failed | None = None
    for tried, grip in enumerate(grips.grips):
        if furthest is not None and search.late:
            furthest.reason = Sentence(
                "{reason} ({tried} of {count} grips tried in {seconds:g} s)",
                reason=furthest.reason,
                tried=tried,
                count=len(grips.grips),
                seconds=search.limits.budget,
            )
            break
        try:
            return _with_grip(search, grip)
        except Failed as failed:
            failed.method = grip.name
            furthest = _further(furthest, failed)
            if failed.hopeless:
                break
    assert furthest is not None
    raise furthest


def _rest(search: Search, tool0_T_element: Pose) -> TaskMotions:
    job, recipe = search.job, search.recipe
    element_T_tcp = product(inverse(tool0_T_element), pose_of(search.tool.tool.tool0_T_tcp))
    grip = Grip("the grip it is held with", element_T_tcp, Pose(np.zeros(3), np.eye(3)), 0)
    furthest: Failed | None = None
    for arrive in _options(recipe.place.arrive, recipe.place.lengths, job.base_T_goal):
        if furthest is not None and search.late:
            break
        at = ways(job, grip, recipe, search.tool, np.zeros(3), arrive)
        there = scenes(search.scene, job, recipe, search.tool, search.robot.tip_link, at, search.shapes)
        try:
            return _OneWay(search, grip, at, there).plan_carried()
        except Failed as failed:
            failed.method = grip.name
            furthest = _further(furthest, failed)
    assert furthest is not None
    raise furthest


def _falls(search: Search) -> str:
    """Return why the element would fall when the tool lets go of it at its place; empty: something is under it."""
    job, recipe = search.job, search.recipe
    own = {item.name for item in job.bodies}
    others = [item for item in search.scene.objects if not item.link and item.name not in own]
    if recipe.place.fastened or search.shapes.holder(job.bodies, job.base_T_goal, others, np.array(job.up)):
        return ""
    return Sentence(
        "nothing holds {element} when the tool lets go: nothing is under it within {gap:.0f} mm. If something else holds it "
        "then, say so: `fastened: true` in the recipe's `place`, or the property CTwin_RobotTask.Fastened",
        element=job.element.name or job.element.id,
        gap=1e3 * FALL,
    )


def _with_grip(search: Search, grip: Grip) -> TaskMotions:
    """Return the plan with one grip; the ways from the stock and to the place in the recipe's order."""
    recipe, job = search.recipe, search.job
    assert job.base_T_stock is not None
    furthest: Failed | None = None
    falls = _falls(search)
    for leave, arrive in itertools.product(
        _options(recipe.stock.leave, recipe.stock.lengths, job.base_T_stock),
        _options(recipe.place.arrive, recipe.place.lengths, job.base_T_goal),
    ):
        if furthest is not None and search.late:
            break
        at = ways(job, grip, recipe, search.tool, leave, arrive)
        try:
            _check_reach(at, search)
            if falls:
                raise Failed(SET_DOWN, falls, True)
            there = scenes(search.scene, job, recipe, search.tool, search.robot.tip_link, at, search.shapes)
            _check_bodies(search, at, there)
            return _OneWay(search, grip, at, there).plan()
        except Failed as failed:
            furthest = _further(furthest, failed)
            if failed.stage == REACH and "gripping" in failed.reason:
                break  # another way of the element does not change where it is gripped
    assert furthest is not None
    raise furthest


def _check_reach(at: Ways, search: Search) -> None:
    def size() -> float:
        """Return how far the element reaches from its middle [m]."""
        points = Pieces(search.job.bodies).points
        return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())

    for where, pose in (
        ("gripping", at.stock),
        ("letting go", at.goal),
        ("gripping: before the element", at.before),
        ("lifted", at.lifted),
        ("above its place", at.above),
        ("after letting go", at.after),
    ):
        search.demand_reach(pose, where, size)


def _check_bodies(search: Search, at: Ways, there: Scenes) -> None:
    """Refuse what tool and element cannot do, with whatever joint solution."""
    places = (
        (APPROACH, there.fetch, at.before), (APPROACH, there.approach, at.stock), (LIFT, there.carry, at.lifted),
        (SET_DOWN, there.carry, at.above), (SET_DOWN, there.set_down, at.goal), (RETREAT, there.done, at.after),
    )  # fmt: skip
    for stage, scene, pose in places:
        found = search.shapes.obstruction(scene, pose)
        if found is not None:
            one, other = found
            said = Sentence("{first} would touch {second}, or come closer than the padding", first=one, second=other)
            raise Failed(stage, said)


def _options(directions: tuple, lengths: tuple[float, ...], base_T_element: Pose) -> list[np.ndarray]:
    return [length * direction(asked, base_T_element) for asked in directions for length in lengths]


def _further(one: Failed | None, other: Failed) -> Failed:
    """Return the attempt that came further, the first of two that came as far."""
    return other if one is None or STAGES.index(other.stage) > STAGES.index(one.stage) else one


_Made = TypeVar("_Made")


def _once(made: dict[int, _Made | Failed], number: int, make: Callable[[], _Made]) -> _Made:
    """Return what was made for a number, made at the first call; a failure is kept and raised again too."""
    if number not in made:
        try:
            made[number] = make()
        except Failed as failed:
            made[number] = failed
    found = made[number]
    if isinstance(found, Failed):
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

    search: Search
    grip: Grip
    at: Ways
    scenes: Scenes
    _stocks: dict[int, _Stock | Failed] = field(default_factory=dict)
    _goals: dict[int, _Goal | Failed] = field(default_factory=dict)

    def plan(self) -> TaskMotions:
        """Return the plan; the combinations of joint solutions with the shortest free ways first."""
        find, at, there = self.search.solutions, self.at, self.scenes
        befores = find(at.before, self.search.start, there.fetch, APPROACH, "before gripping")
        aboves = find(at.above, befores[0], there.carry, SET_DOWN, "above its place")
        furthest: Failed | None = None
        tried = 0
        for one, other in self._combinations(befores, aboves):
            if tried >= self.search.limits.pairs or (tried and self.search.late):
                break
            try:
                stock = self._stock(one, befores[one])
                goal = self._goal(other, aboves[other])
                tried += 1
                return self._joined(stock, goal)
            except Failed as failed:
                furthest = _further(furthest, failed)
        assert furthest is not None
        raise furthest

    def plan_carried(self) -> TaskMotions:
        """Return the rest of a plan whose element is held already."""
        search, there, scale = self.search, self.scenes, self.search.recipe.carry_speed_scale
        aboves = search.solutions(self.at.above, search.start, there.carry, SET_DOWN, "above its place")
        furthest: Failed | None = None
        for number in search.nearest(aboves)[: search.limits.pairs]:
            if furthest is not None and search.late:
                break
            try:
                goal = self._goal(number, aboves[number])
                carry = search.free(search.start, goal.above, scale, there.carry, CARRY)
            except Failed as failed:
                furthest = _further(furthest, failed)
                continue
            return self._carried(PlanBuilder(search, search.scene), carry, goal)
        assert furthest is not None
        raise furthest

    def _combinations(self, befores: list[np.ndarray], aboves: list[np.ndarray]) -> Iterator[tuple[int, int]]:
        robot = self.search.robot
        pace = np.array(robot.velocity)

        def time(first: np.ndarray, second: np.ndarray) -> float:
            return float(np.max(np.abs(second - first) / pace))

        lower, upper = np.array(robot.lower), np.array(robot.upper)
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
            if not (isinstance(self._stocks.get(one), Failed) or isinstance(self._goals.get(other), Failed)):
                yield one, other

    def _stock(self, number: int, before: np.ndarray) -> _Stock:
        return _once(self._stocks, number, lambda: self._make_stock(before))

    def _goal(self, number: int, above: np.ndarray) -> _Goal:
        return _once(self._goals, number, lambda: self._make_goal(above))

    def _make_stock(self, before: np.ndarray) -> _Stock:
        search, recipe, at, there = self.search, self.search.recipe, self.at, self.scenes
        approach = search.line(before, at.stock, recipe.free_speed_scale, there.approach, APPROACH)
        lift = search.line(approach.positions[-1], at.lifted, recipe.carry_speed_scale, there.lift, LIFT)
        search.demand_free(lift.positions[-1], there.carry, LIFT, "lifted, where it is carried freely from")
        return _Stock(before, approach, lift)

    def _make_goal(self, above: np.ndarray) -> _Goal:
        search, recipe, at, there = self.search, self.search.recipe, self.at, self.scenes
        set_down = search.line(above, at.goal, recipe.carry_speed_scale, there.set_down, SET_DOWN)
        retreat = search.line(set_down.positions[-1], at.after, recipe.free_speed_scale, there.retreat, RETREAT)
        search.demand_free(retreat.positions[-1], there.done, RETREAT, "after letting go")
        return _Goal(above, set_down, retreat)

    def _joined(self, stock: _Stock, goal: _Goal) -> TaskMotions:
        search, recipe, there = self.search, self.search.recipe, self.scenes
        fetch = search.free(search.start, stock.before, recipe.free_speed_scale, there.fetch, TO_STOCK)
        carry = search.free(stock.lift.positions[-1], goal.above, recipe.carry_speed_scale, there.carry, CARRY)
        grip, release = search.tool.tool.grip, search.tool.tool.release
        # a sensor that is stuck, or a scrap on the cups, is found before anything is gripped
        held, empty = grip.signals(), release.signals()
        made = PlanBuilder(search, there.fetch)
        made.add(TO_STOCK, fetch.trajectory, False, empty, (), there.approach, fetch.clearance)
        made.add(APPROACH, stock.approach, True, empty, grip.switches(), there.lift)
        made.add(LIFT, stock.lift, True, held, (), there.carry)
        return self._carried(made, carry, goal)

    def _carried(self, made: PlanBuilder, carry: Free, goal: _Goal) -> TaskMotions:
        """Return the plan that goes on with the element in the grip, up to its end."""
        there, tool = self.scenes, self.search.tool.tool
        held, empty = tool.grip.signals(), tool.release.signals()
        engaged = self.search.recipe.carry_engaged
        made.add(CARRY, carry.trajectory, engaged, held, (), there.set_down, carry.clearance)
        made.add(SET_DOWN, goal.set_down, True, held, tool.release.switches(), there.retreat)
        made.add(RETREAT, goal.retreat, True, empty, (), there.done)
        return made.plan(self.grip.name, self.at.tool0_T_element)


PROCESS = Process(
    moves=True,
    recipe=PlaceRecipe,
    overrides=OVERRIDES,
    check_recipe=check_tool,
    mass=mass_of,
    acts=SET_DOWN,
    check=check,
    plan=plan,
)
