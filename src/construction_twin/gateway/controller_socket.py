"""The controller's socket: reads the newest telegram, answers it. ns."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

from construction_twin.controller.port import Encoder
from construction_twin.controller.telegram import Telegram, stamp_step
from construction_twin.core.errors import TelegramError
from construction_twin.core.histogram import Histogram
from construction_twin.core.network import receive
from construction_twin.gateway.gateway import Gateway

#: Datagrams read before anything else gets its turn: a flood must not stop the loop.
DRAIN_LIMIT = 64


@dataclass(frozen=True, slots=True)
class Arrival:
    """A telegram to be answered, with address and port of its sender, and its arrival [ns]."""

    telegram: Telegram
    source: tuple
    arrived: int


class TelegramInbox:
    """Reads the datagrams that wait; refused ones are counted in the gateway.

    Args:
        receive: Returns a datagram, its arrival [ns] and its source, or raises BlockingIOError.
        controller: The only IPv4 address that is read; None: any.
    """

    def __init__(
        self,
        gateway: Gateway,
        receive: Callable[[], tuple[bytes, int, tuple]],
        controller: str | None = None,
    ):
        self._gateway = gateway
        self._receive = receive
        self._controller = controller
        reader = gateway.config.make.reader(gateway.config)
        self.parse, self._status, self._tool = reader.parse, reader.status, reader.tool
        self._timeout_ms = round(gateway.config.timeout * 1000)

    def newest(self, now: int) -> Arrival | None:
        """Read until nothing waits; return the newest telegram: answers to others would be too late (docs/rsi.md, section 4)."""
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
            telegram = self._read(data, source, now)
            if telegram is None:
                continue
            self._gateway.clock.on_telegram(telegram.controller_ms, arrived)
            if self._status is not None:
                self._gateway.controller.on_status(*self._status(data))
            if newest is not None:
                behind = stamp_step(telegram.controller_ms, newest.telegram.controller_ms, self._timeout_ms)
                if source == newest.source and 0 <= behind <= self._timeout_ms:
                    counters["telegrams_repeated"] += 1
                    continue
                counters["telegrams_skipped"] += 1
            newest = Arrival(telegram, source, arrived)
            self._gateway.controller.datagram = data
            if self._tool is not None and self._gateway.tool is not None:
                self._gateway.tool.on_reading(self._tool(data))
        return newest

    def _read(self, data: bytes, source: tuple, now: int) -> Telegram | None:
        refusals = self._gateway.refusals
        if self._controller is not None and source[0] != self._controller:
            why = f"datagrams from {source[0]} are not read, because --controller is {self._controller}"
            refusals.count_telegram("address", why)
            return None
        if not self._gateway.controller.accepts(source, now):
            why = f"a datagram from {source[0]}:{source[1]} while another sender's session is alive"
            refusals.count_telegram("source", why)
            return None
        try:
            telegram = self.parse(data)
        except TelegramError as error:
            refusals.count_telegram(error.reason, error)
            return None
        refusals.unread = 0
        return telegram


class ControllerSocket:
    """Answers one controller: as a `Gateway` says, or after its failure as the last resort does; see `TelegramInbox`."""

    def __init__(self, gateway: Gateway, sock: socket.socket, controller: str | None = None):
        config = gateway.config
        make = config.make
        self.reply_time = Histogram.of_microseconds()
        self.last_resort = make.last_resort(config)
        # a second one: whatever has become of the inbox's, it reads on after a failure
        self._parse = make.reader(config).parse
        self.inbox = TelegramInbox(gateway, self._receive, controller)
        self.encoder = make.encoder(config) if config.layout.expects_replies else None
        self._gateway = gateway
        self._sock = sock
        # the datagram read last, and its source
        self._datagram: tuple[bytes, tuple] | None = None
        self._held_channels: tuple[bool, ...] = ()

    def _receive(self) -> tuple[bytes, int, tuple]:
        data, arrived, source = datagram = receive(self._sock)
        self._datagram = data, source
        return datagram

    def serve(self, now: int) -> bool:
        """Answer the newest telegram; return whether there was one."""
        newest = self.inbox.newest(now)
        if newest is None:
            return False
        gateway, telegram, source = self._gateway, newest.telegram, newest.source
        carried = gateway.on_telegram(telegram, source, now)
        if carried is not None and self.encoder is not None:
            stop = True if gateway.ends_program else None
            switched = self._switched(self.encoder) if gateway.tool is not None else ()
            self._send(self.encoder.encode(carried, telegram.controller_ms, stop, switched), source)
            self.last_resort.on_reply_sent(
                telegram.controller_ms, source, carried, gateway.controller.acknowledged_target, telegram.missed
            )
            self.reply_time.add((time.time_ns() - newest.arrived) / 1e3)
        return True

    def _switched(self, encoder: Encoder) -> tuple[bool, ...]:
        """Return the tool's channels of a reply, and hand them to the last resort."""
        tool = self._gateway.tool
        assert tool is not None
        holding = tool.channels()
        if holding != self._held_channels:
            self._held_channels = holding
            ending = encoder.template(True, tool.channels(ending=True))
            self.last_resort.set_templates(encoder.template(None, holding), ending)
        return tool.channels(ending=True) if self._gateway.ends_program else holding

    def _send(self, reply: bytes, source: tuple) -> None:
        try:
            self._sock.sendto(reply, source)
        except OSError as error:
            self._gateway.counters[f"udp_send_{error.errno}"] += 1

    def answer_as_last_resort(self) -> bool:
        """Answer the controller as the last resort; return whether there is a pose to report."""
        resort = self.last_resort
        newest, waiting = None, self._datagram
        self._datagram = None
        for _ in range(DRAIN_LIMIT):
            if waiting is not None:
                stamp = resort.stamp_of(*waiting)
                if stamp is not None and (newest is None or resort.is_newer(stamp, newest[0])):
                    newest = stamp, *waiting
            try:
                data, _, source = receive(self._sock)
            except OSError:
                # nothing more waits, or the system reports what became of an earlier reply
                break
            waiting = data, source
        if newest is None:
            return False
        stamp, data, source = newest
        lost = resort.rewind_if_lost(stamp, data)
        reply = resort.answer(stamp)
        if reply is not None:
            self._send(reply, source)
        self._gateway.on_last_resort(self._parse(data), resort.target, lost)
        return True
