"""The robot's state by MQTT: `view`, the status line, the scene, the tasks of the building model, messages.

The poses come in bundles, so that `view` costs the bridge no more than another subscriber.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from genpy import Message

from construction_twin.core.errors import ConfigurationError, PayloadError, PoseUnknownError
from construction_twin.core.freshness import present_moment
from construction_twin.core.records import SPACED, to_json
from construction_twin.core.reports import (
    ExecutionReport,
    HoldReport,
    LinkReport,
    SessionRequest,
    SpeedChange,
    SpeedReport,
    SyncReport,
    WorkReport,
)
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.states import ACTIVE
from construction_twin.extensions.console.message_board import APPROVED, REJECTED, MessageBoard
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.shown_plan import PATH_POINTS, segment_ends
from construction_twin.extensions.console.private_files import PrivateFiles
from construction_twin.extensions.console.remote_review import PathView, scene_view
from construction_twin.extensions.console.remote_view import (
    FreshReport,
    PlanProgress,
    PoseView,
    ViewInputs,
    ViewWriter,
)
from construction_twin.extensions.console.status_line import CurrentReports, Line, status_lines
from construction_twin.link.requests import Acknowledgement
from construction_twin.mqtt.requests import ACKNOWLEDGE
from construction_twin.msg import (
    Execution,
    Hold,
    Plan,
    Review,
    WorkTasks,
)
from construction_twin.msg import Scene as SceneMsg
from construction_twin.msg import SessionRequest as SessionRequestMessage
from construction_twin.msg import SpeedChange as SpeedChangeMessage
from construction_twin.review.plan_under_review import EXECUTOR
from construction_twin.review.rehearsal_report import FAILED, PASSED, RehearsalReport
from construction_twin.robot.motion_errors import SceneError
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.scene.objects import Scene
from construction_twin.views.startup import Deployment, ReportedState, StartupInputs, first_missing
from construction_twin.views.texts import hold_cause

#: The status line is looked at so often, and sent again without a change after so long [s].
UPDATE_PERIOD, REPEAT = 0.2, 1.0
#: Of so many plans the tool's path is kept until one is played.
PATHS = 8
#: Topics of the poses on `view`; one that is older counts as not known [s].
TWIN, ARM, EXPECTED = "twin/joint_states", "physical/joint_states", "expected/joint_states"
MAX_POSE_AGE = 0.25
#: What `sync`, `link` and `speed_limit_in_force` repeat by themselves counts as lost after so long [s].
SYNC_AGE, LINK_AGE, SPEED_AGE = 0.5, 3.0, 1.0
_UNDER_WAY = frozenset(state.name for state in ACTIVE)


_Report = TypeVar("_Report")


class _NewestReport(Generic[_Report]):
    """The newest report of a kind, and when it came."""

    def __init__(self, kind: type[_Report]):
        self._kind = kind
        self._newest: tuple[_Report, float] | None = None

    def on_message(self, message: Message) -> _Report:
        """Store the report of a message, and return it."""
        report = from_msg(self._kind, message)
        self._newest = report, time.monotonic()
        return report

    def fresh(self, oldest: float = math.inf) -> FreshReport | None:
        """Return it with its age; None: none, or older than that [s]."""
        newest = self._newest
        if newest is None or (age := time.monotonic() - newest[1]) > oldest:
            return None
        return FreshReport(newest[0], age)


class ConsoleFeed:
    """Publishes the state, and the retained topics again to a new broker; each ROS topic has its thread.

    Args:
        plan: Returns the id of the plan under review; empty: none.
        deployment: What was started; None: unknown.
        files: Folder of the scene's meshes; None: no console was started with this robot.
        messages: File of the messages; None: only in memory.
        clock: Returns the time of day [s since 1970].
    """

    def __init__(
        self,
        base_link: str,
        connection: Connection,
        writer: ViewWriter,
        poses: Mapping[str, LatestPose],
        plan: Callable[[], str] = lambda: "",
        executor_is_there: Callable[[], bool] = lambda: True,
        deployment: Deployment | None = None,
        files: PrivateFiles | None = None,
        messages: Path | None = None,
        clock: Callable[[], float] = time.time,
    ):
        self._topics, self._base_link = connection.topics, base_link
        self._connection, self._writer, self._poses = connection, writer, poses
        self._plan, self._executor_is_there = plan, executor_is_there
        self._deployment, self._files = deployment, files
        # locks of the plan's progress, the writer, the retained messages
        self._lock, self._writing, self._publishing = threading.Lock(), threading.Lock(), threading.RLock()
        self._sync, self._link = _NewestReport(SyncReport), _NewestReport(LinkReport)
        self._speed = _NewestReport(SpeedReport)
        self.on_sync, self.on_link, self.on_speed = self._sync.on_message, self._link.on_message, self._speed.on_message
        self._execution = _NewestReport(ExecutionReport)
        self._progress = PlanProgress()
        #: Of the newest plans, by id: the payload of `path` while that plan is played.
        self._paths: dict[str, bytes] = {}
        self._playing = ""
        self._retained: dict[str, bytes] = {}
        self._scene: Scene | None = None
        self._work: WorkReport | None = None
        self._hold = HoldReport()
        self._had_arm_pose = self._had_twin_pose = False
        publish = partial(self._publish_retained, self._topics.messages)
        self.messages = MessageBoard(publish, connection.refuse, messages, clock)
        connection.serve(
            ACKNOWLEDGE,
            Acknowledgement,
            lambda asked, request: Outcome(*self.messages.acknowledge(asked.message, request.account)),
        )
        self._updated_at = self._published_at = float("-inf")
        self._published = b""

    # -- from ROS

    def on_plan(self, message: Plan) -> None:
        """Store the tool path of a plan."""
        path = _path_of(message)
        with self._publishing:
            self._paths.pop(message.id, None)
            self._paths[message.id] = path
            while len(self._paths) > PATHS:
                del self._paths[next(iter(self._paths))]
            self._publish_path()

    def on_review(self, message: Review, rehearsal: RehearsalReport | None) -> None:
        """Add the message of a verdict; `rehearsal`: the newest, of any plan."""
        if message.reviewer in ("", EXECUTOR):
            return
        person = message.reviewer
        if not message.approved:
            rejected = Sentence("{person} rejected a plan: {reason}", person=person, reason=message.reason)
            self.messages.on_act(REJECTED, message.header.stamp.to_sec(), rejected)
            return
        sentence = Sentence("{person} approved a plan", person=person)
        if rehearsal is not None and rehearsal.engine and rehearsal.plan_hash == message.plan_hash:
            # which engine it was, and which version: as the record has it
            found = {PASSED: Sentence("passed"), FAILED: Sentence("failed")}.get(rehearsal.state, Sentence("broke off"))
            sentence = Sentence(
                "{person} approved a plan. Its rehearsal ({engine}): {found}",
                person=person, engine=rehearsal.engine, found=found,
            )  # fmt: skip
        self.messages.on_act(APPROVED, message.header.stamp.to_sec(), sentence)

    def on_execution(self, message: Execution) -> None:
        """Store the executor's report, and publish the path of the plan under way."""
        with self._lock:
            report = self._execution.on_message(message)
            self._progress.on_report(report)
        with self._publishing:
            self._playing = report.plan_id if report.text in _UNDER_WAY else ""
            self._publish_path()

    def _publish_path(self) -> None:
        # a node that starts in the middle of a motion may receive `plan` after `execution`
        payload = self._paths.get(self._playing, b"")
        if payload != self._retained.get(self._topics.path, b""):
            self._publish_retained(self._topics.path, payload)

    def on_session_request(self, message: SessionRequestMessage) -> None:
        """Add the message of a reset or an arming."""
        asked = from_msg(SessionRequest, message)
        values = {"person": asked.person or Sentence("somebody at the robot's computer"), "lifts": asked.lifts}
        if asked.verb == "arm":
            sentence = Sentence("{person} asked for arming. It lifts: {lifts}", **values)
        else:
            sentence = Sentence("{person} asked for a reset. It lifts: {lifts}", **values)
        self.messages.on_act(asked.verb, message.stamp.to_sec(), sentence)

    def on_speed_change(self, message: SpeedChangeMessage) -> None:
        """Add the message of a changed speed limit."""
        self.messages.on_speed(from_msg(SpeedChange, message))

    def on_hold(self, message: Hold) -> None:
        """Store the cause of a hold."""
        self._hold = from_msg(HoldReport, message)

    def on_scene(self, message: SceneMsg) -> None:
        """Write the scene's meshes, then publish the scene: each named mesh has its file."""
        try:
            scene = scene_from_msg(message)
            if self._files is not None:
                self._files.write_scene(scene)
        except (SceneError, ConfigurationError) as error:
            self._connection.refuse("scene", str(error))
            return
        self._scene = scene
        self._publish_retained(self._topics.scene, to_json(scene_view(scene, self._base_link)))

    def on_tasks(self, message: WorkTasks) -> None:
        """Publish the tasks."""
        self._work = from_msg(WorkReport, message)
        self._publish_retained(self._topics.work_tasks, to_json(self._work, translatable=True))

    # -- to MQTT

    def republish_retained(self) -> None:
        """Publish everything retained again (a new broker)."""
        with self._publishing:
            self._published_at = float("-inf")
            for topic, payload in self._retained.items():
                self._connection.publish(topic, payload, retain=True)

    def publish_offline(self) -> None:
        """Publish the end, and clear what is retained."""
        self._connection.publish(self._topics.view, self._writer.offline())
        with self._publishing:
            for topic in self._retained:
                self._connection.publish(topic, b"", retain=True)

    def _publish_retained(self, topic: str, payload: bytes) -> None:
        # what is retained must not be the older one, which another thread has sent behind it
        with self._publishing:
            self._retained[topic] = payload
            self._connection.publish(topic, payload, retain=True)

    def is_engaged(self) -> bool:
        """Return whether only the way back can be planned."""
        execution = self._execution.fresh()
        return execution is not None and bool(execution.report.engaged)

    def first(self) -> tuple[str, bytes, bool]:
        """Return topic, payload and retain flag of a connection's first message."""
        return self._topics.view, self._view(), False

    def publish_view(self) -> bytes:
        """Publish the present `view`, and return it."""
        payload = self._view()
        self._connection.publish(self._topics.view, payload, qos=0)
        return payload

    def _view(self) -> bytes:
        # before anything is looked at: whoever repeats it has seen nothing newer
        moment, inputs = present_moment(), self.view_inputs()
        self._had_twin_pose |= inputs.twin is not None
        self._had_arm_pose |= inputs.arm is not None
        with self._writing:
            return self._writer.write(now_ns(), inputs, moment)

    def view_inputs(self) -> ViewInputs:
        """Return the inputs of the present view."""
        sync, execution, speed = self._sync.fresh(SYNC_AGE), self._present_execution(), self._speed.fresh(SPEED_AGE)
        with self._lock:
            progress = self._progress.at(now_ns() / NANOSECONDS)
        return ViewInputs(
            twin=_pose_view(self._poses.get(TWIN)),
            arm=_pose_view(self._poses.get(ARM)),
            expected=_pose_view(self._poses.get(EXPECTED)),
            sync=sync,
            link=self._link.fresh(LINK_AGE),
            execution=execution,
            plan=self._plan(),
            progress=progress,
            hold=self._hold if sync is not None else HoldReport(),
            speed=speed.report if speed is not None else None,
        )

    def _present_execution(self) -> FreshReport[ExecutionReport] | None:
        return self._execution.fresh() if self._executor_is_there() else None

    def publish_status_line(self) -> None:
        """Publish the status line on change, and once a second."""
        now = time.monotonic()
        if now - self._updated_at < UPDATE_PERIOD:
            return
        self._updated_at = now
        lines = self._lines(self._link.fresh(LINK_AGE), self._sync.fresh(SYNC_AGE), self._present_execution())
        self.messages.on_lines(lines)
        payload = to_json(lines, separators=SPACED)
        if payload == self._published and now - self._published_at < REPEAT:
            return
        self._published, self._published_at = payload, now
        self._connection.publish(self._topics.screen, payload)

    def _lines(
        self,
        link: FreshReport[LinkReport] | None,
        sync: FreshReport[SyncReport] | None,
        execution: FreshReport[ExecutionReport] | None,
    ) -> list[Line]:
        states = _reported_state(link), _reported_state(sync), _reported_state(execution)
        deployment = self._deployment
        reports = CurrentReports(
            *states,
            bare=link is not None and link.report.gateway_kind == "plc",
            plan=self._plan(),
            obstacle="" if execution is None else execution.report.approval_obstacle,
            cause="" if sync is None else hold_cause(self._hold),
            engaged=execution is not None and bool(execution.report.engaged),
            work=self._work,
        )
        if deployment is not None:
            inputs = StartupInputs(
                *states, feedback=self._had_arm_pose, twin=self._had_twin_pose, scene=self._scene is not None
            )
            missing = first_missing(inputs, deployment)
            reports = replace(reports, started=True, missing=missing, arm=deployment.arm != "none")
        return status_lines(reports)


def _path_of(message: Plan) -> bytes:
    """Return the payload of `path` while a plan is played; empty without a tool path."""
    times = [point.time_from_start.to_nsec() for point in message.trajectory.points]
    if not message.tool_path or len(message.tool_path) != len(times):
        return b""
    path = [(point.x, point.y, point.z) for point in message.tool_path]
    stamps = [time / NANOSECONDS for time in times]
    return PathView(message.id, stamps, path).to_json(PATH_POINTS, segment_ends(message, times))


def _reported_state(shown: FreshReport | None) -> ReportedState | None:
    if shown is None:
        return None
    return ReportedState(shown.report.text, shown.report.reason, getattr(shown.report, "gateway_state", ""))


def _pose_view(stream: LatestPose | None) -> PoseView | None:
    if stream is None:
        return None
    try:
        newest = stream.newest(MAX_POSE_AGE)
    except (PoseUnknownError, PayloadError):
        # it is shown as not known; who publishes something else on the stream is refused and counted by others
        return None
    return PoseView(newest.stamp / NANOSECONDS, time.monotonic() - newest.received, newest.positions)


def deployment_of(started: Mapping[str, object] | None, namespace: str) -> Deployment | None:
    """Return what was started, from the parameters of the node `startup`; None where that is absent."""
    fields = ("arm", "broker", "rsi", "gateway", "gateway_kind")
    if started is None or not set(fields) <= set(started):
        return None
    return Deployment(namespace=namespace, **{name: started[name] for name in fields})  # type: ignore[arg-type]
