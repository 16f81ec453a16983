"""How an element is placed: fetch it from its stock, grip it, carry it, set it down, let go, go away.

Joint vectors in the order of `RobotModel.joint_names`, SI; poses in the robot's base_link.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from construction_twin.core.motion_errors import SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import Scene, product
from construction_twin.work.contacts import FALL
from construction_twin.work.convex_bodies import Pieces
from construction_twin.work.jobs import TaskMotions
from construction_twin.work.motions import Failed, Free, PlanBuilder, Search
from construction_twin.work.place.grips import Grip, find_grips
from construction_twin.work.place.phases import Scenes, Ways, direction, scenes, ways
from construction_twin.work.place.recipe import PlaceRecipe, mass_of
from construction_twin.work.process import REACH
from construction_twin.work.site import inverse, pose_of

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
        raise TaskPlanningError(job.task, Sentence("{element} has no place in stock", element=job.called))
    if search.held is None:
        _check_stock(search)
        return
    carried = {item.name for item in search.scene.objects if item.link}
    for item in job.bodies:
        if item.name not in carried:
            raise TaskPlanningError(
                job.task, Sentence("{body} is not carried in the scene; expected it in the grip", body=item.name)
            )
    if falls := _falls(search):
        raise TaskPlanningError(job.task, falls, SET_DOWN)


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
        raise TaskPlanningError(
            job.task,
            Sentence("recipe {recipe} finds no grip: {reason}", recipe=repr(search.name), reason=grips.reason),
            GRIP,
        )
    furthest = Failed(GRIP, "", Sentence("no grip"))
    for tried, grip in enumerate(grips.grips):
        if tried and search.late:
            reason = Sentence(
                "{reason} ({tried} of {count} grips tried in {seconds:g} s)",
                reason=furthest.reason,
                tried=tried,
                count=len(grips.grips),
                seconds=search.limits.budget,
            )
            furthest = Failed(furthest.stage, furthest.method, reason)
            break
        try:
            return _with_grip(search, grip)
        except Failed as failed:
            furthest = max(furthest, failed, key=_rank)
            if failed.hopeless:
                break
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
            furthest = _further(furthest, failed)
    assert furthest is not None
    raise furthest


def _check_stock(search: Search) -> None:
    """Refuse a scene that is not that of a task's start: the element in its stock."""
    job = search.job
    assert job.base_T_stock is not None
    present = {item.name: item for item in search.scene.objects}
    if not job.bodies:
        raise TaskPlanningError(
            job.task, Sentence("element {element} has no bodies; it cannot be gripped", element=job.element.id)
        )
    for item in job.bodies:
        found = present.get(item.name)
        if found is None:
            raise TaskPlanningError(
                job.task, Sentence("{body} is not in the scene; the element has to be in stock", body=item.name)
            )
        away = float(np.linalg.norm(product(job.base_T_stock, item.pose).position - found.pose.position))
        if found.link:
            raise TaskPlanningError(
                job.task, Sentence("{body} is carried by {link}; expected in stock", body=item.name, link=found.link)
            )
        if away > _ELSEWHERE:
            raise TaskPlanningError(
                job.task,
                Sentence(
                    "{body} is {away:.1f} mm from its place in stock; expected in stock",
                    body=item.name,
                    away=1e3 * away,
                ),
            )


def _falls(search: Search) -> str:
    """Return why the element would fall when the tool lets go of it at its place; empty: something is under it."""
    job, recipe = search.job, search.recipe
    own = {item.name for item in job.bodies}
    others = [item for item in search.scene.objects if not item.link and item.name not in own]
    if recipe.place.fastened or search.shapes.holder(job.bodies, job.base_T_goal, others, np.array(job.up)):
        return ""
    return Sentence(
        "nothing holds {element} when the tool lets go: nothing that stands is under it within "
        "{gap:.0f} mm. If it is fastened before, by what the model does not show, say so: `fastened: "
        "true` in the recipe's `place`, or the property CTwin_RobotTask.Fastened",
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
            _check_reach(at, grip, search)
            if falls:
                raise Failed(SET_DOWN, grip.name, falls, True)
            there = scenes(search.scene, job, recipe, search.tool, search.robot.tip_link, at, search.shapes)
            _check_bodies(search, at, there, grip)
            return _OneWay(search, grip, at, there).plan()
        except Failed as failed:
            furthest = _further(furthest, failed)
            if failed.stage == REACH and "gripping" in failed.reason:
                break  # another way of the element does not change where it is gripped
    assert furthest is not None
    raise furthest


def _check_reach(at: Ways, grip: Grip, search: Search) -> None:
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
        search.demand_reach(pose, grip.name, where, size)


def _check_bodies(search: Search, at: Ways, there: Scenes, grip: Grip) -> None:
    """Refuse what tool and element cannot do, with whatever joint solution."""
    places = (
        (APPROACH, there.fetch, at.before), (APPROACH, there.approach, at.stock), (LIFT, there.carry, at.lifted),
        (SET_DOWN, there.carry, at.above), (SET_DOWN, there.set_down, at.goal), (RETREAT, there.done, at.after),
    )  # fmt: skip
    for stage, scene, pose in places:
        found = search.shapes.obstruction(scene, pose)
        if found is not None:
            raise Failed(
                stage,
                grip.name,
                Sentence(
                    "{first} would touch {second}, or come closer than the padding", first=found[0], second=found[1]
                ),
            )


def _options(directions: tuple, lengths: tuple[float, ...], base_T_element: Pose) -> list[np.ndarray]:
    return [length * direction(asked, base_T_element) for asked in directions for length in lengths]


def _rank(failed: Failed) -> int:
    return STAGES.index(failed.stage)


def _further(one: Failed | None, other: Failed) -> Failed:
    """Return the attempt that came further, the first of two that came as far."""
    return other if one is None or _rank(other) > _rank(one) else one


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
        befores = self._solutions(self.at.before, self.search.start, self.scenes.fetch, APPROACH, "before gripping")
        aboves = self._solutions(self.at.above, befores[0], self.scenes.carry, SET_DOWN, "above its place")
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
        recipe, search, there = self._recipe, self.search, self.scenes
        aboves = self._solutions(self.at.above, search.start, there.carry, SET_DOWN, "above its place")
        furthest: Failed | None = None
        for number in search.nearest(aboves)[: search.limits.pairs]:
            if furthest is not None and search.late:
                break
            try:
                goal = self._goal(number, aboves[number])
                carry = self._free(CARRY, search.start, goal.above, recipe.carry_speed_scale, there.carry)
            except Failed as failed:
                furthest = _further(furthest, failed)
                continue
            return self._carried(PlanBuilder(search, search.scene), carry, goal)
        assert furthest is not None
        raise furthest

    def _solutions(self, pose: Pose, seed: np.ndarray, scene: Scene, stage: str, where: str) -> list[np.ndarray]:
        return self.search.solutions(pose, seed, scene, stage, self.grip.name, where)

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
        self.search.demand_free(q, scene, stage, self.grip.name, where)

    def _line(self, stage: str, start: np.ndarray, pose: Pose, scale: float, scene: Scene) -> Trajectory:
        return self.search.line(start, pose, scale, scene, stage, self.grip.name)

    def _free(self, stage: str, start: np.ndarray, goal: np.ndarray, scale: float, scene: Scene) -> Free:
        return self.search.free(start, goal, scale, scene, stage, self.grip.name)

    def _joined(self, stock: _Stock, goal: _Goal) -> TaskMotions:
        recipe, search, there = self._recipe, self.search, self.scenes
        fetch = self._free(TO_STOCK, search.start, stock.before, recipe.free_speed_scale, there.fetch)
        carry = self._free(CARRY, stock.lift.positions[-1], goal.above, recipe.carry_speed_scale, there.carry)
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
        made.add(CARRY, carry.trajectory, self._recipe.carry_engaged, held, (), there.set_down, carry.clearance)
        made.add(SET_DOWN, goal.set_down, True, held, tool.release.switches(), there.retreat)
        made.add(RETREAT, goal.retreat, True, empty, (), there.done)
        return made.plan(self.grip.name, self.at.tool0_T_element)

    @property
    def _recipe(self) -> PlaceRecipe:
        return self.search.recipe
