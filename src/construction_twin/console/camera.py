"""One camera: a single connection to it for all who look, as long as somebody does; of its pictures only the newest is kept."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from dataclasses import dataclass

from construction_twin.console.mjpeg import LARGEST, LARGEST_HEAD, PictureReader, boundary_of
from construction_twin.core.camera_address import CameraAddress
from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence

log = logging.getLogger("console")
_CHUNK = 65536


@dataclass(frozen=True)
class CameraLimits:
    """What a camera may take, and what is taken of it.

    Attributes:
        connect_s: Longest wait for its connection, and for its answer [s].
        silence_s: Longest wait for a picture [s]; from then on it is gone.
        first_wait_s, longest_wait_s: Wait before the next attempt: at first, and at most [s].
        largest: Longest picture [bytes].
        viewers, viewers_per_browser: Who looks at once.
    """

    connect_s: float = 4.0
    silence_s: float = 4.0
    first_wait_s: float = 0.5
    longest_wait_s: float = 10.0
    largest: int = LARGEST
    viewers: int = 16
    viewers_per_browser: int = 4


@dataclass(frozen=True)
class Picture:
    """The newest picture.

    Attributes:
        number: Rises with each picture that has come.
        at: When it came, by the event loop's clock [s].
    """

    number: int
    at: float
    jpeg: bytes


class Camera:
    """Reads a camera while somebody looks.

    Attributes:
        newest: None while there is none, and as soon as the connection is lost: an old picture is not kept for who comes next.
        connections: How often it was connected to.
    """

    def __init__(self, address: CameraAddress, limits: CameraLimits | None = None):
        self.address = address
        self.limits = limits or CameraLimits()
        self.newest: Picture | None = None
        self.connections = 0
        self._count = 0
        self._viewers: list[str] = []
        self._task: asyncio.Task[None] | None = None
        self._changed = asyncio.Event()
        self._said = ""

    def has_place(self, browser: str) -> bool:
        """Return whether one more may look, in this browser."""
        limits = self.limits
        return len(self._viewers) < limits.viewers and self._viewers.count(browser) < limits.viewers_per_browser

    @contextlib.asynccontextmanager
    async def viewed(self, browser: str) -> AsyncIterator[None]:
        """Read the camera while somebody looks; the last one who leaves ends that."""
        self._viewers.append(browser)
        if self._task is None:
            self._task = asyncio.create_task(self._read())
        try:
            yield
        finally:
            self._viewers.remove(browser)
            if not self._viewers and self._task is not None:
                task, self._task = self._task, None
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)

    async def change(self, patience: float) -> None:
        """Wait until another picture has come, or the camera has gone; at most so long [s]."""
        changed = self._changed
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(changed.wait(), patience)

    def _tell(self, newest: Picture | None) -> None:
        self.newest = newest
        self._changed.set()
        self._changed = asyncio.Event()

    async def _read(self) -> None:
        wait = self.limits.first_wait_s
        try:
            while True:
                before = self._count
                try:
                    await self._watch()
                except (OSError, TimeoutError, PayloadError, asyncio.IncompleteReadError, ValueError) as error:
                    self._say(str(error) or Sentence("view.pipe.no_answer"))
                self._tell(None)
                # it was there: the first attempt comes soon
                wait = self.limits.first_wait_s if self._count > before else min(2 * wait, self.limits.longest_wait_s)
                await asyncio.sleep(wait)
        finally:
            self._tell(None)

    async def _watch(self) -> None:
        """Connect, and take pictures until that fails."""
        address, limits = self.address, self.limits
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(limits.connect_s):
            reader, writer = await asyncio.open_connection(address.host, address.port, limit=LARGEST_HEAD)
        try:
            self.connections += 1
            host = f"[{address.host}]" if ":" in address.host else address.host
            # 1.0: an answer of 1.1 may come in chunks
            request = f"GET {address.path} HTTP/1.0\r\nHost: {host}:{address.port}\r\nAccept: multipart/x-mixed-replace\r\n\r\n"
            writer.write(request.encode("ascii"))
            async with asyncio.timeout(limits.connect_s):
                head = await reader.readuntil(b"\r\n\r\n")
            pictures = PictureReader(boundary_of(head), limits.largest)
            deadline = loop.time() + limits.silence_s
            while True:
                # bytes alone are no picture: a camera that sends one byte a second is gone, too
                async with asyncio.timeout_at(deadline):
                    data = await reader.read(_CHUNK)
                if not data:
                    raise PayloadError("mjpeg", Sentence("view.camera.end"))
                if found := pictures.feed(data):
                    self._say("")
                    self._count += len(found)
                    now = loop.time()
                    deadline = now + limits.silence_s
                    self._tell(Picture(self._count, now, found[-1]))
        finally:
            writer.transport.abort()

    def _say(self, problem: str) -> None:
        """Write a line when what there is to say has changed."""
        if problem == self._said:
            return
        self._said = problem
        where = f"camera {self.address.name} of {self.address.robot}"
        log.log(logging.WARNING if problem else logging.INFO, "%s: %s", where, problem or "there are pictures")
