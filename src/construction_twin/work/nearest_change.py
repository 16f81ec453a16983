"""What would have to be different for a task that cannot be planned: the first of a list of small changes with which it can.

Tried: another grip, another side that it comes from, another order, another place of the work, a longer track. Nothing is changed
anywhere; the answer is a sentence for the person who plans the cell. Metres; poses in the robot's base_link.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from construction_twin.core.motion_errors import SceneError
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.scene_change import SceneChange
from construction_twin.work.jobs import PlaceJob
from construction_twin.work.phases import direction
from construction_twin.work.pieces import Pieces
from construction_twin.work.recipes import OVERRIDES, PROPERTY_SET, Direction, Recipes
from construction_twin.work.task_planner import LIFT, REACH, SET_DOWN, TaskPlanner

#: Shifts of the work that are tried, the smallest first [m], and turns about the vertical [deg].
SHIFTS = (0.1, 0.2, 0.4)
TURNS_DEG = (15.0, -15.0, 30.0, -30.0)
#: By how much the directions of a recipe are raised, as unit vectors.
RISES = (0.5, 1.0)
#: Directions that point down by more than this are not tried.
_FROM_BELOW = 0.1
#: By how much a track is made longer at both ends [m].
LONGER = (0.5, 1.0, 2.0)
#: Most placed elements whose absence is tried.
ELEMENTS_TRIED = 6
#: An element rests on another that ends within this height of where it begins [m].
_RESTS = 0.02
_YAWS_DEG = (0.0, 90.0, 180.0, 270.0)


@dataclass(frozen=True)
class Change:
    """A change that helps.

    Attributes:
        kind: ``grip``, ``direction``, ``order``, ``base`` or ``track``.
        sentence: What to do.
    """

    kind: Literal["grip", "direction", "order", "base", "track"]
    sentence: str


def nearest_change(
    job: PlaceJob,
    start: JointValues,
    scene: Scene,
    planner: TaskPlanner,
    placed: Mapping[str, str],
    longer: Iterable[tuple[float, Callable[[], TaskPlanner]]] = (),
    going_on: Callable[[], bool] = lambda: True,
    failure: TaskPlanningError | None = None,
    before: Collection[str] = (),
) -> Change | None:
    """Return the first change with which a task that failed can be planned; None: none of those tried helps.

    Args:
        start: Length n
        scene: Those with which it failed.
        planner: With which it failed.
        placed: GlobalIds of the elements that stand in the scene, and their names.
        longer: By how much a track is longer at both ends [m], and what makes the planner of the robot on it (see `longer_track`).
        going_on: Asked before each attempt; when it returns false, None is returned.
        failure: Why it failed: where the arm does not reach, place and track are tried first, and other elements not at all; where
            it failed on the way from the stock or to the place, other directions of that way are tried first.
        before: GlobalIds of the elements that it waits for. It is never advised to be placed before these, nor before what it rests
            on.
    """

    def works(candidate: _Candidate) -> bool:
        try:
            candidate.planner().plan(candidate.job, start, candidate.scene)
        except (TaskPlanningError, SceneError):
            return False
        return True

    grips, order = _other_grips(job, scene, planner), _other_order(job, scene, planner, placed, before)
    places, tracks = _other_places(job, scene, planner, placed), _longer(job, scene, longer)
    stage = "" if failure is None else failure.stage
    ways = _other_directions(job, scene, planner, stage)
    first = (places, tracks, grips, ways) if stage == REACH else (ways, grips, order, places, tracks)
    for candidate in itertools.chain(*first):
        if not going_on():
            return None
        if works(candidate):
            return candidate.change
    return None


def longer_track(robot: RobotModel, by: float) -> RobotModel | None:
    """Return a robot whose linear joints reach further to both ends; None: it has none.

    Args:
        by: [m]
    """
    if not any(robot.linear):
        return None
    lower = tuple(low - by if linear else low for low, linear in zip(robot.lower, robot.linear))
    upper = tuple(high + by if linear else high for high, linear in zip(robot.upper, robot.linear))
    return replace(robot, lower=lower, upper=upper)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """One change, and what to plan with it."""

    change: Change
    job: PlaceJob
    scene: Scene
    planner: Callable[[], TaskPlanner]


def _other_grips(job: PlaceJob, scene: Scene, planner: TaskPlanner) -> Iterator[_Candidate]:
    recipes = planner.recipes
    for words, key, update in (
        ("the tool turned by quarter turns", "yaws_deg", {"yaws_deg": _YAWS_DEG}),
        ("every flat face", "faces", {"yaws_deg": _YAWS_DEG, "faces": ("up", "any")}),
        (
            "places further from the middle",
            "along, across, lever",
            {
                "yaws_deg": _YAWS_DEG,
                "faces": ("up", "any"),
                "along": (0.0, 0.05, -0.05, 0.1, -0.1, 0.2, -0.2),
                "across": (0.0, 0.04, -0.04),
                "lever": 0.3,
                "min_cups": 1,
            },
        ),
    ):
        wider = {
            name: recipe.model_copy(update={"grips": recipe.grips.model_copy(update=update)})
            for name, recipe in recipes.recipes.items()
        }
        sentence = f"allow {words} in its recipe ({key}), or in {PROPERTY_SET}"
        other = Recipes(recipes.file, wider)
        asked = _without_overrides(job, [("grips", name) for name in update])
        yield _Candidate(Change("grip", sentence), asked, scene, partial(planner.with_recipes, other))


def _without_overrides(job: PlaceJob, keys: Collection[tuple[str, ...]]) -> PlaceJob:
    """Return a job whose element does not override keys of its recipe: what is tried is then what is planned with."""
    own = job.properties.get(PROPERTY_SET, {})
    left = {name: value for name, value in own.items() if name not in OVERRIDES or OVERRIDES[name].key not in keys}
    return job if len(left) == len(own) else replace(job, properties={**job.properties, PROPERTY_SET: left})


def _other_directions(job: PlaceJob, scene: Scene, planner: TaskPlanner, stage: str) -> Iterator[_Candidate]:
    """Yield other sides from which it is set down, or to which it is lifted off the stock, where that was not possible."""
    if stage not in (LIFT, SET_DOWN):
        return
    part, key, words, pose = (
        ("stock", "leave", "lift it towards", job.base_T_stock)
        if stage == LIFT
        else ("place", "arrive", "set it down from", job.base_T_goal)
    )
    recipes = planner.recipes
    try:
        name, recipe = recipes.of(job)
    except TaskPlanningError:
        return
    part_of = getattr(recipe, part)
    asked = _without_overrides(job, [(part, key)])
    note = (
        "" if asked.properties == job.properties else f", and take {PROPERTY_SET}.{key.capitalize()} from the element"
    )
    for other in other_directions(getattr(part_of, key), pose):
        changed = recipe.model_copy(update={part: part_of.model_copy(update={key: (other,)})})
        shown = f"[{', '.join(f'{value:g}' for value in other)}]" if isinstance(other, tuple) else other
        seen = (
            "seen from the robot's base" if isinstance(other, tuple) else "of the element" if other != "up" else "above"
        )
        sentence = f"{words} {shown} ({seen}): {part}/{key} of its recipe {name!r}{note}"
        with_it = Recipes(recipes.file, {**recipes.recipes, name: changed})
        yield _Candidate(Change("direction", sentence), asked, scene, partial(planner.with_recipes, with_it))


def other_directions(given: Sequence[Direction], base_T_element: Pose) -> Iterator[Direction]:
    """Yield directions that are near to those of a recipe, then the others: each raised, from above, along the element's axes.

    Args:
        given: The recipe's.
    """
    seen = [direction(one, base_T_element) for one in given]
    others: list[Direction] = [
        (round(float(one[0]), 2) + 0.0, round(float(one[1]), 2) + 0.0, round(float(one[2]) + rise, 2) + 0.0)
        for one in list(seen)
        for rise in RISES
    ]
    # half a metre above what comes from right below is no direction
    others = [other for other in others if any(other)]
    for other in (*others, "up", "+x", "-x", "+y", "-y", "+z", "-z"):
        vector = direction(other, base_T_element)
        # nothing is set down from below, and nothing is tried twice
        if vector[2] > -_FROM_BELOW and all(vector @ one < 1.0 - 1e-3 for one in seen):
            seen.append(vector)
            yield other


def _other_order(
    job: PlaceJob, scene: Scene, planner: TaskPlanner, placed: Mapping[str, str], before: Collection[str]
) -> Iterator[_Candidate]:
    needed = {job.element, *before, *_under_element(job, scene, placed)}
    near = sorted((element for element in placed if element not in needed), key=lambda one: _away(scene, one, job))
    for element in near[:ELEMENTS_TRIED]:
        left = _without(scene, element)
        if len(left.objects) == len(scene.objects):
            continue
        sentence = f"place it before {placed[element] or element!r}, which is in the way"
        yield _Candidate(Change("order", sentence), _asked_of(job, left), left, lambda: planner)


def _under_element(job: PlaceJob, scene: Scene, placed: Mapping[str, str]) -> set[str]:
    """Return the placed elements that it rests on, at first or second hand: boxes that end where the upper one begins."""
    items: dict[str, list[SceneObject]] = {}
    for item in scene.objects:
        if _element_of(item) in placed and not item.link:
            items.setdefault(_element_of(item), []).append(item)
    boxes = {element: _box(group) for element, group in items.items()}
    upper = [_box([item.moved(product(job.base_T_goal, item.pose)) for item in job.bodies])]
    found: set[str] = set()
    while upper:
        low, high = upper.pop()
        for element, (other_low, other_high) in boxes.items():
            rests = abs(other_high[2] - low[2]) <= _RESTS
            over = (other_low[:2] < high[:2]).all() and (low[:2] < other_high[:2]).all()
            if element not in found and rests and over:
                found.add(element)
                upper.append((other_low, other_high))
    return found


def _box(items: Sequence[SceneObject]) -> tuple[np.ndarray, np.ndarray]:
    points = Pieces(items).points
    return points.min(axis=0), points.max(axis=0)


def _other_places(job: PlaceJob, scene: Scene, planner: TaskPlanner, placed: Mapping[str, str]) -> Iterator[_Candidate]:
    shifts = [(x, y, 0.0) for size in SHIFTS for x, y in ((0, size), (0, -size), (size, 0), (-size, 0))]
    for x, y, turn in [*shifts, *((0.0, 0.0, turn) for turn in TURNS_DEG)]:
        move = _move(job.base_T_goal, x, y, turn)
        there = _moved(scene, move, job, placed)
        goal = replace(job, base_T_goal=product(move, job.base_T_goal))
        how = f"turned by {turn:g} deg" if turn else f"{_shift(x, 'x')}{_shift(y, 'y')}"
        sentence = f"build it {how}, seen from the robot's base: move model_T_base and what the work stands on with it"
        yield _Candidate(Change("base", sentence), goal, there, lambda: planner)


def _longer(
    job: PlaceJob, scene: Scene, longer: Iterable[tuple[float, Callable[[], TaskPlanner]]]
) -> Iterator[_Candidate]:
    for by, make in longer:
        yield _Candidate(Change("track", f"give the track {by:g} m more at both ends"), job, scene, make)


def _shift(value: float, axis: str) -> str:
    return f"{abs(value):g} m further in {'-' if value < 0 else '+'}{axis}" if value else ""


def _move(about: Pose, x: float, y: float, turn_deg: float) -> Pose:
    angle = math.radians(turn_deg)
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Pose(about.position - rotation @ about.position + np.array([x, y, 0.0]), rotation)


def _moved(scene: Scene, move: Pose, job: PlaceJob, placed: Mapping[str, str]) -> Scene:
    """Return the scene with what the work stands on, and what stands already, moved with it; the stock stays."""
    under = _under(scene, job)

    def item_there(item: SceneObject) -> SceneObject:
        # what is fixed and of an element stands where the model has it
        goes = _element_of(item) in placed or item.name in under or (item.fixed and bool(_element_of(item)))
        return item.moved(product(move, item.pose), "", item.touch) if goes and not item.link else item

    return replace(scene, objects=tuple(item_there(item) for item in scene.objects))


def _under(scene: Scene, job: PlaceJob) -> set[str]:
    """Return the supports that are no elements and are nearer to the place than to the stock."""
    names = set()
    for item in scene.objects:
        if item.name in job.supports and "/" not in item.name:
            to_goal = np.linalg.norm(item.pose.position[:2] - job.base_T_goal.position[:2])
            to_stock = np.linalg.norm(item.pose.position[:2] - job.base_T_stock.position[:2])
            if to_goal < to_stock:
                names.add(item.name)
    return names


def _away(scene: Scene, element: str, job: PlaceJob) -> float:
    at = job.base_T_goal.position
    distances = [np.linalg.norm(item.pose.position - at) for item in scene.objects if _element_of(item) == element]
    return float(min(distances, default=math.inf))


def _element_of(item: SceneObject) -> str:
    return item.name.rpartition("/")[0]


def _without(scene: Scene, element: str) -> Scene:
    return SceneChange((), tuple(item.name for item in scene.objects if _element_of(item) == element)).apply(scene)


def _asked_of(job: PlaceJob, scene: Scene) -> PlaceJob:
    return replace(job, supports=tuple(name for name in job.supports if name in scene.names))
