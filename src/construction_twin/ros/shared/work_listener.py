"""What the work node has heard: of the executor, its plans and verdicts, the scene and the tool. Decides and writes nothing."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from construction_twin.core.motion_errors import SceneError
from construction_twin.core.reports import EngagementReport, ExecutionReport
from construction_twin.msg import Engagement, Execution, Plan, Review, ToolState
from construction_twin.msg import Scene as SceneMsg
from construction_twin.review.record import Fate, read_fate
from construction_twin.robot.segments import Segment
from construction_twin.robot.tool import Tool
from construction_twin.ros.messages.convert import change_from_msg
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.scene.objects import Scene
from construction_twin.scene.scene_change import SceneChange
from construction_twin.work.following import GripReading, grip_of

#: Verdicts that are remembered.
_KEPT = 100
#: Work plans and scenes that are remembered for an arm that is left engaged.
_KEPT_PLANS, _KEPT_SCENES = 4, 12


@dataclass(frozen=True, eq=False)
class KnownPlan:
    """A plan that was published.

    Attributes:
        segments: Of a work plan.
        changes: What each of them does to the scene.
    """

    message: Plan
    segments: tuple[Segment, ...]
    changes: tuple[SceneChange, ...]


class WorkListener:
    """Takes the messages of the topics, from rospy's threads; `start` of the node subscribes to them.

    Args:
        publishers: Takes ``execution``, ``plan`` or ``tool``; returns how many nodes that are heard publish it now.
        ends: Returns whether this process is to end: nothing is waited for then.
        review_file: The executor's record of verdicts.
        refuse: Counts a refused message; takes reason and sentence.

    Attributes:
        plan: The one that was published last.
        engagement: None: the executor has not said yet whether the arm is engaged.
    """

    def __init__(
        self,
        publishers: Callable[[str], int],
        ends: Callable[[], bool],
        review_file: Path,
        refuse: Callable[[str, str], None],
    ):
        self._publishers, self._ends = publishers, ends
        self._review_file = review_file
        self._refuse = refuse
        self._heard = threading.Condition()
        self._news: queue.SimpleQueue[None] = queue.SimpleQueue()
        self.execution: ExecutionReport | None = None
        self.plan: KnownPlan | None = None
        self.engagement: EngagementReport | None = None
        self.scene: Scene | None = None
        self.tool: ToolState | None = None
        #: The planner that published the plan is still there, and gives it to an executor that starts anew.
        self._plan_offered = False
        #: The last verdicts, by plan.
        self._verdicts: dict[str, Review] = {}
        #: Scenes by hash, and work plans by id, the newest last: of them an engaged arm's scene is made.
        self._scenes: dict[str, Scene] = {}
        self._work_plans: dict[str, KnownPlan] = {}

    # -- messages

    def on_execution(self, message: Execution) -> None:
        """Take what the executor does."""
        with self._news_comes():
            self.execution = from_msg(ExecutionReport, message)

    def on_plan(self, message: Plan) -> None:
        """Take a plan; one whose segments cannot be read is refused."""
        try:
            changes = tuple(map(change_from_msg, message.segments))
        except SceneError as error:
            self._refuse("plan", str(error))
            return
        segments = tuple(from_msg(Segment, segment) for segment in message.segments)
        plan = KnownPlan(message, segments, changes)
        with self._news_comes():
            self.plan, self._plan_offered = plan, True
            # a way back changes nothing, and may be planned again and again
            if any(segment.scene != segment.scene_after for segment in segments):
                _keep(self._work_plans, message.id, plan, _KEPT_PLANS)

    def on_engagement(self, message: Engagement) -> None:
        """Take whether, and where, the arm was left engaged."""
        with self._news_comes():
            self.engagement = from_msg(EngagementReport, message)

    def on_review(self, message: Review) -> None:
        """Take a verdict."""
        with self._news_comes():
            _keep(self._verdicts, message.plan_id, message, _KEPT)

    def on_tool(self, message: ToolState) -> None:
        """Take what the tool's outputs and inputs read."""
        with self._news_comes():
            self.tool = message

    def on_scene(self, message: SceneMsg) -> None:
        """Take the scene; one that cannot be read is refused."""
        try:
            scene = scene_from_msg(message)
        except SceneError as error:
            self._refuse("scene", str(error))
            return
        with self._news_comes():
            self.scene = scene
            _keep(self._scenes, scene.hash, scene, _KEPT_SCENES)

    @contextmanager
    def _news_comes(self) -> Iterator[None]:
        """Let what is heard be changed while nobody reads it, then wake whoever waits for it."""
        with self._heard:
            yield
            self._heard.notify_all()
        self.announce()

    # -- waiting

    def announce(self) -> None:
        """Let whoever waits for news know that there are some."""
        self._news.put(None)

    def wait_for_news(self, seconds: float) -> bool:
        """Return whether there was news within a time [s], one piece for each message and `announce`."""
        try:
            self._news.get(timeout=seconds)
        except queue.Empty:
            return False
        return True

    def wait_for(self, condition: Callable[[], object], seconds: float) -> bool:
        """Return whether a condition on what was heard holds, or the process is to end, within a time [s].

        The condition must wait for nobody: no message is taken while it is computed.
        """
        with self._heard:
            return bool(self._heard.wait_for(lambda: condition() or self._ends(), seconds))

    # -- the executor

    @property
    def executor_said(self) -> bool:
        """Whether the executor's state is known, or nobody is there to tell it."""
        return self.execution is not None or not self._publishers("execution")

    @property
    def playing(self) -> bool:
        """Whether a plan is under way, paused or held included."""
        return self.execution is not None and self.execution.playing

    @property
    def engaged(self) -> bool:
        """Whether the arm was left engaged, or may have been."""
        return (self.execution is not None and self.execution.engaged) or self.left is not None

    @property
    def left(self) -> EngagementReport | None:
        """Where the arm was left engaged; None: it was not, or that is not known yet."""
        return self.engagement if self.engagement is not None and self.engagement.engaged else None

    @property
    def unsaid(self) -> bool:
        """Whether the arm was left engaged and `engagement` does not say yet where: the disk takes that first."""
        return self.execution is not None and self.execution.engaged and self.left is None

    # -- plans and scenes

    def work_plan(self, plan_id: str) -> KnownPlan | None:
        """Return one of the last work plans that change the scene; None: it is not known, or not any more."""
        return self._work_plans.get(plan_id)

    def scenes(self) -> list[Scene]:
        """Return the scenes seen last, the newest first."""
        with self._heard:
            return list(reversed(self._scenes.values()))

    def review(self, plan_id: str) -> Review | None:
        """Return the verdict on a plan as the topic told it; None: it told none."""
        return self._verdicts.get(plan_id)

    def fate(self, plan_id: str, offer: str) -> Fate:
        """Return what became of a plan, from the topics, else from the executor's record.

        Args:
            plan_id: Empty: the plan is known by the offer alone.
            offer: Part of the plan's source; empty: its id must fit.
        """
        known = self.plan
        plan = known.message if known is not None else None
        if plan is not None and (plan.id == plan_id or (offer and offer in plan.source)):
            if plan.id not in self._verdicts and self._publishers("plan"):
                return Fate(plan.id, False, under_review=True)
            plan_id = plan.id
        return read_fate(self._review_file, plan_id, offer)

    def forget_if_nobody_has(self, plan_id: str) -> bool:
        """Return whether a plan under review went with planner and executor, so that nobody can approve it any more.

        It counts as published no longer then.
        """
        if not self._publishers("plan"):
            self._plan_offered = False
        # an executor that is still there has the plan, whatever became of the planner
        gone = not self._plan_offered and not self._publishers("execution")
        if not (gone and self.plan is not None and self.plan.message.id == plan_id):
            return False
        self.plan = None
        return True

    # -- the tool

    @property
    def tool_said(self) -> bool:
        """Whether the tool's state is known, or nobody is there to tell it."""
        return self.tool is not None or not self._publishers("tool")

    def grip(self, tool: Tool) -> GripReading:
        """Return what a tool says of its grip."""
        said = self.tool
        if said is None or not said.known or not self._publishers("tool"):
            return GripReading(False, False)
        return grip_of(tool, dict(zip(said.outputs, said.output_values)), dict(zip(said.inputs, said.input_values)))


def _keep(kept: dict[str, Any], key: str, value: object, most: int) -> None:
    """Remember a value as the newest, and forget the oldest above a number."""
    kept.pop(key, None)
    kept[key] = value
    while len(kept) > most:
        kept.pop(next(iter(kept)))
