"""work: the tasks of a building model, from schedule to ledger: has them planned, and changes the scene with them.

Services `work/plan`, `work/decide`, `work/measured`; latched topics `work/tasks`, `work/markers`. Listens to `execution`,
`engagement`, `plan`, `review`, `scene`, `tool`, the poses of twin and arm, and tf. Calls `plan_work`, `plan_way_back` and
`edit_scene`.

Nothing moves without a person's approval, as of every plan. What is written in the ledger is on the disk before the scene changes;
without the changed scene the executor does not go on: killed at any instant, it comes back with what is true, or asks.
"""

from __future__ import annotations

import functools
import math
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import pydantic
import rospy
from geometry_msgs.msg import TransformStamped
from std_srvs.srv import Trigger, TriggerRequest
from visualization_msgs.msg import MarkerArray

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.extras import check_extras
from construction_twin.core.motion_errors import FrameError
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.msg import Engagement, Execution, Plan, Review, Scene, ToolState, WorkTasks
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.convert import pose_from_msg, pose_from_transform_msg, work_segment_to_msg
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.scene_convert import tf_frame
from construction_twin.ros.messages.work_marker_convert import work_marker_array
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.frame_listener import FRAMES
from construction_twin.ros.shared.frames import listen_to_frames
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.params import robot_file, ros_home
from construction_twin.ros.shared.ports import (
    Interface,
    NewestPose,
    Ports,
    Publication,
    Served,
    Shared,
    SharedParameter,
    Subscription,
    has_arm,
)
from construction_twin.ros.shared.private_files import PrivateFiles
from construction_twin.ros.shared.work_follower import WorkFollower
from construction_twin.ros.shared.work_listener import WorkListener
from construction_twin.ros.shared.work_scene import SCENE_TIME, Call, WorkScene
from construction_twin.ros.transport.publisher import Sink
from construction_twin.scene.objects import product
from construction_twin.scene.scene_change import SceneChange
from construction_twin.srv import (
    EditScene,
    PlanWork,
    PlanWorkRequest,
    WorkDecide,
    WorkDecideRequest,
    WorkMeasured,
    WorkMeasuredRequest,
    WorkPlanTask,
    WorkPlanTaskRequest,
)
from construction_twin.views.work_markers import DrawnElement, work_picture
from construction_twin.work.built import change, pose_tuple
from construction_twin.work.glb import ShownElement, glb
from construction_twin.work.jobs import TaskMotions
from construction_twin.work.ledger import Ledger
from construction_twin.work.recipe import DEFAULT
from construction_twin.work.site import read_site
from construction_twin.work.task_board import Prepared, TaskBoard, WorkRefused
from construction_twin.work.task_memory import Entry
from construction_twin.work.task_states import TaskState
from construction_twin.work.worker import Worker, WorkerError

#: The executor's record of verdicts.
RECORD = "executor/review_file"
#: Oldest pose of twin and arm that counts as the present one, and longest wait for one [s].
MAX_POSE_AGE = 0.5


class Settings(pydantic.BaseModel):
    """Private parameters: behaviour is explained in config/work.yaml, the others are given in launch/work.launch.

    Attributes:
        model, cell: Absolute paths of the IFC file and of the cell file.
        tool, scene: Absolute paths of the robot's: those that the cell file names.
        self_collision: YAML of the link pairs that are not checked.
        tf_prefix: Of the twin's tf frames.
        folder: Of the ledgers.
        arm: ``mock``, ``real`` or ``none``: without a physical arm the twin's pose counts as measured.
        private: Folder of what a console serves to whom is logged in, relative to ROS_HOME; empty: no console was started.
        service_timeout, listen_time, retry_time: [s]
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

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


@dataclass(frozen=True)
class Inputs:
    """What the node asks for when it needs it.

    Attributes:
        twin_pose, arm_pose: Return the present joint positions [rad], [m]; raise PoseUnknownError or PayloadError.
        transform: Takes a frame (a link, or a tf frame) and a stamp; returns where it is in the base frame; raises FrameError.
    """

    twin_pose: Callable[[], tuple[float, ...]]
    arm_pose: Callable[[], tuple[float, ...]]
    transform: Callable[[str, rospy.Time], TransformStamped]


@dataclass(frozen=True)
class Outputs:
    """Where the node publishes, and whom it calls.

    Attributes:
        edit_scene, plan_work, plan_way_back: Services; each returns why there is no answer, and the answer.
    """

    tasks: Sink
    markers: Sink
    edit_scene: Call
    plan_work: Call
    plan_way_back: Call


#: What is told of a measured element that was refused.
NOT_MEASURED = {"deviation_mm": math.nan, "deviation_deg": math.nan}


@dataclass(frozen=True, eq=False)
class _Opened:
    """What works on a model that was read.

    Attributes:
        follower: Writes into the ledger what follows from what was heard.
        scene: Has the collision scene changed after that.
    """

    board: TaskBoard
    follower: WorkFollower
    scene: WorkScene


class WorkNode:
    """Answers people, has tasks planned, and does what follows from what was heard; `start` gives it topics and services.

    Args:
        planner: The planner node's settings, with which tasks are planned.
        worker: The process that reads models and plans.

    Attributes:
        heard: What the topics say.
    """

    def __init__(
        self,
        settings: Settings,
        robot: RobotModel,
        planner: Mapping[str, object],
        worker: Worker,
        heard: WorkListener,
        inputs: Inputs,
        outputs: Outputs,
        diagnostics: NodeDiagnostics,
    ):
        self._settings = settings
        self._robot = robot
        self._planner = planner
        self._base_frame = tf_frame(settings.tf_prefix, robot.base_link)
        self._worker = worker
        self._planning = threading.Lock()
        self.heard = heard
        self._inputs, self._outputs = inputs, outputs
        self._diagnostics = diagnostics
        #: Guards board and ledger; never held while somebody else is waited for who may wait for it.
        self._lock = threading.RLock()
        self._work: _Opened | None = None
        #: Why there is no work, and whether there will be none any more.
        self._problem: str = Sentence("work.reading")
        self._broken = False
        self._told: WorkTasks | None = None
        self._drawn: frozenset[str] = frozenset()
        self._publish()

    def run(self) -> None:
        """Read the model, find out what became of the work before this start, then follow what the executor does."""
        self.open()
        while not rospy.is_shutdown():
            self.go_on()

    def go_on(self) -> None:
        """Wait for the next piece of news, at most `retry_time`, and do what follows; to be called in one thread only."""
        # without news, too: what did not work before is tried again
        if self.heard.wait_for_news(self._settings.retry_time):
            self._publish()
        if self._work is None:
            return
        try:
            self._catch_up(self._work)
        except ConstructionTwinError as error:
            # of the ledger: nothing is done without it, and the executor waits for the scene in vain
            self._fail(str(error))

    def _catch_up(self, work: _Opened) -> None:
        # one report for both: the scene may change only after what was written of it
        report = self.heard.execution
        with self._lock:
            work.follower.catch_up(report)
            idle = not work.board.book.busy
        work.scene.change_as_planned(report)
        engaged = self.heard.engaged
        if not engaged:
            work.scene.unblock()
        if (idle or engaged) and not self.heard.playing and self._planning.acquire(blocking=False):
            try:
                if engaged:
                    work.scene.make_for_way_back()
                elif self.heard.executor_said:
                    work.scene.tidy()
            finally:
                self._planning.release()
        self._publish()

    # -- the start

    def open(self) -> None:
        """Read the model, and find out what became of the work before this start."""
        try:
            self._load()
        except ConstructionTwinError as error:
            self._fail(str(error))

    def _load(self) -> None:
        settings = self._settings
        files = PrivateFiles(ros_home() / settings.private, self._robot.name) if settings.private else None
        if files is not None:
            files.drop_building()
        began = time.monotonic()
        prepared: Prepared = self._worker.ask_first(
            "prepare",
            model=settings.model,
            cell=settings.cell,
            robot=self._robot,
            self_collision=settings.self_collision,
            planner=self._planner,
            cache=str(ros_home() / settings.folder),
        )
        if rospy.is_shutdown():
            return
        path = ledger_path(ros_home() / settings.folder, self._robot.name, prepared.cell)
        ledger = Ledger(
            path, prepared.after, prepared.digest, time.time_ns, str(Path(prepared.cell).resolve()),
            prepared.schedule.placing, prepared.standing_elements, self._robot.name, prepared.present,
        )  # fmt: skip
        board = TaskBoard(prepared, ledger, self._robot.name, self._robot.tip_link)
        board.look_around()
        rospy.loginfo(
            "%s: %d tasks, %d lines in %s; read in %.1f s",
            prepared.model, len(prepared.schedule.jobs), ledger.lines, path, time.monotonic() - began,
        )  # fmt: skip
        for note in board.notes:
            rospy.loginfo("%s", note)
        if files is not None:
            self._show_building(prepared, files)
        heard, refuse = self.heard, self._diagnostics.refuse
        follower = WorkFollower(board, heard, Chain(self._robot), self._inputs.arm_pose, refuse)
        scene = WorkScene(board, self._lock, heard, follower, self._outputs.edit_scene, refuse)
        self._work = _Opened(board, follower, scene)
        # nothing is tidied before it is known whether the arm was left engaged
        heard.wait_for(lambda: heard.execution is not None and not heard.unsaid, min(1.0, settings.listen_time))
        self._recall(self._work)

    def _show_building(self, prepared: Prepared, files: PrivateFiles) -> None:
        """Write the model where a console serves it; without it everything else goes on."""
        placed = {job.element for job in prepared.schedule.jobs}
        shown = [
            ShownElement(key, facts.name, facts.triangles, facts.base_T_goal)
            for key, facts in prepared.elements.items()
            if key in placed
        ]
        try:
            files.write_building(glb(shown, prepared.digest))
        except ConstructionTwinError as error:
            self._diagnostics.refuse("building", str(error))

    def _recall(self, work: _Opened) -> None:
        """Find out what became of a plan that the ledger has as offered or under way."""
        if not work.board.book.busy:
            return
        heard = self.heard
        # latched messages come within a moment of the connection; the executor may only now be starting
        heard.wait_for(lambda: heard.execution is not None and heard.tool_said, self._settings.listen_time)
        heard.wait_for(lambda: heard.plan is not None and not heard.unsaid, min(1.0, self._settings.listen_time))
        with self._lock:
            work.follower.follow(heard.execution)
            work.follower.settle()

    # -- services

    @property
    def board(self) -> TaskBoard:
        """The tasks of the building that is open; WorkRefused, with the problem, where none is."""
        return self._opened().board

    def _opened(self) -> _Opened:
        if self._work is None:
            raise WorkRefused(self._problem)
        return self._work

    def on_plan_task(self, request: WorkPlanTaskRequest) -> Outcome:
        """Have a task planned, or while the arm is engaged the way back."""
        if not self._planning.acquire(timeout=self._settings.service_timeout):
            raise WorkRefused(Sentence("work.busy"))
        try:
            return self._plan_task(request.task)
        finally:
            self._planning.release()
            self.heard.announce()

    def _plan_task(self, asked: str) -> Outcome:
        heard = self.heard
        if problem := self._left_closed():
            raise WorkRefused(problem)
        if heard.engaged:
            heard.wait_for(lambda: not heard.unsaid, SCENE_TIME)
        if heard.engaged:
            return self._plan_way_back(asked)
        task, work = self._allowed(asked)
        board = work.board
        work.scene.tidy()
        with self._lock:
            # while the scene was made right, somebody may have said something else
            self._allowed(task)
            memory = board.book.tasks[task]
            held = memory.tool0_T_element if memory.state is TaskState.CARRIED else ()
            scene = heard.scene
            wanted, alone = board.wanted_scene()
        if scene is None:
            raise WorkRefused(Sentence("work.scene_unknown"))
        if change(scene, wanted, alone) != SceneChange():
            raise WorkRefused(Sentence("work.scene_wrong"))
        start = self._inputs.twin_pose()
        began = time.monotonic()
        try:
            plan: TaskMotions = self._worker.ask(
                "plan", task=task, element=board.element_of(task), start=start, scene=scene, held=held
            )
        except WorkerError as error:
            board.failures[task] = board.called(error.sentence)
            raise WorkRefused(board.failures[task]) from error
        board.failures.pop(task, None)
        rospy.loginfo("%s: planned with %s in %.2f s", board.title(task), plan.method, time.monotonic() - began)
        return self._offer(task, plan, work)

    def _left_closed(self) -> str:
        with self._lock:
            work = self._opened()
            return work.board.left_closed(work.follower.grip())

    def _allowed(self, asked: str) -> tuple[str, _Opened]:
        with self._lock:
            work = self._opened()
            now = time.time_ns()
            task = asked or work.board.next(now)
            obstacle = work.board.obstacle(task, now) if task else work.board.summary(now)
            if obstacle:
                raise WorkRefused(obstacle)
            return task, work

    def _offer(self, task: str, plan: TaskMotions, work: _Opened) -> Outcome:
        """Have the planner check a plan and put it under review; the ledger knows of it before."""
        board, offer = work.board, uuid.uuid4().hex[:12]
        title, process = board.title(task), board.prepared.schedule.job(task).process
        held = () if plan.tool0_T_element is None else pose_tuple(plan.tool0_T_element)
        named = "" if process == DEFAULT else process
        with self._lock:
            self._allowed(task)
            board.add(Entry("offered", task, offer=offer, grip=plan.method, pose=held, process=named))
        segments = [work_segment_to_msg(segment) for segment in plan.segments]
        how = f"{named}, {plan.method}" if named else plan.method
        request = PlanWorkRequest(task=task, source=f"{title} by {how}, offer {offer}", segments=segments)
        problem, answer = self._outputs.plan_work(request)
        with self._lock:
            memory = board.book.tasks[task]
            unnamed = memory.state is TaskState.PLANNED and not memory.plan
            if answer is None or not answer.success:
                if answer is not None:
                    problem = answer.message
                    board.add(Entry("dropped", task, offer=offer, reason=problem))
                elif unnamed:
                    work.follower.settle_offer(task, offer)
                board.failures[task] = problem
                raise WorkRefused(problem)
            if unnamed:
                board.add(Entry("planned", task, plan=answer.plan_id, offer=offer))
        sentence = Sentence("work.plan", task=title, plan=answer.plan_id, duration=answer.duration, method=plan.method)
        return _under_review(sentence, task, answer.plan_id, answer.plan_hash, answer.duration)

    def _plan_way_back(self, asked: str) -> Outcome:
        heard = self.heard
        if problem := self._opened().scene.make_for_way_back():
            raise WorkRefused(Sentence("work.back.not_yet", problem=problem))
        before = heard.plan.message.id if heard.plan is not None else ""
        problem, answer = self._outputs.plan_way_back(TriggerRequest())
        if answer is None or not answer.success:
            raise WorkRefused(Sentence("work.back.refused", problem=problem or answer.message))
        heard.wait_for(lambda: heard.plan is not None and heard.plan.message.id != before, SCENE_TIME)
        known = heard.plan
        if known is None or known.message.id == before:
            raise WorkRefused(Sentence("work.back.unpublished"))
        plan = known.message
        sentence = Sentence("work.back.planned", answer=answer.message)
        return _under_review(sentence, asked, plan.id, plan.hash, plan.duration)

    def on_decide(self, request: WorkDecideRequest) -> str:
        """Take what a person decides of a task or the schedule."""
        with self._lock:
            sentence = self._decided(self.board, request)
            problem = self._left_closed() if request.decision == "answer" else ""
            if problem:
                sentence = Sentence("executor.both", first=sentence, second=problem)
        rospy.loginfo("%s (%s)", sentence, request.person)
        self.heard.announce()
        return sentence

    @staticmethod
    def _decided(board: TaskBoard, request: WorkDecideRequest) -> str:
        if request.decision == "accept_schedule":
            return board.accept(request.person, request.reason)
        if request.decision == "answer_all":
            return board.answer_all(request.answer, request.person, request.reason)
        if request.decision == "answer":
            return board.answer(request.task, request.answer, request.person, request.reason, request.question)
        if request.decision in DECISIONS:
            return DECISIONS[request.decision](board, request.task, request.person, request.reason)
        raise WorkRefused(Sentence("work.decision", decision=repr(request.decision)))

    def on_measured(self, request: WorkMeasuredRequest) -> Outcome:
        """Take where a person has measured an element."""
        pose = self._pose_in_base(request)
        with self._lock:
            found = self.board.measured(request.element, pose, request.person, request.reason)
        self.heard.announce()
        distance, angle = found.distance * 1e3, math.degrees(found.angle)
        sentence = Sentence("work.measured", element=request.element, distance=distance, angle=angle)
        return Outcome(True, sentence, fields={"deviation_mm": distance, "deviation_deg": angle})

    def _pose_in_base(self, request: WorkMeasuredRequest) -> Pose:
        pose = pose_from_msg(request.pose.pose)
        frame = request.pose.header.frame_id
        if frame in ("", self._base_frame):
            return pose
        try:
            transform = self._inputs.transform(frame, request.pose.header.stamp)
        except FrameError as error:
            raise WorkRefused(str(error)) from error
        return product(pose_from_transform_msg(transform.transform), pose)

    # -- reports

    def _fail(self, sentence: str) -> None:
        """Go on without the work: its record or its model cannot be used."""
        rospy.logerr("%s", sentence)
        with self._lock:
            self._problem, self._work, self._broken = sentence, None, True
        self._publish()

    def _publish(self) -> None:
        with self._lock:
            work, message = self._work, self._message()
        if self._told is not None:
            message.header.stamp = self._told.header.stamp
            if message == self._told or repr(message) == repr(self._told):
                return
        message.header.stamp = rospy.Time.now()
        self._told = message
        self._outputs.tasks.publish(message)
        if work is not None:
            self._draw(work.board)

    def _draw(self, board: TaskBoard) -> None:
        with self._lock:
            shown = board.appearances(time.time_ns())
        drawn = []
        for one in shown:
            key = f"{one.element} stock" if one.word == "stock" else f"{one.element} {one.word == 'carried'}"
            link = self._robot.tip_link if one.word == "carried" else ""
            triangles = board.prepared.elements[one.element].triangles
            drawn.append(DrawnElement(key, one.name, triangles, one.pose, one.word, link))
        picture = work_picture(drawn, self._drawn)
        self._drawn = picture.keys
        self._outputs.markers.publish(work_marker_array(picture, self._robot.base_link, self._settings.tf_prefix))

    def _message(self) -> WorkTasks:
        engaged = self.heard.execution is not None and self.heard.execution.engaged
        if self._work is None:
            model, reading = Path(self._settings.model).name, not self._broken
            return WorkTasks(model=model, engaged=engaged, reading=reading, reason=self._problem)
        report = self._work.board.report(time.time_ns())
        if engaged:
            blocked = self._work.scene.blocked
            reason = Sentence("work.back.blocked", problem=blocked) if blocked else Sentence("work.back.only")
            report = replace(report, engaged=True, reason=reason)
        return to_msg(report, WorkTasks)

    def report(self) -> Report:
        """Return the state of the work for `/diagnostics`."""
        with self._lock:
            if self._work is None:
                return Report(ERROR if self._broken else WARN, self._problem)
            board = self._work.board
            values: dict[str, object] = {state.value: len(board.book.in_state(state)) for state in TaskState}
            values["lines of the ledger"] = board.ledger.lines
            values["notes on the model"] = len(board.notes)
            asks = bool(board.book.in_state(TaskState.ASKS))
            return Report(WARN if asks else OK, board.summary(time.time_ns()), values)


#: What a person says of a task, without more than a reason.
DECISIONS = {"skip": TaskBoard.skip, "redo": TaskBoard.redo, "removed": TaskBoard.removed}


def _under_review(sentence: str, task: str, plan_id: str, plan_hash: str, duration: float) -> Outcome:
    fields = {"task": task, "plan_id": plan_id, "plan_hash": plan_hash, "duration": duration}
    return Outcome(True, sentence, fields=fields)


def ledger_path(folder: Path, robot: str, cell: str) -> Path:
    """Return the file of a ledger: one for each robot and site, by the name of its cell file, whatever is built there."""
    return folder / f"{robot}_{Path(cell).stem}.jsonl"


def _call(name: str, kind: type, timeout: float, request: Any) -> tuple[str, Any]:
    """Call a service; return why there is no answer within a time [s], and the answer."""
    service = rospy.resolve_name(name)
    try:
        rospy.wait_for_service(service, timeout)
        return "", rospy.ServiceProxy(service, kind)(request)
    except (rospy.ROSException, rospy.ServiceException) as error:
        return Sentence("work.silent", service=service, problem=str(error)), None


def start(settings: Settings, robot: RobotModel, ports: Ports) -> WorkNode:
    """Return the node with its parameters, topics and services."""
    refuse = ports.diagnostics.refuse
    twin = ports.poses["twin/joint_states"]
    # without a physical arm the twin's pose counts as measured
    arm = ports.poses.get("physical/joint_states", twin)
    timeout = settings.service_timeout
    frames = listen_to_frames(robot, settings.tf_prefix, timeout, refuse)
    # what became of a plan is read there after a restart
    review_file = robot_file(ports.parameters[RECORD], robot.name)
    worker = Worker()
    rospy.on_shutdown(worker.close)
    return WorkNode(
        settings,
        robot,
        ports.parameters["planner"],
        worker,
        WorkListener(ports.connections, rospy.is_shutdown, review_file, refuse),
        Inputs(
            functools.partial(twin.pose, MAX_POSE_AGE, MAX_POSE_AGE),
            functools.partial(arm.pose, MAX_POSE_AGE, MAX_POSE_AGE),
            frames.transform,
        ),
        Outputs(
            ports.publishers["work/tasks"],
            ports.publishers["work/markers"],
            functools.partial(_call, "edit_scene", EditScene, timeout),
            functools.partial(_call, "plan_work", PlanWork, timeout),
            functools.partial(_call, "plan_way_back", Trigger, timeout),
        ),
        ports.diagnostics,
    )


def _heard(handler: Callable[[WorkListener, Any], object]) -> Callable[[WorkNode, Any], object]:
    """Return a handler of the node, which gives its message to the listener."""
    return lambda node, message: handler(node.heard, message)


INTERFACE = Interface(
    report=WorkNode.report,
    parameters=(SharedParameter("planner", {}), SharedParameter(RECORD, "")),
    publishes=(
        Publication("work/tasks", WorkTasks, queue_size=5, latch=True),
        Publication("work/markers", MarkerArray, queue_size=2, latch=True),
    ),
    reads=(NewestPose("twin/joint_states"), NewestPose("physical/joint_states", when=has_arm)),
    hears=(
        Subscription("engagement", Engagement, _heard(WorkListener.on_engagement), queue_size=5),
        Subscription("execution", Execution, _heard(WorkListener.on_execution), queue_size=50),
        Subscription("plan", Plan, _heard(WorkListener.on_plan), queue_size=5),
        Subscription("review", Review, _heard(WorkListener.on_review), queue_size=20),
        Subscription("scene", Scene, _heard(WorkListener.on_scene), queue_size=2),
        Subscription("tool", ToolState, _heard(WorkListener.on_tool), queue_size=5),
    ),
    listeners=FRAMES,
    serves=(
        Served("work/plan", WorkPlanTask, WorkNode.on_plan_task, refused=lambda _, request: {"task": request.task}),
        Served("work/decide", WorkDecide, WorkNode.on_decide),
        Served("work/measured", WorkMeasured, WorkNode.on_measured, refused=lambda *_: NOT_MEASURED),
    ),
)


def check(settings: Settings, _robot: RobotModel, _shared: Shared) -> None:
    """Check packages, files, and that the robot's tool and scene are the cell's; see `NodeShell`."""
    check_extras("work")
    for name, path in (("model", settings.model), ("cell", settings.cell)):
        if not Path(path).is_file():
            raise ConfigurationError(f"work_{name}", path, "the absolute path of a file")
    site = read_site(settings.cell)
    for name, given, named in (("tool", settings.tool, site.file.tool), ("scene", settings.scene, site.file.scene)):
        wanted = (Path(settings.cell).parent / named).resolve()
        if Path(given).resolve() != wanted:
            path, cell = str(wanted), settings.cell
            raise ConfigurationError(
                name, given, Sentence("expected.as_cell", wanted=path, cell=cell, name=name, path=path)
            )


NODE = NodeShell("work", Settings, start, INTERFACE, check)


def main() -> None:
    """Run the node until shutdown."""
    NODE.run()
