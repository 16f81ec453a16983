"""Kinds of requests by MQTT, each stated once: topics, right, answer, pace. Standard library only."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from construction_twin.core.rate_limit import Pace, SenderLimits
from construction_twin.core.sentences import templates_of

#: Who carries out what is pressed: the gateway, which brakes the arm, the executor, which brakes along the path, or the bridge,
#: which begins a session with the gateway.
GATEWAY, EXECUTOR, BRIDGE = "gateway", "executor", "bridge"


@dataclass(frozen=True)
class Answer:
    """All fields of an answer, with defaults; a kind of request has some of them.

    Attributes:
        account, sender: Who asked, by the topic; "": no name.
        reviewer: The name on record.
        duration: Of the plan [s].
        limit: People's speed limit after the request, a fraction of the planned speed; 0: unknown.
    """

    id: str = ""
    account: str = ""
    sender: str = ""
    kind: str = ""
    ok: bool = False
    reason: str = ""
    by: str = EXECUTOR
    expired: bool = False
    plan_id: str = ""
    plan_hash: str = ""
    verdict: str = ""
    reviewer: str = ""
    duration: float = 0.0
    notes: Sequence[str] = ()
    task: str = ""
    message: str = ""
    limit: float = 0.0


UNKNOWN: Mapping[str, object] = vars(Answer())


@dataclass(frozen=True)
class RequestKind:
    """A kind of request.

    Attributes:
        right: What an account needs, of `broker.access.RIGHTS`; "stop": any but `look`; "": no account of a site may.
        topic, ack: Where it comes in and is answered, below ``<prefix>/<robot>/``; ``{}`` is the account.
        answer: Fields of `Answer`, in their order.
        limit, limited_by: Longest message that is read [bytes], or the parameter that sets it.
        pace: Of one account; None: any. Kinds of one pace that wait in one queue share it.
        starts: It starts motion or makes it faster, and repeats the moment that its screen had received.
        by: Who carries it out; a stop the gateway too.
        expires: It is void where its moment is too old when its turn comes.
    """

    name: str
    right: str
    topic: str
    ack: str
    answer: tuple[str, ...]
    limit: int = 4096
    pace: Pace | None = None
    starts: bool = False
    by: str = EXECUTOR
    expires: bool = False
    limited_by: str = ""

    def payload(self, /, **known: object) -> bytes:
        """Return an answer with the known fields, and `said` (`core.sentences`); ValueError for a nan."""
        # not by `core.records`: null in the place of a nan would be an answer
        fields = {key: known.get(key, UNKNOWN[key]) for key in self.answer}
        said = templates_of(fields)
        return json.dumps(fields | ({"said": said} if said else {}), allow_nan=False).encode()


_VERDICT = ("plan_id", "plan_hash", "verdict", "reviewer", "account", "ok", "reason", "expired")
_PRESSED = ("id", "account", "ok", "reason", "by", "expired")
_PLANNED = ("id", "account", "kind", "ok", "reason", "plan_id", "plan_hash", "duration", "expired")
_ANSWERED = ("id", "account", "task", "ok", "reason", "expired")
_ACKNOWLEDGED = ("id", "account", "message", "ok", "reason")
_LIMITED = ("id", "account", "limit", "ok", "reason", "expired")
#: Nobody alone holds up the others: a motion is checked in seconds.
_PLANNING = Pace(1)
_CHECKED = ("id", "sender", "ok", "reason", "plan_id", "plan_hash", "duration", "notes")

#: A verdict in no name, on a broker without accounts.
NAMELESS_REVIEW = RequestKind("review", "", "review", "review/ack", _VERDICT, limit=2048)
REVIEW = RequestKind("review", "approve", "review/{}", "review/ack", _VERDICT, limit=2048)
#: An approval although a rehearsal is required that is missing or was no pass; it approves nothing else.
OVERRIDE = RequestKind(
    "override_rehearsal", "approve", "override_rehearsal/{}", "override_rehearsal/ack", _VERDICT, limit=2048
)
STOP = RequestKind("stop", "stop", "stop/{}", "stop/ack", _PRESSED, limit=256)
PAUSE = RequestKind("pause", "operate", "pause/{}", "pause/ack", _PRESSED, limit=256)
RESUME = RequestKind("resume", "approve", "resume/{}", "pause/ack", _PRESSED, limit=256, starts=True)
#: Lifts a stop or fault and starts over from the arm's pose; begins a session where nothing needs to move for it.
RESET = RequestKind("reset", "reset", "reset/{}", "reset/ack", _PRESSED, limit=256, starts=True, by=BRIDGE)
ARM = RequestKind("arm", "reset", "arm/{}", "arm/ack", _PRESSED, limit=256, starts=True, by=BRIDGE)
#: What is pressed; `act_as_seen` of who carries it out takes it.
PRESSED = (STOP, PAUSE, RESUME, RESET, ARM)
#: Answers a question of the work; takes note of a message.
ANSWER = RequestKind("answer", "operate", "answer/{}", "answer/ack", _ANSWERED, expires=True)
ACKNOWLEDGE = RequestKind("acknowledge", "operate", "acknowledge/{}", "acknowledge/ack", _ACKNOWLEDGED)
#: Lowers people's speed limit; raises it, and needs its moment.
LOWER_SPEED = RequestKind("lower_speed", "operate", "lower_speed/{}", "speed/ack", _LIMITED, limit=256)
RAISE_SPEED = RequestKind("raise_speed", "approve", "raise_speed/{}", "speed/ack", _LIMITED, limit=256, starts=True)
PLAN_REQUEST = RequestKind(
    "plan_request", "operate", "plan_request/{}", "plan_request/ack", _PLANNED, pace=_PLANNING, expires=True
)
#: A motion in no name; the account of the topic below is shown to the reviewer.
NAMELESS_TRAJECTORY = RequestKind(
    "trajectory", "operate", "trajectory", "trajectory/ack", _CHECKED, pace=_PLANNING, limited_by="max_trajectory_bytes"
)
TRAJECTORY = replace(NAMELESS_TRAJECTORY, topic="trajectory/from/{}")
#: In the order of the broker's rules.
REQUESTS = (
    NAMELESS_REVIEW, REVIEW, OVERRIDE, *PRESSED, ANSWER, ACKNOWLEDGE, LOWER_SPEED, RAISE_SPEED, PLAN_REQUEST,
    NAMELESS_TRAJECTORY, TRAJECTORY,
)  # fmt: skip

#: Answers per second to what an account sends that cannot be read, or that stops what is stopped; all else is always answered.
ANSWERS = 10


def answer_limits() -> SenderLimits:
    """Return the limits of `ANSWERS`."""
    return SenderLimits(Pace(ANSWERS))
