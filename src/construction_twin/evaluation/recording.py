"""A recorded run as plain arrays: the input of an evaluation, independent of the file format.

Stamps are int64 nanoseconds, positions float64 rad, columns in the order of `Recording.joint_names`. No ROS here:
`bag` makes these of a bag's messages, a simulation may fill them directly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import NANOSECONDS


@dataclass(frozen=True)
class Stream:
    """Joint positions over time.

    Attributes
    ----------
    stamps : array, shape (k,), int64
        Header stamps [ns].
    positions : array, shape (k, n)
        [rad]
    received : array, shape (k,), int64
        When the recorder received each message [ns].
    """

    stamps: np.ndarray
    positions: np.ndarray
    received: np.ndarray

    def __post_init__(self):
        if self.positions.ndim != 2 or not len(self.stamps) == len(self.positions) == len(self.received):
            shapes = f"{self.stamps.shape}, {self.positions.shape}, {self.received.shape}"
            raise ConstructionTwinError(
                f"stamps, positions and received have shapes {shapes}; expected (k,), (k, n), (k,)"
            )
        if not np.isfinite(self.positions).all():
            raise ConstructionTwinError("a recorded joint position is not a finite number; the recording is damaged")

    def __len__(self) -> int:
        return len(self.stamps)


@dataclass(frozen=True)
class FeedbackStream(Stream):
    """Physical joint positions with the command they answer to.

    Attributes
    ----------
    seq : array, shape (k,)
        The gateway's state counter; 0 = unknown.
    command_stamps : array, shape (k,), int64
        Playout time, on the command sender's clock, of the target each pose answers to [ns]; 0 = unknown.
    """

    seq: np.ndarray
    command_stamps: np.ndarray


@dataclass(frozen=True)
class PlayedPlan:
    """One execution of a plan.

    Attributes
    ----------
    plan_id : str
    start : int
        Nominal stamp of its first setpoint [ns].
    duration : float
        [s]
    outcome : str
        ``finished``, ``stopped``, ``held``, ``dropped``; empty when the recording ends before the plan does.
    """

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
    """The bridge's report at one moment.

    Attributes
    ----------
    received : int
        [ns]
    session : str
        Id of the command session at that moment.
    commands_sent : int
        Since the bridge started.
    counters : Mapping of str to str
        The gateway's counters as it reported them.
    reply_bins : tuple of int
        Upper bin edges of the histogram of RSI reply times [us].
    reply_counts : tuple of int
        Counts per bin since the gateway started; one more than `reply_bins`, the last being overflow.
    """

    received: int
    session: str
    commands_sent: int
    counters: Mapping[str, str] = field(default_factory=dict)
    reply_bins: tuple[int, ...] = ()
    reply_counts: tuple[int, ...] = ()

    def counter(self, name: str) -> int | float | None:
        """Return a gateway counter, or None when it is not reported or not a number."""
        text = self.counters.get(name, "")
        try:
            return int(text) if text.lstrip("-").isdigit() else float(text)
        except ValueError:
            return None


@dataclass(frozen=True)
class StateChange:
    """One change of state that was reported.

    Attributes
    ----------
    stamp : int
        ROS time of the change [ns].
    source : str
        What reported it: ``gate``, ``execution``, ``link``.
    state : str
        The new state's word.
    reason : str
        One sentence; may be empty.
    """

    stamp: int
    source: str
    state: str
    reason: str


@dataclass(frozen=True)
class Recording:
    """One robot's run.

    Attributes
    ----------
    robot : str
        The robot's namespace, e.g. ``/kr120``.
    joint_names : tuple of str, length n
        The joints both twin and physical report, in the twin's order.
    twin, physical : Stream
        The physical stream's stamps are ROS time at reception in the bridge, the twin's the nominal time of the command
        it executes.
    feedback : FeedbackStream or None
        One sample per physical sample, with its command stamp.
    command : Stream or None
        What the gate let through.
    plans : tuple of PlayedPlan
        In order of their start.
    waypoints : Mapping of str to int
        Number of waypoints of each recorded plan id.
    links : tuple of LinkSnapshot
        In order of reception.
    mock : Mapping or None
        The mock controller's status (keys ``state``, ``counters``, ``config``); None when no mock reported, so that the arm
        may have been a real one.
    changes : tuple of StateChange
        In order of time.
    linear : tuple of str
        Those of `joint_names` that are prismatic: m in place of rad. A bag does not say so; `write_report` takes it from the robot.

    Raises
    ------
    ConstructionTwinError
        If there are no joints, a stream has another number of columns, or twin or physical hold fewer than two samples.
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

    def __post_init__(self):
        if not self.joint_names:
            raise ConstructionTwinError(
                "twin and physical arm report no joint in common; check the joint names in the recording"
            )
        for name in ("twin", "physical"):
            count = len(getattr(self, name))
            if count < 2:
                raise ConstructionTwinError(
                    f"the recording holds {count} {name} samples; a comparison needs at least 2"
                )
        for name in ("twin", "physical", "feedback", "command"):
            stream = getattr(self, name)
            if stream is not None and stream.positions.shape[1] != len(self.joint_names):
                raise ConstructionTwinError(
                    f"{name} has {stream.positions.shape[1]} joints, expected {len(self.joint_names)}"
                )

    @property
    def finished_plans(self) -> tuple[PlayedPlan, ...]:
        """The plans played to their end, except those from before the recording, which a latched topic may still report."""
        begin = int(self.twin.stamps.min())
        return tuple(plan for plan in self.plans if plan.outcome == "finished" and plan.start >= begin)
