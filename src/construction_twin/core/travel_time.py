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


class SequenceCheck:
    """Refuses sequence numbers that are not a little above the last one.

    A single number out of sequence changes nothing. A new sequence is accepted after `CONFIRMATIONS` consecutive numbers of it
    without one that continues the old sequence.
    """

    def __init__(self):
        self.lost = 0
        self.restart()

    def restart(self) -> None:
        """Take whatever number comes next: the sender is known to be gone."""
        self._last = 0
        self._strange = 0
        self._followers = 0

    def accept(self, seq: int) -> bool:
        """Take a number; return whether the sender counts anew from a lower one.

        Raises:
            PayloadError: ``sequence``, when the number is not used.
        """
        last, restarted = self._last, False
        if not last or 0 < seq - last <= MAX_JUMP:
            self.lost += seq - last - 1 if last else 0
        elif not self._is_confirmed(seq):
            raise PayloadError("sequence", f"seq {seq} after {last}")
        elif seq < last:
            restarted = True
        else:
            self.lost += seq - last - 1 - CONFIRMATIONS
        self._last, self._strange = seq, 0
        return restarted

    def _is_confirmed(self, seq: int) -> bool:
        self._followers = self._followers + 1 if self._strange and seq == self._strange + 1 else 0
        self._strange = seq
        return self._followers >= CONFIRMATIONS


class FreshnessCheck:
    """Refuses messages that travelled longer by `limit` [s] than the quickest one."""

    def __init__(self, limit: float):
        self._limit = round(limit * NANOSECONDS)
        self._travel = TravelTime()
        self._early = 0

    def restart(self) -> None:
        """Forget the quickest one: the sender's clock may be another."""
        self._travel.restart()
        self._early = 0

    def accept(self, stamp: int, received: int) -> None:
        """Take a message by the sender's stamp and the time of reception, each on its own clock [ns].

        Raises:
            PayloadError: ``stale``, when it is too old; ``early``, when it is so much quicker than all others that only further
                ones like it are believed: a single wrong stamp must not cause all later messages to be refused.
        """
        excess = self._travel.excess(stamp, received)
        if excess < -self._limit and self._early < CONFIRMATIONS:
            self._early += 1
            raise PayloadError("early", f"state travelled {-excess / NANOSECONDS:.3f} s less than the quickest one")
        self._early = 0
        self._travel.take(stamp, received)
        if excess > self._limit:
            raise PayloadError("stale", f"state is {excess / NANOSECONDS:.3f} s older than the freshest one")


class StateCheck:
    """Both checks on the states of one gateway, which may travel longer by `max_age` [s] than the quickest one of its run."""

    def __init__(self, max_age: float):
        self._sequence = SequenceCheck()
        self._freshness = FreshnessCheck(max_age)

    @property
    def lost(self) -> int:
        """States that the sequence numbers say were sent, but never came."""
        return self._sequence.lost

    def restart(self) -> None:
        """Start over: the gateway said that it is gone."""
        self._sequence.restart()
        self._freshness.restart()

    def accept(self, seq: int, stamp: int, received: int) -> None:
        """Take a state by its sequence number, the gateway's stamp and the time of reception [ns].

        Raises:
            PayloadError: ``sequence``, ``stale`` or ``early``, when it must not be used.
        """
        if self._sequence.accept(seq):
            self._freshness.restart()
        self._freshness.accept(stamp, received)
