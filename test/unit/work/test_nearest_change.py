"""What would let a task be planned that cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sentence_checks import because, has_parts
from work_samples import building, element, layout, planner, recipes, robot, site

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import TaskPlanningError
from construction_twin.work.motions import TaskLimits
from construction_twin.work.nearest_change import longer_track, nearest_change
from construction_twin.work.place.changes import RISES, other_directions
from construction_twin.work.place.phases import direction
from construction_twin.work.site_scene import WorkState

HOME = np.array(robot().home)


#: So that a test does not wait long for what does not help.
SHORT = TaskLimits(budget=0.5, solutions=4, pairs=2, free_budget=1.0)


def failed(found, element_id, state=WorkState(), **changes):
    """Return what failed: job, scene and why."""
    scene = found.scene(state)
    job = replace(found.job_for(element_id, scene), **changes)
    with pytest.raises(TaskPlanningError) as caught:
        planner(limits=SHORT).plan(job, HOME, scene)
    return job, scene, caught.value


def change_for(job, scene, failure, placed=None, longer=(), going_on=lambda: True, before=()):
    return nearest_change(job, HOME, scene, planner(limits=SHORT), placed or {}, longer, going_on, failure, before)


def test_another_grip_is_named_with_its_key(tmp_path):
    found = layout(site(tmp_path), building(element("b", (0, 0, 0))))
    brick = recipes().recipes["brick"]
    slanting = brick.grips.model_copy(update={"yaws_deg": (45.0,)})
    odd = replace(recipes(), recipes={"brick": brick.model_copy(update={"grips": slanting})})
    scene = found.scene()
    job = found.job_for("b", scene)
    with pytest.raises(TaskPlanningError, match="3 are needed"):
        planner(odd, limits=SHORT).plan(job, HOME, scene)
    change = nearest_change(job, HOME, scene, planner(odd, limits=SHORT), {})
    assert (
        change.kind == "grip"
        and change.sentence.key == "work.change.grip"
        and change.sentence.values["key"] == "yaws_deg"
    )


def test_a_neighbour_that_came_too_early_is_named(tmp_path):
    model = building(
        element("low", (0, 0, 0)), element("high", (0, 0.13, 0), (0.6, 0.115, 0.4), type_name="240x115x71 x")
    )
    rack = {
        "kind": "list",
        "surface": "rack",
        "at": {"xyz": [0, -1.5, 0.6]},
        "slots": [{"xyz": [x, 0, 0]} for x in (-0.5, 0.5)],
    }
    found = layout(site(tmp_path, {"racks": {"r": rack}}), model)
    job, scene, why = failed(found, "low", WorkState({"high": found.base_T_goal("high")}))
    change = change_for(job, scene, why, {"high": "the high one"})
    assert change.kind == "order" and change.sentence == Sentence("work.change.order", element="'the high one'")
    waits = change_for(job, scene, why, {"high": "the high one"}, before={"high"})
    assert waits is None or waits.kind != "order"


def beside_the_table(tmp_path, properties=None):
    """Return job, scene, recipes and why a brick cannot come from the side: all the way it is within the padding of the floor."""
    objects = {
        "padding": 0.02,
        "objects": {
            "ground": {"shape": "box", "size": [2.0, 0.8, 0.6], "position": [0, 1.6, 0.29]},
            "rack": {"shape": "box", "size": [2.0, 0.8, 0.6], "position": [0, -1.6, 0.3]},
        },
    }
    found = layout(
        site(tmp_path, {"supports": ["ground"]}, objects), building(element("b", properties=properties or {}))
    )
    brick = recipes().recipes["brick"]
    place = brick.place.model_copy(update={"arrive": ("-y",)})
    sideways = replace(recipes(), recipes={"brick": brick.model_copy(update={"place": place})})
    scene = found.scene()
    job = found.job_for("b", scene)
    with pytest.raises(TaskPlanningError, check=because("work.cannot.would_touch", second="ground")) as caught:
        planner(sideways, limits=SHORT).plan(job, HOME, scene)
    return job, scene, sideways, caught.value


def test_what_cannot_come_from_the_side_comes_from_a_little_above(tmp_path):
    job, scene, sideways, why = beside_the_table(tmp_path)
    assert why.stage == "set down"
    change = nearest_change(job, HOME, scene, planner(sideways, limits=SHORT), {}, failure=why)
    assert change.kind == "direction"
    assert has_parts(change.sentence, "work.change.set_down", "[0, -1, 0.5]", "place/arrive", "'brick'")
    # what it says helps
    place = sideways.recipes["brick"].place.model_copy(update={"arrive": ((0.0, -1.0, 0.5),)})
    said = replace(sideways, recipes={"brick": sideways.recipes["brick"].model_copy(update={"place": place})})
    assert planner(said, limits=SHORT).plan(job, HOME, scene).segments


@pytest.mark.parametrize("given", [("-z",), ((0.0, 0.0, -2.0),), ("-z", "+x", (0.001, -0.001, -1.0))])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_comes_from_below_is_not_raised_to_no_direction_at_all(given):
    pose = element("b").model_T_element
    found = list(other_directions(given, pose))
    assert 1.0 in RISES and found and all(np.isfinite(direction(one, pose)).all() for one in found)


def test_a_vector_without_a_length_is_no_direction():
    with pytest.raises(ConfigurationError, match="expected a vector that is not zero"):
        direction((0.0, 0.0, 0.0), element("b").model_T_element)


def test_a_property_that_would_override_the_advice_is_named(tmp_path):
    job, scene, sideways, why = beside_the_table(tmp_path, {"CTwin_RobotTask": {"Arrive": "-y"}})
    change = nearest_change(job, HOME, scene, planner(sideways, limits=SHORT), {}, failure=why)
    assert change.kind == "direction" and has_parts(change.sentence, "work.change.and_take", "CTwin_RobotTask.Arrive")


class OnlyWithout:
    """A planner that finds a way only where an element is not in the scene."""

    def __init__(self, element):
        self.element, self.recipes = element, recipes()

    def with_recipes(self, _):
        return self

    def plan(self, job, start, scene):
        if f"{self.element}/0" in scene.names:
            raise TaskPlanningError(job.task, "in the way")


@pytest.mark.parametrize(("way", "kind"), [("floor1", None), ("floor2", None), ("beside", "order")])
def test_what_an_element_rests_on_is_never_advised_to_come_later(tmp_path, way, kind):
    model = building(
        element("floor1"),
        element("floor2", (0, 0, 0.071)),
        element("top", (0, 0, 0.142)),
        element("beside", (0.3, 0, 0)),
    )
    rack = {
        "bricks": {
            "kind": "grid",
            "surface": "rack",
            "at": {"xyz": [-0.5, -1.5, 0.6]},
            "rows": 2,
            "columns": 2,
            "pitch": [0.5, 0.2],
        }
    }
    found = layout(site(tmp_path, {"racks": rack}), model)
    placed = {name: found.base_T_goal(name) for name in ("floor1", "floor2", "beside")}
    scene = found.scene(WorkState(placed))
    change = nearest_change(
        found.job_for("top", scene), HOME, scene, OnlyWithout(way), dict.fromkeys(placed, "it"), failure=None
    )
    assert (change and change.kind) == kind


def test_a_work_that_is_too_far_away_comes_nearer(tmp_path):
    objects = {
        "padding": 0.02,
        "objects": {
            "table": {"shape": "box", "size": [2.0, 0.8, 0.6], "position": [0, 2.55, 0.3]},
            "rack": {"shape": "box", "size": [2.0, 0.8, 0.6], "position": [0, -1.6, 0.3]},
        },
    }
    found = layout(site(tmp_path, {"model_T_base": {"xyz": [0.0, -2.7, -0.6]}}, objects), building(element("b")))
    job, scene, why = failed(found, "b")
    change = change_for(job, scene, why)
    assert change.kind == "base" and has_parts(change.sentence, "work.change.shifted", "-y")


def test_a_longer_track_helps_where_the_work_is_beyond_its_end(tmp_path):
    found = layout(
        site(tmp_path, {"model_T_base": {"xyz": [-3.9, -1.2, -0.6]}, "supports": []}),
        building(element("b", properties={"CTwin_RobotTask": {"Fastened": True}})),
    )
    job, scene, why = failed(found, "b")
    assert why.stage == "reach"
    longer = [(by, lambda by=by: planner(of=longer_track(robot(), by), limits=SHORT)) for by in (0.2, 2.0)]
    change = change_for(job, scene, why, longer=longer)
    assert change.kind == "track" and change.sentence == Sentence("work.change.track", by=2.0)
    stops = iter([True, True])
    assert change_for(job, scene, why, longer=longer, going_on=lambda: next(stops, False)) is None


def test_only_a_linear_joint_becomes_longer():
    longer = longer_track(robot(), 0.5)
    assert longer.lower[0] == robot().lower[0] - 0.5 and longer.upper[0] == robot().upper[0] + 0.5
    assert longer.lower[1:] == robot().lower[1:]
    assert longer_track(replace(robot(), linear=(False,) * 7), 0.5) is None
