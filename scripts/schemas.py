"""JSON Schemas of what travels, made from the records: prints that of `view`, or writes those of the page: `schemas.py [FILE]`.

Types are the annotations, meanings the docstrings, and what stands in `Annotated` beside a type is taken over as it is: `minimum`,
`pattern`, ...; `since` is the version of the message that has added a key. A field with a default may be missing.
"""

from __future__ import annotations

import inspect
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from construction_twin.core.records import ZERO
from construction_twin.core.reports import WorkReport
from construction_twin.core.sentences import REASONS
from construction_twin.link.remote_review import PathView, PlanView
from construction_twin.link.remote_view import VERSION, View
from construction_twin.mqtt.requests import (
    ACKNOWLEDGE,
    ANSWER,
    IK,
    PLAN_REQUEST,
    RAISE_SPEED,
    REVIEW,
    STOP,
    Answer,
    RequestKind,
)
from construction_twin.physics.report import RehearsalReport
from construction_twin.views.message_history import Message
from construction_twin.views.scene_view import SceneView
from construction_twin.views.status_line import Line

_TYPES = {str: "string", bool: "boolean", int: "integer", float: "number", NoneType: "null"}
_ATTRIBUTES = "\n\nAttributes:\n"
_WIDTH = 132
#: What the page checks, by the name of the constant in web/src/schemas.js; of a kind of request its answer. `pause/ack` is as
#: `stop/ack`.
CHECKED: dict[str, Any] = {
    "VIEW": View,
    "WORK": WorkReport,
    "SCENE": SceneView,
    "SCREEN": Sequence[Line],
    "PLAN": PlanView,
    "PATH": PathView,
    "REHEARSAL": RehearsalReport,
    "REVIEW_ACK": REVIEW,
    "STOP_ACK": STOP,
    "PLAN_REQUEST_ACK": PLAN_REQUEST,
    "IK_ACK": IK,
    "ANSWER_ACK": ANSWER,
    "ACKNOWLEDGE_ACK": ACKNOWLEDGE,
    "SPEED_ACK": RAISE_SPEED,
    "MESSAGES": Sequence[Message],
}


def schema(kind: Any, words: bool = True) -> dict[str, Any]:
    """Return the schema of a type.

    Args:
        words: With descriptions.
    """
    if get_origin(kind) is Annotated:
        inner, beside = get_args(kind)
        return dict(beside) if "const" in beside else schema(inner, words) | beside
    if get_origin(kind) in (Union, UnionType):
        (inner,) = (each for each in get_args(kind) if each is not NoneType)
        made = schema(inner, words)
        return made | {"type": [made["type"], "null"]}
    if get_origin(kind) is Literal:
        return {"enum": list(get_args(kind))}
    if isinstance(kind, RequestKind):
        answer = schema(Answer, words)
        return answer | {"properties": {name: answer["properties"][name] for name in kind.answer}}
    if is_dataclass(kind):
        return _record(kind, words)
    if kind is Any:
        return {}
    if get_origin(kind) is not None and issubclass(get_origin(kind), Mapping):
        return {"type": "object", "additionalProperties": schema(get_args(kind)[1], words)}
    if get_origin(kind) is not None and issubclass(get_origin(kind), Sequence):
        return {"type": "array", "items": schema(get_args(kind)[0], words)}
    return {"type": _TYPES[kind]}


def _record(kind: Any, words: bool) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    about, meanings = _told(kind)
    properties = {}
    for each in fields(kind):
        name = each.name
        made = _seconds(each.metadata[ZERO]) if ZERO in each.metadata else schema(hints[name], words)
        meaning = {"description": meanings[name]} if words and name in meanings else {}
        properties[name] = made | meaning
    return {
        **({"description": about} if words else {}),
        "type": "object",
        "additionalProperties": False,
        "required": [each.name for each in fields(kind) if not _may_be_missing(each)],
        "properties": properties,
    }


def _seconds(zero: float | None) -> dict[str, Any]:
    return {"type": "number" if zero is not None else ["number", "null"]}


def _may_be_missing(field: Any) -> bool:
    return field.default is not MISSING or field.default_factory is not MISSING


def _told(kind: type) -> tuple[str, dict[str, str]]:
    """Return what a record's docstring says of it, and of its fields."""
    about, _, rest = (inspect.getdoc(kind) or "").partition(_ATTRIBUTES)
    meanings = {}
    for entry in re.findall(r"^    (\S.*(?:\n {8}.*)*)", rest, re.MULTILINE):
        names, _, meaning = entry.partition(": ")
        meanings.update(dict.fromkeys(names.split(", "), _line(meaning)))
    return _line(about), meanings


def _line(text: str) -> str:
    return " ".join(text.split())


def view_schema() -> str:
    """Return the JSON Schema of `view` as text."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"view, version {VERSION}"}
    return f"{_text(head | schema(View))}\n"


def page_schemas() -> str:
    """Return the text of web/src/schemas.js."""
    constants = [
        f"/** {_about(kind)}. */\nexport const {name} = {_text(schema(kind, words=False))};\n"
        for name, kind in CHECKED.items()
    ]
    reasons = (
        f"/** Beginnings of the keys of reasons and answers, as core/sentences.py has them. */\n"
        f"export const REASONS = {_text(list(REASONS))};\n"
    )
    head = "// Made from the records by scripts/schemas.py; check.js and sentences.js read it.\n"
    return "\n".join([head, *constants, reasons])


def _about(kind: Any) -> str:
    if isinstance(kind, RequestKind):
        return f"A message on <prefix>/<robot>/{kind.ack.format('<account>')}"
    made = schema(kind)
    return made.get("items", made)["description"].partition(".")[0]


def _text(value: Any, indent: str = "", before: int = 0) -> str:
    """Return JSON in which what fits into a line stands in one; `before` is what already stands in this line."""
    line = json.dumps(value, ensure_ascii=False)
    if len(indent) + before + len(line) < _WIDTH or not isinstance(value, (dict, list)):
        return line
    deeper = f"{indent}  "
    if isinstance(value, dict):
        items = [f'"{key}": {_text(item, deeper, len(key) + 4)}' for key, item in value.items()]
        return "{\n" + ",\n".join(deeper + item for item in items) + f"\n{indent}}}"
    items = [_text(item, deeper) for item in value]
    if all(isinstance(item, str) for item in value):
        # names, as many in a line as fit
        return f"[\n{_filled(items, deeper)}\n{indent}]"
    return "[\n" + ",\n".join(deeper + item for item in items) + f"\n{indent}]"


def _filled(items: Sequence[str], indent: str) -> str:
    lines = [indent]
    for number, item in enumerate(items):
        piece = item + ("," if number < len(items) - 1 else "")
        if len(lines[-1]) + 1 + len(piece) > _WIDTH:
            lines.append(indent)
        lines[-1] += piece if lines[-1] == indent else f" {piece}"
    return "\n".join(lines)


if __name__ == "__main__":
    if sys.argv[1:]:
        Path(sys.argv[1]).write_text(page_schemas(), encoding="utf-8")
    else:
        print(view_schema(), end="")
