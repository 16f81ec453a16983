"""A simulated arm: a servo per axis that calculates the torque its motion needs, stepped by MuJoCo. Joints as in `PhysicsModel`.

The servo's answer to a setpoint is that of the mock controller's realistic servo, a lag of second order, exactly discretised, but
for one thing: between two setpoints the drives interpolate. A held setpoint jumps every 4 ms, and so would the torque, to several
times what the motion takes. It costs half a cycle: the arm is 2 ms later than the mock's. The torque that makes the arm follow this
answer is calculated from the model (gravity, inertia, friction, what is carried), plus a stiff correction for what the model does
not know: a contact. Only the first part is what a motion needs: the correction of an arm that something holds grows as far as the
drives let it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from construction_twin.core.servo_lag import transition_matrix
from construction_twin.core.units import CYCLE
from construction_twin.physics.model import PhysicsModel
from construction_twin.robot.description import JointValues

#: Of the lag, as of `mock.servo.RealisticServo`: natural frequency [rad/s] and damping.
OMEGA, ZETA = 60.0, 0.8
#: Of the correction: natural frequency [rad/s]; it is damped critically.
STIFFNESS = 150.0
#: Below this speed friction is taken to grow with speed [rad/s], [m/s], so that an axis at rest has no torque that jumps.
CREEPING = 1e-3


@dataclass(frozen=True)
class Servo:
    """How the axes answer.

    Attributes:
        omega, zeta: Of the lag [rad/s], [1]; omega 0: none, the arm is where it is told to be.
        saturates: An axis gives no more than its torque; False: what it needs is applied, whatever that is.
        holds: A setpoint stands for its whole cycle, as the mock's servo has it; False: the drives go to it in a straight line from
            the one before, which takes 2 ms longer and has no jumps of torque.
    """

    omega: float = OMEGA
    zeta: float = ZETA
    saturates: bool = True
    holds: bool = False


class SimulatedArm:
    """An arm and what stands around it, in motion.

    Args:
        q: Shape (n,). Where the arm stands at rest [rad], [m].

    Attributes:
        data: MuJoCo's state.
        needed: Shape (n,). Torque that the motion needed in the last step, without the correction [N m], [N].
        torque: Shape (n,). What the axes gave, with the correction [N m], [N].
        answer: Shape (n,). Where the servo's lag alone would have the arm now [rad], [m].
        setpoint: Shape (n,). The last one [rad], [m].
        steps_per_cycle: Steps of the simulation in a cycle of 4 ms.
    """

    def __init__(self, physics: PhysicsModel, q: JointValues, servo: Servo = Servo()):
        self.physics = physics
        self.data = physics.at_rest(q)
        model = physics.model
        self._model, self._joints = model, physics.joints
        step = model.opt.timestep
        self.steps_per_cycle = max(1, round(CYCLE / step))
        self._lag = transition_matrix(servo.omega, servo.zeta, step) if servo.omega else None
        self._gains = (STIFFNESS**2, 2.0 * STIFFNESS)
        self._limit = (
            np.array([math.inf if torque is None else torque for torque in physics.drives.torque])
            if servo.saturates
            else None
        )
        self._servo = servo
        self._armature = np.array(physics.drives.armature)
        self._damping = np.array(physics.drives.damping)
        self._friction = np.array(physics.drives.friction)
        self._wanted = np.zeros(model.nv)
        self._forces = np.zeros(model.nv)
        self.needed = np.zeros(len(self._joints))
        self.torque = self.needed
        self.answer = np.array(q, dtype=float)
        self._speed = np.zeros(len(self._joints))
        self.setpoint = self.answer.copy()

    @property
    def q(self) -> np.ndarray:
        """Joint positions, shape (n,) [rad] or [m]."""
        return self.data.qpos[self._joints]

    def begin_with(self, speed: np.ndarray) -> None:
        """Have the arm move already, shape (n,) [rad/s]."""
        self._speed = np.array(speed, dtype=float)
        self.data.qvel[self._joints] = speed
        self.physics.follow(self.data)

    def freeze(self, joint: int, position: float) -> None:
        """Put one joint at rest at `position` [rad], [m], in the arm and in the servo's answer; the others go on."""
        place = self._joints[joint]
        self.answer[joint], self._speed[joint] = position, 0.0
        self.data.qpos[place], self.data.qvel[place] = position, 0.0
        self.physics.follow(self.data)

    def go_on_as(self, before: SimulatedArm) -> None:
        """Take over pose, speed and the servo's state of an arm in another scene."""
        self.answer, self._speed, self.setpoint = before.answer.copy(), before._speed.copy(), before.setpoint.copy()
        self.data.qpos[self._joints] = before.q
        self.data.qvel[self._joints] = before.data.qvel[before._joints]
        self.physics.follow(self.data)

    def cycle(self, setpoint: np.ndarray) -> None:
        """Advance one cycle of 4 ms to a setpoint, shape (n,) [rad] or [m]; see `Servo.holds`."""
        for target in self.targets(setpoint):
            self.step(target)

    def targets(self, setpoint: np.ndarray) -> list[np.ndarray]:
        """Return what `step` takes in one cycle to a setpoint, shape (n,)."""
        begin, steps = self.setpoint, self.steps_per_cycle
        if self._servo.holds:
            return [setpoint] * steps
        return [begin + (setpoint - begin) * (number / steps) for number in range(1, steps + 1)]

    def step(self, setpoint: np.ndarray) -> None:
        """Advance one step of the simulation, with the target of this step, shape (n,)."""
        model, data, joints, physics = self._model, self.data, self._joints, self.physics
        self.setpoint = setpoint
        stiffness, damping = self._gains
        # where the arm should be now, before the answer moves on
        correction = stiffness * (self.answer - data.qpos[joints]) + damping * (self._speed - data.qvel[joints])
        wanted = self._answer_to(setpoint)
        # positions, inertias and contacts of this moment, which the torques below are calculated from
        mujoco.mj_step1(model, data)
        data.qacc[joints] = wanted
        physics.lead(data.qacc)
        mujoco.mj_rne(model, data, 1, self._forces)
        speed = data.qvel[joints] + model.opt.timestep * wanted
        rubbing = self._friction * np.clip(speed / CREEPING, -1.0, 1.0)
        self.needed = physics.of_joints(self._forces) + self._armature * wanted + self._damping * speed + rubbing
        self._wanted[joints] = correction
        physics.lead(self._wanted)
        mujoco.mj_mulM(model, data, self._forces, self._wanted)
        self.torque = self.needed + physics.of_joints(self._forces)
        if self._limit is not None:
            self.torque = np.clip(self.torque, -self._limit, self._limit)
        data.qfrc_applied[joints] = self.torque
        mujoco.mj_step2(model, data)

    def _answer_to(self, setpoint: np.ndarray) -> np.ndarray:
        """Move the lag's state over one step, and return its acceleration [rad/s^2]."""
        dt = self._model.opt.timestep
        if self._lag is None:
            speed = (setpoint - self.answer) / dt
            wanted = (speed - self._speed) / dt
            self.answer, self._speed = setpoint.copy(), speed
            return wanted
        (xx, xv), (vx, vv) = self._lag
        error, speed = self.answer - setpoint, self._speed
        self.answer = setpoint + xx * error + xv * speed
        self._speed = vx * error + vv * speed
        return (self._speed - speed) / dt
