"""The file in which the messages of a robot outlast the node that keeps them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import read_file, write_whole
from construction_twin.views.message_history import MessageHistory

#: Largest file that is read [bytes].
MOST = 4 << 20
#: As what it is counted that the file cannot be read or written.
REASON = "messages"


class MessageFile:
    """One file with a robot's messages."""

    def __init__(self, path: Path):
        self._path = path

    def read(self, refuse: Callable[[str, str], None]) -> bytes:
        """Return the file's text; empty where there is none, and where it is none of ours, which is counted."""
        try:
            text = read_file(self._path, MOST)
            MessageHistory(lambda: "", text)
        except FileNotFoundError:
            return b""
        except (OSError, ConfigurationError) as error:
            refuse(REASON, f"{self._path}: {error}; the messages begin anew")
            return b""
        return text

    def write(self, text: bytes, refuse: Callable[[str, str], None]) -> None:
        """Write the messages; that they cannot be is counted."""
        try:
            write_whole(self._path, text)
        except OSError as error:
            refuse(REASON, f"{self._path} was not written: {error.strerror or error}")
