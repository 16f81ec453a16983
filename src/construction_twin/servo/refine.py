"""The servos' lag, refined while the arm works: slowly, and only so far that a fault is never taken for a servo.

Nothing but the lag of each joint is learned. What does not grow with the speed, as a slip, a drift, or a payload that pulls a joint
down, leaves no trace in it: the estimate is the slope of the residual over the speed, whatever its mean and its growth with time.
Standard library only; s, rad.
"""

from __future__ import annotations

from collections.abc import Sequence

from construction_twin.servo.model import ServoModel

#: Samples in motion before an estimate may take effect: 10 s at 4 ms.
ENOUGH = 2500
#: Slower than this a sample tells nothing of the lag [rad/s], [m/s].
SLOWEST = 0.05
#: Largest change at once, and in all from the identified file [s]. At 5 rad/s the latter hides a hundredth of a rad, at 1 rad/s two
#: thousandths.
STEP, REACH = 0.0005, 0.002
#: A smaller change is none [s].
LEAST = 0.00005


class Refinement:
    """Estimates how much later each joint is than its identified servo.

    Attributes:
        model: As refined so far.
        later: Length n. How much later each joint is than the file says [s].
        due: Whether a joint has moved enough for `take`.
    """

    def __init__(self, model: ServoModel):
        self._file = self.model = model
        self.later = (0.0,) * len(model.names)
        self.due = False
        self._sums = [_Slope() for _ in model.names]

    def learn(self, residual: Sequence[float], speed: Sequence[float]) -> None:
        """Take a sample: measured minus expected position, and the expected speed of each joint, length n [rad], [rad/s]."""
        for slope, difference, rate in zip(self._sums, residual, speed):
            if abs(rate) >= SLOWEST:
                slope.add(rate, difference)
                if slope.count >= ENOUGH:
                    self.due = True

    def take(self) -> dict[str, float]:
        """Let what was learned take effect in `model`, at rest; return the changes of lags by joint [s], {} for none."""
        changes, later = {}, list(self.later)
        for joint, (name, slope) in enumerate(zip(self.model.names, self._sums)):
            if slope.count < ENOUGH:
                continue
            step = min(max(-slope.value, -STEP), STEP)
            wanted = min(max(later[joint] + step, -REACH), REACH)
            if abs(wanted - later[joint]) >= LEAST:
                changes[name] = wanted - later[joint]
                later[joint] = wanted
            self._sums[joint] = _Slope()
        self.due = False
        if changes:
            self.later = tuple(later)
            self.model = self._file.slower(self.later)
        return changes


class _Slope:
    """How a value grows with another, by least squares: its mean, and what grows with time, is taken out first."""

    __slots__ = ("_late", "_squares", "_with_y", "count")

    def __init__(self) -> None:
        self.count = 0
        self._late = 0.0
        #: Sums of the products of 1, time and x with each other (the upper half), and with y.
        self._squares = [0.0] * 6
        self._with_y = [0.0] * 3

    def add(self, x: float, y: float) -> None:
        """Take a pair of values."""
        self.count += 1
        # of the size of a speed, so that no sum drowns another
        self._late += 1.0 / ENOUGH
        t, squares, with_y = self._late, self._squares, self._with_y
        squares[0] += 1.0
        squares[1] += t
        squares[2] += x
        squares[3] += t * t
        squares[4] += t * x
        squares[5] += x * x
        with_y[0] += y
        with_y[1] += t * y
        with_y[2] += x * y

    @property
    def value(self) -> float:
        """The slope; 0 where x tells nothing that mean and time do not."""
        (n, t, x, tt, tx, xx), (y, ty, xy) = self._squares, self._with_y
        times = tt - t * t / n
        along = (tx - t * x / n) / times if times else 0.0
        alone = xx - x * x / n - along * (tx - t * x / n)
        if not alone > 1e-9 * xx:
            return 0.0
        return (xy - x * y / n - along * (ty - t * y / n)) / alone
