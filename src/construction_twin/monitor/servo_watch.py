"""Comparison of the arm with the model of its servos, driven by the targets that the controller really took.

What the controller took in a cycle is told by the command stamp of the pose at its end: the commands at that stamp, by the
playout's own interpolation. A reply that did not arrive is in it: its stamp comes twice. What is not in it is how the gateway
leaves the path of the commands: it brakes, settles on a stream, or stretches it. So the model is judged only where the arm is
moved as it was commanded: the stamps have kept the pace of the cycles, the gate was open, and model and arm have agreed, all that
for `STEADY`. Pure: stamps come in as arguments (ns). Joints in the robot's order; rad, prismatic joints m.

The servos' lag is refined while the arm works: slowly, and only so far that a fault is never taken for a servo. Nothing but the
lag of each joint is learned. What does not grow with the speed, as a slip, a drift, or a payload that pulls a joint down, leaves no
trace in it: the estimate is the slope of the residual over the speed, whatever its mean and its growth with time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from construction_twin.monitor.comparison import TwinHistory
from construction_twin.servo.model import STEADY, ServoModel, ServoState, keeps_pace

#: States that may be missing between two poses, in cycles: what lay between them is known as well.
LONGEST_GAP = 25
#: So many poses in a row must differ. A telegram that was lost on its way leaves the model a cycle behind for one pose: at full
#: speed further than the threshold. The next pose shows by its stamp that the motion was put off.
SAMPLES = 2
#: Before it is judged, the model must have agreed within this fraction of the threshold.
SHARE = 0.8


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
    """Estimates how much later than its identified servo each joint is: `added_lags` [s]; `due`: enough has moved for `apply`."""

    def __init__(self, model: ServoModel):
        self._file = self.model = model
        self.added_lags = (0.0,) * len(model.names)
        self.due = False
        self._sums = [_Slope() for _ in model.names]

    def add_sample(self, residual: Sequence[float], speed: Sequence[float]) -> None:
        """Add a sample: measured minus expected position, and the expected speed of each joint, length n [rad], [rad/s]."""
        for slope, difference, rate in zip(self._sums, residual, speed):
            if abs(rate) >= SLOWEST:
                slope.add(rate, difference)
                if slope.count >= ENOUGH:
                    self.due = True

    def apply(self) -> dict[str, float]:
        """Apply what was learned to `model`, at rest; return the changes of lags by joint [s], {} for none."""
        changes, later = {}, list(self.added_lags)
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
            self.added_lags = tuple(later)
            self.model = self._file.slower(self.added_lags)
        return changes


class _Slope:
    """Slope of y over x by least squares, with a constant and a drift in time as further unknowns."""

    __slots__ = ("_squares", "_time", "_with_y", "count")

    def __init__(self) -> None:
        self.count = 0
        self._time = 0.0
        #: Sums of the products of 1, time and x with each other (the upper half), and with y.
        self._squares = [0.0] * 6
        self._with_y = [0.0] * 3

    def add(self, x: float, y: float) -> None:
        """Add a pair of values."""
        self.count += 1
        # in units of `ENOUGH` samples: all sums stay of similar size
        self._time += 1.0 / ENOUGH
        t, squares, with_y = self._time, self._squares, self._with_y
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
        """The slope; 0 where x is a constant plus a drift in time."""
        (n, t, x, tt, tx, xx), (y, ty, xy) = self._squares, self._with_y
        tt_centred = tt - t * t / n
        x_per_time = (tx - t * x / n) / tt_centred if tt_centred else 0.0
        xx_residual = xx - x * x / n - x_per_time * (tx - t * x / n)
        if not xx_residual > 1e-9 * xx:
            return 0.0
        return (xy - x * y / n - x_per_time * (ty - t * y / n)) / xx_residual


@dataclass(frozen=True)
class ServoDifference:
    """The joint, by its index, that uses most of its threshold against the servo model [rad], [m]."""

    joint: int
    residual: float
    threshold: float


class ServoWatch:
    """Compares the arm with the model of its servos.

    Args:
        threshold: Shape (n,). Largest residual that still counts as agreement, at any speed [rad], [m].

    Attributes:
        expected: Shape (n,). Where the servos should have the arm, for the last pose [rad]; () when it is not known.
        judges: Whether the last pose was judged.
        judged: How many were, since the start.
        largest: Shape (n,). Largest residual of a judged pose that agreed, since the start [rad].
        difference: The present one; None while there is none.
    """

    def __init__(self, model: ServoModel, threshold: Sequence[float]):
        self.refinement = Refinement(model)
        self.judged = 0
        self.largest = (0.0,) * len(model.names)
        self.configure(threshold)
        self.restart()

    def configure(self, threshold: Sequence[float]) -> None:
        """Judge by another threshold, shape (n,), from the next pose on."""
        self._threshold = tuple(threshold)

    def restart(self) -> None:
        """Forget commands and motion, and keep what was learned of the servos: a new command session."""
        self._commands = TwinHistory()
        self.forget_commands()

    def forget_commands(self) -> None:
        """Forget the commands: what the arm follows is unknown."""
        self._state: ServoState | None = None
        self._stamp = self._seq = 0
        self.expected: tuple[float, ...] = ()
        self.suspend_judging()

    def suspend_judging(self) -> None:
        """Judge nothing until the arm has moved as commanded for `STEADY`: the gate is closed."""
        self.judges = False
        self.difference: ServoDifference | None = None
        self._steady = 0
        self._streak = 0

    def on_command(self, stamp: int, command: tuple[float, ...]) -> None:
        """Store a command that goes to the arm, shape (n,), with its stamp [ns]."""
        self._commands.add(stamp, command)

    def on_pose(self, q: Sequence[float], seq: int, command_stamp: int, in_sync: bool) -> ServoDifference | None:
        """Compare a pose of the arm, shape (n,) [rad]; return its difference, None for none and while judging is suspended.

        Args:
            seq: The gateway's counter of its states, one per cycle; 0: not known.
            command_stamp: Of the target that it answers [ns]; 0: not known.
            in_sync: Whether the gate is open, and twin and arm agree.
        """
        before = self.expected
        if seq and seq == self._seq and self._state is not None:
            return self.difference
        if not seq or not command_stamp or not self._follow(seq, command_stamp):
            self.forget_commands()
            return None
        residual = tuple([measured - wanted for measured, wanted in zip(q, self.expected)])
        if not in_sync:
            self.suspend_judging()
            return None
        self._judge(residual)
        if self.judges and self.difference is None and not self._streak and len(before) == len(residual):
            self.largest = tuple([max(most, abs(each)) for most, each in zip(self.largest, residual)])
            period = self.refinement.model.period
            self.refinement.add_sample(residual, [(b - a) / period for a, b in zip(before, self.expected)])
        return self.difference

    def refine(self) -> dict[str, float]:
        """Apply what was learned of the servos, at rest; return the change of each joint's lag by its name [s]."""
        changes = self.refinement.apply()
        if changes and self._state is not None:
            self._state.configure(self.refinement.model)
        return changes

    def _follow(self, seq: int, stamp: int) -> bool:
        """Drive the model by the targets up to a stamp; return whether they are known."""
        cycle = self.refinement.model.cycle_ns
        cycles, begin = seq - self._seq, self._stamp
        if self._state is None or not 0 < cycles <= LONGEST_GAP:
            target = self._target(stamp)
            if target is None:
                return False
            self.suspend_judging()
            self._state = ServoState(self.refinement.model, target)
            self.expected = target
        else:
            advance = stamp - begin
            if keeps_pace(advance, cycles * cycle):
                self._steady += cycles * cycle
            else:
                self.suspend_judging()
            for number in range(1, cycles + 1):
                target = self._target(begin + advance * number // cycles)
                if target is None:
                    return False
                self.expected = self._state.advance(target)
        self._seq, self._stamp = seq, stamp
        return True

    def _target(self, stamp: int) -> tuple[float, ...] | None:
        found = self._commands.at(stamp)
        return None if found is None else found[0]

    def _judge(self, residual: tuple[float, ...]) -> None:
        fraction = 1.0 if self.judges else SHARE
        # written so that a nan does not agree
        agrees = all([abs(each) <= fraction * limit for each, limit in zip(residual, self._threshold)])
        if not self.judges:
            if not agrees:
                self._steady = 0
            self.judges = self._steady >= STEADY
            return
        self.judged += 1
        self._streak = 0 if agrees else min(self._streak + 1, SAMPLES)
        self.difference = None
        if self._streak >= SAMPLES:
            joint = max(range(len(residual)), key=lambda each: abs(residual[each]) / self._threshold[each])
            self.difference = ServoDifference(joint, abs(residual[joint]), self._threshold[joint])
