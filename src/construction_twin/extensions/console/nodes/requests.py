"""Handlers of requests by MQTT: people's acts (`Acts`), motions and plans (`ConsoleRequests`), which move nothing.

What people do has a connection of its own, and each kind a queue and a thread, so that a stop, a pause and a rejection wait for
nothing else. The gateway reads the same stops itself: this one brakes along the path, and voids the plans that wait.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import genpy
import rospy
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PayloadError
from construction_twin.core.extensions import import_extension
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.nodes.endpoint import REPEATED, Connection, IncomingRequest, RequestQueue
from construction_twin.link.requests import (
    AnswerRequest,
    ButtonPress,
    GoalRequest,
    Joints,
    LowerSpeed,
    NamelessVerdict,
    Override,
    RaiseSpeed,
    StampedButtonPress,
    VerdictMessage,
    read_goal,
)
from construction_twin.mqtt import requests as kinds
from construction_twin.mqtt.requests import LOWER_SPEED, PLAN_REQUEST, PRESSED, RAISE_SPEED
from construction_twin.ros.messages.services import PLAN_SERVICES, Outcome, request_fields
from construction_twin.ros.transport.persistent_service import PersistentService, call, call_twice
from construction_twin.srv import PlanTrajectoryResponse, ReviewPlan

#: Requests of a kind that may wait while one is carried out; a tablet sends one at a time.
WAITING = 8
#: Motions and plan requests that may wait while one is carried out; a person sends one at a time.
WAITING_PLANS = 4
#: Of each verb that starts something, requests that are remembered: QoS 1 may deliver twice, and a recording can be replayed.
MEMORY = 1000
#: Between two attempts to connect to a service [s].
CONNECT_PERIOD = 1.0
#: Who offers the services, for sentences.
EXECUTOR, BRIDGE = "the executor", "the bridge"
_PROGRAMS = {kinds.EXECUTOR: EXECUTOR, kinds.BRIDGE: BRIDGE}


@dataclass(frozen=True)
class Services:
    """Services that carry it out; `pressed` by verb. What starts nothing has an open connection, and may be called twice."""

    approve: rospy.ServiceProxy
    reject: rospy.ServiceProxy
    pressed: Mapping[str, rospy.ServiceProxy]
    decide: rospy.ServiceProxy
    limit_speed: rospy.ServiceProxy


class Acts:
    """Handlers of people's acts, each kind with a queue and a thread.

    A rejection never waits behind an approval, whose record may wait for a disk, nor lowering the speed limit behind raising it.
    """

    def __init__(self, connection: Connection, services: Services):
        self._connection, self._services = connection, services
        names = ("reject", "answer", *(kind.name for kind in (LOWER_SPEED, RAISE_SPEED, *PRESSED)))
        self.queues = {name: RequestQueue(WAITING) for name in names}
        serve, verdicts = connection.serve, _ApprovalQueue(self.queues["reject"])
        self.queues["approve"] = verdicts
        serve(kinds.NAMELESS_REVIEW, NamelessVerdict, self._give_verdict, verdicts)
        serve(kinds.REVIEW, VerdictMessage, self._give_verdict, verdicts)
        serve(kinds.OVERRIDE, Override, self._give_verdict, verdicts)
        for kind in PRESSED:
            # each verb remembers its own: the thread of another one may not add to what is looked through
            act = partial(self._start, deque(maxlen=MEMORY)) if kind.starts else self._brake
            serve(kind, StampedButtonPress if kind.starts else ButtonPress, act, self.queues[kind.name])
        serve(kinds.ANSWER, AnswerRequest, self._give_answer, self.queues["answer"])
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

    def _give_verdict(self, verdict: VerdictMessage, request: IncomingRequest) -> Outcome:
        if not request.account and self._connection.proves_accounts:
            raise PayloadError(
                "sender",
                "a verdict on review names nobody: on a broker with accounts publish it on review/<account>; "
                "if the broker refuses that, its rules are old: run make_site again",
            )
        review = verdict.review_by(request.account)
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


class ConsoleRequests:
    """Handlers of motions and plan requests, which wait in `queue`.

    Args:
        has_work: Returns whether a building model is worked on.
        is_engaged: Returns whether only the way back can be planned.
        max_trajectory_bytes: Longest motion that is read; 0: neither motions nor plan requests are taken.
    """

    def __init__(
        self,
        joints: Joints,
        services: Mapping[str, rospy.ServiceProxy],
        plan_trajectory: rospy.ServiceProxy,
        connection: Connection,
        max_trajectory_bytes: int,
        has_work: Callable[[], bool],
        is_engaged: Callable[[], bool],
    ):
        self._joints, self._connection = joints, connection
        self._services, self._plan_trajectory = services, plan_trajectory
        self._has_work, self._is_engaged = has_work, is_engaged
        self.queue = RequestQueue(WAITING_PLANS, PLAN_REQUEST.pace)
        if max_trajectory_bytes:
            for kind in (kinds.NAMELESS_TRAJECTORY, kinds.TRAJECTORY):
                read = partial(import_extension("planners.remote_trajectory").parse_trajectory, joints=joints)
                connection.serve(replace(kind, limit=max_trajectory_bytes), read, self._check_motion, self.queue)
            connection.serve(PLAN_REQUEST, partial(read_goal, joints=joints), self._plan, self.queue)

    # -- motions

    def _check_motion(self, asked: Any, request: IncomingRequest) -> Outcome:
        """Check and time a motion, a `TrajectoryRequest` of the extension planners."""
        answer = call(
            self._plan_trajectory,
            "the planner",
            trajectory=trajectory_message(asked, self._joints),
            speed_scale=asked.speed_scale,
            acceleration_scale=asked.acceleration_scale,
            retime=True,
            source=source_of(asked.source, request.account, self._connection.proves_accounts),
        )
        outcome = Outcome.of(answer)
        return replace(outcome, fields={**outcome.fields, "notes": _timing_notes(asked, answer)})

    # -- plan requests

    def _plan(self, asked: GoalRequest, request: IncomingRequest) -> Outcome:
        kind = asked.kind
        if kind == "way_back" and self._has_work() and self._is_engaged():
            # the node `work` makes the scene right before it has the way back planned
            kind = "work_task"
        if kind == "work_task" and not self._has_work():
            return Outcome(
                False, Sentence("no building model is worked on here; start bringup with work_model and work_cell")
            )
        # a stop between the message and its turn voids the plan
        source = source_of("", request.account, self._connection.proves_accounts)
        fields = PLAN_SERVICES[kind].fields(asked, source=source, asked=str(request.arrived))
        return Outcome.of(call(self._services[kind], "its node", **fields))


def source_of(says: str, sender: str, proven: bool) -> str:
    """Return the source of a plan, for the reviewer: the account, and the sender's own name, `says`.

    Args:
        proven: The broker knows accounts, and by a site's rules only this one writes on that topic.
    """
    if not sender:
        known = "MQTT, sender not known"
    else:
        known = f"MQTT account {sender}" if proven else f"MQTT, on the topic of {sender}"
    return f"{known}, which says it is {says!r}" if says else known


def trajectory_message(asked: Any, joints: Joints) -> JointTrajectory:
    """Return the motion as `plan_trajectory` takes it; its header has no stamp, because a foreign clock proves nothing."""
    points = [
        JointTrajectoryPoint(
            positions=point.positions,
            velocities=point.velocities,
            accelerations=point.accelerations,
            time_from_start=genpy.Duration(*divmod(point.time_ns, NANOSECONDS)),
        )
        for point in asked.points
    ]
    return JointTrajectory(joint_names=list(joints.names), points=points)


def _timing_notes(asked: Any, answer: PlanTrajectoryResponse) -> list[str]:
    """Return a note on replaced times; none where they were kept."""
    if not answer.retimed:
        return []
    requested = (asked.points[-1].time_ns - asked.points[0].time_ns) / NANOSECONDS
    return [f"timed anew: {answer.duration:.3f} s instead of {requested:.3f} s, because {answer.retimed}"]
