"""The experiment: waits for a ready system, records, plans and plays the task, evaluates the recording."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Annotated

import pydantic
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
from construction_twin.ros.commands.driver import CellDriver, RestDetector
from construction_twin.ros.commands.evaluate import print_files
from construction_twin.ros.shared.diagnostics import warn_of_refusals
from construction_twin.ros.shared.master import await_master
from construction_twin.ros.shared.node import ending_on_signals
from construction_twin.ros.shared.params import Parameters, read_parameters, robot_from_parameters
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.validation import StrictModel

#: The bridge reports the gateway's counters this often [s]; the recording goes on until they include the task's end.
_REPORT_PERIOD = 1.0

#: The arm counts as at rest when no joint left a band of this [rad] for this time [s].
REST_TOLERANCE, REST_TIME = 1e-6, 0.5
_Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]


class ExperimentSettings(StrictModel):
    """Private parameters; see config/experiment.yaml. `results_dir` is an absolute path."""

    results_dir: Annotated[str, pydantic.Field(pattern=r"^[/~]")]
    goals_deg: Annotated[list[list[pydantic.FiniteFloat]], pydantic.Field(min_length=1)]
    duration: _Positive
    waypoints: Annotated[int, pydantic.Field(ge=2)]
    timeout: _Positive
    topics: Annotated[list[str], pydantic.Field(min_length=1)]


class Experiment(CellDriver):
    """One run of the task."""

    def __init__(self, settings: ExperimentSettings, robot: RobotModel, console: Console):
        super().__init__("experiment", robot, console, settings.timeout)
        self._settings = settings

    def run(self) -> Report:
        """Run everything; see the module."""
        results = Path(self._settings.results_dir).expanduser()
        directory = results / time.strftime("%Y-%m-%d_%H-%M-%S")
        directory.mkdir(parents=True)
        self.wait_until_ready()
        bag = directory / "experiment.bag"
        with self.recording(bag, self._settings.topics):
            self.print_line(f"recording to {bag}")
            for number, goal in enumerate(self._settings.goals_deg, start=1):
                self._play(self._plan(goal), f"plan {number} of {len(self._settings.goals_deg)}")
            self._wait_for_rest()
            self._wait_for_counters()
        self.print_line("evaluating")
        twin = rospy.get_param("virtual_robot/twin", "")
        report = write_report(read_recording(bag, rospy.get_namespace()), self._robot, directory, twin)
        point_latest(results, directory)
        return Report(report.summary, (bag, *report.files))

    def _plan(self, goal_deg: list[float]) -> str:
        """Request the plan of one reach; return its id."""
        fraction = len(self._settings.goals_deg)
        answer = self.plan(goal_deg, self._settings.duration / fraction, max(2, self._settings.waypoints // fraction))
        self.print_line(answer.message)
        return answer.plan_id

    def _play(self, plan_id: str, title: str) -> None:
        def started() -> bool:
            mine = self.execution.plan_id == plan_id
            return mine and bool(self.execution.state == Execution.PLAYING or self.execution.outcome)

        def ended() -> Execution | None:
            now = self.execution
            return now if now.plan_id != plan_id or now.state in (Execution.WAITING, Execution.IDLE) else None

        approval = f"plan {plan_id} to be approved ({rospy.resolve_name('review_plan')})"
        self.print_line(f"waiting for {approval}")
        self.wait(started, lambda: approval)
        rest = time.monotonic() + self.execution.duration + self._settings.timeout
        end = self.wait(ended, lambda: f"the end of {title}; is the executor alive?", rest)
        assert end is not None  # `wait` returns what is true
        if end.plan_id != plan_id:
            raise ConstructionTwinError(f"plan {plan_id} was replaced by {end.plan_id} before it was finished")
        if end.outcome != "finished":
            raise ConstructionTwinError(f"the plan was not finished but {end.outcome or 'dropped'}: {end.reason}")

    def _wait_for_rest(self) -> None:
        # a stream of 250 Hz is only listened to while it matters: the machine's cores belong to the control path
        rest, refuse = RestDetector(REST_TOLERANCE, REST_TIME), warn_of_refusals()
        subscriber = Subscriber(
            "physical/feedback", Feedback, lambda m: rest.update(m.header.stamp.to_sec(), m.position), refuse, 250
        )
        self.wait(lambda: rest.at_rest, lambda: "the physical arm to be at rest")
        subscriber.unregister()

    def _wait_for_counters(self) -> None:
        due = rospy.get_time() + _REPORT_PERIOD
        self.wait(lambda: self.listener.newest("link").header.stamp.to_sec() >= due, lambda: "the link's next report")


def point_latest(results: Path, directory: Path) -> None:
    """Let the link ``latest`` in `results` point at `directory`, in one step."""
    link = results / f".latest-{os.getpid()}"
    link.symlink_to(directory.name)
    link.replace(results / "latest")


def checked_parameters(parameters: Parameters = rospy) -> tuple[ExperimentSettings, RobotModel]:
    """Return the node's parameters; ConstructionTwinError refuses its start."""
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
