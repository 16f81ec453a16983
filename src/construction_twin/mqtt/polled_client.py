"""An MQTT connection served from the caller's select loop, in whose thread the gateway also answers RSI packets.

Reading and writing never block; connecting, which can take seconds, has a thread of its own.
"""

from __future__ import annotations

import selectors
import socket
import ssl
import threading
import time
from collections.abc import Callable

from construction_twin.mqtt.fast_client import FastClient

#: Pause between attempts to connect [s].
RETRY = 0.5
#: Packets handled in a row when TLS holds more than one: a telegram that comes meanwhile waits for them.
_MAX_PACKETS = 3


class PolledClient:
    """Drives a paho client from a selector loop, where its socket is registered with this object as data.

    Args:
        client: With `connect_async` called and callbacks set.
        on_failure: Called in the thread that connects.
    """

    def __init__(
        self,
        client: FastClient,
        selector: selectors.BaseSelector,
        on_failure: Callable[[OSError], None] = lambda error: None,
    ):
        self.client = client
        self._selector = selector
        self._on_failure = on_failure
        self._registered = None
        self._events = 0
        self._connector: threading.Thread | None = None
        self._retry_at = 0.0
        self._misc_at = 0.0

    @property
    def connected(self) -> bool:
        """True between the broker's CONNACK and the loss of the connection."""
        return self._registered is not None and self.client.is_connected()

    @property
    def pending(self) -> bool:
        """True when there is more to read that no socket shows: call `read` again without waiting."""
        return self.connected and self._decrypted()

    def read(self) -> None:
        """Handle received packets: of TCP one, of TLS all that are decrypted."""
        self.client.loop_read(1)
        for _ in range(_MAX_PACKETS):
            if not self._decrypted():
                return
            self.client.loop_read(1)

    def service(self, now: float) -> None:
        """Write what is queued, keep the connection alive, connect again when it is lost; `now` is monotonic [s]."""
        if self._connector is not None:
            if self._connector.is_alive():
                return
            self._connector = None
        sock = self.client.socket()
        if sock is not self._registered:
            self._register(sock)
        if sock is None:
            self._connect(now)
            return
        if self.client.want_write():
            self.client.loop_write()
        if self._decrypted():
            self.read()
        if now >= self._misc_at:
            self._misc_at = now + 0.5
            if isinstance(sock, ssl.SSLSocket):
                # a TLS read can stop because TLS wants to write first; then no event says when to go on
                self.client.loop_read(1)
            self.client.loop_misc()
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if self.client.want_write() else 0)
        if self.client.socket() is sock and wanted != self._events:
            self._selector.modify(sock, wanted, self)
            self._events = wanted

    def _decrypted(self) -> bool:
        sock = self.client.socket()
        return isinstance(sock, ssl.SSLSocket) and sock.pending() > 0

    def close(self) -> None:
        """Disconnect and wait until the broker has closed the connection, at most 1 s."""
        sock = self.client.socket()
        # paho closes its socket at once; with an answer still unread the broker would see a reset, and could lose our last words.
        # Of a TLS socket the TCP socket below is kept: what comes in is not read, only waited for
        line = socket.fromfd(sock.fileno(), sock.family, sock.type) if isinstance(sock, socket.socket) else None
        self.client.disconnect()
        deadline = time.monotonic() + 1.0
        while self.client.want_write() and time.monotonic() < deadline:
            self.client.loop_write()
        if line is not None:
            with line:
                _await_close(line, deadline)

    def _register(self, sock) -> None:
        if self._registered is not None:
            # the old socket is closed already and its number may be in use again: look it up by key, not by number
            for key in list(self._selector.get_map().values()):
                if key.data is self:
                    self._selector.unregister(key.fileobj)
        if sock is not None:
            self._selector.register(sock, selectors.EVENT_READ, self)
            self._events = selectors.EVENT_READ
        self._registered = sock

    def _connect(self, now: float) -> None:
        if now < self._retry_at:
            return
        self._retry_at = now + RETRY
        self._connector = threading.Thread(target=self._try_connect, name="mqtt-connect", daemon=True)
        self._connector.start()

    def _try_connect(self) -> None:
        try:
            self.client.reconnect()
        except OSError as error:
            # service() tries again; `connected` stays False
            self._on_failure(error)


def _await_close(line: socket.socket, deadline: float) -> None:
    try:
        while (remaining := deadline - time.monotonic()) > 0:
            line.settimeout(remaining)
            if not line.recv(4096):
                return
    except OSError:
        # timed out or reset: the broker is gone
        return
