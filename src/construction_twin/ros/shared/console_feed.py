"""What consoles are told beside `view`: the status line, the scene, the tasks of the building model; which plan is under review.

Everything here was published on ROS already; it is put into the words and files that a browser can use.
"""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import replace

from std_msgs.msg import String

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.motion_errors import SceneError
from construction_twin.core.records import SPACED, dumped
from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SpeedChange, SyncReport, WorkReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.states import ACTIVE
from construction_twin.link.remote_review import PathView, PlanBoard
from construction_twin.mqtt.messages import Topics
from construction_twin.msg import Hold, Link, Plan, Rehearsal, Review, SessionRequest, WorkTasks
from construction_twin.msg import Scene as SceneMsg
from construction_twin.msg import SpeedChange as SpeedChangeMessage
from construction_twin.physics.report import STATES
from construction_twin.review.plan_under_review import EXECUTOR
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.message_board import MessageBoard, MessageFile
from construction_twin.ros.shared.private_files import PrivateFiles
from construction_twin.scene.objects import Scene
from construction_twin.views.hold_cause import hold_cause
from construction_twin.views.message_history import APPROVED, APPROVED_REHEARSED, REJECTED
from construction_twin.views.scene_view import scene_view
from construction_twin.views.startup import Deployment, Seen, Word, first_missing
from construction_twin.views.status_line import Line, ReportsNow, status_lines

#: The status line is looked at so often, and sent again without a change after so long [s].
LOOK, REPEAT = 0.2, 1.0
#: A tool's path is thinned to so many points, beside the ends of its segments; of so many plans it is kept until one is played.
PATH_POINTS, PATHS = 200, 8
_UNDER_WAY = frozenset(state.name for state in ACTIVE)


class ConsoleFeed:
    """Keeps what is retained, and sends it again where the broker may have forgotten it. Topics come in threads of their own.

    Args:
        base_link: Frame of the scene's objects.
        publish: Takes topic, payload, QoS and the retain flag; what cannot be sent now is dropped.
        refuse: Counts a refused input; takes reason and sentence.
        deployment: What was started; None: what the start waits for is not told.
        files: Where the scene's meshes go; None: no console was started with this robot.
        messages: Where the messages are kept; None: only in memory.
        clock: Returns the time of day [s since 1970].
    """

    def __init__(
        self,
        topics: Topics,
        base_link: str,
        publish: Callable[[str, bytes, int, bool], object],
        refuse: Callable[[str, str], None],
        deployment: Deployment | None = None,
        files: PrivateFiles | None = None,
        messages: MessageFile | None = None,
        clock: Callable[[], float] = time.time,
    ):
        self._topics, self._base_link = topics, base_link
        self._publish, self._refuse = publish, refuse
        self._deployment, self._files = deployment, files
        self._lock = threading.Lock()
        self._board = PlanBoard()
        #: Of the newest plans, by id: the payload of `path` while that plan is played.
        self._paths: dict[str, bytes] = {}
        #: Of the newest plans, by id: what their rehearsal has found.
        self._rehearsals: dict[str, Rehearsal] = {}
        self._playing = ""
        self._telling = threading.Lock()
        self._session = ""
        self._retained: dict[str, bytes] = {}
        self._scene: Scene | None = None
        self._work: WorkReport | None = None
        self._hold, self._obstacle = HoldReport(), ""
        self._arm_seen = self._twin_seen = False
        #: What a person must not miss.
        self.messages = MessageBoard(lambda text: self._keep(topics.messages, text), refuse, messages, clock)
        self._looked = self._told_at = float("-inf")
        self._told = b""

    # -- from ROS

    def on_plan(self, message: Plan) -> None:
        """Take a plan for review."""
        with self._lock:
            self._board.on_plan(message.id, message.id.encode())
            self._paths.pop(message.id, None)
            self._paths[message.id] = _path_of(message)
            while len(self._paths) > PATHS:
                del self._paths[next(iter(self._paths))]
        self._tell_path()

    def on_rehearsal(self, message: Rehearsal) -> None:
        """Take what the rehearsal of a plan has found, for the message that the plan was approved."""
        with self._lock:
            self._rehearsals.pop(message.plan_id, None)
            self._rehearsals[message.plan_id] = message
            while len(self._rehearsals) > PATHS:
                del self._rehearsals[next(iter(self._rehearsals))]

    def on_review(self, message: Review) -> None:
        """Take a verdict."""
        with self._lock:
            self._board.on_verdict(message.plan_id)
            rehearsal = self._rehearsals.get(message.plan_id)
        if message.reviewer in ("", EXECUTOR):
            return
        act, said = APPROVED if message.approved else REJECTED, {"reason": message.reason}
        if message.approved and rehearsal is not None and rehearsal.engine and rehearsal.plan_hash == message.plan_hash:
            # which engine it was, and which version: as the record has it
            act, said = APPROVED_REHEARSED, {"engine": rehearsal.engine, "found": _found(rehearsal.state)}
        self.messages.on_act(act, message.header.stamp, person=message.reviewer, **said)

    def on_execution(self, report: ExecutionReport) -> None:
        """Tell the tool's path of the plan that is under way; none once it has ended."""
        self._playing = report.plan_id if report.text in _UNDER_WAY else ""
        self._tell_path()

    def _tell_path(self) -> None:
        # a node that was started in the middle of a motion may hear of the plan after it has heard that it is played
        with self._telling:
            with self._lock:
                payload = self._paths.get(self._playing, b"")
                told = self._retained.get(self._topics.path, b"")
            if payload != told:
                self._keep(self._topics.path, payload)

    def on_session_request(self, message: SessionRequest) -> None:
        """Take that a person has lifted a stop or fault, or armed."""
        person = message.person or Sentence("line.person.somebody")
        self.messages.on_act(message.verb, message.stamp, person=person, lifts=message.lifts)

    def on_speed_change(self, message: SpeedChangeMessage) -> None:
        """Take that a person has set the speed limit of people."""
        self.messages.on_speed(from_msg(SpeedChange, message))

    def on_hold(self, message: Hold) -> None:
        """Take why the gate is closed."""
        self._hold = from_msg(HoldReport, message)

    def on_approval_obstacle(self, message: String) -> None:
        """Take why the plan under review could not be approved now."""
        self._obstacle = message.data

    def on_link(self, message: Link) -> None:
        """Take that another session has made the plan void."""
        with self._lock:
            if message.session and self._session and message.session != self._session:
                self._board.restart()
            self._session = message.session or self._session

    def on_scene(self, message: SceneMsg) -> None:
        """Write the scene's meshes, then tell the scene: who hears of a mesh finds its file."""
        try:
            scene = scene_from_msg(message)
            if self._files is not None:
                self._files.write_scene(scene)
        except (SceneError, ConfigurationError) as error:
            self._refuse("scene", str(error))
            return
        self._scene = scene
        self._keep(self._topics.scene, dumped(scene_view(scene, self._base_link)))

    def on_tasks(self, message: WorkTasks) -> None:
        """Tell the tasks."""
        self._work = from_msg(WorkReport, message)
        self._keep(self._topics.work_tasks, dumped(self._work))

    # -- to MQTT

    def publish_retained(self) -> None:
        """Tell everything again: the broker may have been started anew."""
        with self._lock:
            retained = dict(self._retained)
            self._told_at = float("-inf")
        for topic, payload in retained.items():
            self._publish(topic, payload, 1, True)
            newest = self._retained[topic]
            if newest is not payload:
                # it came meanwhile, and what is retained must not be the older one, which may have been sent behind it
                self._publish(topic, newest, 1, True)

    def publish_offline(self) -> None:
        """Take away what is retained: nobody keeps it up to date any more."""
        with self._lock:
            topics = list(self._retained)
        for topic in topics:
            self._publish(topic, b"", 1, True)

    def _keep(self, topic: str, payload: bytes) -> None:
        with self._lock:
            self._retained[topic] = payload
        self._publish(topic, payload, 1, True)

    @property
    def scene(self) -> Scene | None:
        """The present scene; None while it is not known."""
        return self._scene

    @property
    def plan(self) -> str:
        """Id of the plan under review; empty: none."""
        with self._lock:
            return self._board.payload.decode()

    @property
    def hold(self) -> HoldReport:
        """Why the gate is closed, as the monitor said last."""
        return self._hold

    @property
    def approval_obstacle(self) -> str:
        """Why the plan under review could not be approved now, as the executor said last; empty: it could."""
        return self._obstacle

    def note_poses(self, twin: bool, arm: bool) -> None:
        """Take whether a pose of the twin, and of the arm, is known: a start waits for the first of each."""
        self._twin_seen, self._arm_seen = self._twin_seen or twin, self._arm_seen or arm

    def publish_status_line(
        self, link: LinkReport | None, sync: SyncReport | None, execution: ExecutionReport | None, now: float
    ) -> None:
        """Send the status line when it has changed, or was not sent for a while.

        Args:
            link, sync, execution: None: silent.
            now: Monotonic [s].
        """
        if now - self._looked < LOOK:
            return
        self._looked = now
        lines = self._lines(link, sync, execution)
        self.messages.on_lines(lines)
        payload = dumped(lines, marks=SPACED)
        if payload == self._told and now - self._told_at < REPEAT:
            return
        self._told, self._told_at = payload, now
        self._publish(self._topics.screen, payload, 1, False)

    def _lines(self, link: LinkReport | None, sync: SyncReport | None, execution: ExecutionReport | None) -> list[Line]:
        words = _word(link), _word(sync), _word(execution)
        deployment = self._deployment
        heard = ReportsNow(
            *words,
            bare=link is not None and link.gateway_kind == "plc",
            plan=self.plan,
            obstacle="" if execution is None else self._obstacle,
            cause="" if sync is None else hold_cause(self._hold),
            engaged=execution is not None and bool(execution.engaged),
            work=self._work,
        )
        if deployment is not None:
            seen = Seen(*words, feedback=self._arm_seen, twin=self._twin_seen, scene=self._scene is not None)
            missing = first_missing(seen, deployment)
            heard = replace(heard, started=True, missing=missing, arm=deployment.arm != "none")
        return status_lines(heard)


def _path_of(message: Plan) -> bytes:
    """Return where the tool goes by a plan, as it is told while that is played; nothing where its planner has not said it."""
    times = [point.time_from_start.to_nsec() for point in message.trajectory.points]
    if not message.tool_path or len(message.tool_path) != len(times):
        return b""
    path = [(point.x, point.y, point.z) for point in message.tool_path]
    rests = [min(bisect_left(times, round(each.end * NANOSECONDS)), len(times) - 1) for each in message.segments]
    return PathView(message.id, [time / NANOSECONDS for time in times], path).to_json(PATH_POINTS, rests)


def _word(report: LinkReport | SyncReport | ExecutionReport | None) -> Word | None:
    return None if report is None else Word(report.text, report.reason, getattr(report, "gateway_state", ""))


def deployment_of(started: Mapping[str, object] | None, namespace: str) -> Deployment | None:
    """Return what bringup has told the node `startup`; None where that does not run.

    Args:
        started: The node's parameters.
    """
    fields = ("arm", "broker", "rsi", "gateway", "gateway_kind")
    if started is None or not set(fields) <= set(started):
        return None
    return Deployment(namespace=namespace, **{name: started[name] for name in fields})  # type: ignore[arg-type]


def _found(state: str) -> str:
    """Return how a rehearsal ended, in the words of a message."""
    return Sentence(f"line.person.found.{state}") if state in STATES else state
