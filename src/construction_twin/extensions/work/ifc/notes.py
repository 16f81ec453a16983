"""What the user should know about a file that was read: one sentence for each kind of thing, with the first that it holds for."""

from __future__ import annotations

from collections.abc import Collection

from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.names import first_few

_NAMED = 5
#: Remarks of one element or task.
_REMARKS = 20


class Notes:
    """Sentences with what they are about, in the order of their first occurrence."""

    def __init__(self) -> None:
        self._about: dict[str, list[str]] = {}
        self._at: dict[str, list[str]] = {}

    def add(self, sentence: str, about: str = "", at: str = "") -> None:
        """Add a sentence, or one more thing that it holds for.

        Args:
            sentence: Without a full stop; must make sense for one and for many, whose names follow behind a colon.
            about: Name or GlobalId; empty: the sentence says it all.
            at: Id of the element or task whose remark it is; by default what it is about.
        """
        self._about.setdefault(sentence, []).append(about)
        self.remark(sentence, at or about)

    def remark(self, sentence: str, at: str) -> None:
        """Add a sentence to an element or task only."""
        remarks = self._at.setdefault(at, [])
        # a file can be wrong in the same way very often
        if sentence not in remarks and len(remarks) < _REMARKS:
            remarks.append(sentence)

    def remarks(self, ids: Collection[str]) -> dict[str, tuple[str, ...]]:
        """Return the sentences that hold for each of these elements and tasks, of those that any holds for."""
        return {name: tuple(remarks) for name, remarks in self._at.items() if name in ids}

    def sentences(self) -> tuple[str, ...]:
        """Return them with the first few of what each is about."""
        every = ((text, dict.fromkeys(filter(None, about))) for text, about in self._about.items())
        return tuple(f"{text}: see {first_few(about, _NAMED)}" if about else text for text, about in every)


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
