"""JPEG pictures from a camera's stream: HTTP's answer, then ``multipart/x-mixed-replace`` (RFC 2046, section 5.1). Pure.

Cameras are not to be trusted more than any other device of a network: lengths and headers are bounded, and what is none is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence

#: Largest picture, head of the answer, and headers of a part [bytes].
LARGEST, LARGEST_HEAD, _LARGEST_HEADERS = 2 * 2**20, 16384, 4096
_STATUS = re.compile(rb"HTTP/1\.[01] (\d{3})(?: |$)")
_BOUNDARY = re.compile(rb';\s*boundary\s*=\s*(?:"([^"\r\n]{1,72})"|([^\s";,]{1,72}))', re.IGNORECASE)
_LENGTH = re.compile(rb"\d{1,9}")
#: How each JPEG begins.
_JPEG = b"\xff\xd8"


def boundary_of(head: bytes) -> bytes:
    """Return what separates the pictures of a stream.

    Args:
        head: HTTP's answer, to the empty line.

    Raises:
        PayloadError: ``mjpeg`` when it is no such stream.
    """
    lines = head.split(b"\r\n")
    status = _STATUS.match(lines[0])
    if status is None or status[1] != b"200":
        raise PayloadError("mjpeg", Sentence("view.camera.status", line=_shown(lines[0])))
    headers: dict[bytes, bytes] = {}
    for line in lines[1:]:
        name, _, value = line.partition(b":")
        headers[name.strip().lower()] = value.strip()
    if b"transfer-encoding" in headers:
        raise PayloadError("mjpeg", Sentence("view.camera.encoding", encoding=_shown(headers[b"transfer-encoding"])))
    kind = headers.get(b"content-type", b"")
    found = _BOUNDARY.search(kind)
    if not kind.lower().startswith(b"multipart/x-mixed-replace") or found is None:
        raise PayloadError("mjpeg", Sentence("view.camera.kind", kind=_shown(kind)))
    return found[1] or found[2]


def _shown(text: bytes) -> str:
    return repr(text[:80].decode("ascii", "replace"))


class PictureReader:
    """Cuts a stream into pictures. It keeps one picture at most, whatever comes.

    Args:
        boundary: As `boundary_of` returns it. Some cameras write its two dashes into the header, too.
        largest: Longest picture [bytes].

    Attributes:
        refused: Parts that were no JPEG.
    """

    def __init__(self, boundary: bytes, largest: int = LARGEST):
        self._mark = boundary if boundary.startswith(b"--") else b"--" + boundary
        self._largest = largest
        self._rest = bytearray()
        self._step: Callable[[list[bytes]], bool] = self._between
        self._length: int | None = None
        self._headers = self._skipped = self._looked = 0
        self.refused = 0

    @property
    def kept(self) -> int:
        """How much is kept until more has come [bytes]."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes; return the pictures that are complete now, the oldest first.

        Raises:
            PayloadError: ``size`` when a picture or its headers are too long, ``mjpeg`` for what is no stream of pictures, or its
                end. Nothing can be read of it any more.
        """
        self._rest += data
        pictures: list[bytes] = []
        while self._step(pictures):
            pass
        return pictures

    # -- steps: each returns whether another one can follow

    def _between(self, _pictures: list[bytes]) -> bool:
        """Look for the line that begins a part."""
        rest, mark = self._rest, self._mark
        at = rest.find(mark)
        if at < 0:
            self._skip(max(0, len(rest) - len(mark) + 1))
            return False
        self._skip(at)
        end = rest.find(b"\n", len(mark))
        if end < 0:
            if len(rest) > _LARGEST_HEADERS:
                raise PayloadError("size", Sentence("view.camera.headers", most=_LARGEST_HEADERS))
            return False
        if rest.startswith(b"--", len(mark)):
            raise PayloadError("mjpeg", Sentence("view.camera.end"))
        del rest[: end + 1]
        self._length, self._headers, self._skipped = None, 0, 0
        self._step = self._header
        return True

    def _skip(self, count: int) -> None:
        self._skipped += count
        if self._skipped > self._largest:
            raise PayloadError("mjpeg", Sentence("view.camera.no_part", bytes=self._skipped))
        del self._rest[:count]

    def _header(self, _pictures: list[bytes]) -> bool:
        """Read one line of a part's headers."""
        rest = self._rest
        end = rest.find(b"\n")
        self._headers += end + 1
        if max(self._headers, self._headers + len(rest) if end < 0 else 0) > _LARGEST_HEADERS:
            raise PayloadError("size", Sentence("view.camera.headers", most=_LARGEST_HEADERS))
        if end < 0:
            return False
        line = bytes(rest[:end]).strip()
        del rest[: end + 1]
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            value = value.strip()
            if _LENGTH.fullmatch(value) is None:
                raise PayloadError("mjpeg", Sentence("view.camera.length", length=_shown(value)))
            self._length = int(value)
            if self._length > self._largest:
                raise PayloadError("size", Sentence("view.camera.large", bytes=self._length, most=self._largest))
        if not line:
            self._looked = 0
            self._step = self._body if self._length is None else self._measured
        return True

    def _measured(self, pictures: list[bytes]) -> bool:
        """Take a picture whose length its headers say."""
        assert self._length is not None
        if len(self._rest) < self._length:
            return False
        return self._take(self._length, pictures)

    def _body(self, pictures: list[bytes]) -> bool:
        """Take a picture that ends where the next part begins."""
        rest, mark = self._rest, b"\n" + self._mark
        at = rest.find(mark, self._looked)
        if max(at, len(rest) - len(mark) if at < 0 else 0) > self._largest:
            raise PayloadError("size", Sentence("view.camera.large", bytes=len(rest), most=self._largest))
        if at < 0:
            self._looked = max(0, len(rest) - len(mark) + 1)
            return False
        return self._take(at - (at > 0 and rest[at - 1] == 0x0D), pictures)

    def _take(self, length: int, pictures: list[bytes]) -> bool:
        picture = bytes(self._rest[:length])
        del self._rest[:length]
        if picture.startswith(_JPEG):
            pictures.append(picture)
        else:
            self.refused += 1
        self._step = self._between
        return True
