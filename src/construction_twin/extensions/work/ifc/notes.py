"""Notes on a file for its user, and doubts: elements of which parser or geometry kernel reported something.

What is reported of an instance holds for every element that reaches it; if none is found, for the file.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import ifcopenshell

from construction_twin.extensions.work.building import BuildingError, first_few

_NAMED = 5


class Notes:
    """Sentences with what they are about, in the order of their first occurrence."""

    def __init__(self) -> None:
        self._about: dict[str, dict[str, None]] = {}

    def add(self, sentence: str, about: str = "") -> None:
        """Add a sentence without full stop, or one more name or GlobalId that it holds for."""
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


_Entity = ifcopenshell.entity_instance
_LOGGED = re.compile(r"^\[(error|warning)\](?: \[(\w+)\])? \[[^\]]*\] (?:\{[^}]*\} ?)?(.*)$")
_NUMBER = re.compile(r"#(\d+)")
_OFFSET = re.compile(r"at offset (\d+)")
_MISSING = re.compile(r"Instance reference #(\d+) used by instance #(\d+)")
_SHOWN = 200
#: Why nothing of a file is sure.
ABOUT_ALL = "the reader of the file says, of what holds for all elements or for nobody knows which"
#: Codes of what says nothing of shapes: no style for a colour, a precision of the whole file, a style that is missing, no unit of
#: angles (told), the hole of a hollow profile turned round (its volume is compared), a point given twice, a triangle
#: without area; and texts of what says nothing of instances, or is told by `tasks.unique_id`.
_ASIDE = ("GEO031", "SYS033", "GEO301", "GEO313", "GEO164", "GEO185", "GEO276")
_ASIDE_TEXTS = ("header entity", "non-unique GlobalId")
#: Who made it and how it looks: what is lost there says nothing of elements.
_ASIDE_KINDS = (
    *("IfcOwnerHistory", "IfcPresentationItem", "IfcPresentationStyleAssignment", "IfcStyledItem"),
    "IfcStyledRepresentation",
)


@dataclass(frozen=True)
class LogEntry:
    """One entry of a log; `offset`: into the contents; `missing`: an instance that is not there, and one that refers to it."""

    text: str
    code: str
    numbers: frozenset[int]
    offset: int | None
    missing: tuple[int, ...]


def parse_log(log: str) -> Iterator[LogEntry]:
    """Yield the errors and warnings of a log that concern elements."""
    lines = log.splitlines()
    for line, after in zip(lines, (*lines[1:], "")):
        logged = _LOGGED.match(line)
        if logged is None or logged.group(2) in _ASIDE or any(text in line for text in _ASIDE_TEXTS):
            continue
        _, code, text = logged.groups()
        # what it is about can stand on the next line
        if after.startswith("#"):
            text = f"{text} {after.partition('(')[0]}"
        offset, missing = _OFFSET.search(text), _MISSING.search(text)
        yield LogEntry(
            text[:_SHOWN], code or "", frozenset(map(int, _NUMBER.findall(text))),
            int(offset.group(1)) if offset else None, tuple(map(int, missing.groups())) if missing else (),
        )  # fmt: skip


def _line_at(contents: bytes, offset: int) -> tuple[int, set[int]]:
    """Return the number of the instance whose line holds an offset (0: unknown), and those that it refers to."""
    head, _, values = contents[contents.rfind(b";", 0, offset) + 1 : contents.find(b";", offset)].partition(b"=")
    number = head.rpartition(b"#")[2].strip()
    return int(number) if number.isdigit() else 0, set(map(int, re.findall(rb"#(\d+)", values)))


class Doubts:
    """Reasons for doubt: about the whole file, and by number about products' shapes and their relations to others."""

    def __init__(self, file: ifcopenshell.file):
        self._file = file
        self.everything = ""
        self.shapes: dict[int, str] = {}
        self.related: dict[int, str] = {}

    def on_parser_log(self, log: Collection[LogEntry], contents: bytes, name: str) -> None:
        """Doubt what the parser's log names, remove relations of which a part is missing, and refuse a file that is not whole."""
        dropped = {_line_at(contents, each.offset)[0] for each in log if each.offset is not None}
        users: dict[int, set[int]] = defaultdict(set)
        for entry in log:
            if "'ENDSEC'" in entry.text:
                raise BuildingError(name, "the file", "a last line that is broken off", "a whole IFC file")
            if entry.missing:
                missing, user = entry.missing
                if missing not in dropped:
                    broken = f"#{user} refers to #{missing}, which is not there: the file is not whole"
                    raise BuildingError(name, "the file", broken, "a whole IFC file")
                users[missing].add(user)
        for entry in log:
            own, references = (0, set[int]()) if entry.offset is None else _line_at(contents, entry.offset)
            # of a line that was dropped, what it needs and what needs it is left
            more = set() if self._has(own) else references | users[own]
            self.add(entry.numbers | {own} | more, entry.text)
        for user in set().union(*users.values()):
            if self._has(user) and self._file.by_id(user).is_a("IfcRelationship"):
                self._file.remove(self._file.by_id(user))

    def add(self, numbers: Collection[int], why: str) -> None:
        """Doubt every element that reaches an instance, or everything if none does, or if it says where something is."""
        reason = f"the reader of the file says of what it needs: {why}"
        reached = False
        left, visited = list(numbers), set(numbers)
        while left:
            number = left.pop()
            if not self._has(number):
                continue
            one = self._file.by_id(number)
            if one.is_a("IfcProject") or one.is_a("IfcObjectPlacement"):
                reached = False
                break
            if one.is_a("IfcProduct"):
                self.shapes.setdefault(_host(one), reason)
            elif one.is_a("IfcProcess") or one.is_a("IfcRelationship"):
                products = self._products(one)
                self.related |= {each: reason for each in products if each not in self.related}
                reached = reached or bool(products)
                continue
            elif not any(one.is_a(kind) for kind in _ASIDE_KINDS):
                more = {each.id() for each in self._file.get_inverse(one)} - visited
                visited |= more
                left += more
                continue
            reached = True
        if not reached:
            self.everything = self.everything or f"{ABOUT_ALL}: {why}"

    def _has(self, number: int) -> bool:
        try:
            return bool(self._file.by_id(number))
        except RuntimeError:
            return False

    def _products(self, one: _Entity) -> set[int]:
        """Return the products that a relation names, itself or by a task, or that a task makes or works on."""
        if one.is_a("IfcProcess"):
            near = [each for each in self._file.get_inverse(one) if each.is_a("IfcRelAssigns")]
        else:
            near = [one]
        others = [each for relation in near for each in self._file.traverse(relation, max_levels=1)[1:]]
        found = {_host(each) for each in others if each.is_a("IfcProduct")}
        if one.is_a("IfcRelationship"):
            found.update(*(self._products(each) for each in others if each.is_a("IfcProcess")))
        return found


def _host(product: _Entity) -> int:
    voids = getattr(product, "VoidsElements", None) or ()
    return next((relation.RelatingBuildingElement.id() for relation in voids), product.id())
