"""mqtt_planner: for programs that plan elsewhere. Takes their motions by MQTT, for review, and shows them everything on `view`.

A node of its own: reading a long motion takes longer than the bridge's 4 ms, and checking one takes seconds. The poses come from
ROS topics in bundles, see LatestPose, so that the bridge does nothing more for `view` than for any other subscriber.
"""

from __future__ import annotations

import functools
import hashlib
import queue
import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import genpy
import pydantic
import rospy
from paho.mqtt.client import MQTTMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PayloadError, PoseUnknownError
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.remote_trajectory import (
    Joints,
    SenderPace,
    TrajectoryRequest,
    checked_sender,
    last_level,
    parse_trajectory,
    read_document,
    request_id,
    trajectory_answer,
)
from construction_twin.link.remote_view import (
    ExecutionView,
    LinkView,
    PlanProgress,
    PoseView,
    Seen,
    SyncView,
    ViewWriter,
)
from construction_twin.link.remote_view import Report as ExecutionReport
from construction_twin.mqtt.client import Broker, make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.plain_client import PlainClient
from construction_twin.msg import Execution, Link, Sync
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.mqtt_connection import MqttSettings, broker_of, connect, report_of
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.persistent_service import NO_ANSWER
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import PlanTrajectory, PlanTrajectoryResponse

#: Motions that may wait while one is checked; a person sends one at a time.
WAITING = 4
#: For so long after its answer the same bytes are the same message, sent twice by QoS 1 or by a sender that was run again [s].
REPEAT_WINDOW = 5.0
#: Shortest time between two motions of one sender [s]: nobody alone holds up the others.
SENDER_PAUSE = 1.0
#: Longest wait for `plan_trajectory` to exist [s].
SERVICE_TIMEOUT = 1.0
#: What `sync` and `link` repeat by themselves counts as lost after so long [s].
SYNC_AGE, LINK_AGE = 0.5, 3.0


class Settings(MqttSettings):
    """Private parameters; see config/mqtt_planner.yaml. `trajectories`: whether motions are taken by MQTT."""

    trajectories: bool = True
    max_trajectory_bytes: int = pydantic.Field(ge=1024, le=1 << 24)
    view_rate: float = pydantic.Field(ge=1.0, le=50.0)
    max_pose_age: float = pydantic.Field(gt=0.0, le=5.0)


@dataclass(frozen=True)
class Poses:
    """Where the newest poses come from; None where the robot has no such stream."""

    twin: LatestPose | None
    arm: LatestPose | None


@dataclass(frozen=True)
class _Waiting:
    """A motion that waits: of which account, and the digest of its message."""

    request: TrajectoryRequest
    sender: str
    digest: bytes


class MqttPlanner:
    """ROS and MQTT around `remote_trajectory` and `remote_view`; `start` gives it topics and a connection.

    `_lock` guards what is heard from ROS and the counters: every topic has a thread of its own. `_writing` guards the writer.

    Parameters
    ----------
    settings : Settings
    robot : str
        Name in the MQTT topics.
    joints : Joints
    broker : Broker
    client : PlainClient
        Not connected yet.
    writer : ViewWriter
    plan_trajectory : rospy.ServiceProxy
        The planner's service.
    diagnostics : callable
        Takes `report`; returns the node's NodeDiagnostics.
    """

    def __init__(
        self,
        settings: Settings,
        robot: str,
        joints: Joints,
        broker: Broker,
        client: PlainClient,
        writer: ViewWriter,
        plan_trajectory: rospy.ServiceProxy,
        diagnostics: Callable[[Callable[[], Report]], NodeDiagnostics],
    ):
        self._settings = settings
        self._joints = joints
        self._topics = Topics(settings.prefix, robot)
        self._broker = broker
        self._client = client
        self._writer = writer
        self._plan_trajectory = plan_trajectory
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._waiting: queue.Queue[_Waiting] = queue.Queue(WAITING)
        #: Digest of a message to its answer and when that was given; b"": it is being checked.
        self._answered: dict[bytes, tuple[bytes, float]] = {}
        self._pace = SenderPace(SENDER_PAUSE)
        self._counts: Counter[str] = Counter()
        self._sync: tuple[Sync, float] | None = None
        self._link: tuple[Link, float] | None = None
        self._execution: tuple[Execution, float] | None = None
        self._progress = PlanProgress()
        self._executor_is_there: Callable[[], bool] = lambda: True
        self._poses = Poses(None, None)
        self._connection = report_of(broker)
        self._diagnostics = diagnostics(self.report)

    @property
    def refuse(self) -> Callable[[str, str], None]:
        """Counts a refused input; takes reason and sentence."""
        return self._diagnostics.refuse

    def listen(self, poses: Poses, executor_is_there: Callable[[], bool]) -> None:
        """Take where poses come from, and what tells whether the publisher of `execution` is there."""
        self._poses = poses
        self._executor_is_there = executor_is_there

    def connect(self) -> None:
        """Connect to the broker, and serve the connection in a thread of its own."""
        on_message = {}
        if self._settings.trajectories:
            on_message = {
                self._topics.trajectory: lambda message: self._on_message("", message),
                self._topics.trajectory_from("+"): lambda message: self._on_message(last_level(message.topic), message),
            }
        connect(self._client, self._broker, self._connection, self.on_connect, self.on_disconnect, on_message)

    def run(self) -> None:
        """Check motions, and show everything, until shutdown."""
        viewer = threading.Thread(target=self._show, name="view", daemon=True)
        viewer.start()
        while not rospy.is_shutdown():
            self.run_waiting(0.2)
        viewer.join(1.0)
        self._client.publish(self._topics.view, self._writer.offline(), qos=1)
        self._client.disconnect()
        self._client.loop_stop()

    def run_waiting(self, patience: float = 0.0) -> None:
        """Check all motions that wait; wait so long [s] for the first one."""
        try:
            self._carry_out(self._waiting.get(timeout=patience) if patience else self._waiting.get_nowait())
            while True:
                self._carry_out(self._waiting.get_nowait())
        except queue.Empty:
            return

    # -- motions from MQTT

    def on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        """Subscribe."""
        if reason_code.is_failure:
            self._connection.refused(reason_code)
            return
        self._connection.connected()
        if self._settings.trajectories:
            topics = [(self._topics.trajectory, 1), (self._topics.trajectory_from("+"), 1)]
            client.subscribe(subscriptions(client, topics))
        # the broker answers it, and so shows whether this account may write here
        info = client.publish(self._topics.view, self._present(), qos=1)
        self._connection.watch_publish(client, self._topics.view, info.mid)

    def on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        """Report the end of the connection."""
        self._connection.lost(reason_code)

    def _on_message(self, sender: str, message: MQTTMessage) -> None:
        self.on_trajectory(sender, bytes(message.payload), message.retain)

    def on_trajectory(self, sender: str, payload: bytes, retained: bool) -> None:
        """Take a motion; it is checked in the main thread.

        Parameters
        ----------
        sender : str
            The account in the topic's name; empty on `trajectory` itself.
        payload : bytes
        retained : bool
        """
        request = ""
        try:
            sender = checked_sender(sender)
            document = read_document(payload, retained, self._settings.max_trajectory_bytes)
            request = request_id(document)
            asked = parse_trajectory(document, self._joints)
        except PayloadError as error:
            self._refuse(error.reason, str(error), request, sender)
            return
        digest = hashlib.sha256(sender.encode() + b"\0" + payload).digest()
        if self._is_repeated(digest, asked.id):
            return
        now = time.monotonic()
        wait = self._pace.wait(sender, now)
        problem = f"one motion in {SENDER_PAUSE:g} s is taken from a sender; try again in {wait:.1f} s" if wait else ""
        if not problem:
            try:
                self._waiting.put_nowait(_Waiting(asked, sender, digest))
            except queue.Full:
                problem = f"{WAITING} trajectories are waiting already; try again"
            else:
                self._pace.take(sender, now)
        if problem:
            with self._lock:
                del self._answered[digest]
            self._refuse("busy", problem, asked.id, sender)

    def _is_repeated(self, digest: bytes, request: str) -> bool:
        """Return whether the same message came before; one that was answered is answered alike. If not, note it."""
        now = time.monotonic()
        with self._lock:
            self._answered = {
                key: (answer, at)
                for key, (answer, at) in self._answered.items()
                if not answer or now - at <= REPEAT_WINDOW
            }
            if digest not in self._answered:
                self._answered[digest] = b"", now
                return False
            answer, _ = self._answered[digest]
        self._diagnostics.refuse(
            "repeated", f"trajectory {request!r} came again within {REPEAT_WINDOW:g} s of its answer, or before it"
        )
        if answer:
            self._client.publish(self._topics.trajectory_ack, answer, qos=1)
        return True

    def _refuse(self, reason: str, sentence: str, request: str, sender: str) -> None:
        self._diagnostics.refuse(reason, sentence)
        self._client.publish(self._topics.trajectory_ack, trajectory_answer(request, sender, False, sentence), qos=1)

    def _carry_out(self, waiting: _Waiting) -> None:
        """Have a motion checked and timed, and tell the sender what became of it."""
        asked, sender = waiting.request, waiting.sender
        try:
            rospy.wait_for_service(self._plan_trajectory.resolved_name, SERVICE_TIMEOUT)
            answer = self._plan_trajectory(
                trajectory=trajectory_message(asked, self._joints),
                speed_scale=asked.speed_scale,
                acceleration_scale=asked.acceleration_scale,
                retime=True,
                source=source_of(asked, sender, proven=self._broker.account is not None),
            )
        except (rospy.ROSException, *NO_ANSWER) as error:
            sentence = f"{self._plan_trajectory.resolved_name} does not answer: {error}; does the planner run?"
            content = trajectory_answer(asked.id, sender, False, sentence)
        else:
            plan = {"plan_id": answer.plan_id, "plan_hash": answer.plan_hash, "duration": answer.duration}
            notes = [*asked.notes, *_timing_notes(asked, answer)]
            content = trajectory_answer(asked.id, sender, answer.success, answer.message, **plan, notes=notes)
            with self._lock:
                self._counts["under review" if answer.success else "no plan"] += 1
            rospy.loginfo("trajectory %r from %s: %s", asked.id, sender or "an unknown sender", answer.message)
        with self._lock:
            self._answered[waiting.digest] = content, time.monotonic()
        self._client.publish(self._topics.trajectory_ack, content, qos=1)

    # -- what is shown

    def on_sync(self, message: Sync) -> None:
        """Take the gate's report."""
        with self._lock:
            self._sync = message, time.monotonic()

    def on_link(self, message: Link) -> None:
        """Take the bridge's report."""
        with self._lock:
            self._link = message, time.monotonic()

    def on_execution(self, message: Execution) -> None:
        """Take the executor's report."""
        report = ExecutionReport(
            stamp=message.header.stamp.to_sec(),
            start=message.plan_start.to_sec(),
            state=message.text,
            plan_id=message.plan_id,
            outcome=message.outcome,
            duration=message.duration,
            rate=message.rate,
        )
        with self._lock:
            self._progress.on_report(report)
            self._execution = message, time.monotonic()

    def show(self) -> bytes:
        """Return the present message for `view`, and publish it where there is a connection."""
        payload = self._present()
        # what is not sent at once would be of the past
        if self._client.is_connected():
            self._client.publish(self._topics.view, payload, qos=0)
        return payload

    def _present(self) -> bytes:
        with self._writing:
            return self._writer.write(now_ns(), self.seen())

    def seen(self) -> Seen:
        """Return what is known now."""
        with self._lock:
            sync, link, execution = self._sync, self._link, self._execution
            progress = self._progress.at(now_ns() / NANOSECONDS)
        twin, arm = _pose_view(self._poses.twin, self._settings), _pose_view(self._poses.arm, self._settings)
        now = time.monotonic()
        return Seen(
            twin,
            arm,
            _sync_view(sync[0], now - sync[1]) if sync is not None and now - sync[1] <= SYNC_AGE else None,
            _link_view(link[0], now - link[1]) if link is not None and now - link[1] <= LINK_AGE else None,
            _execution_view(execution[0], now - execution[1], progress)
            if execution is not None and self._executor_is_there()
            else None,
        )

    def _show(self) -> None:
        """Show everything `view_rate` times a second."""
        period = 1.0 / self._settings.view_rate
        due = time.monotonic()
        while not rospy.is_shutdown():
            self.show()
            # after a pause of the machine the next one is a whole period away: nobody needs what was missed
            due = max(due + period, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))

    # -- reports

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        with self._lock:
            values: dict[str, object] = {f"trajectories {name}": n for name, n in sorted(self._counts.items())}
        values["trajectories waiting"] = self._waiting.qsize()
        if not self._client.is_connected():
            return Report(WARN, self._connection.sentence or "connecting to the broker", values)
        taken = (
            "trajectories are taken"
            if self._settings.trajectories
            else "no trajectories are taken (trajectories: false)"
        )
        return Report(OK, taken, values)


def source_of(asked: TrajectoryRequest, sender: str, proven: bool) -> str:
    """Return who asked, for the reviewer.

    Parameters
    ----------
    asked : TrajectoryRequest
    sender : str
        The account in the topic's name; empty when there is none.
    proven : bool
        The broker knows accounts, and by a site's rules only this one writes on that topic.
    """
    if not sender:
        known = "MQTT, sender not known"
    else:
        known = f"MQTT account {sender}" if proven else f"MQTT, on the topic of {sender}"
    return f"{known}, which says it is {asked.source!r}" if asked.source else known


def trajectory_message(asked: TrajectoryRequest, joints: Joints) -> JointTrajectory:
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


def _timing_notes(asked: TrajectoryRequest, answer: PlanTrajectoryResponse) -> list[str]:
    """Return that the times were replaced, and why, where they were."""
    if not answer.retimed:
        return []
    wished = (asked.points[-1].time_ns - asked.points[0].time_ns) / NANOSECONDS
    return [f"timed anew: {answer.duration:.3f} s instead of {wished:.3f} s, because {answer.retimed}"]


def _pose_view(stream: LatestPose | None, settings: Settings) -> PoseView | None:
    if stream is None:
        return None
    try:
        newest = stream.newest(settings.max_pose_age)
    except (PoseUnknownError, PayloadError):
        # it is shown as not known; who publishes something else on the stream is refused and counted by others
        return None
    return PoseView(newest.stamp / NANOSECONDS, time.monotonic() - newest.received, newest.positions)


def _sync_view(message: Sync, age: float) -> SyncView:
    return SyncView(
        state=message.text,
        reason=message.reason,
        age=age,
        policy=message.policy,
        agreed=message.agreed,
        error=message.error,
        threshold=message.threshold,
        servo_lag=message.servo_lag,
        violations=message.violations,
    )


def _link_view(message: Link, age: float) -> LinkView:
    return LinkView(
        state=message.text,
        reason=message.reason,
        age=age,
        gateway_state=message.gateway_state,
        gateway_kind=message.gateway_kind,
        responsible=message.responsible,
    )


def _execution_view(message: Execution, age: float, progress: float) -> ExecutionView:
    return ExecutionView(
        state=message.text,
        reason=message.reason,
        age=age,
        plan_id=message.plan_id,
        outcome=message.outcome,
        duration=message.duration,
        progress=progress,
        rate=message.rate,
        speed_limit=message.speed_limit,
    )


def start() -> MqttPlanner:
    """Return the node with its parameters and topics, connecting to the broker."""
    settings = read_parameters(Settings)
    robot = robot_from_parameters()
    joints = Joints(tuple(robot.joint_names), tuple(robot.linear))
    broker = broker_of(settings)
    writer = ViewWriter(robot.name, secrets.token_hex(8), joints)
    client = make_client(
        broker,
        unique_id(robot.name, "planner"),
        Topics(settings.prefix, robot.name).view,
        will=writer.offline().decode(),
        will_retained=False,
    )
    service = rospy.ServiceProxy("plan_trajectory", PlanTrajectory)
    diagnostics = functools.partial(NodeDiagnostics, robot.name)
    node = MqttPlanner(settings, robot.name, joints, broker, client, writer, service, diagnostics)
    poses = Poses(
        LatestPose("twin/joint_states", robot.joint_names, node.refuse),
        LatestPose("physical/joint_states", robot.joint_names, node.refuse),
    )
    executions = Subscriber("execution", Execution, node.on_execution, node.refuse, queue_size=10)
    node.listen(poses, lambda: executions.get_num_connections() > 0)
    Subscriber("sync", Sync, node.on_sync, node.refuse, queue_size=1)
    Subscriber("link", Link, node.on_link, node.refuse, queue_size=1)
    node.connect()
    return node


def main() -> None:
    """Run the node."""
    run_node("mqtt_planner", start)
