"""What the gateway is doing. Standard library only."""

from __future__ import annotations

from enum import Enum


class State(Enum):
    """States of the gateway; the words are those of `status`."""

    NO_CONTROLLER = "no_controller"  # no telegram for the timeout: nothing to answer
    READ_ONLY = "read_only"  # ONLYSEND: poses are reported, nothing is answered or commanded
    JOINED = "joined_running"  # telegrams whose correction we cannot know: not answered, so that the session times out
    READY = "ready"  # origin captured, holding; waits for `arm`
    ARMED = "armed"  # holding; the session's stream may begin
    FOLLOWING = "following"  # the stream is played
    BRAKING = "braking"  # on the way to rest
    HOLDING = "holding"  # at rest after a fault or a stop; waits for `reset`
