"""Requests by MQTT, from the message to the answer: one `Endpoint` for each kind, and the `Connection` by which they come.

A kind is a row (`mqtt.requests`), a model of its message (`link.requests`) and a handler. What was asked for is carried out first
and answered next; counts and log lines come after that, hold up nothing, and cannot fail it (`core.side_effects`).
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, TypeAlias

import rospy
from paho.mqtt.client import MQTTMessage

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import TOO_OLD, present_moment, staleness
from construction_twin.core.rate_limit import Pace, SenderLimits
from construction_twin.core.sentences import Sentence
from construction_twin.core.side_effects import SideEffects
from construction_twin.link.requests import Request, read, read_document
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.fast_client import FastClient
from construction_twin.mqtt.messages import MAX_IDENTITY_BYTES, Topics, account_of, identity_of
from construction_twin.mqtt.requests import RequestKind, answer_limits
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.shared.diagnostics import DeferredLog
from construction_twin.ros.shared.mqtt_connection import connect, connection_log
from construction_twin.ros.transport.persistent_service import ServiceSilentError

Reader: TypeAlias = "type[Request] | Callable[[dict[str, Any]], Any]"
Handler: TypeAlias = "Callable[[Any, IncomingRequest], Outcome]"
#: Reason of a PayloadError: it came before, and was answered then.
REPEATED = "repeated"


class Connection:
    """A connection of the node to the broker, with a thread of its own, for requests and answers.

    `refuse` counts a refused input, by reason and sentence. What fails of `side_effects` fails neither the request nor the node,
    which may have a stop to carry out.
    """

    def __init__(self, broker: Broker, client: FastClient, topics: Topics, refuse: Callable[[str, str], None]):
        self._broker, self._client, self.topics, self.refuse = broker, client, topics, refuse
        self._state = connection_log(broker)
        self.endpoints: list[Endpoint] = []
        self.counts: Counter[str] = Counter()
        self._counting = threading.Lock()
        self.side_effects, self.log = SideEffects(), DeferredLog()
        self.run_side_effect = self.side_effects.run

    def serve(self, kind: RequestKind, read: Reader, act: Handler, queue: RequestQueue | None = None) -> None:
        """Serve a kind of request, as of `Endpoint`."""
        self.endpoints.append(Endpoint(self, kind, read, act, queue))

    def connect(
        self,
        first: Callable[[], tuple[str, bytes, bool]],
        then: Callable[[], object],
        topic_handlers: Mapping[str, Callable[[MQTTMessage], None]] = MappingProxyType({}),
    ) -> None:
        """Connect, as of `mqtt_connection`; `topic_handlers`: what takes the messages of further topics."""
        on_message = {**topic_handlers, **{endpoint.topic: endpoint.on_message for endpoint in self.endpoints}}
        topics = [(topic, 1) for topic in on_message]
        connect(self._client, self._broker, self._state, topics, first, on_message, then)

    def disconnect(self) -> None:
        """Leave the broker, which publishes no last will then."""
        self._client.disconnect()
        self._client.loop_stop()

    @property
    def fault(self) -> str:
        """Why there is no connection; empty while it is connected."""
        return "" if self._client.is_connected() else self._state.sentence or "connecting to the broker"

    @property
    def proves_accounts(self) -> bool:
        """Whether the broker knows accounts: by a site's rules each writes on its own topics only."""
        return self._broker.account is not None

    def publish(self, topic: str, payload: bytes, qos: int = 1, retain: bool = False) -> None:
        """Publish at once, or drop."""
        if self._client.is_connected():
            self._client.publish(topic, payload, qos=qos, retain=retain)

    def answer(self, topic: str, payload: bytes) -> None:
        """Publish an answer, later where there is no connection now."""
        self._client.publish(topic, payload, qos=1)

    def count(self, kind: RequestKind, outcome: str) -> None:
        """Count a request by its outcome."""
        with self._counting:
            self.counts[f"{kind.name} {outcome}"] += 1

    def write_log(self) -> None:
        """Flush the log queue; for a thread that may wait for a disk or a terminal."""
        self.run_side_effect("the log", self.log.flush)
        self.side_effects.write(rospy.logerr)

    def status_fields(self) -> dict[str, object]:
        """Return the counters for `/diagnostics`."""
        with self._counting:
            return dict(sorted(self.counts.items())) | self.side_effects.status_fields()


@dataclass
class Endpoint:
    """One kind of request: its reading, its handler and its queue; without a queue it is carried out where it arrives."""

    connection: Connection
    kind: RequestKind
    read: Reader
    act: Handler
    queue: RequestQueue | None
    malformed: SenderLimits = field(default_factory=answer_limits)

    @property
    def topic(self) -> str:
        """Topic of the requests."""
        return self.connection.topics.of(self.kind)

    def on_message(self, message: MQTTMessage) -> None:
        """Read and queue a message (connection's thread)."""
        incoming = IncomingRequest(self, "", bytes(message.payload), message.retain)
        if self.topic.endswith("/+"):
            try:
                incoming.account = account_of(message.topic)
            except PayloadError as error:
                incoming.refuse_unread(error)
                return
            if not incoming.account:
                # an answer, of this node or of another one
                return
        if self.queue is not None and not self.queue.admits(incoming):
            return
        try:
            incoming.read()
        except PayloadError as error:
            incoming.refuse_unread(error)
            return
        (IncomingRequest.carry_out if self.queue is None else self.queue.enqueue)(incoming)


class IncomingRequest:
    """One request, from its message to its answer. `account` "": none in the topic."""

    def __init__(self, endpoint: Endpoint, account: str, payload: bytes, retained: bool):
        self._endpoint, self._connection, self.kind = endpoint, endpoint.connection, endpoint.kind
        self.account, self._payload, self._retained, self.arrived = account, payload, retained, present_moment()
        self._document: dict[str, Any] | None = None
        self.asked: Any = None

    @cached_property
    def identity(self) -> dict[str, str]:
        """Texts that the answer repeats, with the account."""
        named = dict.fromkeys(("account", "sender", "reviewer"), self.account) if self.account else {}
        return identity_of(self._payload, self._document, max(MAX_IDENTITY_BYTES, self.kind.limit)) | named

    def read(self) -> None:
        """Parse the payload into `asked`."""
        kind, how = self.kind, self._endpoint.read
        self._document = read_document(self._payload, self._retained, kind.name, kind.limit, kind.limited_by)
        self.asked = read(how, self._document, kind.name) if isinstance(how, type) else how(self._document)

    def carry_out(self) -> None:
        """Carry out the request, and answer."""
        refused = None
        try:
            if self.kind.expires and (problem := staleness(self.asked.moment, present_moment())):
                raise PayloadError(TOO_OLD, Sentence("the request is {problem}", problem=problem))
            outcome = self._endpoint.act(self.asked, self)
        except ServiceSilentError as error:
            outcome = Outcome(False, str(error))
        except PayloadError as error:
            refused, outcome = error, Outcome(False, str(error), error.reason == TOO_OLD)
        if refused is None or refused.reason != REPEATED:
            self._answer(outcome)
            self.count("taken" if outcome.success else "not taken")
        if refused is not None:
            self.count_refusal(refused.reason, str(refused))
        self._connection.run_side_effect("the log", self._log, outcome.message)

    def refuse_unread(self, error: PayloadError) -> None:
        """Refuse an unread request: answer at a limited pace, and count."""
        if self._endpoint.malformed.admit(self.account, _now_ns()):
            self._answer(Outcome(False, str(error), error.reason == TOO_OLD))
        else:
            self.count("not answered")
        self.count_refusal(error.reason, str(error))

    def refuse(self, reason: str, sentence: str) -> None:
        """Refuse a request: answer and count."""
        self._answer(Outcome(False, sentence))
        self.count_refusal(reason, f"{self.kind.name}: {sentence}")

    def count(self, outcome: str) -> None:
        """Count it by its outcome."""
        self._connection.count(self.kind, outcome)

    def count_refusal(self, reason: str, sentence: str) -> None:
        """Count that it was refused."""
        self._connection.run_side_effect("the count of refusals", self._connection.refuse, reason, sentence)

    def _answer(self, outcome: Outcome) -> None:
        answer = self._connection.run_side_effect("the answer", self._payload_of, outcome)
        if answer:
            topic = self._connection.topics.ack_of(self.kind)
            self._connection.run_side_effect("the answer", self._connection.answer, topic, answer)

    def _payload_of(self, outcome: Outcome) -> bytes:
        done = {"ok": outcome.success, "reason": outcome.message, "expired": outcome.expired, "by": self.kind.by}
        return self.kind.payload(**{**self.identity, **done, **outcome.fields})

    def _log(self, sentence: str) -> None:
        known = (pair for pair in self.identity.items() if pair[0] == "account" or pair[1] not in ("", self.account))
        words = ", ".join(map(" ".join, known))
        self._connection.log.add(rospy.loginfo, "%s by MQTT (%s): %s", self.kind.name, words, sentence)


class RequestQueue:
    """Requests that are carried out one after the other, in another thread than the connection's, each answered.

    Args:
        most: That may wait.
        pace: How often each sender may ask; None: as often as it likes.
    """

    def __init__(self, most: int, pace: Pace | None = None):
        self._pace, self._limits = pace, None if pace is None else SenderLimits(pace)
        self._most = most
        self._waiting: queue.Queue[IncomingRequest] = queue.Queue(most)

    @property
    def waiting(self) -> int:
        """Number of waiting requests."""
        return self._waiting.qsize()

    def admits(self, request: IncomingRequest) -> bool:
        """Return whether a request is worth reading; what comes too soon is answered."""
        if self._limits is None or not (wait := self._limits.waiting_time(request.account, _now_ns())):
            return True
        assert self._pace is not None  # there are limits
        # rounded up: who tries again then is not too early
        after = math.ceil(wait / 1e8) / 10.0
        motions = "one motion" if self._pace.most == 1 else f"no more than {self._pace.most}"
        sentence = f"{motions} in {self._pace.seconds:g} s is taken from a sender; try again in {after:.1f} s"
        request.refuse_unread(PayloadError("busy", sentence))
        return False

    def enqueue(self, request: IncomingRequest) -> None:
        """Queue a request, or answer why not."""
        now = _now_ns()
        try:
            self._waiting.put_nowait(request)
        except queue.Full:
            request.refuse("busy", f"{self._most} requests are waiting already; try again")
            return
        if self._limits is not None:
            self._limits.admit(request.account, now)

    def run(self, patience: float = 0.0) -> None:
        """Carry out all waiting requests; wait `patience` [s] for the first one."""
        try:
            (self._waiting.get(timeout=patience) if patience else self._waiting.get_nowait()).carry_out()
            while True:
                self._waiting.get_nowait().carry_out()
        except queue.Empty:
            return


def _now_ns() -> int:
    return round(time.monotonic() * 1e9)
