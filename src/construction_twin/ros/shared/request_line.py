"""Requests that came by MQTT, carried out one after the other: each once, each answered, and nobody alone holds up the others."""

from __future__ import annotations

import hashlib
import math
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

from construction_twin.core.rate_limit import SenderLimits, TokenBucket
from construction_twin.core.units import NANOSECONDS


@dataclass(frozen=True)
class Request:
    """A request that may wait.

    Attributes:
        what: ``trajectory`` or ``plan_request``, for sentences.
        id, sender: As the message has it; the account of its topic, empty for none.
        payload: The whole message: the same bytes of the same sender are the same request, sent twice.
        ack: Topic of the answer.
        carry_out: Does it; returns the answer's payload.
        refuse: Takes a sentence; returns the payload of the answer that says no.
    """

    what: str
    id: str
    sender: str
    payload: bytes
    ack: str
    carry_out: Callable[[], bytes]
    refuse: Callable[[str], bytes]

    @property
    def digest(self) -> bytes:
        """What tells one request from another."""
        return hashlib.sha256(b"\0".join((self.what.encode(), self.sender.encode(), self.payload))).digest()


class RequestLine:
    """The line; requests come from the connection's thread, and are carried out in another.

    Args:
        most: Requests that may wait.
        repeat_window: For so long after its answer the same message is the same request [s].
        pause: Shortest time between two requests of one sender [s].
        clock: Returns the present time [s], monotonic.
        publish: Takes topic and payload of an answer.
        refuse: Counts a refused input; takes reason and sentence.
    """

    def __init__(
        self,
        most: int,
        repeat_window: float,
        pause: float,
        clock: Callable[[], float],
        publish: Callable[[str, bytes], object],
        refuse: Callable[[str, str], None],
    ):
        self._most, self._repeat_window, self._pause = most, repeat_window, pause
        self._clock, self._publish, self._refuse = clock, publish, refuse
        self._lock = threading.Lock()
        self._waiting: queue.Queue[Request] = queue.Queue(most)
        #: Digest of a request to its answer and when that was given; b"": it is being carried out.
        self._answered: dict[bytes, tuple[bytes, float]] = {}
        self._senders = SenderLimits(lambda: TokenBucket(1.0 / pause, 1))

    @property
    def waiting(self) -> int:
        """How many wait."""
        return self._waiting.qsize()

    def take(self, request: Request) -> None:
        """Let a request wait for its turn, or answer why not."""
        if self._is_repeated(request):
            return
        now = round(self._clock() * NANOSECONDS)
        wait = self._senders.wait(request.sender, now) / NANOSECONDS
        # rounded up: who tries again then is not too early
        after = math.ceil(10.0 * wait) / 10.0
        problem = f"one motion in {self._pause:g} s is taken from a sender; try again in {after:.1f} s" if wait else ""
        if not problem:
            try:
                self._waiting.put_nowait(request)
            except queue.Full:
                problem = f"{self._most} requests are waiting already; try again"
            else:
                self._senders.take(request.sender, now)
        if problem:
            with self._lock:
                del self._answered[request.digest]
            self._refuse("busy", problem)
            self._publish(request.ack, request.refuse(problem))

    def run(self, patience: float = 0.0) -> None:
        """Carry out all that wait; wait so long [s] for the first one."""
        try:
            self._carry_out(self._waiting.get(timeout=patience) if patience else self._waiting.get_nowait())
            while True:
                self._carry_out(self._waiting.get_nowait())
        except queue.Empty:
            return

    def _is_repeated(self, request: Request) -> bool:
        """Return whether the same message came before; one that was answered is answered alike. If not, note it."""
        now, digest = self._clock(), request.digest
        with self._lock:
            self._answered = {
                key: (answer, at)
                for key, (answer, at) in self._answered.items()
                if not answer or now - at <= self._repeat_window
            }
            if digest not in self._answered:
                self._answered[digest] = b"", now
                return False
            answer, _ = self._answered[digest]
        self._refuse(
            "repeated",
            f"{request.what} {request.id!r} came again within {self._repeat_window:g} s of its answer, or before it",
        )
        if answer:
            self._publish(request.ack, answer)
        return True

    def _carry_out(self, request: Request) -> None:
        answer = request.carry_out()
        with self._lock:
            self._answered[request.digest] = answer, self._clock()
        self._publish(request.ack, answer)
