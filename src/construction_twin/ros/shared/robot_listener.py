"""Listens to one robot's reports and makes a `Snapshot` of them; used by command line, watch, marker and start-up."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import genpy
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.motion_errors import SceneError
from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SyncReport
from construction_twin.msg import Execution, Hold, Link, Plan, PlanCaller, Review, Sync
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan as PlanValue
from construction_twin.ros.messages.convert import change_from_msg, plan_from_msg
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.shared.refusal_log import warn_of_refusals
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.scene.scene_change import SceneChange
from construction_twin.views.snapshot import NodeFacts, Snapshot

_Report = TypeVar("_Report", LinkReport, SyncReport, HoldReport, ExecutionReport)

#: Streams whose rates are counted, with short names.
STREAMS = {"twin": "twin/joint_states", "physical": "physical/joint_states", "command": "command/joint_states"}
#: Age from which a report counts as silent [s], and a node that publishes on /diagnostics. `execution` is published on change only.
SILENT = {"link": 3.0, "sync": 1.0}
SILENT_NODE = 5.0
_REPORTS = {
    "link": Link,
    "sync": Sync,
    "hold": Hold,
    "execution": Execution,
    "approval_obstacle": String,
    "plan": Plan,
    "plan_caller": PlanCaller,
    "review": Review,
}
#: What it listens to.
REPORTS = tuple(_REPORTS)


class RobotListener:
    """Keeps the newest message of each report, from the node that publishes it.

    Args:
        namespace: Of the robot, absolute: ``/kr120``.
        rates: Also count the 250 Hz streams, without unpacking them, and listen to `/diagnostics`.
        refuse: Called as ``refuse(reason, sentence)`` for a report from another node than the one that publishes it; by default a
            warning.

    Attributes:
        refused: Why the last plan that was received could not be read; empty when it could.
    """

    def __init__(
        self,
        namespace: str,
        robot: RobotModel,
        rates: bool = False,
        refuse: Callable[[str, str], None] | None = None,
    ):
        self._refuse = refuse or warn_of_refusals()
        self._namespace = namespace.rstrip("/")
        self._robot = robot
        self._news = threading.Condition()
        self._newest: dict[str, object] = {}
        self._plan: PlanValue | None = None
        self.refused = ""
        self._counts: Counter[str] = Counter()
        self._counted: tuple[float, Counter[str]] = (time.monotonic(), Counter())
        self._nodes: dict[str, _NodeReport] = {}
        self._heard: dict[str, float] = {}
        self._reports = {name: self._subscribe(name, kind) for name, kind in _REPORTS.items()}
        self._streams = [self._count(name, topic) for name, topic in STREAMS.items()] if rates else []
        if rates:
            self._diagnostics = rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics)

    def wait(self, condition: Callable[[], object], timeout: float | None) -> bool:
        """Wait until `condition`, asked after every report, holds; return whether it does. None waits without end."""
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._news:
            while not condition():
                left = 0.5 if deadline is None else min(0.5, deadline - time.monotonic())
                if left <= 0.0 or rospy.is_shutdown():
                    return False
                # in slices, because Ctrl-C does not interrupt a wait without a timeout
                self._news.wait(left)
        return True

    def newest(self, name: str):
        """Return the newest message of a report, one of `_REPORTS`; None before the first."""
        return self._newest.get(name)

    def publishers(self, name: str) -> int:
        """Return how many nodes publish a report now."""
        return self._reports[name].get_num_connections()

    def plan(self, plan_id: str) -> PlanValue | None:
        """Return the newest plan if it is the one with this id."""
        plan = self._plan
        return plan if plan is not None and plan.id == plan_id else None

    def under_review(self) -> PlanValue | None:
        """Return the plan that waits for a verdict according to the topics; the executor's own state decides."""
        plan = self._plan
        decided = {getattr(self._newest.get(name), "plan_id", None) for name in ("review", "execution")}
        return None if plan is None or plan.id in decided else plan

    def changes(self, plan_id: str) -> tuple[SceneChange, ...]:
        """Return what the segments of the newest plan do to the scene; nothing if it is another one or they cannot be read."""
        newest = self.newest("plan")
        if newest is None or newest.id != plan_id:
            return ()
        try:
            return tuple(map(change_from_msg, newest.segments))
        except SceneError as error:
            rospy.logwarn("the objects of plan %s cannot be shown: %s", plan_id, error)
            return ()

    def snapshot(self) -> Snapshot:
        """Return what is known now; rates are those since the last call."""
        with self._news:
            newest = dict(self._newest)
            plan = self.under_review()
            now = time.monotonic()
            nodes = tuple(_node_now(self._nodes[name], now) for name in sorted(self._nodes))
            ages = {name: now - self._heard.get(name, now) for name in SILENT}
            silent = {name: age for name, age in ages.items() if age > SILENT[name]}
        if "execution" in newest and not self.publishers("execution"):
            silent["execution"] = now - self._heard["execution"]
        return Snapshot(
            robot=self._namespace.strip("/"),
            now=rospy.get_time(),
            joints=self._robot.joint_names,
            linear=self._robot.linear,
            link=_record(LinkReport, newest.get("link")),
            sync=_record(SyncReport, newest.get("sync")),
            execution=_record(ExecutionReport, newest.get("execution")),
            hold=_record(HoldReport, newest.get("hold")) if "sync" not in silent else None,
            plan=plan,
            approval_obstacle=getattr(newest.get("approval_obstacle"), "data", ""),
            rates=self._rates(),
            nodes=nodes,
            silent=silent,
        )

    def _subscribe(self, name: str, kind: type) -> Subscriber:
        return Subscriber(f"{self._namespace}/{name}", kind, partial(self._receive, name), self._refuse, queue_size=20)

    def _receive(self, name: str, message) -> None:
        plan, refused = None, ""
        if name == "plan":
            try:
                plan = plan_from_msg(message)
            except ConstructionTwinError as error:
                refused = str(error)
        with self._news:
            self._newest[name], self._heard[name] = message, time.monotonic()
            if name == "plan":
                self._plan, self.refused = plan, refused
            self._news.notify_all()

    def _count(self, name: str, topic: str) -> rospy.Subscriber:
        def receive(_message) -> None:
            self._counts[name] += 1

        return rospy.Subscriber(f"{self._namespace}/{topic}", rospy.AnyMsg, receive, queue_size=250, tcp_nodelay=True)

    def _rates(self) -> dict[str, float]:
        if not self._streams:
            return {}
        now, counts = time.monotonic(), Counter(self._counts)
        since, before = self._counted
        self._counted = now, counts
        return {name: (counts[name] - before[name]) / max(now - since, 1e-3) for name in STREAMS}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = "/" + status.name.split(":")[0].strip().lstrip("/")
            if node.startswith(self._namespace + "/"):
                name = node.removeprefix(self._namespace + "/")
                with self._news:
                    self._nodes[name] = _NodeReport(time.monotonic(), NodeFacts(name, status.level, status.message))
                    self._news.notify_all()


@dataclass(frozen=True)
class _NodeReport:
    """What a node said of itself last, and when, on the monotonic clock [s]."""

    at: float
    facts: NodeFacts


def _node_now(heard: _NodeReport, now: float) -> NodeFacts:
    facts, age = heard.facts, now - heard.at
    return (
        facts
        if age <= SILENT_NODE
        else NodeFacts(facts.name, 3, f"silent for {age:.0f} s; the last was: {facts.sentence}")
    )


def _record(kind: type[_Report], message: genpy.Message | None) -> _Report | None:
    return None if message is None else from_msg(kind, message)
