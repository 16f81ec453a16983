"""The experiment: waits for a ready system, records, has the task planned and played, evaluates the recording."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
import rosgraph
import roslib.packages
import rospy
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError, command_message
from construction_twin.core.files import check_writable
from construction_twin.core.units import from_wire
from construction_twin.evaluation.bag import read_recording
from construction_twin.evaluation.report import Report, write_report
from construction_twin.evaluation.tables import render_tables, table_console
from construction_twin.msg import Execution, Feedback
from construction_twin.robot.description import RobotModel
from construction_twin.ros.commands.evaluate import print_files
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.master import await_master
from construction_twin.ros.shared.node import ending_on_signals
from construction_twin.ros.shared.params import Parameters, PrivateSettings, read_parameters, robot_from_parameters
from construction_twin.ros.shared.robot_client import RobotListener
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import PlanToJoints


class Recorder:
    """Records topics, by resolved names, into one bag while the ``with`` block runs, or until `stop`.

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


_POLL = 0.05
#: The bridge reports the gateway's counters this often [s]; the recording goes on until they include the task's end.
_REPORT_PERIOD = 1.0

#: The arm counts as at rest when no joint left a band of this [rad] for this time [s].
REST_TOLERANCE, REST_TIME = 1e-6, 0.5


class RestDetector:
    """Tells whether a pose stayed for `rest_time` [s] within `tolerance` [rad], [m] of where it began."""

    def __init__(self, tolerance: float, rest_time: float):
        self._tolerance = tolerance
        self._rest_time = rest_time
        self._pose: np.ndarray | None = None
        self._since = 0.0
        self.at_rest = False

    def update(self, stamp: float, position) -> None:
        """Take one pose, shape (n,) [rad], measured at `stamp` [s]."""
        position = np.asarray(position, dtype=float)
        if self._pose is None or np.abs(position - self._pose).max() > self._tolerance:
            self._pose, self._since = position, stamp
        self.at_rest = stamp - self._since >= self._rest_time


_Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]


class ExperimentSettings(PrivateSettings):
    """Private parameters; see config/experiment.yaml. `results_dir` is an absolute path."""

    results_dir: Annotated[str, pydantic.Field(pattern=r"^[/~]")]
    goals_deg: Annotated[list[list[pydantic.FiniteFloat]], pydantic.Field(min_length=1)]
    duration: _Positive
    waypoints: Annotated[int, pydantic.Field(ge=2)]
    timeout: _Positive
    topics: Annotated[list[str], pydantic.Field(min_length=1)]


class Experiment:
    """One run of the task."""

    def __init__(self, settings: ExperimentSettings, robot: RobotModel, console: Console):
        self._settings, self._robot, self._console = settings, robot, console
        self._listener = RobotListener(rospy.get_namespace(), robot)

    def run(self) -> Report:
        """Run everything; see the module."""
        results = Path(self._settings.results_dir).expanduser()
        directory = _new_directory(results)
        self._wait(self._not_ready, "the system did not get ready")
        topics = [rospy.resolve_name(topic) for topic in self._settings.topics]
        bag = directory / "experiment.bag"
        with Recorder(bag, topics, rospy.resolve_name("recorder")) as recorder:
            self._wait(lambda: "" if recorder.connected() else "the recorder to connect", "the recording did not start")
            self._print(f"recording to {bag}")
            for number, goal in enumerate(self._settings.goals_deg, start=1):
                self._play(self._plan(goal), f"plan {number} of {len(self._settings.goals_deg)}")
            self._wait_for_rest()
            self._wait_for_counters()
            recorder.stop(self._settings.timeout)
        self._print("evaluating")
        twin = rospy.get_param("virtual_robot/twin", "")
        report = write_report(read_recording(bag, rospy.get_namespace()), self._robot, directory, twin)
        point_latest(results, directory)
        return Report(report.summary, (bag, *report.files))

    @property
    def _execution(self) -> Execution:
        return self._listener.newest("execution") or Execution()

    def _plan(self, goal_deg: list[float]) -> str:
        """Have one reach planned from the twin's present pose; return the plan's id."""
        fraction = len(self._settings.goals_deg)
        rospy.wait_for_service("plan_to_joints", self._settings.timeout)
        answer = rospy.ServiceProxy("plan_to_joints", PlanToJoints)(
            goal=from_wire(goal_deg, self._robot.linear),
            duration=self._settings.duration / fraction,
            waypoints=max(2, self._settings.waypoints // fraction),
            source="experiment",
        )
        if not answer.success:
            raise ConstructionTwinError(f"the task could not be planned: {answer.message}")
        self._print(answer.message)
        return answer.plan_id

    def _play(self, plan_id: str, title: str) -> None:
        def not_started() -> str:
            mine = self._execution.plan_id == plan_id
            started = mine and (self._execution.state == Execution.PLAYING or self._execution.outcome)
            return "" if started else f"plan {plan_id} to be approved ({rospy.resolve_name('review_plan')})"

        self._wait(not_started, "the plan was not started")
        end = self._follow(plan_id, title)
        if end.plan_id != plan_id:
            raise ConstructionTwinError(f"plan {plan_id} was replaced by {end.plan_id} before it was finished")
        if end.outcome != "finished":
            raise ConstructionTwinError(f"the plan was not finished but {end.outcome or 'dropped'}: {end.reason}")

    def _follow(self, plan_id: str, title: str) -> Execution:
        """Print the progress of a plan, a line for each tenth, until it ends; return the executor's report of that."""
        printed = -1
        while True:
            now = self._execution
            if now.plan_id != plan_id or now.state in (Execution.WAITING, Execution.IDLE):
                if now.outcome == "finished":
                    self._print(f"{title}: 100 %")
                return now
            played = rospy.get_time() - now.plan_start.to_sec()
            if played > now.duration + self._settings.timeout:
                raise ConstructionTwinError(
                    f"the plan of {now.duration:g} s plays for {played:.0f} s; is the executor alive?"
                )
            if (tenth := min(9, int(10.0 * played / now.duration))) > printed:
                printed = tenth
                self._print(f"{title}: {10 * tenth} %")
            self._pause()

    def _wait_for_rest(self) -> None:
        # a stream of 250 Hz is only listened to while it matters: the machine's cores belong to the control path
        rest = RestDetector(REST_TOLERANCE, REST_TIME)
        subscriber = Subscriber(
            "physical/feedback",
            Feedback,
            lambda m: rest.update(m.header.stamp.to_sec(), m.position),
            warn_of_refusals(),
            250,
        )
        self._wait(lambda: "" if rest.at_rest else "the physical arm to be at rest", "the arm does not come to rest")
        subscriber.unregister()

    def _not_ready(self) -> str:
        """Return what the system still lacks, as text; empty when it is ready."""
        lacking = self._listener.snapshot().not_ready()
        lacking = lacking if self._listener.newest("link") is not None else ["link is silent", *lacking]
        return f"a ready system: {'; '.join(lacking)}" if lacking else ""

    def _wait_for_counters(self) -> None:
        begin = rospy.get_time()

        def outdated() -> str:
            reported = self._listener.newest("link").header.stamp.to_sec()
            return "" if reported >= begin + _REPORT_PERIOD else "the link's next report"

        self._wait(outdated, "the bridge does not report any more")

    def _wait(self, lacking: Callable[[], str], failure: str) -> None:
        """Wait until `lacking` returns an empty text, printing what it says; raise with `failure` after the timeout."""
        deadline = time.monotonic() + self._settings.timeout
        printed = None
        while text := lacking():
            if time.monotonic() > deadline:
                raise ConstructionTwinError(f"{failure} within {self._settings.timeout:g} s: {text}")
            if text != printed:
                self._print(f"waiting for {text}")
                printed = text
            self._pause()

    def _pause(self) -> None:
        if rospy.is_shutdown():
            raise ConstructionTwinError("interrupted")
        time.sleep(_POLL)

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)


def point_latest(results: Path, directory: Path) -> None:
    """Let the link ``latest`` in `results` point at `directory`, in one step."""
    link = results / f".latest-{os.getpid()}"
    link.symlink_to(directory.name)
    link.replace(results / "latest")


def checked_parameters(parameters: Parameters = rospy) -> tuple[ExperimentSettings, RobotModel]:
    """Return what the node starts with; raise the ConstructionTwinError that it is refused for."""
    settings, robot = read_parameters(ExperimentSettings, parameters), robot_from_parameters(parameters=parameters)
    joints = len(robot.joint_names)
    for goal in settings.goals_deg:
        if len(goal) != joints:
            found = f"a goal in ~goals_deg has {len(goal)} values"
            raise ConstructionTwinError(f"{found}; {robot.name} has {joints} joints")
        robot.check_range(from_wire(goal, robot.linear))
    check_writable(Path(settings.results_dir).expanduser())
    return settings, robot


def main() -> int:
    """Run the experiment node; return the process's status: 0, or 1 after a sentence."""
    console = table_console()
    try:
        await_master()
        with ending_on_signals():
            rospy.init_node("experiment", disable_signals=True)
            report = Experiment(*checked_parameters(), console).run()
    except (ConstructionTwinError, rospy.ROSException, rospy.ServiceException, OSError) as error:
        print(f"experiment: {command_message(error)}", file=sys.stderr, flush=True)
        return 1
    render_tables(report.summary, console)
    print_files(console, report.files)
    return 0


def _new_directory(results: Path) -> Path:
    name = time.strftime("%Y-%m-%d_%H-%M-%S")
    for suffix in ("", *(f"_{number}" for number in range(2, 100))):
        directory = results / (name + suffix)
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            continue
        return directory
    raise ConstructionTwinError(f"{results} already holds a hundred results of this second")
