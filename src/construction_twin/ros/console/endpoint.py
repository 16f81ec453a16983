"""A request by MQTT, from its message to its answer: one `Endpoint` for each kind, and the `Connection` by which it comes.

An endpoint is what differs: its kind (`mqtt.requests`), how a message is read (a pure function of `link` or `mqtt`), where it waits
(`request_queue`), and what carries it out. What all have in common is here. A message that cannot be read is refused and counted,
and answered at a pace. What was asked for is carried out first and answered next; counts and log lines come after that, hold up
nothing (`deferred_log`), and cannot fail it (`core.side_effects`).
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Generic, TypeVar

import rospy
from paho.mqtt.client import MQTTMessage

from construction_twin.core.errors import PayloadError, ServiceSilentError
from construction_twin.core.freshness import TOO_OLD
from construction_twin.core.rate_limit import SenderLimits
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.requests import Request as RequestModel
from construction_twin.link.requests import read, read_document
from construction_twin.mqtt.client import Broker, subscriptions
from construction_twin.mqtt.messages import Topics, account_of, identity_of
from construction_twin.mqtt.plain_client import PlainClient
from construction_twin.mqtt.requests import RequestKind, answer_limits
from construction_twin.ros.console.request_queue import Queue, Request
from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.shared.mqtt_connection import connect, report_of
from construction_twin.ros.shared.outcome import Outcome

#: Reason of a PayloadError: it came before, and was answered then.
REPEATED = "repeated"

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


class Connection:
    """A connection of the node to the broker, served by a thread of its own; endpoints hear and answer by it.

    Args:
        client: Not connected yet.
        refuse: Counts a refused input; takes reason and sentence.

    Attributes:
        side_effects: What ran beside a request, and failed: it fails neither the request nor the node, which may have a stop to
            carry out.
        log: What `write_log` writes.
    """

    def __init__(self, broker: Broker, client: PlainClient, refuse: Callable[[str, str], None]):
        self._broker, self._client, self.refuse = broker, client, refuse
        self._state = report_of(broker)
        self.side_effects, self.log = SideEffects(), DeferredLog()
        #: Takes a part's name, the part and its arguments; returns what the part returns, or None where it failed.
        self.tell = self.side_effects.run

    def connect(
        self,
        endpoints: Sequence[Endpoint],
        first: Callable[[], tuple[str, bytes, bool]],
        then: Callable[[], object],
        heard: Mapping[str, Callable[[MQTTMessage], None]] = MappingProxyType({}),
    ) -> None:
        """Connect, and whenever there is a connection subscribe and publish.

        Args:
            first: Returns topic, payload and retain flag of the first message: the broker's answer shows whether this account may
                write here.
            then: Publishes what else is retained.
            heard: What takes the messages of further topics.
        """
        topics = [*((topic, 1) for topic in heard), *((endpoint.topic, endpoint.qos) for endpoint in endpoints)]

        def on_connect(client, _userdata, _flags, reason_code, properties) -> None:
            if reason_code.is_failure:
                self._state.refused(reason_code)
                return
            self._state.connected(client, properties)
            topic, payload, retain = first()
            client.subscribe(subscriptions(client, topics))
            info = client.publish(topic, payload, qos=1, retain=retain)
            self._state.watch_publish(client, topic, info.mid)
            then()

        def on_disconnect(_client, _userdata, _flags, reason_code, _properties) -> None:
            self._state.lost(reason_code)

        on_message = {**heard, **{endpoint.topic: endpoint.on_message for endpoint in endpoints}}
        connect(self._client, self._broker, self._state, on_connect, on_disconnect, on_message)

    def disconnect(self) -> None:
        """Leave the broker, which publishes no last will then."""
        self._client.disconnect()
        self._client.loop_stop()

    @property
    def problem(self) -> str:
        """Why nothing comes or goes by it; empty while it is connected."""
        return "" if self._client.is_connected() else self._state.sentence or "connecting to the broker"

    @property
    def proves_accounts(self) -> bool:
        """Whether the broker knows accounts: by a site's rules each writes on its own topics only."""
        return self._broker.account is not None

    def publish(self, topic: str, payload: bytes, qos: int = 1, retain: bool = False) -> None:
        """Publish where there is a connection; what could be sent later only would be of the past."""
        if self._client.is_connected():
            self._client.publish(topic, payload, qos=qos, retain=retain)

    def answer(self, topic: str, payload: bytes, qos: int) -> None:
        """Publish an answer; one that is acknowledged is sent later where there is no connection now."""
        if qos or self._client.is_connected():
            self._client.publish(topic, payload, qos=qos)

    def write_log(self) -> None:
        """Write what is to be said, and what has failed; for a thread that may wait for a disk or a terminal."""
        self.tell("the log", self.log.flush)
        self.side_effects.write(rospy.logerr)


class RequestCounts:
    """What became of the requests of a kind, for `/diagnostics`, and how often an account is told that it sent what cannot be read.

    Used by several threads.

    Args:
        kind: Of the requests: "verdicts".
        done, not_done: What is counted of a request that was carried out, and of one that was not.
        clock: Returns a time from any origin [ns].
    """

    def __init__(
        self,
        kind: str,
        done: str = "taken",
        not_done: str = "not taken",
        clock: Callable[[], int] = time.monotonic_ns,
    ):
        self._kind = kind
        self._words = {True: done, False: not_done}
        self._clock = clock
        self._answers = answer_limits()
        self._lock = threading.Lock()
        self._unanswered = 0
        self._counts: Counter[str] = Counter()

    def is_due(self, account: str) -> bool:
        """Return whether a malformed message of an account is to be answered, and count it where it is not."""
        with self._lock:
            due = self._answers.take(account, self._clock())
            self._unanswered += not due
            return due

    def add(self, ok: bool, word: str = "") -> None:
        """Count a request that was carried out, or not; as `word` where there is one."""
        with self._lock:
            self._counts[word or self._words[ok]] += 1

    def report(self) -> dict[str, int]:
        """Return the counts; what never happened is left out."""
        with self._lock:
            found = {f"{self._kind} {word}": count for word, count in sorted(self._counts.items())}
            return found | ({f"{self._kind} malformed, not answered": self._unanswered} if self._unanswered else {})


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
        connection: Connection,
        describe: Callable[[Asked], str] | None = None,
        queue: Callable[[Asked], Queue] | None = None,
    ):
        self.topic, self.qos = topics.of(kind), kind.qos
        self._kind, self._topics, self._read, self._act = kind, topics, read, carry_out
        self._counts, self._connection, self._describe, self._queue = counts, connection, describe, queue
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
            self._connection.tell("the log", self._say, self._describe, asked, outcome.message)
        return answer

    def _send(self, incoming: Incoming, outcome: Outcome) -> bytes:
        answer = self._connection.tell("the answer", self._payload, incoming, outcome) or b""
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
            self._connection.tell("the answer", self._connection.answer, topic, answer, self.qos)

    def _count_refusal(self, reason: str, sentence: str) -> None:
        self._connection.tell("the count of refusals", self._connection.refuse, reason, sentence)

    def _say(self, describe: Callable[[Asked], str], asked: Asked, sentence: str) -> None:
        self._connection.log.add(rospy.loginfo, "%s: %s", describe(asked), sentence)
