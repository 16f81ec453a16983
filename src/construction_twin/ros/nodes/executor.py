"""executor: plays the approved plan as `next/joint_states` at 250 Hz. The decisions are in `execution`."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

import genpy
import pydantic
import rospy
from std_srvs.srv import Trigger

import construction_twin.srv as srv
from construction_twin import msg
from construction_twin.core.errors import ConstructionTwinError, PayloadError, ReviewError
from construction_twin.core.extensions import import_extension
from construction_twin.core.files import check_writable
from construction_twin.core.freshness import parse_moment, present_moment
from construction_twin.core.reports import SessionRequest, SpeedChange, ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.speed_limit import SpeedLimit
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.approval import AUTO_APPROVE, Approval, AutoApproval, ConflictVerdicts
from construction_twin.execution.engagement import read_engagement
from construction_twin.execution.executor import Executor
from construction_twin.execution.segment_run import NO_ARM
from construction_twin.execution.upkeep import DiskWriter, ExecutionReporter, Permission
from construction_twin.monitor.states import SyncState
from construction_twin.review.plan_under_review import EXECUTOR, REJECTED, Verdict
from construction_twin.review.record import Responsibility, ReviewLog
from construction_twin.review.rehearsal_report import RehearsalCheck, RehearsalReport, is_consistent
from construction_twin.robot.description import RobotModel
from construction_twin.robot.tool import tool_hash
from construction_twin.ros.messages.convert import engagement_to_msg, order_to_msg, plan_from_msg, tool_report_from_msg
from construction_twin.ros.messages.records import from_msg, sentence_of, to_msg
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, DeferredLog, Diagnosis
from construction_twin.ros.shared.params import NodeSettings, robot_file
from construction_twin.ros.transport.joint_stream import Cycles, from_time, now_ns
from construction_twin.ros.transport.subscriber import caller_of

#: The gate counts as closed this long after the monitor's last word; it speaks at its `SYNC_RATE` [ns].
SYNC_TIMEOUT = NANOSECONDS // 2
#: How often deferred records are written, and a plan is checked for that may be approved by itself [s].
BACKGROUND_PERIOD = 0.05
#: Between two reads of the twin's pose [s]: its pose is needed where it rests, and counts as known for much longer.
TWIN_PAUSE = 0.02
_Result = TypeVar("_Result")


class Settings(NodeSettings, Permission):
    """Private parameters; see config/executor.yaml, the others are given in launch/bringup.launch."""

    review_file: Annotated[str, pydantic.Field(min_length=1)]
    neighbour: str = ""
    rehearsal: Literal["auto", "advise", "require", "off"] = "off"
    tool: str = ""
    speed_limit_deadline: float = pydantic.Field(gt=0)
    speed_limit_silent: float = pydantic.Field(ge=0, le=1)
    speed_limit_required: bool


def _run_unguarded(_what: str, part: Callable[..., _Result], *arguments: object) -> _Result:
    """Call a part whose failure ends the node, as everywhere else."""
    return part(*arguments)


class ExecutorNode:
    """ROS around an `Executor`, used under one lock: a method for each topic and service."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO):
        self._node_io, self._diagnostics = node_io, node_io.diagnostics
        self._log = ReviewLog(robot_file(settings.review_file, robot.name), time.time_ns)
        file = self._log.file.path
        left = file.with_name(f"{file.stem}_engagement.json")
        self.executor = executor = Executor(robot, read_engagement(left, robot.joint_names))
        if settings.arm != "none":
            executor.on_link(False, Sentence("no report of the link yet"))
        else:
            executor.on_tool(ToolReport(reason=NO_ARM), time.monotonic_ns())
        self._limit = SpeedLimit(
            settings.speed_limit_deadline, settings.speed_limit_silent, settings.speed_limit_required
        )
        self._lock = threading.Lock()
        self._approval = Approval(executor, self._log.append, self._lock, lambda: present_moment())
        self._approval.neighbour = ConflictVerdicts(settings.neighbour)
        self._approval.rehearsal = RehearsalCheck(settings.rehearsal == "require", tool_hash(settings.tool))
        self._auto_approval = AutoApproval(settings.auto_approve, settings.auto_approve_sources)
        self._log_queue = DeferredLog()
        self.side_effects = executor.side_effects
        self._sync_at = 0
        self._reporter = ExecutionReporter(executor, self._approval, self._limit)
        self._disk = DiskWriter(executor, left, self._lock, lambda problem: rospy.logerr_throttle(5.0, "%s", problem))
        rospy.on_shutdown(self.write_records)
        rospy.loginfo("verdicts are recorded in %s (%d so far)", file, self._log.file.lines)
        if executor.engagement.engaged:
            rospy.logwarn("%s", executor.engagement.sentence)
        if settings.auto_approve:
            rospy.logwarn("auto_approve is on: every plan is approved by itself, without a person")
        elif settings.auto_approve_sources:
            named = ", ".join(settings.auto_approve_sources)
            set_to = "auto_approve_sources is set: plans of %s are approved by themselves, without a person"
            rospy.logwarn(set_to, named)

    def run(self) -> None:
        """Publish one setpoint per cycle until shutdown."""
        publish, executor = self._node_io.publishers["next/joint_states"].publish, self.executor
        for stamp, stalled in Cycles():
            with self._lock:
                now = time.monotonic_ns()
                if now - self._sync_at > SYNC_TIMEOUT:
                    executor.on_sync(SyncState.STALE, False)
                if stalled:
                    executor.stall(Sentence("this process was not run for {seconds:.3f} s", seconds=stalled / 1e9))
                executor.limit.set_fraction(self._limit.update(now), self._limit.reason)
                setpoint = executor.step(stamp, now)
            if setpoint is not None:
                publish(stamp, setpoint)
            self._publish_changes()

    # -- subscriptions: a PayloadError is counted as refused (`transport.subscriber`)

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Store the twin's pose [rad] with its stamp [ns]."""
        with self._lock:
            self.executor.on_twin(stamp, q, time.monotonic_ns())

    def on_sync(self, message: msg.Sync) -> None:
        """Store the gate's state; after `SYNC_TIMEOUT` of silence it counts as closed."""
        try:
            state = SyncState(message.state)
        except ValueError as error:
            raise PayloadError("sync", f"sync state {message.state} is unknown; expected one of Sync.msg") from error
        with self._lock:
            self._sync_at = time.monotonic_ns()
            self.executor.on_sync(state, message.agreed, message.policy, from_time(message.held_stamp))
            self.executor.limit.on_lag(message.round_trip, message.servo_lag)

    def on_limit(self, message: msg.SpeedLimitInForce) -> None:
        """Store the speed limit in force."""
        with self._lock:
            reason = sentence_of(message, message.reason)
            self._limit.accept(message.limit, caller_of(message), time.monotonic_ns(), sentence=reason)

    def on_scene(self, message: msg.Scene) -> None:
        """Store the scene for which plans may be approved."""
        with self._lock:
            self.executor.on_scene(message.hash)

    def on_conflict(self, message: msg.Conflict) -> None:
        """Store the verdict of the other arm's watch."""
        problem = sentence_of(message, message.reason) if message.conflict else ""
        with self._lock:
            self._approval.neighbour.on_verdict(message.plan_id, problem, time.monotonic_ns())
            self.executor.on_conflict(message.plan_id, problem)

    def on_rehearsal(self, message: msg.Rehearsal) -> None:
        """Store the report of a rehearsal."""
        report = from_msg(RehearsalReport, message)
        if not is_consistent(report):
            raise PayloadError("rehearsal", f"the rehearsal of plan {report.plan_id!r} is not what its hash says")
        with self._lock:
            self._approval.rehearsal.on_report(report)

    def on_plan(self, message: msg.Plan) -> None:
        """Put a plan under review."""
        try:
            self._approval.offer(plan_from_msg(message))
        except ConstructionTwinError as error:
            self._diagnostics.refuse("plan", str(error))

    def on_tool(self, message: msg.ToolState) -> None:
        """Store the tool's state."""
        report = tool_report_from_msg(message)
        with self._lock:
            self.executor.on_tool(report, time.monotonic_ns())

    def on_link(self, message: msg.Link) -> None:
        """Store the link's state, and who is responsible for what is not checked."""
        reason = Sentence("{state}: {reason}", state=message.text, reason=sentence_of(message, message.reason))
        with self._lock:
            self.executor.on_link(message.state == msg.Link.ARMED, reason, message.session, self._now())
        who, unchecked = message.responsible, tuple(message.not_checked)
        self._log.on_responsible(Responsibility(who, message.session, unchecked) if who else None)

    def record(self, request: SessionRequest | SpeedChange) -> None:
        """Record a reset, an arming, or a change of people's speed limit, with the person."""
        self._log.defer(request)

    # -- services

    # A stop, a pause, a rejection: first the act, under the lock; then, beside it, what tells of it (docs/architecture.md).

    def on_review(self, request: srv.ReviewPlanRequest) -> str:
        """Approve or reject a plan in a person's name; an approval's age counts from its screen's moment, else from the call."""
        if request.reviewer.strip() in (AUTO_APPROVE, EXECUTOR):
            raise ReviewError(f"{request.reviewer!r} is what the executor calls itself; expected the name of a person")
        verdict = self._approval.review(
            request.plan_id,
            request.plan_hash,
            request.approve,
            request.reviewer,
            request.reason,
            parse_moment(request.moment) if request.approve and request.moment else None,
            request.rehearsal_hash if request.override_rehearsal else None,
        )
        if verdict.approved:
            # a rejection is published with what the executor decides by itself
            self._publish_verdict(verdict)
        else:
            # what was answered is on record, also where the node ends before its next cycle
            self.side_effects.run("the record", self._log.defer, verdict)
        return verdict.answer

    def on_stop(self, _request) -> str:
        """Brake on the path and drop the plan."""
        with self._lock:
            sentence = self.executor.stop(self._now())
        return self._log_answer("stop", sentence, rospy.logwarn)

    def on_stop_plan(self, request: srv.StopPlanRequest) -> str:
        """Brake one plan on its path; what waits is left alone."""
        caller = self.side_effects.run("the name of a caller", caller_of, request) or "a client"
        with self._lock:
            asked = Sentence("stop requested by {client}", client=caller)
            sentence = self.executor.stop_plan(request.plan_id, asked, self._now())
        return self._log_answer("stop_plan", sentence, rospy.logwarn)

    def on_pause(self, _request) -> str:
        """Brake on the path and keep the plan."""
        with self._lock:
            sentence = self.executor.pause(self._now())
        return self._log_answer("pause", sentence)

    def on_resume(self, _request) -> str:
        """Go on after a pause."""
        return self._log_answer("resume", self._approval.resume())

    def on_act_as_seen(self, request: srv.ActAsSeenRequest) -> str:
        """Stop, pause or resume as seen on a screen; a resume expires, or is void after a newer pause or stop."""
        if request.act == "stop":
            return self.on_stop(request)
        if request.act == "pause":
            return self.on_pause(request)
        if request.act == "resume":
            return self._log_answer("resume", self._approval.resume(parse_moment(request.moment)))
        raise PayloadError("act", f"{request.act!r} is nothing that is done here")

    def on_release(self, request: srv.ReleaseEngagementRequest) -> str:
        """Release the engagement by a person's word that the arm was freed."""
        sentence = self._approval.release(request.person.strip(), request.reason.strip())
        return self._log_answer("release_engagement", sentence, rospy.logwarn)

    def _log_answer(self, request: str, sentence: str, write: Callable[..., None] | None = None) -> str:
        """Log what was carried out, after the answer."""
        self.side_effects.run("the log", self._log_queue.add, write or rospy.loginfo, "%s: %s", request, sentence)
        return sentence

    def _now(self) -> int:
        # where the clock cannot be read, whatever comes was asked for before, and no screen can show a later moment
        now = self.side_effects.run("the moment of an act", present_moment)
        return sys.maxsize if now is None else now.at

    # -- in the background

    def do_background_work(self) -> None:
        """Write logs and records every `BACKGROUND_PERIOD`; failures are logged and tried again."""
        self.write_records()
        # where a stop leaves the arm is written down here
        self.side_effects.run("the engagement", self.save_engagement)
        with self._lock:
            self.executor.under_review.scene_alive = self._node_io.connections("scene") > 0
        self._approval.update_obstacle()
        self._disk.write("an approval", self._approve_automatically)

    def _approve_automatically(self) -> None:
        verdict = self._approval.approve_automatically(time.monotonic_ns(), self._auto_approval)
        if verdict is not None:
            self._publish_verdict(verdict)

    def write_records(self) -> None:
        """Flush log and record (background thread only)."""
        # the lines of a stop are among these
        self.side_effects.run("the log", self._log_queue.flush)
        self.side_effects.write(rospy.logerr)
        self.side_effects.run("the record", self._disk.write, "the record", self._log.flush)

    def save_engagement(self) -> None:
        """Save the engagement, and publish it (background thread only)."""
        if (engagement := self._disk.save_engagement()) is not None:
            self._publish("engagement", engagement_to_msg(*engagement))

    # -- reports

    def _publish(self, topic: str, message: genpy.Message) -> None:
        message.header.stamp = rospy.Time.now()
        self._node_io.publishers[topic].publish(message)

    def _publish_verdict(self, verdict: Verdict) -> None:
        reason = f": {verdict.reason}" if verdict.reason else ""
        known = verdict.rehearsal
        rehearsal = f"; rehearsal: {' '.join(filter(None, (known.state, known.engine)))}" if known is not None else ""
        words = verdict.plan_id, verdict.verdict, verdict.reviewer, reason, rehearsal
        self._log_queue.add(rospy.loginfo, "plan %s %s by %s%s%s", *words)
        message = to_msg(verdict, msg.Review)
        message.approved = verdict.approved
        self._publish("review", message)

    def _publish_changes(self) -> None:
        """Publish and log changes on the cycle's thread, without waiting for a disk or a terminal.

        From a safety act until it is published, and the arm rests, no part of this can end the node.
        """
        executor = self.executor
        with self._lock:
            run = self.side_effects.run if executor.pop_act_flag() else _run_unguarded
            events, orders = executor.pop_events(), executor.pop_orders()
            news = run("the executor's state", self._reporter.pop_report, lambda: (now_ns(), str(present_moment())))
            report, lines = news or (None, ())
        for order in orders:
            self._publish("tool_command", order_to_msg(order))
        if report is not None:
            publish = self._node_io.publishers["execution"].publish
            run("the topic execution", lambda: publish(to_msg(report, msg.Execution)))
        for event in events:
            if not (isinstance(event, Verdict) and event.verdict == REJECTED):
                # a person's rejection was kept for the record when it was carried out
                run("the record", self._log.defer, event)
            if isinstance(event, Verdict):
                run("the topic review", self._publish_verdict, event)
        for warns, line in lines:
            run("the log", self._log_queue.add, rospy.logwarn if warns else rospy.loginfo, "%s", line)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        executor, log = self.executor, self._log.file
        values = {
            "outcome of the last plan": executor.outcome,
            "rate": f"{executor.rate:.3f}",
            "speed limit": f"{self._limit.limit:.3f}",
            "speed limit because": self._limit.reason,
            "records": log.lines,
            "records lost": log.lost,
        } | self.side_effects.status_fields()
        if problem := self._disk.fault:
            return Diagnosis(ERROR, problem, values)
        with self._lock:
            engaged = executor.engagement.sentence
        if failed := engaged or self.side_effects.sentence:
            return Diagnosis(WARN, failed, values)
        return Diagnosis(WARN if self._reporter.waits else OK, f"{executor.state.name}: {executor.reason}", values)


def check(settings: Settings, robot: RobotModel, *_: object) -> None:
    """Check permission and files; see `NodeShell`."""
    settings.check(robot)
    if settings.rehearsal == "require":
        import_extension("physics")
    tool_hash(settings.tool)
    check_writable(robot_file(settings.review_file, robot.name).parent)


INTERFACE = shell.Interface(
    diagnose=ExecutorNode.diagnose,
    publishes=(
        shell.PosePublication("next/joint_states"),
        shell.Publication("execution", msg.Execution, queue_size=10, latch=True),
        shell.Publication("review", msg.Review, queue_size=10, latch=True),
        # not latched: a bridge that is started again must not take a switch that was meant for another moment
        shell.Publication("tool_command", msg.ToolCommand, queue_size=50, tcp_nodelay=True),
        shell.Publication("engagement", msg.Engagement, queue_size=5, latch=True),
    ),
    subscribes=(
        shell.PoseSubscription("twin/joint_states", ExecutorNode.on_twin, queue_size=1, pause=TWIN_PAUSE),
        shell.Subscription("sync", msg.Sync, ExecutorNode.on_sync, queue_size=50, tcp_nodelay=True),
        shell.Subscription("scene", msg.Scene, ExecutorNode.on_scene, queue_size=5),
        shell.Subscription("plan", msg.Plan, ExecutorNode.on_plan, queue_size=5),
        shell.Subscription("rehearsal", msg.Rehearsal, ExecutorNode.on_rehearsal, queue_size=5),
        shell.Subscription(
            "speed_limit_in_force", msg.SpeedLimitInForce, ExecutorNode.on_limit, queue_size=5, tcp_nodelay=True
        ),
        shell.Subscription(
            "speed_change", msg.SpeedChange, lambda node, said: node.record(from_msg(SpeedChange, said)), queue_size=50
        ),
        shell.Subscription(
            "conflict", msg.Conflict, ExecutorNode.on_conflict, queue_size=20, tcp_nodelay=True,
            when=lambda settings: bool(settings.neighbour),
        ),
        shell.Subscription("link", msg.Link, ExecutorNode.on_link, queue_size=5, when=shell.has_arm),
        shell.Subscription(
            "session_request",
            msg.SessionRequest,
            lambda node, said: node.record(from_msg(SessionRequest, said)),
            queue_size=10,
            when=shell.has_arm,
        ),
        shell.Subscription("tool", msg.ToolState, ExecutorNode.on_tool, queue_size=20, tcp_nodelay=True, when=shell.has_arm),
    ),
    serves=(
        shell.Served("review_plan", srv.ReviewPlan, ExecutorNode.on_review, "review"),
        shell.Served("stop", Trigger, ExecutorNode.on_stop),
        shell.Served("stop_plan", srv.StopPlan, ExecutorNode.on_stop_plan, "stop_plan"),
        shell.Served("release_engagement", srv.ReleaseEngagement, ExecutorNode.on_release, "release_engagement"),
        shell.Served("pause", Trigger, ExecutorNode.on_pause, "pause"),
        shell.Served("resume", Trigger, ExecutorNode.on_resume, "resume"),
        shell.Served("~act_as_seen", srv.ActAsSeen, ExecutorNode.on_act_as_seen, lambda asked: asked.act),
    ),
    timers=(shell.NodeTimer(lambda _settings: BACKGROUND_PERIOD, ExecutorNode.do_background_work),),
)  # fmt: skip
NODE = shell.NodeShell("executor", Settings, ExecutorNode, INTERFACE, check, fast=True)
main = NODE.run
