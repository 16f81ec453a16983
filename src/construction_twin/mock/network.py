"""The mock controller on the network: UDP client and clock around `MockController`. Runs without ROS.

The clock is a grid of absolute deadlines; it never waits for a reply. Where this process is late, the packets that are due
follow each other at half a cycle until they are on the grid again, so the PC always has half a cycle to answer, and the stamp
stays in step with time. A reply is in time when it *arrived* before its cycle ended: on Linux the kernel's stamp tells,
elsewhere the time it was read.
"""

from __future__ import annotations

import logging
import select
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import TypeVar

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.network import enable_timestamps, receive
from construction_twin.core.units import NANOSECONDS
from construction_twin.mock.controller import MockController
from construction_twin.mock.faults import FaultBoard

#: Tries for a reading of both clocks that no switch to another process fell into, and what is good enough [ns].
_TRIES, _TIGHT = 3, 2_000


def steady_offset(wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = time.monotonic_ns) -> int:
    """Return how far the monotonic clock is ahead of the wall clock [ns], from the narrowest of a few readings."""
    readings = []
    for _ in range(_TRIES):
        begin, at_wall, end = steady(), wall(), steady()
        readings.append((end - begin, (begin + end) // 2 - at_wall))
        if end - begin <= _TIGHT:
            break
    return min(readings)[1]


log = logging.getLogger(__name__)

#: Packets that are late by no more than this are all sent [ns].
CATCH_UP = NANOSECONDS // 10
#: Pause after an unanswered session [ns]: who starts the controller waits for the gateway.
_UNANSWERED = NANOSECONDS // 10

Result = TypeVar("Result")


class MockRsi:
    """Runs a mock controller against a gateway.

    Args:
        restart_after: A stopped controller starts a new session after this time [s], sooner after one that nobody has answered; 0:
            it stays stopped.
        observe: Called with this object in every cycle, right after sending.

    Attributes:
        overruns, skipped: Packets that left more than half a cycle late; grid points skipped after a stall beyond `CATCH_UP`.
        foreign: Datagrams that did not come from the gateway.
        sent_at: When the last packet left, on the monotonic clock [ns].
    """

    def __init__(
        self,
        controller: MockController,
        gateway: tuple[str, int],
        restart_after: float = 0.0,
        observe: Callable[[MockRsi], None] = lambda mock: None,
        log_line: Callable[[str], None] = log.info,
        fault_seed: int = 0,
    ):
        self.controller = controller
        self.faults = FaultBoard(controller, fault_seed)
        self.overruns = self.skipped = self.foreign = self.send_errors = self.sent_at = 0
        self._gateway = _resolve(*gateway)
        self._cycle = controller.config.cycle * NANOSECONDS // 1000
        #: Shortest distance of two packets [ns].
        self._closest = self._cycle // 2
        self._restart_after = round(restart_after * NANOSECONDS)
        self._observe = observe
        self._log = log_line
        self._requests: SimpleQueue[tuple[Callable[[], object], Future]] = SimpleQueue()
        self._socket, self._stamped = _open_socket()
        #: A reply that arrives later than this is too late for the open cycle [ns].
        self._ends = 0
        self._session = self._replies = 0
        self._stopped_at: int | None = None

    @property
    def counters(self) -> dict[str, int]:
        """The controller's counters, those of the transport, and what faults did to it."""
        names = ("overruns", "skipped", "foreign", "send_errors")
        lines = self.faults.to_pc, self.faults.to_controller
        kinds = ("dropped", "delayed", "doubled")
        by_faults = {kind: sum(getattr(line, kind) for line in lines) for kind in kinds}
        return self.controller.counters | {name: getattr(self, name) for name in names} | by_faults

    def request(self, action: Callable[[], Result], timeout: float = 1.0) -> Result:
        """Run `action` between two cycles of the loop, for another thread; TimeoutError after `timeout` [s]."""
        future: Future = Future()
        self._requests.put((action, future))
        return future.result(timeout)

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set; at most one cycle longer."""
        try:
            due = time.monotonic_ns()
            while not stop.is_set():
                self._serve_requests()
                self._follow_session(due)
                self.faults.tick()
                packet = self.controller.begin_cycle()
                self.sent_at = time.monotonic_ns()
                if packet is not None:
                    self._send(packet)
                sent = time.monotonic_ns()
                due = self.next_due(due, sent)
                self._ends = max(due, sent + self._closest)
                self._observe(self)
                self._receive_until(self._ends)
                if self.controller.refusals.log_lines:
                    self._log_refusals()
        finally:
            self._socket.close()

    def _serve_requests(self) -> None:
        while True:
            try:
                action, future = self._requests.get_nowait()
            except Empty:
                return
            try:
                future.set_result(action())
            except ConstructionTwinError as error:
                future.set_exception(error)

    def _follow_session(self, now: int) -> None:
        """Restart when due; every session gets a port of its own."""
        controller = self.controller
        if not controller.running:
            if self._stopped_at is None:
                self._stopped_at = now
                self._log(f"{controller.terms.protocol} session {controller.session} stopped: {controller.reason}")
            answered = controller.counters["replies"] > self._replies
            wait = self._restart_after if answered else min(self._restart_after, _UNANSWERED)
            due = self._restart_after and now - self._stopped_at >= wait
            if due and not controller.needs_person:
                controller.restart()
        if controller.running:
            self._stopped_at = None
        if controller.session != self._session:
            self._session = controller.session
            self._replies = controller.counters["replies"]
            # the new one first: while one of them asks for stamps, the kernel goes on stamping
            before = self._socket
            self._socket, self._stamped = _open_socket()
            before.close()
            begun = f"session {controller.session} started, {controller.terms.stamp} {controller.stamp}"
            self._log(f"{controller.terms.protocol} {begun}, gateway {self._gateway}")

    def _log_refusals(self) -> None:
        lines = self.controller.refusals.log_lines
        for sentence in lines:
            self._log(f"{self.controller.terms.protocol} session {self.controller.session}: {sentence}")
        lines.clear()

    def _send(self, packet: bytes) -> None:
        line = self.faults.to_pc
        if line.active:
            line.send(packet, time.monotonic_ns())
            self._deliver(time.monotonic_ns())
        else:
            self._put_on_wire(packet)

    def _put_on_wire(self, packet: bytes) -> None:
        try:
            self._socket.sendto(packet, self._gateway)
        except OSError:
            # e.g. no route: a controller does not notice it, it only gets no replies
            self.send_errors += 1

    def next_due(self, due: int, sent: int) -> int:
        """Return when the next packet is due, after one that was sent late or not [ns]; count what a long stall has cost."""
        late = sent - due
        self.overruns += late > self._closest
        skipped = late // self._cycle if late > CATCH_UP else 0
        self.skipped += skipped
        return due + (1 + skipped) * self._cycle

    def _receive_until(self, deadline: int) -> None:
        now = time.monotonic_ns()
        while True:
            wait = max(0, self._wake_up(deadline) - now) / NANOSECONDS
            if self._stamped:
                # the kernel has noted when each reply came: to read them at the end is one time less to wake up
                time.sleep(wait)
            else:
                # select: poll and epoll count in whole milliseconds
                select.select([self._socket], [], [], wait)
            # the time first: what arrived before the deadline is then read before the cycle ends
            now = time.monotonic_ns()
            self._drain()
            if self.faults.to_pc.active or self.faults.to_controller.active:
                self._deliver(now)
            if now >= deadline:
                return

    def _wake_up(self, deadline: int) -> int:
        """Return when something is to be done next, at the latest at `deadline` [ns]."""
        for line in (self.faults.to_pc, self.faults.to_controller):
            arrival = line.next_arrival() if line.active else None
            if arrival is not None and arrival < deadline:
                deadline = arrival
        return deadline

    def _deliver(self, now: int) -> None:
        """Deliver the datagrams whose delay is over."""
        for underway in self.faults.to_pc.pop_arrived(now):
            self._put_on_wire(underway.data)
        for underway in self.faults.to_controller.pop_arrived(now):
            self.controller.receive(underway.data, not self._stamped or underway.due <= self._ends)

    def _drain(self) -> None:
        while True:
            try:
                data, stamp, source = receive(self._socket)
            except BlockingIOError:
                return
            if source != self._gateway:
                self.foreign += 1
                continue
            now = time.monotonic_ns()
            arrived = min(stamp + steady_offset(), now) if self._stamped else now
            if self.faults.to_controller.active:
                self.faults.to_controller.send(data, arrived)
            else:
                self.controller.receive(data, not self._stamped or arrived <= self._ends)


def _open_socket() -> tuple[socket.socket, bool]:
    """Return a socket on a port of the system's choice on all addresses, as the controller opens it, and whether it has stamps."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.bind(("", 0))
    return sock, enable_timestamps(sock)


def _resolve(host: str, port: int) -> tuple[str, int]:
    try:
        address = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
    except OSError as error:
        raise ConstructionTwinError(
            f"gateway host {host!r} port {port}: {error}; give an IPv4 address or a known name"
        ) from error
    return str(address[0]), int(address[1])
