"""Recipes: which one is chosen, which keys and masses are refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import yaml
from work_samples import RECIPES, element, job, recipes, tool

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.place.grips import PlaceRecipe, mass_of
from construction_twin.extensions.work.process import PROPERTY_SET, TaskPlanningError, read_recipes


@dataclass(frozen=True)
class Chosen:
    name: str
    recipe: PlaceRecipe
    mass: float


def find_task(of, among=None, with_tool=None):
    name, recipe = (among or recipes()).of(of)
    return Chosen(name, recipe, mass_of(of, name, recipe, with_tool or tool().tool))


def choose(**changes):
    own = changes.pop("own", {})
    return find_task(job(element("b", properties={PROPERTY_SET: own} if own else {}, **changes)))


def test_the_first_recipe_that_fits_is_chosen():
    assert choose().name == "brick"
    assert choose(ifc_class="IfcMember").name == "timber"
    assert choose(ifc_class="IfcPlate", type_name="240x115x71").name == "board"


def test_an_element_that_no_recipe_fits_is_refused_with_its_name_and_class():
    with pytest.raises(TaskPlanningError, match="fits .*, IfcWall 'odd'; add one"):
        choose(ifc_class="IfcWall", type_name="odd")


def test_the_model_chooses_a_recipe_by_name():
    assert choose(own={"Recipe": "board"}).name == "board"
    with pytest.raises(TaskPlanningError, match=r"CTwin_RobotTask.Recipe: found 'wood', expected one of timber, board"):
        choose(own={"Recipe": "wood"})


def test_any_other_property_of_the_models_own_set_is_refused_by_name():
    with pytest.raises(TaskPlanningError, match=r"CTwin_RobotTask.MinCups: found 2, expected no property but Recipe"):
        choose(own={"MinCups": 2, "id": 7})
    task = replace(job(element("b")), task_properties={"Recipe": "brick", "Speed": 0.1})
    with pytest.raises(TaskPlanningError, match=r"CTwin_RobotTask.Speed: found 0.1"):
        find_task(task)


def test_masses_unknown_or_too_large_are_refused():
    with pytest.raises(TaskPlanningError, match="is not known: give it a weight or a density"):
        choose(mass=None)
    with pytest.raises(TaskPlanningError, match=r"has 61\.0 kg; tool .* carries at most 60 kg"):
        choose(mass=61.0)
    with pytest.raises(TaskPlanningError, match="has a mass of 0 kg; expected above 0"):
        choose(mass=0.0)
    assert choose(mass=60.0).mass == 60.0


def test_tool_and_element_together_must_stay_within_the_load():
    small = tool().tool.model_copy(update={"load": 20.0})
    with pytest.raises(TaskPlanningError, match=r"together have 21\.5 kg; .* load data are for 20 kg"):
        find_task(job(element("b")), with_tool=small)


def test_a_recipes_own_mass_is_used_where_the_model_has_none(tmp_path):
    document = yaml.safe_load(RECIPES.read_text())
    document["recipes"]["brick"]["mass"] = 5.0
    (tmp_path / "r.yaml").write_text(yaml.safe_dump(document))
    found = read_recipes(tmp_path / "r.yaml")
    assert find_task(job(element("b", mass=None)), found).mass == 5.0
    assert find_task(job(element("b", mass=3.0)), found).mass == 3.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"sped": 1.0}, "no such key; did you mean speed"),
        ({"speed": 0.0}, "speed.*greater than 0"),
        ({"grips": {"touching": []}}, "touching"),
        ({"place": {"lengths": []}}, "lengths"),
        ({"place": {"arrive": [[0.0, 0.0, 0.0]]}}, "a vector that is not zero"),
    ],
)
def test_a_wrong_key_of_the_file_is_named(tmp_path, change, sentence):
    document = yaml.safe_load(RECIPES.read_text())
    document["recipes"]["brick"].update(change)
    (tmp_path / "r.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(ConfigurationError, match=sentence):
        read_recipes(tmp_path / "r.yaml")
