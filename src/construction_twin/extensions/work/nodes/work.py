"""work: has the tasks of a building model planned, follows them, and changes the scene with them; `work_progress.py` in ROS."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import pydantic
import rospy
from std_srvs.srv import Trigger

from construction_twin import msg, srv
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError, PayloadError, RequestRefused
from construction_twin.core.extensions import check_extras, import_extension
from construction_twin.core.reports import EngagementReport, ExecutionReport
from construction_twin.core.worker import Worker
from construction_twin.extensions.work.loaded_model import WORKER, LoadedModel, glb
from construction_twin.extensions.work.received_messages import KnownPlan, Received, Verdict
from construction_twin.extensions.work.task_board import WorkRefused
from construction_twin.extensions.work.task_memory import TaskState
from construction_twin.extensions.work.work_cell import read_work_cell
from construction_twin.extensions.work.work_progress import NoAnswer, UnderReview, WorkProgress, WorkServices
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import SceneError, TrajectoryError
from construction_twin.ros.messages.convert import (
    change_from_msg,
    plan_from_msg,
    pose_from_msg,
    tool_report_from_msg,
    work_segment_to_msg,
)
from construction_twin.ros.messages.records import from_msg, to_msg
from construction_twin.ros.messages.scene_convert import object_to_msg, scene_from_msg
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, Diagnosis
from construction_twin.ros.shared.frames import FRAMES, listen_to_frames
from construction_twin.ros.shared.node_shell import (
    Interface,
    NodeIO,
    NodeShell,
    PolledPose,
    Publication,
    Served,
    Shared,
    SharedParameter,
    Subscription,
    has_arm,
)
from construction_twin.ros.shared.params import robot_file, ros_home
from construction_twin.scene.objects import product
from construction_twin.scene.scene_change import SceneChange
from construction_twin.validation import StrictModel

#: The executor's record of verdicts.
RECORD = "executor/review_file"
#: Oldest present pose of twin and arm, and longest wait for one [s].
MAX_POSE_AGE = 0.5


class Settings(StrictModel):
    """Private parameters, explained in config/work.yaml and launch/bringup.launch.

    `private`: folder that a console serves to whom is logged in, relative to ROS_HOME; empty: no console.
    """

    model: str
    cell: str
    self_collision: str
    tf_prefix: str
    folder: str
    arm: str
    tool: str = ""
    scene: str = ""
    private: str = ""
    service_timeout: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    listen_time: Annotated[float, pydantic.Field(gt=0.0, le=60.0)]
    retry_time: Annotated[float, pydantic.Field(gt=0.0, le=60.0)]


class WorkNode:
    """A `WorkProgress` in ROS; `progress` is None without a usable model and ledger."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: NodeIO):
        self._settings, self._robot, self._diagnostics = settings, robot, node_io.diagnostics
        self._planner, self._publishers = node_io.parameters["planner"], node_io.publishers
        twin = node_io.poses["twin/joint_states"]
        # without a physical arm the twin's pose counts as measured
        self._twin, self._arm = twin, node_io.poses.get("physical/joint_states", twin)
        self._frames = listen_to_frames(robot, settings.tf_prefix, settings.service_timeout, self._diagnostics.refuse)
        self._worker = Worker(WORKER)
        rospy.on_shutdown(self._worker.close)
        # what became of a plan is read in the record after a restart
        self.received = Received(
            node_io.connections, rospy.is_shutdown, robot_file(node_io.parameters[RECORD], robot.name)
        )
        self.progress: WorkProgress | None = None
        #: Why there is no work, and whether there will be none any more.
        self._fault: str = "the model is being read"
        self._broken = False
        self._published = ""
        self._publish()

    def run(self) -> None:
        """Load the model, then follow the executor."""
        self.open()
        while not rospy.is_shutdown():
            self.run_once()

    def run_once(self) -> None:
        """Wait for news, at most `retry_time`, and act on it. For one thread."""
        # without news, too: what did not work before is tried again
        if self.received.wait_for_news(self._settings.retry_time):
            self._publish()
        if self.progress is None:
            return
        try:
            self.progress.catch_up()
            self._publish()
        except ConstructionTwinError as error:
            # of the ledger: nothing is done without it, and the executor waits for the scene in vain
            self._fail(str(error))

    def open(self) -> None:
        """Load the model, and find out what became of the work before this start."""
        try:
            self._load()
        except ConstructionTwinError as error:
            self._fail(str(error))

    def _load(self) -> None:
        settings, robot = self._settings, self._robot
        files = None
        if settings.private:
            files = import_extension("console.private_files").PrivateFiles(ros_home() / settings.private, robot.name)
            files.drop_building()
        began, folder = time.monotonic(), ros_home() / settings.folder
        loaded: LoadedModel = self._worker.ask_first(
            "load_model",
            model=settings.model,
            cell=settings.cell,
            robot=robot,
            self_collision=settings.self_collision,
            planner=self._planner,
            cache=str(folder),
        )
        if rospy.is_shutdown():
            return
        rospy.loginfo("the model was read in %.1f s", time.monotonic() - began)
        if files is not None:
            self._show_building(loaded, files)
        services = WorkServices(
            functools.partial(self._twin.pose, MAX_POSE_AGE, MAX_POSE_AGE),
            functools.partial(self._arm.pose, MAX_POSE_AGE, MAX_POSE_AGE),
            functools.partial(self._worker.ask, "plan"),
            self._plan_work,
            lambda: self._call("plan_way_back", Trigger).message,
            self._edit_scene,
            self._diagnostics.refuse,
            functools.partial(rospy.loginfo, "%s"),
        )
        self.progress = WorkProgress(loaded, folder, robot, self.received, services, time.time_ns)
        self.progress.recall(settings.listen_time)

    def _show_building(self, loaded: LoadedModel, files: Any) -> None:
        placed = {job.element: loaded.elements[job.element] for job in loaded.schedule.jobs}
        try:
            files.write_building(glb(placed, loaded.digest))
        except ConstructionTwinError as error:
            self._diagnostics.refuse("building", str(error))

    def _plan_work(self, task: str, source: str, segments: Sequence[WorkSegment]) -> UnderReview:
        messages = [work_segment_to_msg(segment) for segment in segments]
        answer = self._call("plan_work", srv.PlanWork, task=task, source=source, segments=messages)
        return UnderReview(Outcome.of(answer).message, task, answer.plan_id, answer.plan_hash, answer.duration)

    def _edit_scene(self, before: str, change: SceneChange, after: str) -> str:
        put = list(map(object_to_msg, change.put))
        fields = {"before": before, "put": put, "remove": list(change.remove), "after": after}
        return str(self._call("edit_scene", srv.EditScene, **fields).hash)

    def _call(self, name: str, kind: type, **fields: object) -> Any:
        """Return the answer of a service; raise NoAnswer or RequestRefused."""
        service = rospy.resolve_name(name)
        try:
            rospy.wait_for_service(service, self._settings.service_timeout)
            answer = rospy.ServiceProxy(service, kind)(**fields)
        except (rospy.ROSException, rospy.ServiceException) as error:
            raise NoAnswer(f"{service} does not answer: {error}") from error
        if not answer.success:
            raise RequestRefused(Outcome.of(answer).message)
        return answer

    def _usable_progress(self) -> WorkProgress:
        if self.progress is None:
            raise WorkRefused(self._fault)
        return self.progress

    def on_plan_task(self, request: srv.WorkPlanTaskRequest) -> Outcome:
        """Have a task planned, or while the arm is engaged the way back."""
        fields = asdict(self._usable_progress().plan(request.task, self._settings.service_timeout))
        return Outcome(True, fields.pop("message"), fields=fields)

    def on_decide(self, request: srv.WorkDecideRequest) -> str:
        """Record a decision of a person, or where one has measured an element."""
        if request.decision == "measured":
            return self._record_measured(request)
        return self._usable_progress().decide(
            request.decision, request.task, request.answer, request.person, request.reason, request.question
        )

    def _record_measured(self, request: srv.WorkDecideRequest) -> str:
        header = request.pose.header
        pose = product(self._frames.in_base(header.frame_id, header.stamp), pose_from_msg(request.pose.pose))
        found = self._usable_progress().record_measured(request.task, pose, request.person, request.reason)
        distance, angle = found.distance * 1e3, math.degrees(found.angle)
        return f"{request.task} is {distance:.2f} mm and {angle:.3f} deg from where the model has it"

    def on_message(self, topic: str, read: Callable[[Any], Any], message: Any) -> None:
        """Read and store a message, or refuse it."""
        try:
            content = read(message)
        except (SceneError, TrajectoryError, PayloadError) as error:
            self._diagnostics.refuse(topic, str(error))
            return
        self.received.on_message(content)

    def _fail(self, sentence: str) -> None:
        rospy.logerr("%s", sentence)
        self._fault, self.progress, self._broken = sentence, None, True
        self._publish()

    def _publish(self) -> None:
        progress = self.progress
        if progress is None:
            engaged = self.received.execution is not None and self.received.execution.engaged
            model, reading = Path(self._settings.model).name, not self._broken
            message = msg.WorkTasks(model=model, engaged=engaged, reading=reading, reason=self._fault)
        else:
            message = to_msg(progress.state_report(), msg.WorkTasks)
        # of numbers that are not known, only their text is the same
        if repr(message) == self._published:
            return
        self._published = repr(message)
        message.header.stamp = rospy.Time.now()
        self._publishers["work/tasks"].publish(message)

    def diagnose(self) -> Diagnosis:
        """Return the state of the work for `/diagnostics`."""
        progress = self.progress
        if progress is None:
            return Diagnosis(ERROR if self._broken else WARN, self._fault)
        with progress.lock:
            board = progress.board
            values: dict[str, object] = {state.value: len(board.states.in_state(state)) for state in TaskState}
            values["lines of the ledger"] = board.ledger.lines
            values["notes on the model"] = len(board.notes)
            asks = bool(board.states.in_state(TaskState.ASKS))
            return Diagnosis(WARN if asks else OK, board.summary(time.time_ns()), values)


def _subscription(topic: str, kind: type, read: Callable[[Any], Any], queue_size: int) -> Subscription:
    return Subscription(topic, kind, lambda node, message: node.on_message(topic, read, message), queue_size=queue_size)


INTERFACE = Interface(
    diagnose=WorkNode.diagnose,
    parameters=(SharedParameter("planner", {}), SharedParameter(RECORD, "")),
    publishes=(Publication("work/tasks", msg.WorkTasks, queue_size=5, latch=True),),
    polls=(PolledPose("twin/joint_states"), PolledPose("physical/joint_states", when=has_arm)),
    subscribes=(
        _subscription("engagement", msg.Engagement, functools.partial(from_msg, EngagementReport), 5),
        _subscription("execution", msg.Execution, functools.partial(from_msg, ExecutionReport), 50),
        _subscription(
            "plan", msg.Plan, lambda plan: KnownPlan(plan_from_msg(plan), (*map(change_from_msg, plan.segments),)), 5
        ),
        _subscription("review", msg.Review, functools.partial(from_msg, Verdict), 20),
        _subscription("scene", msg.Scene, scene_from_msg, 2),
        _subscription("tool", msg.ToolState, tool_report_from_msg, 5),
    ),
    listeners=FRAMES,
    serves=(
        Served("work/plan", srv.WorkPlanTask, WorkNode.on_plan_task, refused=lambda _, request: {"task": request.task}),
        Served("work/decide", srv.WorkDecide, WorkNode.on_decide),
    ),
)


def check(settings: Settings, _robot: RobotModel, _shared: Shared) -> None:
    """Check packages, files, and that the robot's tool and scene are the cell's; see `NodeShell`."""
    check_extras("work")
    for name, path in (("model", settings.model), ("cell", settings.cell)):
        if not Path(path).is_file():
            raise ConfigurationError(f"work_{name}", path, "the absolute path of a file")
    work_cell = read_work_cell(settings.cell)
    for name, argument, wanted_file in (
        ("tool", settings.tool, work_cell.file.tool),
        ("scene", settings.scene, work_cell.file.scene),
    ):
        wanted = (Path(settings.cell).parent / wanted_file).resolve()
        if Path(argument).resolve() != wanted:
            path, cell = str(wanted), settings.cell
            raise ConfigurationError(name, argument, f"{path}, as {cell} says; give {name}:={path}")


NODE = NodeShell("work", Settings, WorkNode, INTERFACE, check)
main = NODE.run
