"""MQTT messages around the joint string: topics, user properties, control messages. Standard library only."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partialmethod
from typing import Any

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.records import SPACED, optional_field, to_json
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.mqtt.requests import STOP, RequestKind

_NUMBER = re.compile(r"[0-9]{1,19}")
#: A ROS time, into which every stamp is turned, ends here [ns].
_MAX_NUMBER = (1 << 32) * NANOSECONDS - 1
_SESSION = re.compile(r"[A-Za-z0-9_-]{1,64}")
#: Robot, role and person of up to 32 characters each.
_ACCOUNT = re.compile(r"[A-Za-z0-9_-]{1,100}")
_LEVEL = re.compile(r"[A-Za-z0-9_-]+")
#: What a `control` message may ask for.
VERBS = ("arm", "stop", "reset", "end", "speed_limit", "switch", "void")
#: What a bare PLC says on `status`, retained: it takes joint strings, or none. ``offline`` is its last will too.
READY, OFFLINE = "ready", "offline"
#: Who answers on `status`: rsi_gateway, in JSON, or a bare PLC, in those two words.
RSI, PLC = "rsi", "plc"
#: Version of `status` and `control`, which gateway and bridge must have alike; a message that names none has the first.
PROTOCOL, FIRST_PROTOCOL = 2, 1
MAX_CONTROL_BYTES = 2048
#: What the answer to a request repeats, and the longest request in which it is looked for [bytes].
_IDENTITY, MAX_IDENTITY_BYTES = ("id", "kind", "message", "plan_hash", "plan_id", "reviewer", "task", "verdict"), 8192


def _level(name: str) -> Any:
    return property(lambda topics: topics._topic(name))


@dataclass(frozen=True)
class Topics:
    """Topic names of one robot, ``<prefix>/<robot>/...`` (docs/reference/mqtt.md)."""

    prefix: str
    robot: str

    def __post_init__(self):
        for name in ("prefix", "robot"):
            if not _LEVEL.fullmatch(getattr(self, name)):
                raise ConfigurationError(name, getattr(self, name), "letters, digits, - and _: it is a topic level")

    def _topic(self, name: str) -> str:
        return f"{self.prefix}/{self.robot}/{name}"

    def of(self, kind: RequestKind, account: str = "+") -> str:
        """Topic of one account's requests of a kind; ``+``: any account's."""
        return self._topic(kind.topic.format(account))

    def ack_of(self, kind: RequestKind) -> str:
        """Topic of the answers to them."""
        return self._topic(kind.ack)

    #: Joint strings to the arm, and from it.
    command, state = _level("command"), _level("state")
    #: Retained: the gateway's status, and the bridge's.
    status, bridge_status = _level("status"), _level("bridge/status")
    #: Verbs to the gateway, and its answers.
    control, control_ack = _level("control"), _level("control/ack")
    #: Retained: the plan under review and its rehearsal, the scene, the tasks, where the tool goes, what a person must not miss.
    plan, rehearsal, scene = _level("plan"), _level("rehearsal"), _level("scene")
    work_tasks, path, messages = _level("work/tasks"), _level("path"), _level("messages")
    #: The state of everything, for programs that show it, and the status line for a foreman.
    view, screen = _level("view"), _level("screen")
    stop_by, stop_ack = partialmethod(of, STOP), _level(STOP.ack)


@dataclass(frozen=True)
class CommandProperties:
    """User properties beside a command: session id, sequence number, stamp on the sender's clock [ns]."""

    session: str
    seq: int
    stamp: int

    def pairs(self) -> list[tuple[str, str]]:
        """Return them as MQTT 5 user properties."""
        return [("session", self.session), ("seq", str(self.seq)), ("stamp", str(self.stamp))]


@dataclass(frozen=True)
class StateProperties:
    """User properties beside a state: sequence number, the gateway's stamp [ns], command stamp [ns] (0: none)."""

    seq: int
    stamp: int
    command_stamp: int

    def pairs(self) -> list[tuple[str, str]]:
        """Return them as MQTT 5 user properties."""
        return [("seq", str(self.seq)), ("stamp", str(self.stamp)), ("command_stamp", str(self.command_stamp))]


def _read(pairs: list[tuple[str, str]], names: tuple[str, ...]) -> dict[str, str]:
    values = dict(pairs)
    if len(values) != len(pairs) or set(values) != set(names):
        raise PayloadError("properties", f"user properties {_shown_names(pairs)}; expected exactly {list(names)}")
    return values


def _number(name: str, text: str) -> int:
    if not _NUMBER.fullmatch(text) or int(text) > _MAX_NUMBER:
        raise PayloadError("properties", f"property {name} is {text[:32]!r}; expected a number up to {_MAX_NUMBER}")
    return int(text)


def is_session(text: str) -> bool:
    """Return whether a text can be a session's id beside a command: 1 to 64 letters, digits, - and _."""
    return _SESSION.fullmatch(text) is not None


def message_number(text: str) -> int | None:
    """Return the number, up to 19 digits, that a control message's id is; None: another text."""
    return int(text) if _NUMBER.fullmatch(text) else None


def read_command_properties(pairs: list[tuple[str, str]]) -> CommandProperties:
    """Parse a command's user properties; PayloadError ``properties``."""
    values = _read(pairs, ("session", "seq", "stamp"))
    if not is_session(session := values["session"]):
        raise PayloadError("properties", f"property session is {session[:32]!r}; expected letters, digits, - and _")
    return CommandProperties(session, _number("seq", values["seq"]), _number("stamp", values["stamp"]))


def read_state_properties(pairs: list[tuple[str, str]]) -> StateProperties:
    """Parse a state's user properties; PayloadError ``properties``."""
    values = _read(pairs, ("seq", "stamp", "command_stamp"))
    return StateProperties(*(_number(name, values[name]) for name in ("seq", "stamp", "command_stamp")))


def refuse_properties(pairs: list[tuple[str, str]]) -> StateProperties | None:
    """Refuse user properties beside a bare PLC's state: PayloadError ``properties``."""
    if pairs:
        found = f"a state with user properties {_shown_names(pairs)}; expected a bare PLC's"
        raise PayloadError("properties", found)
    return None


def _shown_names(pairs: list[tuple[str, str]]) -> str:
    return str([name[:32] for name, _ in pairs[:8]])


def shown_keys(document: Mapping[str, object]) -> str:
    """Return the keys of an object that are shown in a refusal."""
    return str([key[:32] for key in sorted(document)[:8]])


@dataclass(frozen=True)
class Control:
    """A message on `control`; the id of a `speed_limit` is a rising number."""

    id: str
    session: str
    verb: str
    value: object = None

    def to_json(self) -> bytes:
        """Return the message's payload."""
        return to_json(self, separators=SPACED)


@dataclass(frozen=True)
class ControlAnswer:
    """A message on `control/ack`."""

    id: str
    verb: str
    ok: bool
    reason: str
    session: str


@dataclass(frozen=True)
class BridgeStatus:
    """A message on `bridge/status`; of a bridge that ends without session and protocol, of a gateway without the last two."""

    state: str
    reason: str
    session: str | None = optional_field()
    protocol: int | None = optional_field()
    responsible: str | None = optional_field()
    not_checked: Sequence[str] | None = optional_field()


def protocol_of(document: object) -> object:
    """Return the protocol of a status or of a control message's value."""
    return document.get("protocol", FIRST_PROTOCOL) if isinstance(document, dict) else FIRST_PROTOCOL


def protocol_mismatch(gateway: object, bridge: object) -> str:
    """Return a sentence where gateway and bridge are of different versions, else ""."""
    if type(gateway) is type(bridge) is int and gateway == bridge:
        return ""
    return Sentence(
        "the gateway speaks protocol {gateway}, the bridge {bridge}: install the same version on both sides, then start both "
        "again",
        gateway=str(gateway)[:20],
        bridge=str(bridge)[:20],
    )


def arm_value(config_hash: str, run: str) -> dict[str, str | int]:
    """Return the value of `arm`: configuration and present run as in the gateway's status."""
    return {"hash": config_hash, "run": run, "protocol": PROTOCOL}


def reset_value(run: str, fault_number: int) -> dict[str, str | int]:
    """Return the value of `reset`, which a gateway refuses that was stopped or started again since the call."""
    return {"run": run, "fault_number": fault_number, "protocol": PROTOCOL}


def parse_control(payload: bytes) -> Control:
    """Parse a control message; PayloadError ``control``."""
    document = parse_object(payload, "control")
    if set(document) - {"value"} != {"id", "session", "verb"}:
        found = f"control message with keys {shown_keys(document)}; expected id, session, verb and value"
        raise PayloadError("control", found)
    if not all(is_short_text(document[key]) for key in ("id", "session", "verb")):
        raise PayloadError("control", "control message whose id, session or verb is not a short text in one line")
    return Control(**document)


def account_of(topic: str) -> str:
    """Return the account at the end of a topic such as `stop/<account>`, "" of an answer's ``ack``; PayloadError, ``sender``."""
    account = topic.rpartition("/")[2]
    if not _ACCOUNT.fullmatch(account):
        found = f"a message on {topic[-80:]!r}; expected an account at its end: up to 100 letters, digits, - and _"
        raise PayloadError("sender", found)
    return "" if account == "ack" else account


def is_short_text(value: object) -> bool:
    """Return whether a value is a text of at most 64 characters in one line."""
    # printable, because it is shown to people: in the status, in answers, in a log
    return isinstance(value, str) and len(value) <= 64 and value.isprintable()


def _without_duplicates(pairs: list[tuple[str, object]]) -> dict:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("a key stands in it twice")
    return document


def identity_of(
    payload: bytes, document: Mapping[str, object] | None = None, limit: int = MAX_IDENTITY_BYTES
) -> dict[str, str]:
    """Return the short texts in a request, also a refused one, by which its sender knows the answer."""
    if document is None:
        try:
            document = parse_object(payload, "request", limit)
        except PayloadError:
            return {}
    found = {name: document[name] for name in _IDENTITY if name in document}
    return {name: value for name, value in found.items() if isinstance(value, str) and is_short_text(value)}


def demand_live(retained: bool, what: str) -> None:
    """Refuse a retained message, which is of an unknown time: PayloadError ``retained``."""
    if retained:
        found = f"retained {what}: it is unknown when it was meant; publish it without the retain flag"
        raise PayloadError("retained", found)


def parse_object(payload: bytes, reason: str, limit: int = MAX_CONTROL_BYTES) -> dict:
    """Return the JSON object in a payload of at most `limit` bytes; PayloadError `reason`."""
    if len(payload) > limit:
        raise PayloadError(reason, f"{reason} message of {len(payload)} bytes; at most {limit} are read")
    try:
        document = json.loads(payload, object_pairs_hook=_without_duplicates)
    except (ValueError, RecursionError) as error:
        raise PayloadError(reason, f"{reason} message {payload[:80]!r} is not JSON: {error}") from error
    if not isinstance(document, dict):
        raise PayloadError(reason, f"{reason} message {payload[:80]!r} is not a JSON object")
    return document


@dataclass(frozen=True)
class Intervention:
    """A person's stop, as the gateway reads it."""

    account: str
    id: str


def parse_intervention(account: str, payload: bytes, retained: bool) -> Intervention:
    """Parse a message on `stop/<account>` as `link.requests.ButtonPress`; PayloadError ``retained`` or ``stop``."""
    demand_live(retained, STOP.name)
    document = parse_object(payload, STOP.name, STOP.limit)
    id_ = document.get("id", "")
    if not set(document) <= {"id", "moment"} or not is_short_text(id_) or not id_.strip():
        found = f"stop with keys {shown_keys(document)}; expected id, a text of 1 to 64 characters, alone"
        raise PayloadError(STOP.name, found)
    return Intervention(account, id_)
