"""Models of the gateway's `status` and of its answers on `control/ack`, and their values as texts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, FailFast, Field, ValidationError, ValidationInfo

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import LONGEST, Sentence, sentences_of
from construction_twin.gateway.tool_switches import MOST_REPORTED
from construction_twin.mqtt.messages import FIRST_PROTOCOL, OFFLINE, PLC, READY, RSI, is_short_text, parse_object

#: Longest text that is shown, longest status [bytes], and most templates in `said`.
_LONGEST, _MOST_BYTES, _MOST_SAID = 300, 1 << 20, 256
#: Objects of the status whose values are shown, each under its own name and theirs.
_GROUPS = ("controller", "cycle", "playout", "speed_limit", "stop", "intruder")
_SINGLE = ("mode", "fault_number", "last_refusal", "later_refusal", "last_ipoc_jump_ms")
#: Numbers in the gateway's reason that change with every second of a sender that it refuses.
_COUNTS = re.compile(r"(datagrams refused:|\bline|\bcolumn) \d+")


def _short(text: str) -> str:
    if not is_short_text(text):
        raise ValueError("no short text in one line")
    return text


def _sentence(text: str, info: ValidationInfo) -> str:
    """Return a text as the sentence whose template is in the message's `said`."""
    return (info.context or {}).get(text, text[:LONGEST])


_Text = Annotated[str, AfterValidator(_sentence)]
_Count = Annotated[int, Field(ge=0, lt=1 << 63)]
# a whole number in JSON may have more digits than a float holds
_Number = Annotated[float, Field(gt=-(2.0**63), lt=2.0**63)]
_Shown = _Text | _Number | None
_Name = Annotated[str, Field(max_length=64)]
_Group = Annotated[dict[_Name, _Shown], Field(max_length=32)]
# a record of each fault in a long list would hold up the bridge
_Counts = Annotated[list[_Count], FailFast()]
_PerAxis = Annotated[list[_Number], Field(max_length=12)]
_Signals = Annotated[dict[_Name, bool], Field(max_length=16)]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True)


class _Histogram(_Part):
    bins: _Counts = []
    counts: _Counts = []
    max: _Count | _Number = 0


class _Switch(_Part):
    id: str
    state: Literal["armed", "fired", "void", "refused"]
    reason: _Text


class _Tool(_Part):
    known: bool
    name: str
    outputs: _Signals
    inputs: _Signals
    switches: Annotated[list[_Switch], Field(max_length=MOST_REPORTED)] = []
    reason: _Text


class ToolPose(_Part):
    """Where a controller says that its tool is, and the axes of the same telegram: [rad], [m], KUKA's A, B, C."""

    axes: _PerAxis
    position: Annotated[list[_Number], Field(min_length=3, max_length=3)]
    abc: Annotated[list[_Number], Field(min_length=3, max_length=3)]


class GatewayStatus(_Part):
    """The fields that are read of a status; a bare PLC has `kind` and `state` alone."""

    kind: Literal["rsi", "plc"] = RSI  # type: ignore[assignment]  # a constant
    state: str = OFFLINE
    reason: _Text = ""
    session: str = ""
    run: Annotated[str, AfterValidator(_short)] = ""
    connection: _Count | None = None
    fault: bool = False
    #: Of the last stop or fault in its run; None: unknown.
    fault_number: _Count | None = None
    protocol: _Count = FIRST_PROTOCOL
    hash: str = ""
    decimals: _Count | None = None
    counters: dict[str, _Count] = {}
    reply_us: _Histogram = _Histogram()
    tool: _Tool = Field(default=None)  # type: ignore[assignment]  # there is none, or one that is whole
    #: None: telegrams carry none, or there are none.
    tool_pose: ToolPose | None = None
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

    @property
    def has_failed(self) -> bool:
        """True when the gateway's program has failed: it brakes, holds and takes nothing until it is started again."""
        return self.state == "failed"

    @property
    def is_armed(self) -> bool:
        """True when it is armed for its `session`, or follows it."""
        return self.state in ("armed", "following")

    def text_values(self) -> dict[str, str]:
        """Return the values beside the counters: ``{"playout_delay_ms": "20", "intruder_session": "", ...}``."""
        values = {name: _text(getattr(self, name)) for name in _SINGLE if name in self.model_fields_set}
        for group in _GROUPS:
            values |= {f"{group}_{name}": _text(value) for name, value in getattr(self, group).items()}
        return values

    @property
    def controller_sentence(self) -> str:
        """Why the arm may not move, as the controller says itself; "": it may."""
        return _text(self.controller.get("sentence"))


class GatewayAnswer(_Part):
    """An answer to a control message."""

    id: str = ""
    verb: str = ""
    ok: bool = False
    reason: _Text = ""


NO_STATUS = GatewayStatus()
_Model = TypeVar("_Model", GatewayStatus, GatewayAnswer)


def read(model: type[_Model], document: Mapping[str, Any]) -> _Model:
    """Return a status or an answer; PayloadError ``status``."""
    said = document.get("said")
    known = sentences_of(said) if isinstance(said, dict) and len(said) <= _MOST_SAID else {}
    try:
        # only a gateway sends JSON: the message's own `kind` is overwritten
        return model.model_validate({**document, "kind": RSI}, context=known)
    except ValidationError as error:
        place = ".".join(str(level)[:64] for level in error.errors()[0]["loc"])
        raise PayloadError(
            "status", Sentence("status message whose {name} is not what the interface says", name=place)
        ) from None


def parse_status(payload: bytes) -> GatewayStatus:
    """Parse a payload on `status`, a gateway's JSON or a bare PLC's word; PayloadError as of `read`."""
    if payload in (READY.encode(), OFFLINE.encode()):
        return GatewayStatus.model_construct(kind=PLC, state=payload.decode())
    return read(GatewayStatus, parse_object(payload, "status", _MOST_BYTES))


def parse_answer(payload: bytes) -> GatewayAnswer:
    """Parse a payload on `control/ack`; PayloadError as of `read`."""
    return read(GatewayAnswer, parse_object(payload, "status", _MOST_BYTES))


def without_counts(reason: str) -> str:
    """Return a reason without the numbers that change alone, to ask whether it is new."""
    return _COUNTS.sub(r"\1", reason)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(_text, value))
    return "" if value is None else cut(value) if isinstance(value, str) else f"{value:.9g}"


def cut(text: str) -> str:
    """Return a text, or its beginning where it is too long; a sentence that fits stays one."""
    return text if len(text) <= _LONGEST else text[:_LONGEST]
