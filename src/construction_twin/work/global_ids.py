"""GlobalIds of IFC, made from words: the same words, the same id, on every machine. Knows no file."""

from __future__ import annotations

import uuid

_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_$"
_IDS = uuid.UUID("5b0f6c3e-9d1a-4b52-8a35-6c1f7d2e9b40")


def global_id(*words: str) -> str:
    """Return an IFC GlobalId, 22 characters, that follows from words."""
    number = uuid.uuid5(_IDS, "|".join(words)).int
    return "".join(_DIGITS[number >> shift & 63] for shift in range(126, -1, -6))
