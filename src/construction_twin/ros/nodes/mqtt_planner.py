"""mqtt_planner: for programs that plan elsewhere. Takes their motions by MQTT, for review, and shows them everything on `view`.

What consoles want beside that is in `ros.shared.console_feed` and `ros.shared.console_requests`.

A node of its own: reading a long motion takes longer than the bridge's 4 ms, and checking one takes seconds. The poses come from
ROS topics in bundles, see LatestPose, so that the bridge does nothing more for `view` than for any other subscriber.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import genpy
import pydantic
import rospy
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PayloadError, PoseUnknownError
from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SpeedReport, SyncReport
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.remote_trajectory import TrajectoryRequest, parse_trajectory
from construction_twin.link.remote_view import PlanProgress, PoseView, Seen, Shown, ViewWriter
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import Broker, make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.plain_client import PlainClient
from construction_twin.mqtt.requests import NAMELESS_TRAJECTORY, TRAJECTORY, RequestKind
from construction_twin.msg import (
    Execution,
    Hold,
    Link,
    Plan,
    Rehearsal,
    Review,
    SessionRequest,
    SpeedChange,
    SpeedLimitInForce,
    Sync,
    WorkTasks,
)
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.plan_services import PLAN_SERVICES
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.console_feed import ConsoleFeed, deployment_of
from construction_twin.ros.shared.console_requests import ConsoleRequests, RobotContext
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.endpoint import Endpoint, Incoming, Outlets
from construction_twin.ros.shared.launch_arguments import BROKER, has_link
from construction_twin.ros.shared.message_board import MessageFile
from construction_twin.ros.shared.mqtt_connection import MqttSettings, broker_of, connect, report_of
from construction_twin.ros.shared.node_shell import ConfigFile, NodeShell
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.params import ros_home
from construction_twin.ros.shared.ports import (
    Interface,
    NewestPose,
    Ports,
    SharedParameter,
    Subscription,
)
from construction_twin.ros.shared.pose_judge import PoseJudge
from construction_twin.ros.shared.private_files import PrivateFiles
from construction_twin.ros.shared.request_counts import RequestCounts
from construction_twin.ros.shared.request_queue import RequestQueue
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.persistent_service import call
from construction_twin.srv import PlanTrajectory, PlanTrajectoryResponse

#: Motions that may wait while one is checked; a person sends one at a time.
WAITING = 4
#: For so long after its answer the same bytes are the same message, sent twice by QoS 1 or by a sender that was run again [s].
REPEAT_WINDOW = 5.0
#: What `sync`, `link` and `speed_limit_in_force` repeat by themselves counts as lost after so long [s].
SYNC_AGE, LINK_AGE, SPEED_AGE = 0.5, 3.0, 1.0

#: A pose that is older counts as not known on `view` [s].
MAX_POSE_AGE = 0.25
_Record = TypeVar("_Record")
#: What was reported and its age [s]; None: there is nothing, or it is too old.
_Report = tuple[_Record, float] | None


class Settings(MqttSettings):
    """Private parameters; see config/mqtt_planner.yaml.

    Attributes:
        trajectories: Whether motions, and requests for plans, are taken by MQTT.
        self_collision: YAML of the link pairs that are not checked; empty: no joint values are found for poses that are dragged.
        messages: Folder of the messages that outlast this node, relative to ROS_HOME; empty: they do not.
        servo_model: As the gate has it; empty: it does not expect the arm where its servos should have it.
        private: Folder of what a console serves to whom is logged in, relative to ROS_HOME; empty: no console was started.
    """

    trajectories: bool = True
    self_collision: str = ""
    private: str = ""
    messages: str = ""
    servo_model: str = ""
    max_trajectory_bytes: int = pydantic.Field(ge=1024, le=1 << 24)
    view_rate: float = pydantic.Field(ge=1.0, le=50.0)


@dataclass(frozen=True)
class Poses:
    """Where the newest poses come from; None where the robot has no such stream."""

    twin: LatestPose | None
    arm: LatestPose | None
    expected: LatestPose | None = None


@dataclass(frozen=True)
class _Motion:
    """A motion from elsewhere, and the account of its topic."""

    asked: TrajectoryRequest
    sender: str


class MqttPlanner:
    """ROS and MQTT around `remote_trajectory` and `remote_view`; `start` gives it topics and a connection.

    `_lock` guards what is heard from ROS and the counters: every topic has a thread of its own. `_writing` guards the writer.

    Args:
        robot: Name in the MQTT topics.
        client: Not connected yet.
        plan_trajectory: The planner's service.
        diagnostics: Counts what is refused.
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
        diagnostics: NodeDiagnostics,
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
        #: The broker knows accounts, and by a site's rules each account writes on its own topics only.
        self._proven = broker.account is not None
        self._feed: ConsoleFeed | None = None
        self._acknowledgements: tuple[Endpoint, ...] = ()
        self._read_messages = RequestCounts("messages", "acknowledged", "not acknowledged")
        self._consoles: ConsoleRequests | None = None
        self._looks_around = bool(settings.private)
        self._counts = RequestCounts("trajectories", "under review", "no plan")
        self._sync: tuple[SyncReport, float] | None = None
        self._link: tuple[LinkReport, float] | None = None
        self._execution: tuple[ExecutionReport, float] | None = None
        self._speed: tuple[SpeedReport, float] | None = None
        self._progress = PlanProgress()
        self._executor_is_there: Callable[[], bool] = lambda: True
        self._poses = Poses(None, None)
        self._connection = report_of(broker)
        self.outlets = Outlets(self._publish_answer, lambda reason, sentence: self.refuse(reason, sentence))
        self._queue = RequestQueue(WAITING, REPEAT_WINDOW, lambda: time.monotonic())
        kinds = (NAMELESS_TRAJECTORY, TRAJECTORY) if settings.trajectories else ()
        self._motions = tuple(map(self._motion_endpoint, kinds))
        self._diagnostics = diagnostics

    def _motion_endpoint(self, kind: RequestKind) -> Endpoint[_Motion]:
        return Endpoint(
            kind, self._topics, self._read_motion, self._carry_out, self._counts, self.outlets,
            lambda motion: f"trajectory {motion.asked.id!r} from {motion.sender or 'an unknown sender'}",
            lambda _motion: self._queue,
        )  # fmt: skip

    @property
    def endpoints(self) -> tuple[Endpoint, ...]:
        """What takes requests: motions, and of consoles requests for plans and poses."""
        if self._consoles is None:
            return self._motions
        plans = (self._consoles.plan_requests,) if self._settings.trajectories else ()
        return *self._motions, *plans, self._consoles.ik, *self._acknowledgements

    @property
    def refuse(self) -> Callable[[str, str], None]:
        """Counts a refused input; takes reason and sentence."""
        return self._diagnostics.refuse

    @property
    def feed(self) -> ConsoleFeed:
        """What tells consoles more than `view`, where they are served."""
        assert self._feed is not None  # what is heard for it comes after `serve_consoles`
        return self._feed

    def listen(self, poses: Poses, executor_is_there: Callable[[], bool]) -> None:
        """Take where poses come from, and what tells whether the publisher of `execution` is there."""
        self._poses = poses
        self._executor_is_there = executor_is_there

    @property
    def joints(self) -> Joints:
        """The robot's joints."""
        return self._joints

    def is_engaged(self) -> bool:
        """Return whether only the way back can be planned."""
        with self._lock:
            return self._execution is not None and bool(self._execution[0].engaged)

    @property
    def queue(self) -> RequestQueue:
        """Where requests wait for their turn."""
        return self._queue

    def serve_consoles(self, feed: ConsoleFeed, requests: ConsoleRequests) -> None:
        """Take what tells consoles more than `view`, and what carries out their requests."""
        self._feed, self._consoles = feed, requests
        self._acknowledgements = (feed.messages.endpoint(self._topics, self._read_messages, self.outlets),)

    def publish_now(self, topic: str, payload: bytes, qos: int, retain: bool = False) -> None:
        """Publish where there is a connection; what could be sent later only would be of the past."""
        if self._client.is_connected():
            self._client.publish(topic, payload, qos=qos, retain=retain)

    def source_of(self, account: str) -> str:
        """Return who asks on the topic of an account, for the reviewer."""
        return source_of("", account, self._proven)

    def connect(self) -> None:
        """Connect to the broker, and serve the connection in a thread of its own."""
        on_message = {endpoint.topic: endpoint.on_message for endpoint in self.endpoints}
        connect(self._client, self._broker, self._connection, self.on_connect, self.on_disconnect, on_message)

    def run(self) -> None:
        """Check motions, and show everything, until shutdown."""
        viewer = threading.Thread(target=self._run_view, name="view", daemon=True)
        viewer.start()
        if self._consoles is not None:
            threading.Thread(target=self._consoles.run, args=(self._looks_around,), name="ik", daemon=True).start()
        while not rospy.is_shutdown():
            self.run_waiting(0.2)
        viewer.join(1.0)
        self._client.publish(self._topics.view, self._writer.offline(), qos=1)
        if self._feed is not None:
            self._feed.publish_offline()
        self._client.disconnect()
        self._client.loop_stop()

    def run_waiting(self, patience: float = 0.0) -> None:
        """Carry out all requests that wait; wait so long [s] for the first one."""
        self._queue.run(patience)
        self.outlets.write_log()
        if self._feed is not None:
            self._feed.messages.write()

    # -- motions from MQTT

    def on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        """Subscribe."""
        if reason_code.is_failure:
            self._connection.refused(reason_code)
            return
        self._connection.connected(client, properties)
        if topics := [(endpoint.topic, endpoint.qos) for endpoint in self.endpoints]:
            client.subscribe(subscriptions(client, topics))
        # the broker answers it, and so shows whether this account may write here
        info = client.publish(self._topics.view, self._present(), qos=1)
        self._connection.watch_publish(client, self._topics.view, info.mid)
        if self._feed is not None:
            self._feed.publish_retained()

    def on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        """Report the end of the connection."""
        self._connection.lost(reason_code)

    def _read_motion(self, incoming: Incoming) -> _Motion:
        limit = self._settings.max_trajectory_bytes
        document = incoming.read_document("trajectory", limit, "max_trajectory_bytes")
        return _Motion(parse_trajectory(document, self._joints), incoming.account)

    def _carry_out(self, motion: _Motion) -> Outcome:
        """Have a motion checked and timed."""
        asked = motion.asked
        answer = call(
            self._plan_trajectory,
            "the planner",
            trajectory=trajectory_message(asked, self._joints),
            speed_scale=asked.speed_scale,
            acceleration_scale=asked.acceleration_scale,
            retime=True,
            source=source_of(asked.source, motion.sender, self._proven),
        )
        outcome = Outcome.of(answer)
        return replace(outcome, fields={**outcome.fields, "notes": [*asked.notes, *_timing_notes(asked, answer)]})

    def _publish_answer(self, topic: str, payload: bytes, qos: int) -> None:
        # what asks for no acknowledgement is of the past when it cannot be sent at once
        if qos or self._client.is_connected():
            self._client.publish(topic, payload, qos=qos)

    # -- what is shown

    def on_sync(self, message: Sync) -> None:
        """Take the gate's report."""
        report = from_msg(SyncReport, message)
        with self._lock:
            self._sync = report, time.monotonic()

    def on_link(self, message: Link) -> None:
        """Take the bridge's report."""
        report = from_msg(LinkReport, message)
        with self._lock:
            self._link = report, time.monotonic()
        if self._feed is not None:
            self._feed.on_link(message)

    def on_execution(self, message: Execution) -> None:
        """Take the executor's report."""
        report = from_msg(ExecutionReport, message)
        with self._lock:
            self._progress.on_report(report)
            self._execution = report, time.monotonic()
        if self._feed is not None:
            self._feed.on_execution(report)

    def on_speed(self, message: SpeedLimitInForce) -> None:
        """Take which speed limit is in force."""
        with self._lock:
            self._speed = from_msg(SpeedReport, message), time.monotonic()

    def publish_view(self) -> bytes:
        """Return the present message for `view`, and publish it where there is a connection."""
        payload = self._present()
        # what is not sent at once would be of the past
        if self._client.is_connected():
            self._client.publish(self._topics.view, payload, qos=0)
        return payload

    def _present(self) -> bytes:
        # before anything is looked at: whoever repeats it has seen nothing newer
        moment, seen = present(), self.seen()
        if self._feed is not None:
            self._feed.note_poses(seen.twin is not None, seen.arm is not None)
        with self._writing:
            return self._writer.write(now_ns(), seen, moment)

    def _reports(self) -> tuple[_Report[LinkReport], _Report[SyncReport], _Report[ExecutionReport]]:
        """Return what was reported, with its age; None for what is silent."""
        now = time.monotonic()
        with self._lock:
            link, sync, execution = self._link, self._sync, self._execution
        return (
            (link[0], now - link[1]) if link is not None and now - link[1] <= LINK_AGE else None,
            (sync[0], now - sync[1]) if sync is not None and now - sync[1] <= SYNC_AGE else None,
            (execution[0], now - execution[1]) if execution is not None and self._executor_is_there() else None,
        )

    def seen(self) -> Seen:
        """Return what is known now."""
        link, sync, execution = self._reports()
        with self._lock:
            progress, speed = self._progress.at(now_ns() / NANOSECONDS), self._speed
        return Seen(
            _pose_view(self._poses.twin, self._settings),
            _pose_view(self._poses.arm, self._settings),
            Shown(*sync) if sync is not None else None,
            Shown(*link) if link is not None else None,
            Shown(*execution) if execution is not None else None,
            self._feed.plan if self._feed is not None else "",
            self._consoles.closest() if self._consoles is not None else None,
            progress,
            self._feed.hold if self._feed is not None and sync is not None else HoldReport(),
            self._feed.approval_obstacle if self._feed is not None and execution is not None else "",
            speed[0] if speed is not None and time.monotonic() - speed[1] <= SPEED_AGE else None,
            _pose_view(self._poses.expected, self._settings),
        )

    def publish_status_line(self) -> None:
        """Tell the status line, where it is due."""
        if self._feed is None:
            return
        link, sync, execution = self._reports()
        now = time.monotonic()
        self._feed.publish_status_line(
            link[0] if link is not None else None,
            sync[0] if sync is not None else None,
            execution[0] if execution is not None else None,
            now,
        )

    def _run_view(self) -> None:
        """Show everything `view_rate` times a second."""
        period = 1.0 / self._settings.view_rate
        due = time.monotonic()
        while not rospy.is_shutdown():
            self.publish_view()
            self.publish_status_line()
            # after a pause of the machine the next one is a whole period away: nobody needs what was missed
            due = max(due + period, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))

    # -- reports

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        values: dict[str, object] = {**self._counts.report(), "trajectories waiting": self._queue.waiting}
        values |= (self._consoles.counts if self._consoles is not None else {}) | self._read_messages.report()
        if not self._client.is_connected():
            return Report(WARN, self._connection.sentence or "connecting to the broker", values)
        taken = (
            "trajectories are taken"
            if self._settings.trajectories
            else "no trajectories are taken (trajectories: false)"
        )
        return Report(OK, taken, values)


def source_of(says: str, sender: str, proven: bool) -> str:
    """Return who asked, for the reviewer.

    Args:
        says: What the sender says of itself; empty: nothing.
        sender: The account in the topic's name; empty when there is none.
        proven: The broker knows accounts, and by a site's rules only this one writes on that topic.
    """
    if not sender:
        known = "MQTT, sender not known"
    else:
        known = f"MQTT account {sender}" if proven else f"MQTT, on the topic of {sender}"
    return f"{known}, which says it is {says!r}" if says else known


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
    requested = (asked.points[-1].time_ns - asked.points[0].time_ns) / NANOSECONDS
    return [f"timed anew: {answer.duration:.3f} s instead of {requested:.3f} s, because {answer.retimed}"]


def _pose_view(stream: LatestPose | None, settings: Settings) -> PoseView | None:
    if stream is None:
        return None
    try:
        newest = stream.newest(MAX_POSE_AGE)
    except (PoseUnknownError, PayloadError):
        # it is shown as not known; who publishes something else on the stream is refused and counted by others
        return None
    return PoseView(newest.stamp / NANOSECONDS, time.monotonic() - newest.received, newest.positions)


def _consoles(node: MqttPlanner, settings: Settings, robot: RobotModel, poses: Poses, ports: Ports) -> None:
    """Give the node what consoles want beside motions and `view`."""
    topics = Topics(settings.prefix, robot.name)
    files = None
    if settings.private:
        files = PrivateFiles(ros_home() / settings.private, robot.name)
        for problem in files.write_robot(robot.urdf):
            node.refuse("mesh", problem)
        if ports.parameters["work"] is None:
            files.drop_building()
    deployment = deployment_of(ports.parameters["startup"], rospy.get_namespace().rstrip("/"))
    messages = MessageFile(ros_home() / settings.messages / f"{robot.name}.json") if settings.messages else None
    feed = ConsoleFeed(topics, robot.base_link, node.publish_now, node.refuse, deployment, files, messages)
    services = {kind: rospy.ServiceProxy(service.name, service.kind) for kind, service in PLAN_SERVICES.items()}
    around = RobotContext(
        twin=lambda: _positions(poses.twin, MAX_POSE_AGE),
        has_work=lambda: ports.connections("work/tasks") > 0,
        is_engaged=node.is_engaged,
    )
    requests = ConsoleRequests(
        topics, node.joints, node.queue, services, PoseJudge(robot, settings.self_collision, lambda: feed.scene), around,
        node.outlets, node.source_of,
    )  # fmt: skip
    node.serve_consoles(feed, requests)


def _positions(stream: LatestPose | None, oldest: float) -> tuple[float, ...]:
    """Return the newest pose, empty while it is not known."""
    try:
        return stream.newest(oldest).positions if stream is not None else ()
    except (PoseUnknownError, PayloadError):
        return ()


def start(settings: Settings, robot: RobotModel, ports: Ports) -> MqttPlanner:
    """Return the node with its parameters and topics, connecting to the broker."""
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
    node = MqttPlanner(settings, robot.name, joints, broker, client, writer, service, ports.diagnostics)
    poses = Poses(
        ports.poses["twin/joint_states"], ports.poses["physical/joint_states"], ports.poses.get("expected/joint_states")
    )
    node.listen(poses, lambda: ports.connections("execution") > 0)
    _consoles(node, settings, robot, poses, ports)
    node.connect()
    return node


def _fed(handler: Callable[[ConsoleFeed, Any], object]) -> Callable[[MqttPlanner, Any], object]:
    """Return a handler of the node, which gives its message to the feed of the consoles."""
    return lambda node, message: handler(node.feed, message)


INTERFACE = Interface(
    report=MqttPlanner.report,
    parameters=(SharedParameter("work"), SharedParameter("startup")),
    reads=(
        NewestPose("twin/joint_states"),
        NewestPose("physical/joint_states"),
        NewestPose("expected/joint_states", when=lambda settings: bool(settings.servo_model)),
    ),
    hears=(
        Subscription("execution", Execution, MqttPlanner.on_execution, queue_size=10),
        Subscription("work/tasks", WorkTasks, _fed(ConsoleFeed.on_tasks), queue_size=2),
        Subscription("scene", SceneMsg, _fed(ConsoleFeed.on_scene), queue_size=2),
        Subscription("plan", Plan, _fed(ConsoleFeed.on_plan), queue_size=5),
        Subscription("rehearsal", Rehearsal, _fed(ConsoleFeed.on_rehearsal), queue_size=5),
        Subscription("review", Review, _fed(ConsoleFeed.on_review), queue_size=10),
        Subscription("sync", Sync, MqttPlanner.on_sync, queue_size=1),
        Subscription("hold", Hold, _fed(ConsoleFeed.on_hold), queue_size=1),
        Subscription("approval_obstacle", String, _fed(ConsoleFeed.on_approval_obstacle), queue_size=1),
        Subscription("link", Link, MqttPlanner.on_link, queue_size=1),
        Subscription("session_request", SessionRequest, _fed(ConsoleFeed.on_session_request), queue_size=10),
        Subscription("speed_change", SpeedChange, _fed(ConsoleFeed.on_speed_change), queue_size=50),
        Subscription("speed_limit_in_force", SpeedLimitInForce, MqttPlanner.on_speed, queue_size=1),
    ),
)
FILE = ConfigFile(lambda _given: BROKER, has_link)
NODE = NodeShell("mqtt_planner", Settings, start, INTERFACE, file=FILE)


def main() -> None:
    """Run the node."""
    NODE.run()
