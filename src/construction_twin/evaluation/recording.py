"""A recorded run as plain arrays: the input of an evaluation, made by `bag` or filled by a simulation.

Stamps are int64 nanoseconds, positions float64 rad, columns in the order of `Recording.joint_names`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import NANOSECONDS


@dataclass(frozen=True)
class Stream:
    """Joint positions over time: header stamps [ns] and when the recorder received each message [ns], shape (k,); (k, n) [rad]."""

    stamps: np.ndarray
    positions: np.ndarray
    received: np.ndarray

    def __post_init__(self):
        if self.positions.ndim != 2 or not len(self.stamps) == len(self.positions) == len(self.received):
            shapes = f"{self.stamps.shape}, {self.positions.shape}, {self.received.shape}"
            raise ConstructionTwinError(f"stamps, positions, received of {shapes}; expected (k,), (k, n), (k,)")
        if not np.isfinite(self.positions).all():
            raise ConstructionTwinError("a recorded joint position is not a finite number; the recording is damaged")

    def __len__(self) -> int:
        return len(self.stamps)


@dataclass(frozen=True)
class FeedbackStream(Stream):
    """Physical joint positions, the gateway's state counter, and playout time of the target each answers to [ns]; 0: unknown."""

    seq: np.ndarray
    command_stamps: np.ndarray


@dataclass(frozen=True)
class PlayedPlan:
    """One execution of a plan: nominal stamp of its first setpoint [ns], duration [s]; `outcome` is empty while it is under way."""

    plan_id: str
    start: int
    duration: float
    outcome: str

    @property
    def end(self) -> int:
        """Nominal stamp of the last setpoint [ns]."""
        return self.start + round(self.duration * NANOSECONDS)


@dataclass(frozen=True)
class LinkSnapshot:
    """The bridge's report at one moment [ns], with the gateway's counters.

    `reply_bins`: upper bin edges of the histogram of RSI reply times [us]; `reply_counts` has one more, the overflow.
    """

    received: int
    session: str
    commands_sent: int
    counters: Mapping[str, str] = field(default_factory=dict)
    reply_bins: tuple[int, ...] = ()
    reply_counts: tuple[int, ...] = ()

    def counter(self, name: str) -> int | float | None:
        """Return a counter that the gateway reports as a number, else None."""
        text = self.counters.get(name, "")
        try:
            return int(text) if text.lstrip("-").isdigit() else float(text)
        except ValueError:
            return None


@dataclass(frozen=True)
class StateChange:
    """One change of state that ``gate``, ``execution`` or ``link`` reported, at a ROS time [ns]."""

    stamp: int
    source: str
    state: str
    reason: str


@dataclass(frozen=True)
class Recording:
    """One robot's run.

    Attributes:
        robot: The robot's namespace, e.g. ``/kr120``.
        joint_names: Length n. The joints both twin and physical report, in the twin's order.
        twin, physical: The physical stream's stamps are ROS time at reception in the bridge, the twin's the nominal time of the
            command it executes.
        waypoints: Number of waypoints of each recorded plan id.
        mock: The mock controller's status (keys ``state``, ``counters``, ``config``); None: the arm may have been a real one.
        expected: Where the gate's model of the servos had the arm, stamped as the physical sample that it was compared with.
        linear: Those of `joint_names` that are prismatic: m in place of rad. A bag does not say so; `write_report` takes it from
            the robot.
    """

    robot: str
    joint_names: tuple[str, ...]
    twin: Stream
    physical: Stream
    feedback: FeedbackStream | None = None
    command: Stream | None = None
    plans: tuple[PlayedPlan, ...] = ()
    waypoints: Mapping[str, int] = field(default_factory=dict)
    links: tuple[LinkSnapshot, ...] = ()
    mock: Mapping | None = None
    linear: tuple[str, ...] = ()
    changes: tuple[StateChange, ...] = ()
    expected: Stream | None = None

    def __post_init__(self):
        count = len(self.joint_names)
        if not count:
            raise ConstructionTwinError(
                "twin and physical arm report no joint in common; check their names in the recording"
            )
        for name in ("twin", "physical", "feedback", "command", "expected"):
            stream = getattr(self, name)
            if stream is not None and stream.positions.shape[1] != count:
                raise ConstructionTwinError(f"{name} has {stream.positions.shape[1]} joints, expected {count}")
            if name in ("twin", "physical") and len(stream) < 2:
                raise ConstructionTwinError(
                    f"the recording holds {len(stream)} {name} samples; a comparison needs at least 2"
                )

    @property
    def finished_plans(self) -> tuple[PlayedPlan, ...]:
        """The plans played to their end, except those from before the recording, which a latched topic may still report."""
        begin = int(self.twin.stamps.min())
        return tuple(plan for plan in self.plans if plan.outcome == "finished" and plan.start >= begin)
