"""What the gateway says on `status`, checked by a model, and as what `link`, `tool` and `/diagnostics` tell of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, FailFast, Field, ValidationError

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import LONGEST, Sentence, heard
from construction_twin.gateway.tool_switches import MOST_REPORTED
from construction_twin.mqtt.messages import FIRST_PROTOCOL, OFFLINE, PLC, READY, RSI, is_short_text, parse_object

#: Longest text that is told, and longest status [bytes].
_LONGEST, _MOST_BYTES = 300, 1 << 20
#: Most sentences that are told of, and how deep they stand: in a switch of the tool.
_MOST_SAID, _LEVELS = 256, 4
#: Objects of the status whose values are shown, each under its own name and theirs.
_GROUPS = ("controller", "cycle", "playout", "speed_limit", "stop", "intruder")
_SINGLE = ("mode", "fault_number", "last_refusal", "later_refusal", "last_ipoc_jump_ms")
#: What counts in the gateway's reason while it refuses datagrams, where a parser stopped, and by how much a clock is off: these
#: change with every second of a sender that goes on.
_COUNTS = re.compile(r"(datagrams refused:|\bline|\bcolumn|\bclock is) \d+(?:\.\d+)?")


def _short(text: str) -> str:
    if not is_short_text(text):
        raise ValueError("no short text in one line")
    return text


def _different(switches: list[_Switch]) -> list[_Switch]:
    if len({switch.id for switch in switches}) < len(switches):
        raise ValueError("a switch stands in it twice")
    return switches


_Count = Annotated[int, Field(ge=0, lt=1 << 63)]
# a whole number in JSON may have more digits than a float holds
_Number = Annotated[float, Field(gt=-(2.0**63), lt=2.0**63)]
_Shown = str | _Number | None
_Name = Annotated[str, Field(max_length=64)]
_Group = Annotated[dict[_Name, _Shown], Field(max_length=32)]
# a record of each fault in a long list would hold up the bridge
_Counts = Annotated[list[_Count], FailFast()]
_PerAxis = Annotated[list[_Number], Field(max_length=12)]
_Signals = Annotated[dict[_Name, bool], Field(max_length=16)]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True)


class _Histogram(_Part):
    bins: _Counts = []
    counts: _Counts = []


class _Switch(_Part):
    id: str
    state: Literal["armed", "fired", "void", "refused"]
    reason: str


class _Tool(_Part):
    known: bool
    name: str
    outputs: _Signals
    inputs: _Signals
    switches: Annotated[list[_Switch], Field(max_length=MOST_REPORTED), AfterValidator(_different)] = []
    reason: str


class _Status(_Part):
    """What is read of a status; it may hold more."""

    state: str = ""
    reason: str = ""
    run: Annotated[str, AfterValidator(_short)] = ""
    fault: bool = False
    fault_number: _Count = 0
    protocol: _Count = FIRST_PROTOCOL
    counters: dict[str, _Count] = {}
    reply_us: _Histogram = _Histogram()
    tool: _Tool = Field(default=None)  # type: ignore[assignment]  # there is none, or one that is whole
    mode: _Shown = None
    last_refusal: _Shown = None
    later_refusal: _Shown = None
    last_ipoc_jump_ms: _Shown = None
    controller: _Group = {}
    cycle: _Group = {}
    playout: _Group = {}
    speed_limit: _Group = {}
    stop: Annotated[dict[_Name, _Shown | _PerAxis], Field(max_length=32)] = {}
    intruder: _Group = {}


def parse_status(payload: bytes) -> dict:
    """Return a gateway's status, or its answer; PayloadError (``status``) when it is not as the interface says."""
    status = parse_object(payload, "status", _MOST_BYTES)
    try:
        _Status.model_validate(status)
    except ValidationError as error:
        place = ".".join(str(level)[:64] for level in error.errors()[0]["loc"])
        raise PayloadError(
            "status", Sentence("status message whose {name} is not what the interface says", name=place)
        ) from None
    said = status.pop("said", None)
    if "reason" in status:
        status["reason"] = status["reason"][:LONGEST]
    return _with_sentences(status, heard(said) if isinstance(said, dict) and len(said) <= _MOST_SAID else {}, _LEVELS)


def _with_sentences(value: Any, known: Mapping[str, Sentence], levels: int) -> Any:
    if isinstance(value, dict) and levels:
        return {name: _with_sentences(each, known, levels - 1) for name, each in value.items()}
    if isinstance(value, list) and levels:
        return [_with_sentences(each, known, levels - 1) for each in value]
    return known.get(value, value) if isinstance(value, str) else value


def parse_presence(payload: bytes) -> dict:
    """Parse what is on `status`, whoever sent it: a gateway's JSON, see `parse_status`, or a bare PLC's word.

    Returns:
        Of a bare PLC ``{"state": "ready", "kind": "plc"}``. In a gateway's `kind` is ``rsi``, whatever its message holds.
    """
    if payload in (READY.encode(), OFFLINE.encode()):
        return {"state": payload.decode(), "kind": PLC}
    return parse_status(payload) | {"kind": RSI}


def without_counts(reason: str) -> str:
    """Return a reason without the numbers that go on while nothing else changes: to ask whether it is news, not to be read."""
    return _COUNTS.sub(r"\1", reason)


def status_values(status: Mapping[str, Any]) -> dict[str, str]:
    """Return what stands beside the counters of a parsed status; what is absent is left out.

    Returns:
        E.g. ``{"playout_delay_ms": "20", "intruder_session": "", "last_refusal": "..."}``; "" for what is not known.
    """
    values = {name: _text(status[name]) for name in _SINGLE if name in status}
    for group in _GROUPS:
        values |= {f"{group}_{name}": _text(value) for name, value in status.get(group, {}).items()}
    return values


def controller_sentence(status: Mapping[str, Any]) -> str:
    """Return why the arm may not move, as the controller told the gateway; "" for no reason."""
    return _text(status.get("controller", {}).get("sentence"))


def _text(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(_text, value))
    return "" if value is None else cut(value) if isinstance(value, str) else f"{value:.9g}"


def cut(text: str) -> str:
    """Return a text, or its beginning where it is too long to be told: a sentence that fits stays one."""
    return text if len(text) <= _LONGEST else text[:_LONGEST]
