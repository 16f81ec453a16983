"""The arm alone, with mass, in empty space: what the mock controller moves, and what torques a motion of it should take. SI.

Joints in the order of ``robot.joint_names``. It touches nothing: a collision is a torque that somebody says.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import mujoco
import numpy as np

from construction_twin.physics.arm import CREEPING, Servo, SimulatedArm
from construction_twin.physics.drive import ArmDrives
from construction_twin.physics.known_mass import carried_part, masses_of
from construction_twin.physics.mass import MassProperties
from construction_twin.physics.model import Load, PhysicsModel, build_model
from construction_twin.robot.description import JointValues
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision


def bare_model(
    bodies: RobotBodies,
    drives: ArmDrives,
    flange: MassProperties | None = None,
    scene: Scene = Scene(),
    known: Mapping[str, float] = MappingProxyType({}),
) -> PhysicsModel:
    """Return the model of an arm with nothing around it.

    Args:
        flange: A payload in the frame of the tip link that it carries at all times; None: none.
        scene: It also carries what it does in this scene.
        known: Masses of bodies there, see `physics.known_mass` [kg].

    Raises:
        SceneError: If an object's link does not exist, or its mesh cannot be used.
        ConfigurationError: If an inertia of the URDF is none.
    """
    carried = carried_part(scene)
    load = Load(masses_of(known, (carried,), bodies), flange=flange)
    return build_model(bodies, carried, SelfCollision({}, ""), drives, load, contacts=False)


class Plant:
    """An arm that is told setpoints, and can be pushed and lose its load.

    Args:
        loaded, empty: The arm with its payload, and without.
        omega, zeta: Of the servo's lag [rad/s], [1].

    Attributes:
        torque: Shape (n,). What the axes gave in the last cycle on average [N m], [N].
    """

    def __init__(self, loaded: PhysicsModel, empty: PhysicsModel, omega: float, zeta: float):
        self._models = {True: loaded, False: empty}
        self._servo = Servo(omega, zeta, holds=True)
        self._carries = True
        count = len(loaded.drives.torque)
        self._push = np.zeros(count)
        self._arm = self._arm_at(np.zeros(count))
        self.torque = self._arm.torque

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

    def carry(self, carries: bool) -> None:
        """Lose the load, or have it again; the arm goes on as it moves."""
        if carries is not self._carries:
            before, self._carries = self._arm, carries
            self._arm = self._arm_at(before.q)
            self._arm.go_on_as(before)
            mujoco.mj_forward(self._arm.physics.model, self._arm.data)

    def cycle(self, setpoint: np.ndarray, cycles: int = 1) -> None:
        """Advance so many cycles of 4 ms to a setpoint, shape (n,)."""
        arm, total, steps = self._arm, np.zeros(len(self._push)), 0
        for _ in range(cycles):
            for _step in arm.steps(setpoint):
                total += arm.torque
                steps += 1
        self.torque = total / steps

    def _arm_at(self, q: np.ndarray) -> SimulatedArm:
        """Return an arm at rest, with or without the load as it is now, and pushed as the one before."""
        arm = SimulatedArm(self._models[self._carries], q, self._servo)
        arm.push = self._push
        return arm


class InverseDynamics:
    """The torques that a motion of the arm takes: gravity, inertia, friction, payload."""

    def __init__(self, physics: PhysicsModel):
        self._physics = physics
        self._data = physics.at_rest(np.zeros(len(physics.drives.torque)))
        self._forces = np.zeros(physics.model.nv)
        drives = physics.drives
        self._armature, self._damping, self._friction = map(
            np.array, (drives.armature, drives.damping, drives.friction)
        )

    def torques(self, q: JointValues, speed: JointValues, acceleration: JointValues) -> np.ndarray:
        """Return the torques of the joints, shape (n,) [N m], [N], from position, speed and acceleration of each, shape (n,)."""
        physics, data = self._physics, self._data
        model, joints = physics.model, physics.joints
        data.qpos[joints], data.qvel[joints] = q, speed
        physics.follow(data)
        data.qacc[joints] = acceleration
        physics.lead(data.qacc)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, self._forces)
        rate, growth = np.asarray(speed, dtype=float), np.asarray(acceleration, dtype=float)
        rubbing = self._friction * np.clip(rate / CREEPING, -1.0, 1.0)
        return physics.of_joints(self._forces) + self._armature * growth + self._damping * rate + rubbing
