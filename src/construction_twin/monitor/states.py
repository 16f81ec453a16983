"""The state machine of the pose checking algorithm: one table of states, events and the states that they lead to.

Pure. What causes an event is the gate's business; here it is only said what follows from it, and kept why.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from construction_twin.monitor.comparison import Comparison


class SyncState(Enum):
    """State of the pose checking algorithm; values are those of `Sync.msg`."""

    WAITING = 0
    IN_SYNC = 1
    HOLDING = 2
    REPLANNING = 3
    STALE = 4
    STOPPED = 5
    FAULT = 6


class SyncEvent(Enum):
    """What can happen to the gate; values are the words of `Transition.msg`."""

    STARTED = "started"
    NEW_SESSION = "new_session"
    MIRROR = "mirror"
    OPENED = "opened"
    POSE_DIFFERS = "pose_differs"
    FEEDBACK_STALE = "feedback_stale"
    SETPOINT_STALE = "setpoint_stale"
    SETPOINT_REFUSED = "setpoint_refused"
    REPLAN_ASKED = "replan_asked"
    REPLAN_FAILED = "replan_failed"
    POLICY_STOP = "policy_stop"
    ESCALATED = "escalated"
    GAVE_UP = "gave_up"
    STOPPED_BEFORE = "stopped_before"
    CONFIGURED = "configured"


_ANEW = {SyncEvent.NEW_SESSION: SyncState.WAITING, SyncEvent.MIRROR: SyncState.WAITING}
_GIVE_UP = {SyncEvent.OPENED: SyncState.IN_SYNC, SyncEvent.GAVE_UP: SyncState.STOPPED}
#: What may follow a violation at once.
_END = _GIVE_UP | {SyncEvent.POLICY_STOP: SyncState.STOPPED, SyncEvent.ESCALATED: SyncState.STOPPED}

#: State, event, next state. An event that a state's row does not name changes nothing in that state.
TABLE: dict[SyncState, dict[SyncEvent, SyncState]] = {
    SyncState.WAITING: _ANEW
    | {
        SyncEvent.STARTED: SyncState.WAITING,
        SyncEvent.CONFIGURED: SyncState.WAITING,
        SyncEvent.STOPPED_BEFORE: SyncState.STOPPED,
        SyncEvent.OPENED: SyncState.IN_SYNC,
    },
    SyncState.IN_SYNC: _ANEW
    | {
        SyncEvent.CONFIGURED: SyncState.IN_SYNC,
        SyncEvent.POSE_DIFFERS: SyncState.HOLDING,
        SyncEvent.FEEDBACK_STALE: SyncState.STALE,
        SyncEvent.SETPOINT_STALE: SyncState.STALE,
        SyncEvent.SETPOINT_REFUSED: SyncState.FAULT,
    },
    SyncState.HOLDING: _ANEW | _END | {SyncEvent.REPLAN_ASKED: SyncState.REPLANNING},
    SyncState.REPLANNING: _ANEW
    | _GIVE_UP
    | {SyncEvent.REPLAN_FAILED: SyncState.HOLDING, SyncEvent.ESCALATED: SyncState.STOPPED},
    SyncState.STALE: _ANEW
    | _GIVE_UP
    | {
        SyncEvent.POLICY_STOP: SyncState.STOPPED,
        SyncEvent.POSE_DIFFERS: SyncState.HOLDING,
        SyncEvent.REPLAN_ASKED: SyncState.REPLANNING,
    },
    # a source of setpoints that no robot can execute is not asked for a new plan
    SyncState.FAULT: _ANEW | _END,
    # a person has to see to it: only a new command session leads out
    SyncState.STOPPED: {SyncEvent.NEW_SESSION: SyncState.WAITING, SyncEvent.CONFIGURED: SyncState.STOPPED},
}

#: States of a gate that was closed by a violation, and may open again by itself.
HELD_STATES = frozenset(state for state, row in TABLE.items() if SyncEvent.GAVE_UP in row)


@dataclass(frozen=True)
class Transition:
    """One change of state.

    Attributes
    ----------
    at : int
        When [ns], on the gate's own clock, until the monitor reports it in ROS time.
    source, target : SyncState
    event : SyncEvent
    reason : str
        One sentence with the values.
    comparison : Comparison or None
        The newest comparison of the poses at that moment; None before the first.
    held_stamp : int
        Stamp of the last setpoint that passed [ns]; 0 when none.
    """

    at: int
    source: SyncState
    target: SyncState
    event: SyncEvent
    reason: str
    comparison: Comparison | None
    held_stamp: int

    def __str__(self) -> str:
        return f"{self.source.name} -> {self.target.name} ({self.event.value}): {self.reason}"


class SyncMachine:
    """The present state, and how it changes.

    Attributes
    ----------
    state : SyncState
    reason : str
        Why it was entered; other settings are no reason to be in a state.
    """

    def __init__(self):
        self.state = SyncState.WAITING
        self.reason = ""
        self._taken: list[Transition] = []

    def on(
        self, event: SyncEvent, reason: str, now: int, comparison: Comparison | None = None, held_stamp: int = 0
    ) -> bool:
        """Take an event; return whether the table has a row for it in the present state.

        Parameters
        ----------
        event : SyncEvent
        reason : str
        now : int
            [ns]
        comparison : Comparison, optional
        held_stamp : int, optional
            [ns]
        """
        target = TABLE[self.state].get(event)
        if target is None:
            return False
        self._taken.append(Transition(now, self.state, target, event, reason, comparison, held_stamp))
        self.state = target
        if event is not SyncEvent.CONFIGURED:
            self.reason = reason
        return True

    @property
    def changed(self) -> bool:
        """True when there are transitions to take."""
        return bool(self._taken)

    def take(self) -> list[Transition]:
        """Return the transitions since the last call, oldest first."""
        taken, self._taken = self._taken, []
        return taken
