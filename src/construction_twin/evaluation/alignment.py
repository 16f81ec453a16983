"""Pairs every physical sample with a pose, by four alignments. The paper does not say which one it used.

``instant``
    The physical pose at ROS time t (reception in the bridge) against the twin's pose at the same ROS time. The difference
    contains everything that an observer sees: the round trip, the playout delay and the servo's lag.
``by_command``
    The physical pose against the twin's pose at the command stamp of the target that it answers. The transport cancels out;
    the arm's lag behind its setpoint remains.
``lag_removed``
    ``by_command`` with one constant lag L >= 0, the same for all joints, taken out: twin(command_stamp - L). L minimises
    the sum of squared differences over all joints and samples.
``expected``
    The physical pose against where the gate's model of the servos had the arm (`construction_twin.servo`), as it was recorded.

The twin is known at its own stamps and interpolated in between by a cubic, with the playout's arithmetic
(`construction_twin.core.interpolation`): what the gateway plays between two commands is then exactly what is compared.
Differences of stamps are taken in int64, so that float64 keeps them to far below a nanosecond.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.evaluation.recording import Recording, Stream

#: Largest lag considered [ns]: far beyond any working servo, but short compared with a task.
MAX_LAG_NS = NANOSECONDS // 2
#: The optimiser's tolerance [ns]; it is absolute.
LAG_TOLERANCE_NS = 1e-3
#: Samples used by the coarse scan over lags; the final fit uses all.
SCAN_SAMPLES = 2000
#: A twin that moves less than this has no lag to show [rad].
STANDSTILL = 1e-9


@dataclass(frozen=True)
class Window:
    """The span of ROS time that is evaluated.

    Attributes:
        start, end: First and last moment [ns].
        task_end: Nominal stamp of the last setpoint [ns]; `end` is later by the time the arm needs to answer it.
        from_plan: Start and end come from the plans that were played; False: from the overlap of both streams.
    """

    start: int
    end: int
    task_end: int
    from_plan: bool

    @property
    def duration(self) -> float:
        """Length of the task, or of the overlap [s]."""
        return (self.task_end - self.start) / NANOSECONDS

    def contains(self, stamps: np.ndarray) -> np.ndarray:
        """Return which stamps [ns] lie inside; shape as `stamps`, bool."""
        return (stamps >= self.start) & (stamps <= self.end)

    def extended(self, delay: int) -> Window:
        """Return the window with its end moved to `delay` [ns] after the task's, when it comes from a plan."""
        return Window(self.start, self.task_end + delay, self.task_end, True) if self.from_plan else self


@dataclass(frozen=True)
class Alignment:
    """Differences physical - twin, shape (m, n) [rad], at ROS times of physical samples, shape (m,) [ns].

    `skipped`: samples inside the window without a command stamp, or beyond the twin's recording.
    """

    name: str
    stamps: np.ndarray
    errors: np.ndarray
    skipped: int

    @property
    def average(self) -> np.ndarray:
        """Mean absolute error per joint [rad]; shape (n,)."""
        return np.abs(self.errors).mean(axis=0)

    @property
    def maximum(self) -> np.ndarray:
        """Largest absolute error per joint [rad]; shape (n,)."""
        return np.abs(self.errors).max(axis=0)


class TwinPath:
    """The twin's motion as a function of time.

    Samples whose stamp does not lie after all earlier ones (a restarted or repeated stream) are left out. `base`: Stamp that times
    are counted from [ns].
    """

    def __init__(self, twin: Stream, base: int):
        newest = np.maximum.accumulate(twin.stamps)
        increasing = np.concatenate([[True], twin.stamps[1:] > newest[:-1]])
        if np.count_nonzero(increasing) < 2:
            raise ConstructionTwinError("the twin's stamps do not increase; was it recorded with a stopped clock?")
        self._times = (twin.stamps[increasing] - base).astype(float)
        self._positions = twin.positions[increasing]
        periods = np.diff(self._times)
        # the periods before and after each segment; at the ends any value, because its weight is 0
        self._earlier = np.concatenate([periods[:1], periods[:-1]])
        self._later = np.concatenate([periods[1:], periods[-1:]])

    def covers(self, times: np.ndarray) -> np.ndarray:
        """Return which times [ns after base] lie within the recorded motion; shape (m,), bool."""
        return (times >= self._times[0]) & (times <= self._times[-1])

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Return the twin's pose at `times` [ns after base], which must be covered; shape (m, n), rad."""
        last = len(self._times) - 2
        segment = np.clip(np.searchsorted(self._times, times, side="right") - 1, 0, last)
        a, b, c = self._weights(segment, times, last)
        before, after = np.maximum(segment - 1, 0), np.minimum(segment + 2, last + 1)
        q_before, q0, q1, q_after = (self._positions[row] for row in (before, segment, segment + 1, after))
        return q0 + (a * (q0 - q_before) + b * (q1 - q0) + c * (q_after - q1))

    def _weights(self, segment: np.ndarray, times: np.ndarray, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `construction_twin.core.interpolation.weights` for every time, each with shape (m, 1)."""
        period = self._times[segment + 1] - self._times[segment]
        earlier, later = self._earlier[segment], self._later[segment]
        fraction = (times - self._times[segment]) / period
        rest = 1.0 - fraction
        begin, end = fraction * rest * rest, -fraction * fraction * rest
        first, final = segment == 0, segment == last
        b = fraction * fraction * (3.0 - 2.0 * fraction)
        b += np.where(first, begin, begin * (earlier / (earlier + period)))
        b += np.where(final, end, end * (later / (later + period)))
        a = np.where(first, 0.0, begin * (period / earlier * (period / (earlier + period))))
        c = np.where(final, 0.0, end * (period / later * (period / (later + period))))
        return a[:, None], b[:, None], c[:, None]


def task_window(recording: Recording) -> Window:
    """Return the span from the first finished plan's start to the last one's end, else the overlap of both streams."""
    plans = recording.finished_plans
    if plans:
        start, end = min(plan.start for plan in plans), max(plan.end for plan in plans)
        return Window(start, end, end, True)
    stamps = recording.twin.stamps, recording.physical.stamps
    start, end = max(int(s.min()) for s in stamps), min(int(s.max()) for s in stamps)
    if end <= start:
        raise ConstructionTwinError(
            "twin and physical samples do not overlap in time; were they recorded on one clock?"
        )
    return Window(start, end, end, False)


def align_instant(recording: Recording, window: Window) -> Alignment:
    """Pair each physical sample inside the window with the twin's pose at the same ROS time."""
    inside = window.contains(recording.physical.stamps)
    stamps = recording.physical.stamps[inside]
    path = TwinPath(recording.twin, window.start)
    times = (stamps - window.start).astype(float)
    return _paired("instant", stamps, times, recording.physical.positions[inside], path)


def align_by_command(recording: Recording, window: Window) -> Alignment | None:
    """Pair each physical sample inside the window with the twin's pose at its command stamp; None: there are none inside."""
    return _align_command("by_command", recording, window, 0.0)


def align_lag_removed(recording: Recording, window: Window, lag_ns: float) -> Alignment | None:
    """Pair each physical sample as `align_by_command`, with the twin's pose `lag_ns` [ns] before its command stamp."""
    return _align_command("lag_removed", recording, window, lag_ns)


def align_expected(recording: Recording, window: Window) -> Alignment | None:
    """Pair each physical sample inside the window with the pose that the gate expected of the servos; None: there are none."""
    if recording.expected is None:
        return None
    physical, expected = recording.physical, recording.expected
    stamps, rows, others = np.intersect1d(physical.stamps, expected.stamps, return_indices=True)
    inside = window.contains(stamps)
    if not inside.any():
        return None
    errors = physical.positions[rows[inside]] - expected.positions[others[inside]]
    skipped = int(np.count_nonzero(window.contains(physical.stamps))) - len(errors)
    return Alignment("expected", stamps[inside], errors, skipped)


def estimate_lag(recording: Recording, window: Window) -> float | None:
    """Return the constant lag of the arm behind its commands [ns], by least squares; None without stamps, or a twin at rest.

    A coarse scan over whole cycles finds the global minimum's neighbourhood (a repetitive motion has several local minima), a
    bounded search inside it the minimum.
    """
    answered, _ = _answered(recording, window)
    if answered is None:
        return None
    path = TwinPath(recording.twin, window.start)
    times = (answered.command_stamps - window.start).astype(float)
    usable = path.covers(times) & path.covers(times - MAX_LAG_NS)
    times, measured = times[usable], answered.positions[usable]
    if len(times) < 2 or np.ptp(path(times), axis=0).max() < STANDSTILL:
        return None

    def squares(lag: float, step: int = 1) -> float:
        return float(np.sum((measured[::step] - path(times[::step] - lag)) ** 2))

    step = max(1, len(times) // SCAN_SAMPLES)
    coarse = min(range(0, MAX_LAG_NS + 1, CYCLE_NS), key=lambda lag: squares(lag, step))
    # Searched as an offset from the coarse value: the optimiser also carries a tolerance relative to its variable.
    bounds = (max(-coarse, -CYCLE_NS), CYCLE_NS)
    fine = minimize_scalar(
        lambda offset: squares(coarse + offset), bounds=bounds, method="bounded", options={"xatol": LAG_TOLERANCE_NS}
    )
    return 0.0 if squares(0.0) <= fine.fun else float(coarse + fine.x)


def round_trips(recording: Recording, window: Window) -> np.ndarray:
    """Return reception minus command stamp of every answered sample inside the window [s]; shape (m,), may be empty."""
    answered, _ = _answered(recording, window)
    if answered is None:
        return np.empty(0)
    return (answered.stamps - answered.command_stamps) / NANOSECONDS


class _Answered(NamedTuple):
    stamps: np.ndarray
    positions: np.ndarray
    command_stamps: np.ndarray


def _answered(recording: Recording, window: Window) -> tuple[_Answered | None, int]:
    """Return the feedback inside the window that knows its command stamp, and how many do not."""
    feedback = recording.feedback
    if feedback is None:
        return None, 0
    inside = window.contains(feedback.stamps)
    known = inside & (feedback.command_stamps > 0)
    missing = int(np.count_nonzero(inside) - np.count_nonzero(known))
    if not known.any():
        return None, missing
    return _Answered(feedback.stamps[known], feedback.positions[known], feedback.command_stamps[known]), missing


def _align_command(name: str, recording: Recording, window: Window, lag_ns: float) -> Alignment | None:
    answered, missing = _answered(recording, window)
    if answered is None:
        return None
    times = (answered.command_stamps - window.start).astype(float) - lag_ns
    return _paired(name, answered.stamps, times, answered.positions, TwinPath(recording.twin, window.start), missing)


def _paired(name, stamps, times, measured, path: TwinPath, missing: int = 0) -> Alignment:
    covered = path.covers(times)
    if not covered.any():
        raise ConstructionTwinError(f"alignment {name}: no physical sample of that time meets the twin's recording")
    errors = measured[covered] - path(times[covered])
    return Alignment(name, stamps[covered], errors, missing + int(np.count_nonzero(~covered)))


@dataclass(frozen=True)
class Evaluation:
    """A recording with its alignments; `lag_ns`: estimated constant lag [ns]."""

    recording: Recording
    window: Window
    lag_ns: float | None
    alignments: dict[str, Alignment | None]


def evaluate(recording: Recording) -> Evaluation:
    """Align a recording by every method for which it holds the data.

    The window is that of `task_window`, extended by the median round trip and the lag, so that the samples which answer the last
    waypoint belong to it.
    """
    window = task_window(recording)
    trips = round_trips(recording, window)
    round_trip = int(np.median(trips) * NANOSECONDS) if len(trips) else 0
    lag_ns = estimate_lag(recording, window.extended(round_trip))
    window = window.extended(round_trip + int(lag_ns or 0))
    return Evaluation(
        recording=recording,
        window=window,
        lag_ns=lag_ns,
        alignments={
            "by_command": align_by_command(recording, window),
            "instant": align_instant(recording, window),
            "expected": align_expected(recording, window),
            "lag_removed": None if lag_ns is None else align_lag_removed(recording, window, lag_ns),
        },
    )
