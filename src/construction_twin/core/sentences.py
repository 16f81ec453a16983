"""Sentences for people: English, and what another language needs in order to say the same.

A message carries what `told` returns; whoever receives it finds its sentences again with `heard`, and the page says them by their
templates (web/locale). Standard library only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import reduce
from string import Formatter
from typing import Any

from construction_twin.core.units import for_people, to_people


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
#: Of each sentence that has values, by its text: `template`, and its `values` as they are written in it.
Told = Mapping[str, Mapping[str, Any]]


class Sentence(str):
    """A sentence in English, which knows its template and values: ``Sentence("the gate holds ({state})", state="STALE")``.

    What is made of it with other text is a plain text; to be said in another language too, it is a value of another sentence.
    """

    template: str
    values: Mapping[str, Value]

    def __new__(cls, template: str, /, **values: Value) -> Sentence:
        """Return the sentence of a template with its values."""
        return cls.of(template.format(**values), template, values)

    @classmethod
    def of(cls, text: str, template: str, values: Mapping[str, Value]) -> Sentence:
        """Return a sentence that was written already."""
        sentence = super().__new__(cls, text)
        sentence.template, sentence.values = template, values
        return sentence

    def __reduce__(self) -> tuple[Any, ...]:
        return Sentence.of, (str(self), self.template, dict(self.values))


def both(*sentences: str) -> str:
    """Return sentences one after the other; those that are empty are left out."""
    said = [sentence for sentence in sentences if sentence]
    return reduce(lambda first, second: Sentence("{first}; {second}", first=first, second=second), said) if said else ""


def replaced(text: str, part: str, other: str) -> str:
    """Return a sentence with another one in the place of the part that it has as a value."""
    if text == part:
        return other
    if not isinstance(text, Sentence):
        return text
    values = text.values.items()
    return Sentence.of(
        text.replace(part, other),
        text.template,
        {name: replaced(each, part, other) if isinstance(each, str) else each for name, each in values},
    )


def told(*parts: object) -> Told:
    """Return what another language needs of all sentences in records, lists and texts. One without values is its own template."""
    return {
        str(sentence): {"template": sentence.template, "values": _written(sentence)}
        for sentence in _sentences(parts)
        if sentence.values
    }


def _sentences(part: object) -> Iterator[Sentence]:
    if isinstance(part, Sentence):
        yield part
        part = part.values
    if is_dataclass(part):
        part = [getattr(part, each.name) for each in fields(part)]
    for each in part.values() if isinstance(part, Mapping) else part if isinstance(part, (tuple, list)) else ():
        yield from _sentences(each)


def places(template: str) -> dict[str, str]:
    """Return the formats of a template's values by their names; ValueError: it is none."""
    return {name: form or "" for _, name, form, _ in Formatter().parse(template) if name is not None}


def _written(sentence: Sentence) -> dict[str, str]:
    # of a sentence that came in a message the values are texts already
    values = ((name, form, sentence.values[name]) for name, form in places(sentence.template).items())
    return {name: str(value) if isinstance(value, str) else format(value, form) for name, form, value in values}


def heard(told_of: Told) -> dict[str, Sentence]:
    """Return the sentences that a message has told of, by their texts."""
    known: dict[str, Sentence] = {}
    for text in sorted(told_of, key=len):
        # a sentence among the values of another one is the shorter one
        values = {name: known.get(value, value) for name, value in told_of[text]["values"].items()}
        known[text] = Sentence.of(text, told_of[text]["template"], values)
    return known
