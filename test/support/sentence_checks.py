"""What is said, by key and values: the words are in `sentences.json` alone."""

from __future__ import annotations

from collections.abc import Callable

from construction_twin.core import sentences
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.sentences import Sentence, Value, understood
from construction_twin.core.work_errors import TaskPlanningError

sentences.REASONS = ("",)  # while words move into the code: a plain text is read back, whatever it speaks of
sentences._patterns.cache_clear()  # modules of tests that were collected before may have read a text already
understood.cache_clear()


def key_of(text: str) -> str:
    """Return the key of what is said, or of the sentence that a text reads as; empty: it has none."""
    said = _sentence(text)
    return "" if said is None else said.key


def _sentence(text: str) -> Sentence | None:
    return text if isinstance(text, Sentence) else understood(text)


def _agrees(text: str, key: str, values: dict[str, Value]) -> bool:
    said = _sentence(text)
    if said is None or said.key != key:
        return False
    found = said.values
    return all(
        name in found and (found[name] == value or f"{found[name]}" == f"{value}") for name, value in values.items()
    )


def has_parts(text: str, *parts: str) -> bool:
    """Return whether a text has these parts: keys of its sentence, of a sentence that is a value of it, or texts of its values."""
    said = _sentence(text)
    if said is None:
        return False
    values = list(said.values.values())
    return all(
        part == said.key
        or any(has_parts(value, part) if isinstance(value, Sentence) else part in str(value) for value in values)
        for part in parts
    )


def says(key: str, /, **values: Value) -> Callable[[ConstructionTwinError], bool]:
    """Return the check, for `pytest.raises`, that an error says the sentence of a key, with these of its values."""

    def check(error: ConstructionTwinError) -> bool:
        return _agrees(error.sentence, key, values)

    return check


def expects(key: str, where: str = "", /, **values: Value) -> Callable[[ConfigurationError], bool]:
    """Return the check that an error expects the sentence of a key, with these of its values, there: `where` is in its own."""

    def check(error: ConfigurationError) -> bool:
        return where in error.where and _agrees(error.expected, key, values)

    return check


def because(key: str, /, **values: Value) -> Callable[[TaskPlanningError], bool]:
    """Return the same check of the reason why a task cannot be planned."""
    return lambda error: _agrees(error.reason, key, values)


def remarked(model, one, *parts: str) -> bool:
    """Whether a remark on one element or task has these keys and values."""
    return any(has_parts(remark, *parts) for remark in model.remarks.get(one.GlobalId, ()))
