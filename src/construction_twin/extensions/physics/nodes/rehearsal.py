"""rehearsal: carries out each new plan with a simulated arm, and publishes the result (`rehearsal`).

The simulation is a process of its own (`physics.process`): a rehearsal that breaks off, or takes too long, is `broken`.
"""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.extensions import check_extras
from construction_twin.core.sentences import Sentence
from construction_twin.core.worker import Worker
from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.known_mass import element_masses, tool_mass
from construction_twin.extensions.physics.mass import payload_of
from construction_twin.extensions.physics.process import PROGRAM, RehearsalRequest, digest, file_digest
from construction_twin.msg import Plan as PlanMsg
from construction_twin.msg import Rehearsal, Review, WorkTasks
from construction_twin.msg import Scene as SceneMsg
from construction_twin.review.rehearsal_report import BROKEN, PASSED, RehearsalReport, first_reason, with_hash
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.plan import Plan
from construction_twin.robot.tool import read_tool, tool_hash
from construction_twin.ros.messages.convert import change_from_msg, plan_from_msg
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.node_shell import Interface, NodeIO, NodeShell, Publication, Shared, Subscription
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_change import SceneChange
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.validation import StrictModel

#: A plan may come so long before the scene that it begins in [s].
SCENE_DELAY = 1.0
#: The state of `WorkTask.msg` in which an element stands at its place.
PLACED = "done"
#: Scenes, plans and verdicts that are remembered.
_KEPT = 12
#: How often the main thread looks whether this process is to end [s].
_AWAKE = 0.5


class Settings(StrictModel):
    """Private parameters; see config/rehearsal.yaml and launch/bringup.launch.

    Attributes:
        mode: Of the launch argument `rehearsal`; with `auto` nothing is rehearsed where MuJoCo is not installed.
        payload: As in `payload_of`.
    """

    mode: Literal["auto", "advise", "require"]
    time_limit: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    drives: str
    tool: str
    self_collision: str
    payload: list[Annotated[float, pydantic.Field(allow_inf_nan=False)]] = []


class _Job(NamedTuple):
    """A plan to rehearse, with its changes of the scene."""

    plan: Plan
    changes: tuple[SceneChange, ...]


class RehearsalNode:
    """ROS around a rehearsal in another process: plans and scenes in, results out."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: NodeIO):
        self._time_limit = settings.time_limit
        self._output, self._diagnostics = node_io.publishers["rehearsal"], node_io.diagnostics
        self._process = Worker(PROGRAM)
        self._arm = {"robot": robot, "payload": tuple(settings.payload)} | {
            name: getattr(settings, name) for name in ("self_collision", "drives", "tool")
        }
        #: Why nothing is rehearsed; empty: everything is.
        self._absent = ""
        try:
            check_extras("physics")
        except ConfigurationError as error:
            self._absent = f"plans are not rehearsed: {error}"
            rospy.loginfo("%s", self._absent)
        self._tool, self._of_tool = tool_hash(settings.tool), tool_mass(settings.tool)
        payload = [settings.payload] if settings.payload else []
        # an arm may have no file of its drives
        drives = settings.drives if Path(settings.drives).is_file() else ""
        self._constant = digest(file_digest(drives), file_digest(settings.self_collision), *payload)
        self._news = threading.Condition()
        self._scenes: dict[str, Scene] = {}
        self._masses, self._placed = dict(self._of_tool), frozenset[str]()
        self._knows_tasks = False
        #: Plans that were neither rehearsed nor withdrawn, the newest last: that is next, and may be refused yet.
        self._jobs: dict[str, _Job] = {}
        self._withdrawn: list[str] = []
        self._running: _Job | None = None
        # the process was interrupted: another plan is next, or it took too long
        self._superseded = self._late = False
        self._last: RehearsalReport | None = None
        self._rehearsed = self._broken = self._dropped = 0

    # -- subscriptions

    def on_scene(self, message: SceneMsg) -> None:
        """Store a scene."""
        try:
            scene = scene_from_msg(message)
        except SceneError as error:
            self._diagnostics.refuse("scene", str(error))
            return
        with self._news:
            _store_newest(self._scenes, scene.hash, scene)
            self._news.notify_all()

    def on_tasks(self, message: WorkTasks) -> None:
        """Store masses of elements, and which were placed."""
        with self._news:
            self._masses = element_masses(message.tasks) | self._of_tool
            self._placed = frozenset(task.element for task in message.tasks if task.state == PLACED)
            self._knows_tasks = True
            self._news.notify_all()

    def on_plan(self, message: PlanMsg) -> None:
        """Queue a plan in place of the one that is being rehearsed."""
        if self._absent:
            return
        try:
            job = _Job(plan_from_msg(message), tuple(map(change_from_msg, message.segments)))
        except ConstructionTwinError as error:
            self._diagnostics.refuse("plan", str(error))
            return
        with self._news:
            # the executor may be the first to hear of it
            if job.plan.id not in self._withdrawn:
                _store_newest(self._jobs, job.plan.id, job)
                self._supersede()

    def on_review(self, message: Review) -> None:
        """Drop a rejected plan; the one before it is under review again."""
        if message.approved:
            return
        with self._news:
            self._withdrawn = [*self._withdrawn, message.plan_id][-_KEPT:]
            if self._jobs.pop(message.plan_id, None) is not None:
                self._supersede()

    def _next(self) -> _Job | None:
        """Return the plan to rehearse; under the lock."""
        return next(reversed(self._jobs.values()), None)

    def _supersede(self) -> None:
        """Interrupt a rehearsal that is superseded; under the lock."""
        if self._running is not None and self._running is not self._next():
            self._superseded = True
            self._process.interrupt()
        self._news.notify_all()

    # -- the work

    def run(self) -> None:
        """Rehearse one plan after the other until shutdown, in the main thread."""
        rospy.on_shutdown(self._process.interrupt)
        try:
            while not rospy.is_shutdown():
                self.work(_AWAKE)
        finally:
            self._process.close()

    def work(self, patience: float) -> None:
        """Rehearse the next plan; return after `patience` [s] when there is none."""
        with self._news:
            self._news.wait_for(lambda: self._jobs, patience)
            job = self._next()
            if job is None:
                return
            # after a start of this node the plan may come before the scene that it begins in, and before what its element weighs
            self._news.wait_for(
                lambda: self._is_ready(job) or self._next() is not job or rospy.is_shutdown(), SCENE_DELAY
            )
            if self._next() is not job:
                self._dropped += 1
                return
            scene, known, placed = self._scenes.get(job.plan.scene), self._masses, self._placed
            guessed = bool(job.plan.task) and not self._knows_tasks
            self._running, self._late, self._superseded = job, False, False
        began = time.monotonic()
        report: RehearsalReport
        try:
            if guessed:
                raise ConstructionTwinError(
                    Sentence(
                        "what the element of task {task} weighs has not been heard: is the node work running?",
                        task=job.plan.task,
                    )
                )
            report = self._rehearse(RehearsalRequest.of(job.plan, scene, job.changes, known, placed, self._constant))
        except ConstructionTwinError as error:
            why = Sentence("it took longer than {limit:g} s", limit=self._time_limit) if self._late else str(error)
            reasons = (Sentence("the rehearsal broke off: {problem}", problem=why),)
            broken = RehearsalReport(job.plan.id, job.plan.hash, job.plan.scene, self._tool, "", BROKEN, reasons)
            report = with_hash(broken, time.monotonic() - began)
        with self._news:
            self._running = None
            superseded = self._superseded
            if not superseded:
                self._jobs.pop(job.plan.id, None)
        if superseded or self._late:
            # the process may still be ending: the next question goes to another one
            self._process.close()
        if rospy.core.is_shutdown_requested():
            return
        if superseded:
            self._dropped += 1
            return
        self._publish_report(replace(report, stamp=now_ns()))

    def _is_ready(self, job: _Job) -> bool:
        """Return whether all is known that a plan is rehearsed with; under the lock."""
        return job.plan.scene in self._scenes and (self._knows_tasks or not job.plan.task)

    def _rehearse(self, request: RehearsalRequest) -> RehearsalReport:
        """Rehearse a plan in the other process, within the time limit."""
        limit = threading.Timer(self._time_limit, self._expire)
        limit.daemon = True
        limit.start()
        try:
            return self._process.ask("rehearse", arm=self._arm, request=request)
        finally:
            limit.cancel()

    def _expire(self) -> None:
        with self._news:
            if self._running is not None:
                self._late = True
                self._process.interrupt()

    def _publish_report(self, report: RehearsalReport) -> None:
        self._last = report
        self._rehearsed += 1
        self._broken += report.state == BROKEN
        self._output.publish(to_msg(report, Rehearsal))
        said = rospy.loginfo if report.state == PASSED else rospy.logwarn
        why = "".join(f"; {reason}" for reason in report.reasons)
        said("rehearsal of plan %s: %s in %.2f s%s", report.plan_id, report.state, report.took, why)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        if self._absent:
            return Diagnosis(OK, self._absent)
        last, running = self._last, self._running
        values: dict[str, object] = {"rehearsals": self._rehearsed, "broken": self._broken, "superseded": self._dropped}
        if running is not None:
            return Diagnosis(OK, f"rehearses plan {running.plan.id}", values)
        if last is None:
            return Diagnosis(OK, "no plan was rehearsed yet", values)
        values |= {"took": f"{last.took:.2f}", "engine": last.engine}
        if last.state == PASSED:
            return Diagnosis(OK, f"plan {last.plan_id}: passed", values)
        level, word = (WARN, "the rehearsal broke off") if last.state == BROKEN else (OK, "failed")
        return Diagnosis(level, f"plan {last.plan_id}: {word}: {first_reason(last.reasons)}", values)


def _store_newest(stored: dict, key: str, value: object) -> None:
    """Put a value last, and forget the oldest."""
    stored.pop(key, None)
    stored[key] = value
    while len(stored) > _KEPT:
        del stored[next(iter(stored))]


def check(settings: Settings, robot: RobotModel, _shared: Shared) -> None:
    """Check packages and files before anything starts; see `NodeShell`."""
    if settings.mode != "auto":
        check_extras("physics")
    read_drives(settings.drives, robot)
    if settings.tool:
        read_tool(settings.tool)
    read_self_collision(settings.self_collision, robot)
    payload_of(settings.payload, "payload")


INTERFACE = Interface(
    diagnose=RehearsalNode.diagnose,
    publishes=(Publication("rehearsal", Rehearsal, queue_size=2, latch=True),),
    subscribes=(
        Subscription("scene", SceneMsg, RehearsalNode.on_scene, queue_size=5),
        Subscription("work/tasks", WorkTasks, RehearsalNode.on_tasks, queue_size=1),
        Subscription("plan", PlanMsg, RehearsalNode.on_plan, queue_size=2),
        Subscription("review", Review, RehearsalNode.on_review, queue_size=10),
    ),
)
NODE = NodeShell("rehearsal", Settings, RehearsalNode, INTERFACE, check)
main = NODE.run
