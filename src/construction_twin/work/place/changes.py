"""What of its recipe may let an element be placed that cannot be: another grip, or another side that it comes from.

Nothing is changed anywhere; see `nearest_change`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial

from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.objects import Scene
from construction_twin.work.jobs import WorkJob
from construction_twin.work.nearest_change import Candidate, Change
from construction_twin.work.place.phases import direction
from construction_twin.work.place.recipe import OVERRIDES, Direction, PlaceRecipe
from construction_twin.work.place.stages import LIFT, SET_DOWN
from construction_twin.work.recipe import PROPERTY_SET
from construction_twin.work.recipes import Recipes
from construction_twin.work.task_planner import TaskPlanner

#: By how much the directions of a recipe are raised, as unit vectors.
RISES = (0.5, 1.0)
#: Directions that point down by more than this are not tried.
_FROM_BELOW = 0.1
_YAWS_DEG = (0.0, 90.0, 180.0, 270.0)


def changes(job: WorkJob, scene: Scene, planner: TaskPlanner, stage: str) -> Iterator[Candidate]:
    """Yield what may help: other directions where the way from the stock or to the place was not possible, then other grips."""
    yield from _other_directions(job, scene, planner, stage)
    yield from _other_grips(job, scene, planner)


def _other_grips(job: WorkJob, scene: Scene, planner: TaskPlanner) -> Iterator[Candidate]:
    recipes = planner.recipes
    for words, key, update in (
        (Sentence("work.change.quarter_turns"), "yaws_deg", {"yaws_deg": _YAWS_DEG}),
        (Sentence("work.change.faces"), "faces", {"yaws_deg": _YAWS_DEG, "faces": ("up", "any")}),
        (
            Sentence("work.change.places"),
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
            if isinstance(recipe, PlaceRecipe)
            else recipe
            for name, recipe in recipes.recipes.items()
        }
        sentence = Sentence("work.change.grip", words=words, key=key, set=PROPERTY_SET)
        other = Recipes(recipes.file, wider)
        asked = _without_overrides(job, [("grips", name) for name in update])
        yield Candidate(Change("grip", sentence), asked, scene, partial(planner.with_recipes, other))


def _without_overrides(job: WorkJob, keys: Collection[tuple[str, ...]]) -> WorkJob:
    """Return a job whose element does not override keys of its recipe: what is tried is then what is planned with."""
    own = job.properties.get(PROPERTY_SET, {})
    left = {name: value for name, value in own.items() if name not in OVERRIDES or OVERRIDES[name].key not in keys}
    return job if len(left) == len(own) else replace(job, properties={**job.properties, PROPERTY_SET: left})


def _other_directions(job: WorkJob, scene: Scene, planner: TaskPlanner, stage: str) -> Iterator[Candidate]:
    """Yield other sides from which it is set down, or to which it is lifted off the stock, where that was not possible."""
    if stage not in (LIFT, SET_DOWN):
        return
    part, key, change, pose = (
        ("stock", "leave", "work.change.lift", job.base_T_stock)
        if stage == LIFT
        else ("place", "arrive", "work.change.set_down", job.base_T_goal)
    )
    assert pose is not None
    recipes = planner.recipes
    name, recipe = recipes.of(job)
    part_of = getattr(recipe, part)
    asked = _without_overrides(job, [(part, key)])
    for other in other_directions(getattr(part_of, key), pose):
        changed = recipe.model_copy(update={part: part_of.model_copy(update={key: (other,)})})
        sentence = Sentence(change, direction=_shown(other), key=f"{part}/{key}", recipe=repr(name))
        if asked.properties != job.properties:
            overrides = f"{PROPERTY_SET}.{key.capitalize()}"
            sentence = Sentence("work.change.and_take", change=sentence, name=overrides)
        with_it = Recipes(recipes.file, {**recipes.recipes, name: changed})
        yield Candidate(Change("direction", sentence), asked, scene, partial(planner.with_recipes, with_it))


def _shown(way: Direction) -> Sentence:
    if isinstance(way, tuple):
        return Sentence("work.change.seen_from_base", direction=f"[{', '.join(f'{value:g}' for value in way)}]")
    return Sentence("work.change.above" if way == "up" else "work.change.of_element", direction=way)


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
