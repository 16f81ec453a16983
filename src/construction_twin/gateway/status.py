"""What the gateway tells on MQTT: the content of `status`, when it is due, and the messages of `state`.

It takes values and knows nothing of the gateway. Standard library only; rad and ns.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from construction_twin.core.errors import PayloadError
from construction_twin.core.records import left_out
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import StateProperties

#: Without a telegram for this long no controller waits for an answer [s].
QUIET = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The content of the `status` topic, key by key; each is explained in docs/reference/mqtt.md."""

    tool: dict | None = left_out()
    state: str
    reason: str
    session: str
    fault: bool
    fault_number: int
    mode: str
    correction: Sequence[float]
    controller: dict
    last_ipoc_jump_ms: int
    cycle: dict
    run: str
    protocol: int
    hash: str
    decimals: int
    properties: bool
    playout: dict
    speed_limit: dict
    stop: dict
    intruder: dict
    last_refusal: str
    later_refusal: str
    counters: dict[str, int]


class StateReport:
    """Makes the messages of the `state` topic; without `properties` commands carry no stamps, and states none of theirs."""

    def __init__(self, codec: JointStringCodec, counters: Counter[str], properties: bool):
        self._codec = codec
        self._counters = counters
        self._properties = properties

    def message(
        self, measured: tuple[float, ...], command_stamp: int, stamp: int
    ) -> tuple[bytes, StateProperties] | None:
        """Return a pose's joint string and what goes beside it; None without a pose, or when it does not fit the format.

        `command_stamp` is that of the target in the reply before this telegram, 0 for none; `stamp` the gateway's own time [ns].
        """
        if not measured:
            return None
        try:
            payload = self._codec.encode(measured)
        except PayloadError as error:
            self._counters[f"state_refused_{error.reason}"] += 1
            return None
        self._counters["states_sent"] += 1
        return payload, StateProperties(self._counters["states_sent"], stamp, command_stamp if self._properties else 0)


class StatusClock:
    """When the periodic status is sent: in the pause after an answer, because putting it together takes part of a cycle."""

    def __init__(self, period: float):
        self._period = period
        self._due_at = -math.inf
        self._heard_at = -math.inf

    def sent(self, now: float) -> None:
        """Take note of a status, also of one out of turn, at `now` [s]."""
        self._due_at = now + self._period

    def hurry(self) -> None:
        """Send the next one as soon as possible."""
        self._due_at = -math.inf

    def is_due(self, now: float, answered: bool) -> bool:
        """Return whether to send one now [s]: after a telegram was `answered` in this turn, or when none has come for 50 ms."""
        if answered:
            self._heard_at = now
        return now >= self._due_at and (answered or now - self._heard_at >= QUIET)
