"""From the datagrams that wait in the gateway's socket to the one telegram that is answered. Standard library only; ns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from construction_twin.controller.telegram import Telegram, stamp_step
from construction_twin.core.errors import TelegramError
from construction_twin.gateway.gateway import Gateway

#: Datagrams read before anything else gets its turn: a flood must not stop the loop.
DRAIN_LIMIT = 64


@dataclass(frozen=True, slots=True)
class Arrival:
    """A telegram that is to be answered, with address and port of its sender, and when it arrived [ns]."""

    telegram: Telegram
    source: tuple
    arrived: int


class TelegramInbox:
    """Reads what has come since the last time; what is noticed is counted in the gateway.

    Args:
        receive: Returns a datagram, its time of arrival [ns] and its source, without waiting, or raises BlockingIOError.
        clock: Returns the gateway's monotonic time [ns].
        controller: Only datagrams from this IPv4 address are read; None reads any.
    """

    def __init__(
        self,
        gateway: Gateway,
        receive: Callable[[], tuple[bytes, int, tuple]],
        clock: Callable[[], int],
        controller: str | None = None,
    ):
        self._gateway = gateway
        self._receive = receive
        self._clock = clock
        self._controller = controller
        reader = gateway.config.make.reader(gateway.config)
        self._parse, self._status, self._tool = reader.parse, reader.status, reader.tool
        self._timeout_ms = round(gateway.config.timeout * 1000)

    def newest(self) -> Arrival | None:
        """Read until nothing waits; return the newest telegram.

        An answer to any other would come too late (docs/rsi.md, section 4). Whatever is no telegram is dropped here, so that it
        cannot take the place of one; nor can a copy of an older one that the network brings last.
        """
        newest: Arrival | None = None
        counters = self._gateway.counters
        for _ in range(DRAIN_LIMIT):
            try:
                data, arrived, source = self._receive()
            except BlockingIOError:
                break
            except OSError as error:
                # e.g. ICMP "port unreachable" for a reply to a controller that has just gone
                counters[f"udp_receive_{error.errno}"] += 1
                break
            telegram = self._read(data, source)
            if telegram is None:
                continue
            self._gateway.clock.note(telegram.controller_ms, arrived)
            if self._status is not None:
                self._gateway.controller.note_status(*self._status(data))
            if newest is not None:
                behind = stamp_step(telegram.controller_ms, newest.telegram.controller_ms, self._timeout_ms)
                if source == newest.source and 0 <= behind <= self._timeout_ms:
                    counters["telegrams_repeated"] += 1
                    continue
                counters["telegrams_skipped"] += 1
            newest = Arrival(telegram, source, arrived)
            if self._tool is not None and self._gateway.tool is not None:
                self._gateway.tool.note(self._tool(data))
        return newest

    def _read(self, data: bytes, source: tuple) -> Telegram | None:
        refusals = self._gateway.refusals
        if self._controller is not None and source[0] != self._controller:
            why = f"datagrams from {source[0]} are not read, because --controller is {self._controller}"
            refusals.telegram("address", why)
            return None
        if not self._gateway.controller.accepts(source, self._clock()):
            why = f"a datagram from {source[0]}:{source[1]} while another sender's session is alive"
            refusals.telegram("source", why)
            return None
        try:
            telegram = self._parse(data)
        except TelegramError as error:
            refusals.telegram(error.reason, error)
            return None
        refusals.unread = 0
        return telegram
