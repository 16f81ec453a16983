"""rehearsal: has every plan carried out by the simulated arm as soon as it is made, and says what that found (`rehearsal`).

It moves nothing and decides nothing. The simulation is a process of its own behind everything else (`rehearsal_process`), so that
what happens to it is an answer: a rehearsal that breaks off, or takes too long, is published as `broken`.
"""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Protocol

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.extras import check_extras
from construction_twin.core.motion_errors import SceneError
from construction_twin.core.sentences import Sentence
from construction_twin.execution.rehearsal_check import first_reason
from construction_twin.msg import Plan as PlanMsg
from construction_twin.msg import Rehearsal, Review, WorkTasks
from construction_twin.msg import Scene as SceneMsg
from construction_twin.physics.drive import read_drives
from construction_twin.physics.known_mass import body_of
from construction_twin.physics.mass import payload_of
from construction_twin.physics.report import BROKEN, PASSED, RehearsalReport, finished
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.robot.tool import read_tool, tool_hash
from construction_twin.ros.messages.convert import change_from_msg, plan_from_msg
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.element_masses import element_masses, placed_elements, tool_mass
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.ports import Interface, Ports, Publication, Shared, Subscription
from construction_twin.ros.shared.rehearsal_process import PROGRAM, Question
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.publisher import Sink
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.work.worker import Worker

#: A plan may come so long before the scene that it begins in [s].
SCENE_DELAY = 1.0
#: Scenes, plans and verdicts that are remembered.
_KEPT = 12
#: How often the main thread looks whether this process is to end [s].
_AWAKE = 0.5


class Settings(pydantic.BaseModel):
    """Private parameters; see config/rehearsal.yaml, the others are given in launch/twin.launch.

    Attributes:
        mode: Of the launch argument `rehearsal`; with `auto` nothing is rehearsed where MuJoCo is not installed.
        drives: YAML of the arm's drives; empty: what its URDF says, and nothing is known of motors and rating.
        tool: Tool file; empty: no tool.
        self_collision: YAML of the link pairs that are not checked.
        payload: At the flange at all times: mass [kg], or mass and centre in the tip link [m]; empty: nothing.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    mode: Literal["auto", "advise", "require"]
    time_limit: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    drives: str
    tool: str
    self_collision: str
    payload: list[Annotated[float, pydantic.Field(allow_inf_nan=False)]] = []


class Rehearser(Protocol):
    """What rehearses in another process: a `Worker`."""

    def ask_first(self, name: str, **arguments: object) -> object:
        """Prepare it."""

    def ask(self, name: str, **arguments: object) -> RehearsalReport:
        """Rehearse."""

    def interrupt(self) -> None:
        """End what it does now."""

    def close(self) -> None:
        """End it."""


@dataclass(frozen=True, eq=False)
class _Job:
    """A plan that is to be rehearsed, and what its segments make of the scene."""

    plan: Plan
    changes: tuple[SceneChange, ...]


class RehearsalNode:
    """Plans and scenes in, what their rehearsal found out; `start` gives it parameters, topics and a process.

    Args:
        tool: Hash of the tool file; empty: no tool. masses: What the tool weighs, see `physics.known_mass` [kg].
        constant: Hash of what decides a result beside plan, scene, tool and masses.
        absent: Why nothing is rehearsed; empty: everything is.
    """

    def __init__(
        self,
        settings: Settings,
        robot: RobotModel,
        process: Rehearser,
        output: Sink,
        diagnostics: NodeDiagnostics,
        tool: str,
        masses: Mapping[str, float],
        constant: str,
        absent: str = "",
    ):
        self._settings, self._robot = settings, robot
        self._process, self._output, self._diagnostics = process, output, diagnostics
        self._tool, self._constant, self._absent = tool, constant, absent
        self._news = threading.Condition()
        self._scenes: dict[str, Scene] = {}
        self._of_tool, self._masses = masses, {**masses}
        self._placed: frozenset[str] = frozenset()
        self._knows_tasks = False
        self._waiting: _Job | None = None
        self._running: _Job | None = None
        #: Replaced by a newer plan before their rehearsal ended, and not withdrawn yet: the newer one may be refused.
        self._replaced: dict[str, _Job] = {}
        self._withdrawn: list[str] = []
        #: The plan that was interrupted, and why: it is late, or there is a newer one.
        self._late = self._superseded = False
        self._prepared = False
        self._last: RehearsalReport | None = None
        self._rehearsed = self._broken = self._dropped = 0

    # -- subscriptions

    def on_scene(self, message: SceneMsg) -> None:
        """Take a scene in which a plan may begin."""
        try:
            scene = scene_from_msg(message)
        except SceneError as error:
            self._diagnostics.refuse("scene", str(error))
            return
        with self._news:
            self._scenes.pop(scene.hash, None)
            self._scenes[scene.hash] = scene
            while len(self._scenes) > _KEPT:
                del self._scenes[next(iter(self._scenes))]
            self._news.notify_all()

    def on_tasks(self, message: WorkTasks) -> None:
        """Take what the elements of the tasks weigh, and which of them were placed."""
        with self._news:
            self._masses, self._placed = {**element_masses(message), **self._of_tool}, placed_elements(message)
            self._knows_tasks = True
            self._news.notify_all()

    def on_plan(self, message: PlanMsg) -> None:
        """Take a plan; it supersedes what is being rehearsed, until the executor has refused it."""
        if self._absent:
            return
        try:
            plan = plan_from_msg(message)
            changes = tuple(map(change_from_msg, message.segments))
        except ConstructionTwinError as error:
            self._diagnostics.refuse("plan", str(error))
            return
        with self._news:
            if plan.id in self._withdrawn:
                # the executor was the first to hear of it
                return
            for job in (self._running, self._waiting):
                if job is not None and job.plan.id != plan.id and job.plan.id not in self._withdrawn:
                    self._replaced[job.plan.id] = job
            self._replaced.pop(plan.id, None)
            _keep_newest(self._replaced)
            self._supersede(_Job(plan, changes))

    def on_review(self, message: Review) -> None:
        """Take a verdict: when the executor did not take a plan, the one that it has replaced here is still under review."""
        if message.approved:
            return
        plan_id = message.plan_id
        with self._news:
            self._withdrawn = [*self._withdrawn, plan_id][-_KEPT:]
            self._replaced.pop(plan_id, None)
            newest = self._waiting or self._running
            if newest is not None and newest.plan.id == plan_id and self._replaced:
                self._supersede(self._replaced.pop(next(reversed(self._replaced))))

    def _supersede(self, job: _Job) -> None:
        """Have a plan rehearsed next, instead of what waits or is rehearsed now."""
        self._waiting = job
        if self._running is not None:
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
        """Rehearse the plan that waits; return after `patience` [s] when none does."""
        with self._news:
            self._news.wait_for(lambda: self._waiting is not None, patience)
            job, self._waiting = self._waiting, None
            if job is None:
                return
            # after a start of this node the plan may come before the scene that it begins in, and before what its element weighs
            self._news.wait_for(
                lambda: self._is_ready(job) or self._waiting is not None or rospy.is_shutdown(), SCENE_DELAY
            )
            if self._waiting is not None:
                self._dropped += 1
                return
            scene, known, placed = self._scenes.get(job.plan.scene), self._masses, self._placed
            guessed = bool(job.plan.task) and not self._knows_tasks
            self._running, self._late, self._superseded = job, False, False
        began = time.monotonic()
        carried = {body_of(item.name) for item in carried_objects(scene, job.changes)}
        stands = placed & {body_of(item.name) for item in (() if scene is None else scene.objects)} - carried
        masses = {body: mass for body, mass in sorted(known.items()) if body in carried | stands}
        standing, unweighed = tuple(sorted(stands & masses.keys())), tuple(sorted(stands - masses.keys()))
        inputs = _digest(self._constant, masses, standing, unweighed)
        report: RehearsalReport
        try:
            if guessed:
                raise ConstructionTwinError(Sentence("rehearsal.no_tasks", task=job.plan.task))
            scenes = {} if scene is None else segment_scenes(scene, job.plan, job.changes)
            report = self._ask(Question(job.plan, scenes, masses, inputs, standing, unweighed))
        except ConstructionTwinError as error:
            report = self._broke(job, inputs, error.sentence, time.monotonic() - began)
        with self._news:
            self._running = None
            superseded, interrupted = self._superseded, self._superseded or self._late
        if interrupted:
            # the process may still be ending: the next question goes to another one
            self._process.close()
        if rospy.core.is_shutdown_requested():
            return
        if superseded:
            self._dropped += 1
            return
        self._tell(replace(report, stamp=now_ns()))

    def _is_ready(self, job: _Job) -> bool:
        """Return whether all is known that a plan is rehearsed with; under the lock."""
        return job.plan.scene in self._scenes and (self._knows_tasks or not job.plan.task)

    def _ask(self, question: Question) -> RehearsalReport:
        """Have a plan rehearsed, for as long as that may take."""
        limit = threading.Timer(self._settings.time_limit, self._expire)
        limit.daemon = True
        limit.start()
        try:
            if not self._prepared:
                self._process.ask_first(
                    "prepare",
                    robot=self._robot,
                    self_collision=self._settings.self_collision,
                    drives=self._settings.drives,
                    tool=self._settings.tool,
                    payload=tuple(self._settings.payload),
                )
                self._prepared = True
            return self._process.ask("rehearse", question=question)
        finally:
            limit.cancel()

    def _expire(self) -> None:
        with self._news:
            if self._running is not None:
                self._late = True
                self._process.interrupt()

    def _broke(self, job: _Job, inputs: str, reason: str, took: float) -> RehearsalReport:
        if self._late:
            reason = Sentence("rehearsal.late", limit=self._settings.time_limit)
        plan = job.plan
        report = RehearsalReport(
            plan.id, plan.hash, plan.scene, self._tool, inputs, BROKEN, (Sentence("rehearsal.broke", problem=reason),)
        )
        return finished(report, took)

    def _tell(self, report: RehearsalReport) -> None:
        self._last = report
        self._rehearsed += 1
        self._broken += report.state == BROKEN
        self._output.publish(to_msg(report, Rehearsal))
        said = rospy.loginfo if report.state == PASSED else rospy.logwarn
        why = "".join(f"; {reason}" for reason in report.reasons)
        said("rehearsal of plan %s: %s in %.2f s%s", report.plan_id, report.state, report.took, why)

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        if self._absent:
            return Report(OK, self._absent)
        last, running = self._last, self._running
        values: dict[str, object] = {"rehearsals": self._rehearsed, "broken": self._broken, "superseded": self._dropped}
        if running is not None:
            return Report(OK, Sentence("rehearsal.node.running", plan=running.plan.id), values)
        if last is None:
            return Report(OK, Sentence("rehearsal.node.none"), values)
        values |= {"took": f"{last.took:.2f}", "engine": last.engine}
        if last.state == PASSED:
            return Report(OK, Sentence("rehearsal.node.passed", plan=last.plan_id), values)
        key, level = ("rehearsal.node.broken", WARN) if last.state == BROKEN else ("rehearsal.node.failed", OK)
        return Report(level, Sentence(key, plan=last.plan_id, reason=first_reason(last.reasons)), values)


def _keep_newest(jobs: dict[str, _Job]) -> None:
    while len(jobs) > _KEPT:
        del jobs[next(iter(jobs))]


def segment_scenes(scene: Scene, plan: Plan, changes: tuple[SceneChange, ...]) -> dict[str, Scene]:
    """Return the scenes of a plan by hash: the one that it begins in, and what its segments make of it.

    Raises:
        SceneError: If a change does not lead to the scene that its segment names.
    """
    scenes = {scene.hash: scene}
    for segment, change in zip(plan.segments, changes, strict=True):
        scene = change.between(scene, segment.scene, segment.scene_after)
        scenes[scene.hash] = scene
    return scenes


def carried_objects(scene: Scene | None, changes: tuple[SceneChange, ...]) -> Iterator[SceneObject]:
    """Yield what the arm carries in a scene, and what it does after changes of it."""
    for items in (() if scene is None else scene.objects, *(change.put for change in changes)):
        yield from (item for item in items if item.link)


def _digest(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _hash_of(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else ""


def check(settings: Settings, robot: RobotModel, _shared: Shared) -> None:
    """Check packages and files before anything starts; see `NodeShell`."""
    if settings.mode != "auto":
        check_extras("physics")
    if settings.drives:
        read_drives(settings.drives, robot)
    if settings.tool:
        read_tool(settings.tool)
    read_self_collision(settings.self_collision, robot)
    payload_of(settings.payload, "payload")


def start(settings: Settings, robot: RobotModel, ports: Ports) -> RehearsalNode:
    """Return the node with its parameters, topics and process."""
    absent = ""
    try:
        check_extras("physics")
    except ConfigurationError as error:
        absent = str(Sentence("rehearsal.absent", problem=error.sentence))
        rospy.loginfo("%s", absent)
    # of the file: what it says decides the result
    read_self_collision(settings.self_collision, robot)
    payload = [settings.payload] if settings.payload else []
    constant = _digest(_hash_of(settings.drives), _hash_of(settings.self_collision), *payload)
    return RehearsalNode(
        settings, robot, Worker(PROGRAM), ports.publishers["rehearsal"], ports.diagnostics,
        tool_hash(settings.tool), tool_mass(settings.tool), constant, absent,
    )  # fmt: skip


INTERFACE = Interface(
    report=RehearsalNode.report,
    publishes=(Publication("rehearsal", Rehearsal, queue_size=2, latch=True),),
    hears=(
        Subscription("scene", SceneMsg, RehearsalNode.on_scene, queue_size=5),
        Subscription("work/tasks", WorkTasks, RehearsalNode.on_tasks, queue_size=1),
        Subscription("plan", PlanMsg, RehearsalNode.on_plan, queue_size=2),
        Subscription("review", Review, RehearsalNode.on_review, queue_size=10),
    ),
)
NODE = NodeShell("rehearsal", Settings, start, INTERFACE, check)


def main() -> None:
    """Run the node."""
    NODE.run()
