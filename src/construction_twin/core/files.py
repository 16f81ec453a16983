"""Files from outside: read whole, or refused before they can do harm."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path


def read_file(path: str | Path, most: int) -> bytes:
    """Read a regular file of limited size.

    A named pipe would keep its reader waiting for ever, and a device has no end: neither is opened for waiting.

    Parameters
    ----------
    path : str or Path
    most : int
        Largest size [bytes].

    Raises
    ------
    OSError
        If it cannot be read, is not a regular file, or is larger; `strerror` is a phrase for a sentence.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        contents = file.read(most + 1)
    if len(contents) > most:
        raise OSError(errno.EFBIG, f"larger than {most / 2**20:.4g} MiB", str(path))
    return contents


def write_whole(path: Path, text: str) -> None:
    """Write a text file in one step: a reader sees the old text or the new one, never a part.

    Raises
    ------
    OSError
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)
