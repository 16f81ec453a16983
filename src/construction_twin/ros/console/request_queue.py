"""Where requests wait: carried out one after the other, each once, each answered, and nobody alone holds up the others."""

from __future__ import annotations

import hashlib
import math
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from construction_twin.core.rate_limit import Pace, SenderLimits
from construction_twin.core.units import NANOSECONDS


@dataclass(frozen=True)
class Request:
    """A request that may wait.

    Attributes:
        kind: ``trajectory``, ``plan_request``, ... for the digest.
        sender: The account of its topic, empty for none.
        payload: The whole message: the same bytes of the same sender are the same request, sent twice.
        carry_out: Does it and answers; returns the answer, empty when it could not be sent.
        refuse: Takes a reason and a sentence; counts it and says no.
        repeat: Takes the answer that was given, empty when it is still to come; counts that the message came again, and answers.
        pace: How often its sender may ask, kept where each is carried out; None: as often as it likes.
    """

    kind: str
    sender: str
    payload: bytes
    carry_out: Callable[[], bytes]
    refuse: Callable[[str, str], None]
    repeat: Callable[[bytes], None]
    pace: Pace | None = None

    @property
    def digest(self) -> bytes:
        """What tells one request from another."""
        return hashlib.sha256(b"\0".join((self.kind.encode(), self.sender.encode(), self.payload))).digest()


class Queue(Protocol):
    """Where requests wait."""

    def take(self, request: Request) -> None:
        """Let a request wait for its turn, or answer why not."""


class NewestQueue:
    """A queue in which only the newest request of each sender waits: what it asked for before is not worth doing any more.

    Args:
        most: Senders that may wait at once.
        full: Says so, with what to do.
        overtaken: Called for each request that is dropped.
    """

    def __init__(self, most: int, full: str, overtaken: Callable[[], None]):
        self._most, self._full, self._overtaken = most, full, overtaken
        self._news = threading.Condition()
        self._waiting: dict[str, Request] = {}

    def take(self, request: Request) -> None:
        """Let a request wait in place of its sender's former one, or answer why not."""
        with self._news:
            former = request.sender in self._waiting
            fits = former or len(self._waiting) < self._most
            if fits:
                self._waiting[request.sender] = request
                self._news.notify_all()
        if former:
            self._overtaken()
        if not fits:
            request.refuse("busy", self._full)

    def run(self, patience: float = 0.0) -> None:
        """Carry out all that wait; wait so long [s] for the first one."""
        with self._news:
            self._news.wait_for(lambda: self._waiting, patience)
            waiting, self._waiting = self._waiting, {}
        for request in waiting.values():
            request.carry_out()


class RequestQueue:
    """The queue; requests come from the connection's thread, and are carried out in another.

    Args:
        most: Requests that may wait.
        repeat_window: For so long after its answer the same message is the same request [s]; 0: each is another one.
        clock: Returns the present time [s], monotonic.
    """

    def __init__(
        self,
        most: int,
        repeat_window: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._most, self._repeat_window = most, repeat_window
        self._clock = clock
        self._lock = threading.Lock()
        self._waiting: queue.Queue[Request] = queue.Queue(most)
        #: Digest of a request to its answer and when that was given; None: it is not answered yet.
        self._answered: dict[bytes, tuple[bytes | None, float]] = {}
        self._limits: dict[Pace, SenderLimits] = {}

    @property
    def waiting(self) -> int:
        """How many wait."""
        return self._waiting.qsize()

    def take(self, request: Request) -> None:
        """Let a request wait for its turn, or answer why not."""
        if self._repeat_window and self._is_repeated(request):
            return
        problem = self._problem(request)
        if problem:
            with self._lock:
                self._answered.pop(request.digest, None)
            request.refuse("busy", problem)

    def run(self, patience: float = 0.0) -> None:
        """Carry out all that wait; wait so long [s] for the first one."""
        try:
            self._do_next(self._waiting.get(timeout=patience) if patience else self._waiting.get_nowait())
            while True:
                self._do_next(self._waiting.get_nowait())
        except queue.Empty:
            return

    def _problem(self, request: Request) -> str:
        """Let it wait; return why it cannot, empty when it does."""
        now, pace = round(self._clock() * NANOSECONDS), request.pace
        limits = self._limits.setdefault(pace, SenderLimits(pace)) if pace is not None else None
        if pace is not None and limits is not None and (wait := limits.wait(request.sender, now)):
            # rounded up: who tries again then is not too early
            after = math.ceil(10.0 * wait / NANOSECONDS) / 10.0
            motions = "one motion" if pace.most == 1 else f"no more than {pace.most}"
            return f"{motions} in {pace.seconds:g} s is taken from a sender; try again in {after:.1f} s"
        try:
            self._waiting.put_nowait(request)
        except queue.Full:
            return f"{self._most} requests are waiting already; try again"
        if limits is not None:
            limits.take(request.sender, now)
        return ""

    def _is_repeated(self, request: Request) -> bool:
        """Return whether the same message came before; one that was answered is answered alike. If not, note it."""
        now, digest = self._clock(), request.digest
        with self._lock:
            self._answered = {
                key: (answer, at)
                for key, (answer, at) in self._answered.items()
                if answer is None or now - at <= self._repeat_window
            }
            if digest not in self._answered:
                self._answered[digest] = None, now
                return False
            answer, _ = self._answered[digest]
        request.repeat(answer or b"")
        return True

    def _do_next(self, request: Request) -> None:
        answer = request.carry_out()
        if self._repeat_window:
            with self._lock:
                self._answered[request.digest] = answer, self._clock()
