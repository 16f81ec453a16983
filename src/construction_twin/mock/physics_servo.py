"""The mock arm with mass: its axes are moved by a simulated arm, so that friction, coupling and payload show. Axis angles in rad.

The simulation itself is `physics.plant`; here are the axes of the controller around it. Standard library and numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from construction_twin.core.units import CYCLE
from construction_twin.mock.servo import Servo, WithMass, read_encoder


class Plant(Protocol):
    """A simulated arm; see `physics.plant.Plant`. Joints in the robot's order, SI."""

    @property
    def q(self) -> np.ndarray:
        """Where the joints are, shape (n,)."""
        ...

    def place(self, q: Sequence[float]) -> None:
        """Stand at rest."""

    def hold(self, joint: int, position: float) -> None:
        """Put one joint at rest."""

    def push(self, joint: int, torque: float) -> None:
        """Have something push on one joint."""

    def cycle(self, setpoint: np.ndarray, cycles: int = 1) -> None:
        """Advance."""


class PhysicsServo(WithMass, Servo):
    """Axes that a simulated arm moves; they answer as `RealisticServo`, as long as the drives have the torque for it.

    A stalled axis is held where it is by a brake, whatever it takes.

    Args:
        axis_angles, joint_angles: Between angles of the controller's axes and of the robot's joints, each length n.
        signs: Length n. 1 or -1: the sense of each axis, seen from its joint.
        resolution: Encoder step [rad]; 0 for an exact reading.
        period: Length of a cycle [s], a multiple of 4 ms.
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
