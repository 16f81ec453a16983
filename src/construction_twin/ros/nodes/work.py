"""work: the tasks of a building model, from schedule to ledger: has them planned, and changes the scene with them.

Nothing moves without a person's approval, as of every plan. What is written in the ledger is on the disk before the scene changes;
without the changed scene the executor does not go on: killed at any instant, it comes back with what is true, or asks.
"""

from __future__ import annotations

import math
import queue
import threading
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import pydantic
import rospy
import tf2_ros
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError
from construction_twin.core.motion_errors import SceneError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.msg import Engagement, Execution, Review, ToolState, WorkTasks
from construction_twin.msg import Plan as PlanMsg
from construction_twin.msg import Scene as SceneMsg
from construction_twin.review.record import read_fate
from construction_twin.ros.messages.convert import (
    pose_from_msg,
    pose_from_transform_msg,
    trajectory_from_msg,
)
from construction_twin.ros.messages.scene_convert import object_to_msg, scene_from_msg, tf_frame
from construction_twin.ros.messages.work_convert import left_from_msg, step_from_msg, task_to_msg, work_segment_to_msg
from construction_twin.ros.messages.work_marker_convert import work_marker_array
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node import Service, run_node
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters, ros_home
from construction_twin.ros.shared.private_files import PrivateFiles
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.scene.objects import Scene, product
from construction_twin.srv import (
    EditScene,
    EditSceneRequest,
    PlanWork,
    PlanWorkRequest,
    WorkDecide,
    WorkDecideRequest,
    WorkDecideResponse,
    WorkMeasured,
    WorkMeasuredRequest,
    WorkMeasuredResponse,
    WorkPlanTask,
    WorkPlanTaskRequest,
    WorkPlanTaskResponse,
)
from construction_twin.views.work_markers import DrawnElement, work_picture
from construction_twin.work import engaged_scene, following
from construction_twin.work.built import as_built, change, pose_of_tuple, pose_tuple
from construction_twin.work.desk import Desk, Prepared, WorkRefused
from construction_twin.work.following import Followed, Grip, Verdict
from construction_twin.work.glb import ShownElement, glb
from construction_twin.work.jobs import WorkPlan
from construction_twin.work.ledger import MEASURED, PLANNED, Entry, Ledger
from construction_twin.work.task_states import UNDER_WAY, TaskState
from construction_twin.work.worker import Worker, WorkerError

#: States of the executor in which a plan is under way.
_AT_REST = (Execution.WAITING, Execution.IDLE)
#: Verdicts that are remembered.
_KEPT = 100
#: Work plans and scenes that are remembered for an arm that is left engaged.
_KEPT_PLANS, _KEPT_SCENES = 4, 12
#: How long a changed scene may take from the scene node to this one [s].
_SCENE_TIME = 2.0


class Settings(pydantic.BaseModel):
    """Private parameters: behaviour is explained in config/work.yaml, the others are given in launch/work.launch.

    Attributes
    ----------
    model, cell : str
        Absolute paths of the IFC file and of the cell file.
    self_collision : str
        YAML of the link pairs that are not checked.
    tf_prefix : str
        Of the twin's tf frames.
    review_file : str
        The executor's record of verdicts, which is read after a restart.
    folder : str
        Of the ledgers.
    arm : str
        ``mock``, ``real`` or ``none``: without a physical arm the twin's pose counts as measured.
    private : str
        Folder of what a console serves to whom is logged in, relative to ROS_HOME; empty: no console was started.
    max_pose_age, service_timeout, listen_time, retry_time : float
        [s]
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    model: str
    cell: str
    self_collision: str
    tf_prefix: str
    review_file: str
    folder: str
    arm: str
    private: str = ""
    max_pose_age: Annotated[float, pydantic.Field(gt=0.0, le=60.0)]
    service_timeout: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    listen_time: Annotated[float, pydantic.Field(gt=0.0, le=60.0)]
    retry_time: Annotated[float, pydantic.Field(gt=0.0, le=60.0)]


class WorkNode:
    """Services `work/plan`, `work/decide`, `work/measured`; latched topics `work/tasks`, `work/markers`.

    Listens to `execution`, `engagement`, `plan`, `review`, `scene`, `tool`, the poses of twin and arm, and tf. Calls `plan_work`,
    `plan_way_back` and `edit_scene`.
    """

    def __init__(self):
        self._settings = read_parameters(Settings)
        self._robot = robot_from_parameters()
        self._chain = Chain(self._robot)
        self._base_frame = tf_frame(self._settings.tf_prefix, self._robot.base_link)
        self._worker = Worker()
        # guards desk and ledger; never held while somebody else is waited for who may wait for it
        self._lock = threading.RLock()
        self._planning = threading.Lock()
        self._desk: Desk | None = None
        self._problem = "the model is being read"
        self._broken = False
        self._news: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._heard = threading.Condition()
        self._execution: Execution | None = None
        self._plan: PlanMsg | None = None
        #: The planner that published it is still there, and gives it to an executor that starts anew.
        self._plan_offered = False
        #: The last verdicts, by plan.
        self._verdicts: dict[str, Review] = {}
        self._tool: ToolState | None = None
        self._scene: Scene | None = None
        #: Those seen last, the newest last, by hash; and the work plans, by id: of them an engaged arm's scene is made.
        self._scenes: dict[str, Scene] = {}
        self._work_plans: dict[str, PlanMsg] = {}
        self._steps: dict[str, tuple[engaged_scene.Step, ...]] = {}
        #: None: the executor has not said yet whether the arm is engaged.
        self._engagement: Engagement | None = None
        #: Why the scene of an engaged arm cannot be made right, and of what that was said.
        self._blocked = ""
        self._blocked_in: tuple | None = None
        self._told: WorkTasks | None = None
        self._clearances: list[float] = []
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        refuse = self._diagnostics.refuse
        self._tasks_publisher = Publisher("work/tasks", WorkTasks, queue_size=5, latch=True)
        self._markers_publisher = Publisher("work/markers", MarkerArray, queue_size=2, latch=True)
        self._drawn: frozenset[str] = frozenset()
        self._twin = LatestPose("twin/joint_states", self._robot.joint_names, refuse)
        measured = "physical/joint_states" if self._settings.arm != "none" else "twin/joint_states"
        self._arm = LatestPose(measured, self._robot.joint_names, refuse)
        self._tf = tf2_ros.Buffer()
        self._tf_listener = tf2_ros.TransformListener(self._tf)
        self._subscribers = {
            "engagement": Subscriber("engagement", Engagement, self._on_engagement, refuse, queue_size=5),
            "execution": Subscriber("execution", Execution, self._on_execution, refuse, queue_size=50),
            "plan": Subscriber("plan", PlanMsg, self._on_plan, refuse, queue_size=5),
            "review": Subscriber("review", Review, self._on_review, refuse, queue_size=20),
            "scene": Subscriber("scene", SceneMsg, self._on_scene, refuse, queue_size=2),
            "tool": Subscriber("tool", ToolState, self._on_tool, refuse, queue_size=5),
        }
        rospy.on_shutdown(self._worker.close)
        self._publish()
        Service("work/plan", WorkPlanTask, self._on_plan_task)
        Service("work/decide", WorkDecide, self._on_decide)
        Service("work/measured", WorkMeasured, self._on_measured)

    def run(self) -> None:
        """Read the model, find out what became of the work before this start, then follow what the executor does."""
        try:
            self._load()
        except ConstructionTwinError as error:
            self._fail(str(error))
        while not rospy.is_shutdown():
            try:
                self._news.get(timeout=self._settings.retry_time)()
            except queue.Empty:
                pass  # nothing was said: what did not work before is tried again below
            if self._desk is None:
                continue
            try:
                self._catch_up()
            except ConstructionTwinError as error:
                # of the ledger: nothing is done without it, and the executor waits for the scene in vain
                self._fail(str(error))

    # -- the start

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
            planner=rospy.get_param("planner", {}),
            cache=str(ros_home() / settings.folder),
        )
        if rospy.is_shutdown():
            return
        path = ledger_path(ros_home() / settings.folder, self._robot.name, prepared.model)
        ledger = Ledger(
            path, prepared.after, prepared.digest, time.time_ns, str(Path(prepared.cell).resolve()), prepared.placed_by
        )
        desk = Desk(prepared, ledger, self._robot.name, self._robot.tip_link)
        rospy.loginfo(
            "%s: %d tasks, %d lines in %s; read in %.1f s",
            prepared.model, len(prepared.schedule.jobs), ledger.lines, path, time.monotonic() - began,
        )  # fmt: skip
        for note in desk.notes:
            rospy.loginfo("%s", note)
        if files is not None:
            self._show_building(prepared, files)
        with self._lock:
            self._problem, self._desk = "", desk
        # nothing is tidied before it is known whether the arm was left engaged
        self._wait(lambda: self._execution is not None and not self._unsaid(), min(1.0, settings.listen_time))
        self._recall()

    def _show_building(self, prepared: Prepared, files: PrivateFiles) -> None:
        """Write the model where a console serves it; without it everything else goes on."""
        shown = [
            ShownElement(key, facts.name, facts.triangles, facts.base_T_goal)
            for key, facts in prepared.elements.items()
        ]
        try:
            files.write_building(glb(shown, prepared.digest))
        except ConstructionTwinError as error:
            self._diagnostics.refuse("building", str(error))

    def _recall(self) -> None:
        """Find out what became of a plan that the ledger has as offered or under way."""
        desk = self._desk
        assert desk is not None
        task = desk.busy()
        if not task:
            return
        # latched messages come within a moment of the connection; the executor may only now be starting
        self._wait(lambda: self._execution is not None and self._tool_heard(), self._settings.listen_time)
        self._wait(lambda: self._plan is not None and not self._unsaid(), min(1.0, self._settings.listen_time))
        with self._lock:
            self._follow(self._execution)
            self._resolve()

    def _resolve(self) -> None:
        """Settle a task whose plan the executor does not report, and never will: by its record, else by asking."""
        desk = self._desk
        task = desk.busy() if desk is not None else ""
        if desk is None or not task or self._unsaid():
            return
        memory, element = desk.ledger.book.tasks[task], desk.element_of(task)
        if self._execution is not None and memory.plan and self._execution.plan_id == memory.plan:
            return
        verdict, outcome = self._verdict(memory.plan, memory.offer)
        if outcome == following.FINISHED:
            ended = following.Report(verdict.plan, False, outcome)
            followed = Followed(verdict.plan, task, "", -1 if memory.in_grip else 0, 0)
            built, source = self._planned_end(task, verdict.plan)
            entries = following.follow(memory, element, followed, ended, self._grip(), built, source)
        else:
            entries = following.after_restart(memory, element, verdict, self._grip())
        for entry in entries:
            rospy.logwarn("%s: %s; %s", desk.title(task), entry.event, entry.reason)
            desk.ledger.add(entry)

    def _tool_heard(self) -> bool:
        return self._tool is not None or not self._subscribers["tool"].get_num_connections()

    def _verdict(self, plan_id: str, offer: str) -> tuple[Verdict, str]:
        """Return what became of a plan, from the topics, else from the executor's record; and its outcome."""
        plan = self._plan
        if plan is not None and (plan.id == plan_id or (offer and offer in plan.source)):
            if plan.id not in self._verdicts and self._subscribers["plan"].get_num_connections():
                return Verdict(plan.id, True, False), ""
            plan_id = plan.id
        fate = read_fate(ros_home() / Path(self._settings.review_file).expanduser(), plan_id, offer)
        return Verdict(fate.plan, False, fate.approved), fate.outcome

    # -- subscriptions; all that is done is done in `run`

    def _on_execution(self, message: Execution) -> None:
        def hear() -> None:
            self._execution = message

        self._hear(hear)

    def _on_plan(self, message: PlanMsg) -> None:
        try:
            steps = tuple(map(step_from_msg, message.segments))
        except SceneError as error:
            self._diagnostics.refuse("plan", str(error))
            return

        def hear() -> None:
            self._plan, self._plan_offered = message, True
            # a way back changes nothing, and may be planned again and again
            if any(step.before != step.after for step in steps):
                _keep(self._work_plans, message.id, message, _KEPT_PLANS)
                _keep(self._steps, message.id, steps, _KEPT_PLANS)

        self._hear(hear)

    def _on_engagement(self, message: Engagement) -> None:
        def hear() -> None:
            self._engagement = message

        self._hear(hear)

    def _on_review(self, message: Review) -> None:
        def hear() -> None:
            _keep(self._verdicts, message.plan_id, message, _KEPT)

        self._hear(hear)

    def _on_tool(self, message: ToolState) -> None:
        def hear() -> None:
            self._tool = message

        self._hear(hear)

    def _on_scene(self, message: SceneMsg) -> None:
        try:
            scene = scene_from_msg(message)
        except SceneError as error:
            self._diagnostics.refuse("scene", str(error))
            return

        def hear() -> None:
            self._scene = scene
            _keep(self._scenes, scene.hash, scene, _KEPT_SCENES)

        self._hear(hear)

    def _hear(self, change_state: Callable[[], None]) -> None:
        with self._heard:
            change_state()
            self._heard.notify_all()
        self._news.put(self._publish)

    def _wait(self, condition: Callable[[], object], seconds: float) -> bool:
        with self._heard:
            return bool(self._heard.wait_for(lambda: condition() or rospy.is_shutdown(), seconds))

    # -- what is followed

    def _catch_up(self) -> None:
        # one report for both: the scene may change only after what was written of it
        report = self._execution
        with self._lock:
            self._follow(report)
            self._drop_if_turned_down()
            self._resolve_if_lost()
            self._doubt_if_open()
            idle = self._desk is not None and not self._desk.busy()
        self._change_scene(report)
        engaged = self._engaged()
        if not engaged:
            self._blocked, self._blocked_in = "", None
        if (idle or engaged) and not self._playing() and self._planning.acquire(blocking=False):
            try:
                if engaged:
                    self._make_engaged_scene()
                elif self._execution is not None or not self._subscribers["execution"].get_num_connections():
                    self._tidy_scene()
            finally:
                self._planning.release()
        self._publish()

    def _playing(self) -> bool:
        return self._execution is not None and self._execution.state not in _AT_REST

    def _engaged(self) -> bool:
        """Return whether the arm was left engaged, or may have been."""
        return (self._execution is not None and self._execution.engaged) or self._left() is not None

    def _left(self) -> Engagement | None:
        """Return where the arm was left engaged; None: it was not, or that is not known yet."""
        return self._engagement if self._engagement is not None and self._engagement.engaged else None

    def _unsaid(self) -> bool:
        """Return whether the arm was left engaged and `engagement` does not say yet where: the disk takes that first."""
        return self._execution is not None and self._execution.engaged and self._left() is None

    def _follow(self, report: Execution | None) -> None:
        """Write what a report says of the task under way."""
        desk, plan, left = self._desk, self._plan, self._left()
        if desk is None or report is None:
            return
        task = desk.busy()
        if not task or self._unsaid():
            return
        memory = desk.ledger.book.tasks[task]
        if left is not None and left.plan_id == memory.plan and left.plan_id in self._work_plans:
            if report.plan_id != memory.plan or report.state in _AT_REST:
                self._follow_left(task, left, report)
                return
        followed = self._followed(task, plan) if plan is not None else None
        if followed is None or followed.id != report.plan_id:
            followed = Followed(memory.plan, task, "", -2, -2)
            if not memory.plan or report.plan_id != memory.plan:
                return
            if not report.outcome:
                return  # without the plan nothing can be told of its segments; its end will be heard
            if report.outcome == following.FINISHED:
                followed = Followed(memory.plan, task, "", -1 if memory.in_grip else 0, 0)
        said = following.Report(
            plan=report.plan_id,
            playing=report.state not in _AT_REST,
            outcome=report.outcome if report.state in _AT_REST else "",
            segment=report.segment,
            at_boundary=report.at_boundary,
            wants_scene=report.wants_scene,
            reason=report.reason,
        )
        self._write(task, followed, said)

    def _follow_left(self, task: str, left: Engagement, report: Execution) -> None:
        """Write how the task's plan ended inside an engaged segment: what the tool has done by then is done."""
        plan = self._work_plans[left.plan_id]
        followed = self._followed(task, plan)
        if followed is None:
            return
        numbers = [number for number, segment in enumerate(plan.segments) if segment.name == left.segment]
        mine = report.plan_id == plan.id
        # after a restart of the executor only the segment's name is known
        number = report.segment if mine else numbers[0] if len(numbers) == 1 else -1
        confirmed = 0 <= number < len(plan.segments) and engaged_scene.confirmed(
            left_from_msg(left), self._steps[plan.id][number]
        )
        outcome = (report.outcome if mine else "") or "stopped"
        said = following.Report(
            plan=plan.id,
            playing=False,
            outcome=outcome,
            segment=number,
            # only there the arm still stands as it let go
            at_boundary=mine and (confirmed or report.at_boundary),
            reason=left.reason,
            confirmed=confirmed,
        )
        self._write(task, followed, said)

    def _write(self, task: str, followed: Followed, said: following.Report) -> None:
        """Write the lines that follow from a report."""
        desk = self._desk
        assert desk is not None
        memory = desk.ledger.book.tasks[task]
        built, source = self._as_built(task, followed, said) if followed.releases >= 0 else ((), "")
        entries = following.follow(memory, desk.element_of(task), followed, said, self._grip(), built, source)
        for entry in entries:
            desk.ledger.add(entry)
            rospy.loginfo("%s: %s%s", desk.title(task), entry.event, f"; {entry.reason}" if entry.reason else "")

    def _followed(self, task: str, plan: PlanMsg) -> Followed | None:
        """Return a plan of a task as it is followed; None when it is another's."""
        assert self._desk is not None
        memory = self._desk.ledger.book.tasks[task]
        if plan.task != task or not (plan.id == memory.plan or (memory.offer and memory.offer in plan.source)):
            return None
        tool = self._desk.prepared.tool
        closes, opens = -1, -1
        for number, segment in enumerate(plan.segments):
            for switch in segment.switches:
                if tool.grip.set.get(switch.output) == switch.value and any(item.link for item in segment.put):
                    closes = number
                if (
                    tool.release.set.get(switch.output) == switch.value
                    and opens < 0
                    and (closes >= 0 or memory.in_grip)
                ):
                    opens = number
        return Followed(plan.id, task, plan.source, closes, opens)

    def _as_built(self, task: str, followed: Followed, report: following.Report) -> tuple[tuple[float, ...], str]:
        """Return where the element stands if let go now: by the arm's own pose at the boundary, else by the plan's; and which."""
        assert self._desk is not None
        memory, planned = self._desk.ledger.book.tasks[task], self._planned_pose(followed)
        if planned is None or not memory.tool0_T_element or memory.state is TaskState.RETREATING:
            return (), ""
        q, source = planned, PLANNED
        if report.segment == followed.releases and (report.at_boundary or report.wants_scene):
            try:
                q, source = self._arm.pose(self._settings.max_pose_age, self._settings.max_pose_age), MEASURED
            except (PoseUnknownError, PayloadError) as error:
                self._diagnostics.refuse("pose", f"the planned pose is taken for the arm's: {error}")
        held, goal = pose_of_tuple(memory.tool0_T_element), self._desk.goal(task)
        return pose_tuple(as_built(self._chain.forward(q), self._chain.forward(planned), held, goal)), source

    def _planned_pose(self, followed: Followed) -> tuple[float, ...] | None:
        """Return where the arm was to let go [rad], [m]; None when the plan is not known any more."""
        plan = self._work_plans.get(followed.id)
        if plan is None or not 0 <= followed.releases < len(plan.segments):
            return None
        return tuple(trajectory_from_msg(plan.trajectory).sample(plan.segments[followed.releases].end)[0])

    def _planned_end(self, task: str, plan_id: str) -> tuple[tuple[float, ...], str]:
        """Return where the element was to be let go by a plan that has been carried out; empty when it is not known any more."""
        plan = self._plan
        followed = self._followed(task, plan) if plan is not None and plan.id == plan_id else None
        return ((), "") if followed is None else self._as_built(task, followed, following.Report(plan_id, False, ""))

    def _resolve_if_lost(self) -> None:
        """Settle a task under way that the executor does not know: it was started anew, or has gone on to another plan."""
        desk, report = self._desk, self._execution
        task = desk.busy() if desk is not None else ""
        if desk is None or not task or report is None:
            return
        memory = desk.ledger.book.tasks[task]
        if memory.state in UNDER_WAY and report.plan_id != memory.plan:
            self._resolve()
        elif memory.state is TaskState.PLANNED and self._nobody_has(memory.plan):
            self._resolve()

    def _nobody_has(self, plan_id: str) -> bool:
        """Return whether a plan under review went with planner and executor, so that nobody can approve it any more."""
        if not self._subscribers["plan"].get_num_connections():
            self._plan_offered = False
        # an executor that is still there has the plan, whatever became of the planner
        gone = not self._plan_offered and not self._subscribers["execution"].get_num_connections()
        if not (gone and self._plan is not None and self._plan.id == plan_id):
            return False
        self._plan = None
        return True

    def _doubt_if_open(self) -> None:
        """Have it asked about what counts as carried, when the tool is surely open."""
        if self._desk is not None and not self._playing() and self._grip().surely_open:
            sentence = self._desk.lost()
            if sentence:
                rospy.logwarn("%s", sentence)

    def _drop_if_turned_down(self) -> None:
        """Take note of a plan under review that was rejected, replaced, or is void."""
        desk = self._desk
        task = desk.busy() if desk is not None else ""
        if desk is None or not task:
            return
        memory = desk.ledger.book.tasks[task]
        review = self._verdicts.get(memory.plan)
        if memory.state is TaskState.PLANNED and review is not None and not review.approved:
            reason = f"{review.reviewer}: {review.reason}"
            desk.ledger.add(Entry("dropped", task, desk.element_of(task), plan=memory.plan, reason=reason))
            desk.failures[task] = f"its plan was turned down by {reason}"

    def _grip(self) -> Grip:
        """Return what the tool says of its grip."""
        tool, desk = self._tool, self._desk
        if tool is None or desk is None or not tool.known or not self._subscribers["tool"].get_num_connections():
            return Grip(False, False)
        outputs = dict(zip(tool.outputs, tool.output_values))
        inputs = dict(zip(tool.inputs, tool.input_values))
        description = desk.prepared.tool
        asked = any(outputs.get(name) == value for name, value in description.grip.set.items())
        holds = any(inputs.get(name) == value for name, value in description.grip.confirm.items())
        return Grip(True, asked or holds)

    # -- the scene

    def _change_scene(self, report: Execution | None) -> None:
        """Change the scene as planned, when a report, which has been followed, says that the executor waits for it."""
        desk, plan, scene = self._desk, self._plan, self._scene
        if desk is None or report is None or plan is None or scene is None:
            return
        if not report.wants_scene or report.plan_id != plan.id or not 0 <= report.segment < len(plan.segments):
            return
        segment = plan.segments[report.segment]
        task = desk.busy()
        if not task or desk.ledger.book.tasks[task].plan != plan.id or scene.hash == segment.scene_after:
            return
        self._edit(
            EditSceneRequest(before=segment.scene, put=segment.put, remove=segment.remove, after=segment.scene_after)
        )

    def _tidy_scene(self) -> None:
        """Make the scene what the ledger says: tool, stock, placed elements."""
        scene = self._scene
        if scene is None or self._desk is None:
            return
        with self._lock:
            if self._desk.in_doubt:
                return
            wanted, alone = self._desk.wanted_scene()
        wrong = change(scene, wanted, alone)
        if wrong:
            put = [object_to_msg(item) for item in wrong.put]
            self._edit(EditSceneRequest(before=scene.hash, put=put, remove=list(wrong.remove)))

    def _make_engaged_scene(self) -> str:
        """Make the scene one in which an engaged arm can go back; return why not, empty when it is.

        What the ledger has to say of the stop is on the disk before.
        """
        left = self._left()
        if left is None:
            return (
                "the executor has not said yet where the arm was left engaged; its log says whether the disk takes it"
            )
        with self._lock:
            desk, scene = self._desk, self._scene
            if scene is None:
                return "the scene is not known; see why the scene node is down"
            if scene.hash in left.scenes:
                self._blocked, self._blocked_in = "", None
                return ""
            if desk is None:
                return self._problem
            if self._playing():
                return "a plan is under way, and the scene is not the one for the way back; wait for its end"
            self._follow(self._execution)
            self._resolve_if_lost()
            memory = desk.ledger.book.tasks.get(left.task)
            if memory is not None and memory.plan == left.plan_id and memory.state in UNDER_WAY:
                return f"{desk.title(left.task)}: how its plan ended is not written yet; ask again"
            steps = self._steps.get(left.plan_id, ())
            about = (left.plan_id, tuple(left.scenes), scene.hash, bool(steps), memory.state if memory else None)
            if about == self._blocked_in:
                return self._blocked
            with self._heard:
                earlier = list(reversed(self._scenes.values()))
            element = desk.element_of(left.task) if memory is not None else ""
            forms = desk.forms(left.task) if memory is not None else ()
            found = engaged_scene.due(left_from_msg(left), scene, steps, earlier, element, forms)
        if found.change is None:
            self._blocked, self._blocked_in = found.sentence, about
            self._diagnostics.refuse("engagement", found.sentence)
            return found.sentence
        put = [object_to_msg(item) for item in found.change.put]
        request = EditSceneRequest(before=scene.hash, put=put, remove=list(found.change.remove), after=found.after)
        # tried again as long as the scene node refuses
        self._blocked, self._blocked_in = self._edit(request), None
        return self._blocked

    def _edit(self, request: EditSceneRequest) -> str:
        """Have the scene changed; return why not, empty when it was and the change has arrived here."""
        problem, answer = self._call("edit_scene", EditScene, request)
        if answer is None or not answer.success:
            sentence = problem or answer.message
            self._diagnostics.refuse("edit_scene", sentence)
            return sentence
        if not self._wait(lambda: self._scene is not None and self._scene.hash == answer.hash, _SCENE_TIME):
            return "the scene was changed, but is not published"
        return ""

    def _call(self, name: str, kind: type, request) -> tuple[str, Any]:
        """Call a service; return why there is no answer, and the answer."""
        service = rospy.resolve_name(name)
        try:
            rospy.wait_for_service(service, self._settings.service_timeout)
            return "", rospy.ServiceProxy(service, kind)(request)
        except (rospy.ROSException, rospy.ServiceException) as error:
            return f"{service} does not answer: {error}", None

    # -- services

    def _on_plan_task(self, request: WorkPlanTaskRequest) -> WorkPlanTaskResponse:
        if not self._planning.acquire(timeout=self._settings.service_timeout):
            return WorkPlanTaskResponse(
                False, "a task is being planned already; wait for it", request.task, "", "", 0.0
            )
        try:
            return self._plan_task(request.task)
        except ConstructionTwinError as error:
            self._diagnostics.count(type(error).__name__, str(error))
            rospy.logwarn("no plan for task %r: %s", request.task, error)
            return WorkPlanTaskResponse(False, str(error), request.task, "", "", 0.0)
        finally:
            self._planning.release()
            self._news.put(self._publish)

    def _plan_task(self, asked: str) -> WorkPlanTaskResponse:
        if self._engaged():
            self._wait(lambda: not self._unsaid(), _SCENE_TIME)
        if self._engaged():
            if problem := self._make_engaged_scene():
                raise WorkRefused(f"the arm is engaged, only the way back can be planned, and not yet: {problem}")
            return self._plan_way_back(asked)
        task, desk = self._allowed(asked)
        self._tidy_scene()
        with self._lock:
            # while the scene was made right, somebody may have said something else
            self._allowed(task)
            memory = desk.ledger.book.tasks[task]
            held = memory.tool0_T_element if memory.state is TaskState.CARRIED else ()
            scene = self._scene
            wanted, alone = desk.wanted_scene()
        if scene is None:
            raise WorkRefused("the scene is not known; see why the scene node is down")
        if change(scene, wanted, alone):
            raise WorkRefused(
                "the scene could not be made what the ledger says; /diagnostics of the node work says why"
            )
        start = self._twin.pose(self._settings.max_pose_age, self._settings.max_pose_age)
        began = time.monotonic()
        try:
            plan: WorkPlan = self._worker.ask(
                "plan", task=task, element=desk.element_of(task), start=start, scene=scene, held=held
            )
        except WorkerError as error:
            desk.failures[task] = str(error)
            raise
        desk.failures.pop(task, None)
        rospy.loginfo("%s: planned with %s in %.2f s", desk.title(task), plan.grip, time.monotonic() - began)
        return self._offer(task, plan, desk)

    def _allowed(self, asked: str) -> tuple[str, Desk]:
        with self._lock:
            if self._desk is None:
                raise WorkRefused(self._problem)
            now = time.time_ns()
            task = asked or self._desk.next(now)
            if not task:
                raise WorkRefused(self._desk.summary(now))
            obstacle = self._desk.obstacle(task, now)
            if obstacle:
                raise WorkRefused(obstacle)
            return task, self._desk

    def _offer(self, task: str, plan: WorkPlan, desk: Desk) -> WorkPlanTaskResponse:
        """Have the planner check a plan and put it under review; the ledger knows of it before."""
        offer, element = uuid.uuid4().hex[:12], desk.element_of(task)
        title = desk.title(task)
        held = pose_tuple(plan.tool0_T_element)
        with self._lock:
            self._allowed(task)
            desk.ledger.add(Entry("offered", task, element, offer=offer, grip=plan.grip, pose=held))
        segments = [work_segment_to_msg(segment) for segment in plan.segments]
        request = PlanWorkRequest(task=task, source=f"{title} by {plan.grip}, offer {offer}", segments=segments)
        problem, answer = self._call("plan_work", PlanWork, request)
        with self._lock:
            memory = desk.ledger.book.tasks[task]
            if answer is None:
                if memory.state is TaskState.PLANNED and not memory.plan:
                    # the planner may have published it before it went away
                    for entry in following.after_restart(memory, element, self._verdict("", offer)[0], self._grip()):
                        desk.ledger.add(entry)
                desk.failures[task] = problem
                raise WorkRefused(problem)
            if not answer.success:
                desk.ledger.add(Entry("dropped", task, element, offer=offer, reason=answer.message))
                desk.failures[task] = answer.message
                raise WorkRefused(answer.message)
            if memory.state is TaskState.PLANNED and not memory.plan:
                desk.ledger.add(Entry("planned", task, element, plan=answer.plan_id, offer=offer))
        sentence = f"{title}: plan {answer.plan_id} of {answer.duration:.1f} s with {plan.grip} waits for approval"
        return WorkPlanTaskResponse(True, sentence, task, answer.plan_id, answer.plan_hash, answer.duration)

    def _plan_way_back(self, asked: str) -> WorkPlanTaskResponse:
        from std_srvs.srv import TriggerRequest

        before = self._plan.id if self._plan is not None else ""
        problem, answer = self._call("plan_way_back", Trigger, TriggerRequest())
        if answer is None or not answer.success:
            raise WorkRefused(f"the arm is engaged, only the way back can be planned: {problem or answer.message}")
        self._wait(lambda: self._plan is not None and self._plan.id != before, _SCENE_TIME)
        plan = self._plan
        if plan is None or plan.id == before:
            raise WorkRefused("the way back was planned, but is not published")
        sentence = f"the arm is engaged: the way back comes first; {answer.message}"
        return WorkPlanTaskResponse(True, sentence, asked, plan.id, plan.hash, plan.duration)

    def _on_decide(self, request: WorkDecideRequest) -> WorkDecideResponse:
        try:
            with self._lock:
                if self._desk is None:
                    raise WorkRefused(self._problem)
                sentence = self._decided(self._desk, request)
        except ConstructionTwinError as error:
            self._diagnostics.count(type(error).__name__, str(error))
            return WorkDecideResponse(False, str(error))
        rospy.loginfo("%s (%s)", sentence, request.person)
        self._news.put(self._publish)
        return WorkDecideResponse(True, sentence)

    @staticmethod
    def _decided(desk: Desk, request: WorkDecideRequest) -> str:
        if request.decision == "accept_schedule":
            return desk.accept(request.person, request.reason)
        if request.decision == "skip":
            return desk.skip(request.task, request.person, request.reason)
        if request.decision == "redo":
            return desk.redo(request.task, request.person, request.reason)
        if request.decision == "answer":
            return desk.answer(request.task, request.answer, request.person, request.reason)
        raise WorkRefused(f"decision {request.decision!r}; expected skip, redo, answer or accept_schedule")

    def _on_measured(self, request: WorkMeasuredRequest) -> WorkMeasuredResponse:
        try:
            pose = self._pose_in_base(request)
            with self._lock:
                if self._desk is None:
                    raise WorkRefused(self._problem)
                found = self._desk.measured(request.element, pose, request.person, request.reason)
        except ConstructionTwinError as error:
            self._diagnostics.count(type(error).__name__, str(error))
            return WorkMeasuredResponse(False, str(error), math.nan, math.nan)
        self._news.put(self._publish)
        distance, angle = found.distance * 1e3, math.degrees(found.angle)
        sentence = f"{request.element} is {distance:.2f} mm and {angle:.3f} deg from where the model has it"
        return WorkMeasuredResponse(True, sentence, distance, angle)

    def _pose_in_base(self, request: WorkMeasuredRequest) -> Pose:
        pose = pose_from_msg(request.pose.pose)
        frame = request.pose.header.frame_id
        if frame in ("", self._base_frame):
            return pose
        timeout = rospy.Duration(self._settings.service_timeout)
        try:
            transform = self._tf.lookup_transform(self._base_frame, frame, request.pose.header.stamp, timeout)
        except tf2_ros.TransformException as error:
            raise WorkRefused(f"no transform from {frame!r} to {self._base_frame!r}: {error}") from error
        return product(pose_from_transform_msg(transform.transform), pose)

    # -- reports

    def _fail(self, sentence: str) -> None:
        """Go on without the work: its record or its model cannot be used."""
        rospy.logerr("%s", sentence)
        with self._lock:
            self._problem, self._desk, self._broken = sentence, None, True
        self._publish()

    def _publish(self) -> None:
        with self._lock:
            message = self._message()
        if self._told is not None:
            message.header.stamp = self._told.header.stamp
            if message == self._told or repr(message) == repr(self._told):
                return
        message.header.stamp = rospy.Time.now()
        self._told = message
        self._tasks_publisher.publish(message)
        self._draw()

    def _draw(self) -> None:
        desk = self._desk
        if desk is None:
            return
        with self._lock:
            shown = desk.appearances(time.time_ns())
        drawn = []
        for one in shown:
            key = f"{one.element} stock" if one.word == "stock" else f"{one.element} {one.word == 'carried'}"
            link = self._robot.tip_link if one.word == "carried" else ""
            triangles = desk.prepared.elements[one.element].triangles
            drawn.append(DrawnElement(key, one.name, triangles, one.pose, one.word, link))
        picture = work_picture(drawn, self._drawn)
        self._drawn = picture.keys
        self._markers_publisher.publish(work_marker_array(picture, self._robot.base_link, self._settings.tf_prefix))

    def _message(self) -> WorkTasks:
        engaged = self._execution is not None and self._execution.engaged
        desk, now = self._desk, time.time_ns()
        if desk is None:
            return WorkTasks(model=Path(self._settings.model).name, engaged=engaged, reason=self._problem)
        reason = desk.summary(now)
        if engaged:
            reason = "the arm is engaged: only the way back can be planned"
            reason += f", and not yet: {self._blocked}" if self._blocked else ""
        return WorkTasks(
            model=desk.prepared.model,
            model_hash=desk.prepared.digest,
            schedule=desk.schedule_word,
            engaged=engaged,
            next=desk.next(now),
            reason=reason,
            tasks=[task_to_msg(row) for row in desk.rows(now)],
            notes=list(desk.notes),
        )

    def _report(self) -> Report:
        desk = self._desk
        if desk is None:
            return Report(ERROR if self._broken else WARN, self._problem)
        with self._lock:
            book = desk.ledger.book
            values: dict[str, object] = {state.value: len(book.in_state(state)) for state in TaskState}
            values |= {"lines of the ledger": desk.ledger.lines, "SHA-256 of the last line": desk.ledger.head}
            values["notes on the model"] = len(desk.notes)
            asks = bool(book.in_state(TaskState.ASKS))
            return Report(WARN if asks else OK, desk.summary(time.time_ns()), values)


def ledger_path(folder: Path, robot: str, model: str) -> Path:
    """Return the file of a ledger: one for each robot and name of a model, whatever its version."""
    return folder / f"{robot}_{Path(model).stem}.jsonl"


def _keep(kept: dict[str, Any], key: str, value: object, most: int) -> None:
    """Remember a value as the newest, and forget the oldest above a number."""
    kept.pop(key, None)
    kept[key] = value
    while len(kept) > most:
        kept.pop(next(iter(kept)))


def main() -> None:
    """Run the node until shutdown."""
    run_node("work", WorkNode)
