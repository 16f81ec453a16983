"""How far the gateway reaches: into the arm, up to the telegram (commissioning), or nowhere (read-only). Standard library only."""

from __future__ import annotations

from enum import Enum

from construction_twin.gateway.config import GatewayConfig


class Mode(Enum):
    """What becomes of the corrections; the words are those of `status`."""

    NORMAL = "normal"  # they are sent
    COMMISSIONING = "commissioning"  # they are computed, reported, and zero on the wire
    READ_ONLY = "read_only"  # ONLYSEND: the controller expects no answer, and gets none

    @classmethod
    def of(cls, config: GatewayConfig, commissioning: bool) -> Mode:
        """Return the mode: what the Ethernet XML says comes first, because a controller with ONLYSEND takes nothing."""
        if config.layout.onlysend:
            return cls.READ_ONLY
        return cls.COMMISSIONING if commissioning else cls.NORMAL


#: What is added to a reason, so that nobody mistakes an arm that stands still for a fault.
NOTES = {
    Mode.NORMAL: "",
    Mode.COMMISSIONING: "; commissioning: every correction is sent as zero, the arm does not move",
    Mode.READ_ONLY: "; read-only: the Ethernet XML has ONLYSEND TRUE, so nothing is answered and no motion can be commanded",
}
