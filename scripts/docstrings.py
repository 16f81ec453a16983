"""Checks what docstrings say of parameters, attributes and errors: `python scripts/docstrings.py [FILE...]`, all files without one.

The form is Google's, one line per name: its meaning, shape, unit, frame. What an annotation says is not said again; a name that its
meaning explains is left out, and a section without a line, too. A name that nothing has any more, and an error that is none, are
findings. griffe reads files and sections; nothing is imported.
"""

from __future__ import annotations

import builtins
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import griffe

ROOT = Path(__file__).resolve().parent.parent
#: Title and underline of NumPy's form.
_UNDERLINED = re.compile(r"^[ ]*(Parameters|Attributes|Returns|Raises|Yields|Notes)\n[ ]*-{3,}$", re.MULTILINE)
#: `name (type):`, and a section's title.
_TYPED = re.compile(r"^[ ]{4,}(\*{0,2}\w+) \((?:\w|\[|\]|[,. |])+\):", re.MULTILINE)
_SECTION = re.compile(r"^[ ]*(Args|Attributes|Raises):$", re.MULTILINE)
#: An error of the standard library that lies too deep to be imported by its name.
_FOREIGN = "BrokenProcessPool"
#: Sections in which every entry is a name and a text.
_NAMED = {"parameters": "Args", "attributes": "Attributes", "raises": "Raises"}


def sources() -> list[Path]:
    """Return every Python file that git knows."""
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / line for line in listed.stdout.splitlines()]


class Names:
    """What the files define: errors, and what objects of each class have.

    Args:
        modules, texts: Each file's.
    """

    def __init__(self, modules: Mapping[Path, griffe.Module], texts: Mapping[Path, str]):
        self._own: dict[str, set[str]] = {}
        self._bases: dict[str, list[str]] = {}
        for file, module in modules.items():
            lines = texts[file].splitlines()
            for thing in _objects(module):
                if isinstance(thing, griffe.Class):
                    # of a class that is named like another one, either will do
                    self._own.setdefault(thing.name, set()).update(_own_names(thing, lines))
                    self._bases.setdefault(thing.name, []).extend(str(base).rpartition(".")[2] for base in thing.bases)

    def of_class(self, name: str) -> set[str]:
        """Return the names that objects of a class have, those of its bases included."""
        found = set(self._own.get(name, ()))
        return found.union(*(self.of_class(base) for base in self._bases.get(name, ()) if base != name))

    def is_error(self, name: str, module: griffe.Module) -> bool:
        """Return whether a class of this name is defined here, in Python, or imported by the module."""
        first, last = name.partition(".")[0], name.rpartition(".")[2]
        return last in self._own or first in module.members or hasattr(builtins, name) or last == _FOREIGN


def _own_names(thing: griffe.Class, lines: Sequence[str]) -> set[str]:
    # names that a tuple is assigned to are no members for griffe
    assigned = re.findall(r"\bself\.(\w+)", "\n".join(lines[thing.lineno - 1 : thing.endlineno]))
    return set(thing.members) | set(assigned) | {parameter.name for parameter in thing.parameters}


def _objects(owner: griffe.Object) -> Iterator[griffe.Object]:
    yield owner
    for member in owner.members.values():
        if not member.is_alias and not member.is_attribute:
            yield from _objects(member)


def _entries(section: griffe.DocstringSection) -> Iterator[tuple[list[str], str]]:
    """Return names and text of each entry; of several names with one text griffe takes those behind the first for a type."""
    for item in section.value:
        name, kind = getattr(item, "name", ""), str(item.annotation)
        if not name or name.endswith(","):
            name += kind
        yield re.findall(r"[\w.]+", name), item.description


def findings(file: Path, module: griffe.Module, names: Names) -> list[str]:
    """Return what is wrong in a file, a line each: `path:line: what`."""
    found = []
    for thing in _objects(module):
        if thing.docstring is not None:
            place = f"{file.relative_to(ROOT)}:{thing.docstring.lineno}: {thing.name}"
            found += [f"{place}: {what}" for what in _problems(thing, thing.docstring, module, names)]
    return found


def _problems(thing: griffe.Object, docstring: griffe.Docstring, module: griffe.Module, names: Names) -> Iterator[str]:
    text = docstring.value
    if match := _UNDERLINED.search(text):
        yield f"{match[1]} is underlined; expected `Args:`, `Attributes:`, `Returns:` or `Raises:`"
        return
    if _SECTION.search(text) and (match := _TYPED.search(text)):
        yield f"the type of {match[1]} is in its annotation; expected `{match[1]}: meaning, shape, unit, frame`"
        return
    read = set()
    for section in docstring.parse("google", warnings=False):
        if (title := _NAMED.get(section.kind.value)) is None:
            continue
        for entry, description in _entries(section):
            read.add(title)
            if not description.strip():
                yield f"{title} has nothing to say of {', '.join(entry)}: leave it out"
            if unknown := [name for name in entry if not _is_known(name, title, thing, module, names)]:
                yield f"{title} names {', '.join(unknown)}, which is not there: name what is, or leave it out"
    for match in _SECTION.finditer(text):
        if match[1] not in read:
            yield f"{match[1]} has no line `name: text`; expected one, or no such section"


def _is_known(name: str, title: str, thing: griffe.Object, module: griffe.Module, names: Names) -> bool:
    if title == "Raises":
        return names.is_error(name, module)
    if title == "Args":
        return name in {parameter.name.lstrip("*") for parameter in thing.parameters}
    return name in names.of_class(thing.name)


def main(arguments: Sequence[str]) -> int:
    """Check files; return how the process ends."""
    texts = {file: file.read_text() for file in sources()}
    modules = {file: griffe.visit(file.stem, filepath=file, code=text) for file, text in texts.items()}
    names = Names(modules, texts)
    wanted = {Path(argument).resolve() for argument in arguments} or set(modules)
    found = [line for file, module in modules.items() if file in wanted for line in findings(file, module, names)]
    print("\n".join(found) or "docstrings say what annotations cannot")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
