"""A record and its ROS message, field by field by their names: one converter for both directions.

Times are whole ns, arrays of key and value are mappings; fields that only one of the two has keep their defaults. A message with a
field `said` carries what another language needs of the sentences in it (`core.sentences.templates_of`), as JSON.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import genpy
from diagnostic_msgs.msg import KeyValue
from genpy.message import get_message_class  # type: ignore[attr-defined]

from construction_twin.core.sentences import Sentence, sentences_of, templates_of
from construction_twin.core.units import NANOSECONDS

_Record = TypeVar("_Record")


def from_msg(kind: type[_Record], message: genpy.Message) -> _Record:
    """Return the record of a message; ValueError, or what the record raises, for values that there are not."""
    return _record(kind, message, _sentences_of(message))


def to_msg(record: Any, kind: type[genpy.Message]) -> Any:
    """Return the message of a record."""
    return with_sentences(_message(record, kind), record)


def with_sentences(message: Any, *parts: object) -> Any:
    """Return a message with what another language needs of the sentences in these parts, if it has a field for that."""
    if hasattr(message, "said"):
        found = templates_of(*parts)
        message.said = json.dumps(found) if found else ""
    return message


def sentence_of(message: genpy.Message, text: str) -> str:
    """Return a text of a message, as a `Sentence` where the message carries its template."""
    return _sentences_of(message).get(text, text)


def _sentences_of(message: genpy.Message) -> Mapping[str, Sentence]:
    return _parsed_sentences(getattr(message, "said", ""))


@functools.lru_cache(maxsize=64)
def _parsed_sentences(said: str) -> Mapping[str, Sentence]:
    return sentences_of(json.loads(said)) if said else {}


def _record(kind: Any, message: Any, known: Mapping[str, Sentence]) -> Any:
    hints = _hints(kind, type(message))  # type: ignore[arg-type]  # a class is hashable
    return kind(**{name: _record_value(hint, _value(message, name), known) for name, hint in hints})


def _message(record: Any, kind: type[genpy.Message]) -> Any:
    message = kind()
    slots = dict(zip(kind.__slots__, kind._slot_types))
    for each in fields(record):
        value = getattr(record, each.name)
        if each.name in slots:
            setattr(message, each.name, _ros_value(value, slots[each.name]))
        elif each.name == "stamp" and "header" in slots:
            message.header.stamp = _ros_value(value, "time")
    return message


@functools.cache
def _hints(kind: Any, message: Any) -> tuple[tuple[str, Any], ...]:
    has = {*message.__slots__, *(("stamp",) if "header" in message.__slots__ else ())}
    hints = get_type_hints(kind)
    return tuple((each.name, hints[each.name]) for each in fields(kind) if each.name in has)


def _value(message: Any, name: str) -> Any:
    return message.header.stamp if name == "stamp" and hasattr(message, "header") else getattr(message, name)


def _record_value(hint: Any, value: Any, known: Mapping[str, Sentence]) -> Any:
    if isinstance(value, str):
        return known.get(value, value)
    if isinstance(value, (genpy.Time, genpy.Duration)):
        return value.to_nsec()
    if get_origin(hint) is tuple:
        (item, *_) = get_args(hint)
        return tuple(_record_value(item, each, known) for each in value)
    if isinstance(value, (list, tuple)):
        return {pair.key: pair.value for pair in value}
    if is_dataclass(hint):
        return _record(hint, value, known)
    if isinstance(hint, type) and issubclass(hint, (Enum, bool)):
        return hint(value)
    return value


def _ros_value(value: Any, kind: str) -> Any:
    if kind.endswith("[]"):
        if isinstance(value, Mapping):
            return [KeyValue(*pair) for pair in value.items()]
        return [_ros_value(each, kind[:-2]) for each in value]
    if kind == "time":
        return genpy.Time(*divmod(value, NANOSECONDS))
    if is_dataclass(value):
        return _message(value, get_message_class(kind))
    return value.value if isinstance(value, Enum) else value
