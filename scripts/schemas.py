"""JSON Schemas of what travels, made from the records: prints that of `view`, or writes those of the page: `schemas.py [FILE]`.

Types, bounds and meanings are those of the records and their docstrings, as pydantic tells them. A field with a default may be
missing.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from construction_twin.core.reports import WorkReport
from construction_twin.extensions.console.message_board import Message
from construction_twin.extensions.console.remote_review import PathView, PlanView, SceneView
from construction_twin.extensions.console.remote_view import VERSION, View
from construction_twin.extensions.console.status_line import Line
from construction_twin.mqtt.requests import (
    ACKNOWLEDGE,
    ANSWER,
    PLAN_REQUEST,
    RAISE_SPEED,
    REVIEW,
    STOP,
    Answer,
    RequestKind,
)
from construction_twin.review.rehearsal_report import RehearsalReport

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
    "ANSWER_ACK": ANSWER,
    "ACKNOWLEDGE_ACK": ACKNOWLEDGE,
    "SPEED_ACK": RAISE_SPEED,
    "MESSAGES": Sequence[Message],
}


def schema(kind: Any, words: bool = True) -> dict[str, Any]:
    """Return the schema of a type, with its records where they stand.

    Args:
        words: With descriptions.
    """
    if isinstance(kind, RequestKind):
        answer = schema(Answer, words)
        return answer | {"properties": {name: answer["properties"][name] for name in kind.answer}}
    made = TypeAdapter(kind).json_schema(mode="serialization")
    return _inlined(made, made.pop("$defs", {}), words)


def _inlined(node: dict[str, Any], known: Mapping[str, Any], words: bool) -> dict[str, Any]:
    """Return a schema without references, and without the keywords that the page does not know."""
    beside = {
        key: value for key, value in node.items() if key not in ("title", "default", "description", "$ref", "anyOf")
    }
    if words and "description" in node:
        beside["description"] = " ".join(node["description"].split())
    if "$ref" in node:
        return _inlined(known[node["$ref"].rpartition("/")[2]], known, words) | beside
    if "anyOf" in node:
        one = _inlined(node["anyOf"][0], known, words)
        return one | {"type": [one["type"], "null"]} | beside
    if "properties" in node:
        properties = {name: _inlined(each, known, words) for name, each in node["properties"].items()}
        return {"required": [], **beside, "properties": properties, "additionalProperties": False}
    if "prefixItems" in node:
        beside["items"] = beside.pop("prefixItems")[0]
    if "items" in beside:
        beside["items"] = _inlined(beside["items"], known, words)
    if isinstance(inner := beside.get("additionalProperties"), dict):
        beside["additionalProperties"] = _inlined(inner, known, words)
    return {key: {} if value is True else value for key, value in beside.items()}


def view_schema() -> str:
    """Return the JSON Schema of `view` as text."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"view, version {VERSION}"}
    return json.dumps(head | schema(View), ensure_ascii=False, indent=1) + "\n"


def page_schemas() -> str:
    """Return the text of web/src/schemas.js."""
    constants = [
        f"/** {_about(kind)}. */\nexport const {name} = {json.dumps(schema(kind, words=False))};\n"
        for name, kind in CHECKED.items()
    ]
    head = "// Made from the records by scripts/schemas.py; check.js reads it.\n"
    return "\n".join([head, *constants])


def _about(kind: Any) -> str:
    if isinstance(kind, RequestKind):
        return f"A message on <prefix>/<robot>/{kind.ack.format('<account>')}"
    made = schema(kind)
    return made.get("items", made)["description"].partition(".")[0]


if __name__ == "__main__":
    if sys.argv[1:]:
        Path(sys.argv[1]).write_text(page_schemas(), encoding="utf-8")
    else:
        print(view_schema(), end="")
