"""What is said, by key and values: the words are in `sentences.json` alone."""

from __future__ import annotations

from collections.abc import Callable

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.sentences import Sentence, Value, key_and_values, understood
from construction_twin.core.work_errors import TaskPlanningError


def key_of(text: str) -> str:
    """Return the key of what is said, or of the reason that a text reads as; empty: it has none."""
    return (key_and_values(text) or key_and_values(understood(text)) or {"key": ""})["key"]


def has_parts(text: str, *parts: str) -> bool:
    """Return whether a text has these parts: keys of its sentence, of a sentence that is a value of it, or texts of its values."""
    said = text if isinstance(text, Sentence) else understood(text)
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
        said = error.sentence
        return key_of(said) == key and values.items() <= said.values.items()

    return check


def expects(key: str, where: str = "", /, **values: Value) -> Callable[[ConfigurationError], bool]:
    """Return the check that an error expects the sentence of a key, with these of its values, there: `where` is in its own."""

    def check(error: ConfigurationError) -> bool:
        said = error.expected
        return where in error.where and key_of(said) == key and values.items() <= said.values.items()

    return check


def holds(part: str, key: str, /) -> Callable[[ConstructionTwinError], bool]:
    """Return the check that a part of what an error says is the sentence of a key."""
    return lambda error: key_of(error.sentence.values[part]) == key


def because(key: str, /, **values: Value) -> Callable[[TaskPlanningError], bool]:
    """Return the same check of the reason why a task cannot be planned."""
    return lambda error: key_of(error.reason) == key and values.items() <= error.reason.values.items()


def remarked(model, one, *parts: str) -> bool:
    """Whether a remark on one element or task has these keys and values."""
    return any(has_parts(remark, *parts) for remark in model.remarks.get(one.GlobalId, ()))
