"""The way back out of an engaged segment: the executed path in reverse, slowly, with every sample on that path.

Joint vectors in the order of `RobotModel.joint_names`, SI. The path is not searched, smoothed or cut short: the positions are those
of the executed trajectory, at other times. Contacts and limits are checked afterwards, as those of any work plan.
"""

from __future__ import annotations

import numpy as np

from construction_twin.core.motion_errors import PlanningError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.planning.limit_usage import SAME_POINT, sampled_usage
from construction_twin.planning.recheck import ROUNDING
from construction_twin.planning.timing import time_path
from construction_twin.planning.work_plan import joined
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.executed_path import LARGEST_ENTRY, WAY_BACK_TOLERANCE, ExecutedPath
from construction_twin.robot.trajectory import Trajectory, whole_nanoseconds

#: Name of the planner in the plan, and of its one segment.
WAY_BACK = "way back"
#: Pace of the way back, as a fraction of the pace of the way there; where it goes straight to the path, of the velocity limits.
PACE, ENTRY_SPEED = 0.25, 0.05
#: From rest to that pace [s]; doubled until the limits hold, at most so often.
RAMP, DOUBLINGS = 0.5, 8
#: Spacing of the waypoints while the pace rises [s], and the least distance of two [s].
SPACING, CLOSEST = 0.01, 1e-4


def way_back(path: ExecutedPath, present: JointValues, robot: RobotModel) -> Trajectory:
    """Return the motion from where the arm is back along a path to its beginning.

    Args:
        present: Length n. The arm's pose. Beside the path by more than a quarter of `WAY_BACK_TOLERANCE`, it goes straight to the
            nearest point of it first, and rests there.

    Returns:
        Begins where the arm is, to that quarter.

    Raises:
        PlanningError: If the arm is too far from the path, or at its beginning already, or the path cannot be gone back within the
            limits.
    """
    pose = np.array(present, dtype=float)
    if path.trajectory.joint_names != tuple(robot.joint_names):
        names = {"found": ", ".join(path.trajectory.joint_names), "joints": ", ".join(robot.joint_names)}
        raise PlanningError(Sentence("motion.back.joints", **names))
    entry = path.entry(pose)
    if entry.distance > LARGEST_ENTRY:
        distances = {"away": Quantity(entry.distance, "rad"), "most": Quantity(LARGEST_ENTRY, "rad")}
        raise PlanningError(Sentence("motion.back.beside", **distances))
    begin, there = path.trajectory.positions[0], path.trajectory.sample(entry.time)[0]
    if np.max(np.abs(pose - begin)) <= SAME_POINT:
        raise PlanningError(Sentence("motion.back.there"))
    at_begin = np.max(np.abs(there - begin)) <= SAME_POINT
    parts = []
    if entry.distance > WAY_BACK_TOLERANCE / 4 or at_begin:
        parts.append(time_path(np.array([pose, there]), robot, speed_scale=ENTRY_SPEED))
    if not at_begin:
        parts.append(_reversed(path.trajectory, entry.time, robot))
    return joined(parts)[0]


def _reversed(trajectory: Trajectory, begin: float, robot: RobotModel) -> Trajectory:
    """Return the motion from rest at a time along a trajectory back to its beginning, at `PACE`."""
    ramp = RAMP
    for _ in range(DOUBLINGS):
        back = _at_pace(trajectory, begin, ramp)
        usage = sampled_usage(back, robot)
        if max(np.max(usage.velocity), np.max(usage.acceleration), np.max(usage.jerk)) <= 1.0 + ROUNDING:
            return back
        ramp *= 2.0
    raise PlanningError(Sentence("motion.back.too_fast", seconds=ramp / 2))


def _at_pace(trajectory: Trajectory, begin: float, ramp: float) -> Trajectory:
    """Return the way back with a pace that rises over `ramp` [s] and then stays.

    The pace stays to the end: where the executed path begins, it rests. A waypoint is set wherever the executed path has one: so
    the quintics between waypoints are those of that path where the pace is constant, and closely so where it rises.
    """
    gone = _Ramp(ramp)
    knots = trajectory.times[trajectory.times < begin]
    times = np.concatenate((np.arange(0.0, min(ramp, float(gone.when(begin))), SPACING), gone.when(begin - knots)))
    times = whole_nanoseconds(np.unique(times))
    # what lies too close before a waypoint is left out, never the end
    kept = np.append(np.diff(times) > CLOSEST, True)
    kept[0] = True
    times = times[kept]
    s, sd, sdd = gone.states(times)
    q, qd, qdd, _ = trajectory.sample_many(np.clip(begin - s, 0.0, None))
    velocities, accelerations = -qd * sd[:, None], qdd * sd[:, None] ** 2 - qd * sdd[:, None]
    q[0], q[-1] = trajectory.sample(begin)[0], trajectory.positions[0]
    velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
    return Trajectory(trajectory.joint_names, times, q, velocities, accelerations)


class _Ramp:
    """How far along the path the way back has come [s of the path] at a time: from rest, smooth up to the jerk, then at `PACE`."""

    def __init__(self, ramp: float):
        self._ramp = ramp
        self._table = np.linspace(0.0, ramp, 2001)
        self._reached = self.states(self._table)[0]

    def states(self, times) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the way, its rate and the rate's rate at some times [s]."""
        x = np.clip(np.asarray(times) / self._ramp, 0.0, 1.0)
        way = PACE * self._ramp * x**4 * (2.5 - 3.0 * x + x**2) + PACE * np.clip(times - self._ramp, 0.0, None)
        rate = PACE * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        return way, rate, PACE * 30.0 * x**2 * (1.0 - x) ** 2 / self._ramp

    def when(self, way) -> np.ndarray:
        """Return when so much of the way is gone [s]."""
        rest = np.clip(np.asarray(way) - self._reached[-1], 0.0, None) / PACE
        return np.interp(way, self._reached, self._table) + rest
