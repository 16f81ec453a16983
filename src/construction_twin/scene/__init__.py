"""What the arm must not touch: objects, carried objects, the arm's own body, and another arm.

In: the scene's YAML and edits, a robot description, joint positions. Out: contacts, clearances, bounds of distances along a
motion, and the version (hash) of a scene. May import ``core``, ``robot`` and ``kinematics``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.scene.cell import Cell as Cell
    from construction_twin.scene.cell import load_cell as load_cell
    from construction_twin.scene.collision_bodies import RobotBodies as RobotBodies
    from construction_twin.scene.collision_world import CollisionWorld as CollisionWorld
    from construction_twin.scene.collision_world import Contact as Contact
    from construction_twin.scene.collision_world import PairDistance as PairDistance
    from construction_twin.scene.edits import SceneFile as SceneFile
    from construction_twin.scene.home import Home as Home
    from construction_twin.scene.home import find_home as find_home
    from construction_twin.scene.mesh_file import parse_mesh as parse_mesh
    from construction_twin.scene.neighbour import Neighbour as Neighbour
    from construction_twin.scene.neighbour import Obstacle as Obstacle
    from construction_twin.scene.neighbour import PathCopy as PathCopy
    from construction_twin.scene.objects import Scene as Scene
    from construction_twin.scene.objects import SceneObject as SceneObject
    from construction_twin.scene.objects import product as product
    from construction_twin.scene.objects import relative as relative
    from construction_twin.scene.planner_scene import PlannerObject as PlannerObject
    from construction_twin.scene.planner_scene import PlannerScene as PlannerScene
    from construction_twin.scene.planner_scene import scene_text as scene_text
    from construction_twin.scene.scene_change import SceneChange as SceneChange
    from construction_twin.scene.scene_yaml import load_scene as load_scene
    from construction_twin.scene.scene_yaml import read_scene as read_scene
    from construction_twin.scene.self_collision import SelfCollision as SelfCollision
    from construction_twin.scene.self_collision import read_self_collision as read_self_collision
    from construction_twin.scene.self_collision import sample_self_collision as sample_self_collision
    from construction_twin.scene.self_collision import self_collision_yaml as self_collision_yaml
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)
