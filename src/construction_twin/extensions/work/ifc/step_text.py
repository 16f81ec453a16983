"""The bytes of an IFC file before the parser: whether they are one and end, and in the letters and schema names that it reads.

The parser reads what is there and goes on: it does not miss an end, and drops a letter that is not ASCII. Knows no entity.
"""

from __future__ import annotations

import codecs
import re

from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.notes import Notes

#: Schemas as the parser calls them: their last publication. Earlier ones of the same name say nothing that it reads otherwise.
SCHEMAS = {"IFC2X3": b"IFC2X3", "IFC4": b"IFC4", "IFC4X3": b"IFC4X3_ADD2"}
_MAGIC = b"ISO-10303-21;"
_END = b"END-ISO-10303-21;"
_MARK = b"\xef\xbb\xbf"
_SPACE = b" \t\r\n\0\x1a"
#: What other forms of IFC begin with, and what to do with one.
_OTHERS = {
    b"PK": "a ZIP archive (IFCZIP): unpack it and give the .ifc file in it",
    b"<": "XML (ifcXML): export the model as STEP text (.ifc) instead",
    b"\xff\xfe": "text in UTF-16: save it as UTF-8",
    b"\xfe\xff": "text in UTF-16: save it as UTF-8",
    b"I\0": "text in UTF-16: save it as UTF-8",
    b"\0I": "text in UTF-16: save it as UTF-8",
}
_SCHEMA = re.compile(rb"FILE_SCHEMA\s*\(\s*\(\s*'([^']*)'")


def check_form(contents: bytes, name: str) -> None:
    """Check that contents are a STEP file from its beginning to its end."""
    begun = _from_start(contents)
    if not begun.startswith(_MAGIC):
        shown = f"{contents[:20]!r} at its beginning" if contents else "nothing in it"
        found = next((said for begins, said in _OTHERS.items() if begun.startswith(begins)), shown)
        raise BuildingError(name, "the file", found, f"an IFC file, which begins with {_MAGIC.decode()}")
    if not contents.rstrip(_SPACE).endswith(_END):
        found = f"no {_END.decode()} at its end: it is not whole"
        raise BuildingError(name, "the file", found, "a whole IFC file")


def _from_start(contents: bytes) -> bytes:
    """Return contents without what may stand before the first line: a byte order mark, comments."""
    begun = contents.removeprefix(_MARK).lstrip()
    while begun.startswith(b"/*"):
        begun = begun.partition(b"*/")[2].lstrip()
    return begun


def for_parser(contents: bytes, name: str, notes: Notes) -> bytes:
    """Return contents as the parser reads all of them; letters that it would drop are noted."""
    return _in_ascii(_of_last_publication(contents, name), notes)


def _of_last_publication(contents: bytes, name: str) -> bytes:
    found = _SCHEMA.search(contents, 0, contents.find(b"ENDSEC"))
    given = found.group(1).decode("latin-1").upper() if found else ""
    base, _, publication = given.partition("_")
    if found is None or base not in SCHEMAS or publication.startswith("RC"):
        raise BuildingError(
            name, "schema", given or "none",
            (f"one of {', '.join(SCHEMAS)} as published (IFC4_ADD2 and the like too), no release " "candidate: export it so"),
        )  # fmt: skip
    if SCHEMAS[base] == found.group(1):
        return contents
    return contents[: found.start(1)] + SCHEMAS[base] + contents[found.end(1) :]


def _in_ascii(contents: bytes, notes: Notes) -> bytes:
    """Return contents with letters that are not ASCII written as IFC wants them.

    They are taken as UTF-8 if all of them are, else as Latin-1 (Windows-1252).
    """
    contents = _from_start(contents)
    if contents.isascii():
        return contents
    try:
        text, code = contents.decode("utf-8"), "UTF-8"
    except UnicodeDecodeError:
        text, code = contents.decode("cp1252", errors="replace"), "Latin-1 (Windows-1252)"
    letters = sorted(letter for letter in set(text) if not letter.isascii())
    notes.add(
        f"The file has letters that are not ASCII, which IFC does not allow; taken as {code}: {''.join(letters[:20])}"
    )
    return text.encode("ascii", errors="ifc")


def _escaped(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    numbers = map(ord, error.object[error.start : error.end])
    return "".join(f"\\X2\\{n:04X}\\X0\\" if n < 0x10000 else f"\\X4\\{n:08X}\\X0\\" for n in numbers), error.end


codecs.register_error("ifc", _escaped)
