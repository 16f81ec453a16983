"""Sentences for people: English, with template and values for translation.

A message carries what `templates_of` returns; its receiver reads them with `sentences_of`, the page translates (web/locale).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import reduce
from string import Formatter
from typing import Any

from construction_twin.core.units import display_text, to_display_unit


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its unit, as the program has it: rad, m, alone or over a time (``rad/s^2``), or another unit."""

    value: float
    unit: str

    def __format__(self, form: str) -> str:
        """Return it in deg or mm with the decimals it needs, with two (``.2``), or in its own unit with six (``.6q``)."""
        if not form:
            return display_text(self.value, self.unit)
        number, unit = (self.value, self.unit) if form.endswith("q") else to_display_unit(self.value, self.unit)
        return f"{number:{form.removesuffix('q')}f} {unit}".strip()


Value = str | int | float | Quantity
#: Longest sentence that is read, and how deep one may stand in others: a message may come from anybody.
LONGEST, DEEPEST = 2000, 20
#: Of each sentence that has values, by its text: `template`, and its `values` as they are written in it.
SentenceTemplates = Mapping[str, Mapping[str, Any]]


class Sentence(str):
    """A sentence in English with template and values; to be translated inside another one, it is a value of that."""

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


def join_sentences(*sentences: str) -> str:
    """Return sentences one after the other; those that are empty are left out."""
    texts = [sentence for sentence in sentences if sentence]
    return (
        reduce(lambda first, second: Sentence("{first}; {second}", first=first, second=second), texts) if texts else ""
    )


def replace_part(text: str, part: str, other: str) -> str:
    """Replace a part of a sentence, in its values too."""
    if text == part or not isinstance(text, Sentence):
        return other if text == part else text
    items = text.values.items()
    values = {name: replace_part(each, part, other) if isinstance(each, str) else each for name, each in items}
    return Sentence.of(text.replace(part, other), text.template, values)


def templates_of(*parts: object) -> SentenceTemplates:
    """Return templates and values of all sentences in records, lists and texts, by text. One without values is its own template."""
    found: dict[str, Mapping[str, Any]] = {}
    _collect_templates(parts, found)
    return found


def _collect_templates(part: object, found: dict[str, Mapping[str, Any]]) -> None:
    if isinstance(part, Sentence):
        if part.values and part not in found:
            found[str(part)] = {"template": part.template, "values": _written(part)}
            _collect_templates(part.values, found)
        return
    if is_dataclass(part):
        part = [getattr(part, each.name) for each in fields(part)]
    for each in part.values() if isinstance(part, Mapping) else part if isinstance(part, (tuple, list)) else ():
        _collect_templates(each, found)


def _written(sentence: Sentence) -> dict[str, str]:
    # of a sentence that came in a message the values are texts already
    places = ((name, form or "") for _, name, form, _ in Formatter().parse(sentence.template) if name is not None)
    values = ((name, form, sentence.values[name]) for name, form in places)
    return {name: str(value) if isinstance(value, str) else format(value, form) for name, form, value in values}


def sentences_of(templates: Any) -> dict[str, Sentence]:
    """Return the sentences of a message's templates, by their texts; one that does not make its text is left out."""
    known, levels = dict[str, Sentence](), dict[str, int]()
    for text in sorted(templates, key=len) if isinstance(templates, dict) else ():
        try:
            template, parts = templates[text]["template"], [*Formatter().parse(templates[text]["template"])]
            values = {name: templates[text]["values"][name] for _, name, *_ in parts if name is not None}
            pieces = [piece for own, name, *_ in parts for piece in (own, values.get(name or "", ""))]
            is_made = sum(map(len, pieces)) == len(text) and "".join(pieces) == text
        except (KeyError, TypeError, ValueError):
            continue
        levels[text] = 1 + max((levels.get(value, 0) for value in values.values()), default=0)
        if is_made and max(len(text), len(template)) <= LONGEST and levels[text] <= DEEPEST:
            # a sentence among the values of another one is the shorter one
            known[text] = Sentence.of(text, template, {name: known.get(value, value) for name, value in values.items()})
    return known
