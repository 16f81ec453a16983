"""Steps that experiment and scenario share at a running cell: wait, record, plan, detect rest."""

from __future__ import annotations

import signal
import subprocess
import time
import xmlrpc.client
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import rosgraph
import roslib.packages
import rospy
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.units import from_wire
from construction_twin.msg import Execution
from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.robot_client import RobotListener
from construction_twin.srv import PlanToJoints, PlanToJointsResponse

_Found = TypeVar("_Found")
_POLL = 0.005


class RestDetector:
    """Detects a pose that stayed for `rest_time` [s] within `tolerance` [rad], [m] of where it began."""

    def __init__(self, tolerance: float, rest_time: float):
        self._tolerance = tolerance
        self._rest_time = rest_time
        self._pose: np.ndarray | None = None
        self._since = 0.0
        self.at_rest = False

    def update(self, stamp: float, position) -> None:
        """Add one pose, shape (n,) [rad], measured at `stamp` [s]."""
        position = np.asarray(position, dtype=float)
        if self._pose is None or np.abs(position - self._pose).max() > self._tolerance:
            self._pose, self._since = position, stamp
        self.at_rest = stamp - self._since >= self._rest_time


class CellDriver:
    """Operates a running cell as a person would.

    Args:
        name: Who asks for plans.
        timeout: Longest wait for the system, a service, the recorder [s].
    """

    def __init__(self, name: str, robot: RobotModel, console: Console, timeout: float):
        self._name, self._robot, self._console, self._timeout = name, robot, console, timeout
        self.listener = RobotListener(rospy.get_namespace(), robot)

    @property
    def execution(self) -> Execution:
        """The executor's newest report."""
        return self.listener.newest("execution") or Execution()

    def print_line(self, text: str) -> None:
        """Print a line, however long."""
        self._console.print(text, soft_wrap=True)

    def wait(self, condition: Callable[[], _Found], what: Callable[[], str], deadline: float | None = None) -> _Found:
        """Return what `condition` returns as soon as it is true; else raise ConstructionTwinError, by default after the timeout.

        `deadline` is on the monotonic clock [s].
        """
        deadline = time.monotonic() + self._timeout if deadline is None else deadline
        while not (found := condition()):
            if time.monotonic() > deadline:
                raise ConstructionTwinError(f"waited in vain for {what()}")
            if rospy.is_shutdown():
                raise ConstructionTwinError("interrupted")
            time.sleep(_POLL)
        return found

    def wait_until_ready(self, *services: str) -> None:
        """Wait until a plan could be approved, and its services are there."""
        self.print_line("waiting for a ready system")
        self.wait(lambda: not self._not_ready(), lambda: f"a ready system: {'; '.join(self._not_ready())}")
        for service in ("plan_to_joints", *services):
            rospy.wait_for_service(service, self._timeout)

    def _not_ready(self) -> list[str]:
        silent = [] if self.listener.newest("link") is not None else ["link is silent"]
        return silent + self.listener.snapshot().not_ready()

    def plan(self, goal_deg: Sequence[float], duration: float, waypoints: int = 0) -> PlanToJointsResponse:
        """Request a plan of a motion [deg], [mm] from the twin's present pose."""
        answer = rospy.ServiceProxy("plan_to_joints", PlanToJoints)(
            goal=from_wire(goal_deg, self._robot.linear), duration=duration, waypoints=waypoints, source=self._name
        )
        if not answer.success:
            raise ConstructionTwinError(f"the motion could not be planned: {answer.message}")
        return answer

    @contextmanager
    def recording(self, bag: Path, topics: Sequence[str]) -> Iterator[None]:
        """Record topics of the robot while the block runs; once it has ended well the bag is closed."""
        resolved = [rospy.resolve_name(topic) for topic in topics]
        with Recorder(bag, resolved, rospy.resolve_name("recorder")) as recorder:
            self.wait(recorder.connected, lambda: "the recorder to connect")
            yield
            recorder.stop(self._timeout)


class Recorder:
    """A `rosbag record` process that records topics, by resolved names, while the ``with`` block runs, or until `stop`.

    It stays in the caller's process group, so that whatever ends the node (roslaunch, a terminal's Ctrl-C) ends it too.
    """

    def __init__(self, path: Path, topics: Sequence[str], name: str):
        programs = roslib.packages.find_node("rosbag", "record")
        if not programs:
            raise ConstructionTwinError("rosbag's recorder is not installed; install the package python3-rosbag")
        self.path = path
        self._topics = tuple(topics)
        self._name = name
        self._master = rosgraph.Master(name)
        namespace, _, base = name.rpartition("/")
        # --buffsize 0: no limit, so that a slow disk loses no samples
        options = ["--buffsize", "0", "-O", str(path), f"__name:={base}", f"__ns:={namespace or '/'}"]
        self._process = subprocess.Popen([programs[0], *options, *topics], stdout=subprocess.DEVNULL)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_) -> None:
        self._end(signal.SIGINT)

    def connected(self) -> bool:
        """Return whether every publisher of the topics sends to the recorder: they are asked, it counts a connection too early."""
        if self._process.poll() is not None:
            raise ConstructionTwinError(f"the recorder ended with status {self._process.returncode}; is the disk full?")
        try:
            publishers, subscribers, _ = self._master.getSystemState()
            subscribed = {topic for topic, nodes in subscribers if self._name in nodes}
            wanted = {(topic, node) for topic, nodes in publishers if topic in self._topics for node in nodes}
            return subscribed.issuperset(self._topics) and wanted <= self._sent_by({node for _, node in wanted})
        except (rosgraph.MasterException, rosgraph.MasterError, OSError, xmlrpc.client.Error):
            return False  # a node is still registering, or just left

    def _sent_by(self, nodes: set[str]) -> set[tuple[str, str]]:
        sent = set()
        for node in nodes:
            answer: Any = xmlrpc.client.ServerProxy(self._master.lookupNode(node)).getBusInfo(self._name)
            _, _, connections = answer
            for _, subscriber, direction, _, topic, connected, *_ in connections:
                if direction == "o" and subscriber == self._name and connected:
                    sent.add((topic, node))
        return sent

    def stop(self, timeout: float) -> None:
        """End the recording and wait until the bag is closed."""
        self._end(signal.SIGINT, timeout)
        if not self.path.exists():
            raise ConstructionTwinError(f"{self.path} was not closed within {timeout:g} s; see `rosbag reindex`")

    def _end(self, number: signal.Signals, timeout: float = 10.0) -> None:
        if self._process.poll() is None:
            self._process.send_signal(number)
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
