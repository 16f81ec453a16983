"""mqtt_review: the plan under review on MQTT, what people do: verdicts, `stop`, `pause`, `resume`, `reset`, `arm`, answers to the
work's questions, and speed limits.

A node of its own: the bridge has 4 ms.
"""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import rospy
from std_srvs.srv import Trigger

from construction_twin.core.errors import ConstructionTwinError, PayloadError
from construction_twin.core.freshness import staleness
from construction_twin.core.records import SPACED, dumped
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.remote_review import (
    ClearanceView,
    PlanBoard,
    PlanView,
    SegmentView,
    SwitchView,
    UseView,
)
from construction_twin.link.requests import (
    AnswerRequest,
    LowerSpeed,
    NamelessVerdict,
    Override,
    RaiseSpeed,
    ReviewRequest,
    Verdict,
)
from construction_twin.mqtt.client import Broker, make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.plain_client import PlainClient
from construction_twin.mqtt.requests import (
    ANSWER,
    BRIDGE,
    LOWER_SPEED,
    NAMELESS_REVIEW,
    OVERRIDE,
    PRESSED,
    RAISE_SPEED,
    REVIEW,
    RequestKind,
)
from construction_twin.msg import Link, Plan, PlanCaller, Rehearsal, Review
from construction_twin.physics.report import RehearsalReport, is_whole
from construction_twin.robot.description import RobotModel
from construction_twin.robot.segments import segments_content
from construction_twin.robot.tool import tool_hash
from construction_twin.ros.messages.convert import plan_from_msg
from construction_twin.ros.messages.plan_services import request_fields
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.endpoint import TOO_OLD, Endpoint, Incoming, Outlets
from construction_twin.ros.shared.mqtt_connection import MqttSettings, broker_of, connect, report_of
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.ports import Interface, Ports, Subscription
from construction_twin.ros.shared.remote_interventions import EXECUTOR, remote_interventions
from construction_twin.ros.shared.request_counts import RequestCounts
from construction_twin.ros.shared.request_queue import RequestQueue
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.transport.persistent_service import PersistentService, call, call_twice
from construction_twin.srv import LimitSpeed, ResumeFromScreen, ReviewFromScreen, SessionFromScreen, WorkDecide

#: Verdicts that may wait while one is carried out; a tablet sends one at a time.
WAITING = 8
#: Period at which the node compares what the broker holds with what it should hold [s].
CHECK_PERIOD = 1.0
#: Between two writings of the log [s].
LOG_PERIOD = 0.1
#: The tool path of a plan on MQTT is thinned to at most so many points; 200 are about 6 kB.
PATH_POINTS = 200


class Settings(MqttSettings):
    """Private parameters; given in launch/link.launch.

    Attributes:
        tool: Tool file; empty: no tool.
    """

    tool: str = ""


class MqttReview:
    """ROS and MQTT around a PlanBoard; `start` gives it topics and a connection.

    `_lock` guards the board and the counters: ROS serves every topic from a thread of its own.

    Args:
        robot: Name in the MQTT topics.
        client: Not connected yet.
        give_approval: The executor's `review_from_screen`.
        interventions: The services of what is pressed, by its verb.
        diagnostics: Counts what is refused.
        give_rejection: The same as `give_approval`, for rejections, which may come twice and ask no master.
        connections: What is to be connected before it is called.
        decide: The service of the work that takes what a person decides; None: there is none.
        limit_speed: The service that takes a person's speed limit, which may come twice; None: there is none.
        tool: Hash of the tool file, with which a rehearsal counts; empty: no tool.

    Attributes:
        endpoints: What takes verdicts, what is pressed, answers, and speed limits.
        approvals, rejections: Where verdicts wait: a rejection not behind an approval, whose record may wait for a disk.
    """

    def __init__(
        self,
        settings: Settings,
        robot: str,
        broker: Broker,
        client: PlainClient,
        give_approval: rospy.ServiceProxy,
        interventions: Mapping[str, rospy.ServiceProxy],
        diagnostics: NodeDiagnostics,
        give_rejection: rospy.ServiceProxy | None = None,
        connections: Sequence[PersistentService] = (),
        decide: rospy.ServiceProxy | None = None,
        limit_speed: rospy.ServiceProxy | None = None,
        tool: str = "",
    ):
        self._settings, self._tool = settings, tool
        self._board = PlanBoard()
        self._view: PlanView | None = None
        self._rehearsals = PlanBoard()
        self._gone = ""
        self._lock = threading.Lock()
        self._session: str | None = None
        self._seen = b""
        self._checked_at = 0.0
        self._topics = topics = Topics(settings.prefix, robot)
        self._give_approval, self._give_rejection = give_approval, give_rejection or give_approval
        self._connections, self._decide, self._limit_speed = connections, decide, limit_speed
        self._broker = broker
        self._client = client
        self._verdicts, self._pressed = RequestCounts("verdicts"), RequestCounts("interventions")
        self._speeds = RequestCounts("speed limits")
        self.outlets = Outlets(
            self._publish_answer, lambda reason, sentence: self.refuse(reason, sentence), safety=True
        )
        self._connection = report_of(broker)
        self.approvals, self.rejections, self._answers = (RequestQueue(WAITING) for _ in range(3))
        # what raises the limit never holds up what lowers it
        self._raises, self._limits = RequestQueue(WAITING), RequestQueue(WAITING)
        self.interventions = remote_interventions(topics, interventions, self._pressed, self.outlets)
        self.endpoints: tuple[Endpoint, ...] = (
            self._verdict_endpoint(NAMELESS_REVIEW),
            self._verdict_endpoint(REVIEW),
            self._verdict_endpoint(OVERRIDE),
            *self.interventions.endpoints,
            Endpoint(
                ANSWER, topics, _read_answer, self._give_answer, RequestCounts("answers"), self.outlets,
                lambda asked: f"answer to a question of the work by MQTT account {asked[1]}", lambda _: self._answers,
            ),
            self._speed_endpoint(LOWER_SPEED, self._limits),
            self._speed_endpoint(RAISE_SPEED, self._raises),
        )  # fmt: skip
        self._diagnostics = diagnostics

    def _verdict_endpoint(self, kind: RequestKind) -> Endpoint[ReviewRequest]:
        # where the broker knows accounts, one in no name is refused where it arrives
        nameless = kind is NAMELESS_REVIEW and bool(self._settings.account)
        models: dict[RequestKind, type[Verdict]] = {REVIEW: Verdict, OVERRIDE: Override}
        model = models.get(kind, NamelessVerdict)
        return Endpoint(
            kind, self._topics, lambda incoming: incoming.read(kind, model).by(incoming.account),
            _refuse_nameless if nameless else self._call_executor,
            self._verdicts, self.outlets, _describe,
            None if nameless else lambda review: self.approvals if review.approve else self.rejections,
        )  # fmt: skip

    def _speed_endpoint(self, kind: RequestKind, queue: RequestQueue) -> Endpoint[tuple[LowerSpeed, str]]:
        read = partial(_read_speed, kind)
        return Endpoint(
            kind, self._topics, read, self._set_speed, self._speeds, self.outlets, _describe_speed, lambda _: queue
        )

    def connect(self) -> None:
        """Connect to the broker, and serve the connection in a thread of its own."""
        on_message = {endpoint.topic: endpoint.on_message for endpoint in self.endpoints}
        on_message[self._topics.plan] = lambda message: self.on_own_plan(bytes(message.payload))
        self.start_queues()
        threading.Thread(target=self.run_log, name="log", daemon=True).start()
        threading.Thread(target=self.run_connections, name="connections", daemon=True).start()
        connect(self._client, self._broker, self._connection, self.on_connect, self.on_disconnect, on_message)

    def start_queues(self) -> None:
        """Begin to carry out what waits for no approval, each kind in a thread of its own."""
        queues = {"reject": self.rejections, "answer": self._answers, **self.interventions.queues}
        queues |= {"raise": self._raises, "limit": self._limits}
        for name, queue in queues.items():
            threading.Thread(target=_run_queue, args=(queue,), name=name, daemon=True).start()

    @property
    def refuse(self) -> Callable[[str, str], None]:
        """Counts a refused input; takes reason and sentence."""
        return self._diagnostics.refuse

    def run(self) -> None:
        """Carry out approvals until shutdown."""
        while not rospy.is_shutdown():
            self.approvals.run(0.2)
            self._check_plan()
        for topic in (self._topics.plan, self._topics.rehearsal):
            self._client.publish(topic, b"", qos=1, retain=True)
        self._client.disconnect()
        self._client.loop_stop()

    def run_log(self) -> None:
        """Write the log until shutdown, in a thread of its own: nothing else here waits for a disk or a terminal."""
        while not rospy.is_shutdown():
            self.outlets.write_log()
            time.sleep(LOG_PERIOD)

    def run_connections(self) -> None:
        """Connect to the executor until shutdown, in a thread of its own: a master that dies later keeps no stop back."""
        while not rospy.is_shutdown():
            for service in self._connections:
                service.open()
            time.sleep(CHECK_PERIOD)

    # -- ROS to MQTT

    def on_plan(self, message: Plan) -> None:
        """Show a plan; a work plan whose hash is not that of what would be shown is refused."""
        try:
            view = plan_view(message, self._tool)
        except ConstructionTwinError as error:
            self._diagnostics.refuse("plan", str(error))
            return
        with self._lock:
            self._view = view
            self._show()
        self._publish_plan()

    def on_rehearsal(self, message: Rehearsal) -> None:
        """Show what the rehearsal of a plan has found, until the plan is decided."""
        report = from_msg(RehearsalReport, message)
        if not is_whole(report):
            self._diagnostics.refuse("rehearsal", Sentence("reason.refused.rehearsal", plan=repr(report.plan_id)))
            return
        with self._lock:
            self._rehearsals.on_plan(report.plan_id, dumped(report, marks=SPACED))
        self._publish_rehearsal()

    def on_caller(self, message: PlanCaller) -> None:
        """Say of the plan under review whether the program that asked for it is still connected."""
        with self._lock:
            self._gone = "" if message.connected else message.plan_id
            if self._view is None or self._view.id != message.plan_id:
                return
            self._show()
        self._publish_plan()

    def _show(self) -> None:
        """Put the newest plan on the board, unless it was decided."""
        view = self._view
        assert view is not None  # there is a plan
        if view.id == self._gone:
            # in the one text about who asked that every screen shows
            view = replace(view, source=f"{view.source} (connected no more: nobody waits for the result)")
        self._board.on_plan(view.id, view.to_json(PATH_POINTS))

    def on_verdict(self, message: Review) -> None:
        """Take a plan away that was approved or rejected."""
        with self._lock:
            self._board.on_verdict(message.plan_id)
            self._rehearsals.on_verdict(message.plan_id)
        self._publish_plan()
        self._publish_rehearsal()

    def on_link(self, message: Link) -> None:
        """Take the plan away when another session begins."""
        if message.session and message.session != self._session:
            if self._session is not None:
                with self._lock:
                    self._board.restart()
                    self._rehearsals.restart()
                self._publish_plan()
                self._publish_rehearsal()
            self._session = message.session

    def _publish_plan(self) -> None:
        if self._client.is_connected():
            self._client.publish(self._topics.plan, self._board.payload, qos=1, retain=True)

    def _publish_rehearsal(self) -> None:
        if self._client.is_connected():
            self._client.publish(self._topics.rehearsal, self._rehearsals.payload, qos=1, retain=True)

    def _check_plan(self) -> None:
        """Publish again when the broker holds something else: the late last will of a predecessor takes our plan away."""
        now = time.monotonic()
        if now - self._checked_at < CHECK_PERIOD:
            return
        self._checked_at = now
        if self._seen != self._board.payload:
            self._publish_plan()

    # -- MQTT to ROS

    def on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        """Subscribe, and show what is under review."""
        if reason_code.is_failure:
            self._connection.refused(reason_code)
            return
        self._connection.connected(client, properties)
        self._seen = b""
        topics = [self._topics.plan, *(endpoint.topic for endpoint in self.endpoints)]
        client.subscribe(subscriptions(client, [(topic, 1) for topic in topics]))
        info = client.publish(self._topics.plan, self._board.payload, qos=1, retain=True)
        self._connection.watch_publish(client, self._topics.plan, info.mid)
        client.publish(self._topics.rehearsal, self._rehearsals.payload, qos=1, retain=True)

    def on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        """Report the end of the connection."""
        self._connection.lost(reason_code)

    def on_own_plan(self, payload: bytes) -> None:
        """Note what the broker holds."""
        self._seen = payload

    def _call_executor(self, review: ReviewRequest) -> Outcome:
        """Give a verdict to the executor; return what it says."""
        fields = request_fields(ReviewFromScreen, replace(review, reason=review.recorded_reason))
        if review.approve:
            answer = call(self._give_approval, EXECUTOR, **fields)
        else:
            # over the connection that is open, as a stop
            answer = call_twice(self._give_rejection, EXECUTOR, **fields)
        return Outcome.of(answer)

    def _give_answer(self, asked: tuple[AnswerRequest, str]) -> Outcome:
        """Give an answer to the work, in the name of its account."""
        answer, account = asked
        if problem := staleness(answer.moment, present()):
            raise PayloadError(TOO_OLD, Sentence("link.void.answer", problem=problem))
        if self._decide is None:
            return Outcome(False, Sentence("link.no_work"))
        fields = {"task": answer.task, "question": answer.question, "answer": answer.answer, "person": account}
        return Outcome.of(call(self._decide, "the work", decision="answer", reason="by MQTT", **fields))

    def _set_speed(self, asked: tuple[LowerSpeed, str]) -> Outcome:
        """Have a person's speed limit set, in the name of its account."""
        request, account = asked
        assert self._limit_speed is not None  # the node runs
        fields = {"limit": request.limit, "person": account, "moment": request.moment}
        return Outcome.of(call_twice(self._limit_speed, "pca_monitor", **fields))

    def _publish_answer(self, topic: str, payload: bytes, qos: int) -> None:
        self._client.publish(topic, payload, qos=qos)

    # -- reports

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        values: dict[str, object] = dict(
            self._verdicts.report()
            | self._pressed.report()
            | self._speeds.report()
            | self.outlets.side_effects.report()
        )
        if failed := self.outlets.side_effects.sentence:
            return Report(WARN, failed, values)
        if not self._client.is_connected():
            return Report(WARN, self._connection.sentence or "connecting to the broker", values)
        return Report(OK, "a plan is shown" if self._board.payload else "no plan to review", values)


def _run_queue(queue: RequestQueue) -> None:
    while not rospy.is_shutdown():
        queue.run(0.2)


def _refuse_nameless(review: ReviewRequest) -> Outcome:
    raise PayloadError("sender", Sentence("link.payload.nameless"))


def _read_answer(incoming: Incoming) -> tuple[AnswerRequest, str]:
    return incoming.read(ANSWER, AnswerRequest), incoming.account


def _read_speed(kind: RequestKind, incoming: Incoming) -> tuple[LowerSpeed, str]:
    return incoming.read(kind, RaiseSpeed if kind.starts else LowerSpeed), incoming.account


def _describe_speed(asked: tuple[LowerSpeed, str]) -> str:
    return f"speed limit {asked[0].limit:g} by MQTT account {asked[1]}"


def _describe(review: ReviewRequest) -> str:
    spite = " in spite of its rehearsal" if review.override_rehearsal else ""
    return f"{review.verdict} of plan {review.plan_id} by {review.reviewer}{spite}"


def plan_view(message: Plan, tool: str = "") -> PlanView:
    """Return what is shown of a plan; what a planner has not measured is left empty.

    Numbers cross unchanged. Every measured plan has its fractions of the velocity limits, so their absence means that none was.

    Args:
        tool: Hash of the tool file that counts; empty: no tool.

    Raises:
        PlanningError: If a work plan is not what its hash says.
    """
    points, is_work = message.trajectory.points, bool(message.segments)
    clearance = ClearanceView(
        message.clearance, message.clearance_time, message.clearance_between, _xyz(message.clearance_point)
    )
    return PlanView(
        id=message.id,
        hash=message.hash,
        source=message.source,
        planner=message.planner,
        scene=message.scene,
        frame=message.header.frame_id,
        created_ns=message.header.stamp.to_nsec(),
        duration=message.duration,
        planning_time=message.planning_time,
        joints=message.trajectory.joint_names,
        start=points[0].positions if points else (),
        goal=points[-1].positions if points else (),
        waypoints=len(message.tool_path),
        tool_path=[_xyz(point) for point in message.tool_path],
        clearance=clearance if message.velocity_use else None,
        use=UseView(message.velocity_use, message.acceleration_use, message.jerk_use),
        trajectory=_trajectory(message),
        tool=tool or None,
        task=message.task if is_work else None,
        content=_content(message) if is_work else None,
        segments=segment_views(message) if is_work else None,
    )


def segment_views(message: Plan) -> list[SegmentView]:
    """Return what is shown of a work plan's segments."""
    times = [point.time_from_start.to_nsec() for point in message.trajectory.points]
    return [
        SegmentView(
            name=segment.name,
            end=segment.end,
            tool_path_end=min(bisect_left(times, round(segment.end * NANOSECONDS)), max(len(times) - 1, 0)),
            engaged=segment.engaged,
            requires={signal.name: signal.value for signal in segment.requires},
            switches=[
                SwitchView(
                    switch.output,
                    switch.value,
                    {signal.name: signal.value for signal in switch.confirm},
                    switch.timeout,
                )
                for switch in segment.switches
            ],
            scene=segment.scene,
            scene_after=segment.scene_after,
            put=[item.name for item in segment.put],
            remove=segment.remove,
        )
        for segment in message.segments
    ]


def _content(message: Plan) -> str:
    """Return the text that a work plan's hash covers."""
    plan = plan_from_msg(message)
    return segments_content(plan.trajectory.content_hash(), plan.task, plan.segments)


def _trajectory(message: Plan) -> dict[str, list]:
    """Return what the trajectory's hash covers, as it is in the message: who shows the plan compares."""
    points = message.trajectory.points
    return {
        "times": [point.time_from_start.to_nsec() / NANOSECONDS for point in points],
        "positions": [point.positions for point in points],
        "velocities": [point.velocities for point in points],
        "accelerations": [point.accelerations for point in points],
    }


def _xyz(point) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def start(settings: Settings, robot: RobotModel, ports: Ports) -> MqttReview:
    """Return the node with its parameters and topics, connecting to the broker."""
    broker = broker_of(settings)
    # the last will takes the plan away: while this node does not run, a verdict on it would not be heard
    topics = Topics(settings.prefix, robot.name)
    client = make_client(broker, unique_id(robot.name, "review"), topics.plan, will="")
    give_approval = rospy.ServiceProxy("review_from_screen", ReviewFromScreen)
    # what starts nothing may be called twice
    twice = {kind.name: PersistentService(kind.name, Trigger) for kind in PRESSED if not kind.starts}
    once = {
        kind.name: rospy.ServiceProxy(
            f"{kind.name}_from_screen", SessionFromScreen if kind.by == BRIDGE else ResumeFromScreen
        )
        for kind in PRESSED
        if kind.starts
    }
    # a plan is rejected once, and a second time it is said to be
    reject = PersistentService("review_from_screen", ReviewFromScreen)
    limit_speed = PersistentService("limit_speed", LimitSpeed)
    connections = (*twice.values(), reject, limit_speed)
    node = MqttReview(
        settings, robot.name, broker, client, give_approval, twice | once, ports.diagnostics, reject, connections,
        rospy.ServiceProxy("work/decide", WorkDecide), limit_speed, tool_hash(settings.tool),
    )  # fmt: skip
    node.connect()
    return node


INTERFACE = Interface(
    report=MqttReview.report,
    hears=(
        Subscription("plan", Plan, MqttReview.on_plan, queue_size=5),
        Subscription("rehearsal", Rehearsal, MqttReview.on_rehearsal, queue_size=5),
        Subscription("plan_caller", PlanCaller, MqttReview.on_caller, queue_size=5),
        Subscription("review", Review, MqttReview.on_verdict, queue_size=10),
        Subscription("link", Link, MqttReview.on_link, queue_size=5),
    ),
)
NODE = NodeShell("mqtt_review", Settings, start, INTERFACE)


def main() -> None:
    """Run the node."""
    NODE.run()
