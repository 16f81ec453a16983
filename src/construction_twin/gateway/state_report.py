"""What the gateway tells of the arm: the measured pose as a joint string. Standard library only; rad and ns."""

from __future__ import annotations

from collections import Counter

from construction_twin.core.errors import PayloadError
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import StateProperties


class StateReport:
    """Makes the messages of the `state` topic.

    Parameters
    ----------
    codec : JointStringCodec
    counters : Counter
        The gateway's.
    properties : bool
        Whether commands carry stamps; without, no state has a command stamp.
    """

    def __init__(self, codec: JointStringCodec, counters: Counter[str], properties: bool):
        self._codec = codec
        self._counters = counters
        self._properties = properties

    def message(
        self, measured: tuple[float, ...], answered_stamp: int, stamp: int
    ) -> tuple[bytes, StateProperties] | None:
        """Return a pose's joint string and what goes beside it; None without a pose, or when it does not fit the format.

        Parameters
        ----------
        measured : tuple, shape (n,)
            [rad]; () for none.
        answered_stamp : int
            Stamp of the target in the reply before this telegram [ns]; 0 for none.
        stamp : int
            The gateway's own time [ns].
        """
        if not measured:
            return None
        try:
            payload = self._codec.encode(measured)
        except PayloadError as error:
            self._counters[f"state_refused_{error.reason}"] += 1
            return None
        self._counters["states_sent"] += 1
        return payload, StateProperties(self._counters["states_sent"], stamp, answered_stamp if self._properties else 0)
