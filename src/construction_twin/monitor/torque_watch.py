"""Do the axes give the torques that their motion should take? What differs for long is a collision, or a load that was lost.

The expected motion is the one that a servo of second order makes of what passed the gate; what torque it takes, the model of the
arm says, with the payload that it is believed to carry. Compared by command stamp, as poses are. Pure: stamps come in as arguments
(ns). Joints in the robot's order; SI.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.servo.model import JointServo, ServoModel, ServoState

#: Motions kept for comparison by command stamp: 2 s.
HISTORY = 500
#: A command that comes so much later than the one before it begins another motion, from rest [ns].
LONGEST_GAP = 25 * CYCLE_NS

#: From position, speed and acceleration of the joints, each length n, to their torques [N m], [N], length n.
InverseDynamics = Callable[[Sequence[float], Sequence[float], Sequence[float]], Sequence[float]]


@dataclass(frozen=True)
class TorqueSettings:
    """From where on a torque differs.

    Attributes:
        threshold: Length n. Largest difference that still counts as agreement [N m], [N]; infinite: the axis is not watched.
        samples: So many comparisons in a row must differ on one axis, at least 1.
        omega, zeta: Of the servos' lag [rad/s], [1].
    """

    threshold: tuple[float, ...]
    samples: int = 5
    omega: float = 60.0
    zeta: float = 0.8


@dataclass(frozen=True)
class TorqueDifference:
    """A torque that is not what the motion should take.

    Attributes:
        joint: Index of the joint.
        measured, expected, threshold: [N m], [N]
    """

    joint: int
    measured: float
    expected: float
    threshold: float


@dataclass(frozen=True, slots=True)
class Motion:
    """What the arm should do in the cycle that ends with a stamp: its middle position, and mean speed and acceleration."""

    stamp: int
    q: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]


class TorqueWatch:
    """Compares torques with what the motion should take.

    Args:
        dynamics: The model of the arm, with what it is believed to carry.

    Attributes:
        compared: How often torques were compared since the start.
        motions: What the arm should do in each cycle that is kept, the newest last.
        difference: The present one; None while the torques agree, and before they could be compared.
    """

    def __init__(self, settings: TorqueSettings, dynamics: InverseDynamics):
        self._dynamics = dynamics
        self._counts = True
        self.compared = 0
        self.restart()
        self.configure(settings)

    def configure(self, settings: TorqueSettings) -> None:
        """Compare by other settings from the next torques on."""
        self._settings = settings
        servo, count = JointServo(settings.omega, settings.zeta), len(settings.threshold)
        self._servos = ServoModel(("",) * count, (servo,) * count, CYCLE_NS)
        if self._state is not None:
            self._state.configure(self._servos)

    def restart(self) -> None:
        """Forget motion and differences: a new command session."""
        self.difference: TorqueDifference | None = None
        self.motions: deque[Motion] = deque(maxlen=HISTORY)
        self._stamp = 0
        self._command: tuple[float, ...] = ()
        self._state: ServoState | None = None
        self._streak: list[int] = []
        #: Torques of cycles that end with this command stamp or before it are not compared.
        self._before = 0

    def believe(self, dynamics: InverseDynamics) -> None:
        """Expect what another model says from the next torques on: the arm carries something else."""
        self._dynamics = dynamics

    def count(self, counts: bool) -> None:
        """Say whether torques count: not while nobody knows what the arm carries. When they count again, from the next command on.

        A difference that there is stays until torques are compared that agree.
        """
        if counts and not self._counts:
            self._before, self._streak = self._stamp, []
        self._counts = counts

    def on_command(self, stamp: int, command: tuple[float, ...]) -> None:
        """Take a command that goes to the arm, shape (n,), with its stamp [ns]; one that is not newer than the last is ignored."""
        if self._command and stamp <= self._stamp:
            return
        gap = stamp - self._stamp
        state, before = self._state, self._command
        if state is None or gap > LONGEST_GAP:
            state = self._state = ServoState(self._servos, command)
            self.motions.clear()
            before, gap = command, CYCLE_NS
        cycles = max(1, round(gap / CYCLE_NS))
        for number in range(1, cycles + 1):
            share = number / cycles
            target = tuple([a + (b - a) * share for a, b in zip(before, command)])
            self._advance(state, stamp - (cycles - number) * CYCLE_NS, target)
        self._stamp, self._command = stamp, command

    def _advance(self, state: ServoState, stamp: int, target: tuple[float, ...]) -> None:
        """Move the servos' answer over one cycle, with a setpoint that is held."""
        q, speed = state.position, state.speed
        after = state.advance(target)
        self.motions.append(
            Motion(
                stamp,
                tuple([(a + b) / 2.0 for a, b in zip(q, after)]),
                tuple([(b - a) / CYCLE for a, b in zip(q, after)]),
                tuple([(b - a) / CYCLE for a, b in zip(speed, state.speed)]),
            )
        )

    def expected(self, stamp: int) -> tuple[float, ...] | None:
        """Return the torques of the cycle that ends with a command stamp [ns], shape (n,); None when its motion is not known."""
        later = None
        for motion in reversed(self.motions):
            if motion.stamp <= stamp:
                if later is None:
                    return self._torques(motion) if motion.stamp == stamp else None
                share = (stamp - motion.stamp) / (later.stamp - motion.stamp)
                if not share:
                    return self._torques(motion)
                first, second = self._torques(motion), self._torques(later)
                return tuple([a + (b - a) * share for a, b in zip(first, second)])
            later = motion
        return None

    def _torques(self, motion: Motion) -> tuple[float, ...]:
        return tuple(self._dynamics(motion.q, motion.speed, motion.acceleration))

    def on_torques(self, measured: Sequence[float], command_stamp: int) -> TorqueDifference | None:
        """Take what the axes gave in the cycle that ends with a command stamp, shape (n,); nan for an axis that is not told.

        What cannot be compared, because no command belongs to it, its motion is not known or what the arm carries is not, changes
        nothing.

        Returns:
            The present difference: of the axis that is furthest over its threshold; None while there is none.
        """
        compares = self._counts and command_stamp > self._before
        expected = self.expected(command_stamp) if compares else None
        if expected is None:
            return self.difference
        self.compared += 1
        threshold, samples = self._settings.threshold, self._settings.samples
        streak = self._streak or [0] * len(expected)
        over = [
            # written so that an axis that is not told does not differ
            abs(found - wanted) > limit
            for found, wanted, limit in zip(measured, expected, threshold)
        ]
        self._streak = [min(count + 1, samples) if far else 0 for count, far in zip(streak, over)]
        differing = [joint for joint, count in enumerate(self._streak) if count >= samples]
        if not differing:
            if self.difference is not None and not any(over):
                self.difference = None
            return self.difference
        joint = max(differing, key=lambda each: abs(measured[each] - expected[each]) / threshold[each])
        self.difference = TorqueDifference(joint, measured[joint], expected[joint], threshold[joint])
        return self.difference


def thresholds(
    fraction: float, single: Mapping[str, float], names: Sequence[str], limits: Sequence[float | None]
) -> tuple[float, ...]:
    """Return from where on each joint's torque differs, shape (n,) [N m], [N]; infinite for one whose limit nobody says.

    Args:
        fraction: Of the limit.
        single: Other values for single joints, by joint name [N m], [N].
        limits: Length n. What each axis can give [N m], [N]; None: nobody says.
    """
    return tuple(
        single.get(name, math.inf if limit is None else fraction * limit) for name, limit in zip(names, limits)
    )
