"""A mistyped key of any YAML file that people write is named, wherever it stands, whether the right key is missing or not."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from scene_samples import kr120

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.work.process import read_recipes
from construction_twin.extensions.work.work_cell import read_work_cell
from construction_twin.robot.description import load_robot
from construction_twin.robot.tool import read_tool
from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.commands.experiment import ExperimentSettings
from construction_twin.scenario.definition import make_scenario
from construction_twin.scene.neighbour import load_cell
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision

CONFIG = Path(__file__).resolve().parents[3] / "config"
#: Keys that are names which the writer gives: another name is another thing, not a mistake.
NAMES = ("objects", "shapes", "racks", "recipes", "materials")
#: A file whose uppermost keys are such names: of robots.
NAMED_AT_THE_TOP = "cell_two_robots.yaml"
URDF = expand_xacro(str(CONFIG.parent / "urdf" / "kr120r2500.urdf.xacro"), {})
Place = tuple[str | int, ...]


def places(value: object, above: Place = ()) -> Iterator[Place]:
    """Every key of a document, from the top; of a list the first entry counts for all."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not above or above[-1] not in NAMES:
                yield (*above, key)
            yield from places(inner, (*above, key))
    elif isinstance(value, list) and value:
        yield from places(value[0], (*above, 0))


def mistyped(document: dict, place: Place, keep: bool) -> tuple[dict, str]:
    """Return the document with another last letter in a key, and that key; the right one may stay beside it."""
    changed = copy.deepcopy(document)
    around = changed
    for step in place[:-1]:
        around = around[step]
    key = str(place[-1])
    wrong = key[:-1] + "q" if len(key) > 1 else key + "q"
    around[wrong] = around[key] if keep else around.pop(key)
    return changed, wrong


def robot_yaml(path: Path) -> None:
    load_robot(URDF, yaml.safe_load(path.read_text()) | {"name": "kr120"})


def experiment(path: Path) -> None:
    ExperimentSettings.read(yaml.safe_load(path.read_text()) | {"results_dir": "/"}, str(path))


READERS: dict[str, Callable[[Path], object]] = {
    "kr120.yaml": robot_yaml,
    "kr120_self_collision.yaml": lambda path: read_self_collision(str(path), kr120()),
    "scene.yaml": lambda path: read_scene(str(path)),
    "work/timber_panel_scene.yaml": lambda path: read_scene(str(path)),
    "cell_two_robots.yaml": lambda path: load_cell(yaml.safe_load(path.read_text())),
    "tools/vacuum_frame.yaml": lambda path: read_tool(str(path)),
    "work/timber_panel.yaml": lambda path: read_work_cell(str(path)),
    "work/brick_wall.yaml": lambda path: read_work_cell(str(path)),
    "work/recipes.yaml": lambda path: read_recipes(str(path)),
    "experiment.yaml": experiment,
    "scenarios/stall_replan.yaml": lambda path: make_scenario("test", yaml.safe_load(path.read_text()).get("scenario")),
}


@pytest.mark.parametrize("name", READERS)
def test_a_mistyped_key_of_a_file_is_named(name, tmp_path):
    folder = shutil.copytree(CONFIG, tmp_path / "config")
    file = folder / name
    document = yaml.safe_load(file.read_text())
    inside = document.get("scenario") and ("scenario",)
    for place in places(document):
        if inside and (place[0] != "scenario" or place == inside):
            continue  # what else is in a scenario belongs to the nodes
        if name == NAMED_AT_THE_TOP and len(place) == 1:
            continue
        for keep in (False, True):
            changed, wrong = mistyped(document, place, keep)
            file.write_text(yaml.safe_dump(changed, sort_keys=False))
            with pytest.raises(ConstructionTwinError) as refusal:
                READERS[name](file)
                pytest.fail(f"{place} as {wrong} was taken")
            assert wrong in str(refusal.value), place
