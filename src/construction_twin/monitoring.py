"""Algorithm 1 of the paper: do twin and physical arm agree, and may the next pose pass?

Pure: time comes in as an argument (ns). Angles in rad, joints in the robot's order.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from construction_twin.rsi.interpolation import interpolate
from construction_twin.units import CYCLE_NS, NANOSECONDS

#: Twin poses kept for comparison by command stamp: 2 s.
HISTORY = 500


def next_pose(
    theta_virtual: tuple[float, ...],
    theta_physical: tuple[float, ...],
    theta_next: tuple[float, ...],
    threshold: tuple[float, ...],
) -> tuple[tuple[float, ...], bool]:
    """Choose the pose to execute next: Algorithm 1, line by line.

    Parameters
    ----------
    theta_virtual, theta_physical, theta_next : tuple, shape (n,)
        Joint angles of the twin, of the physical arm, and of the next setpoint [rad].
    threshold : tuple, shape (n,)
        Largest difference that still counts as agreement, per joint [rad].

    Returns
    -------
    theta : tuple, shape (n,)
        `theta_next`, or `theta_virtual` when any joint differs by more than its threshold.
    replan : bool
        True when the trajectory must be planned anew from `theta`.

    References
    ----------
    Liang et al., section 3.3, Algorithm 1.
    """
    for virtual, physical, limit in zip(theta_virtual, theta_physical, threshold):
        # written so that a nan does not pass
        if not abs(virtual - physical) <= limit:
            return theta_virtual, True
    return theta_next, False


class TwinHistory:
    """The twin's recent poses by stamp, so that a delayed physical pose meets the twin's pose for the same command."""

    def __init__(self):
        self._poses: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=HISTORY)

    @property
    def latest(self) -> tuple[int, tuple[float, ...]] | None:
        """Newest stamp [ns] and pose [rad], or None."""
        return self._poses[-1] if self._poses else None

    def add(self, stamp: int, q: tuple[float, ...]) -> None:
        """Append a pose; one that is not newer than the newest is ignored."""
        if not self._poses or stamp > self._poses[-1][0]:
            self._poses.append((stamp, q))

    def at(self, stamp: int) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Return pose [rad] and velocity [rad/s] at `stamp` [ns], or None when it lies outside what is kept.

        Between two poses the playout's own interpolation is used.
        """
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
    """One physical pose compared with the twin.

    Attributes
    ----------
    at : int
        When the physical pose was received [ns].
    mode : str
        ``command_stamp`` or ``instant``.
    theta_virtual, theta_physical, threshold : tuple, shape (n,)
        [rad]
    round_trip : float
        Reception minus command stamp [s]; nan when unknown.
    """

    at: int
    mode: str
    theta_virtual: tuple[float, ...]
    theta_physical: tuple[float, ...]
    threshold: tuple[float, ...]
    round_trip: float

    @property
    def error(self) -> tuple[float, ...]:
        """|physical - twin| per joint [rad]."""
        return tuple(abs(p - v) for p, v in zip(self.theta_physical, self.theta_virtual))

    @property
    def agrees(self) -> bool:
        """True when Algorithm 1 lets the next pose pass."""
        return not next_pose(self.theta_virtual, self.theta_physical, self.theta_virtual, self.threshold)[1]

    def worst(self) -> int:
        """Index of the joint that uses most of its threshold."""
        shares = [error / limit for error, limit in zip(self.error, self.threshold)]
        return shares.index(max(shares))


class PoseComparison:
    """Compares each physical pose with the twin.

    Parameters
    ----------
    threshold : float
        Agreement at rest [rad]; the project's default is 0.01.
    lag_allowance : float
        Seconds of servo lag to allow for at the commanded velocity: adds `lag_allowance` times |velocity| [s].
    """

    def __init__(self, threshold: float, lag_allowance: float):
        self.threshold = threshold
        self.lag_allowance = lag_allowance
        self.twin = TwinHistory()
        self.last: Comparison | None = None

    def compare(self, q: tuple[float, ...], command_stamp: int, now: int) -> Comparison | None:
        """Compare a physical pose.

        Parameters
        ----------
        q : tuple, shape (n,)
            Physical pose [rad].
        command_stamp : int
            Stamp of the command it answers to [ns]; 0 compares with the twin's present pose.
        now : int
            Time of reception, on the clock of the stamps [ns].

        Returns
        -------
        comparison : Comparison or None
            None when the twin's pose for that stamp is not known.
        """
        mode = "command_stamp" if command_stamp else "instant"
        if command_stamp:
            reference = self.twin.at(command_stamp)
        else:
            reference = (self.twin.latest[1], self._present_velocity()) if self.twin.latest else None
        if reference is None:
            return None
        virtual, velocity = reference
        threshold = tuple(self.threshold + self.lag_allowance * abs(v) for v in velocity)
        round_trip = (now - command_stamp) / NANOSECONDS if command_stamp else math.nan
        self.last = Comparison(now, mode, virtual, q, threshold, round_trip)
        return self.last

    def _present_velocity(self) -> tuple[float, ...]:
        stamp, q = self.twin.latest
        before = self.twin.at(stamp - CYCLE_NS)
        return before[1] if before else (0.0,) * len(q)
