"""What the user should know about a file that was read: one sentence for each kind of thing, with the first that it holds for."""

from __future__ import annotations

from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.names import first_few

_NAMED = 5


class Notes:
    """Sentences with what they are about, in the order of their first occurrence."""

    def __init__(self) -> None:
        self._about: dict[str, dict[str, None]] = {}

    def add(self, sentence: str, about: str = "") -> None:
        """Add a sentence without full stop, or one more name or GlobalId that it holds for; "": the sentence says it all."""
        self._about.setdefault(sentence, {}).update({about: None} if about else {})

    def sentences(self) -> tuple[str, ...]:
        """Return them with the first few of what each is about."""
        return tuple(
            f"{text}: see {first_few(about, _NAMED)}" if about else text for text, about in self._about.items()
        )


class MisreadError(BuildingError):
    """ifcopenshell cannot read an entity."""


class ReadingEntity:
    """Raises `MisreadError` with file and entity in place of any error of ifcopenshell."""

    def __init__(self, file: str, entity: object):
        self._file, self._entity = file, entity

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, Exception) and not isinstance(error, (BuildingError, MemoryError)):
            found = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            raise MisreadError(self._file, label(self._entity), found, "what the IFC schema says") from error


def label(entity: object) -> str:
    """Return ``#12=IFCWALL`` for an entity, and a text as it is."""
    if isinstance(entity, str):
        return entity
    try:
        return f"#{entity.id()}={entity.is_a().upper()}"  # type: ignore[attr-defined]
    except (AttributeError, RuntimeError):
        return "an entity"
