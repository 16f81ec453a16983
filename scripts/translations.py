"""Bring web/locale/de.po to the templates that stand in the code: new ones come without German, unused ones go.

Templates are `Sentence("...")` of Python, `texts("...")` and `mark("...")` of the page.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from babel.messages import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.pofile import read_po, write_po

ROOT = Path(__file__).resolve().parents[1]
GERMAN = ROOT / "web/locale/de.po"
#: What editors of such files need.
_HEADER = 'msgid ""\nmsgstr ""\n"Language: de\\n"\n"Content-Type: text/plain; charset=utf-8\\n"\n'
_TEXT = r'"(?:[^"\\]|\\.)*"'
_CALL = re.compile(rf"\b(?:texts|mark)\(\s*({_TEXT}(?:\s*\+\s*{_TEXT})*)")

#: Line, keyword, template, comments: as Babel wants them.
Found = tuple[int, str, str, list[str]]


def of_python(file: IO[bytes], *_: Any, **__: Any) -> Iterator[Found]:
    """Find the templates in a Python file; of a choice both."""
    for node in ast.walk(ast.parse(file.read())):
        match node:
            case ast.Call(func=ast.Name(id="Sentence"), args=[first, *_]):
                yield from ((0, "Sentence", text, []) for text in _texts(first))


def _texts(node: ast.expr) -> Iterator[str]:
    match node:
        case ast.Constant(value=str(text)):
            yield text
        case ast.IfExp(body=one, orelse=other):
            yield from (*_texts(one), *_texts(other))


def of_page(file: IO[bytes], *_: Any, **__: Any) -> Iterator[Found]:
    """Find the templates in a file of the page."""
    for found in _CALL.finditer(file.read().decode()):
        yield 0, "texts", "".join(json.loads(text) for text in re.findall(_TEXT, found[1])), []


def templates(folder: str) -> list[str]:
    """Return the templates in a folder, by file."""
    methods: list[Any] = [("**.py", of_python), ("**.js", of_page)]
    found = extract_from_dir(ROOT / folder, methods, keywords={"Sentence": None, "texts": None})
    return list(dict.fromkeys(str(template) for _, _, template, _, _ in found))


def german() -> dict[str, str]:
    """Return the German by template; "": none yet."""
    with GERMAN.open("rb") as file:
        return {str(message.id): str(message.string) for message in read_po(file) if message.id}


def write(words: dict[str, str]) -> None:
    """Write the German by template."""
    catalog, text = Catalog(), BytesIO()
    for template, translated in words.items():
        catalog.add(template, translated).flags.clear()
    write_po(text, catalog, width=0, omit_header=True)
    GERMAN.write_text(_HEADER + text.getvalue().decode().replace("\n\n", "\n"), encoding="utf-8")


if __name__ == "__main__":
    known = german()
    write({each: known.get(each, "") for each in [*templates("web/src"), *templates("src/construction_twin")]})
