"""A simulated arm: a servo per axis that calculates the torque its motion needs, stepped by MuJoCo. Joints as in `PhysicsModel`.

The servo answers a setpoint as the mock controller's realistic servo, a lag of second order, but between two setpoints the drives
interpolate: a setpoint that jumps every 4 ms would ask for several times the torque. It costs half a cycle. The torque is that of
the model, which a motion needs, plus a stiff correction for what the model lacks: a contact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from construction_twin.core.units import CYCLE
from construction_twin.extensions.physics.model import PhysicsModel
from construction_twin.robot.description import JointValues
from construction_twin.servo.model import transition_matrix

#: Of the lag, as of `mock.servo.RealisticServo`: natural frequency [rad/s] and damping.
OMEGA, ZETA = 60.0, 0.8
#: Of the correction: natural frequency [rad/s]; it is damped critically.
STIFFNESS = 150.0
_STIFFNESS, _DAMPING = STIFFNESS**2, 2.0 * STIFFNESS
#: Below this speed friction is taken to grow with speed [rad/s], [m/s], so that an axis at rest has no torque that jumps.
CREEPING = 1e-3
#: What MuJoCo warns of when a state has become useless.
_BROKEN = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


@dataclass(frozen=True)
class Servo:
    """How the axes answer.

    Attributes:
        omega, zeta: Of the lag [rad/s], [1]; omega 0: none.
        saturates: An axis gives at most its torque.
        holds: A setpoint stands for its whole cycle, as the mock's servo has it; False: the drives interpolate.
    """

    omega: float = OMEGA
    zeta: float = ZETA
    saturates: bool = True
    holds: bool = False


class SimulatedArm:
    """An arm and what stands around it, in motion from rest at `q`, shape (n,) [rad], [m].

    Attributes (of shape (n,), SI):
        needed: Torque that the motion needed in the last step, without the correction.
        torque: What the axes gave, with the correction.
        answer: Where the servo's lag alone would have the arm now.
        push: Torques of something else on the axes, unknown to the servo.
    """

    def __init__(self, physics: PhysicsModel, q: JointValues, servo: Servo = Servo()):
        self.physics = physics
        self.data = physics.at_rest(q)
        self._model, self._joints = physics.model, physics.joints
        drives = physics.drives
        self._limit = (
            np.array([math.inf if torque is None else torque for torque in drives.torque]) if servo.saturates else None
        )
        self._course = _course(servo, physics.model.opt.timestep)
        self._damping, self._friction = np.array(drives.damping), np.array(drives.friction)
        size = len(drives.torque)
        self.needed = np.zeros(size)
        self.torque = self.needed
        self.answer = np.array(q, dtype=float)
        self._speed = np.zeros(size)
        self.setpoint = self.answer.copy()
        self.push = np.zeros(size)
        #: What a step wants of the axes: acceleration of the answer, and the correction's [rad/s^2], [m/s^2].
        self._wanted = np.zeros((2, size))

    @property
    def q(self) -> np.ndarray:
        """Joint positions, shape (n,) [rad] or [m]."""
        return self.data.qpos[self._joints].copy()

    def set_speed(self, speed: np.ndarray) -> None:
        """Set the speed of an arm at rest, shape (n,) [rad/s]."""
        self._speed = np.array(speed, dtype=float)
        self.data.qvel[self._joints] = speed

    def freeze(self, joint: int, position: float) -> None:
        """Put one joint at rest at `position` [rad], [m], in the arm and in the servo's answer; the others go on."""
        place = self._joints[joint]
        self.answer[joint], self._speed[joint] = position, 0.0
        self.data.qpos[place], self.data.qvel[place] = position, 0.0

    def continue_from(self, before: SimulatedArm) -> None:
        """Continue with pose, speed and servo state of an arm in another scene."""
        self.answer, self._speed, self.setpoint = before.answer.copy(), before._speed.copy(), before.setpoint.copy()
        self.data.qpos[self._joints] = before.q
        self.data.qvel[self._joints] = before.data.qvel[before._joints]

    def speeds_of(self, body: str) -> np.ndarray:
        """Return the indices of a loose body's velocity in `qvel`, shape (6,)."""
        return int(self._model.jnt_dofadr[self._model.joint(f"free\n{body}").id]) + np.arange(6)

    def loose_state(self, body: str) -> tuple[np.ndarray, np.ndarray]:
        """Return place (x, y, z [m], and the quaternion w, x, y, z) and speed [m/s], [rad/s] of a loose body."""
        at = self.physics.loose[body]
        return self.data.qpos[at : at + 7].copy(), self.data.qvel[self.speeds_of(body)]

    def put_loose(self, body: str, place: np.ndarray, speed: np.ndarray | float = 0.0) -> None:
        """Put a loose body where `loose_state` has it."""
        at = self.physics.loose[body]
        self.data.qpos[at : at + 7], self.data.qvel[self.speeds_of(body)] = place, speed

    def cycle(self, setpoint: np.ndarray) -> None:
        """Advance one cycle of 4 ms to a setpoint, shape (n,) [rad] or [m]; see `Servo.holds`."""
        for _ in self.steps(setpoint):
            pass

    def steps(self, setpoint: np.ndarray) -> Iterator[None]:
        """Advance as `cycle` does, and yield after each step of the simulation."""
        begin, self.setpoint = self.setpoint, setpoint
        # from `begin`: an arm at rest has zeros here, whatever its pose, and stays at rest to the last digit
        course = self._course @ np.stack((self.answer - begin, self._speed, setpoint - begin))
        yield from self.follow(course[0] + begin, course[1], course[2])

    def follow(self, answers: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray) -> Iterator[None]:
        """Advance one step of the simulation per row, and yield after each.

        All of shape (steps, n): where the servo has the arm at the end of a step, how fast, and the acceleration during it.
        """
        rubbing = self._damping * speeds + self._friction * np.minimum(np.maximum(speeds / CREEPING, -1.0), 1.0)
        for answer, speed, acceleration, friction in zip(answers, speeds, accelerations, rubbing):
            self._step(acceleration, friction)
            self.answer, self._speed = answer, speed
            yield

    def _step(self, acceleration: np.ndarray, friction: np.ndarray) -> None:
        """Advance one step; `friction`: friction torque, both of shape (n,)."""
        data, joints, physics, wanted = self.data, self._joints, self.physics, self._wanted
        wanted[0] = acceleration
        wanted[1] = _STIFFNESS * (self.answer - data.qpos[joints]) + _DAMPING * (self._speed - data.qvel[joints])
        # positions, inertias and forces of this moment, which the torques below are calculated from
        mujoco.mj_step1(self._model, data)
        motion, correction = wanted @ physics.inertia(data)
        self.needed = motion + data.qfrc_bias[joints] + friction
        self.torque = self.needed + correction
        if self._limit is not None:
            self.torque = np.minimum(np.maximum(self.torque, -self._limit), self._limit)
        data.qfrc_applied[joints] = self.torque + self.push
        mujoco.mj_step2(self._model, data)


def _course(servo: Servo, step: float) -> np.ndarray:
    """Return position, speed and acceleration at the end of each step of a cycle, shape (3, steps, 3).

    The last axis are factors of the answer before the cycle, of its speed, and of the new setpoint; positions count from the
    setpoint before.
    """
    steps = max(1, round(CYCLE / step))
    lag = transition_matrix(servo.omega, servo.zeta, step) if servo.omega else None
    answer, speed, setpoint = np.eye(3)
    course = np.zeros((3, steps, 3))
    for number in range(steps):
        target = setpoint if servo.holds else setpoint * ((number + 1) / steps)
        before = speed
        if lag is None:
            answer, speed = target, (target - answer) / step
        else:
            (xx, xv), (vx, vv) = lag
            error = answer - target
            answer, speed = target + xx * error + xv * speed, vx * error + vv * speed
        course[:, number] = answer, speed, (speed - before) / step
    return course


class GravityTorque:
    """Torques that hold the arm still where it is, and its kinetic energy."""

    def __init__(self, physics: PhysicsModel):
        self._physics = physics
        self._data = mujoco.MjData(physics.model)
        self._product, self._speed = np.zeros(physics.model.nv), np.zeros(physics.model.nv)

    def at(self, data: mujoco.MjData) -> np.ndarray:
        """Return the torques, shape (n,)."""
        model, own = self._physics.model, self._data
        own.qpos[:] = data.qpos
        mujoco.mj_kinematics(model, own)
        mujoco.mj_comPos(model, own)
        mujoco.mj_comVel(model, own)
        mujoco.mj_rne(model, own, 0, self._product)
        return self._product[self._physics.joints]

    def kinetic(self, data: mujoco.MjData) -> float:
        """Return the kinetic energy of the arm and its load [J]."""
        self._speed[self._physics.joints] = data.qvel[self._physics.joints]
        mujoco.mj_mulM(self._physics.model, data, self._product, self._speed)
        return 0.5 * float(self._speed @ self._product)


def is_broken(data: mujoco.MjData) -> bool:
    """Return whether the simulation has diverged, or MuJoCo has reset itself."""
    return not np.isfinite(data.qpos).all() or any(data.warning[kind].number for kind in _BROKEN)
