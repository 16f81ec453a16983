"""Names in place of the ids of a building model, in sentences."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping

from construction_twin.core.sentences import Sentence

#: An id, in quotes or not, with the number of a body or job, and in parentheses the name that may stand before it.
_ID = re.compile(
    r"""((?P<name>'[^']*'|"[^"]*") \()?(?<![\w$#/])(?P<quote>['"]?)(?P<whole>(?P<id>[\w$#]{1,64})(?:/\d+)?)(?P=quote)(?![\w$/])"""
    r"""(?(name)\))"""
)
#: An id behind the name that it belongs to.
_IN_PARENTHESES = re.compile(r" \((?P<id>[\w$#]{1,64})\)")


def labels(names: Mapping[str, str]) -> dict[str, str]:
    """Return what stands for each id: its name in quotes, with the id where others have it; none without a name."""
    count = Counter(names.values())
    return {key: repr(name) if count[name] == 1 else f"{name!r} ({key})" for key, name in names.items() if name}


def with_names(text: str, known: Mapping[str, str]) -> str:
    """Return a sentence with names for ids, in the values of a `Sentence` too."""
    if isinstance(text, Sentence):
        values = {
            key: with_names(value, known) if isinstance(value, str) else value for key, value in text.values.items()
        }
        return Sentence.of(_labelled(text, known), text.template, values)
    return _labelled(text, known)


def _labelled(text: str, known: Mapping[str, str]) -> str:

    def label(found: re.Match[str]) -> str:
        said = known.get(found["whole"]) or known.get(found["id"])
        if said is None:
            return found.group()
        name = found["name"]
        return said if not name or said.startswith(name) else f"{name} ({said})"

    return _ID.sub(label, _quoted(text, known))


def _quoted(text: str, known: Mapping[str, str]) -> str:
    """Return a sentence in which a name before its id in parentheses stands in quotes."""
    parts, at = [], 0
    for found in _IN_PARENTHESES.finditer(text):
        name = known.get(found["id"], "").removesuffix(f" ({found['id']})")
        before = text[at : found.start()]
        if len(name) > 2 and before.endswith(name[1:-1]):
            parts += [before[: 2 - len(name)], name]
            at = found.start()
    return "".join((*parts, text[at:]))


def first_few(names: Iterable[str], most: int = 10) -> str:
    """Return the first `most` names with commas between them, and how many more there are."""
    every = tuple(names)
    first = ", ".join(every[:most])
    return f"{first} and {len(every) - most} more" if len(every) > most else first
