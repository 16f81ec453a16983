"""The text of an IFC file before and after the parser: whether it is whole, in which letters, and what the parser dropped.

The parser reads what is there and goes on: what it logs or leaves out is found here. A file that is not whole is refused; a line
of a kind that the schema does not have is left out with a note.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.ifc.notes import Notes

#: Texts and comments that end, and what is between them.
_WHOLE = re.compile(rb"(?:[^'/]++|'[^']*+'|/\*(?:[^*]|\*(?!/))*+\*/|/(?!\*))*+")
_TEXTS = re.compile(rb"'[^']*+'|/\*(?:[^*]|\*(?!/))*+\*/")
#: A line without its end: another one, or the end of the section, comes before its semicolon.
_BROKEN = re.compile(rb"#(\d+)\s*=[^;=]*=|[^;\s]\s*(ENDSEC)\s*;")
_LINE = re.compile(rb"#(\d+)\s*=\s*(\w*)([^;]*)")
_BEGUN = re.compile(rb"#(\d+)\s*=\s*(\w+)")
_REFERENCE = re.compile(rb"#(\d+)")
_OTHER_LETTERS = re.compile(rb"[^\x00-\x7f]+")
#: What is beyond the letters of the file, as the parser's log has it.
_UNKNOWN = re.compile(r"Entity with name '([^']*)' not found in schema '([^']*)'(?: at offset (\d+))?")
_MISSING = re.compile(r"Instance reference #(\d+) used by instance #(\d+)")
_TWICE = re.compile(r"Overwriting instance with name #(\d+)")
_VALUES = re.compile(r"Expected (\d+) attribute values, found (\d+) for instance #(\d+)")
_LOGGED = re.compile(r"^\[(\w+)\](?: \[(\w+)\])? \[[^\]]*\] (.*)$")
_SHOWN = 200


def check_whole(contents: bytes, name: str) -> None:
    """Check that every text, comment and line of a file ends.

    Raises BuildingError.
    """
    found = _WHOLE.match(contents)
    end = 0 if found is None else found.end()
    if end < len(contents):
        line = contents.count(b"\n", 0, end) + 1
        raise BuildingError(
            name, Sentence("ifc.file"), Sentence("ifc.found.text", line=line), Sentence("ifc.whole_file")
        )
    if (broken := _BROKEN.search(_without_texts(contents))) is not None:
        number = broken.group(1)
        which = Sentence("ifc.found.line", number=number.decode()) if number else Sentence("ifc.found.last_line")
        raise BuildingError(name, Sentence("ifc.file"), which, Sentence("ifc.whole_file"))


def _without_texts(contents: bytes) -> bytes:
    return _TEXTS.sub(b" ", contents)


def in_ascii(contents: bytes, notes: Notes) -> bytes:
    """Return a file with letters that are not ASCII written as IFC wants them; what they were taken for is noted.

    The parser drops such letters. They are taken as UTF-8 if all of them are, else as Latin-1 (Windows-1252).
    """
    if not _OTHER_LETTERS.search(contents):
        return contents
    try:
        contents.decode("utf-8")
        code = "utf-8"
    except UnicodeDecodeError:
        code = "cp1252"
    shown: list[str] = []

    def written(found: re.Match[bytes]) -> bytes:
        letters = found.group().decode(code, errors="replace")
        if len(shown) < 5:
            shown.append(letters)
        return b"".join(_escaped(letter) for letter in letters)

    # a byte order mark is no letter
    marked = contents.startswith(b"\xef\xbb\xbf")
    result = _OTHER_LETTERS.sub(written, contents[3:] if marked else contents)
    if shown:
        said = {"utf-8": "UTF-8", "cp1252": "Latin-1 (Windows-1252)"}[code]
        notes.add(Sentence("ifc.note.letters", code=said, letters=", ".join(shown)))
    return result


def _escaped(letter: str) -> bytes:
    number = ord(letter)
    return b"\\X2\\%04X\\X0\\" % number if number < 0x10000 else b"\\X4\\%08X\\X0\\" % number


def note_parser_log(
    log: str,
    contents: bytes,
    present: Collection[int],
    global_id: Callable[[int], str],
    is_geometry: Callable[[int], bool],
    name: str,
    schema: str,
    notes: Notes,
) -> None:
    """Note what the parser dropped or had to guess, and refuse what is not whole.

    Args:
        log: What the parser logged while it read.
        contents: What it read.
        present: Numbers of the lines that it kept.
        global_id: Returns the GlobalId of a line that it kept; empty: it has none.
        is_geometry: Returns whether a line that it kept says where something is, what shape it has or in which unit.
        name, schema: For messages.

    Raises:
        BuildingError: If a line refers to one that the file does not have, or has the number of another one; or if one that says
            where something is or what shape it has refers to one that the parser dropped.
    """
    about = {int(number) for entry in log.splitlines() for number in re.findall(r"(?:instance|name) #(\d+)", entry)}
    about |= {int(number) for entry in log.splitlines() for number in re.findall(r"reference #(\d+)", entry)}
    kinds: dict[int, str] = {}
    dropped: dict[int, list[int]] = {}
    referring: dict[int, list[int]] = {}
    for line in _LINE.finditer(_without_texts(contents)):
        number = int(line.group(1))
        if number not in present:
            dropped.setdefault(number, [int(each) for each in _REFERENCE.findall(line.group(3))])
        if number in about or number in dropped:
            kinds[number] = line.group(2).decode().upper()
            referring[number] = [int(each) for each in _REFERENCE.findall(line.group(3))]

    def shown(number: int) -> str:
        return f"#{number}={kinds.get(number, '')}"

    for entry in log.splitlines():
        if (found := _MISSING.search(entry)) is not None:
            missing, by = map(int, found.groups())
            if missing not in dropped:
                broken = Sentence("ifc.found.missing", line=shown(by), missing=missing)
                raise BuildingError(name, Sentence("ifc.file"), broken, Sentence("ifc.whole_file"))
            if by in present and is_geometry(by):
                lost = Sentence("ifc.found.lost", line=shown(by), missing=shown(missing), schema=schema)
                raise BuildingError(name, Sentence("ifc.file"), lost, Sentence("ifc.lines", schema=schema))
            # a hole whose opening was dropped, for one, is missed by the wall
            dropped[missing] += [by, *referring.get(by, [])]
        elif (found := _TWICE.search(entry)) is not None:
            raise BuildingError(name, f"#{found.group(1)}", Sentence("ifc.found.twice"), Sentence("expected.one"))
        elif (found := _VALUES.search(entry)) is not None:
            expected, given, number = map(int, found.groups())
            sentence = Sentence("ifc.note.values", given=given, expected=expected, schema=schema)
            notes.add(sentence, shown(number), global_id(number) if number in present else "")
            for each in referring.get(number, ()):
                if each in present and (named := global_id(each)):
                    notes.remark(Sentence("ifc.note.of", note=sentence, names=shown(number)), named)
        elif (found := _UNKNOWN.search(entry)) is not None:
            unknown = found.group(1).upper()
            if unknown not in {kinds[number] for number in dropped}:
                sentence = Sentence("ifc.note.values_left_out", schema=schema, kind=unknown)
                notes.add(sentence, _line_of(contents, found.group(3)))
        else:
            plain = _LOGGED.match(entry)
            if plain is not None and plain.group(1) in ("error", "warning"):
                notes.add(Sentence("ifc.note.parser"), plain.group(3)[:_SHOWN])
    for number, references in dropped.items():
        sentence = Sentence("ifc.note.lines_left_out", schema=schema)
        notes.add(sentence, shown(number))
        for each in references:
            if each in present and (named := global_id(each)):
                notes.remark(Sentence("ifc.note.of", note=sentence, names=shown(number)), named)


def _line_of(contents: bytes, offset: str | None) -> str:
    """Return the line of a file that holds an offset, as ``#12=IFCWALL``; empty: nobody says."""
    before = [] if offset is None else _BEGUN.findall(contents, 0, int(offset))
    return "" if not before else f"#{before[-1][0].decode()}={before[-1][1].decode().upper()}"


def first_error(log: str) -> str:
    """Return the first error that the parser logged; empty: none."""
    logged = (_LOGGED.match(entry) for entry in log.splitlines())
    return next((entry.group(3)[:_SHOWN] for entry in logged if entry is not None and entry.group(1) == "error"), "")


@dataclass(frozen=True)
class KernelSays:
    """What the geometry kernel logged.

    Attributes:
        about: GlobalId; empty: of none.
        sentence: With the entity that it is about.
        code: Of the kind of message.
        is_error: Else it is a warning.
    """

    about: str
    sentence: str
    code: str
    is_error: bool


def kernel_says(log: str) -> list[KernelSays]:
    """Return what the geometry kernel logged of shapes, its own statistics left out."""
    found = []
    lines = log.splitlines()
    for entry, after in zip(lines, (*lines[1:], "")):
        line = _LOGGED.match(entry)
        if line is None or line.group(1) not in ("error", "warning") or line.group(2) in _NOT_SHAPE:
            continue
        about = re.match(r"\{([^}]*)\} ?(.*)", line.group(3))
        name, sentence = about.groups() if about else ("", line.group(3))
        # the entity stands on the next line
        entity = _ENTITY.match(after)
        if sentence.endswith(":") and entity is not None:
            sentence = f"{sentence[:-1].rstrip()} {entity.group(1)}"
        sentence = _PLAIN.get(line.group(2), sentence)
        found.append(KernelSays(name, sentence[:_SHOWN], line.group(2) or "", line.group(1) == "error"))
    return found


#: In plainer words.
_PLAIN = {"GEO132": "an opening or a clipping does not meet a body, nothing is cut from it"}
_ENTITY = re.compile(r"(#\d+=\w+)\(")
#: Messages of the kernel that are not about shapes: no style for a colour, a precision of the whole file, a style that is missing.
_NOT_SHAPE = ("GEO031", "SYS033", "GEO301")
