"""A camera for tests: MJPEG over HTTP on loopback, with pictures that the test gives, and faults that it asks for."""

from __future__ import annotations

import io
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
from matplotlib import image


def jpeg(shade: int, size: int = 32) -> bytes:
    """Return a picture of one shade of grey, from 0 to 255."""
    buffer = io.BytesIO()
    pixels = np.full((size, size, 3), shade / 255.0)
    image.imsave(buffer, pixels, format="jpeg")
    return buffer.getvalue()


class MjpegCamera:
    """Serves pictures to whoever connects, each `period` [s], until it is stopped.

    Attributes:
        picture: What is sent now.
        frozen: Sends nothing, and keeps its connections.
        sent: Bytes sent by now.
        connections: How often somebody has connected.
        open: Connections that are open.
        requests: First lines of what was asked.
    """

    def __init__(self, period: float = 0.05, port: int = 0, kind: str = "multipart/x-mixed-replace; boundary=frame"):
        self.picture = jpeg(128)
        self.frozen = False
        self.sent = self.connections = self.open = 0
        self.requests: list[str] = []
        self.head = f"HTTP/1.0 200 OK\r\nContent-Type: {kind}\r\n\r\n".encode()
        self._period = period
        self._ended = threading.Event()
        self._server = socket.create_server(("127.0.0.1", port))
        self.port = self._server.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/stream?size=small"
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def part(self) -> bytes:
        """Return the present picture as a part of the stream."""
        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(self.picture)}\r\n\r\n"
        return head.encode() + self.picture + b"\r\n"

    def _accept(self) -> None:
        while not self._ended.is_set():
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _pieces(self) -> Iterator[bytes]:
        yield self.head
        while not self._ended.is_set():
            if not self.frozen:
                yield self.part()
            time.sleep(self._period)

    def _serve(self, connection: socket.socket) -> None:
        self.connections += 1
        self.open += 1
        try:
            with connection:
                connection.settimeout(5.0)
                self.requests.append(connection.recv(4096).partition(b"\r\n")[0].decode())
                for piece in self._pieces():
                    connection.sendall(piece)
                    self.sent += len(piece)
        except OSError:
            pass
        finally:
            self.open -= 1

    def close(self) -> None:
        """End it and its connections, as a power cut would."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def __enter__(self) -> MjpegCamera:
        return self

    def __exit__(self, *_) -> None:
        self.close()
