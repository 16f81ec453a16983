"""Joint values for a pose that is dragged, and how close the arm is to something: what a console asks for between plans.

The robot's geometry is read at the first question, and what computes with it is imported then: most starts have no console, and the
node that shows the state of everything must not come up later for it. For one thread at a time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel
from construction_twin.scene.objects import Scene

if TYPE_CHECKING:
    from construction_twin.kinematics.solution import InverseKinematics
    from construction_twin.robot.plan import Clearance
    from construction_twin.scene.collision_world import CollisionWorld
    from construction_twin.views.reachability import PoseVerdict

#: Time for one pose, of an arm that is solved by search [s].
BUDGET = 0.03


class PoseJudge:
    """Knows the robot in its scene.

    Args:
        self_collision: YAML of the link pairs that are not checked; empty: nothing can be judged.
        scene: Returns the present scene, None while it is not known.
    """

    def __init__(self, robot: RobotModel, self_collision: str, scene: Callable[[], Scene | None]):
        self._robot, self._path, self._scene = robot, self_collision, scene
        self._solver: InverseKinematics | None = None
        self._world: CollisionWorld | None = None

    def judge(self, position: Sequence[float], rotation: np.ndarray, seed: Sequence[float]) -> PoseVerdict:
        """Return whether a pose of the tool can be reached, and with which joint values, nearest to a seed.

        Args:
            position: In the base_link [m].
            rotation: Shape (3, 3)
            seed: [rad], [m]; brought into the joints' ranges.

        Raises:
            ConfigurationError, SceneError: When robot or scene cannot be used, or the scene is not known yet.
        """
        from construction_twin.kinematics.chain import Chain, Pose
        from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
        from construction_twin.views.reachability import judge_pose

        world = self._present_world()
        if self._solver is None:
            settings = IkSettings(budget_s=BUDGET)
            self._solver = inverse_kinematics(Chain(self._robot), settings, np.random.default_rng(0), time.monotonic)
        near = np.clip(seed, self._robot.lower, self._robot.upper)
        return judge_pose(Pose(np.array(position, dtype=float), rotation), near.tolist(), self._solver, world)

    def closest(self, q: Sequence[float]) -> Clearance | None:
        """Return the two bodies that are closest at a pose, of those whose distance some joint changes; None where nothing is
        checked or no scene known; raises as `judge`.
        """
        if not self._path or self._scene() is None:
            return None
        clearance = self._present_world().clearance(list(q), changing=True)
        return clearance if clearance.between else None

    def _present_world(self) -> CollisionWorld:
        scene = self._scene()
        if not self._path:
            raise ConfigurationError("self_collision", "", "the YAML of the link pairs that are not checked")
        if scene is None:
            raise ConfigurationError("scene", None, "a scene; see why the scene node is down")
        if self._world is None:
            from construction_twin.scene.collision_world import CollisionWorld
            from construction_twin.scene.self_collision import read_self_collision

            self._world = CollisionWorld(self._robot, scene, read_self_collision(self._path, self._robot))
        elif self._world.scene is not scene:
            self._world = self._world.with_scene(scene)
        return self._world
