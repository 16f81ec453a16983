"""The torques that a motion of an arm takes, from MuJoCo's inverse dynamics: what a simulated arm is compared with. SI."""

from __future__ import annotations

import mujoco
import numpy as np

from construction_twin.extensions.physics.arm import CREEPING
from construction_twin.extensions.physics.model import PhysicsModel
from construction_twin.robot.description import JointValues


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
        data.qacc[joints] = acceleration
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, self._forces)
        rate, growth = np.asarray(speed, dtype=float), np.asarray(acceleration, dtype=float)
        rubbing = self._friction * np.clip(rate / CREEPING, -1.0, 1.0)
        return self._forces[joints] + self._armature * growth + self._damping * rate + rubbing
