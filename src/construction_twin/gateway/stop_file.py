"""The file that keeps a stop or fault, until a reset, over restarts (docs/architecture.md, law 5).

It is written beside the loop, which waits for no disk, and in place: a disk that is full later takes every stop.
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file, write_in_place
from construction_twin.core.sentences import Sentence

log = logging.getLogger("rsi_gateway")

#: What the file has from its first start on, and the longest sentence that is kept [bytes].
ROOM, LONGEST = 4096, 1000
#: A file that could not be written is tried again after this time [s].
_AGAIN = 0.5


class StopFile:
    """Saves why the arm was stopped, until `close`; `found` is the text of the program before this one, "" for none."""

    def __init__(self, path: str | Path):
        self._path = Path(path)
        try:
            self.found = self._read()
            write_in_place(self._path, self.found, ROOM)
        except OSError as error:
            expected = f"a file that can be written ({error.strerror})"
            raise ConfigurationError("--stop-file", str(path), expected) from error
        self._wanted = self._written = self.found
        self._changed = threading.Event()
        self._ends = False
        self._writer = threading.Thread(target=self._run, name="stop file", daemon=True)
        self._writer.start()

    def _read(self) -> str:
        try:
            return read_file(self._path, ROOM * 4).decode().strip()
        except FileNotFoundError:
            return ""
        except UnicodeDecodeError:
            # whatever it was, it was not nothing
            return Sentence("what {path} says of a stop cannot be read", path=str(self._path))

    def save(self, reason: str) -> None:
        """Queue the reason of the stop for writing, "" after a reset."""
        # what a message named may be no text: half a surrogate pair
        reason = reason[:LONGEST].encode(errors="replace").decode()
        if reason != self._wanted:
            self._wanted = reason
            self._changed.set()

    def close(self) -> None:
        """Finish pending writes, within a second."""
        self._ends = True
        self._changed.set()
        self._writer.join(1.0)

    def _run(self) -> None:
        while not self._ends or self._changed.is_set():
            self._changed.wait()
            self._changed.clear()
            wanted = self._wanted
            while wanted != self._written and not self._write(wanted) and not self._ends:
                self._changed.wait(_AGAIN)
                self._changed.clear()
                wanted = self._wanted

    def _write(self, reason: str) -> bool:
        try:
            write_in_place(self._path, reason, ROOM)
        except OSError as error:
            lasts = "whether the arm is stopped would not outlast this program; mend it"
            log.error("%s was not written (%s): %s", self._path, error.strerror, lasts)
            return False
        self._written = reason
        return True
