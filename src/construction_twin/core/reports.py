"""What gate, bridge and executor report: one record per message, for every folder that shows or acts on it.

Each field has the name that it has in the ROS message; times are whole ns of ROS time, and lists are tuples in the order of the
message. SI unless a name says otherwise. Records only: what follows from them is decided where it matters. Standard library only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from construction_twin.core.units import seconds


@dataclass(frozen=True)
class SyncReport:
    """The gate's report: `Sync.msg`.

    Attributes:
        text: State as a word; `state` is its number.
        error, threshold: Length n. [rad], [m] for prismatic joints; empty while nothing is compared.
        round_trip, servo_lag: [s]; nan when unknown.
        violations: How often the gate left IN_SYNC.
        agreed: Twin and arm agree, whatever the state.
        held_stamp: Nominal time of the last setpoint that passed [ns]; 0 for none.
    """

    text: str
    reason: str
    policy: str = ""
    comparison: str = ""
    error: tuple[float, ...] = ()
    threshold: tuple[float, ...] = ()
    round_trip: float = math.nan
    servo_lag: float = math.nan
    violations: int = 0
    agreed: bool = False
    name: tuple[str, ...] = ()
    held_stamp: int = 0
    state: int = 0
    stamp: int = 0


@dataclass(frozen=True)
class LinkReport:
    """The bridge's report: `Link.msg`, without its histogram.

    Attributes:
        text: State as a word; `state` is its number.
        gateway_counters: What the gateway counts, and says of its playout and controller.
        responsible: Who has armed a bare PLC; empty otherwise.
        not_checked: What is not checked with a bare PLC, one sentence each.
        gateway_kind: `rsi`, or `plc` for a bare one.
    """

    text: str
    reason: str
    gateway_state: str = ""
    gateway_counters: Mapping[str, str] = field(default_factory=dict)
    commands_refused: int = 0
    states_refused: int = 0
    responsible: str = ""
    not_checked: tuple[str, ...] = ()
    gateway_kind: str = ""
    session: str = ""
    state: int = 0
    stamp: int = 0

    @property
    def late(self) -> int | None:
        """How many replies came too late at the controller; None when the gateway has not said anything."""
        # a counter appears with its first use
        return int(self.gateway_counters.get("late_replies", "0")) if self.gateway_counters else None


@dataclass(frozen=True)
class ExecutionReport:
    """The executor's report: `Execution.msg`.

    Attributes:
        text: State as a word; `state` is its number.
        plan_id: Of the plan that is played, or of the last one; empty for none.
        outcome: Of the last plan; empty: none has ended.
        plan_start: Nominal time of the plan's first setpoint [ns]; 0 for none.
        duration: Of the plan as planned [s].
        rate, speed_limit: Fraction of the planned speed now, and the fraction that is allowed.
        segment, segment_name: Of a work plan: where it is, from 0; -1 without.
        at_boundary, wants_scene: It stands at the end of that segment; and waits for the scene to change.
        engaged: Only the way back along the executed path can be planned.
        expected_scene: Hash of the scene that is waited for; empty for none.
        stamp: Of the report [ns].
    """

    text: str
    reason: str
    plan_id: str = ""
    outcome: str = ""
    plan_start: int = 0
    duration: float = 0.0
    rate: float = 0.0
    speed_limit: float = 1.0
    segment: int = -1
    segment_name: str = ""
    at_boundary: bool = False
    wants_scene: bool = False
    engaged: bool = False
    expected_scene: str = ""
    state: int = 0
    stamp: int = 0

    def progress(self, now: float) -> float | None:
        """Return how much of a plan's time is over at `now` [s], 0 to 1; None unless a plan is being played."""
        if self.text != "PLAYING" or not self.plan_start or self.duration <= 0.0:
            return None
        return min(1.0, max(0.0, (now - seconds(self.plan_start)) / self.duration))
