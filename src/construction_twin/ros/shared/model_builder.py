"""The process that builds models for nodes with a cycle to keep: to compile a scene with many meshes takes longer than a cycle.

``python -m construction_twin.ros.shared.model_builder`` is started by the node (`work.worker.Worker`), and ends when that does. It
speaks no ROS. It runs behind everything else, although the node that starts it has a real-time priority.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from construction_twin.core.realtime import release_realtime
from construction_twin.robot.description import RobotModel
from construction_twin.scene.objects import Scene
from construction_twin.work.worker import Worker, serve_parent

if TYPE_CHECKING:
    from construction_twin.physics.model import PhysicsModel


class ModelBuilder:
    """The process, as the node sees it.

    Args:
        drives: YAML file, absolute path; empty: what the URDF says.
        payload: At the flange at all times, see `payload_of`.
    """

    def __init__(self, robot: RobotModel, drives: str, payload: tuple[float, ...] = ()):
        self._worker = Worker((sys.executable, "-m", __name__))
        self._arm = {"robot": robot, "drives": drives, "payload": payload}

    def build(self, scene: Scene, masses: Mapping[str, float], self_collision: str) -> PhysicsModel:
        """Return the model of the arm in a scene; raises WorkerError with the sentence of what went wrong there.

        Args:
            masses: Of bodies that the arm carries, see `physics.known_mass` [kg].
            self_collision: YAML of the link pairs that are not checked, absolute path.
        """
        return self._worker.ask("build", **self._arm, scene=scene, masses=dict(masses), self_collision=self_collision)

    def close(self) -> None:
        """End the process."""
        self._worker.close()


def main() -> None:
    """Serve the node."""
    from construction_twin.physics.drive import drives_of, read_drives
    from construction_twin.physics.known_mass import masses_of
    from construction_twin.physics.mass import payload_of
    from construction_twin.physics.model import Load, build_model
    from construction_twin.scene.collision_bodies import RobotBodies
    from construction_twin.scene.self_collision import read_self_collision

    read: dict[str, RobotBodies] = {}

    def build(
        robot: RobotModel,
        drives: str,
        payload: tuple[float, ...],
        scene: Scene,
        masses: Mapping[str, float],
        self_collision: str,
    ) -> PhysicsModel:
        # it is always the same arm; its meshes are read once
        bodies = read.get(robot.name) or read.setdefault(robot.name, RobotBodies(robot))
        known = read_drives(drives, robot) if drives else drives_of(robot)
        load = Load(masses_of(masses, (scene,), bodies), flange=payload_of(payload, "payload"))
        return build_model(bodies, scene, read_self_collision(self_collision, robot), known, load)

    release_realtime()
    serve_parent({"build": build})


if __name__ == "__main__":
    main()
