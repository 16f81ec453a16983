"""A robot's node as data: parameters, their check, topics, services and timers; `NodeIO` opens them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MethodType
from typing import Any, Generic, TypeVar

import rospy
from genpy.message import get_message_class  # type: ignore[attr-defined]
from sensor_msgs.msg import JointState

from construction_twin.core.errors import ConstructionTwinError, ExpiredError, ProtocolError
from construction_twin.core.freshness import TOO_OLD
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.shared.diagnostics import WARN, Diagnosis, NodeDiagnostics
from construction_twin.ros.shared.node import Service, run_node
from construction_twin.ros.shared.params import Parameters, Settings, read_parameters, robot_from_parameters
from construction_twin.ros.shared.start_refusal import expect_own_parameters, refuse
from construction_twin.ros.transport.joint_stream import QUEUE, JointPublisher, JointSubscriber
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.publisher import AnyPublisher, Publisher
from construction_twin.ros.transport.subscriber import Subscriber

_Topic = TypeVar("_Topic", bound="Publication | PosePublication | Subscription | PoseSubscription")
Refuse = Callable[[str, str], None]
#: Values of the shared parameters of an interface, by name.
Shared = Mapping[str, Any]
#: Takes the node's parameters; returns whether there is such a topic with them.
When = Callable[[Any], bool]


def always(_settings: Any) -> bool:
    """Return True: with any parameters."""
    return True


def has_arm(settings: Any) -> bool:
    """Return whether there is a physical arm, mock or real."""
    return settings.arm != "none"


def has_mass(settings: Any) -> bool:
    """Return whether the twin is an arm with mass: then it has a pose beside the commanded one."""
    return settings.twin != "kinematic"


def knows_servos(settings: Any) -> bool:
    """Return whether the arm is compared with a model of its servos."""
    return bool(settings.servo_model) and has_arm(settings)


@dataclass(frozen=True)
class SharedParameter:
    """A parameter of the robot, read once before the node is made; `written`: the node writes it for the process after it."""

    name: str
    default: object = None
    written: bool = False


@dataclass(frozen=True)
class Publication:
    """A topic that the node publishes; a `kind` by name, ``moveit_msgs/PlanningScene``, need not be installed."""

    topic: str
    kind: type | str
    queue_size: int
    latch: bool = False
    tcp_nodelay: bool = False
    when: When = always

    def open(self, _robot: RobotModel) -> AnyPublisher | None:
        """Return the publisher; None where its kind is not installed."""
        kind = get_message_class(self.kind) if isinstance(self.kind, str) else self.kind
        if kind is None:
            return None
        return Publisher(self.topic, kind, self.queue_size, latch=self.latch, tcp_nodelay=self.tcp_nodelay)


@dataclass(frozen=True)
class PosePublication:
    """Poses of the robot that the node publishes, as joint states or as `Feedback`."""

    topic: str
    kind: type = JointState
    when: When = always

    def open(self, robot: RobotModel) -> AnyPublisher:
        """Return the publisher."""
        return JointPublisher(self.topic, robot.joint_names, self.kind)


@dataclass(frozen=True)
class Subscription:
    """A topic that the node subscribes to; the handler takes node and message."""

    topic: str
    kind: type
    handler: Callable[[Any, Any], object]
    queue_size: int
    tcp_nodelay: bool = False
    when: When = always

    def open(self, handler: Callable[..., object], _robot: RobotModel, refuse: Refuse) -> Subscriber:
        """Return the subscriber, with a handler that knows its node."""
        return Subscriber(self.topic, self.kind, handler, refuse, self.queue_size, self.tcp_nodelay)


@dataclass(frozen=True)
class PoseSubscription:
    """Poses that the node subscribes to; `handler(node, stamp [ns], positions [rad])`, of `Feedback` also seq, command stamp."""

    topic: str
    handler: Callable[..., object]
    queue_size: int = QUEUE
    kind: type = JointState
    pause: float = 0.0
    when: When = always

    def open(self, handler: Callable[..., object], robot: RobotModel, refuse: Refuse) -> JointSubscriber:
        """Return the subscriber, with a handler that knows its node."""
        return JointSubscriber(self.topic, robot.joint_names, handler, refuse, self.queue_size, self.kind, self.pause)


@dataclass(frozen=True)
class PolledPose:
    """A topic of poses, of which the node polls the newest (`LatestPose`)."""

    topic: str
    when: When = always


@dataclass(frozen=True)
class Served:
    """A service, whose answer has `success`, `message` and what else its kind has; a typed error of the handler is a refusal.

    `reason`: as what a refusal is counted that has none of its own, "": its type. `refused`: returns further fields of a refusal.
    """

    name: str
    kind: type
    handler: Callable[[Any, Any], Outcome | str]
    reason: str | Callable[[Any], str] = ""
    refused: Callable[[Any, Any], Mapping[str, object]] = lambda _node, _request: {}

    def answer(self, node: Any, refuse: Refuse, request: Any) -> Any:
        """Return the response: the one place where a refusal becomes an answer, is counted, and written to the log later."""
        try:
            done = self.handler(node, request)
        except ConstructionTwinError as error:
            expired, own = isinstance(error, ExpiredError), error.reason if isinstance(error, ProtocolError) else ""
            given = self.reason if isinstance(self.reason, str) else self.reason(request)
            refuse(TOO_OLD if expired else own or given or type(error).__name__, str(error))
            done = Outcome(False, str(error), expired, self.refused(node, request))
        return (Outcome(True, done) if isinstance(done, str) else done).response(self.kind)


@dataclass(frozen=True)
class NodeTimer:
    """A timer of the node: `period` takes its parameters [s], `act` the node."""

    period: Callable[[Any], float]
    act: Callable[[Any], object]


@dataclass(frozen=True)
class Interface:
    """All that a node has to do with ROS; `listeners`: topics that collaborators hear; without `diagnose` it refuses nothing."""

    diagnose: Callable[[Any], Diagnosis] | None = None
    parameters: tuple[SharedParameter, ...] = ()
    publishes: tuple[Publication | PosePublication, ...] = ()
    polls: tuple[PolledPose, ...] = ()
    subscribes: tuple[Subscription | PoseSubscription, ...] = ()
    listeners: tuple[str, ...] = ()
    serves: tuple[Served, ...] = ()
    timers: tuple[NodeTimer, ...] = ()

    def shared(self, parameters: Parameters) -> dict[str, Any]:
        """Return the values of the shared parameters, by name."""
        return {each.name: parameters.get_param(each.name, each.default) for each in self.parameters}


class NodeIO:
    """A node's topics and services, opened so that nothing arrives before it can be handled.

    Publishers and polled poses are there before the node is made, then come subscriptions, services last. `parameters`: the
    shared ones by name; `publishers`, `poses`: by topic, without what is not there with these parameters.
    """

    def __init__(self, interface: Interface, settings: Any, robot: RobotModel):
        self._interface, self._settings, self._robot = interface, settings, robot
        self._node: object = None
        self.parameters = interface.shared(rospy)
        self._diagnostics = None
        if interface.diagnose is not None:
            self._diagnostics = NodeDiagnostics(robot.name, self._diagnose)
        opened = ((each.topic, each.open(robot)) for each in interface.publishes if each.when(settings))
        self.publishers: dict[str, AnyPublisher] = {
            topic: publisher for topic, publisher in opened if publisher is not None
        }
        polls = [each.topic for each in interface.polls if each.when(settings)]
        self.poses = {topic: LatestPose(topic, robot.joint_names, self.diagnostics.refuse) for topic in polls}
        self._subscribers: dict[str, Subscriber] = {}

    @property
    def diagnostics(self) -> NodeDiagnostics:
        """Where the node counts what it refuses; only of one that reports."""
        assert self._diagnostics is not None  # it reports
        return self._diagnostics

    def parameter_writer(self, name: str) -> Callable[[Any], None]:
        """Return the writer of a shared parameter that is `written`; it may take as long as the master does."""
        assert any(each.written for each in self._interface.parameters if each.name == name), name
        return partial(rospy.set_param, name)

    def connect(self, node: object) -> None:
        """Open subscriptions, services and timers."""
        self._node = node
        for each in self._interface.subscribes:
            if each.when(self._settings):
                opened = each.open(MethodType(each.handler, node), self._robot, self.diagnostics.refuse)
                if isinstance(opened, Subscriber):
                    self._subscribers[each.topic] = opened
        for served in self._interface.serves:
            Service(served.name, served.kind, partial(served.answer, node, self.diagnostics.refuse))
        for timer in self._interface.timers:
            rospy.Timer(rospy.Duration(timer.period(self._settings)), self._timer_callback(timer.act))

    def connections(self, topic: str) -> int:
        """Return how many publishers of a subscribed topic are connected; 0 before `connect`."""
        subscriber = self._subscribers.get(topic)
        return subscriber.get_num_connections() if subscriber is not None else 0

    def unsubscribe(self, topic: str) -> None:
        """Unsubscribe from a topic."""
        self._subscribers.pop(topic).unregister()

    def _timer_callback(self, act: Callable[[Any], object]) -> Callable[[object], object]:
        # at shutdown silence is no news: the other nodes end as well
        return lambda _event: rospy.core.is_shutdown_requested() or act(self._node)

    def _diagnose(self) -> Diagnosis:
        if self._node is None or self._interface.diagnose is None:
            return Diagnosis(WARN, "this node starts")
        return self._interface.diagnose(self._node)


@dataclass(frozen=True)
class NodeShell(Generic[Settings]):
    """One robot's node, as its process starts it and as `preflight` checks it before anything starts.

    `check` raises a ConstructionTwinError where it cannot work, and changes nothing. `fast`: on the 250 Hz path.
    """

    name: str
    settings: type[Settings]
    start: Callable[[Settings, RobotModel, NodeIO], object]
    interface: Interface
    check: Callable[[Settings, RobotModel, Shared], object] = lambda *_: None
    fast: bool = False
    refused: Callable[[str], object] = refuse

    def checked_parameters(self, parameters: Parameters = rospy) -> tuple[Settings, RobotModel]:
        """Return the node's parameters; ConstructionTwinError refuses its start."""
        settings, robot = read_parameters(self.settings, parameters), robot_from_parameters(parameters=parameters)
        self.check(settings, robot, self.interface.shared(parameters))
        return settings, robot

    def run(self) -> None:
        """Be the node's process."""
        if self.fast:
            sys.setswitchinterval(0.001)
        run_node(self.name, self._start, self.refused)

    def _start(self) -> object:
        found = self.checked_parameters()
        expect_own_parameters()
        return self.open(*found)

    def open(self, settings: Settings, robot: RobotModel) -> Any:
        """Return the node, with its topics, services and timers open."""
        node_io = NodeIO(self.interface, settings, robot)
        node = self.start(settings, robot, node_io)
        node_io.connect(node)
        return node
