"""What people do by MQTT: verdicts, `stop`, `pause`, `resume`, `reset`, `arm`, answers to the work's questions, speed limits.

They have a connection of their own, and each kind has a queue and a thread of its own, so that a stop, a pause and a rejection wait
for nothing else: no lock here is held by what shows, plans or computes. The gateway reads the same stops itself, so this one brakes
along the path what the gateway brakes within its limits, and voids the plans that wait.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import rospy

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import TOO_OLD, staleness
from construction_twin.core.sentences import Sentence
from construction_twin.link.requests import (
    AnswerRequest,
    LowerSpeed,
    NamelessVerdict,
    Override,
    RaiseSpeed,
    ReviewRequest,
    Verdict,
)
from construction_twin.mqtt import requests
from construction_twin.mqtt.interventions import Intervention, parse_intervention
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import (
    ANSWER,
    LOWER_SPEED,
    NAMELESS_REVIEW,
    OVERRIDE,
    PRESSED,
    RAISE_SPEED,
    REVIEW,
    RequestKind,
)
from construction_twin.ros.console.endpoint import REPEATED, Connection, Endpoint, Incoming, RequestCounts
from construction_twin.ros.console.request_queue import RequestQueue
from construction_twin.ros.messages.plan_services import request_fields
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.transport.persistent_service import PersistentService, call, call_twice
from construction_twin.srv import ReviewPlan

#: Requests of a kind that may wait while one is carried out; a tablet sends one at a time.
WAITING = 8
#: Of each verb that starts something, requests that are remembered: QoS 1 may deliver twice, and a recording can be replayed.
MEMORY = 1000
#: Between two attempts to connect to a service [s].
CONNECT_PERIOD = 1.0
#: Who offers the services, for sentences.
EXECUTOR, BRIDGE = "the executor", "the bridge"
_PROGRAMS = {requests.EXECUTOR: EXECUTOR, requests.BRIDGE: BRIDGE}


@dataclass(frozen=True)
class Services:
    """Who carries it out.

    Attributes:
        approve, reject: The executor's `review_plan`; a rejection may come twice, and asks no master.
        pressed: By verb. One that starts something is an `ActAsSeen`; others may be called twice.
        decide: The work's, which takes what a person decides.
        limit_speed: Takes a person's speed limit, and may be called twice.
    """

    approve: rospy.ServiceProxy
    reject: rospy.ServiceProxy
    pressed: Mapping[str, rospy.ServiceProxy]
    decide: rospy.ServiceProxy
    limit_speed: rospy.ServiceProxy


class Acts:
    """The endpoints of what people do.

    Attributes:
        endpoints: What takes messages of each kind.
        queues: Where requests wait, by name; a thread for each of them. A rejection never waits behind an approval, whose record
            may wait for a disk, nor what lowers the speed limit behind what raises it.
    """

    def __init__(self, topics: Topics, connection: Connection, services: Services):
        self._topics, self._connection, self._services = topics, connection, services
        self._verdicts, self._pressed = RequestCounts("verdicts"), RequestCounts("interventions")
        self._answers, self._speeds = RequestCounts("answers"), RequestCounts("speed limits")
        names = ("approve", "reject", "answer", *(kind.name for kind in (LOWER_SPEED, RAISE_SPEED, *PRESSED)))
        self.queues = {name: RequestQueue(WAITING) for name in names}
        self.endpoints: tuple[Endpoint, ...] = (
            *map(self._verdict_endpoint, (NAMELESS_REVIEW, REVIEW, OVERRIDE)),
            *map(self._pressed_endpoint, PRESSED),
            Endpoint(
                ANSWER, topics, _read_answer, self._give_answer, self._answers, connection,
                lambda asked: f"answer to a question of the work by MQTT account {asked[1]}",
                lambda _: self.queues["answer"],
            ),
            *map(self._speed_endpoint, (LOWER_SPEED, RAISE_SPEED)),
        )  # fmt: skip

    def _verdict_endpoint(self, kind: RequestKind) -> Endpoint[ReviewRequest]:
        # where the broker knows accounts, one in no name is refused where it arrives
        nameless = kind is NAMELESS_REVIEW and self._connection.proves_accounts
        models: dict[RequestKind, type[Verdict]] = {REVIEW: Verdict, OVERRIDE: Override}
        model = models.get(kind, NamelessVerdict)
        return Endpoint(
            kind, self._topics, lambda incoming: incoming.read(kind, model).by(incoming.account),
            _refuse_nameless if nameless else self._give_verdict, self._verdicts, self._connection, _describe_verdict,
            None if nameless else lambda review: self.queues["approve" if review.approve else "reject"],
        )  # fmt: skip

    def _pressed_endpoint(self, kind: RequestKind) -> Endpoint[Intervention]:
        # each verb remembers its own: the thread of another one may not add to what is looked through
        act = partial(self._start, kind, deque(maxlen=MEMORY)) if kind.starts else partial(self._brake, kind)
        return Endpoint(
            kind, self._topics, partial(_read_pressed, kind.name), act, self._pressed, self._connection,
            lambda wanted: f"{wanted.verb} by MQTT account {wanted.account}", lambda _: self.queues[kind.name],
        )  # fmt: skip

    def _speed_endpoint(self, kind: RequestKind) -> Endpoint[tuple[LowerSpeed, str]]:
        return Endpoint(
            kind, self._topics, partial(_read_speed, kind), self._set_speed, self._speeds, self._connection,
            lambda asked: f"speed limit {asked[0].limit:g} by MQTT account {asked[1]}", lambda _: self.queues[kind.name],
        )  # fmt: skip

    def start(self) -> None:
        """Begin to carry out what waits, each kind in a thread of its own."""
        for name, queue in self.queues.items():
            threading.Thread(target=_run_queue, args=(queue,), name=name, daemon=True).start()

    def run_connections(self) -> None:
        """Connect to what may be called twice until shutdown: a master that dies later keeps no stop back."""
        services = (*self._services.pressed.values(), self._services.reject, self._services.limit_speed)
        while not rospy.is_shutdown():
            for service in services:
                if isinstance(service, PersistentService):
                    service.open()
            time.sleep(CONNECT_PERIOD)

    def report(self) -> dict[str, int]:
        """Return what was done so far, for `/diagnostics`."""
        counts = (self._verdicts, self._pressed, self._answers, self._speeds)
        return {name: count for each in counts for name, count in each.report().items()}

    def _give_verdict(self, review: ReviewRequest) -> Outcome:
        fields = request_fields(ReviewPlan, replace(review, reason=review.recorded_reason))
        if review.approve:
            return Outcome.of(call(self._services.approve, EXECUTOR, **fields))
        # over the connection that is open, as a stop
        return Outcome.of(call_twice(self._services.reject, EXECUTOR, **fields))

    def _start(self, kind: RequestKind, known: deque[Intervention], wanted: Intervention) -> Outcome:
        if wanted in known:
            # it must not start again what was paused since
            names = {"verb": wanted.verb, "id": repr(wanted.id), "account": wanted.account}
            raise PayloadError(REPEATED, Sentence("link.payload.again", **names))
        known.append(wanted)
        # it asks the master first; when a pause overtakes it, its moment is older than that pause, and it is void
        fields = {"act": kind.name, "person": wanted.account, "moment": wanted.moment}
        return Outcome.of(call(self._services.pressed[kind.name], _PROGRAMS[kind.by], **fields))

    def _brake(self, kind: RequestKind, _wanted: Intervention) -> Outcome:
        return Outcome.of(call_twice(self._services.pressed[kind.name], _PROGRAMS[kind.by]))

    def _give_answer(self, asked: tuple[AnswerRequest, str]) -> Outcome:
        answer, account = asked
        if problem := staleness(answer.moment, present()):
            raise PayloadError(TOO_OLD, Sentence("link.void.answer", problem=problem))
        fields = {"task": answer.task, "question": answer.question, "answer": answer.answer, "person": account}
        return Outcome.of(call(self._services.decide, "the work", decision="answer", reason="by MQTT", **fields))

    def _set_speed(self, asked: tuple[LowerSpeed, str]) -> Outcome:
        request, account = asked
        fields = {"limit": request.limit, "person": account, "moment": request.moment}
        return Outcome.of(call_twice(self._services.limit_speed, "pca_monitor", **fields))


def _run_queue(queue: RequestQueue) -> None:
    while not rospy.is_shutdown():
        queue.run(0.2)


def _refuse_nameless(_review: ReviewRequest) -> Outcome:
    raise PayloadError("sender", Sentence("link.payload.nameless"))


def _describe_verdict(review: ReviewRequest) -> str:
    spite = " in spite of its rehearsal" if review.override_rehearsal else ""
    return f"{review.verdict} of plan {review.plan_id} by {review.reviewer}{spite}"


def _read_pressed(verb: str, incoming: Incoming) -> Intervention:
    return parse_intervention(verb, incoming.account, incoming.payload, incoming.retained)


def _read_answer(incoming: Incoming) -> tuple[AnswerRequest, str]:
    return incoming.read(ANSWER, AnswerRequest), incoming.account


def _read_speed(kind: RequestKind, incoming: Incoming) -> tuple[LowerSpeed, str]:
    return incoming.read(kind, RaiseSpeed if kind.starts else LowerSpeed), incoming.account
