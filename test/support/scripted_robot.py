"""A robot without ROS for tests of the console: a client that says what console_node and the gateway say.

It knows one plan at a time, plays it when it was approved, and answers verdicts, stops, pauses and requests of plans as they do.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from plan_samples import make_report
from processes import ROOT

from construction_twin.core.errors import ExpiredError, PayloadError
from construction_twin.core.freshness import Moment, parse_moment, present_moment, staleness
from construction_twin.core.records import SPACED, to_json
from construction_twin.core.reports import ExecutionReport, LinkReport, SyncReport
from construction_twin.core.speed_limit import SpeedLimit
from construction_twin.extensions.console.remote_review import (
    ClearanceView,
    PathView,
    PlanView,
    UseView,
)
from construction_twin.extensions.console.remote_view import (
    FreshReport,
    PoseView,
    ViewInputs,
    ViewWriter,
)
from construction_twin.kinematics.chain import Chain
from construction_twin.link.requests import (
    ButtonPress,
    Joints,
    LowerSpeed,
    Override,
    RaiseSpeed,
    StampedButtonPress,
    VerdictMessage,
    read,
    read_document,
    read_goal,
)
from construction_twin.link.speed_limits import NOBODY, SpeedLimits
from construction_twin.mqtt import requests
from construction_twin.mqtt.client import Broker, make_client, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import EXECUTOR, GATEWAY, RequestKind
from construction_twin.review.rehearsal_report import RehearsalReport
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.trajectory import Trajectory, whole_nanoseconds

XACRO, CONFIG = ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml"
#: Period of `view` [s], and of `screen` where nothing changes.
VIEW, SCREEN = 0.04, 1.0
#: What an arm that hangs behind by nothing reports [rad].
_THRESHOLD = 0.02


def kr120() -> RobotModel:
    """Return the robot of the tests."""
    return read_robot_files(XACRO, CONFIG)


def read_message(model, kind: RequestKind, payload: bytes, retained: bool):
    """Read a request whole, as an endpoint does in two steps."""
    return read(model, read_document(payload, retained, kind.name, kind.limit), kind.name)


def joints_of(robot: RobotModel) -> Joints:
    """Return its joints, as messages name them."""
    return Joints(tuple(robot.joint_names), robot.linear)


def bent_motion(
    start: np.ndarray, goal: np.ndarray, names: Sequence[str], duration: float, rows: int = 25
) -> Trajectory:
    """Return a motion of minimum jerk from rest to rest whose joints do not all go straight: its path has a shape of its own."""
    times = whole_nanoseconds(np.linspace(0.0, duration, rows))
    x = times / times[-1]
    s, ds, dds = (
        10 * x**3 - 15 * x**4 + 6 * x**5,
        (30 * x**2 - 60 * x**3 + 30 * x**4) / duration,
        (60 * x - 180 * x**2 + 120 * x**3) / duration**2,
    )
    way = goal - start
    bend = np.zeros_like(way)
    bend[2] = 0.15
    wave, slope, bow = np.sin(math.pi * s), math.pi * np.cos(math.pi * s), -(math.pi**2) * np.sin(math.pi * s)
    return Trajectory(
        tuple(names),
        times,
        start + np.outer(s, way) + np.outer(wave, bend),
        np.outer(ds, way) + np.outer(slope * ds, bend),
        np.outer(dds, way) + np.outer(bow * ds**2 + slope * dds, bend),
    )


class ScriptedRobot:
    """One robot on the broker.

    Args:
        broker: With the account of the robot's bridge.
        name: In the topics.
        period: Of `view` [s]; 0: only when `publish_view` is called.
    """

    def __init__(self, broker: Broker, name: str, prefix: str = "twin", period: float = VIEW):
        self.robot = kr120()
        self.name = name
        self.heard: list[tuple[str, bytes]] = []
        self.verdicts: list[tuple[str, str, str]] = []
        self.twin = np.array(self.robot.home, dtype=float)
        self.arm_error = np.zeros(len(self.twin))
        #: Where the servos should have the arm, from the twin; None: nobody knows them.
        self.expected_error: np.ndarray | None = None
        #: When the arm was where it is [s since 1970]; 0: now.
        self.arm_stamp = 0.0
        self.plan: PlanView | None = None
        self.trajectory: Trajectory | None = None
        self.state = "IDLE"
        #: What the bridge says.
        self.link = LinkReport("ARMED", "", "ARMED", {"late_replies": "0"}, gateway_kind="rsi")
        #: Why the plan under review could not be approved; an approval in spite of its rehearsal takes no notice of it.
        self.obstacle = ""
        #: How much older than it is what comes shall count [s]: as if it had lain on its way.
        self.delay = 0.0
        self.speed_limits = SpeedLimits(SpeedLimit(0.5), NOBODY, present_moment())
        self._chain = Chain(self.robot)
        self._names = tuple(self.robot.joint_names)
        self._joints = joints_of(self.robot)
        self._topics = Topics(prefix, name)
        self._root = self._topics.view.removesuffix("view")
        self._lock = threading.RLock()
        self._period = period
        self._ended = threading.Event()
        self._ready = threading.Event()
        self._elapsed, self._rate, self._tick = 0.0, 1.0, 0.0
        self._outcome, self._playing = "", ""
        self._path = b""
        self._numbers = 0
        self._listened: dict[str, Callable[[bytes], None]] = {}
        self._writer = ViewWriter(name, unique_id(name, "run"), self._joints)
        self._broker = broker
        self._client = make_client(broker, unique_id(name, "scripted"), self._topics.view, will=self._writer.offline())
        self._client.on_connect = self._on_connect
        self._client.on_subscribe = lambda *_: self._ready.set()
        self._client.on_message = self._on_message
        self._thread = threading.Thread(target=self._talk, daemon=True)

    # -- life

    def start(self) -> ScriptedRobot:
        self._client.connect(self._broker.host, self._broker.port, self._broker.keepalive)
        self._client.loop_start()
        assert self._ready.wait(30.0), f"{self.name}: no answer to the subscription"
        self._thread.start()
        return self

    def stop(self) -> None:
        self._ended.set()
        self._thread.join(5.0)
        self._client.disconnect()
        self._client.loop_stop()

    def __enter__(self) -> ScriptedRobot:
        return self.start()

    def __exit__(self, *_) -> None:
        self.stop()

    # -- what it says

    def show_plan(self, goal: Sequence[float] | None = None, duration: float = 2.0, source: str = "a test") -> PlanView:
        """Put a plan under review, and return it."""
        with self._lock:
            if goal is None:
                goal = self.twin + np.array([0.6, 0.2, -0.3, 0.0, 0.3, 0.0])
            self._numbers += 1
            self.trajectory = bent_motion(self.twin.copy(), np.asarray(goal, dtype=float), self._names, duration)
            self.plan = self._view_of(self.trajectory, f"{self.name}-{self._numbers}", source)
            self._publish(self._topics.plan, self.plan.to_json(200), retain=True)
            self.publish_view()
            return self.plan

    def take_plan_away(self) -> None:
        """No plan is under review any more."""
        with self._lock:
            self.plan, self.obstacle = None, ""
            self._publish(self._topics.plan, b"", retain=True)
            self._publish(self._topics.rehearsal, b"", retain=True)
            self.publish_view()

    def show_rehearsal(self, report: RehearsalReport, obstacle: str = "") -> None:
        """Say what a rehearsal of the plan under review has found, and why that is against approving it."""
        with self._lock:
            assert self.plan is not None
            report = replace(report, plan_id=self.plan.id, plan_hash=self.plan.hash)
            self.obstacle = obstacle
            self._publish(self._topics.rehearsal, to_json(report, separators=SPACED), retain=True)
            self.publish_view()

    def _play(self, plan: PlanView) -> None:
        assert plan.trajectory is not None
        self._show_path(PathView(plan.id, plan.trajectory["times"], plan.tool_path).to_json(200))
        self.state, self._outcome, self._playing, self._elapsed, self._rate = "PLAYING", "", plan.id, 0.0, 1.0

    def publish_view(self) -> None:
        """Publish a view of now."""
        with self._lock:
            now = time.time_ns()
            stamp = now / 1e9
            plan = self.trajectory
            progress = 0.0 if plan is None or not self._playing else min(1.0, self._elapsed / plan.duration)
            seen = ViewInputs(
                twin=PoseView(stamp, 0.0, tuple(self.twin)),
                arm=PoseView(self.arm_stamp or stamp, 0.0, tuple(self.twin + self.arm_error)),
                expected=None
                if self.expected_error is None
                else PoseView(stamp, 0.0, tuple(self.twin + self.expected_error)),
                sync=self._sync(),
                link=FreshReport(self.link, 0.0),
                execution=FreshReport(
                    ExecutionReport(
                        self.state,
                        "",
                        self._playing,
                        self._outcome,
                        duration=plan.duration if plan else 0.0,
                        rate=self._rate,
                        approval_obstacle=self.obstacle,
                        # here only a rehearsal is ever against a plan
                        overridable=bool(self.obstacle),
                    ),
                    0.0,
                ),
                plan="" if self.plan is None else self.plan.id,
                progress=progress,
                speed=self.speed_limits.state_report(time.monotonic_ns()),
            )
            payload = self._writer.write(now, seen, present_moment())
        self._client.publish(self._topics.view, payload)

    def tool(self, positions: Sequence[float]) -> tuple[float, ...]:
        """Return where the tool is [m], computed without the page."""
        return tuple(self._chain.forward(np.asarray(positions, dtype=float)).position)

    def publish(self, below: str, payload: bytes, retain: bool = False) -> None:
        """Publish anything on a topic of this robot."""
        self._publish(self._root + below, payload, retain)

    def payloads(self, below: str) -> list[dict]:
        """Return what was heard on a topic that begins so."""
        return [json.loads(payload) for topic, payload in list(self.heard) if topic.startswith(below)]

    def listen(self, below: str, function: Callable[[bytes], None]) -> None:
        """Before `start`: call a function with each payload of a topic of this robot, in the client's thread."""
        self._listened[self._root + below] = function

    def _publish(self, topic: str, payload: bytes, retain: bool = False) -> None:
        self._client.publish(topic, payload, qos=1, retain=retain)

    def _sync(self) -> FreshReport[SyncReport]:
        error = np.abs(self.arm_error)
        agreed = bool(np.all(error < _THRESHOLD))
        state, reason = ("IN_SYNC", "") if agreed else ("HOLDING", "the arm does not follow")
        threshold = (_THRESHOLD,) * len(error)
        report = SyncReport(state, reason, "stop", "", tuple(error), threshold, 0.0082, 0.02, agreed=agreed)
        return FreshReport(report, 0.0)

    def _screen(self) -> bytes:
        moving = self.state == "PLAYING"
        sentence = "The arm moves along the approved plan" if moving else "The arm holds its pose; no plan is executed"
        waits = "" if self.plan is None else "a verdict on the plan"
        line = {
            "topic": "execution", "state": self.state, "sentence": sentence, "waits_for": waits,
            "who": "reviewer" if waits else "", "todo": "look at the plan, then approve or reject it" if waits else "",
            "page": "reference/states.md#execution", "level": 2 if waits else 0,
        }  # fmt: skip
        return json.dumps([line]).encode()

    def _view_of(self, trajectory: Trajectory, plan_id: str, source: str) -> PlanView:
        report = make_report(len(self._names))
        use = report.usage
        return PlanView(
            id=plan_id, hash=trajectory.content_hash(), source=source, planner="none", scene="0" * 64, frame="base_link",
            created_ns=time.time_ns(), duration=trajectory.duration, planning_time=0.1, joints=self._names,
            start=tuple(trajectory.positions[0]), goal=tuple(trajectory.positions[-1]),
            waypoints=len(trajectory.positions), tool_path=[self.tool(row) for row in trajectory.positions],
            clearance=ClearanceView(0.213, 1.0, ["link_4", "table"], (1.0, 0.2, 0.9)),
            use=UseView(use.velocity, use.acceleration, use.jerk),
            trajectory={
                "times": trajectory.times.tolist(), "positions": trajectory.positions.tolist(),
                "velocities": trajectory.velocities.tolist(), "accelerations": trajectory.accelerations.tolist(),
            },
        )  # fmt: skip

    # -- what it does

    def _talk(self) -> None:
        self._tick = time.monotonic()
        said = 0.0
        while not self._ended.wait(self._period or VIEW):
            with self._lock:
                self._advance()
            if self._period:
                self.publish_view()
            if time.monotonic() - said >= SCREEN:
                said = time.monotonic()
                self._publish(self._topics.screen, self._screen())

    def _advance(self) -> None:
        now = time.monotonic()
        passed, self._tick = now - self._tick, now
        if self.state != "PLAYING":
            return
        assert self.trajectory is not None
        # a process that stood still has not moved the arm
        self._elapsed += min(passed, 0.2) * self._rate
        self.twin = self.trajectory.sample(self._elapsed)[0]
        if self._elapsed >= self.trajectory.duration:
            self._end("finished")

    def _end(self, outcome: str) -> None:
        self.state, self._outcome = "IDLE", outcome
        self._show_path(b"")

    def _show_path(self, payload: bytes) -> None:
        self._path = payload
        self._publish(self._topics.path, payload, retain=True)

    # -- what it hears

    def _on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        assert not reason_code.is_failure, str(reason_code)
        topics = self._topics
        kinds = (requests.NAMELESS_REVIEW, requests.REVIEW, requests.STOP, requests.PAUSE, requests.RESUME)
        asked = [topics.of(kind) for kind in kinds]
        asked += [
            self._root + "override_rehearsal/+",
            self._root + "plan_request/+",
            self._root + "lower_speed/+",
            self._root + "raise_speed/+",
        ]
        client.subscribe([(topic, 1) for topic in asked] + [(topic, 0) for topic in self._listened])
        with self._lock:
            self._publish(topics.plan, b"" if self.plan is None else self.plan.to_json(200), retain=True)
            self._publish(topics.path, self._path, retain=True)

    def _on_message(self, client, userdata, message) -> None:
        if message.topic in self._listened:
            self._listened[message.topic](bytes(message.payload))
            return
        below = message.topic.removeprefix(self._root)
        payload = bytes(message.payload)
        verb, _, account = below.partition("/")
        if account == "ack":
            # its own answers
            return
        self.heard.append((below, payload))
        answer: dict[str, Callable[[str, bytes, bool], None]] = {
            "review": self._on_review, "override_rehearsal": self._on_override,
            "plan_request": self._on_plan_request,
            "lower_speed": partial(self._on_speed, requests.LOWER_SPEED),
            "raise_speed": partial(self._on_speed, requests.RAISE_SPEED),
        }  # fmt: skip
        with self._lock:
            if verb in ("stop", "pause", "resume"):
                self._on_intervention(verb, account, payload, message.retain)
            else:
                answer[verb](account, payload, message.retain)

    def _answer(self, kind: RequestKind, account: str, ok: bool, reason: str = "", /, **known: object) -> None:
        payload = kind.payload(account=account, ok=ok, reason=reason, **known)
        self._publish(self._topics.ack_of(kind), payload)

    def _on_review(self, account: str, payload: bytes, retained: bool) -> None:
        self._on_verdict(requests.REVIEW, VerdictMessage, account, payload, retained)

    def _on_override(self, account: str, payload: bytes, retained: bool) -> None:
        self._on_verdict(requests.OVERRIDE, Override, account, payload, retained)

    def _on_verdict(
        self, kind: RequestKind, model: type[VerdictMessage], account: str, payload: bytes, retained: bool
    ) -> None:
        try:
            review = read_message(model, kind, payload, retained).review_by(account)
        except PayloadError as error:
            self._answer(kind, account, False, str(error), reviewer=account)
            return
        known = {name: getattr(review, name) for name in ("plan_id", "plan_hash", "verdict", "reviewer")}
        plan = self.plan
        if plan is None or (plan.id, plan.hash) != (review.plan_id, review.plan_hash):
            sentence = f"plan {review.plan_id} with this hash is not under review"
            self._answer(kind, account, False, sentence, **known)
            return
        if review.approve and (problem := self._too_old(review.moment)):
            self._answer(kind, account, False, f"the approval is {problem}", expired=True, **known)
            return
        if review.approve and self.obstacle and not review.override_rehearsal:
            self._answer(kind, account, False, self.obstacle, **known)
            return
        self.verdicts.append((review.reviewer, review.verdict, review.plan_id))
        self.plan, self.obstacle = None, ""
        self._answer(kind, account, True, f"{review.verdict} by {review.reviewer}", **known)
        self._publish(self._topics.plan, b"", retain=True)
        if review.approve:
            self._play(plan)

    def _on_intervention(self, verb: str, account: str, payload: bytes, retained: bool) -> None:
        kind = requests.STOP if verb == "stop" else requests.PAUSE
        by = (GATEWAY, EXECUTOR) if verb == "stop" else (EXECUTOR,)
        try:
            document = read_document(payload, retained, verb, kind.limit)
            asked = read(StampedButtonPress if verb == "resume" else ButtonPress, document, verb)
        except PayloadError as error:
            for each in by:
                self._answer(kind, account, False, str(error), by=each)
            return
        if verb == "resume" and (problem := self._too_old(asked.moment)):
            self._answer(kind, account, False, f"the resume is {problem}", id=asked.id, expired=True)
            return
        moves = {"stop": ("IDLE", "stopped"), "pause": ("PAUSED", ""), "resume": ("PLAYING", "")}
        ok = self.state in ("PLAYING", "PAUSED") or verb == "stop"
        if self.state in ("PLAYING", "PAUSED"):
            self.state, self._outcome = moves[verb]
            if verb == "stop":
                self._end("stopped")
        for each in by:
            self._answer(kind, account, ok, "" if ok else "nothing is played", id=asked.id, by=each)

    def _on_plan_request(self, account: str, payload: bytes, retained: bool) -> None:
        try:
            kind = requests.PLAN_REQUEST
            asked = read_goal(read_document(payload, retained, kind.name, kind.limit), self._joints)
        except PayloadError as error:
            self._answer(requests.PLAN_REQUEST, account, False, str(error))
            return
        known = {"id": asked.id, "kind": asked.kind}
        if problem := self._too_old(str(asked.moment)):
            self._answer(requests.PLAN_REQUEST, account, False, f"the request is {problem}", expired=True, **known)
        elif asked.kind == "joints":
            plan = self.show_plan(asked.joints)
            known |= {"plan_id": plan.id, "plan_hash": plan.hash, "duration": plan.duration}
            self._answer(requests.PLAN_REQUEST, account, True, "planned", **known)
        else:
            reason = f"this robot of a test plans no {asked.kind}"
            self._answer(requests.PLAN_REQUEST, account, False, reason, **known)

    def _on_speed(self, kind: RequestKind, account: str, payload: bytes, retained: bool) -> None:
        id_, now = "", present_moment()
        try:
            asked = read_message(RaiseSpeed if kind.starts else LowerSpeed, kind, payload, retained)
            id_, now = asked.id, Moment(now.origin, now.at + round(self.delay * 1e9))
            reason, ok = self.speed_limits.set(asked.limit, account, asked.moment, now, time.time_ns()), True
        except (PayloadError, ExpiredError) as error:
            reason, ok = str(error), False
        known = {"id": id_, "limit": self.speed_limits.people.limit, "expired": bool(self.delay) and not ok}
        self._answer(kind, account, ok, reason, **known)

    def _too_old(self, moment: str) -> str:
        """Return why what repeats a moment is void, as if it had lain on its way for `delay`."""
        now = present_moment()
        return staleness(parse_moment(moment), Moment(now.origin, now.at + round(self.delay * 1e9)))
