"""From a separation distance to a speed limit: how near a person is to the arm, and how fast it may move then.

Pure; times are arguments, in ns on a monotonic clock; distances in m. An example of a source, not a safety function: neither
sensor, nor table, nor this program are safety rated.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.units import NANOSECONDS


class SpeedTable:
    """Fraction of the planned speed by distance: straight lines between the rows, constant beyond the first and the last.

    Args:
        rows: Distance [m], not negative and rising; fraction, 0 to 1 and never falling.

    Raises:
        ConfigurationError: Naming the first row that does not fit.
    """

    def __init__(self, rows: Sequence[Sequence[float]]):
        if not rows:
            raise ConfigurationError(
                "table", list(rows), "at least one row [distance in m, fraction of the planned speed]"
            )
        before: Sequence[float] = (-math.inf, 0.0)
        for number, row in enumerate(rows, 1):
            if len(row) != 2 or not all(map(math.isfinite, row)):
                raise ConfigurationError(
                    f"table, row {number}", list(row), "[distance in m, fraction of the planned speed]"
                )
            if not (row[0] >= 0.0 and row[0] > before[0]):
                raise ConfigurationError(
                    f"table, row {number}", row[0], "distances from 0 on, each above the one before"
                )
            if not before[1] <= row[1] <= 1.0:
                raise ConfigurationError(f"table, row {number}", row[1], "fractions from 0 to 1 that do not fall")
            before = row
        self._distances = [float(row[0]) for row in rows]
        self._fractions = [float(row[1]) for row in rows]

    @property
    def lowest(self) -> float:
        """Fraction of the nearest row."""
        return self._fractions[0]

    def fraction(self, distance: float) -> float:
        """Return the fraction of the planned speed at a distance [m], which may be inf."""
        after = bisect_right(self._distances, distance)
        if after == 0:
            return self._fractions[0]
        if after == len(self._distances):
            return self._fractions[-1]
        near, far = self._distances[after - 1], self._distances[after]
        low, high = self._fractions[after - 1], self._fractions[after]
        return low + (high - low) * (distance - near) / (far - near)


class SeparationLimit:
    """The newest distance of one sensor, with a deadline: a silent sensor means the lowest fraction.

    Args:
        deadline: A distance counts this long [s].
    """

    def __init__(self, table: SpeedTable, deadline: float):
        self._table = table
        self._deadline = round(deadline * NANOSECONDS)
        self._distance = math.nan
        self._measured = 0
        self._heard_at: int | None = None

    def on_range(self, distance: float, nearest: float, farthest: float, measured: int, now: int) -> None:
        """Take a measured distance.

        Args:
            distance: [m]; inf: nothing within reach of the sensor, -inf: something too near to tell how near (REP 117). A finite
                distance below `nearest` is taken for -inf: there are sensors that report it so.
            nearest, farthest: What the sensor can tell apart [m].
            measured: Stamp of the measurement [ns]; 0 when the sensor gives none.
            now: Time of reception [ns].

        Raises:
            PayloadError: ``distance`` or ``repeated``; nothing has changed then, and the deadline runs on.
        """
        if 0.0 <= distance < nearest:
            distance = -math.inf
        if math.isnan(distance) or (math.isfinite(distance) and not max(nearest, 0.0) <= distance <= farthest):
            expected = f"{max(nearest, 0.0):g} to {farthest:g} m, or inf or -inf"
            raise PayloadError("distance", f"the sensor reports a distance of {distance} m; expected {expected}")
        # a stamp that falls back is believed of a sensor that was silent: it, or its clock, may have been restarted
        if measured and (measured == self._measured or (measured < self._measured and self._in_time(now))):
            raise PayloadError("repeated", f"the sensor repeats its measurement of {measured} ns; expected a newer one")
        self._distance, self._measured, self._heard_at = distance, measured or self._measured, now

    def _in_time(self, now: int) -> bool:
        return self._heard_at is not None and now - self._heard_at <= self._deadline

    def update(self, now: int) -> tuple[float, str]:
        """Return the fraction of the planned speed that may be used at `now` [ns], and why."""
        lowest = self._table.lowest
        if self._heard_at is None:
            return lowest, "no separation distance was measured yet"
        if not self._in_time(now):
            return lowest, f"no separation distance for more than {self._deadline / NANOSECONDS:g} s"
        if self._distance == math.inf:
            return self._table.fraction(math.inf), "nobody within reach of the sensor"
        if self._distance == -math.inf:
            return lowest, "nearer than the sensor can tell"
        return self._table.fraction(self._distance), f"separation {self._distance:.2f} m"
