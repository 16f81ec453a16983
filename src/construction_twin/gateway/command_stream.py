"""Which commands belong to the armed session: identity, order and age; and a stamp for each. Standard library only; ns and rad."""

from __future__ import annotations

from typing import NamedTuple

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.travel_time import TravelTime
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties

#: Fraction of its distance to the arrivals by which the grid of unstamped commands moves per command: follows the drift between two
#: clocks within minutes, and lets 10 ms of network jitter through as less than a microsecond.
ARRIVAL_SMOOTHING = 16_384
#: Commands after which it is asked whether all of them were late on that grid (1 s): then some were lost before.
ARRIVAL_BLOCK = 250
#: Sequence numbers behind the newest of which it is remembered whether they were taken.
REMEMBERED = 64
#: Sequence numbers that one command may be ahead of the last one taken: more than are sent while a stream survives.
FARTHEST = 10_000
_ALL = (1 << REMEMBERED) - 1


class Command(NamedTuple):
    """A command that was read.

    Attributes:
        stamp: On the sender's clock [ns]; on ours when commands carry none.
        q: Shape (n,). Axis angles [rad].
        lost: Commands missing between the last one and this.
    """

    # a NamedTuple, and not a frozen dataclass: one is made and unpacked for every command, and it is faster at both
    stamp: int
    q: tuple[float, ...]
    lost: int


class CommandStream:
    """The commands of one session."""

    def __init__(self, config: GatewayConfig, codec: JointStringCodec):
        self._config = config
        self._codec = codec
        # a sender that has been silent for longer has been given up
        self._longest_wait = round((config.playout_delay_max + config.silence) * NANOSECONDS)
        self._travel_time = TravelTime()
        self.begin("")

    def begin(self, session: str) -> None:
        """Start over with another session; "" for none."""
        self.session = session
        #: Stamp of the last command that was taken [ns].
        self.last_stamp = 0
        self._sequence = 0
        # bit k: the number k below the newest was taken
        self._taken = 0
        self._travel_time.restart()
        self._last_q: tuple[float, ...] = ()
        self._begin_block()

    def read(self, payload: bytes, properties: CommandProperties | None, now: int) -> Command:
        """Read a command.

        Args:
            payload: A joint string.
            properties: What was beside it.
            now: [ns]

        Raises:
            PayloadError: ``properties``, ``session``, ``duplicate`` (was taken), ``reordered`` (comes behind a newer one),
                ``sequence`` (too far behind to tell, as a replayed one is, or too far ahead), ``stale``, or a reason of the codec.
        """
        if not self._config.properties:
            q = self._codec.decode(payload)
            return Command(self._arrival_stamp(now, q), q, 0)
        if properties is None:
            raise PayloadError("properties", Sentence("gateway.command.properties"))
        if properties.session != self.session:
            names = {"session": repr(properties.session), "armed": repr(self.session)}
            raise PayloadError("session", Sentence("gateway.command.session", **names))
        step = properties.seq - self._sequence
        if step <= 0:
            raise self._why_behind(properties.seq, -step)
        if step > FARTHEST and self.last_stamp:
            # nor would the count of what was lost mean anything
            found = Sentence("gateway.command.far", seq=properties.seq, last=self._sequence)
            raise PayloadError("sequence", found)
        q = self._codec.decode(payload)
        self._check_age(properties.stamp, now)
        self._sequence = properties.seq
        self._taken = 1 if step >= REMEMBERED else (self._taken << step | 1) & _ALL
        return Command(properties.stamp, q, step - 1)

    def _why_behind(self, seq: int, behind: int) -> PayloadError:
        numbers = {"seq": seq, "last": self._sequence}
        if behind >= REMEMBERED or seq < 1:
            return PayloadError("sequence", Sentence("gateway.command.behind", **numbers))
        if self._taken >> behind & 1:
            return PayloadError("duplicate", Sentence("gateway.command.again", **numbers))
        return PayloadError("reordered", Sentence("gateway.command.reordered", **numbers))

    def _check_age(self, stamp: int, now: int) -> None:
        # a command that is late leaves the reference as it is, so it may be taken before it is judged
        late = self._travel_time.take(stamp, now) / NANOSECONDS
        if late > self._config.max_age:
            raise PayloadError("stale", Sentence("gateway.command.stale", late=late))

    def _arrival_stamp(self, now: int, q: tuple[float, ...]) -> int:
        """Return a stamp for a command without one: the sender's 4 ms grid, begun anew after a gap in which it was given up.

        A lost command leaves the grid a cycle late. It is brought back where the stream rests and nothing depends on it; in
        motion the step is what it looks like, one over two cycles in the time of one, and the motion check refuses it.
        """
        expected = self.last_stamp + CYCLE_NS
        distance = now - expected
        if abs(distance) > self._longest_wait:
            self._begin_block()
            return now
        expected += self._lateness(distance, q)
        return expected + distance // ARRIVAL_SMOOTHING

    def _begin_block(self) -> None:
        self._block_length = 0
        self._block_rests = True
        self._block_lateness = self._longest_wait

    def _lateness(self, distance: int, q: tuple[float, ...]) -> int:
        """Return by how much every command of a resting second came late [ns], when that second is over; else 0."""
        self._block_length += 1
        self._block_rests = self._block_rests and q == self._last_q
        self._block_lateness = min(self._block_lateness, distance)
        self._last_q = q
        if self._block_length < ARRIVAL_BLOCK:
            return 0
        late = self._block_lateness if self._block_rests and self._block_lateness > CYCLE_NS // 2 else 0
        self._begin_block()
        return late
