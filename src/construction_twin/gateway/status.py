"""The content of the gateway's `status` topic, put together from its parts. Standard library only."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from construction_twin.gateway.ownership import Ownership
from construction_twin.gateway.player import Player
from construction_twin.gateway.rsi_session import ControllerSession
from construction_twin.gateway.speed_limit import SpeedLimit
from construction_twin.gateway.stop_report import StopReport

#: Without a telegram for this long nobody waits for an answer [s].
QUIET = 0.05

if TYPE_CHECKING:
    from construction_twin.gateway.gateway import Gateway


def gateway_status(
    gateway: Gateway,
    controller: ControllerSession,
    player: Player,
    speed: SpeedLimit,
    stopping: StopReport,
    owners: Ownership,
) -> dict:
    """Return what the gateway and its parts tell; every key is explained in docs/interface.md."""
    config = gateway.config
    return {
        "state": gateway.state.value,
        "reason": gateway.reason,
        "session": gateway.session,
        "fault": gateway.fault,
        "mode": gateway.mode.value,
        "correction": list(gateway.correction),
        "last_ipoc_jump_ms": controller.jump_ms,
        "run": gateway.run,
        "hash": config.hash,
        "decimals": config.decimals,
        "properties": config.properties,
        "playout": player.report(),
        "speed_limit": speed.report(),
        "stop": stopping.report(),
        "intruder": {"session": owners.intruder, "count": owners.intrusions},
        "last_refusal": gateway.refusals.last,
        "counters": dict(gateway.counters),
    }


class StatusClock:
    """When the periodic status is sent: in the pause after an answer, because putting it together takes part of a cycle.

    Parameters
    ----------
    period : float
        [s]
    """

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
