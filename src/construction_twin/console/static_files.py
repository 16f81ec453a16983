"""The files that the console serves, with their hashes, compressed where that helps.

The page is read once, at the start; other folders are looked through at each request, and a file is read again when it has changed.
No path of a request ever reaches the file system: a name is looked up among the names that are there.
"""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence

#: Largest file, and all together [bytes].
LARGEST, LARGEST_SUM = 64 * 2**20, 256 * 2**20
#: Kinds that the machine's own table may not know.
_KINDS = {
    ".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css", ".html": "text/html", ".csv": "text/csv",
    ".json": "application/json", ".webmanifest": "application/manifest+json", ".urdf": "application/xml",
    ".svg": "image/svg+xml", ".png": "image/png",
    ".dae": "model/vnd.collada+xml", ".stl": "model/stl", ".glb": "model/gltf-binary", ".obj": "model/obj",
}  # fmt: skip
_COMPRESSIBLE = ("text/", "application/json", "application/xml", "model/", "image/svg")
#: A name with a hash of its content, as esbuild writes it (8 of base 32) or in hexadecimal: it never changes, so that a browser
#: need not ask again. A word or a date is none.
_HASHED = re.compile(r"(?:^|[.-])(?:(?=\d*[A-Z])[0-9A-Z]{8}|[0-9a-f]{12,64})\.\w+$")


@dataclass(frozen=True)
class StaticFile:
    """One file.

    Attributes:
        kind: Its media type.
        compressed: By gzip; None where that is no smaller.
        tag: SHA-256 of `body`, as a browser gets it back as ``ETag``.
        lasting: Its name holds a hash.
    """

    kind: str
    body: bytes
    compressed: bytes | None
    tag: str
    lasting: bool

    @classmethod
    def of(cls, name: str, body: bytes) -> StaticFile:
        """Return the file of that name and content."""
        suffix = Path(name).suffix.lower()
        kind = _KINDS.get(suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
        compressed = gzip.compress(body, 6, mtime=0) if kind.startswith(_COMPRESSIBLE) else None
        if compressed is not None and len(compressed) >= len(body):
            compressed = None
        if kind.startswith(("text/", "application/json", "application/xml")):
            kind += "; charset=utf-8"
        return cls(kind, body, compressed, f'"{hashlib.sha256(body).hexdigest()}"', bool(_HASHED.search(name)))


def read_folder(folder: Path) -> Mapping[str, StaticFile]:
    """Return the files of a folder and its folders, by the path of the request that gets them.

    Raises:
        ConfigurationError: When there is no such folder, or a file is too large.
    """
    if not folder.is_dir():
        raise ConfigurationError("console files", str(folder), Sentence("expected.folder"))
    files: dict[str, StaticFile] = {}
    total = 0
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if not path.is_file() or any(part.startswith(".") for part in name.parts):
            continue
        size = path.stat().st_size
        total += size
        if size > LARGEST or total > LARGEST_SUM:
            raise ConfigurationError(str(path), size, Sentence("expected.size_of_all", most=LARGEST, sum=LARGEST_SUM))
        files["/" + name.as_posix()] = StaticFile.of(name.name, path.read_bytes())
    return files


def names(folder: Path) -> Mapping[str, Path]:
    """Return the files of a folder and its folders by their relative names, without hidden ones and links out of the folder."""
    root = folder.resolve()
    return {
        path.relative_to(root).as_posix(): path
        for path in sorted(root.rglob("*"))
        if path.is_file()
        and path.resolve().is_relative_to(root)
        and not any(part.startswith(".") for part in path.relative_to(root).parts)
    }


class FileCache:
    """Files that may change while the console runs, kept as long as they stay what they were. Used by several threads."""

    def __init__(self) -> None:
        self._kept: dict[Path, tuple[tuple[int, int], StaticFile]] = {}
        self._lock = threading.Lock()

    def read(self, path: Path) -> StaticFile | None:
        """Return a file as it is now; None when it has gone, or may not be read.

        Raises:
            ConfigurationError: When it is too large.
        """
        try:
            status = path.stat()
            seen = status.st_mtime_ns, status.st_size
            with self._lock:
                kept = self._kept.get(path)
            if kept is not None and kept[0] == seen:
                return kept[1]
            if status.st_size > LARGEST:
                raise ConfigurationError(str(path), status.st_size, Sentence("expected.size", most=LARGEST))
            file = StaticFile.of(path.name, path.read_bytes())
        except (FileNotFoundError, PermissionError):
            return None
        with self._lock:
            self._kept[path] = seen, file
            while sum(len(each.body) for _, each in self._kept.values()) > LARGEST_SUM:
                del self._kept[next(iter(self._kept))]
        return file
