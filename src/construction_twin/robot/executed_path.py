"""The path that an arm has executed, for the way back; distances are the largest over the joints [rad], [m]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from construction_twin.core.units import CYCLE
from construction_twin.robot.trajectory import Trajectory

#: A way back lies this near to the executed path, at every setpoint: 0.5 mm at the tool of an arm of 2.5 m.
WAY_BACK_TOLERANCE = 2e-4
#: An arm that a hold or the gateway has brought to rest beside the path may go straight to it from at most this far.
LARGEST_ENTRY = 0.02


@dataclass(frozen=True)
class NearestPoint:
    """The time of the point of a path that is nearest to a pose [s], of several passages the last, and the distance to it."""

    time: float
    distance: float


@dataclass(frozen=True, eq=False)
class ExecutedPath:
    """A trajectory from its beginning, at rest, to the time along it that was reached at most [s]."""

    trajectory: Trajectory
    end: float

    def points(self, until: float | None = None) -> np.ndarray:
        """Return the poses on a grid of at most 4 ms up to a time, by default `end`; shape (k, n)."""
        return self.trajectory.sample_many(self._grid(self.end if until is None else until))[0]

    def nearest_point(self, pose: np.ndarray) -> NearestPoint:
        """Return where a pose, shape (n,), lies on the path or next to it."""
        times = self._grid(self.end)
        points = self.trajectory.sample_many(times)[0]
        fractions, distances = nearest_on_lines(points[:-1], points[1:], np.asarray(pose, dtype=np.float64))
        near = np.flatnonzero(distances <= distances.min() + WAY_BACK_TOLERANCE)
        # of a path that passes the pose several times, the last passage; within that, the nearest line
        breaks = np.flatnonzero(np.diff(near) > 1)
        last = near[breaks[-1] + 1 :] if len(breaks) else near
        best = int(last[np.argmin(distances[last])])
        time = times[best] + fractions[best] * (times[best + 1] - times[best])
        return NearestPoint(float(time), float(distances[best]))

    def _grid(self, until: float) -> np.ndarray:
        return np.linspace(0.0, until, max(2, math.ceil(until / CYCLE) + 1))


def nearest_on_lines(starts: np.ndarray, ends: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where on lines, shape (k, n), a pose, shape (n,), is nearest: 0 at the start, 1 at the end; and its distances."""
    way = ends - starts
    square = (way * way).sum(axis=1)
    along = ((pose - starts) * way).sum(axis=1)
    fractions = np.clip(np.divide(along, square, out=np.zeros_like(along), where=square > 0.0), 0.0, 1.0)
    return fractions, np.abs(starts + fractions[:, None] * way - pose).max(axis=1)
