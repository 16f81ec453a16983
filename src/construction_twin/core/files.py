"""Bounded reading of foreign files, and atomic writing."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from pathlib import Path

from construction_twin.core.errors import ConfigurationError


def read_file(path: str | Path, most: int) -> bytes:
    """Read a regular file of at most `most` bytes; an OSError's `strerror` completes a sentence."""
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        contents = file.read(most + 1)
    if len(contents) > most:
        raise OSError(errno.EFBIG, f"larger than {most / 2**20:.4g} MiB", str(path))
    return contents


def write_atomically(path: Path, contents: str | bytes) -> None:
    """Write a file in one step: readers see the old or the new contents."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # not with_name, which refuses "." with another error
    temporary = path.parent / f"{path.name}.{os.getpid()}.tmp"
    try:
        temporary.write_bytes(contents.encode() if isinstance(contents, str) else contents)
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def write_in_place(path: Path, text: str, room: int) -> None:
    """Overwrite a file's text on the disk, padded with blanks to `room` [bytes]."""
    data = text.encode().ljust(room)
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        if os.write(file, data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        os.ftruncate(file, len(data))
        os.fsync(file)
    finally:
        os.close(file)


def check_writable(folder: str | Path) -> None:
    """Check, before a long computation, that a folder can be made and takes files."""
    folder = Path(folder).absolute()
    there = next(parent for parent in (folder, *folder.parents) if os.path.lexists(parent))
    try:
        # only trying tells: permissions do not bind root, and a disk may be full or read-only
        with tempfile.NamedTemporaryFile(dir=there) as file:
            file.write(b"0")
    except OSError as error:
        found = f"{there}: {error.strerror or error}"
        raise ConfigurationError(str(folder), found, "a folder that files can be written into") from error
