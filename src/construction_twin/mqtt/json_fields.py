"""JSON of a request from elsewhere, read strictly into the fields of a record: what reads each key is a table (`read_fields`).

Each function returns what it checked, or raises a PayloadError: ``format`` for keys and their kinds, ``values`` for numbers.
Sentences show what was found, cut to a length for a log. Standard library only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.mqtt.messages import demand_live, parse_object

#: Takes what stands at a key, and the key; returns what it checked.
Reader = Callable[[Any, str], Any]
#: Longest id, name and other short text.
MAX_TEXT = 64
#: No position, velocity, acceleration or time of an arm is larger, in whatever unit.
LARGEST = 1e6


def read_document(payload: bytes, retained: bool, what: str, limit: int, parameter: str = "") -> dict[str, Any]:
    """Return the JSON object of a message.

    Args:
        retained: The message's retain flag.
        what: ``trajectory``, ``plan_request`` or ``ik``, for the sentence.
        limit: Longest payload that is read [bytes].
        parameter: That sets the limit, where a motion can have fewer points; "" for none.

    Raises:
        PayloadError: ``retained``, ``size`` or ``format``.
    """
    demand_live(retained, what)
    if len(payload) > limit:
        refusal = Sentence("link.payload.size", what=what, bytes=len(payload), limit=limit)
        if parameter:
            refusal = Sentence("link.payload.size_here", refusal=refusal, parameter=parameter)
        raise PayloadError("size", refusal)
    return parse_object(payload, "format", limit)


def read_fields(document: Mapping[str, Any], readers: Mapping[str, Reader]) -> dict[str, Any]:
    """Return what a document holds at the keys of `readers`, in their order; a key that is not there is left out."""
    return {key: read(document[key], key) for key, read in readers.items() if key in document}


def number(value: object, place: str) -> float:
    """Return a number between -LARGEST and LARGEST; true and false are none."""
    # true and false are numbers to Python
    if type(value) not in (int, float) or not -LARGEST <= value <= LARGEST:  # type: ignore[operator]
        found = Sentence("link.payload.number", place=place, found=shown(value), lowest=-LARGEST, largest=LARGEST)
        raise PayloadError("values", found)
    return float(value)  # type: ignore[arg-type]


def list_of(value: object, place: str) -> list:
    """Return a list, of whatever."""
    if not isinstance(value, list):
        raise PayloadError("format", Sentence("link.payload.list", place=place, found=shown(value)))
    return value


def text(value: object, key: str) -> str:
    """Return a printable text of at most MAX_TEXT characters in one line."""
    if not isinstance(value, str) or len(value) > MAX_TEXT or not value.isprintable():
        raise PayloadError("format", Sentence("link.payload.text", key=key, found=shown(value), longest=MAX_TEXT))
    return value


def own_id(value: object, key: str) -> str:
    """Return a text as `text` does, which is not empty."""
    found = text(value, key)
    if not found:
        raise PayloadError("format", Sentence("link.payload.id"))
    return found


def fraction(value: object, key: str) -> float:
    """Return a fraction of the limits, 0 for the planner's default."""
    scale = number(value, key)
    if not 0.0 <= scale <= 1.0:
        raise PayloadError("values", Sentence("link.payload.fraction", key=key, found=scale))
    return scale


def keys(document: object, what: str, needed: Sequence[str], known: Sequence[str]) -> None:
    """Check that a document is an object with every key that is needed, and none that is not known."""
    if not isinstance(document, dict):
        found = Sentence("link.payload.object", what=what, found=shown(document), needed=", ".join(needed))
        raise PayloadError("format", found)
    missing = [key for key in needed if key not in document]
    unknown = [key for key in document if key not in known]
    if missing or unknown:
        key, wrong = (
            ("missing", {"missing": ", ".join(missing)}) if missing else ("unknown", {"found": shown(unknown[0])})
        )
        names = {"what": what, "needed": ", ".join(needed), "known": ", ".join(known)}
        raise PayloadError("format", Sentence(f"link.payload.key_{key}", **wrong, **names))


def shown(value: object) -> str:
    """Return what was found, short enough for a sentence; of what is nested only the kind."""
    if isinstance(value, (dict, list)) and any(isinstance(item, (dict, list)) for item in value):
        return Sentence(f"link.payload.{'an_object' if isinstance(value, dict) else 'a_list'}", count=len(value))
    if isinstance(value, int) and abs(value) > LARGEST:
        return Sentence("link.payload.a_number", bits=value.bit_length())
    words = repr(value[:8] if isinstance(value, list) else value)
    return words if len(words) <= 96 else words[:93] + "..."
