"""executor: plays the approved plan as `next/joint_states` at 250 Hz; serves `review_plan`, the stops, `pause`, `resume`.

`~act_as_seen` resumes for people at screens elsewhere. Of a work plan also `tool_command`, from what `tool` says; `engagement`, and
the service `release_engagement`.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple, TypeVar

import pydantic
import rospy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from construction_twin.core.errors import (
    ConfigurationError,
    ConstructionTwinError,
    ExecutionError,
    ExpiredError,
    PayloadError,
    RecordError,
    ReviewError,
)
from construction_twin.core.files import check_writable
from construction_twin.core.freshness import LIFETIME, TOO_OLD, Moment, is_newer, parse_moment, staleness
from construction_twin.core.reports import ExecutionReport, SessionRequest, SpeedChange, ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.speed_limit import LimitState, SpeedLimit
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.approval import AUTO_APPROVE, Approval, WithoutPerson
from construction_twin.execution.conflict_verdicts import ConflictVerdicts
from construction_twin.execution.engagement import check_way_back
from construction_twin.execution.executor import Executor, ExecutorState
from construction_twin.execution.playback import StopForecaster
from construction_twin.execution.rehearsal_check import RehearsalCheck
from construction_twin.execution.segment_run import NO_ARM
from construction_twin.execution.states import ACTIVE
from construction_twin.monitor.gate import SyncState
from construction_twin.msg import (
    Conflict,
    Engagement,
    Execution,
    Link,
    Plan,
    Rehearsal,
    Review,
    Scene,
    SpeedLimitInForce,
    Sync,
    ToolCommand,
    ToolState,
)
from construction_twin.msg import SessionRequest as SessionRequestMessage
from construction_twin.msg import SpeedChange as SpeedChangeMessage
from construction_twin.physics.report import RehearsalReport, is_whole
from construction_twin.review.plan_under_review import EXECUTOR, REJECTED, Verdict
from construction_twin.review.record import Release, Responsibility, ReviewLog
from construction_twin.robot.description import ESTIMATES, RobotModel
from construction_twin.robot.plan import Plan as PlanContent
from construction_twin.robot.tool import tool_hash
from construction_twin.ros.messages.convert import plan_from_msg
from construction_twin.ros.messages.records import from_msg, to_msg
from construction_twin.ros.messages.tool import engagement_to_msg, order_to_msg, tool_report_from_msg
from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.engagement_file import ENDED, EngagementFile
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.params import NodeSettings, robot_file
from construction_twin.ros.shared.ports import (
    Every,
    Interface,
    Ports,
    PosePublication,
    PoseSubscription,
    Publication,
    Served,
    Shared,
    Subscription,
    has_arm,
)
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.transport.cycle import Cycles
from construction_twin.ros.transport.joint_stream import from_time, now_ns
from construction_twin.ros.transport.publisher import Sink
from construction_twin.ros.transport.subscriber import caller_of
from construction_twin.srv import (
    ActAsSeen,
    ActAsSeenRequest,
    ReleaseEngagement,
    ReleaseEngagementRequest,
    ReviewPlan,
    ReviewPlanRequest,
    StopPlan,
    StopPlanRequest,
)

#: The gate counts as closed this long after the monitor's last word; it speaks at its `SYNC_RATE` [ns].
SYNC_TIMEOUT = NANOSECONDS // 2
#: How often deferred records are written, and a plan is checked for that may be approved by itself [s].
BACKGROUND_PERIOD = 0.05
#: Between two reads of the twin's pose [s]: its pose is needed where it rests, and counts as known for much longer.
TWIN_PAUSE = 0.02
#: How long the forecast of a stop leaves the processor to the cycle, every few setpoints [s].
PAUSE = 0.0005


#: States in which an act of a person is under way.
BRAKING = (ExecutorState.STOPPING, ExecutorState.PAUSING)

_Result = TypeVar("_Result")


class Settings(NodeSettings):
    """Private parameters; see config/executor.yaml, the others are given in launch/gate.launch."""

    arm: Literal["mock", "real", "none"]
    auto_approve: bool = False
    auto_approve_is_meant: bool = False
    auto_approve_sources: tuple[Annotated[str, pydantic.Field(min_length=1)], ...] = ()
    review_file: Annotated[str, pydantic.Field(min_length=1)]
    neighbour: str = ""
    rehearsal: Literal["auto", "advise", "require", "off"] = "off"
    tool: str = ""
    speed_limit_deadline: float = pydantic.Field(gt=0)
    speed_limit_silent: float = pydantic.Field(ge=0, le=1)
    speed_limit_required: bool

    @pydantic.field_validator("auto_approve_sources")
    @classmethod
    def _never_with_a_real_arm(cls, names: tuple[str, ...], given: pydantic.ValidationInfo) -> tuple[str, ...]:
        if names and given.data.get("arm") == "real":
            raise ValueError(Sentence("expected.no_auto_approval"))
        return names


class ExecutionFields(NamedTuple):
    """Fields of Execution.msg, which is published when one changes; they are read in every cycle."""

    state: ExecutorState
    reason: str
    plan_start: int
    outcome: str
    steady: bool
    #: A limit that follows a sensor changes all the time: a hundredth is worth a message, none of it a line in the log.
    limit: float
    segment: int
    at_boundary: bool
    expected_scene: str
    engaged: bool


@dataclass(frozen=True)
class Outputs:
    """Where the executor publishes."""

    next: Sink
    execution: Sink
    approval_obstacle: Sink
    review: Sink
    tool_command: Sink
    engagement: Sink


class LoggedState(NamedTuple):
    """What of the executor is worth a line in the log when it changes."""

    state: ExecutorState
    cause: str
    standing: bool
    plan_start: int
    outcome: str


class Snapshot(NamedTuple):
    """The executor in one cycle, as far as there is something to report."""

    fields: ExecutionFields
    logged: LoggedState
    plan: PlanContent | None
    rate: float
    limit: float
    limit_state: LimitState
    limit_reason: str
    stamp: int
    moment: Moment


def _do(_what: str, part: Callable[..., _Result], *arguments: object) -> _Result:
    """Call a part whose failure ends the node, as everywhere else."""
    return part(*arguments)


class ExecutorNode:
    """ROS around an Executor; `start` gives it parameters, topics and services.

    Args:
        engagements: What it says at the start holds: the executor before this one ended inside an engaged segment.
        diagnostics: Counts what is refused.
        without_person: Which plans are approved without a person; by default none.
    """

    def __init__(
        self,
        robot: RobotModel,
        executor: Executor,
        limit: SpeedLimit,
        log: ReviewLog,
        outputs: Outputs,
        engagements: EngagementFile,
        diagnostics: NodeDiagnostics,
        without_person: WithoutPerson = WithoutPerson(),
    ):
        self._robot = robot
        self._executor = executor
        self._limit = limit
        self._limit_state: LimitState | None = None
        self._log = log
        self._outputs = outputs
        self._engagements = engagements
        self._reported_engagement: tuple | None = None
        self._record_problem = ""
        self._engagement_problem = ""
        self._log_queue = DeferredLog()
        self._side_effects = executor.side_effects
        # safety acts, and how many of them were told of: until then, and while the arm brakes, what tells cannot end this node
        self._acts = self._acts_reported = 0
        # of the newest pause or stop that was answered; a screen that has not seen it resumes nothing
        self._rested: Moment | None = None
        self._started = present()
        self._lock = threading.Lock()
        self._approval = Approval(executor, log.append, self._lock, lambda: present())
        self._without_person = without_person
        # against approving the plan under review: looked at beside the cycle, because a start is compared with every joint
        self._obstacle: str | None = None
        self._session: str | None = None
        self._sync_at = 0
        self._reported: ExecutionFields | None = None
        self._logged: LoggedState | None = None
        self._diagnostics = diagnostics
        found = engagements.read()
        if found is not None:
            executor.engagement.found(found if found.reason else replace(found, reason=ENDED))
            rospy.logwarn("%s", executor.engaged())

    @property
    def side_effects(self) -> SideEffects:
        """What tells of a stop, a pause or a rejection, and cannot fail it."""
        return self._side_effects

    def run(self) -> None:
        """Publish one setpoint per cycle until shutdown."""
        for stamp, stalled in Cycles():
            with self._lock:
                now = time.monotonic_ns()
                if now - self._sync_at > SYNC_TIMEOUT:
                    self._executor.on_sync(SyncState.STALE, False)
                if stalled:
                    self._executor.stall(Sentence("executor.stalled", seconds=stalled / 1e9))
                self._executor.limit_rate(self._limit.update(now), self._limit.reason)
                setpoint = self._executor.step(stamp, now)
            if setpoint is not None:
                self._outputs.next.publish(stamp, setpoint)
            self._publish_changes()

    # -- subscriptions

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Take the twin's pose [rad] with its stamp [ns]."""
        with self._lock:
            self._executor.on_twin(stamp, q, time.monotonic_ns())

    def on_sync(self, message: Sync) -> None:
        """Take what the monitor says; what it does not say for `SYNC_TIMEOUT` counts as closed."""
        try:
            state = SyncState(message.state)
        except ValueError:
            self._diagnostics.refuse("sync", Sentence("reason.refused.sync_state", state=message.state))
            return
        with self._lock:
            self._sync_at = time.monotonic_ns()
            self._executor.on_sync(state, message.agreed, message.policy, from_time(message.held_stamp))
            self._executor.trail(message.round_trip, message.servo_lag)

    def on_limit(self, message: SpeedLimitInForce) -> None:
        """Take the speed limit in force."""
        source = caller_of(message)
        try:
            with self._lock:
                self._limit.accept(message.limit, source, time.monotonic_ns(), sentence=message.reason)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))

    def on_scene(self, message: Scene) -> None:
        """Take the scene for which plans may be approved."""
        with self._lock:
            self._executor.on_scene(message.hash)

    def on_conflict(self, message: Conflict) -> None:
        """Take a verdict on the other arm, with the age that its stamp tells."""
        # by the clock that both nodes have; from here on it grows old by the executor's own
        age = (rospy.Time.now() - message.header.stamp).to_nsec()
        problem = message.reason if message.conflict else ""
        try:
            with self._lock:
                self._executor.neighbour.on_verdict(message.plan_id, problem, time.monotonic_ns(), age)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))

    def on_rehearsal(self, message: Rehearsal) -> None:
        """Take what the rehearsal of a plan has found."""
        report = from_msg(RehearsalReport, message)
        if not is_whole(report):
            self._diagnostics.refuse("rehearsal", Sentence("reason.refused.rehearsal", plan=repr(report.plan_id)))
            return
        with self._lock:
            self._executor.rehearsal.on_report(report)

    def on_plan(self, message: Plan) -> None:
        """Take a plan to be reviewed."""
        try:
            plan = plan_from_msg(message)
        except ConstructionTwinError as error:
            self._diagnostics.refuse("plan", str(error))
            return
        with self._lock:
            keeper = self._executor.engagement
            way_back = keeper.present if keeper.engaged else None
        problem = None
        if way_back is not None:
            # outside of the lock: it takes many cycles' time
            try:
                check_way_back(plan, way_back)
            except ReviewError as error:
                problem = error
        with self._lock:
            try:
                if plan.asked.origin != self._started.origin:
                    raise ReviewError(Sentence("executor.plan_elsewhere", plan=plan.id))
                if plan.asked.at < self._started.at:
                    raise ReviewError(Sentence("executor.plan_older", plan=plan.id))
                if problem is not None:
                    raise problem
                self._executor.offer(plan, way_back)
            except ReviewError as error:
                # displays that show it as waiting take it away
                self._executor.tell_withdrawn(plan, error.sentence)
                self._diagnostics.refuse("plan", str(error))

    def on_tool(self, message: ToolState) -> None:
        """Take what is known of the tool."""
        try:
            report = tool_report_from_msg(message)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            return
        with self._lock:
            self._executor.on_tool(report, time.monotonic_ns())

    def on_link(self, message: Link) -> None:
        """Take the link's state; a new session ends what is being executed."""
        with self._lock:
            if message.session and message.session != self._session:
                if self._session is not None:
                    self._executor.restart(Sentence("reason.gate.new_session"), self._asked_until())
                self._session = message.session
            reason = Sentence("executor.link", state=message.text, reason=message.reason)
            self._executor.on_link(message.state == Link.ARMED, reason)
        before, now = self._log.responsibility, None
        if message.responsible:
            now = Responsibility(message.responsible, message.session, tuple(message.not_checked))
        self._log.responsibility = now
        if now is not None and now != before:
            self._log.defer(now)

    def on_session_request(self, message: SessionRequestMessage) -> None:
        """Record who has lifted a stop or fault, or armed."""
        self._log.defer(from_msg(SessionRequest, message))

    def on_speed_change(self, message: SpeedChangeMessage) -> None:
        """Record who has set the speed limit of people."""
        self._log.defer(from_msg(SpeedChange, message))

    # -- services

    # A stop, a pause, a rejection: first the act, under the lock; then, beside it, what tells of it (docs/architecture.md).

    def on_review(self, request: ReviewPlanRequest) -> Outcome:
        """Approve or reject a plan in a person's name; an approval is as old as what its screen had shown, else as the call."""
        try:
            seen = parse_moment(request.moment) if request.approve and request.moment else None
            if request.reviewer.strip() in (AUTO_APPROVE, EXECUTOR):
                raise ReviewError(Sentence("review.own_name", name=repr(request.reviewer)))
            if not request.approve:
                with self._lock:
                    self._note_act()
            taken = self._approval.review(
                request.plan_id,
                request.plan_hash,
                request.approve,
                request.reviewer,
                request.reason,
                seen,
                request.rehearsal_hash if request.override_rehearsal else None,
            )
        except ConstructionTwinError as error:
            return self._refused("review", error)
        if taken.verdict.approved:
            # a rejection is told with what the executor decides by itself
            self._publish_verdict(taken.verdict)
        else:
            # what was answered is on record, also where the node ends before its next cycle
            self._side_effects.run("the record", self._log.defer, taken.verdict)
        return Outcome(True, taken.sentence)

    def on_stop(self, _request) -> Outcome:
        """Brake on the path and drop the plan."""
        with self._lock:
            self._note_act()
            sentence = self._executor.stop(self._asked_until())
            self._note_rest()
            braking = self._side_effects.run("the forecast of a stop", self._executor.braking)
        # it brakes already; the forecast takes some cycles' time, and must not hold up a setpoint
        if braking is not None:
            forecast = self._side_effects.run("the forecast of a stop", self._forecast, braking)
            forecast = forecast or Sentence("executor.stop.no_forecast")
            sentence = Sentence("executor.both", first=sentence, second=forecast)
        self._say(rospy.logwarn, "stop: %s", sentence)
        return Outcome(True, sentence)

    def _forecast(self, braking: StopForecaster) -> str:
        return braking.forecast(lambda: time.sleep(PAUSE)).text(self._robot)

    def on_stop_plan(self, request: StopPlanRequest) -> Outcome:
        """Brake one plan on its path; what waits is left alone."""
        caller = self._side_effects.run("the name of a caller", caller_of, request)

        def stop() -> str:
            with self._lock:
                self._note_act()
                asked = Sentence("executor.stop_asked_by", client=caller or "a client")
                sentence = self._executor.stop_plan(request.plan_id, asked)
                self._note_rest()
            return sentence

        return self._carry_out("stop_plan", stop, rospy.logwarn)

    def _carry_out(self, request: str, act: Callable[[], str], write: Callable[..., None] | None = None) -> Outcome:
        """Carry out a person's request, and answer it."""
        try:
            sentence = act()
        except ConstructionTwinError as error:
            return self._refused(request, error)
        self._say(write or rospy.loginfo, "%s: %s", request, sentence)
        return Outcome(True, sentence)

    def _refused(self, request: str, error: ConstructionTwinError) -> Outcome:
        """Return the answer to a request that was refused, count it, and have its line written after the answer."""
        if isinstance(error, PayloadError):
            self._diagnostics.refuse(error.reason, str(error))
        elif isinstance(error, ExpiredError):
            self._diagnostics.refuse(TOO_OLD, str(error))
        else:
            self._side_effects.run("the count of refusals", self._diagnostics.count, request, str(error))
            self._say(rospy.logwarn, "%s refused: %s", request, error)
        return Outcome(False, str(error), isinstance(error, ExpiredError))

    def _note_act(self) -> None:
        self._acts += 1

    def _note_rest(self) -> None:
        # where the moment cannot be read, no screen can show a later one
        self._rested = self._side_effects.run("the moment of an act", present) or Moment("", 0)

    def _say(self, write: Callable[..., None], *words) -> None:
        """Have a line written after the answer."""
        self._side_effects.run("the log", self._log_queue.add, write, *words)

    def on_release(self, request: ReleaseEngagementRequest) -> Outcome:
        """Take a person's word that the arm was freed; recorded before it counts."""

        def release() -> str:
            return self._release(request.person.strip(), request.reason.strip())

        return self._carry_out("release_engagement", release, rospy.logwarn)

    def _release(self, person: str, reason: str) -> str:
        if not person or not reason:
            raise ExecutionError(Sentence("executor.release.nameless"))
        with self._lock:
            left = self._executor.check_release()
        release = Release(person, reason, left.plan_id, left.task, left.segment)
        asked = present()
        self._log.append(release)
        try:
            if problem := staleness(asked, present()):
                raise ExecutionError(Sentence("executor.void.release", problem=problem))
            with self._lock:
                self._executor.release(left)
        except ExecutionError as error:
            # something happened while it was written down: the record is corrected
            self._log.append(replace(release, refused=str(error)))
            raise
        where = {"segment": repr(left.segment), "plan": left.plan_id}
        return Sentence("executor.release.done", **where, person=person, reason=reason)

    def on_pause(self, _request) -> Outcome:
        """Brake on the path and keep the plan."""
        return self._carry_out("pause", self._pause)

    def on_resume(self, _request) -> Outcome:
        """Go on after a pause."""
        return self._carry_out("resume", self._resume)

    def _pause(self) -> str:
        with self._lock:
            self._note_act()
            sentence = self._executor.pause(self._asked_until())
            self._note_rest()
        return sentence

    def _resume(self) -> str:
        with self._lock:
            return self._executor.resume()

    def _asked_until(self) -> int:
        # where the clock cannot be read, whatever comes was asked for before
        now = self._side_effects.run("the moment of an act", present)
        return sys.maxsize if now is None else now.at

    def on_act_as_seen(self, request: ActAsSeenRequest) -> Outcome:
        """Go on after a pause, unless what the person's screen had shown is too old, or older than a pause or stop."""

        def resume() -> str:
            if request.act != "resume":
                raise PayloadError("act", Sentence("executor.void.act", act=repr(request.act)))
            seen = parse_moment(request.moment)
            with self._lock:
                now = present()
                if problem := staleness(seen, now):
                    raise ExpiredError(Sentence("executor.void.resume", problem=problem))
                if not is_newer(seen, self._rested):
                    raise ExpiredError(Sentence("executor.void.resume_since"))
                return self._executor.resume(LIFETIME - (now.at - seen.at))

        return self._carry_out("resume", resume)

    # -- in the background

    def do_background_work(self, scene_alive: bool) -> None:
        """Do what may wait; to be called every `BACKGROUND_PERIOD`.

        An error would end the timer for good: that of a record is said and tried again, no other can occur. Publishing fails only
        while the node shuts down, where `Publisher` drops the message; a verdict that is refused ends in `Approval`.

        Args:
            scene_alive: Whether there is a node that says which scene is the present one.
        """
        self.write_records()
        # where a stop leaves the arm is written down here
        reported = self._acts == self._acts_reported
        (_do if reported else self._side_effects.run)("the engagement", self.keep_engagement)
        with self._lock:
            self._executor.under_review.scene_alive = scene_alive
            obstacle = self._executor.approval_obstacle()
        if obstacle != self._obstacle:
            self._obstacle = obstacle
            self._outputs.approval_obstacle.publish(String(obstacle))
        if self._without_person == WithoutPerson():
            return
        try:
            taken = self._approval.approve_by_itself(time.monotonic_ns(), self._without_person)
        except RecordError as error:
            rospy.logerr_throttle(5.0, "%s", error)
            return
        if taken is not None:
            self._publish_verdict(taken.verdict)

    def write_records(self) -> None:
        """Write what is kept to log and record; not for the path of the setpoints."""
        # the lines of a stop are among these
        self._side_effects.run("the log", self._log_queue.flush)
        self._side_effects.write(rospy.logerr)
        self._side_effects.run("the record", self._flush_record)

    def _flush_record(self) -> None:
        try:
            self._log.flush()
        except RecordError as error:
            self._record_problem = str(error)
            rospy.logerr_throttle(5.0, "%s", error)
            return
        self._record_problem = ""

    def keep_engagement(self) -> None:
        """Write down where the arm is about to be, or was left, and tell the planner; not for the path of the setpoints."""
        with self._lock:
            keeper, tool = self._executor.engagement, self._executor.tool
            present, settled, engaged = keeper.present, keeper.settled, keeper.engaged
        if not settled:
            try:
                self._engagements.write(present)
            except ExecutionError as error:
                self._engagement_problem = str(error)
                rospy.logerr_throttle(5.0, "%s", error)
                return
            with self._lock:
                keeper.on_written(present)
        self._engagement_problem = ""
        left = present if engaged else None
        report = left, left.requires(tool) if left is not None else ()
        if report != self._reported_engagement:
            self._reported_engagement = report
            message = engagement_to_msg(left, tool)
            message.header.stamp = rospy.Time.now()
            self._outputs.engagement.publish(message)

    # -- reports

    def _publish_verdict(self, verdict: Verdict) -> None:
        reason = f": {verdict.reason}" if verdict.reason else ""
        known = verdict.rehearsal
        rehearsal = f"; rehearsal: {' '.join(filter(None, (known.state, known.engine)))}" if known is not None else ""
        self._log_queue.add(
            rospy.loginfo, "plan %s %s by %s%s%s", verdict.plan_id, verdict.verdict, verdict.reviewer, reason, rehearsal
        )
        message = Review(
            plan_id=verdict.plan_id,
            plan_hash=verdict.plan_hash,
            approved=verdict.approved,
            reviewer=verdict.reviewer,
            reason=verdict.reason,
        )
        message.header.stamp = rospy.Time.now()
        self._outputs.review.publish(message)

    def _publish_changes(self) -> None:
        """Publish and note what has changed; on the cycle's thread, so nothing here waits for a disk or a terminal.

        From a safety act until it has been told, and the arm rests, no part of this can end the node.
        """
        executor = self._executor
        with self._lock:
            acts, brakes = self._acts, executor.state in BRAKING
            run = _do if acts == self._acts_reported else self._side_effects.run
            events, orders = executor.take_events(), executor.take_orders()
            now = run("the executor's state", self._snapshot)
        for order in orders:
            command = order_to_msg(order)
            command.header.stamp = rospy.Time.now()
            self._outputs.tool_command.publish(command)
        if now is not None and now.fields != self._reported:
            self._reported = now.fields
            run("the topic execution", self._publish_execution, now)
        for event in events:
            if not (isinstance(event, Verdict) and event.verdict == REJECTED):
                # a person's rejection was kept for the record when it was carried out
                run("the record", self._log.defer, event)
            if isinstance(event, Verdict):
                run("the topic review", self._publish_verdict, event)
        if now is not None:
            run("the log", self._note_changes, now)
        if not brakes:
            self._acts_reported = acts

    def _snapshot(self) -> Snapshot:
        """Return what there is to report; to be called under the lock."""
        executor, limit, work = self._executor, self._limit, self._executor.segment_run
        fields = ExecutionFields(
            executor.state,
            executor.reason,
            executor.plan_start,
            executor.outcome,
            executor.steady,
            round(limit.limit, 2),
            work.number if work is not None else -1,
            work is not None and work.at_boundary and executor.state in ACTIVE,
            work.expected_scene if work is not None and executor.state in ACTIVE else "",
            executor.engagement.engaged,
        )
        standing = executor.limit.standing
        logged = LoggedState(executor.state, executor.cause, standing, executor.plan_start, executor.outcome)
        # with the state: a stop that comes after this moment is not known to the report
        moment = present()
        return Snapshot(
            fields, logged, executor.plan, executor.rate, limit.limit, limit.state, limit.reason, now_ns(), moment
        )

    def _note_changes(self, now: Snapshot) -> None:
        if now.limit_state is not self._limit_state:
            self._limit_state = now.limit_state
            warns = now.limit_state in (LimitState.SILENT, LimitState.MISSING)
            self._log_queue.add(rospy.logwarn if warns else rospy.loginfo, "%s", now.limit_reason)
        if now.logged != self._logged:
            self._logged = now.logged
            self._log_queue.add(rospy.loginfo, "%s: %s", now.fields.state.name, now.fields.reason)

    def _publish_execution(self, now: Snapshot) -> None:
        report = execution_report(now.fields, now.plan, now.rate, now.limit, now.stamp)
        self._outputs.execution.publish(to_msg(replace(report, moment=str(now.moment)), Execution))

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        executor, log = self._executor, self._log.file
        values = {
            "outcome of the last plan": executor.outcome,
            "rate": f"{executor.rate:.3f}",
            "speed limit": f"{self._limit.limit:.3f}",
            "speed limit because": self._limit.reason,
            "records": log.lines,
            "records lost": log.lost,
        } | self._side_effects.report()
        if problem := self._record_problem or self._engagement_problem:
            return Report(ERROR, problem, values)
        with self._lock:
            engaged = executor.engaged() if executor.engagement.engaged else ""
        if engaged:
            return Report(WARN, engaged, values)
        if failed := self._side_effects.sentence:
            return Report(WARN, failed, values)
        slow = self._limit.state in (LimitState.SILENT, LimitState.MISSING)
        level = WARN if slow or executor.state in (ExecutorState.WAITING, ExecutorState.HELD) else OK
        return Report(level, f"{executor.state.name}: {executor.reason}", values)


def execution_report(
    fields: ExecutionFields, plan: PlanContent | None, rate: float, limit: float, stamp: int
) -> ExecutionReport:
    """Return the report at the moment `stamp` [ns]."""
    report = ExecutionReport(
        state=fields.state.value,
        text=fields.state.name,
        reason=fields.reason,
        outcome=fields.outcome,
        rate=rate,
        speed_limit=limit,
        segment=fields.segment,
        at_boundary=fields.at_boundary,
        wants_scene=bool(fields.expected_scene),
        expected_scene=fields.expected_scene,
        engaged=fields.engaged,
        stamp=stamp,
    )
    if plan is None:
        return report
    name = plan.segments[fields.segment].name if fields.segment >= 0 else ""
    start, duration = fields.plan_start, plan.trajectory.duration
    return replace(report, plan_id=plan.id, plan_start=start, duration=duration, segment_name=name)


def check(settings: Settings, robot: RobotModel, _shared: Shared) -> None:
    """Check files, and that a real arm moves by a person's word and by looked-up values; see `NodeShell`."""
    if settings.arm == "real" and settings.auto_approve and not settings.auto_approve_is_meant:
        raise ConfigurationError(
            "auto_approve",
            True,
            "false with arm:=real, for a person to approve each plan; or also give auto_approve_is_meant:=true",
        )
    if settings.arm == "real" and robot.estimates:
        keys = " and ".join(ESTIMATES[word] for word in robot.estimates)
        raise ConfigurationError("estimates", list(robot.estimates), Sentence("expected.no_estimates", keys=keys))
    tool_hash(settings.tool)
    check_writable(robot_file(settings.review_file, robot.name).parent)


def start(settings: Settings, robot: RobotModel, ports: Ports) -> ExecutorNode:
    """Return the executor with its parameters, topics and services."""
    executor = Executor(robot)
    executor.neighbour = ConflictVerdicts(settings.neighbour)
    executor.rehearsal = RehearsalCheck(settings.rehearsal == "require", tool_hash(settings.tool))
    if settings.arm != "none":
        executor.on_link(False, Sentence("executor.no_link"))
    else:
        executor.on_tool(ToolReport(reason=NO_ARM), time.monotonic_ns())
    log = ReviewLog(robot_file(settings.review_file, robot.name), time.time_ns)
    node = ExecutorNode(
        robot,
        executor,
        SpeedLimit(settings.speed_limit_deadline, settings.speed_limit_silent, settings.speed_limit_required),
        log,
        Outputs(
            next=ports.publishers["next/joint_states"],
            execution=ports.publishers["execution"],
            approval_obstacle=ports.publishers["approval_obstacle"],
            review=ports.publishers["review"],
            tool_command=ports.publishers["tool_command"],
            engagement=ports.publishers["engagement"],
        ),
        EngagementFile(log.file.path.with_name(f"{log.file.path.stem}_engagement.json"), robot.joint_names),
        ports.diagnostics,
        WithoutPerson(settings.auto_approve, settings.auto_approve_sources),
    )
    rospy.on_shutdown(node.write_records)
    rospy.loginfo("verdicts are recorded in %s (%d so far)", log.file.path, log.file.lines)
    if settings.auto_approve:
        rospy.logwarn("auto_approve is on: every plan is approved by itself, without a person")
    elif settings.auto_approve_sources:
        named = ", ".join(settings.auto_approve_sources)
        rospy.logwarn("auto_approve_sources is set: plans of %s are approved by themselves, without a person", named)
    return node


INTERFACE = Interface(
    report=ExecutorNode.report,
    publishes=(
        PosePublication("next/joint_states"),
        Publication("execution", Execution, queue_size=10, latch=True),
        Publication("approval_obstacle", String, queue_size=5, latch=True),
        Publication("review", Review, queue_size=10, latch=True),
        # not latched: a bridge that is started again must not take a switch that was meant for another moment
        Publication("tool_command", ToolCommand, queue_size=50, tcp_nodelay=True),
        Publication("engagement", Engagement, queue_size=5, latch=True),
    ),
    hears=(
        PoseSubscription("twin/joint_states", ExecutorNode.on_twin, queue_size=1, pause=TWIN_PAUSE),
        Subscription("sync", Sync, ExecutorNode.on_sync, queue_size=50, tcp_nodelay=True),
        Subscription("scene", Scene, ExecutorNode.on_scene, queue_size=5),
        Subscription("plan", Plan, ExecutorNode.on_plan, queue_size=5),
        Subscription("rehearsal", Rehearsal, ExecutorNode.on_rehearsal, queue_size=5),
        Subscription(
            "speed_limit_in_force", SpeedLimitInForce, ExecutorNode.on_limit, queue_size=5, tcp_nodelay=True
        ),
        Subscription("speed_change", SpeedChangeMessage, ExecutorNode.on_speed_change, queue_size=50),
        Subscription(
            "conflict", Conflict, ExecutorNode.on_conflict, queue_size=20, tcp_nodelay=True,
            when=lambda settings: bool(settings.neighbour),
        ),
        Subscription("link", Link, ExecutorNode.on_link, queue_size=5, when=has_arm),
        Subscription(
            "session_request", SessionRequestMessage, ExecutorNode.on_session_request, queue_size=10, when=has_arm
        ),
        Subscription("tool", ToolState, ExecutorNode.on_tool, queue_size=20, tcp_nodelay=True, when=has_arm),
    ),
    serves=(
        Served("review_plan", ReviewPlan, ExecutorNode.on_review),
        Served("stop", Trigger, ExecutorNode.on_stop),
        Served("stop_plan", StopPlan, ExecutorNode.on_stop_plan),
        Served("release_engagement", ReleaseEngagement, ExecutorNode.on_release),
        Served("pause", Trigger, ExecutorNode.on_pause),
        Served("resume", Trigger, ExecutorNode.on_resume),
        Served("~act_as_seen", ActAsSeen, ExecutorNode.on_act_as_seen),
    ),
    every=(
        Every(
            lambda _settings: BACKGROUND_PERIOD,
            lambda node, ports: node.do_background_work(ports.connections("scene") > 0),
        ),
    ),
)  # fmt: skip
NODE = NodeShell("executor", Settings, start, INTERFACE, check, fast=True)


def main() -> None:
    """Run the node."""
    NODE.run()
