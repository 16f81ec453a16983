"""Strict models of files and parameters, and sentences from pydantic's errors: key, value, what is allowed, the key mistyped."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import pydantic

from construction_twin.core.errors import ConfigurationError

Schema = Mapping[str, Any]

#: What the patterns of our documents mean.
PATTERNS = {
    r"^[AE][1-6]$": "A1 to A6 or E1 to E6",
    r"^[a-z][a-z0-9_]*$": "a name of small letters, digits and _ that begins with a letter",
    r"^[a-z0-9_]+$": "a name of small letters, digits and _",
    r"^[0-9a-f]{64}$": "64 hexadecimal digits",
    r"^[/~]": "a path that begins with / or ~",
    r"^/": "a path that begins with /",
    r"^(now|motion|rest|(sync|link|execution) [A-Z_]+)$": "now, motion, rest, or a state such as `sync HOLDING`",
    r"^(fault|call|sync|execution) \S+$": "fault, call, sync or execution, and a name: `fault stall`",
    r"^/?[A-Za-z]\w*(/\w+)*$": "a name of ROS: words of letters, digits and _, with / between them",
    r"^[^.]+\.[^.]+$": "a property set and a property, with a point between them: `Pset_Robot.Side`",
    r"^[A-Z_]+\??$": "the name of a state in capitals, with ? when it may be left out",
}
#: How pydantic begins to say what it expected.
_SHOULD = re.compile(r"^(Input|String|List|Tuple|Dictionary|Value) should (be )?(have )?")
#: How it ends, of what the value beside it says already.
_TOO_MUCH = re.compile(r"( after validation|, unable to|, got | or instance of ).*")
#: Python's kinds, in the words of who writes a file.
_KINDS = {
    "a valid tuple": "a list",
    "a valid list": "a list",
    "a valid dictionary": "a mapping",
    "a valid string": "a text",
    "a valid number": "a number",
    "a valid integer": "a whole number",
    "a valid boolean": "true or false",
}


@dataclass(frozen=True)
class WrongValue:
    """The first wrong value: keys and positions from the top with ``/`` between; value None: missing."""

    key: str
    value: object
    expected: str

    def __str__(self) -> str:
        return f"{self.key}: found {'nothing' if self.value is None else repr(self.value)}, expected {self.expected}"


_Model = TypeVar("_Model", bound="StrictModel")


class StrictModel(pydantic.BaseModel):
    """What a person writes into a file, or into parameters: an unknown key is refused."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def read(cls: type[_Model], values: object, where: str = "") -> _Model:
        """Return the model of a mapping; ConfigurationError names the first wrong key below `where`."""
        try:
            return cls.model_validate(values)
        except pydantic.ValidationError as error:
            wrong = wrong_value(error, cls.model_json_schema())
            raise ConfigurationError("/".join(filter(None, (where, wrong.key))), wrong.value, wrong.expected) from error


def wrong_value(error: pydantic.ValidationError, schema: Schema) -> WrongValue:
    """Return the first wrong value; `schema`: the model's."""
    objects = list(_objects(schema))
    known = {name for each in objects for name in each.get("properties", ())}
    tags = {tag for each in objects for tag in _tags(each)} - known
    problems = [(_key(problem["loc"], tags), problem) for problem in error.errors()]
    key, first = problems[0]
    if first["type"] == "missing":
        # whoever mistypes a key looks for what he wrote: the unknown one beside the missing one
        above = key.rpartition("/")[0]
        strange = ((at, each) for at, each in problems if each["type"] == "extra_forbidden")
        key, first = next(((at, each) for at, each in strange if at.rpartition("/")[0] == above), (key, first))
    # of a value with several forms each form has its problem
    expected = " or ".join(dict.fromkeys(_expected(each, known) for at, each in problems if at == key))
    number = len({at for at, _ in problems})
    more = f" ({number} keys are wrong)" if number > 1 else ""
    return WrongValue(key, None if first["type"] == "missing" else first.get("input"), expected + more)


def _objects(node: Any) -> Iterator[Mapping[str, Any]]:
    """Return every mapping in a schema, itself included."""
    if isinstance(node, Mapping):
        yield node
    for inner in node.values() if isinstance(node, Mapping) else node if isinstance(node, list) else ():
        yield from _objects(inner)


def _tags(node: Mapping[str, Any]) -> Iterator[str]:
    """Return the words by which pydantic names an alternative in the path to a value, besides its own types."""
    title, alternatives = node.get("title"), node.get("discriminator")
    if isinstance(title, str) and "properties" in node:
        yield title
    if isinstance(alternatives, Mapping):
        yield from alternatives.get("mapping", ())


def _key(loc: tuple[str | int, ...], tags: set[str]) -> str:
    """Return the keys and positions of a path, which also names types, validators and alternatives."""
    return "/".join(str(step) for step in loc if step not in tags and step not in _TYPES and "[" not in str(step))


_TYPES = {"int", "float", "str", "bool", "none", "list", "tuple", "dict"}


def _expected(problem: Mapping[str, Any], known: set[str]) -> str:
    kind, message = problem["type"], problem["msg"]
    if kind == "missing":
        return "this key"
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(str(problem["loc"][-1]), known, n=1)
        return f"no such key; did you mean {near[0]}?" if near else "no such key"
    if kind in ("value_error", "assertion_error"):
        # of our own validators
        return str(problem.get("ctx", {}).get("error", message)).removeprefix("expected ")
    if kind == "literal_error":
        return re.sub(r"'([^']+)'", r"\1", problem["ctx"]["expected"])
    if kind == "string_pattern_mismatch":
        return PATTERNS.get(problem["ctx"]["pattern"], message)
    expected = _TOO_MUCH.sub("", _SHOULD.sub("", message))
    return _KINDS.get(expected, expected)
