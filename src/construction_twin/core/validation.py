"""What is wrong with a document, in words for the person who wrote it: key, value, what is allowed.

pydantic finds it; its own words ("Field required", "String should match pattern") are a programmer's. What a key may hold is told
from the model's JSON Schema, whatever is wrong with it. Standard library only: this takes what pydantic returns, not pydantic.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
_KINDS = {
    "number": "a number",
    "integer": "a whole number",
    "string": "a text",
    "boolean": "true or false",
    "array": "a list",
    "object": "a mapping",
    "null": "nothing",
}
_BOUNDS = {"exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below", "maximum": "at most"}


@dataclass(frozen=True)
class WrongValue:
    """The first thing that is wrong.

    Attributes:
        key: Keys and positions from the top, with ``/`` between; empty: the document itself.
        value: None when the key is missing.
    """

    key: str
    value: object
    expected: str

    def __str__(self) -> str:
        return f"{self.key}: found {'nothing' if self.value is None else repr(self.value)}, expected {self.expected}"


def wrong_value(error: Any, schema: Schema) -> WrongValue:
    """Return in words what is wrong by a pydantic.ValidationError."""
    problems = error.errors()
    first = _mistyped(problems) or problems[0]
    keys, place, parent = _walk(schema, first["loc"])
    value = None if first["type"] == "missing" else first.get("input")
    more = f" ({len(problems)} keys are wrong)" if len(problems) > 1 else ""
    return WrongValue("/".join(keys), value, _expected(first, place, parent, keys, schema) + more)


def _mistyped(problems: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the unknown key beside the first problem, a key that is missing: whoever mistypes a key looks for what he wrote."""
    first = problems[0]
    if first["type"] != "missing":
        return None
    beside = first["loc"][:-1]
    strange = (problem for problem in problems if problem["type"] == "extra_forbidden")
    return next((problem for problem in strange if problem["loc"][:-1] == beside), None)


def configuration_error(error: Any, model: Any, where: str = "") -> ConfigurationError:
    """Return the typed error of what is wrong with a document of a pydantic model."""
    wrong = wrong_value(error, model.model_json_schema())
    key = "/".join(filter(None, (where, wrong.key)))
    return ConfigurationError(key, wrong.value, wrong.expected)


def _expected(
    problem: Mapping[str, Any], place: Schema | None, parent: Schema, keys: Sequence[str], root: Schema
) -> str:
    kind = problem["type"]
    if kind == "extra_forbidden":
        known = list(parent.get("properties", ()))
        near = difflib.get_close_matches(keys[-1], known, n=1)
        return f"no such key; did you mean {near[0]}?" if near else f"no such key; known are {', '.join(known)}"
    if kind in ("value_error", "assertion_error"):
        # of our own validators
        return str(problem.get("ctx", {}).get("error", "another value")).removeprefix("expected ")
    if kind == "json_invalid":
        return f"JSON ({problem['ctx']['error']})"
    said = _described(place, root) if place is not None else "another value"
    return said.replace("a number", "a finite number", 1) if kind == "finite_number" else said


def _walk(schema: Schema, loc: Sequence[str | int]) -> tuple[list[str], Schema | None, Schema]:
    """Return the keys of a place, what may stand there, and what may stand around it.

    `loc` also holds names of alternatives and of validators, which are no keys.
    """
    keys: list[str] = []
    parent = place = _resolved(schema, schema)
    for step in loc:
        inner = next(filter(None, (_inner(way, step, schema) for way in _alternatives(place, schema))), None)
        if inner is not None:
            keys.append(str(step))
            parent, place = place, _resolved(inner, schema)
            continue
        ways = _alternatives(place, schema)
        named = [way for way in ways if _is_named(step, way, place)]
        if named:
            place = named[0]
        elif (
            step == loc[-1] and isinstance(step, str) and "[" not in step and any(way.get("properties") for way in ways)
        ):
            known = {name: node for way in ways for name, node in way.get("properties", {}).items()}
            return [*keys, step], None, {"properties": known}
    return keys, place, parent


def _is_named(step: str | int, way: Schema, union: Schema) -> bool:
    """Return whether a step names an alternative of a union: by its model, or by the value that tells the alternatives apart."""
    if way is union:
        return False
    reference = union.get("discriminator", {}).get("mapping", {}).get(step, "")
    return way.get("title") in {step, reference.rpartition("/")[2]}


def _resolved(node: Schema, root: Schema) -> Schema:
    while "$ref" in node:
        node = root["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def _alternatives(node: Schema, root: Schema) -> list[Schema]:
    ways = node.get("anyOf") or node.get("oneOf") or [node]
    return [_resolved(way, root) for way in ways]


def _inner(node: Schema, step: str | int, root: Schema) -> Schema | None:
    """Return what may stand at a key or position of `node`; None when there is no such place."""
    if isinstance(step, int):
        fixed = node.get("prefixItems", ())
        found = fixed[step] if step < len(fixed) else node.get("items")
        return found if isinstance(found, Mapping) else None
    if step in node.get("properties", {}):
        return node["properties"][step]
    # keys of a certain form stand under their pattern
    free = next(iter(node.get("patternProperties", {}).values()), node.get("additionalProperties"))
    return free if isinstance(free, Mapping) and not step.startswith("[") else None


def _described(node: Schema, root: Schema) -> str:
    """Return in words what may stand at a place."""
    node = _resolved(node, root)
    if "anyOf" in node or "oneOf" in node:
        return " or ".join(dict.fromkeys(_described(way, root) for way in _alternatives(node, root)))
    if "const" in node or "enum" in node:
        return _either([_text(value) for value in node.get("enum", [node.get("const")])])
    kind = node.get("type")
    special = _SPECIAL.get(kind)
    return special(node, root) if special else _KINDS.get(str(kind), "another value")


def _number(node: Schema, _root: Schema) -> str:
    words = [_KINDS[node["type"]]]
    for key, word in _BOUNDS.items():
        if key in node:
            words.append(f"{word} {node[key]:g}")
    return words[0] if len(words) == 1 else f"{words[0]} {' and '.join(words[1:])}"


def _string(node: Schema, _root: Schema) -> str:
    pattern = node.get("pattern")
    if pattern:
        return PATTERNS.get(pattern, f"a text of the form {pattern}")
    return "a text that is not empty" if node.get("minLength") else "a text"


def _array(node: Schema, root: Schema) -> str:
    fixed = node.get("prefixItems")
    if fixed:
        kinds = list(dict.fromkeys(_described(item, root) for item in fixed))
        return f"a list of {len(fixed)}: {', '.join(kinds)}"
    least, most = node.get("minItems", 0), node.get("maxItems")
    count = f" with {least} to {most} entries" if most else f" with {least} or more entries" if least else ""
    items = node.get("items")
    return f"a list{count}" + (f", each {_described(items, root)}" if items else "")


def _object(node: Schema, root: Schema) -> str:
    if node.get("properties"):
        return f"a mapping with the keys {', '.join(node['properties'])}"
    free = node.get("additionalProperties")
    return "a mapping" + (f", each value {_described(free, root)}" if isinstance(free, Mapping) and free else "")


_SPECIAL: Mapping[Any, Callable[[Schema, Schema], str]] = {
    "number": _number,
    "integer": _number,
    "string": _string,
    "array": _array,
    "object": _object,
}


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "''" if value == "" else str(value)


def _either(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
