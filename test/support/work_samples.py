"""A small work for tests: three bricks from a rack to a table, the KR 120 on its track; no IFC file is read."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from construction_twin.extensions.work.building import Body, BuildingModel, Element
from construction_twin.extensions.work.layout import Layout
from construction_twin.extensions.work.motions import BUDGET, TaskPlanner
from construction_twin.extensions.work.process import Recipes, WorkJob, read_recipes
from construction_twin.extensions.work.schedule import Job
from construction_twin.extensions.work.work_cell import WorkCell, read_work_cell
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, InverseKinematics, inverse_kinematics
from construction_twin.planning.planner import PlannerSettings
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.tool import ToolFile, read_tool
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.self_collision import SelfCollision, read_self_collision

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "config/tools/vacuum_frame.yaml"
RECIPES = ROOT / "config/work/recipes.yaml"
BRICK = (0.24, 0.115, 0.071)
_BOX = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])

SCENE = {
    "padding": 0.02,
    "objects": {
        "floor": {"shape": "box", "size": [20, 20, 1], "position": [0, 0, -0.5], "fixed": True},
        "table": {"shape": "box", "size": [2.0, 0.8, 0.6], "position": [0, 1.6, 0.3], "fixed": True},
        "rack": {"shape": "box", "size": [2.0, 0.8, 0.6], "position": [0, -1.6, 0.3], "fixed": True},
    },
}
CELL = {
    "tool": str(TOOL),
    "recipes": str(RECIPES),
    "scene": "scene.yaml",
    "model_T_base": {"xyz": [0.0, -1.6, -0.6]},
    "supports": ["table"],
    "racks": {
        "bricks": {
            "kind": "grid", "surface": "rack", "at": {"xyz": [-0.5, -1.5, 0.6]}, "rows": 1, "columns": 3, "pitch": [0.5, 0.2],
        }
    },
}  # fmt: skip


def box_pieces(element: Element) -> tuple[SceneObject, ...]:
    """Return an element's bounding boxes, one for each of its bodies, as scene objects ``<GlobalId>/<number>`` in its frame."""
    pieces = []
    for number, body in enumerate(element.bodies):
        low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
        x, y, z = (float(value) for value in high - low)
        mx, my, mz = (float(value) for value in 0.5 * (high + low))
        pieces.append(SceneObject(f"{element.id}/{number}", "box", (x, y, z), (mx, my, mz)))
    return tuple(pieces)


def element(
    name: str,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    size: tuple[float, float, float] = BRICK,
    properties: Mapping | None = None,
    mass: float | None = 3.5,
    ifc_class: str = "IfcBuildingElementPart",
    type_name: str = "NF 240x115x71",
) -> Element:
    """Return a box whose frame is in the middle of its underside."""
    body = Body(_BOX * size, np.empty((0, 3), dtype=int))
    pose = Pose(np.array(position), np.eye(3))
    return Element(name, ifc_class, name, type_name, "", "", pose, (body,), properties or {}, mass)


def building(*elements: Element) -> BuildingModel:
    """Return a model of elements; without any: three bricks in a row, 10 mm apart."""
    found = elements or tuple(element(f"brick{number}", (0.25 * number, 0.0, 0.0)) for number in range(3))
    return BuildingModel("sample.ifc", "0" * 64, "sample", {one.id: one for one in found})


def work_cell(folder: Path, cell: Mapping | None = None, scene: Mapping | None = None) -> WorkCell:
    """Write a cell into a folder and read it."""
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene or SCENE))
    (folder / "cell.yaml").write_text(yaml.safe_dump({**CELL, **(cell or {})}))
    return read_work_cell(folder / "cell.yaml")


def layout(at: WorkCell, model: BuildingModel, jobs: Sequence[Job] = ()) -> Layout:
    """Return the layout of a model's elements, boxes all, in the order of the file."""
    pieces = {one.id: box_pieces(one) for one in model.elements.values()}
    return Layout(at, model, pieces, list(model.elements), robot().tip_link, jobs=jobs)


@cache
def robot() -> RobotModel:
    """The KR 120 on its track."""
    return read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml")


@cache
def pairs() -> SelfCollision:
    """Its pairs of links that are not checked."""
    return read_self_collision(ROOT / "config/kr120_track_self_collision.yaml", robot())


@cache
def tool() -> ToolFile:
    """The tool of the samples."""
    return read_tool(TOOL)


@cache
def recipes() -> Recipes:
    """The recipes of the samples."""
    return read_recipes(RECIPES)


def brick_recipe(part: str = "", **changes: object) -> Recipes:
    """Return the sample's recipe for bricks alone, with changed keys, of a part (`grips`, `stock`, `place`) or its own."""
    chosen = recipes().recipes["brick"]
    if part:
        changes = {part: getattr(chosen, part).model_copy(update=changes)}
    return replace(recipes(), recipes={"brick": chosen.model_copy(update=changes)})


def solver(of: RobotModel | None = None) -> InverseKinematics:
    """Return an inverse kinematics."""
    return inverse_kinematics(Chain(of or robot()), IkSettings(), np.random.default_rng(0), time.monotonic)


def planner(
    with_recipes: Recipes | None = None,
    with_tool: ToolFile | None = None,
    of: RobotModel | None = None,
    budget: float = BUDGET,
) -> TaskPlanner:
    """Return a planner with a seed."""
    values = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
    settings = PlannerSettings(**{name: values[name] for name in PlannerSettings.model_fields} | {"seed": 1})
    return TaskPlanner(
        of or robot(), solver(of), settings, pairs(), with_tool or tool(), with_recipes or recipes(), time.process_time,
        budget,
    )  # fmt: skip


def job(one: Element, **changes: object) -> WorkJob:
    """Return the job of an element whose stock is its place."""
    here = one.model_T_element
    made = WorkJob("task", one, bodies=box_pieces(one), base_T_stock=here, base_T_goal=here)
    return replace(made, **changes)
