"""What the executor can be doing, and which of its states have something in common."""

from __future__ import annotations

from enum import Enum

from construction_twin.monitor.gate import SyncState


class ExecutorState(Enum):
    """What the executor is doing; values are those of `Execution.msg`."""

    WAITING = 0
    IDLE = 1
    PLAYING = 2
    STOPPING = 3
    PAUSING = 4
    PAUSED = 5
    HELD = 6


#: The setpoints may change from cycle to cycle.
MOVING = (ExecutorState.PLAYING, ExecutorState.STOPPING, ExecutorState.PAUSING)
#: A plan stands at rest on its path.
RESTING = (ExecutorState.PAUSED, ExecutorState.HELD)
#: An approved plan is not at its end.
ACTIVE = (*MOVING, *RESTING)
#: States of the gate that a plan survives under the policy `resume`.
SURVIVED = (SyncState.HOLDING, SyncState.STALE)
