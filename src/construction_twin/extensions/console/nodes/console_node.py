"""console_node: the robot's state by MQTT, and requests of operators and programs elsewhere.

A node of its own: reading a long motion takes longer than the bridge's 4 ms, and checking one takes seconds.
"""

from __future__ import annotations

import gc
import secrets
import threading
import time
from collections.abc import Callable
from typing import Any

import pydantic
import rospy

from construction_twin import msg, srv
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.feed import ARM, EXPECTED, TWIN, ConsoleFeed, deployment_of
from construction_twin.extensions.console.nodes.requests import Acts, ConsoleRequests, Services
from construction_twin.extensions.console.nodes.shown_plan import ShownPlan
from construction_twin.extensions.console.private_files import PrivateFiles
from construction_twin.extensions.console.remote_view import ViewWriter
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import make_client, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import BRIDGE, PRESSED
from construction_twin.robot.description import RobotModel
from construction_twin.robot.tool import tool_hash
from construction_twin.ros.messages.services import PLAN_SERVICES
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.mqtt_connection import MqttSettings, broker_of, check_broker
from construction_twin.ros.shared.node_shell import (
    Interface,
    NodeIO,
    NodeShell,
    PolledPose,
    SharedParameter,
    Subscription,
)
from construction_twin.ros.shared.params import ros_home
from construction_twin.ros.transport.persistent_service import PersistentService

#: Between two writings of log and messages [s].
LOG_PERIOD = 0.1
#: Objects after which the garbage collector looks through them. It holds up every thread, a stop's too: while a motion of 2 MiB was
#: read, by Python's 700, for 200 ms at once, and it takes four times as long to read.
COLLECTED = 500_000


class Settings(MqttSettings):
    """Private parameters; see config/console_node.yaml. Folders are relative to ROS_HOME, empty: none."""

    trajectories: bool = True
    private: str = ""
    messages: str = ""
    servo_model: str = ""
    tool: str = ""
    max_trajectory_bytes: int = pydantic.Field(ge=1024, le=1 << 24)
    view_rate: float = pydantic.Field(ge=1.0, le=50.0)


class ConsoleNode:
    """The parts of the node, and the threads in which they work."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: NodeIO):
        self._settings = settings
        joints, topics = Joints(tuple(robot.joint_names), tuple(robot.linear)), Topics(settings.prefix, robot.name)
        broker, refuse = broker_of(settings), node_io.diagnostics.refuse
        files = None
        if settings.private:
            files = PrivateFiles(ros_home() / settings.private, robot.name)
            for problem in files.write_robot(robot.urdf):
                refuse("mesh", problem)
            if node_io.parameters["work"] is None:
                files.drop_building()
        # its last will clears the plan: while it is lost, no verdict arrives
        client = make_client(broker, unique_id(robot.name, "acts"), topics.plan, will="")
        acts_connection = Connection(broker, client, topics, refuse)
        writer = ViewWriter(robot.name, secrets.token_hex(8), joints)
        will = writer.offline().decode()
        client = make_client(broker, unique_id(robot.name, "console"), topics.view, will, will_retained=False)
        connection = Connection(broker, client, topics, refuse)
        # one for what people do, and one for everything else
        self._connections = acts_connection, connection
        self.acts = Acts(acts_connection, _services())
        self.shown_plan = ShownPlan(acts_connection, tool_hash(settings.tool))
        self.feed = feed = ConsoleFeed(
            robot.base_link,
            connection,
            writer,
            node_io.poses,
            lambda: self.shown_plan.plan,
            lambda: node_io.connections("execution") > 0,
            deployment_of(node_io.parameters["startup"], rospy.get_namespace().rstrip("/")),
            files,
            ros_home() / settings.messages / f"{robot.name}.json" if settings.messages else None,
        )
        self.requests = ConsoleRequests(
            joints,
            {kind: rospy.ServiceProxy(service.name, service.kind) for kind, service in PLAN_SERVICES.items()},
            rospy.ServiceProxy("plan_trajectory", srv.PlanTrajectory),
            connection,
            settings.max_trajectory_bytes if settings.trajectories else 0,
            lambda: node_io.connections("work/tasks") > 0,
            feed.is_engaged,
        )
        self._connect()

    def _connect(self) -> None:
        plan, (acts, others) = self.shown_plan, self._connections
        own_plan = {acts.topics.plan: lambda message: plan.on_own_plan(bytes(message.payload))}
        acts.connect(plan.first, plan.publish_rehearsal, own_plan)
        others.connect(self.feed.first, self.feed.republish_retained)

    def run(self) -> None:
        """Carry out requests, and publish the state, until shutdown."""
        self.acts.start()
        viewer = threading.Thread(target=self.run_view, name="view", daemon=True)
        for each in (
            threading.Thread(target=self.acts.run_connections, name="connections", daemon=True),
            threading.Thread(target=self._run_log, name="log", daemon=True),
            viewer,
        ):
            each.start()
        while not rospy.is_shutdown():
            self.requests.queue.run(0.2)
        viewer.join(1.0)
        self.shown_plan.clear_retained()
        self.feed.publish_offline()
        for connection in self._connections:
            connection.disconnect()

    def run_view(self) -> None:
        """Show everything `view_rate` times a second."""
        period = 1.0 / self._settings.view_rate
        due = time.monotonic()
        while not rospy.is_shutdown():
            self.feed.publish_view()
            self.feed.publish_status_line()
            self.shown_plan.check()
            # after a pause of the machine the next one is a whole period away: nobody needs what was missed
            due = max(due + period, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))

    def _run_log(self) -> None:
        """Write log and messages: nothing else here waits for a disk or a terminal."""
        while not rospy.is_shutdown():
            self.write()
            time.sleep(LOG_PERIOD)

    def write(self) -> None:
        """Write what waits to be written."""
        for connection in self._connections:
            connection.write_log()
        self.feed.messages.write()

    # -- from ROS, what several parts hear

    def on_plan(self, message: msg.Plan) -> None:
        """Show a plan for review."""
        self.shown_plan.on_plan(message)
        self.feed.on_plan(message)

    def on_review(self, message: msg.Review) -> None:
        """Clear the decided plan, and add its message."""
        self.shown_plan.on_review(message)
        self.feed.on_review(message, self.shown_plan.rehearsal)

    def on_link(self, message: msg.Link) -> None:
        """Store the bridge's report, and follow its session."""
        self.shown_plan.on_link(message)
        self.feed.on_link(message)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        values: dict[str, object] = {"trajectories waiting": self.requests.queue.waiting}
        for connection in reversed(self._connections):
            values |= connection.status_fields()
        failed = [connection.side_effects.sentence for connection in self._connections]
        if problem := next(filter(None, (*failed, *(connection.fault for connection in self._connections))), ""):
            return Diagnosis(WARN, problem, values)
        shown = "a plan is shown" if self.shown_plan.plan else "no plan to review"
        taken = "are taken" if self._settings.trajectories else "are not taken (trajectories: false)"
        return Diagnosis(OK, f"{shown}; trajectories {taken}", values)


def _services() -> Services:
    """Return the services of people's acts; those that start nothing have an open connection, and may be called twice."""
    pressed = {
        kind.name: (rospy.ServiceProxy if kind.starts else PersistentService)(
            f"{'mqtt_bridge' if kind.by == BRIDGE else 'executor'}/act_as_seen", srv.ActAsSeen
        )
        for kind in PRESSED
    }
    return Services(
        rospy.ServiceProxy("review_plan", srv.ReviewPlan),
        PersistentService("review_plan", srv.ReviewPlan),
        pressed,
        rospy.ServiceProxy("work/decide", srv.WorkDecide),
        PersistentService("limit_speed", srv.LimitSpeed),
    )


def _forward_to(part: str, handler: str) -> Callable[[ConsoleNode, Any], object]:
    """Return a handler that forwards a message to a part of the node."""
    return lambda node, message: getattr(getattr(node, part), handler)(message)


INTERFACE = Interface(
    diagnose=ConsoleNode.diagnose,
    parameters=(SharedParameter("work"), SharedParameter("startup")),
    polls=(
        PolledPose(TWIN),
        PolledPose(ARM),
        PolledPose(EXPECTED, when=lambda settings: bool(settings.servo_model)),
    ),
    subscribes=(
        Subscription("execution", msg.Execution, _forward_to("feed", "on_execution"), queue_size=10),
        Subscription("work/tasks", msg.WorkTasks, _forward_to("feed", "on_tasks"), queue_size=2),
        Subscription("scene", msg.Scene, _forward_to("feed", "on_scene"), queue_size=2),
        Subscription("plan", msg.Plan, ConsoleNode.on_plan, queue_size=5),
        Subscription("rehearsal", msg.Rehearsal, _forward_to("shown_plan", "on_rehearsal"), queue_size=5),
        Subscription("plan_caller", msg.PlanCaller, _forward_to("shown_plan", "on_caller"), queue_size=5),
        Subscription("review", msg.Review, ConsoleNode.on_review, queue_size=10),
        Subscription("sync", msg.Sync, _forward_to("feed", "on_sync"), queue_size=1),
        Subscription("hold", msg.Hold, _forward_to("feed", "on_hold"), queue_size=1),
        Subscription("link", msg.Link, ConsoleNode.on_link, queue_size=5),
        Subscription("session_request", msg.SessionRequest, _forward_to("feed", "on_session_request"), queue_size=10),
        Subscription("speed_change", msg.SpeedChange, _forward_to("feed", "on_speed_change"), queue_size=50),
        Subscription("speed_limit_in_force", msg.SpeedLimitInForce, _forward_to("feed", "on_speed"), queue_size=1),
    ),
)
# its threads take turns every millisecond: what computes a pose holds up no stop
NODE = NodeShell("console_node", Settings, ConsoleNode, INTERFACE, check_broker, fast=True)


def main() -> None:
    """Run the node."""
    gc.freeze()
    gc.set_threshold(COLLECTED)
    NODE.run()
