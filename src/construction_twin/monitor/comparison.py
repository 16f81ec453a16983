"""Algorithm 1 of the paper: do twin and physical arm agree, and may the next pose pass? Angles in rad, `now` in ns."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from construction_twin.core.interpolation import interpolate
from construction_twin.core.units import CYCLE_NS, NANOSECONDS

#: Samples in motion over which the estimate forgets: 1 s.
MEMORY = 250
#: Samples in motion after which it counts as known: 0.2 s.
ENOUGH = 50
#: Below this speed a lag is lost in rounding: 3 decimals of a degree, 0.4 ms [rad/s].
SLOWEST = 0.02


class LagEstimate:
    """Recursive least squares with forgetting for one unknown, the lag: `most` is the largest that is believed [s].

    A pose measured L after its command differs from the commanded one by -L times the velocity. Each difference between the
    arm and the twin at the present estimate so corrects it, weighted by velocity squared.
    """

    def __init__(self, most: float):
        self.most = most
        self._lag = 0.0
        self._weight = 0.0
        self._samples = 0

    @property
    def known(self) -> bool:
        """True when the arm has moved long enough."""
        return self._samples >= ENOUGH

    @property
    def seconds(self) -> float:
        """The lag [s]; nan until it is known."""
        return self._lag if self.known else math.nan

    @property
    def nanoseconds(self) -> int:
        """The lag to compare by [ns]: the best that is known so far, 0 at first."""
        return round(self._lag * NANOSECONDS)

    def add_sample(self, difference: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        """Add one sample in motion: physical pose minus the twin's at the present estimate [rad], and its velocity [rad/s]."""
        power = sum(v * v for v in velocity)
        if power < SLOWEST * SLOWEST:
            return
        self._weight = self._weight * (1.0 - 1.0 / MEMORY) + power
        correction = sum(d * v for d, v in zip(difference, velocity)) / self._weight
        self._lag = min(max(self._lag - correction, 0.0), self.most)
        if self._samples < ENOUGH:
            self._samples += 1


#: Twin poses kept for comparison by command stamp: 3 s of motion, and the rests in it. The gateway puts off at most 2 s of motion.
HISTORY = 750
#: Poses of a rest that are kept at its begin. What lies between them and the last two has the same pose.
_OF_REST = 2
#: The twin's stamps rise, by at least a cycle. When they fall by more than this, a clock was set back before a program was started
#: again that stamps commands: nothing is known of the twin on the clock of before [ns].
ANOTHER_CLOCK = NANOSECONDS // 50
#: Kinds of comparison: with the twin's pose for the same command, and with its present one.
ALIGNED, INSTANT = "aligned", "instant"


class TwinHistory:
    """The twin's recent poses by stamp, so that a delayed physical pose meets the twin's pose for the same command."""

    def __init__(self):
        self._poses: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=HISTORY)
        #: Number of the newest poses in a row that equal their predecessors.
        self._resting = 0

    @property
    def latest(self) -> tuple[int, tuple[float, ...]] | None:
        """Newest stamp [ns] and pose [rad], or None."""
        return self._poses[-1] if self._poses else None

    def add(self, stamp: int, q: tuple[float, ...]) -> None:
        """Append a pose. One that is not newer than the newest is ignored; one that is far older begins another clock's poses."""
        poses = self._poses
        if poses and stamp < poses[-1][0] - ANOTHER_CLOCK:
            poses.clear()
        if poses and stamp <= poses[-1][0]:
            return
        self._resting = self._resting + 1 if poses and poses[-1][1] == q else 0
        if self._resting > _OF_REST + 1:
            # an arm that trails is compared with a motion, however long the twin has rested since
            poses[-2] = poses[-1]
            poses[-1] = stamp, q
        else:
            poses.append((stamp, q))

    def at(self, stamp: int) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Return pose [rad] and velocity [rad/s] at `stamp` [ns] by the playout's interpolation; None outside what is kept."""
        after = later = None
        poses = reversed(self._poses)
        for pose in poses:
            if pose[0] <= stamp:
                return self._between(stamp, pose, later, next(poses, None), after)
            after, later = later, pose
        return None

    @staticmethod
    def _between(
        stamp: int, earlier: tuple, later: tuple | None, before: tuple | None, after: tuple | None
    ) -> tuple | None:
        stamp0, q0 = earlier
        if later is None:
            return (q0, (0.0,) * len(q0)) if stamp == stamp0 else None
        stamp1, q1 = later
        period = (stamp1 - stamp0) / NANOSECONDS
        return interpolate(stamp, earlier, later, before, after), tuple((b - a) / period for a, b in zip(q0, q1))


@dataclass(frozen=True)
class Comparison:
    """One physical pose compared with the twin: received `at` [ns]; poses and threshold of shape (n,) [rad], [m].

    Attributes:
        mode: ``aligned`` or ``instant``.
        round_trip: From the setpoint with the command stamp to the arm's answer [s]; nan when unknown.
        servo_lag: How long the arm trails what it is compared with [s]; nan until it has moved.
    """

    at: int
    mode: str
    theta_virtual: tuple[float, ...]
    theta_physical: tuple[float, ...]
    threshold: tuple[float, ...]
    round_trip: float
    servo_lag: float

    @property
    def error(self) -> tuple[float, ...]:
        """|physical - twin| per joint [rad]."""
        return tuple(abs(p - v) for p, v in zip(self.theta_physical, self.theta_virtual))

    @property
    def agrees(self) -> bool:
        """True when Algorithm 1 lets the next pose pass."""
        return self.agrees_within(1.0)

    def agrees_within(self, fraction: float) -> bool:
        """Return whether Algorithm 1 (Liang et al., section 3.3) lets the next pose pass within a fraction of the threshold."""
        # written so that a nan does not agree
        return all([error <= fraction * limit for error, limit in zip(self.error, self.threshold)])

    def worst(self) -> int:
        """Index of the joint that uses most of its threshold; one whose error is no number comes first."""
        uses = [error / limit for error, limit in zip(self.error, self.threshold)]
        return max(range(len(uses)), key=lambda index: math.inf if math.isnan(uses[index]) else uses[index])


@dataclass(frozen=True)
class ComparisonSettings:
    """How poses are compared.

    Attributes:
        threshold: Shape (n,). Agreement at rest [rad], [m].
        lag_allowance: Largest servo lag that is believed, and until the lag is known what is allowed for it at the commanded
            velocity [s].
        lag_margin: Once the lag is known: what it may be wrong by [s].
        aligned: True compares by command stamp where there is one, False always with the twin's present pose.
    """

    threshold: tuple[float, ...]
    lag_allowance: float
    lag_margin: float
    aligned: bool = True


class PoseComparison:
    """Compares each physical pose with the twin's, the arm's lag taken out."""

    def __init__(self, settings: ComparisonSettings):
        self.twin = TwinHistory()
        self.last: Comparison | None = None
        # compared with the present pose, the arm trails by the whole round trip
        self._lags = {mode: LagEstimate(settings.lag_allowance) for mode in (ALIGNED, INSTANT)}
        self.configure(settings)

    def configure(self, settings: ComparisonSettings) -> None:
        """Compare by other settings from the next pose on."""
        self._settings = settings
        for lag in self._lags.values():
            lag.most = settings.lag_allowance

    def compare(
        self, q: tuple[float, ...], command_stamp: int, now: int, round_trip: float = math.nan
    ) -> Comparison | None:
        """Compare a physical pose, shape (n,) [rad]; None when the twin's pose for its command stamp is not known.

        `command_stamp` 0 compares with the present pose; `now` is on the clock of the stamps, for the report alone [ns].
        """
        settings = self._settings
        mode = ALIGNED if command_stamp and settings.aligned else INSTANT
        lag = self._lags[mode]
        reference = self._reference(command_stamp if mode == ALIGNED else 0, lag.nanoseconds)
        if reference is None:
            return None
        virtual, velocity = reference
        allowance = settings.lag_margin if lag.known else settings.lag_allowance
        threshold = tuple(limit + allowance * abs(v) for limit, v in zip(settings.threshold, velocity))
        self.last = Comparison(now, mode, virtual, q, threshold, round_trip, lag.seconds)
        if self.last.agrees:
            # what disagrees is not lag
            lag.add_sample(tuple(p - v for p, v in zip(q, virtual)), velocity)
        return self.last

    def _reference(self, stamp: int, lag: int) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Return the twin's pose [rad] and velocity [rad/s] a lag [ns] before a stamp [ns]; stamp 0: before the newest pose."""
        latest = self.twin.latest
        if latest is None:
            return None
        stamp = (stamp or latest[0]) - lag
        if stamp != latest[0]:
            return self.twin.at(stamp)
        before = self.twin.at(stamp - CYCLE_NS)
        return latest[1], before[1] if before else (0.0,) * len(latest[1])


#: Setpoints that are remembered: 65 s. An arm whose replies get lost may trail by many of them.
MAX_SETPOINTS = 16384


class RoundTrips:
    """When each of the last setpoints passed, on the monotonic clock: how long the arm's answer to one takes."""

    def __init__(self):
        # two lists that are written over: nothing is made in a cycle
        self._stamps = [0] * MAX_SETPOINTS
        self._passed = [0] * MAX_SETPOINTS

    def on_setpoint(self, stamp: int, now: int) -> None:
        """Store that the setpoint with this nominal stamp passed at `now` [ns]."""
        place = stamp // CYCLE_NS % MAX_SETPOINTS
        self._stamps[place], self._passed[place] = stamp, now

    def elapsed_since(self, stamp: int, now: int) -> float:
        """Return the time from the passing of the setpoint of `stamp` to `now` [s]; nan when no setpoint nearby is known.

        A stamp between two setpoints is one of the gateway's playout. Where a message waited in a queue the time of its reception
        is an estimate, and may lie a moment before the setpoint passed: 0 then.
        """
        place = stamp // CYCLE_NS % MAX_SETPOINTS
        between = stamp - self._stamps[place]
        if stamp == 0 or not -CYCLE_NS < between < CYCLE_NS:
            return math.nan
        return max(now - self._passed[place] - between, 0) / NANOSECONDS
