"""Limits of what a request may ask of a plan, and of a plan's size; checked before anything of that size is computed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from construction_twin.core.limits import OUTSIDE
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.planning.limit_usage import SAME_POINT
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import PlanningError, TrajectoryError


class PlanSizeError(PlanningError):
    """A plan would be larger than this planner makes; `quantity` is ``duration`` [s], ``waypoints`` or ``length`` [m]."""

    _OF = {
        "duration": ("duration", "ask for a faster or shorter motion"),
        "waypoints": ("waypoints", "ask for fewer, or for a faster or shorter motion"),
        "length": ("length of the tool's path", "divide it into several"),
    }

    def __init__(self, quantity: str, value: float, limit: float):
        self.quantity, self.value, self.limit = quantity, value, limit
        what, to_do = self._OF[quantity]
        found, most = (
            f"{Quantity(number, 'm')}" if quantity == "length" else f"{number:g}{' s' * (quantity == 'duration')}"
            for number in (value, limit)
        )
        super().__init__(f"the plan's {what} would be {found}; this planner takes at most {most}, {to_do}")


#: A tool covers less than this from one waypoint of a trajectory to the next [m]: 2.5 m/s at the usual 20 ms.
TOOL_STEP = 0.05


@dataclass(frozen=True)
class PlanBounds:
    """The largest plan, in s and waypoints."""

    duration: float = math.inf
    waypoints: float = math.inf

    def check(self, duration: float, waypoints: float = 0) -> None:
        """Check a plan that is about to be made; PlanSizeError if it would be too large, or its duration [s] is no number."""
        if not duration <= self.duration:
            raise PlanSizeError("duration", duration, self.duration)
        if waypoints > self.waypoints:
            raise PlanSizeError("waypoints", waypoints, self.waypoints)

    def check_tool_path(self, length: float, speed: float | None) -> None:
        """Check the length of a tool path [m], and the time it takes at a speed of the tool [m/s] (None: any); PlanSizeError."""
        if speed is not None:
            self.check(length / speed)
        if not length <= TOOL_STEP * self.waypoints:
            raise PlanSizeError("length", length, TOOL_STEP * self.waypoints)


def check_request(
    duration: float | None, speed: float, acceleration: float, waypoints: int | None, corner_fraction: float | None
) -> None:
    """Check what a request asks of a plan besides its path; see `timing.time_path`. PlanningError names what is wrong."""
    if duration is not None and not 0.0 < duration < math.inf:
        raise PlanningError(f"the requested duration is {duration} s; expected a positive number")
    for name, scale in (("speed", speed), ("acceleration", acceleration)):
        if not 0.0 < scale <= 1.0:
            raise PlanningError(f"the requested {name} scale is {scale}; expected a fraction of the limits in (0, 1]")
    if waypoints is not None and waypoints < 2:
        raise PlanningError(f"{waypoints} waypoints are requested; a motion needs at least 2")
    if corner_fraction is not None and not 0.0 < corner_fraction <= 1.0:
        raise PlanningError(f"the requested corner fraction is {corner_fraction}; expected a number in (0, 1]")


def check_path(path: np.ndarray, robot: RobotModel) -> np.ndarray:
    """Return a checked copy of a path without repeated points; see `timing.time_path`, also for what it raises."""
    path = np.array(path, dtype=np.float64)
    joints = len(robot.joint_names)
    if path.ndim != 2 or path.shape[1] != joints or len(path) < 2:
        raise TrajectoryError(f"the path has shape {path.shape}; expected at least 2 points of {joints} joints")
    if not np.all(np.isfinite(path)):
        row, joint = np.argwhere(~np.isfinite(path))[0]
        found = f"{robot.joint_names[joint]} is {path[row, joint]}, not a finite number"
        raise TrajectoryError(f"point {row} of the path: {found}")
    for row in np.flatnonzero(np.any((path < robot.lower) | (path > robot.upper), axis=1)):
        robot.check_range(path[row], (0.0, 0.0) if row else OUTSIDE)
    apart = distinct(path)
    if not np.any(apart[1:]):
        raise TrajectoryError(Sentence("the arm is already there: the path's points are all the same; nothing to plan"))
    kept = path[apart]
    kept[-1] = path[-1]
    return kept


def distinct(path: np.ndarray) -> np.ndarray:
    """Return which points of a path, shape (m, n), are not the same as the one before: an array of bool, shape (m,)."""
    return np.concatenate(([True], np.max(np.abs(np.diff(path, axis=0)), axis=1) > SAME_POINT))
