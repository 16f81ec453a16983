"""The readings of the mock arm's encoders: the measured angles with slip, backlash and noise.

A fault of an encoder changes the reading, not the arm: it has no effect on servo and setpoints. Pure, standard library only, rad.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

from construction_twin.core.units import CYCLE


class Encoders:
    """From measured angles to reported ones, one `read` per cycle.

    Args:
        period: Length of a cycle [s].

    Attributes:
        offset: Length n. What is added to the measured angle now [rad].
        slip: Length n. Error of the controller's angles since it took its readings as its pose [rad], see `absorb`.
    """

    def __init__(self, count: int, period: float = CYCLE):
        self._period = period
        self._random = random.Random(0)
        self.offset = [0.0] * count
        self.slip = [0.0] * count
        self._drift: dict[int, float] = {}
        self._play: dict[int, list[float]] = {}
        self._noise: dict[int, float] = {}
        self.active = False

    def reseed(self, random_numbers: random.Random) -> None:
        """Use this source of noise: the same seed gives the same readings."""
        self._random = random_numbers

    def shift(self, joint: int, offset: float) -> None:
        """Let the reading of an axis jump to `offset` [rad] beside the measured angle; 0 ends it."""
        self.offset[joint] = offset
        self._note()

    def drift(self, joint: int, rate: float) -> None:
        """Let the reading of an axis drift at `rate` [rad/s]; 0 stops it, and the offset is gone."""
        if rate:
            self._drift[joint] = rate
        else:
            self._drift.pop(joint, None)
            self.offset[joint] = 0.0
        self._note()

    def backlash(self, joint: int, gap: float, measured: float) -> None:
        """Give an axis a play of `gap` [rad]: the reading stands until half of it is crossed; 0 ends it."""
        if gap:
            self._play[joint] = [gap / 2.0, measured]
        else:
            self._play.pop(joint, None)
        self._note()

    def noise(self, joint: int, deviation: float) -> None:
        """Add Gaussian noise of a standard deviation [rad] to the reading of an axis; 0 ends it."""
        if deviation:
            self._noise[joint] = deviation
        else:
            self._noise.pop(joint, None)
        self._note()

    def read(self, measured: Sequence[float]) -> tuple[float, ...]:
        """Return what the encoders report for the measured angles [rad], shape (n,); one cycle passes."""
        reading = list(measured)
        for joint, play in self._play.items():
            half, position = play
            play[1] = min(max(position, reading[joint] - half), reading[joint] + half)
            reading[joint] = play[1]
        for joint, rate in self._drift.items():
            self.offset[joint] += rate * self._period
        for joint, deviation in self._noise.items():
            reading[joint] += self._random.gauss(0.0, deviation)
        return tuple([angle + offset for angle, offset in zip(reading, self.offset)])

    def absorb(self) -> None:
        """Let the controller take its readings as its pose, as at a restart: the offsets become slip."""
        self.slip = [slip + offset for slip, offset in zip(self.slip, self.offset)]
        self.offset = [0.0] * len(self.offset)
        self._note()

    def _note(self) -> None:
        self.active = bool(any(self.offset) or self._drift or self._play or self._noise)
