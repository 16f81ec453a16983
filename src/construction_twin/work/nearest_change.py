"""What would have to be different for a task that cannot be planned: the first of a list of small changes with which it can.

Tried: what its process names (of `place` another grip, another side that it comes from), another order, another place of the work,
a longer track. Nothing is changed anywhere; the answer is a sentence for the person who plans the cell. Metres; poses in the
robot's base_link.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from construction_twin.core.motion_errors import SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.scene_change import SceneChange
from construction_twin.work.convex_bodies import Pieces
from construction_twin.work.jobs import WorkJob
from construction_twin.work.process import REACH
from construction_twin.work.processes import process_of
from construction_twin.work.task_planner import TaskPlanner

#: Shifts of the work that are tried, the smallest first [m], and turns about the vertical [deg].
SHIFTS = (0.1, 0.2, 0.4)
TURNS_DEG = (15.0, -15.0, 30.0, -30.0)
#: By how much a track is made longer at both ends [m].
LONGER = (0.5, 1.0, 2.0)
#: Most placed elements whose absence is tried.
ELEMENTS_TRIED = 6
#: An element rests on another that ends within this height of where it begins [m].
_RESTS = 0.02


@dataclass(frozen=True)
class Change:
    """A change that helps.

    Attributes:
        kind: ``order``, ``base``, ``track``, or a word of the process: of `place` ``grip`` or ``direction``.
        sentence: What to do.
    """

    kind: str
    sentence: str


def nearest_change(
    job: WorkJob,
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
        failure: Why it failed: where the arm does not reach, place and track are tried first, and other elements not at all; else
            what its process names comes first.
        before: GlobalIds of the elements that it waits for. It is never advised to be placed before these, nor before what it rests
            on.
    """

    def works(candidate: Candidate) -> bool:
        try:
            candidate.planner().plan(candidate.job, start, candidate.scene)
        except (TaskPlanningError, SceneError):
            return False
        return True

    places, tracks = _other_places(job, scene, planner, placed), _longer(job, scene, longer)
    stage = "" if failure is None else failure.stage
    order, own = _other_order(job, scene, planner, placed, before), _of_process(job, scene, planner, stage)
    first = (places, tracks, own) if stage == REACH else (own, order, places, tracks)
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
class Candidate:
    """One change, and what to plan with it.

    Attributes:
        planner: Returns the planner that it is planned with.
    """

    change: Change
    job: WorkJob
    scene: Scene
    planner: Callable[[], TaskPlanner]


def _of_process(job: WorkJob, scene: Scene, planner: TaskPlanner, stage: str) -> Iterator[Candidate]:
    """Yield what the job's process has to try."""
    try:
        _, recipe = planner.recipes.of(job)
    except TaskPlanningError:
        return
    yield from process_of(recipe.process).changes(job, scene, planner, stage)


def _other_order(
    job: WorkJob, scene: Scene, planner: TaskPlanner, placed: Mapping[str, str], before: Collection[str]
) -> Iterator[Candidate]:
    needed = {job.element, *before, *_under_element(job, scene, placed)}
    near = sorted((element for element in placed if element not in needed), key=lambda one: _away(scene, one, job))
    for element in near[:ELEMENTS_TRIED]:
        left = _without(scene, element)
        if len(left.objects) == len(scene.objects):
            continue
        sentence = Sentence("work.change.order", element=repr(placed[element] or element))
        yield Candidate(Change("order", sentence), _asked_of(job, left), left, lambda: planner)


def _under_element(job: WorkJob, scene: Scene, placed: Mapping[str, str]) -> set[str]:
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


def _other_places(job: WorkJob, scene: Scene, planner: TaskPlanner, placed: Mapping[str, str]) -> Iterator[Candidate]:
    shifts = [(x, y, 0.0) for size in SHIFTS for x, y in ((0, size), (0, -size), (size, 0), (-size, 0))]
    for x, y, turn in [*shifts, *((0.0, 0.0, turn) for turn in TURNS_DEG)]:
        move = _move(job.base_T_goal, x, y, turn)
        there = _moved(scene, move, job, placed)
        goal = replace(job, base_T_goal=product(move, job.base_T_goal))
        by, axis = (x, "x") if x else (y, "y")
        shifted = Sentence("work.change.shifted", by=abs(by), direction=f"{'-' if by < 0 else '+'}{axis}")
        sentence = Sentence("work.change.turned", turn=turn) if turn else shifted
        yield Candidate(Change("base", sentence), goal, there, lambda: planner)


def _longer(
    job: WorkJob, scene: Scene, longer: Iterable[tuple[float, Callable[[], TaskPlanner]]]
) -> Iterator[Candidate]:
    for by, make in longer:
        yield Candidate(Change("track", Sentence("work.change.track", by=by)), job, scene, make)


def _move(about: Pose, x: float, y: float, turn_deg: float) -> Pose:
    angle = math.radians(turn_deg)
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Pose(about.position - rotation @ about.position + np.array([x, y, 0.0]), rotation)


def _moved(scene: Scene, move: Pose, job: WorkJob, placed: Mapping[str, str]) -> Scene:
    """Return the scene with what the work stands on, and what stands already, moved with it; the stock stays."""
    under = _under(scene, job)
    with_it = {*placed} if job.base_T_stock is not None else {*placed, job.element}

    def item_there(item: SceneObject) -> SceneObject:
        # what is fixed and of an element stands where the model has it
        goes = _element_of(item) in with_it or item.name in under or (item.fixed and bool(_element_of(item)))
        return item.moved(product(move, item.pose), "", item.touch) if goes and not item.link else item

    return replace(scene, objects=tuple(item_there(item) for item in scene.objects))


def _under(scene: Scene, job: WorkJob) -> set[str]:
    """Return the supports that are no elements and are nearer to the place than to the stock."""
    names = set()
    for item in scene.objects:
        if item.name in job.supports and "/" not in item.name:
            to_goal = np.linalg.norm(item.pose.position[:2] - job.base_T_goal.position[:2])
            stock = job.base_T_stock
            if stock is None or to_goal < np.linalg.norm(item.pose.position[:2] - stock.position[:2]):
                names.add(item.name)
    return names


def _away(scene: Scene, element: str, job: WorkJob) -> float:
    at = job.base_T_goal.position
    distances = [np.linalg.norm(item.pose.position - at) for item in scene.objects if _element_of(item) == element]
    return float(min(distances, default=math.inf))


def _element_of(item: SceneObject) -> str:
    return item.name.rpartition("/")[0]


def _without(scene: Scene, element: str) -> Scene:
    return SceneChange((), tuple(item.name for item in scene.objects if _element_of(item) == element)).apply(scene)


def _asked_of(job: WorkJob, scene: Scene) -> WorkJob:
    return replace(job, supports=tuple(name for name in job.supports if name in scene.names))
