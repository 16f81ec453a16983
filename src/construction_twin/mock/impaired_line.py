"""One direction of the mock's network: datagrams lost, delayed or doubled on purpose. Pure; time in ns is an argument."""

from __future__ import annotations

import heapq
import itertools
import random
from typing import NamedTuple

from construction_twin.core.units import NANOSECONDS


class Underway(NamedTuple):
    """A datagram that has not arrived; as a tuple it stands in the heap by its time, then in the order of sending.

    Attributes:
        due: When it arrives [ns].
    """

    due: int
    order: int
    data: bytes


class ImpairedLine:
    """Loses, doubles and delays datagrams of one direction.

    Attributes:
        active: False: datagrams need not come here.
        dropped, doubled, delayed: Datagrams so far.
    """

    def __init__(self, random_numbers: random.Random):
        self._random = random_numbers
        self._drop = self._duplicate = 0.0
        self._delay = self._jitter = 0
        self._order = itertools.count()
        self._queue: list[Underway] = []
        self.active = False
        self.dropped = self.doubled = self.delayed = 0

    def drop(self, fraction: float) -> None:
        """Lose this fraction of the datagrams, 0 to 1."""
        self._drop = fraction
        self._note()

    def duplicate(self, fraction: float) -> None:
        """Send this fraction of the datagrams twice, 0 to 1."""
        self._duplicate = fraction
        self._note()

    def delay(self, delay: float, jitter: float) -> None:
        """Delay every datagram by `delay` to `delay` + `jitter` [s], evenly spread; one may overtake another."""
        self._delay, self._jitter = round(delay * NANOSECONDS), round(jitter * NANOSECONDS)
        self._note()

    def put(self, data: bytes, now: int) -> None:
        """Take a datagram that sets out at `now` [ns]."""
        if self._drop and self._random.random() < self._drop:
            self.dropped += 1
            return
        twice = bool(self._duplicate) and self._random.random() < self._duplicate
        self.doubled += twice
        self.delayed += bool(self._delay or self._jitter)
        for _ in range(1 + twice):
            due = now + self._delay + round(self._random.random() * self._jitter)
            heapq.heappush(self._queue, Underway(due, next(self._order), data))

    def take(self, now: int) -> list[Underway]:
        """Return what has arrived by `now` [ns], in the order of arrival."""
        arrived = []
        while self._queue and self._queue[0].due <= now:
            arrived.append(heapq.heappop(self._queue))
        self._note()
        return arrived

    def next_arrival(self) -> int | None:
        """Return when the next datagram arrives [ns], or None."""
        return self._queue[0].due if self._queue else None

    def _note(self) -> None:
        # delayed datagrams are still delivered after the fault has ended
        self.active = bool(self._drop or self._duplicate or self._delay or self._jitter or self._queue)
