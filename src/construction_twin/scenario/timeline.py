"""The time line of a run: changes with their moments; stamps are ROS time [ns]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from construction_twin.evaluation.recording import Recording


@dataclass(frozen=True)
class Change:
    """A change of a state, or something that was done.

    Attributes:
        stamp: [ns]
        topic: ``sync``, ``link``, ``execution``, ``outcome``, ``fault``, ``fault_end``, ``session`` (RSI's), ``call``, ``move``,
            ``approve``, ``refused`` (an approval).
    """

    stamp: int
    topic: str
    value: str
    reason: str = ""


@dataclass(frozen=True)
class SyncMoment:
    """The gate's measurement when it left a state: error and threshold [rad], empty where nothing was compared; lag [s], or nan."""

    stamp: int
    joints: tuple[str, ...]
    error: tuple[float, ...]
    threshold: tuple[float, ...]
    servo_lag: float


@dataclass(frozen=True)
class GatewayStop:
    """A stop as the gateway reported it at its end: distance of each joint to rest as stated, and as it moved [deg], [mm]."""

    cause: str
    stated: tuple[float, ...]
    moved: tuple[float, ...]


@dataclass(frozen=True)
class Run:
    """One recorded run of a scenario.

    Attributes:
        arm_stamps: Shape (k,), int64. [ns]
        arm: Shape (k, n). True joint positions of the mock arm, every cycle [rad].
        missed_at: Shape (m,), int64. When the controller reported missed replies [ns].
        failure: Why the run was cut short; empty: it was not.
        stated: Distance of each axis to rest, as the controller stated it when an emergency stop began [deg]; empty without one.
    """

    recording: Recording
    changes: tuple[Change, ...]
    closings: tuple[SyncMoment, ...]
    arm_stamps: np.ndarray
    arm: np.ndarray
    missed: int
    missed_at: np.ndarray
    failure: str = ""
    stops: tuple[GatewayStop, ...] = ()
    stated: tuple[float, ...] = ()

    @property
    def start(self) -> int:
        """Nominal stamp of the first motion's first setpoint [ns]; without one the first change."""
        plans = [plan.start for plan in self.recording.plans if plan.start >= self.arm_stamps[0]]
        return min(plans, default=self.changes[0].stamp if self.changes else int(self.arm_stamps[0]))

    def states(self, topic: str) -> list[str]:
        """Return the states of a topic since the start of the motion, with the one that stood then."""
        values = []
        for change in self.changes:
            if change.topic != topic:
                continue
            if change.stamp < self.start:
                values = [change.value]
            elif not values or values[-1] != change.value:
                values.append(change.value)
        return values

    def first(self, topic: str, value: str = "", since: int = 0) -> Change | None:
        """Return the first change of a topic (to a value) at or after a stamp [ns], or None."""
        return next((c for c in self.changes if c.topic == topic and c.stamp >= since and value in ("", c.value)), None)

    def last(self, topic: str) -> str:
        """Return a topic's last value; empty without one."""
        return next((c.value for c in reversed(self.changes) if c.topic == topic), "")
