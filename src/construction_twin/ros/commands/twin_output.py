"""Where `twin` puts what can be a file: on standard output, or in the file that was named."""

from __future__ import annotations

from pathlib import Path

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.files import write_whole


def write_or_print(file: str, text: str) -> Path | None:
    """Write a text into a file, whole, and return its path; None when it was printed, for "-"."""
    if file == "-":
        print(text, end="")
        return None
    path = Path(file).absolute()
    try:
        write_whole(path, text)
    except OSError as error:
        raise ConfigurationError(file, error.strerror or str(error), "a file that can be written") from error
    return path
