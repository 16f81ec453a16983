"""The plant of the mock controller with ``servo: physics``: axes that an arm with mass moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.arm import Plant, bare_model
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.mass import payload_of
from construction_twin.mock.program import (
    RESOLUTION,
    SERVO_OMEGA,
    SERVO_ZETA,
    MockSettings,
    axis_angles,
    joint_angles,
)
from construction_twin.mock.servo import Servo, read_encoder
from construction_twin.robot.description import RobotModel
from construction_twin.scene.collision_bodies import RobotBodies


class PhysicsServo(Servo):
    """Axes that a simulated arm moves; they answer as `RealisticServo`, as long as the drives have the torque for it.

    A stalled axis is held where it is by a brake, whatever it takes. Signs are the senses of the axes, seen from their joints.
    """

    def __init__(
        self,
        plant: Plant,
        axis_angles: Callable[[Sequence[float]], tuple[float, ...]],
        joint_angles: Callable[[Sequence[float]], tuple[float, ...]],
        signs: Sequence[int],
        resolution: float,
        period: float = CYCLE,
    ):
        super().__init__(period)
        self._plant = plant
        self._axis_angles, self._joint_angles = axis_angles, joint_angles
        self._signs = tuple(signs)
        self._cycles = round(period / CYCLE)
        self._resolution = resolution

    def push(self, joint: int, torque: float) -> None:
        """Have something push on an axis with this torque [N m], in the axis' own sense, until it is 0 again."""
        self._plant.push(joint, self._signs[joint] * torque)

    def _start(self, q: tuple[float, ...]) -> None:
        self._plant.place(self._joint_angles(q))

    def _respond(self, reference: tuple[float, ...]) -> tuple[float, ...]:
        self._plant.cycle(np.array(self._joint_angles(reference)), self._cycles)
        for joint in self._stalled:
            self._plant.hold(joint, self._joint_angles(reference)[joint])
        moved = self._axis_angles(self._plant.q.tolist())
        return tuple(
            [
                reference[joint] if joint in self._stalled else read_encoder(angle, self._resolution)
                for joint, angle in enumerate(moved)
            ]
        )

    def _freeze(self, joint: int, position: float) -> None:
        pose = list(self._axis_angles(self._plant.q.tolist()))
        pose[joint] = position
        self._plant.hold(joint, self._joint_angles(pose)[joint])


def physics_servo(settings: MockSettings, robot: RobotModel, period: float) -> PhysicsServo:
    """Build the servos of an arm with mass; `period`: of a cycle [s]."""
    drives = read_drives(settings.drives, robot)
    model = bare_model(RobotBodies(robot), drives, payload_of(settings.payload, "payload"))
    return PhysicsServo(
        Plant(model, SERVO_OMEGA, SERVO_ZETA),
        lambda q: axis_angles(robot, tuple(q)),
        lambda angles: joint_angles(robot, tuple(angles)),
        [axis.sign for axis in robot.axes],
        RESOLUTION,
        period,
    )
