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

from construction_twin.extensions.work import process
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
#: Length of the straight way down to a point, and back [m].
WAY = 0.1
#: The tool's z points down, its x along the base's.
_DOWN = np.diag([1.0, -1.0, -1.0])


class TouchRecipe(Recipe):
    """How elements are touched.

    Attributes:
        points: In the element's frame [m], the best first.
        gap: Between the point and where the tool's centre point turns [m].
    """

    points: Annotated[tuple[tuple[Finite, Finite, Finite], ...], pydantic.Field(min_length=1)]
    gap: Length = 0.03


def plan(search: Search) -> TaskMotions:
    """Plan for the first point, by the nearest pose above it from which the way down and back is free."""
    recipe, scene, job = search.recipe, search.scene, search.job
    point = recipe.points[0]
    there = job.base_T_goal.position + job.base_T_goal.rotation @ np.array(point)
    tcp_T_tool0 = inverse(pose_of(search.tool.tool.tool0_T_tcp))
    at, above = (
        product(Pose(there + np.array([0.0, 0.0, height]), _DOWN), tcp_T_tool0)
        for height in (recipe.gap, recipe.gap + WAY)
    )
    search.require_reach(at, "at the point")
    befores = search.solutions(above, search.start, scene, TO_POINT, "above the point")
    scale, empty = recipe.free_speed_scale, search.tool.tool.release.signals()
    failed = None
    for number in search.nearest(befores)[:PAIRS]:
        try:
            down = search.line_motion(befores[number], at, scale, scene, TOUCH)
            back = search.line_motion(down.positions[-1], above, scale, scene, BACK)
            free, clearance = search.free_motion(search.start, befores[number], scale, scene, TO_POINT)
        except AttemptFailed as error:
            failed = error
            continue
        made = PlanBuilder(search, scene)
        made.add(TO_POINT, free, False, empty, (), scene, clearance)
        made.add(TOUCH, down, True, empty, (), scene)
        made.add(BACK, back, True, empty, (), scene)
        return made.plan(f"point {' '.join(f'{1e3 * value:g}' for value in point)} mm")
    raise failed


PROCESS = Process(
    moves=False,
    recipe=TouchRecipe,
    check_recipe=lambda recipe, tool, where: None,
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
    """A fixture of a module: makes this process known."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(process.MODULES, NAME, "touch_process")
        yield
