"""What is said, by key and values: the words are in `sentences.json` alone."""

from __future__ import annotations

from collections.abc import Callable

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Value, said_in, understood
from construction_twin.core.work_errors import TaskPlanningError


def key_of(text: str) -> str:
    """Return the key of what is said, or of the reason that a text reads as; empty: it has none."""
    return (said_in(text) or said_in(understood(text)) or {"key": ""})["key"]


def says(key: str, /, **values: Value) -> Callable[[ConstructionTwinError], bool]:
    """Return the check, for `pytest.raises`, that an error says the sentence of a key, with these of its values."""

    def check(error: ConstructionTwinError) -> bool:
        said = error.sentence
        return key_of(said) == key and values.items() <= said.values.items()

    return check


def because(key: str, /, **values: Value) -> Callable[[TaskPlanningError], bool]:
    """Return the same check of the reason why a task cannot be planned."""
    return lambda error: key_of(error.reason) == key and values.items() <= error.reason.values.items()
