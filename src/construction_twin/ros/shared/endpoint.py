"""A request by MQTT, from its message to its answer: one `Endpoint` for each kind.

An endpoint is what differs: its kind (`mqtt.requests`), how a message is read (a pure function of `link` or `mqtt`), where it waits
(`request_queue`), and what carries it out. What all have in common is here. A message that cannot be read is refused and counted,
and answered at a pace. What was asked for is carried out first and answered next; counts and log lines come after that, and hold up
nothing (`deferred_log`). Of a safety act none of them can fail it either (`core.side_effects`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

import rospy
from paho.mqtt.client import MQTTMessage

from construction_twin.core.errors import PayloadError, ServiceSilentError
from construction_twin.core.rate_limit import SenderLimits
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.requests import Request as RequestModel
from construction_twin.link.requests import read, read_document
from construction_twin.mqtt.messages import Topics, account_of, identity_of
from construction_twin.mqtt.requests import RequestKind
from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.request_counts import RequestCounts
from construction_twin.ros.shared.request_queue import Queue, Request

#: Reasons of a PayloadError: what its screen had shown is too old; it came before, and was answered then.
TOO_OLD, REPEATED = "too_old", "repeated"

Asked = TypeVar("Asked")
Model = TypeVar("Model", bound=RequestModel)


@dataclass
class Incoming:
    """A message, and what an answer repeats of it even when it is refused.

    Attributes:
        account: Of the topic; "" where it names none.
        retained: The message's retain flag.
        document: What `read_document` has read.
    """

    account: str
    payload: bytes
    retained: bool
    document: dict[str, Any] | None = None

    def read(self, kind: RequestKind, model: type[Model]) -> Model:
        """Return what is asked for; PayloadError as of `read_document`, and where it is not as its model says."""
        return read(model, self.read_document(kind.name, kind.limit), kind.name)

    def read_document(self, what: str, limit: int, parameter: str = "") -> dict[str, Any]:
        """Return the JSON object of a request; PayloadError, and arguments, as of `link.requests`."""
        self.document = read_document(self.payload, self.retained, what, limit, parameter)
        return self.document

    @property
    def identity(self) -> dict[str, str]:
        """What an answer repeats of the message, with its account."""
        named = dict.fromkeys(("account", "sender", "reviewer"), self.account) if self.account else {}
        return identity_of(self.payload, self.document) | named


class Outlets:
    """Where the endpoints of a node say what they have to say.

    Args:
        publish: Takes topic, payload and QoS.
        refuse: Counts a refused input; takes reason and sentence.

        safety: Some of the requests are safety acts: then what tells of a request cannot fail it, nor end the node. Elsewhere what
            nobody foresaw ends the node, as everywhere (docs/architecture.md).

    Attributes:
        side_effects: What ran beside a safety act, and failed.
        log: What `write_log` writes.
    """

    def __init__(
        self, publish: Callable[[str, bytes, int], object], refuse: Callable[[str, str], None], safety: bool = False
    ):
        self.publish, self.refuse = publish, refuse
        self.side_effects = SideEffects()
        self.log = DeferredLog()
        #: Takes a part's name, the part and its arguments; returns what the part returns, or None where it failed beside an act.
        self.tell: Callable[..., Any] = self.side_effects.run if safety else _just_do

    def write_log(self) -> None:
        """Write what is to be said, and what has failed; for a thread that may wait for a disk or a terminal."""
        self.tell("the log", self.log.flush)
        self.side_effects.write(rospy.logerr)


def _just_do(_what: str, part: Callable[..., Any], *arguments: object) -> Any:
    return part(*arguments)


class Endpoint(Generic[Asked]):
    """One kind of request by MQTT.

    Args:
        read: Returns what is asked for, or raises PayloadError.
        carry_out: Does it. May raise PayloadError, which is refused and counted then, and ServiceSilentError.
        describe: Returns in a few words who asks for what, for the log; None: there is no line of it.
        queue: Takes what is asked for; returns where that waits, and is kept to its kind's pace. None: it is carried out where it
            arrives, and waits for nothing.
    """

    def __init__(
        self,
        kind: RequestKind,
        topics: Topics,
        read: Callable[[Incoming], Asked],
        carry_out: Callable[[Asked], Outcome],
        counts: RequestCounts,
        outlets: Outlets,
        describe: Callable[[Asked], str] | None = None,
        queue: Callable[[Asked], Queue] | None = None,
    ):
        self.topic, self.qos = topics.of(kind), kind.qos
        self._kind, self._topics, self._read, self._act = kind, topics, read, carry_out
        self._counts, self._outlets, self._describe, self._queue = counts, outlets, describe, queue
        # a newer one follows: this one is not worth reading, and answering it would be as much again
        self._unread = SenderLimits(kind.pace) if kind.pace is not None and not kind.qos else None

    def on_message(self, message: MQTTMessage) -> None:
        """Take a message from the connection's thread."""
        incoming = Incoming("", bytes(message.payload), message.retain)
        if self.topic.endswith("/+"):
            try:
                incoming.account = account_of(message.topic)
            except PayloadError as error:
                self._refuse_unread(incoming, error)
                return
            if not incoming.account:
                # an answer, of this node or of another one
                return
        self.take(incoming)

    def take(self, incoming: Incoming) -> None:
        """Take a message whose account is known."""
        account = incoming.account
        if self._unread is not None and not self._unread.take(account, round(time.monotonic() * NANOSECONDS)):
            self._count_refusal(
                f"{self._kind.name}_rate", f"{self._kind.name} too often from {account}: {self._kind.pace}"
            )
            return
        try:
            asked = self._read(incoming)
        except PayloadError as error:
            self._refuse_unread(incoming, error)
            return
        if self._queue is None:
            self._act_and_answer(incoming, asked)
            return
        self._queue(asked).take(
            Request(
                self._kind.name,
                incoming.account,
                incoming.payload,
                partial(self._act_and_answer, incoming, asked),
                partial(self._refuse, incoming),
                partial(self._repeat, incoming),
                self._kind.pace if self._unread is None else None,
            )
        )

    def _refuse_unread(self, incoming: Incoming, error: PayloadError) -> None:
        if self._counts.is_due(incoming.account):
            self._send(incoming, Outcome(False, str(error), error.reason == TOO_OLD))
        self._count_refusal(error.reason, str(error))

    def _refuse(self, incoming: Incoming, reason: str, sentence: str) -> None:
        self._send(incoming, Outcome(False, sentence))
        self._count_refusal(reason, f"{self._kind.name}: {sentence}")

    def _repeat(self, incoming: Incoming, answer: bytes) -> None:
        if answer:
            self._publish(incoming, answer)
        self._count_refusal(
            REPEATED,
            f"{self._kind.name} {incoming.identity.get('id', '')!r} came again soon after its answer, or before it",
        )

    def _act_and_answer(self, incoming: Incoming, asked: Asked) -> bytes:
        """Do it, and answer; return the answer, empty where there is none."""
        refused = None
        try:
            outcome = self._act(asked)
        except ServiceSilentError as error:
            outcome = Outcome(False, str(error))
        except PayloadError as error:
            refused, outcome = error, Outcome(False, str(error), error.reason == TOO_OLD)
        answer = b""
        if refused is None or refused.reason != REPEATED:
            answer = self._send(incoming, outcome)
            self._counts.add(outcome.success, outcome.counted)
        if refused is not None:
            self._count_refusal(refused.reason, str(refused))
        if self._describe is not None:
            self._outlets.tell("the log", self._say, self._describe, asked, outcome.message)
        return answer

    def _send(self, incoming: Incoming, outcome: Outcome) -> bytes:
        answer = self._outlets.tell("the answer", self._payload, incoming, outcome) or b""
        if answer:
            self._publish(incoming, answer)
        return answer

    def _payload(self, incoming: Incoming, outcome: Outcome) -> bytes:
        said = dict.fromkeys(("reason", "sentence"), outcome.message)
        done = {"ok": outcome.success, "expired": outcome.expired, "by": self._kind.by}
        return self._kind.payload(**{**incoming.identity, **said, **done, **outcome.fields})

    def _publish(self, incoming: Incoming, answer: bytes) -> None:
        if self._kind.is_answered_to(incoming.account):
            topic = self._topics.ack_of(self._kind, incoming.account)
            self._outlets.tell("the answer", self._outlets.publish, topic, answer, self.qos)

    def _count_refusal(self, reason: str, sentence: str) -> None:
        self._outlets.tell("the count of refusals", self._outlets.refuse, reason, sentence)

    def _say(self, describe: Callable[[Asked], str], asked: Asked, sentence: str) -> None:
        self._outlets.log.add(rospy.loginfo, "%s: %s", describe(asked), sentence)
