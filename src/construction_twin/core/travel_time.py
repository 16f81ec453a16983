"""How long messages travel, and which of them are too old or out of sequence to be used. Standard library only.

Pure: stamps and times of reception are arguments [ns]. They are on two clocks that are never compared; only the difference of the
two is, with its own smallest value (docs/architecture.md, "Three clocks, never compared with each other"). What is refused raises
PayloadError, whose reason is the counter's name.
"""

from __future__ import annotations

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS

#: A sequence number may be this far ahead: one second of states.
MAX_JUMP = 250
#: So many messages in a row must follow one that does not fit before it becomes the new reference.
CONFIRMATIONS = 3
#: The shortest travel time is forgotten at this rate, so that clocks that drift apart never make fresh messages old.
MAX_DRIFT = 100e-6


class TravelTime:
    """By how much the members of one stream travel longer than the quickest one.

    A member that waited in a queue has a large excess. The smallest difference between reception and stamp is the reference;
    it grows by `MAX_DRIFT`, so that it follows clocks that drift apart.
    """

    def __init__(self):
        self.restart()

    def restart(self) -> None:
        """Forget the quickest one: the sender's clock may be another."""
        self._shortest: int | None = None
        self._at = 0

    def excess(self, stamp: int, received: int) -> int:
        """Return by how much longer than the quickest one a member has travelled, without taking it as a reference.

        `stamp` is on the sender's clock, `received` on a monotonic one [ns]. Negative: quicker than all before it; 0: the first.
        """
        if self._shortest is None:
            return 0
        return received - stamp - self._shortest - round((received - self._at) * MAX_DRIFT)

    def take(self, stamp: int, received: int) -> int:
        """Return the same, itself included; 0 for one that is at least as quick as all before it: it is the new reference."""
        travelled = received - stamp
        if self._shortest is None:
            shortest = travelled
        else:
            shortest = min(travelled, self._shortest + round((received - self._at) * MAX_DRIFT))
        self._shortest, self._at = shortest, received
        return travelled - shortest


class StateCheck:
    """Which states of one gateway may be used: numbered in order, and none that was under way for too long.

    A single number or stamp that does not fit changes nothing; a new sequence, or a new clock, is believed after `CONFIRMATIONS` of
    it in a row.

    Args:
        max_age: By how much longer than the quickest one of its run a state may travel [s].

    Attributes:
        lost: States that the sequence numbers say were sent, but never came.
    """

    def __init__(self, max_age: float):
        self.lost = 0
        self._limit = round(max_age * NANOSECONDS)
        self._travel, self._early = TravelTime(), 0
        self.restart()

    def restart(self) -> None:
        """Start over: the gateway said that it is gone, and its clock may be another."""
        self._last = self._strange = self._followers = 0
        self._forget_clock()

    def accept(self, seq: int, stamp: int, received: int) -> None:
        """Take a state by its number, the gateway's stamp and the time of reception, each on its own clock [ns].

        Raises:
            PayloadError: ``sequence``; ``stale``; ``early``: so much quicker than all others that only further ones like it are
                believed, because a single wrong stamp must not cause all later states to be refused.
        """
        self._accept_number(seq)
        excess = self._travel.excess(stamp, received)
        if excess < -self._limit and self._early < CONFIRMATIONS:
            self._early += 1
            raise PayloadError("early", f"state travelled {-excess / NANOSECONDS:.3f} s less than the quickest one")
        self._early = 0
        self._travel.take(stamp, received)
        if excess > self._limit:
            raise PayloadError("stale", f"state is {excess / NANOSECONDS:.3f} s older than the freshest one")

    def _accept_number(self, seq: int) -> None:
        last = self._last
        if not last or 0 < seq - last <= MAX_JUMP:
            self.lost += seq - last - 1 if last else 0
        else:
            self._followers = self._followers + 1 if self._strange and seq == self._strange + 1 else 0
            self._strange = seq
            if self._followers < CONFIRMATIONS:
                raise PayloadError("sequence", f"seq {seq} after {last}")
            if seq < last:
                self._forget_clock()
            else:
                self.lost += seq - last - 1 - CONFIRMATIONS
        self._last, self._strange = seq, 0

    def _forget_clock(self) -> None:
        self._travel.restart()
        self._early = 0
