"""The arm alone, with mass, in empty space: what the mock controller moves. SI.

Joints in the order of ``robot.joint_names``. It touches nothing: a collision is a torque that somebody says.
"""

from __future__ import annotations

import numpy as np

from construction_twin.physics.arm import Servo, SimulatedArm
from construction_twin.physics.drive import ArmDrives
from construction_twin.physics.mass import MassProperties
from construction_twin.physics.model import Load, PhysicsModel, build_model
from construction_twin.robot.description import JointValues
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision


def bare_model(bodies: RobotBodies, drives: ArmDrives, flange: MassProperties | None = None) -> PhysicsModel:
    """Return the model of an arm with nothing around it.

    Args:
        flange: A payload in the frame of the tip link; None: none.
    """
    return build_model(bodies, Scene(), SelfCollision({}, ""), drives, Load(flange=flange), contacts=False)


class Plant:
    """An arm that is told setpoints, and can be pushed.

    Args:
        omega, zeta: Of the servo's lag [rad/s], [1].
    """

    def __init__(self, model: PhysicsModel, omega: float, zeta: float):
        self._model = model
        self._servo = Servo(omega, zeta, holds=True)
        count = len(model.drives.torque)
        self._push = np.zeros(count)
        self._arm = self._arm_at(np.zeros(count))

    @property
    def q(self) -> np.ndarray:
        """Where the joints are, shape (n,) [rad], [m]."""
        return self._arm.q

    def place(self, q: JointValues) -> None:
        """Stand at rest at `q`, shape (n,)."""
        self._arm = self._arm_at(np.asarray(q, dtype=float))

    def hold(self, joint: int, position: float) -> None:
        """Put one joint at rest at `position` [rad], [m]; the others go on."""
        self._arm.freeze(joint, position)

    def push(self, joint: int, torque: float) -> None:
        """Have something push on one joint with this torque [N m], [N], until it is 0 again."""
        self._push[joint] = torque

    def cycle(self, setpoint: np.ndarray, cycles: int = 1) -> None:
        """Advance so many cycles of 4 ms to a setpoint, shape (n,)."""
        for _ in range(cycles):
            self._arm.cycle(setpoint)

    def _arm_at(self, q: np.ndarray) -> SimulatedArm:
        """Return an arm at rest, pushed as the one before."""
        arm = SimulatedArm(self._model, q, self._servo)
        arm.push = self._push
        return arm
