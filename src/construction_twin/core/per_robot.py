"""Command lines of programs that serve several robots in one process. Standard library only."""

from __future__ import annotations

from collections.abc import Sequence

#: Between the options of two robots.
AND = "--and"


def per_robot(words: Sequence[str]) -> list[list[str]]:
    """Return the options of each robot: they stand one after the other, with `AND` between them."""
    parts: list[list[str]] = [[]]
    for word in words:
        if word == AND:
            parts.append([])
        else:
            parts[-1].append(word)
    return parts
