"""Which commands belong to the armed session: identity, order and age; and a stamp for each. Standard library only; ns and rad."""

from __future__ import annotations

from construction_twin.errors import PayloadError
from construction_twin.mqtt.codec import JointStringCodec
from construction_twin.mqtt.freshness import MAX_DRIFT
from construction_twin.mqtt.messages import CommandProperties
from construction_twin.rsi.config import GatewayConfig
from construction_twin.units import CYCLE_NS, NANOSECONDS

#: Share of its distance to the arrivals by which the grid of unstamped commands moves per command: follows the drift between two
#: clocks within minutes, and lets 10 ms of network jitter through as less than a microsecond.
ARRIVAL_SMOOTHING = 16_384


class CommandStream:
    """The commands of one session.

    Parameters
    ----------
    config : GatewayConfig
    codec : JointStringCodec
    """

    def __init__(self, config: GatewayConfig, codec: JointStringCodec):
        self._config = config
        self._codec = codec
        self.begin("")

    def begin(self, session: str) -> None:
        """Start over with another session; "" for none."""
        self.session = session
        #: Stamp of the last command that was taken [ns].
        self.last_stamp = 0
        self._sequence = 0
        self._quickest: int | None = None
        self._quickest_at = 0

    def read(
        self, payload: bytes, properties: CommandProperties | None, now: int
    ) -> tuple[int, tuple[float, ...], int]:
        """Read a command.

        Parameters
        ----------
        payload : bytes
            A joint string.
        properties : CommandProperties or None
            What was beside it.
        now : int
            [ns]

        Returns
        -------
        stamp : int
            On the sender's clock [ns]; on ours when commands carry none.
        q : tuple, shape (n,)
            Axis angles [rad].
        lost : int
            Commands missing between the last one and this.

        Raises
        ------
        PayloadError
            ``properties``, ``session``, ``sequence``, ``stale``, or a reason of the codec.
        """
        if not self._config.properties:
            return self._arrival_stamp(now), self._codec.decode(payload), 0
        if properties is None:
            raise PayloadError("properties", "command without session, seq and stamp")
        if properties.session != self.session:
            raise PayloadError("session", f"command of session {properties.session!r}; armed is {self.session!r}")
        if properties.seq <= self._sequence:
            raise PayloadError("sequence", f"seq {properties.seq} after {self._sequence}")
        q = self._codec.decode(payload)
        self._check_age(now - properties.stamp, now)
        lost = properties.seq - self._sequence - 1
        self._sequence = properties.seq
        return properties.stamp, q, lost

    def _check_age(self, travelled: int, now: int) -> None:
        quickest = travelled
        if self._quickest is not None:
            # forgotten at the rate at which two clocks may drift apart, or a slow one would make every command look old
            quickest = min(travelled, self._quickest + round((now - self._quickest_at) * MAX_DRIFT))
        late = (travelled - quickest) / NANOSECONDS
        if late > self._config.max_age:
            raise PayloadError("stale", f"command is {late:.3f} s older than the freshest")
        self._quickest, self._quickest_at = quickest, now

    def _arrival_stamp(self, now: int) -> int:
        """Return a stamp for a command without one: the sender's 4 ms grid, begun anew after a gap longer than `silence`."""
        expected = self.last_stamp + CYCLE_NS
        distance = now - expected
        if abs(distance) > self._config.silence * NANOSECONDS:
            return now
        return expected + distance // ARRIVAL_SMOOTHING
