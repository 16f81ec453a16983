"""Names in a sentence: the first few of many. Standard library only."""

from __future__ import annotations

from collections.abc import Iterable

from construction_twin.core.sentences import Sentence


def first_few(names: Iterable[str], most: int = 10) -> str:
    """Return the first `most` names with commas between them, and how many more there are."""
    every = tuple(names)
    first = ", ".join(every[:most])
    return Sentence("work.and_more", listed=first, count=len(every) - most) if len(every) > most else first
