"""The plant of the mock controller with ``servo: physics``: axes that an arm with mass moves."""

from __future__ import annotations

import numpy as np

from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.arm import Servo as ArmServo
from construction_twin.extensions.physics.arm import SimulatedArm
from construction_twin.extensions.physics.drive import ArmDrives, read_drives
from construction_twin.extensions.physics.mass import MassProperties, payload_of
from construction_twin.extensions.physics.model import Load, PhysicsModel, build_model
from construction_twin.mock.program import RESOLUTION, SERVO_OMEGA, SERVO_ZETA, MockSettings
from construction_twin.mock.servo import Servo, read_encoder
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision


def bare_model(bodies: RobotBodies, drives: ArmDrives, flange: MassProperties | None = None) -> PhysicsModel:
    """Return the model of an arm with nothing around it; `flange`: a payload in the frame of the tip link."""
    return build_model(bodies, Scene(), SelfCollision({}, ""), drives, Load(flange=flange), contacts=False)


class Plant:
    """An arm in empty space that can be pushed; `omega`, `zeta` as in `arm.Servo`."""

    def __init__(self, model: PhysicsModel, omega: float, zeta: float):
        self._model, self._servo = model, ArmServo(omega, zeta, holds=True)
        self._push = np.zeros(len(model.drives.torque))
        self.place(np.zeros(len(self._push)))

    @property
    def q(self) -> np.ndarray:
        """Where the joints are, shape (n,) [rad], [m]."""
        return self._arm.q

    def place(self, q: JointValues) -> None:
        """Stand at rest at `q`, shape (n,), pushed as before."""
        self._arm = SimulatedArm(self._model, np.asarray(q, dtype=float), self._servo)
        self._arm.push = self._push

    def hold(self, joint: int, position: float) -> None:
        """Put one joint at rest at `position` [rad], [m]; the others go on."""
        self._arm.freeze(joint, position)

    def push(self, joint: int, torque: float) -> None:
        """Apply an external torque to a joint, until it is 0 again [N m], [N]."""
        self._push[joint] = torque

    def cycle(self, setpoint: np.ndarray, cycles: int = 1) -> None:
        """Advance so many cycles of 4 ms to a setpoint, shape (n,)."""
        for _ in range(cycles):
            self._arm.cycle(setpoint)


class PhysicsServo(Servo):
    """Axes that a simulated arm moves; they answer as `RealisticServo`, as long as the drives have the torque for it.

    A stalled axis is held where it is by a brake, whatever it takes. Signs are the senses of the axes, seen from their joints.
    """

    def __init__(self, plant: Plant, robot: RobotModel, resolution: float, period: float = CYCLE):
        super().__init__(period)
        self._plant, self._robot = plant, robot
        self._cycles = round(period / CYCLE)
        self._resolution = resolution

    def push(self, joint: int, torque: float) -> None:
        """Apply an external torque to an axis, in its own sense, until it is 0 again [N m]."""
        self._plant.push(joint, self._robot.axes[joint].sign * torque)

    def _start(self, q: tuple[float, ...]) -> None:
        self._plant.place(self._robot.from_axes(q))

    def _respond(self, reference: tuple[float, ...]) -> tuple[float, ...]:
        self._plant.cycle(np.array(self._robot.from_axes(reference)), self._cycles)
        for joint in self._stalled:
            self._plant.hold(joint, self._robot.from_axes(reference)[joint])
        moved = self._robot.to_axes(self._plant.q.tolist())
        return tuple(
            [
                reference[joint] if joint in self._stalled else read_encoder(angle, self._resolution)
                for joint, angle in enumerate(moved)
            ]
        )

    def _freeze(self, joint: int, position: float) -> None:
        pose = list(self._robot.to_axes(self._plant.q.tolist()))
        pose[joint] = position
        self._plant.hold(joint, self._robot.from_axes(pose)[joint])


def physics_servo(settings: MockSettings, robot: RobotModel, period: float) -> PhysicsServo:
    """Build the servos of an arm with mass; `period`: of a cycle [s]."""
    drives = read_drives(settings.drives, robot)
    model = bare_model(RobotBodies(robot), drives, payload_of(settings.payload, "payload"))
    return PhysicsServo(Plant(model, SERVO_OMEGA, SERVO_ZETA), robot, RESOLUTION, period)
