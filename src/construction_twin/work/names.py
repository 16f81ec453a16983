"""Sentences with names in place of the ids of a building model: a GlobalId of 22 characters says nothing to a person. Pure."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping

from construction_twin.core.sentences import Sentence

#: An id, in quotes or not, with the number of a body or job, and in parentheses the name that may stand before it.
_ID = re.compile(
    r"""((?P<name>'[^']*'|"[^"]*") \()?(?<![\w$#/])(?P<quote>['"]?)(?P<whole>(?P<id>[\w$#]{1,64})(?:/\d+)?)(?P=quote)(?![\w$/])"""
    r"""(?(name)\))"""
)


def labels(names: Mapping[str, str]) -> dict[str, str]:
    """Return what stands for each id in a sentence: its name in quotes, with the id where others have it; not of what has none."""
    count = Counter(names.values())
    return {key: repr(name) if count[name] == 1 else f"{name!r} ({key})" for key, name in names.items() if name}


def named(text: str, known: Mapping[str, str]) -> str:
    """Return a sentence with what stands for each id in its place, also in the values by which it is said in another language.

    Args:
        known: By id, see `labels`.
    """
    if isinstance(text, Sentence):
        values = {key: named(value, known) if isinstance(value, str) else value for key, value in text.values.items()}
        return Sentence(text.key, **values)

    def label(found: re.Match[str]) -> str:
        said = known.get(found["whole"]) or known.get(found["id"])
        if said is None:
            return found.group()
        name = found["name"]
        return said if not name or said.startswith(name) else f"{name} ({said})"

    return _ID.sub(label, text)
