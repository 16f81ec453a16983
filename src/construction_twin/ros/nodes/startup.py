"""startup: ends a start that cannot work, and logs what a start waits for, until all is there."""

from __future__ import annotations

import difflib
import os
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import rosgraph
import rospy

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.share import share_folder
from construction_twin.msg import Feedback, Scene, StartRefused
from construction_twin.robot.description import RobotModel, other_joints_text
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, Diagnosis, warn_of_refusals
from construction_twin.ros.shared.robot_client import REPORTS, RobotListener
from construction_twin.ros.shared.start_refusal import RESTART_DELAY, TOPIC, launch_id
from construction_twin.ros.transport.subscriber import Subscriber, caller_of
from construction_twin.validation import StrictModel
from construction_twin.views.startup import Deployment, ReportedState, StartUp, StartupInputs

#: How often it checks [s].
PERIOD = 0.25
#: How long other nodes are listened to, once one has refused to start [s].
COLLECT = 0.7
#: So long after this node's start another one that loads slowly may still refuse the launch's, where nothing was played yet [s].
LATE = 60.0
#: How long a connection of this machine to itself may take [s].
ADDRESS_TIME = 2.0
#: Topics of which one message is enough.
FEEDBACK, TWIN, SCENE = "physical/feedback", "twin/joint_states", "scene"


class Settings(StrictModel):
    """Private parameters, given in launch/bringup.launch: see `startup.Deployment`."""

    arm: Literal["mock", "real", "none"]
    broker: str
    rsi: str
    gateway: bool
    gateway_kind: Literal["rsi", "plc"] = "rsi"
    console: bool = False
    gui: bool | Literal["marker"] = False


class Refusals:
    """Collects which nodes of this launch cannot start."""

    def __init__(self) -> None:
        #: When each node has said each sentence last [s].
        self._nodes: dict[str, dict[str, float]] = {}
        above = rosgraph.names.namespace(rospy.get_namespace())
        for topic in (TOPIC, f"{above}{TOPIC}"):
            Subscriber(topic, StartRefused, self._on_refused, warn_of_refusals(), queue_size=50)

    def add(self, node: str, sentence: str) -> None:
        """Record why a node cannot start."""
        # without what rospy put behind an anonymous name
        self._nodes.setdefault(sentence, {})[re.sub(r"_\d+_\d{13}$", "", node)] = time.monotonic()

    def _on_refused(self, message: StartRefused) -> None:
        if message.launch == launch_id():
            self.add(caller_of(message), message.sentence)

    @property
    def sentences(self) -> list[str]:
        """Each sentence once, with the nodes that say it; a node that has not repeated it has started since."""
        since = time.monotonic() - 2.0 * RESTART_DELAY
        nodes = {
            sentence: sorted(node for node, at in dict(said).items() if at > since)
            for sentence, said in dict(self._nodes).items()
        }
        return [f"cannot start: {sentence} ({', '.join(names)})" for sentence, names in nodes.items() if names]

    def end_launch(self) -> None:
        """Print all sentences, and end the process: the node is required, so roslaunch ends all others."""
        for sentence in self.sentences:
            print(sentence, file=sys.stderr, flush=True)
        sys.exit(1)


class StartupNode:
    """ROS around a StartUp."""

    def __init__(
        self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO, clock: Callable[[], float] = time.monotonic
    ):
        namespace = rospy.get_namespace().rstrip("/")
        named = settings.model_dump(exclude={"console", "gui"})
        self._startup = StartUp(Deployment(namespace=namespace, **named))
        self._refusals, self._refused = Refusals(), threading.Event()
        self._logged: set[str] = set()
        self._clock, self._began = clock, clock()
        self._is_over = False
        #: Topics of which a message has come.
        self.came: set[str] = set()
        others = other_joints_text(robot.other_joints, robot.base_link, robot.tip_link)
        if others:
            rospy.loginfo("%s", others)
        if settings.gateway_kind == "plc" and settings.arm == "real":
            rospy.logwarn(
                "gateway_kind:=plc with arm:=real: a bare PLC is commanded by joint strings alone. "
                "Configuration, session, sequence and age of strings, stops and speed limits are not "
                "checked, on neither side; a person is responsible for that, by name: `rosrun "
                "construction_twin twin arm --responsible NAME`. Read docs/broker.md first"
            )
        self._listener = RobotListener(namespace, robot)
        self._node_io = node_io
        self._unsubscribed: set[str] = set()

    def run(self) -> None:
        """Wait for the end of ROS, or end the launch: only at its start, so that no arm is left in the midst."""
        while not rospy.core.is_shutdown_requested():
            if self._refused.wait(PERIOD):
                time.sleep(COLLECT)  # for the others, who find the same
                if not self._is_over:
                    self._refusals.end_launch()
                self._refused.clear()

    def update(self) -> None:
        """Log what has changed."""
        now, snapshot = self._clock(), self._listener.snapshot()
        state = snapshot.execution.text if snapshot.execution is not None else "WAITING"
        self._is_over = self._is_over or now - self._began > LATE or state not in ("WAITING", "IDLE")
        if self._refusals.sentences and not self._is_over:
            self._refused.set()
            return
        for sentence in set(self._refusals.sentences) - self._logged:
            self._logged.add(sentence)
            rospy.logerr("%s", sentence)
        for topic in self.came - self._unsubscribed:
            self._unsubscribed.add(topic)
            self._node_io.unsubscribe(topic)  # one message of a 250 Hz stream is enough
        reports = {"link": snapshot.link, "sync": snapshot.sync, "execution": snapshot.execution}
        # a node that fell silent is not there
        words = {
            name: ReportedState(facts.text, facts.reason, getattr(facts, "gateway_state", ""))
            for name, facts in reports.items()
            if facts is not None and name not in snapshot.silent
        }
        link, sync, execution = (words.get(name) for name in reports)
        feedback, twin, scene = (topic in self.came for topic in (FEEDBACK, TWIN, SCENE))
        inputs = StartupInputs(link, sync, execution, feedback, twin, scene)
        for line in self._startup.update(inputs, now):
            waits = self._startup.missing is not None
            (rospy.logwarn if waits else rospy.loginfo)("%s", line)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        if sentences := self._refusals.sentences:
            return Diagnosis(ERROR, "; ".join(sentences))
        missing = self._startup.missing
        return Diagnosis(OK, "ready") if missing is None else Diagnosis(WARN, str(missing))


def expect_reachable(environ: Mapping[str, str]) -> None:
    """Raise a ConfigurationError where ROS_HOSTNAME, else ROS_IP, else the machine's name leads no node of it to another."""
    if environ.get("ROS_IPV6") == "on":
        return
    variable = next((name for name in ("ROS_HOSTNAME", "ROS_IP") if name in environ), "")
    own, why = environ[variable] if variable else rosgraph.network.get_host_name(), "it is empty"
    with socket.create_server(("", 0)) as server:
        try:
            if own:
                found = socket.getaddrinfo(own, None, socket.AF_INET, socket.SOCK_STREAM)
                address = str(found[0][4][0]), server.getsockname()[1]
                return socket.create_connection(address, ADDRESS_TIME).close()
        except (OSError, UnicodeError) as error:
            why = f"it leads to no program here ({getattr(error, 'strerror', None) or str(error)})"
    to_do = f"an address of this machine, or unset {variable}"
    if not variable:
        to_do = "a name that /etc/hosts has beside 127.0.1.1, or ROS_IP set to an address of this machine"
    raise ConfigurationError(variable or "this machine's name", own, f"{to_do}: {why}")


def expect_known(words: list[str]) -> None:
    """Raise a ConfigurationError about an argument on roslaunch's command line that no launch file of this package knows."""
    files = list((share_folder() / "launch").glob("*.launch"))
    if "construction_twin" not in words and not {str(file) for file in files} & set(words):
        return
    known = {name for file in files for name in re.findall(r'<arg name="(\w+)"\s+default=', file.read_text())}
    for word in words:
        name, assigned, value = word.partition(":=")
        if assigned and not name.startswith("_") and name not in known:
            near = "".join(f"; did you mean {each}:=?" for each in difflib.get_close_matches(name, known, n=1))
            raise ConfigurationError(name, value, f"an argument that `roslaunch --ros-args` lists{near}")


def check(settings: Settings, robot: RobotModel, *_: object) -> None:
    """Check addresses, roslaunch's arguments, and nodes that would start beside a missing one."""
    expect_reachable(os.environ)
    expect_known(_words_of_parent())
    if settings.gateway_kind == "plc" and settings.arm == "mock" and any(robot.linear):
        expected = "rsi with track:=true: the PLC of examples/plc, which is the mock arm then, has no track"
        raise ConfigurationError("gateway_kind", "plc", expected)
    if settings.console and settings.arm == "none":
        expected = "false with arm:=none: nothing is sent by MQTT then, and the page would stay empty"
        raise ConfigurationError("console", True, expected)


def _words_of_parent() -> list[str]:
    words = Path(f"/proc/{os.getppid()}/cmdline").read_bytes().decode(errors="replace").split("\0")
    return words if any(Path(word).name == "roslaunch" for word in words[:2]) else []


def refused(sentence: str) -> None:
    """End the launch with the sentences of all nodes."""
    refusals = Refusals()
    refusals.add(rospy.get_name(), sentence)
    time.sleep(COLLECT)
    refusals.end_launch()


INTERFACE = shell.Interface(
    diagnose=StartupNode.diagnose,
    subscribes=(
        shell.Subscription(FEEDBACK, Feedback, lambda node, _: node.came.add(FEEDBACK), queue_size=1),
        shell.Subscription(TWIN, rospy.AnyMsg, lambda node, _: node.came.add(TWIN), queue_size=1),
        shell.Subscription(SCENE, Scene, lambda node, _: node.came.add(SCENE), queue_size=1),
    ),
    listeners=(*REPORTS, TOPIC),
    timers=(shell.NodeTimer(lambda _settings: PERIOD, StartupNode.update),),
)
NODE = shell.NodeShell("startup", Settings, StartupNode, INTERFACE, check, refused=refused)
main = NODE.run
