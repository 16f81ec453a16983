"""The gate: Algorithm 1 in the command path. Nothing reaches either robot that has not passed here.

Pure: time is an argument, in ns on the clock of the stamps. Angles in rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from construction_twin.errors import MotionRefused, PayloadError
from construction_twin.limits import MotionCheck, MotionLimits
from construction_twin.monitoring import Comparison, PoseComparison, next_pose
from construction_twin.mqtt.codec import JointStringCodec
from construction_twin.units import CYCLE_NS, NANOSECONDS


class SyncState(Enum):
    """State of the pose checking algorithm; values are those of `Sync.msg`."""

    WAITING = 0
    IN_SYNC = 1
    HOLDING = 2
    STALE = 3
    REFUSING = 4


@dataclass(frozen=True)
class GateSettings:
    """How strict the gate is.

    Attributes
    ----------
    threshold : float
        Agreement at rest [rad].
    lag_allowance : float
        [s], see `PoseComparison`.
    feedback_timeout : float
        Physical feedback older than this counts as out of sync [s].
    agree_time : float
        The poses must agree this long before the gate opens [s].
    compares : bool
        False without a physical arm: the gate then only checks the motion.
    """

    threshold: float = 0.01
    lag_allowance: float = 0.05
    feedback_timeout: float = 0.1
    agree_time: float = 0.1
    compares: bool = True


class Gate:
    """Passes theta_next, or holds theta_virtual.

    theta_virtual is the twin's present pose. A command that is still on its way to the twin counts as executed: holding anything
    older would send both robots a step backwards.

    Parameters
    ----------
    limits : MotionLimits
    codec : JointStringCodec
        The wire's; everything that passes is rounded by it, so that both robots execute identical numbers.
    settings : GateSettings
    """

    def __init__(self, limits: MotionLimits, codec: JointStringCodec, settings: GateSettings):
        self._limits = limits
        self._codec = codec
        self.settings = settings
        self.violations = 0
        self.refused = 0
        self.restart("started")

    def restart(self, reason: str) -> None:
        """Close the gate and forget every pose: twin and arm start over."""
        self.comparison = PoseComparison(self.settings.threshold, self.settings.lag_allowance)
        self.state = SyncState.WAITING
        self.reason = reason
        self._check = MotionCheck(self._limits, self._codec.decimals)
        self._agreed_since: int | None = None
        self._stamp = 0

    @property
    def held(self) -> tuple[float, ...]:
        """Last command that passed [rad], which a closed gate repeats; empty while it has never been open."""
        return self._check.position

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Take the twin's pose [rad] with the stamp of the command it executes [ns]."""
        self.comparison.twin.add(stamp, q)

    def on_physical(self, q: tuple[float, ...], command_stamp: int, now: int) -> Comparison | None:
        """Take a physical pose; see `PoseComparison.compare`."""
        continued = self._fresh(now)
        comparison = self.comparison.compare(q, command_stamp, now)
        if comparison is None:
            return None
        if not comparison.agrees:
            self._agreed_since = None
        elif self._agreed_since is None or not continued:
            self._agreed_since = now
        return comparison

    def agreed(self, now: int) -> bool:
        """True when fresh feedback has agreed with the twin for `agree_time`."""
        if not self.settings.compares:
            return self.comparison.twin.latest is not None
        return (
            self._fresh(now)
            and self._agreed_since is not None
            and self.comparison.last.at - self._agreed_since >= self.settings.agree_time * NANOSECONDS
        )

    def pass_next(self, stamp: int, theta_next: tuple[float, ...], now: int) -> tuple[float, ...] | None:
        """Decide what is executed in place of theta_next.

        Parameters
        ----------
        stamp : int
            Nominal time of the setpoint [ns].
        theta_next : tuple, shape (n,)
            [rad]
        now : int
            [ns]

        Returns
        -------
        command : tuple, shape (n,) or None
            Pose to execute, rounded to the wire [rad]; None while the gate has never been open, and for a setpoint that is not
            newer than the last one: whatever went out with its stamp would be refused further on.
        """
        if stamp <= self._stamp:
            self.refused += 1
            return None
        self._stamp = stamp
        if self.state is not SyncState.IN_SYNC:
            self._try_to_open(stamp, theta_next, now)
        else:
            self.watch(now)
        if self.state is SyncState.WAITING:
            return None
        if self.state is not SyncState.IN_SYNC:
            return self._check.position
        return self._checked(stamp, theta_next)

    def watch(self, now: int) -> None:
        """Close an open gate when feedback has gone stale or differs: also while nobody sends theta_next."""
        if self.state is SyncState.IN_SYNC and not self._may_stay_open(now):
            self.violations += 1

    def _fresh(self, now: int) -> bool:
        last = self.comparison.last
        return last is not None and now - last.at <= self.settings.feedback_timeout * NANOSECONDS

    def _may_stay_open(self, now: int) -> bool:
        if not self.settings.compares:
            return True
        last = self.comparison.last
        if not self._fresh(now):
            self._enter(SyncState.STALE, f"last comparable feedback is {(now - last.at) / NANOSECONDS:.3f} s old")
            return False
        held = self._check.position
        if next_pose(last.theta_virtual, last.theta_physical, held, last.threshold)[1]:
            joint = last.worst()
            self._enter(
                SyncState.HOLDING,
                f"{self._limits.names[joint]} differs by {last.error[joint]:.6f} rad, threshold {last.threshold[joint]:.6f} rad",
            )
            return False
        return True

    def _try_to_open(self, stamp: int, theta_next: tuple[float, ...], now: int) -> None:
        if not self.agreed(now):
            return
        held = self.comparison.twin.latest[1] if self.state is SyncState.WAITING else self._check.position
        try:
            trial = MotionCheck(self._limits, self._codec.decimals)
            trial.start(stamp - CYCLE_NS, self._codec.quantise(held))
            trial.accept(stamp, self._codec.quantise(theta_next))
        except (MotionRefused, PayloadError) as refusal:
            self.reason = f"{self.reason.split('; not opened: ')[0]}; not opened: {refusal}"
            return
        self._check.start(stamp - CYCLE_NS, self._codec.quantise(held))
        self._enter(SyncState.IN_SYNC, "poses agree and the stream continues from the held pose")

    def _checked(self, stamp: int, theta_next: tuple[float, ...]) -> tuple[float, ...]:
        try:
            command = self._codec.quantise(theta_next)
            self._check.accept(stamp, command)
        except (MotionRefused, PayloadError) as refusal:
            self.refused += 1
            self.violations += 1
            self._enter(SyncState.REFUSING, str(refusal))
            return self._check.position
        return command

    def _enter(self, state: SyncState, reason: str) -> None:
        self.state, self.reason = state, reason
        # whatever closed the gate, agreement counts from now on
        if state is not SyncState.IN_SYNC:
            self._agreed_since = None
