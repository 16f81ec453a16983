"""One execution of a work plan: which segment it is in, what the next boundary waits for, and what is expected of tool and scene.

Pure. Stamps in ns, `now` in ns on the monotonic clock, times in s.
"""

from __future__ import annotations

from dataclasses import replace

from construction_twin.core.reports import ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.boundary import Boundary, BoundaryEvent, ToolOrder
from construction_twin.execution.engagement import Engagement, EngagementKeeper, Holding, engagement_of, holding_of
from construction_twin.execution.states import ExecutorEvent
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Segment

#: Why there is none without a physical arm.
NO_ARM = Sentence("there is no physical arm (`arm:=none`), so nothing switches or reads a tool")


def awaited(report: ToolReport, plan: Plan) -> str:
    """Return what passes by itself and is against a work plan, as a clause: its tool is not known yet. "" when nothing is."""
    return report.unknown() if needs_tool(plan) and report.reason != NO_ARM else ""


def lacks(report: ToolReport, plan: Plan) -> str:
    """Return what a work plan needs of the tool and is not there, as a clause; "" when nothing is missing."""
    if not needs_tool(plan):
        return ""
    if problem := awaited(report, plan) or report.unknown():
        return problem
    if not report.tool:
        return Sentence("the gateway's configuration names no tool")
    for segment in plan.segments:
        for switch in segment.switches:
            if switch.output not in report.outputs:
                named = {"tool": repr(report.tool), "signal": repr(switch.output)}
                return Sentence("the tool {tool} has no output {signal}", **named)
        confirmed = [signal for switch in segment.switches for signal in switch.confirm]
        for signal in (*segment.requires, *confirmed):
            if signal.name not in report.inputs:
                named = {"tool": repr(report.tool), "signal": repr(signal.name)}
                return Sentence("the tool {tool} has no input {signal}", **named)
    return ""


def needs_tool(plan: Plan) -> bool:
    """Return whether a plan switches the tool or requires something of its inputs."""
    return any(segment.switches or segment.requires for segment in plan.segments)


#: An engaged segment must be on the disk within this time [ns].
RECORD_TIMEOUT = 10 * NANOSECONDS


class SegmentRun:
    """The segments of one plan, in order, each entered only in its scene, with what it requires of the tool.

    Args:
        way_back: Whether it leads out of an engagement: then it begins none, and ends that one when it is finished.

    Attributes:
        number: Of the segment that it is in, or at the end of; -1 before the first is entered.
        at_boundary: Whether it stands at the end of that segment.
    """

    def __init__(self, plan: Plan, keeper: EngagementKeeper, way_back: bool = False):
        self.plan = plan
        self.number = -1
        self.at_boundary = True
        self.way_back = way_back
        self._keeper = keeper
        self._engagement: Engagement | None = None
        self._coming: Engagement | None = None
        self._recording_since: int | None = None
        self._boundary = Boundary(plan.id, -1, None, plan.scene)
        self._orders: list[ToolOrder] = []

    @property
    def segment(self) -> Segment | None:
        """The segment that it is in; None before the first."""
        return self.plan.segments[self.number] if self.number >= 0 else None

    @property
    def wants_scene(self) -> bool:
        """Whether it stands and waits for the scene that was planned for."""
        return self.at_boundary and self._boundary.wants_scene

    @property
    def expected_scene(self) -> str:
        """Hash of that scene; empty when it does not wait for one."""
        return self._boundary.scene_after if self.wants_scene else ""

    @property
    def where(self) -> str:
        """Where it is, for people: a clause."""
        if self.segment is None:
            return Sentence("before the first segment")
        name = repr(self.segment.name)
        if self.at_boundary:
            return Sentence("at the end of segment {number} ({name})", number=self.number, name=name)
        return Sentence("in segment {number} ({name})", number=self.number, name=name)

    def waits_for(self) -> str:
        """Return what a boundary waits for, as a clause for the operator."""
        if not self._boundary.confirmed:
            return Sentence("waits for the tool")
        if self._boundary.wants_scene:
            return Sentence("waits for the scene {scene}", scene=self._boundary.scene_after[:12])
        if self._recording_since is not None and not self._keeper.settled:
            return Sentence("waits for the disk")
        return Sentence("goes on")

    # -- events from outside

    def take_orders(self) -> list[ToolOrder]:
        """Return what is to be asked of the tool since the last call."""
        return self._boundary.take_orders() if self.at_boundary else []

    def problem(self, tool: ToolReport, now: int) -> str:
        """Take a report of the tool; return what it says against going on, as a clause, "" when nothing."""
        segment = self.segment
        if segment is None:
            return ""
        if self.at_boundary:
            self._boundary.observe(tool, now)
            return tool.problem(self._boundary.required)
        if segment.switches and not tool.known:
            return tool.unknown()
        return tool.problem(segment.requires)

    def expects(self, scene: str) -> bool:
        """Return whether a scene is the present one, or at a boundary the one that was planned for."""
        segment = self.segment
        if segment is None:
            return scene == self.plan.scene
        return scene == segment.scene or (self.at_boundary and scene == segment.scene_after)

    # -- the way through the segments

    def arrive(self) -> None:
        """It has come to the end of the present segment."""
        segment = self.segment
        assert segment is not None  # it moves only inside of one
        self.at_boundary = True
        self._recording_since = None
        self._boundary = Boundary(self.plan.id, self.number, segment, segment.scene_after)

    def enter(self) -> float:
        """Enter the next segment; return the time of its end [s]."""
        self.number += 1
        self.at_boundary = False
        self._engagement, self._coming = self._coming, None
        return self.plan.segments[self.number].end

    def pause(self) -> None:
        """A pause at a boundary: what is armed is forgotten."""
        self._boundary.void()

    def resume(self, now: int) -> None:
        """The end of that pause."""
        if self._recording_since is not None:
            self._recording_since = now
        self._boundary.resume(now)

    def update(self, stamp: int, now: int, tool: ToolReport, scene: str, may_switch: bool) -> BoundaryEvent | None:
        """Go on by one cycle at a boundary; return what follows, None while it waits. Arguments as of `Boundary.update`."""
        event = self._boundary.update(stamp, now, tool, scene, may_switch)
        if event is not None or not self._boundary.done:
            return event
        following = self.plan.segments[self.number + 1] if self.number + 1 < len(self.plan.segments) else None
        if not self._recorded(following, now):
            assert self._recording_since is not None  # `_recorded` has set it
            if now - self._recording_since > RECORD_TIMEOUT:
                late = Sentence("the disk did not take what the way back needs; see the executor's log")
                return BoundaryEvent(ExecutorEvent.TIMEOUT, late)
            return None
        if following is None:
            return BoundaryEvent(ExecutorEvent.GOAL, Sentence("goal reached"))
        if following.switches and not tool.known:
            return BoundaryEvent(ExecutorEvent.LOST, tool.unknown())
        if problem := tool.problem(following.requires):
            lost = Sentence("segment {name} cannot begin: {problem}", name=repr(following.name), problem=problem)
            return BoundaryEvent(ExecutorEvent.LOST, lost)
        return BoundaryEvent(ExecutorEvent.NEXT_SEGMENT)

    def _recorded(self, following: Segment | None, now: int) -> bool:
        """Tell whether the disk says where the arm is about to be: an engaged segment, or none."""
        if self.way_back:
            return True
        if self._recording_since is None:
            self._recording_since = now
            engaged = following is not None and following.engaged
            self._keeper.present = self._coming = engagement_of(self.plan, self.number + 1) if engaged else None
        return self._keeper.settled

    # -- the end

    def end(self, finished: bool, elapsed: float, reason: str) -> list[ToolOrder]:
        """The plan has ended, `elapsed` [s] along its trajectory; return what is still to be asked of the tool."""
        if self.at_boundary:
            self._boundary.void()
        if self.way_back:
            if finished:
                self._keeper.end()
            return self.take_orders()
        left, inside = self._engagement, 0.0
        if left is not None:
            # its path begins with the first of the engaged segments
            inside = elapsed - (self.plan.segments[self.number].end - left.path.trajectory.duration)
        if finished or left is None or inside <= 0.0:
            self._keeper.end()
        else:
            path = replace(left.path, end=min(inside, left.path.trajectory.duration))
            self._keeper.leave_inside(replace(left, path=path, holding=self._held_with(), reason=reason))
        return self.take_orders()

    def _held_with(self) -> Holding:
        """Return what the tool's inputs may read where the plan has ended, in the order of time, and the scene of each."""
        segment, boundary = self.segment, self._boundary
        assert segment is not None  # it is engaged
        if not segment.switches:
            return holding_of(segment)
        if not self.at_boundary or not boundary.may_have_switched:
            return ((segment.requires, segment.scene),)
        if boundary.confirmed:
            return ((boundary.confirmation, segment.scene_after),)
        return holding_of(segment)
