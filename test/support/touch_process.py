"""A second process, for tests: the tool's centre point goes straight down to a point of an element that stands, and back.

It grips nothing and changes no scene. The point is in the element's frame; the tool stops a gap above it, so that the scene's
padding holds all the way.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import pydantic
import pytest
import yaml
from work_samples import RECIPES

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work import process
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.extensions.work.motions import PAIRS, AttemptFailed, PlanBuilder, Search
from construction_twin.extensions.work.process import Finite, Length, Process, Recipe, TaskMotions
from construction_twin.extensions.work.work_cell import inverse, pose_of
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.objects import product

NAME = "touch"
TO_POINT, TOUCH, BACK = "to point", "touch", "back"
#: In the frame of a brick of `work_samples`.
TOP = (0.05, 0.0, 0.071)
RECIPE = {
    "process": NAME, "match": {"elements": ["brick0"]}, "speed": 0.2, "free_speed_scale": 0.5, "points": [TOP], "gap": 0.04,
}  # fmt: skip
#: The tool's z points down, its x along the base's.
_DOWN = np.diag([1.0, -1.0, -1.0])


class TouchRecipe(Recipe):
    """How elements are touched.

    Attributes:
        points: In the element's frame [m], the best first.
        gap: Between the point and where the tool's centre point turns [m].
        way: Length of the straight way down to it, and back [m].
    """

    points: Annotated[tuple[tuple[Finite, Finite, Finite], ...], pydantic.Field(min_length=1)]
    gap: Length = 0.03
    way: Length = 0.1


def check_recipe(recipe: TouchRecipe, tool, where: str) -> None:
    if recipe.gap <= 0.02:
        raise ConfigurationError(f"{where}/gap", recipe.gap, "more than 0.02")


def check(search: Search) -> None:
    """Refuse an element that is not where the job has it, and one that is held."""
    job, present = search.job, {item.name: item for item in search.scene.objects}
    if search.held is not None:
        raise TaskPlanningError(job.task, f"{job.label} is in the grip; to touch it is to stand at its place")
    for item in job.bodies:
        found = present.get(item.name)
        away = np.inf if found is None else np.linalg.norm(
            product(job.base_T_goal, item.pose).position - found.pose.position
        )  # fmt: skip
        if found is None or found.link or away > 1e-3:
            raise TaskPlanningError(job.task, f"{item.name} is not at its place in the scene; expected it there")


def plan(search: Search) -> TaskMotions:
    check(search)
    furthest: AttemptFailed | None = None
    for point in search.recipe.points:
        if furthest is not None and search.is_out_of_time:
            break
        name = f"point {' '.join(f'{1e3 * value:g}' for value in point)} mm"
        try:
            return _at(search, point, name)
        except AttemptFailed as failed:
            failed.method = name
            furthest = failed
    assert furthest is not None
    raise furthest


def _at(search: Search, point: tuple[float, float, float], name: str) -> TaskMotions:
    recipe, scene, job = search.recipe, search.scene, search.job
    there = job.base_T_goal.position + job.base_T_goal.rotation @ np.array(point)
    tcp_T_tool0 = inverse(pose_of(search.tool.tool.tool0_T_tcp))
    at, above = (
        product(Pose(there + np.array([0.0, 0.0, height]), _DOWN), tcp_T_tool0)
        for height in (recipe.gap, recipe.gap + recipe.way)
    )
    search.require_reach(at, "at the point")
    befores = search.solutions(above, search.start, scene, TO_POINT, "above the point")
    furthest: AttemptFailed | None = None
    for number in search.nearest(befores)[:PAIRS]:
        try:
            return _planned(search, befores[number], at, above, name)
        except AttemptFailed as failed:
            furthest = failed
    assert furthest is not None
    raise furthest


def _planned(search: Search, before: np.ndarray, at: Pose, above: Pose, name: str) -> TaskMotions:
    scene, scale = search.scene, search.recipe.free_speed_scale
    down = search.line_motion(before, at, scale, scene, TOUCH)
    back = search.line_motion(down.positions[-1], above, scale, scene, BACK)
    free, clearance = search.free_motion(search.start, before, scale, scene, TO_POINT)
    empty = search.tool.tool.release.signals()
    made = PlanBuilder(search, scene)
    made.add(TO_POINT, free, False, empty, (), scene, clearance)
    made.add(TOUCH, down, True, empty, (), scene)
    made.add(BACK, back, True, empty, (), scene)
    return made.plan(name)


PROCESS = Process(
    moves=False,
    recipe=TouchRecipe,
    check_recipe=check_recipe,
    mass=lambda job, name, recipe, tool: job.element.mass,
    acts=TOUCH,
    plan=plan,
)


def recipes_file(folder: Path, **changes: object) -> Path:
    """Return a file with a recipe that touches, before those that place."""
    document = yaml.safe_load(RECIPES.read_text())
    document["recipes"] = {"probe": {**yaml.safe_load(json.dumps(RECIPE)), **changes}, **document["recipes"]}
    (folder / "recipes.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return folder / "recipes.yaml"


def known() -> Iterator[None]:
    """A fixture of a module, in which this process is known: other tests compare what is known with the documents."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(process.MODULES, NAME, "touch_process")
        yield
