"""The newest messages of executor, planner, reviewers, scene and tool."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from construction_twin.core.reports import EngagementReport, ExecutionReport, ToolReport
from construction_twin.review.record import PlanRecord, read_plan_record
from construction_twin.robot.plan import Plan
from construction_twin.robot.tool import Tool
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_change import SceneChange

#: Verdicts, and work plans for an arm that is left engaged, that are remembered.
_MOST_VERDICTS, _MOST_PLANS = 100, 4


@dataclass(frozen=True, eq=False)
class KnownPlan:
    """A published plan, and what each of its segments does to the scene."""

    plan: Plan
    changes: tuple[SceneChange, ...]


@dataclass(frozen=True)
class Verdict:
    """A verdict on a plan."""

    plan_id: str
    approved: bool
    reviewer: str
    reason: str


@dataclass(frozen=True)
class GripReading:
    """The tool's grip; `closed`: outputs command it to hold (`commanded`), or an input confirms that it does."""

    known: bool
    closed: bool
    commanded: tuple[str, ...] = ()

    @property
    def is_surely_open(self) -> bool:
        """Whether it is known to be open."""
        return self.known and not self.closed


class Received:
    """The newest message of each kind (None: unknown), for any thread.

    `publishers`: number of nodes that publish a topic. `ends`: whether this process ends. `review_file`: the executor's.
    """

    def __init__(self, publishers: Callable[[str], int], ends: Callable[[], bool], review_file: Path):
        self._publishers, self._ends = publishers, ends
        self._review_file = review_file
        self._changed = threading.Condition()
        self._news = threading.Event()
        self.execution: ExecutionReport | None = None
        self.plan: KnownPlan | None = None
        self.engagement: EngagementReport | None = None
        self.scene: Scene | None = None
        self.tool: ToolReport | None = None
        #: The planner that published the plan is still there, and gives it to an executor that starts anew.
        self._plan_offered = False
        self._verdicts: deque[Verdict] = deque(maxlen=_MOST_VERDICTS)
        self._work_plans: list[KnownPlan] = []

    def on_message(
        self, message: ExecutionReport | EngagementReport | ToolReport | KnownPlan | Verdict | Scene
    ) -> None:
        """Store a message, and wake the threads that wait for it."""
        with self._changed:
            match message:
                case ExecutionReport():
                    self.execution = message
                case EngagementReport():
                    self.engagement = message
                case ToolReport():
                    self.tool = message
                case Verdict():
                    self._verdicts.appendleft(message)
                case Scene():
                    self.scene = message
                case KnownPlan():
                    self.plan, self._plan_offered = message, True
                    # a way back changes nothing, and may be planned again and again
                    if any(segment.scene != segment.scene_after for segment in message.plan.segments):
                        others = (one for one in self._work_plans if one.plan.id != message.plan.id)
                        self._work_plans = [message, *others][:_MOST_PLANS]
            self._changed.notify_all()
        self.notify()

    def notify(self) -> None:
        """Wake the thread that waits for news."""
        self._news.set()

    def wait_for_news(self, seconds: float) -> bool:
        """Return whether there was news within a time [s]."""
        if not self._news.wait(seconds):
            return False
        self._news.clear()
        return True

    def wait_for(self, condition: Callable[[], object], seconds: float) -> bool:
        """Return whether a condition on what was received holds, or the process ends, within a time [s]."""
        with self._changed:
            return bool(self._changed.wait_for(lambda: condition() or self._ends(), seconds))

    @property
    def is_executor_settled(self) -> bool:
        """Whether the executor's state is known, or it has no publisher."""
        return self.execution is not None or not self._publishers("execution")

    @property
    def playing(self) -> bool:
        """Whether a plan is under way, paused or held included."""
        return self.execution is not None and self.execution.playing

    @property
    def engaged(self) -> bool:
        """Whether the arm was left engaged, or may have been."""
        return (self.execution is not None and self.execution.engaged) or self.left_engaged is not None

    @property
    def left_engaged(self) -> EngagementReport | None:
        """Where the arm was left engaged; None: nowhere, or unknown."""
        return self.engagement if self.engagement is not None and self.engagement.engaged else None

    @property
    def is_engagement_unknown(self) -> bool:
        """Whether the arm was left engaged at an unknown place, until its record is on the disk."""
        return self.execution is not None and self.execution.engaged and self.left_engaged is None

    def work_plan(self, plan_id: str) -> KnownPlan | None:
        """Return one of the last work plans that change the scene; None: unknown."""
        return next((one for one in self._work_plans if one.plan.id == plan_id), None)

    def verdict(self, plan_id: str) -> Verdict | None:
        """Return the verdict on a plan; None: none was received."""
        return next((one for one in self._verdicts if one.plan_id == plan_id), None)

    def fate(self, plan_id: str, offer: str) -> PlanRecord:
        """Return what became of a plan, or without known id of an offer, by the topics, else by the executor's record."""
        plan = self.plan.plan if self.plan is not None else None
        if plan is not None and (plan.id == plan_id or (offer and offer in plan.source)):
            if self.verdict(plan.id) is None and self._publishers("plan"):
                return PlanRecord(plan.id, False, under_review=True)
            plan_id = plan.id
        return read_plan_record(self._review_file, plan_id, offer)

    def forget_orphaned_plan(self, plan_id: str) -> bool:
        """Forget a plan under review whose planner and executor have gone; return whether it was one."""
        if not self._publishers("plan"):
            self._plan_offered = False
        # an executor that is still there has the plan, whatever became of the planner
        gone = not self._plan_offered and not self._publishers("execution")
        if not (gone and self.plan is not None and self.plan.plan.id == plan_id):
            return False
        self.plan = None
        return True

    @property
    def is_tool_settled(self) -> bool:
        """Whether the tool's state is known, or it has no publisher."""
        return self.tool is not None or not self._publishers("tool")

    def grip(self, tool: Tool) -> GripReading:
        """Return what a tool says of its grip."""
        report = self.tool
        if report is None or not report.known or not self._publishers("tool"):
            return GripReading(False, False)
        commanded = tuple(name for name, value in tool.grip.set.items() if report.outputs.get(name) == value)
        holds = any(report.inputs.get(name) == value for name, value in tool.grip.confirm.items())
        return GripReading(True, bool(commanded) or holds, commanded)
