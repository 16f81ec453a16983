"""Which PIN a person may choose for a paired device. Pure.

`web/src/pin_state.js` has the same rule; both pass `test/data/pins.json`.

A PIN is tried five times at most (`pairings.py`), so what matters is that the first guesses of whoever finds a tablet are wrong.
"""

from __future__ import annotations

import re

#: Digits of a PIN, and different ones among them.
SHORTEST, LONGEST, DIFFERENT = 6, 12, 3
_DIGITS = re.compile(f"[0-9]{{{SHORTEST},{LONGEST}}}")


def refusal(pin: str) -> str:
    """Return in one word why a text is no PIN: ``length``, ``same``, ``row`` or ``repeated``; "" when it is one.

    Args:
        pin: ``row`` is one digit after the other, up or down, 0 after 9; ``repeated`` a group again and again, as 123123; ``same``
            fewer than three different digits.
    """
    if not _DIGITS.fullmatch(pin):
        return "length"
    if len(set(pin)) < DIFFERENT:
        return "same"
    steps = {(int(after) - int(before)) % 10 for before, after in zip(pin, pin[1:])}
    if steps in ({1}, {9}):
        return "row"
    # a text is made of repeats of a part if it stands in itself twice, moved by less than its length
    return "repeated" if pin in (pin + pin)[1:-1] else ""
