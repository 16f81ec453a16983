"""What people do by MQTT: verdicts, `stop`, `pause`, `resume`, `reset`, `arm`, answers to the work's questions, speed limits.

They have a connection of their own, and each kind a queue and a thread, so that a stop, a pause and a rejection wait for nothing
else. The gateway reads the same stops itself: this one brakes along the path, and voids the plans that wait.
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
from construction_twin.extensions.console.nodes.endpoint import REPEATED, Connection, IncomingRequest, RequestQueue
from construction_twin.link.requests import (
    AnswerRequest,
    ButtonPress,
    LowerSpeed,
    NamelessVerdict,
    Override,
    RaiseSpeed,
    StampedButtonPress,
    Verdict,
)
from construction_twin.mqtt import requests
from construction_twin.mqtt.requests import (
    ANSWER,
    LOWER_SPEED,
    NAMELESS_REVIEW,
    OVERRIDE,
    PRESSED,
    RAISE_SPEED,
    REVIEW,
)
from construction_twin.ros.messages.services import Outcome, request_fields
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
    """Services that carry it out; `pressed` by verb. What starts nothing has an open connection, and may be called twice."""

    approve: rospy.ServiceProxy
    reject: rospy.ServiceProxy
    pressed: Mapping[str, rospy.ServiceProxy]
    decide: rospy.ServiceProxy
    limit_speed: rospy.ServiceProxy


class Acts:
    """Handlers of what people do, each kind with a queue and a thread.

    A rejection never waits behind an approval, whose record may wait for a disk, nor lowering the speed limit behind raising it.
    """

    def __init__(self, connection: Connection, services: Services):
        self._connection, self._services = connection, services
        names = ("reject", "answer", *(kind.name for kind in (LOWER_SPEED, RAISE_SPEED, *PRESSED)))
        self.queues = {name: RequestQueue(WAITING) for name in names}
        serve, verdicts = connection.serve, _ApprovalQueue(self.queues["reject"])
        self.queues["approve"] = verdicts
        serve(NAMELESS_REVIEW, NamelessVerdict, self._give_verdict, verdicts)
        serve(REVIEW, Verdict, self._give_verdict, verdicts)
        serve(OVERRIDE, Override, self._give_verdict, verdicts)
        for kind in PRESSED:
            # each verb remembers its own: the thread of another one may not add to what is looked through
            act = partial(self._start, deque(maxlen=MEMORY)) if kind.starts else self._brake
            serve(kind, StampedButtonPress if kind.starts else ButtonPress, act, self.queues[kind.name])
        serve(ANSWER, AnswerRequest, self._give_answer, self.queues["answer"])
        serve(LOWER_SPEED, LowerSpeed, self._set_speed, self.queues[LOWER_SPEED.name])
        serve(RAISE_SPEED, RaiseSpeed, self._set_speed, self.queues[RAISE_SPEED.name])

    def start(self) -> None:
        """Start the threads."""
        for name, queue in self.queues.items():
            threading.Thread(target=_run_queue, args=(queue,), name=name, daemon=True).start()

    def run_connections(self) -> None:
        """Keep the connections open until shutdown: a master that dies later delays no stop."""
        services = (*self._services.pressed.values(), self._services.reject, self._services.limit_speed)
        while not rospy.is_shutdown():
            for service in services:
                if isinstance(service, PersistentService):
                    service.open()
            time.sleep(CONNECT_PERIOD)

    def _give_verdict(self, verdict: Verdict, request: IncomingRequest) -> Outcome:
        if not request.account and self._connection.proves_accounts:
            raise PayloadError(
                "sender",
                "a verdict on review names nobody: on a broker with accounts publish it on review/<account>; "
                "if the broker refuses that, its rules are old: run make_site again",
            )
        review = verdict.by(request.account)
        fields = request_fields(ReviewPlan, replace(review, reason=review.recorded_reason))
        if review.approve:
            return Outcome.of(call(self._services.approve, EXECUTOR, **fields))
        # over the connection that is open, as a stop
        return Outcome.of(call_twice(self._services.reject, EXECUTOR, **fields))

    def _start(self, known: deque[tuple[str, str]], wanted: ButtonPress, request: IncomingRequest) -> Outcome:
        kind, names = request.kind, (request.account, wanted.id)
        if names in known:
            # it must not start again what was paused since
            raise PayloadError(REPEATED, f"{kind.name} {wanted.id!r} of account {request.account} came before")
        known.append(names)
        # it asks the master first; when a pause overtakes it, its moment is older than that pause, and it is void
        fields = {"act": kind.name, "person": request.account, "moment": wanted.moment}
        return Outcome.of(call(self._services.pressed[kind.name], _PROGRAMS[kind.by], **fields))

    def _brake(self, _wanted: ButtonPress, request: IncomingRequest) -> Outcome:
        kind, fields = request.kind, {"act": request.kind.name, "person": request.account}
        return Outcome.of(call_twice(self._services.pressed[kind.name], _PROGRAMS[kind.by], **fields))

    def _give_answer(self, asked: AnswerRequest, request: IncomingRequest) -> Outcome:
        fields = {"task": asked.task, "question": asked.question, "answer": asked.answer, "person": request.account}
        return Outcome.of(call(self._services.decide, "the work", decision="answer", reason="by MQTT", **fields))

    def _set_speed(self, asked: LowerSpeed | RaiseSpeed, request: IncomingRequest) -> Outcome:
        fields = {"limit": asked.limit, "person": request.account, "moment": asked.moment}
        return Outcome.of(call_twice(self._services.limit_speed, "pca_monitor", **fields))


class _ApprovalQueue(RequestQueue):
    """Where approvals wait; a rejection among the verdicts waits elsewhere."""

    def __init__(self, rejections: RequestQueue):
        super().__init__(WAITING)
        self._rejections = rejections

    def enqueue(self, request: IncomingRequest) -> None:
        """Put a verdict into its queue."""
        if request.asked.verdict == "rejected":
            self._rejections.enqueue(request)
        else:
            super().enqueue(request)


def _run_queue(queue: RequestQueue) -> None:
    while not rospy.is_shutdown():
        queue.run(0.2)
