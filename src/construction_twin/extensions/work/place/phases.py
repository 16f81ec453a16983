"""The scenes of one task, and where the flange is at the ends of its straight ways. Metres; poses in the base_link.

Each scene allows exactly the contacts that its straight way needs, see `contacts`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from construction_twin.extensions.work.contacts import Shapes, straight
from construction_twin.extensions.work.place.grips import AXES, Grip
from construction_twin.extensions.work.place.recipe import Direction, PlaceRecipe
from construction_twin.extensions.work.process import WorkJob
from construction_twin.extensions.work.site import inverse, pose_of
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.tool import ToolFile
from construction_twin.scene.objects import TOOL, Scene, SceneObject, product, tool_objects
from construction_twin.scene.scene_change import SceneChange


@dataclass(frozen=True, eq=False)
class Ways:
    """``base_T_tool0`` at the ends of the straight ways of one task.

    Attributes:
        lifted, above: Ends of the free way with the element.
    """

    before: Pose
    stock: Pose
    lifted: Pose
    above: Pose
    goal: Pose
    after: Pose
    tool0_T_element: Pose


@dataclass(frozen=True, eq=False)
class Scenes:
    """The scene of each part of a task."""

    fetch: Scene
    approach: Scene
    lift: Scene
    carry: Scene
    set_down: Scene
    retreat: Scene
    done: Scene


def ways(job: WorkJob, grip: Grip, recipe: PlaceRecipe, tool: ToolFile, leave: np.ndarray, arrive: np.ndarray) -> Ways:
    """Return where the flange goes; `leave`, `arrive`: the element's straight ways, shape (3,)."""
    assert job.base_T_stock is not None
    tcp_T_tool0 = inverse(pose_of(tool.tool.tool0_T_tcp))
    turned_T_tcp = product(inverse(grip.element_T_turned), grip.element_T_tcp)
    base_T_stock_tcp = product(job.base_T_stock, grip.element_T_tcp)
    base_T_goal_tcp = product(job.base_T_goal, turned_T_tcp)
    stock, goal = product(base_T_stock_tcp, tcp_T_tool0), product(base_T_goal_tcp, tcp_T_tool0)
    # the tool's z points into the face
    out, away = -base_T_stock_tcp.rotation[:, 2], -base_T_goal_tcp.rotation[:, 2]
    return Ways(
        _moved(stock, recipe.stock.approach * out),
        stock,
        _moved(stock, leave),
        _moved(goal, arrive),
        goal,
        _moved(goal, recipe.place.retreat * away),
        product(inverse(tcp_T_tool0), inverse(turned_T_tcp)),
    )


def direction(asked: Direction, base_T_element: Pose) -> np.ndarray:
    """Return a direction of a recipe as a unit vector in the base_link."""
    if asked == "up":
        return np.array([0.0, 0.0, 1.0])
    if isinstance(asked, str):
        return base_T_element.rotation @ np.array(AXES[asked], dtype=float)
    return np.array(asked) / np.linalg.norm(asked)


def scenes(
    scene: Scene, job: WorkJob, recipe: PlaceRecipe, tool: ToolFile, link: str, at: Ways, shapes: Shapes
) -> Scenes:
    """Return the scene of each part of a task; `scene`: the present one."""
    bare = tool_objects(tool, link)
    own = {item.name for item in job.bodies}
    supports = [item for item in scene.objects if item.name in job.supports and item.name not in own and not item.link]
    held = [item.moved(product(at.tool0_T_element, item.pose)) for item in job.bodies]
    beside = [item for item in bare if item.name.removeprefix(TOOL) in recipe.grips.beside]

    def near(moving: Sequence[SceneObject], *ends: Pose) -> tuple[str, ...]:
        places = [pose for start, end in zip(ends, ends[1:]) for pose in straight(start, end)]
        return shapes.near(moving, places, supports, scene.padding) if moving else ()

    stock_tool, stock_held = near(beside, at.before, at.stock, at.lifted), near(held, at.stock, at.lifted)
    goal_tool, goal_held = near(beside, at.above, at.goal, at.after), near(held, at.above, at.goal)

    def tools(beside_names: Iterable[str], gripping: bool) -> list[SceneObject]:
        items = []
        for item in bare:
            shape, names = item.name.removeprefix(TOOL), []
            if gripping and shape in recipe.grips.touching:
                names += sorted(own)
            if shape in recipe.grips.beside:
                names += list(beside_names)
            items.append(replace(item, touch=(*item.touch, *names)))
        return items

    def carried(names: Iterable[str]) -> list[SceneObject]:
        return [body.moved(item.pose, link, names) for body, item in zip(job.bodies, held)]

    placed = [item.moved(product(job.base_T_goal, item.pose)) for item in job.bodies]
    after = (
        tools(stock_tool, True),
        [*tools(stock_tool, False), *carried(stock_held)],
        [*bare, *carried(())],
        [*tools(goal_tool, False), *carried(goal_held)],
        [*tools(goal_tool, True), *placed],
        [*bare, *placed],
    )
    return Scenes(scene, *(SceneChange(tuple(items)).apply(scene) for items in after))


def _moved(pose: Pose, by: np.ndarray) -> Pose:
    return Pose(pose.position + by, pose.rotation)
