"""mqtt_review: the plan under review on MQTT, and verdicts from there to `review_plan`. A node of its own: the bridge has 4 ms."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections import Counter

import pydantic
import rospy

from construction_twin.core.errors import PayloadError
from construction_twin.link.remote_review import PlanBoard, PlanView, RemoteReview, parse_review, review_answer
from construction_twin.mqtt.client import make_client, subscriptions, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.msg import Link, Plan, Review
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics
from construction_twin.ros.shared.mqtt_connection import MqttSettings, broker_of, report_of
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters
from construction_twin.srv import ReviewPlan

#: Verdicts that may wait while one is carried out; a tablet sends one at a time.
WAITING = 8
#: Longest wait for `review_plan` to exist [s].
SERVICE_TIMEOUT = 1.0
#: How often the node looks whether the broker holds what it should [s].
CHECK_PERIOD = 1.0


class Settings(MqttSettings):
    """Private parameters; see config/mqtt_review.yaml."""

    path_points: int = pydantic.Field(ge=2, le=1000)


class MqttReviewNode:
    """ROS and MQTT around a PlanBoard; `_lock` guards it, because ROS serves every topic from a thread of its own."""

    def __init__(self):
        self._settings = read_parameters(Settings)
        robot = robot_from_parameters()
        self._board = PlanBoard()
        self._lock = threading.Lock()
        self._session: str | None = None
        self._seen = b""
        self._checked_at = 0.0
        self._reviews: queue.Queue[RemoteReview] = queue.Queue(WAITING)
        self._verdicts: Counter[str] = Counter()
        self._diagnostics = NodeDiagnostics(robot.name, self._report)
        self._topics = Topics(self._settings.prefix, robot.name)
        self._review_plan = rospy.ServiceProxy("review_plan", ReviewPlan)
        self._client = self._connect(robot.name)
        rospy.Subscriber("plan", Plan, self._on_plan, queue_size=5)
        rospy.Subscriber("review", Review, self._on_verdict, queue_size=10)
        rospy.Subscriber("link", Link, self._on_link, queue_size=5)

    def run(self) -> None:
        """Carry out verdicts until shutdown."""
        while not rospy.is_shutdown():
            try:
                self._carry_out(self._reviews.get(timeout=0.2))
            except queue.Empty:
                self._check_plan()
        self._client.publish(self._topics.plan, b"", qos=1, retain=True)
        self._client.disconnect()
        self._client.loop_stop()

    # -- ROS to MQTT

    def _on_plan(self, message: Plan) -> None:
        payload = plan_view(message).to_json(self._settings.path_points)
        with self._lock:
            self._board.on_plan(message.id, payload)
        self._publish_plan()

    def _on_verdict(self, message: Review) -> None:
        with self._lock:
            self._board.on_verdict(message.plan_id)
        self._publish_plan()

    def _on_link(self, message: Link) -> None:
        if message.session and message.session != self._session:
            if self._session is not None:
                with self._lock:
                    self._board.restart()
                self._publish_plan()
            self._session = message.session

    def _publish_plan(self) -> None:
        if self._client.is_connected():
            self._client.publish(self._topics.plan, self._board.payload, qos=1, retain=True)

    def _check_plan(self) -> None:
        """Publish again when the broker holds something else: the late last will of a predecessor takes our plan away."""
        now = time.monotonic()
        if now - self._checked_at < CHECK_PERIOD:
            return
        self._checked_at = now
        if self._seen != self._board.payload:
            self._publish_plan()

    # -- MQTT to ROS

    def _connect(self, robot: str):
        broker = broker_of(self._settings)
        # as the last will, nothing: without this node nobody hears a verdict, so there is nothing to review
        client = make_client(broker, unique_id(robot, "review"), self._topics.plan, will="")
        self._connection = report_of(broker)
        self._connection.watch(client)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.message_callback_add(self._topics.review, self._on_review)
        client.message_callback_add(self._topics.plan, self._on_own_plan)
        client.connect_async(broker.host, broker.port, broker.keepalive)
        client.loop_start()
        return client

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        if reason_code.is_failure:
            self._connection.refused(reason_code)
            return
        self._connection.connected()
        self._seen = b""
        client.subscribe(subscriptions(client, [(self._topics.review, 1), (self._topics.plan, 1)]))
        info = client.publish(self._topics.plan, self._board.payload, qos=1, retain=True)
        self._connection.watch_publish(client, self._topics.plan, info.mid)

    def _on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        self._connection.lost(reason_code)

    def _on_own_plan(self, client, userdata, message) -> None:
        self._seen = message.payload

    def _on_review(self, client, userdata, message) -> None:
        try:
            review = parse_review(message.payload, message.retain)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            self._answer(None, False, str(error))
            return
        try:
            self._reviews.put_nowait(review)
        except queue.Full:
            sentence = f"{WAITING} verdicts are waiting already; try again"
            self._diagnostics.refuse("busy", sentence)
            self._answer(review, False, sentence)

    def _carry_out(self, review: RemoteReview) -> None:
        try:
            rospy.wait_for_service(self._review_plan.resolved_name, SERVICE_TIMEOUT)
            answer = self._review_plan(
                review.plan_id, review.plan_hash, review.approves, review.reviewer, _reason(review)
            )
            ok, sentence = answer.success, answer.message
        except (rospy.ServiceException, rospy.ROSException) as error:
            ok, sentence = False, f"{self._review_plan.resolved_name} does not answer: {error}; does the executor run?"
        self._verdicts["taken" if ok else "not taken"] += 1
        rospy.loginfo("%s of plan %s by %s: %s", review.verdict, review.plan_id, review.reviewer, sentence)
        self._answer(review, ok, sentence)

    def _answer(self, review: RemoteReview | None, ok: bool, sentence: str) -> None:
        self._client.publish(self._topics.review_ack, review_answer(review, ok, sentence), qos=1)

    # -- reports

    def _report(self) -> tuple[int, str, dict]:
        values = {f"verdicts {name}": count for name, count in sorted(self._verdicts.items())}
        if not self._client.is_connected():
            return WARN, self._connection.sentence or "connecting to the broker", values
        return OK, "a plan is shown" if self._board.payload else "no plan to review", values


def _reason(review: RemoteReview) -> str:
    """Return the reviewer's words, marked: what came by MQTT was not said at this machine."""
    return f"by MQTT: {review.reason}" if review.reason else "by MQTT"


def plan_view(message: Plan) -> PlanView:
    """Return what is shown of a plan; what a planner has not measured is left empty.

    Numbers cross unchanged. Every measured plan has its fractions of the velocity limits, so their absence means that none was.
    """
    points = message.trajectory.points
    clearance = None
    if message.velocity_use:
        clearance = {
            "distance": message.clearance if math.isfinite(message.clearance) else None,
            "time": message.clearance_time,
            "between": list(message.clearance_between),
            "point": _xyz(message.clearance_point),
        }
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
        joint_names=message.trajectory.joint_names,
        start=points[0].positions if points else (),
        goal=points[-1].positions if points else (),
        tool_path=[_xyz(point) for point in message.tool_path],
        clearance=clearance,
        use={
            "velocity": message.velocity_use,
            "acceleration": message.acceleration_use,
            "jerk": message.jerk_use,
        },
    )


def _xyz(point) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def main() -> None:
    """Run the node."""
    run_node("mqtt_review", MqttReviewNode)
