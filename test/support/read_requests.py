"""Reading a request whole, as an endpoint of ros/console does in two steps."""

from __future__ import annotations

from construction_twin.link.requests import read, read_document
from construction_twin.mqtt.requests import RequestKind


def read_message(model, kind: RequestKind, data: bytes, retained: bool):
    return read(model, read_document(data, retained, kind.name, kind.limit), kind.name)
