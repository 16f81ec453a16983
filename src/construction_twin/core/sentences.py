"""Sentences for people: each has a key, and its words in every language stand in `sentences.json`, and nowhere else.

A place in braces is a named value, and is written as its format says; `web/src/sentences.js` follows the same rules:

    {name}                a text or a whole number, as it is; in a reason one word
    {name:s}              in a reason, a text of several words, or another sentence
    {name:t}              in a reason, a task: its name in quotes, with its id behind in parentheses if others have it, or one word
    {name:.3f}            a number with three decimals
    {name:g}              a number with at most six digits
    {name:.6q}            a `Quantity` with six decimals, in its own unit
    {name:p}, {name:.2p}  a `Quantity` in deg or mm: with the decimals that it needs, or with two

A value that is not given leaves its place as it is. Here English is written, which logs, topics and MQTT have; the console's page
writes its own language. Standard library only; the file is read when this module is imported, never while an arm moves.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from pathlib import Path
from typing import Any

from construction_twin.core.records import document
from construction_twin.core.units import for_people, from_people, to_people

_PLACE = re.compile(r"\{(\w+)(?::(?:\.(\d))?([fgqpst])?)?\}")
_FILE = Path(__file__).with_name("sentences.json")
_ENGLISH: dict[str, str] = {key: words["en"] for key, words in json.loads(_FILE.read_bytes()).items()}
#: The key of each template, as it is written in the code: without the formats of reasons.
_KEY_OF: dict[str, str] = {
    re.sub(
        r"\{(\w+):(?:[stp]|(\.\d)p)\}", lambda place: f"{{{place[1]}{':' * bool(place[2])}{place[2] or ''}}}", words
    ): key
    for key, words in _ENGLISH.items()
}
#: Beginnings of the keys of what nodes give as reasons and answers: `understood` finds these.
REASONS = (
    "reason.",
    "executor.",
    "review.",
    "link.",
    "gateway.",
    "motion.",
    "work.",
    "startup.",
    "expected.",
    "telegram.",
    "ifc.",
    "rehearsal.",
    "physics.",
)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its unit, as the program has it: rad, m, alone or over a time (``rad/s^2``), or another unit."""

    value: float
    unit: str

    def __format__(self, form: str) -> str:
        """Return it in deg or mm with the decimals it needs, with two (``.2``), or in its own unit with six (``.6q``)."""
        if not form:
            return for_people(self.value, self.unit)
        number, unit = (self.value, self.unit) if form.endswith("q") else to_people(self.value, self.unit)
        return f"{number:{form.removesuffix('q')}f} {unit}".strip()


Value = str | int | float | Quantity


class Sentence(str):
    """A sentence in English that also knows its key and values, so that another language can say it.

    It is the text for whoever only logs, compares or sends it. What is made of it with other text is a plain text without a key; to
    keep the key, it is a value of another sentence.
    """

    key: str
    values: Mapping[str, Value]

    def __new__(cls, words: str, /, **values: Value) -> Sentence:
        """Return the sentence of a key or of a template."""
        if words in _ENGLISH:
            sentence = super().__new__(cls, fill(_ENGLISH[words], values))
        else:
            sentence = super().__new__(cls, words.format(**values))
        sentence.key, sentence.values = _KEY_OF.get(words, words), values
        return sentence

    def __getnewargs_ex__(self) -> tuple[tuple[str], Mapping[str, Value]]:
        return (self.key,), self.values

    def document(self) -> dict[str, Any]:
        """Return key and values as JSON has them."""
        return {
            "key": self.key,
            "values": {name: key_and_values(value) or document(value) for name, value in self.values.items()},
        }


def both(*sentences: str) -> str:
    """Return sentences one after the other; those that are empty are left out."""
    said = [sentence for sentence in sentences if sentence]
    return reduce(lambda first, second: Sentence("executor.both", first=first, second=second), said) if said else ""


def replaced(text: str, part: str, other: str) -> str:
    """Return a sentence with another one in the place of the part that it has as a value."""
    if text == part:
        return other
    if not isinstance(text, Sentence):
        return text
    values = text.values.items()
    return Sentence(
        text.key, **{name: replaced(each, part, other) if isinstance(each, str) else each for name, each in values}
    )


def key_and_values(text: object) -> dict[str, Any] | None:
    """Return key and values of a sentence as JSON has them; None: of a text without a key."""
    return text.document() if isinstance(text, Sentence) else None


def has(key: str) -> bool:
    """Return whether there is a sentence of this key."""
    return key in _ENGLISH


def fill(template: str, values: Mapping[str, Value]) -> str:
    """Return a template with its places filled in, by the rules above."""
    return _PLACE.sub(lambda place: _written(place, values), template)


def _written(place: re.Match[str], values: Mapping[str, Value]) -> str:
    name, decimals, form = place.groups()
    value = values.get(name)
    if value is None:
        return place[0]
    if isinstance(value, Quantity):
        form = form or "p"
        if form == "p" and decimals is None:
            return for_people(value.value, value.unit)
        number, unit = to_people(value.value, value.unit) if form == "p" else (value.value, value.unit)
        return f"{number:.{decimals}f} {unit}".strip()
    if form == "f":
        return f"{value:.{decimals}f}"
    return f"{value:g}" if form == "g" else str(value)


@lru_cache(maxsize=256)
def understood(text: str) -> Sentence | None:
    """Return the reason that a node has given as English text, with its key and values: ROS messages carry the text alone.

    Returns:
        The sentence whose text this is, character by character; None: no reason of `sentences.json` reads so. What has no words of
        its own, as ``{first:s}; {second:s}``, is found around another one only.
    """
    for key, longest, pattern, names, has_words in _patterns():
        found = pattern.fullmatch(text) if longest in text else None
        if found is not None:
            try:
                values = {name: _read(form, part) for (name, form), part in zip(names, found.groups())}
            except ValueError:
                continue
            sentence = Sentence(key, **values)
            if sentence == text and (has_words or any(isinstance(value, Sentence) for value in values.values())):
                return sentence
    return None


def _read(form: str | None, part: str) -> Value:
    if form in (None, "t"):
        return part
    if form == "s":
        return understood(part) or part
    if form in "fg":
        return float(part)
    number, _, unit = part.partition(" ")
    return Quantity(*from_people(float(number), unit)) if form == "p" else Quantity(float(number), unit)


#: What places with other values than one word may hold.
_READ = {"s": "(.+?)", "t": r"""((?:'.*?'|".*?")(?: \(\S+\))?|\S+?)""", "p": r"(\S+ \S+?)", "q": r"(\S+ \S+?)"}
_Pattern = tuple[str, str, re.Pattern[str], list[tuple[str, str | None]], bool]


@lru_cache(maxsize=1)
def _patterns() -> list[_Pattern]:
    """Return of each reason key, longest piece of its own words, pattern, places, and whether it has words; most words first."""
    reasons = {key: words for key, words in _ENGLISH.items() if key.startswith(REASONS)}
    own = {key: _PLACE.sub("", words) for key, words in reasons.items()}
    return [
        (
            key,
            max(re.split(r"\{.*?\}", reasons[key]), key=len),
            re.compile("".join(_pieces(reasons[key])), re.DOTALL),
            _names(reasons[key]),
            any(letter.isalpha() for letter in own[key]),
        )
        for key in sorted(own, key=lambda key: -len(own[key]))
    ]


def _names(template: str) -> list[tuple[str, str | None]]:
    return [(place[1], place[3]) for place in _PLACE.finditer(template)]


def _pieces(template: str) -> Iterator[str]:
    at = 0
    for place in _PLACE.finditer(template):
        yield re.escape(template[at : place.start()])
        yield _READ.get(place[3], r"(\S+?)")
        at = place.end()
    yield re.escape(template[at:])
