"""Paths of the package's data files: below a checkout's root, or ``share/construction_twin`` where it is installed."""

from __future__ import annotations

from functools import cache
from pathlib import Path

#: The package, whose name its folder below ``share`` has.
NAME = "construction_twin"


def share_file(path: str) -> Path:
    """Return where a file or folder of the package is."""
    return share_folder() / path


@cache
def share_folder() -> Path:
    """Return the folder of the data files, existing or not."""
    here = Path(__file__).resolve()
    checkout = here.parents[3]
    places = (checkout, *(above / "share" / NAME for above in here.parents))
    return next((place for place in places if (place / "package.xml").is_file()), checkout)
