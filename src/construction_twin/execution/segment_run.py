"""One execution of a work plan: its segment, the wait at the boundary, the expected tool and scene.

At a boundary the arm stands at rest: its switches are armed, fire and are confirmed, and the scene becomes the one planned for. The
setpoints go on repeating its pose, so that the playout passes the stamps of the switches. Pure. Stamps [ns] are those of setpoints;
`now` [ns] is on the monotonic clock; times in s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from construction_twin.core.reports import SwitchReport, SwitchState, ToolReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.execution.engagement import Engagement, EngagementStore, Holding, engagement_of, holding_of
from construction_twin.execution.states import ExecutorEvent
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Segment, Signal, Switch

#: Why there is none without a physical arm.
NO_ARM = Sentence("there is no physical arm (`arm:=none`), so nothing switches or reads a tool")


def tool_pending(report: ToolReport, plan: Plan) -> str:
    """Return the passing obstacle of an unknown tool to a work plan, as a clause; "" for none."""
    return report.why_unknown() if needs_tool(plan) and report.reason != NO_ARM else ""


def tool_missing(report: ToolReport, plan: Plan) -> str:
    """Return a work plan's unmet requirement of the tool, as a clause; "" for none."""
    if not needs_tool(plan):
        return ""
    if problem := tool_pending(report, plan) or report.why_unknown():
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


#: A switch is armed for the setpoint this far ahead [ns]: its acknowledgement takes a message there and one back, over a link that
#: may be wireless, and the playout adds its delay of about 20 ms on top.
LEAD = NANOSECONDS * 3 // 20 // CYCLE_NS * CYCLE_NS
#: A switch must have fired this long after it was armed [ns]: the lead, the playout's delay, and a report over a slow link.
FIRE_TIMEOUT = 3 * NANOSECONDS
#: What is asked to change the scene must have done so within this time [ns]: longer than a node that was killed takes to come back.
SCENE_TIMEOUT = 30 * NANOSECONDS


@dataclass(frozen=True)
class ToolOrder:
    """An order to the tool.

    Attributes:
        id: Of the switch; empty: forget every switch that is armed and has not fired.
        stamp: Nominal stamp of the setpoint with which it fires [ns].
    """

    id: str
    plan_id: str
    switch: Switch | None = None
    stamp: int = 0


@dataclass(frozen=True)
class BoundaryEvent:
    """The end of a wait at a boundary, and its reason."""

    event: ExecutorEvent
    reason: str = ""


@dataclass
class _Order:
    """One switch, as it was armed last: its place among those of the segment, id, how often, and when it was seen to fire [ns]."""

    switch: Switch
    place: int
    id: str = ""
    attempts: int = 0
    fired: int | None = None


class Boundary:
    """The end of one segment: switches that fire once, then the scene. `wants_scene`: only `scene_after` is missing."""

    def __init__(self, plan_id: str, number: int, segment: Segment | None, scene_after: str):
        self.segment = segment
        self.scene_after = scene_after
        self.wants_scene = False
        self._plan_id, self._number = plan_id, number
        self._ordered = [_Order(switch, place) for place, switch in enumerate(segment.switches)] if segment else []
        self._armed_at: int | None = None
        self._voided = False
        self._confirmed = not self._ordered
        self._wanted_at: int | None = None
        self._orders: list[ToolOrder] = []

    @property
    def fired(self) -> bool:
        """Whether a switch is known to have fired."""
        return any(order.fired is not None for order in self._ordered)

    @property
    def confirmed(self) -> bool:
        """Whether all switches have fired and were confirmed; true without switches."""
        return self._confirmed

    @property
    def may_have_switched(self) -> bool:
        """Whether a switch was armed, and may have fired."""
        return any(order.attempts for order in self._ordered)

    @property
    def done(self) -> bool:
        """Whether switches and scene are as planned."""
        return self._confirmed and not self.wants_scene and self._wanted_at is not None

    @property
    def confirmation(self) -> tuple[Signal, ...]:
        """Required readings of the inputs after the switches."""
        return tuple(signal for order in self._ordered for signal in order.switch.confirm)

    @property
    def required(self) -> tuple[Signal, ...]:
        """Required readings of the inputs now."""
        if self._confirmed and self._ordered:
            return self.confirmation
        return self.segment.requires if self.segment is not None and not self.fired else ()

    def pop_orders(self) -> list[ToolOrder]:
        """Return the orders to the tool since the last call."""
        orders, self._orders = self._orders, []
        return orders

    def on_report(self, tool: ToolReport, now: int) -> None:
        """Store the switches' states of a report, paused or not."""
        for order in self._ordered:
            report = tool.switches.get(order.id) if order.id else None
            if report is not None and report.state is SwitchState.FIRED and order.fired is None:
                order.fired = now

    def void(self) -> None:
        """Order the armed switches void: a pause, or the end of the plan."""
        if not self._voided and any(order.attempts and order.fired is None for order in self._ordered):
            self._orders.append(ToolOrder("", self._plan_id))
            self._voided = True

    def resume(self, now: int) -> None:
        """Continue after a pause: fired switches stay fired, void ones are armed anew."""
        if self._armed_at is not None:
            self._armed_at = now
        if self._wanted_at is not None:
            self._wanted_at = now

    def update(self, stamp: int, now: int, tool: ToolReport, scene: str, may_switch: bool) -> BoundaryEvent | None:
        """Advance by one cycle, whose setpoint has this stamp [ns]; return the event of a failed wait, else None (see `done`).

        `scene`: hash of the present one, empty: not known. `may_switch`: whether a switch may be armed now.
        """
        self.on_report(tool, now)
        if not self._confirmed:
            return self._switch(stamp, now, tool, may_switch)
        if self._wanted_at is None:
            self._wanted_at = now
        self.wants_scene = scene != self.scene_after
        if self.wants_scene and now - self._wanted_at > SCENE_TIMEOUT:
            wanted, seconds = self.scene_after[:12], SCENE_TIMEOUT / NANOSECONDS
            late = Sentence(
                "the scene did not become {scene} within {seconds:g} s; does its node run?",
                scene=wanted,
                seconds=seconds,
            )
            return BoundaryEvent(ExecutorEvent.TIMEOUT, late)
        return None

    # -- switches

    def _switch(self, stamp: int, now: int, tool: ToolReport, may_switch: bool) -> BoundaryEvent | None:
        if problem := tool.why_unknown():
            return BoundaryEvent(ExecutorEvent.LOST, problem)
        if self._armed_at is None:
            if confirmed := self._confirmed_before(tool):
                return confirmed
            if may_switch:
                self._arm(self._ordered, stamp, now)
            return None
        if not may_switch:
            # the gateway fires nothing either while everything is kept still
            self.void()
        if refused := self._refused(tool):
            return refused
        if self._voided:
            self._arm_again(stamp, now, tool, may_switch)
        return self._check_fired(now, tool)

    def _confirmed_before(self, tool: ToolReport) -> BoundaryEvent | None:
        """Return the event of a switch that was confirmed before it fired, as by a stuck sensor."""
        for order in self._ordered:
            if order.switch.confirm and not tool.mismatch(order.switch.confirm):
                stuck = Sentence(
                    "what confirms {switch} reads so already; look at sensor and tool", switch=_name(order)
                )
                return BoundaryEvent(ExecutorEvent.LOST, stuck)
        return None

    def _arm(self, which: list[_Order], stamp: int, now: int) -> None:
        for order in which:
            order.attempts += 1
            order.id = f"{self._plan_id}/{self._number}/{order.place}/{order.attempts}"
            self._orders.append(ToolOrder(order.id, self._plan_id, order.switch, stamp + LEAD))
        self._armed_at = now

    def _arm_again(self, stamp: int, now: int, tool: ToolReport, may_switch: bool) -> None:
        """Arm void switches anew after a pause, once the gateway has reported on all of them."""
        open_ones = [order for order in self._ordered if order.fired is None]
        if not all(_is_void(tool.switches.get(order.id)) for order in open_ones):
            return
        if may_switch or not open_ones:
            self._voided = False
            self._arm(open_ones, stamp, now)
        else:
            self._armed_at = now

    def _refused(self, tool: ToolReport) -> BoundaryEvent | None:
        for order in self._ordered:
            report = tool.switches.get(order.id)
            if order.fired is not None or report is None:
                continue
            if report.state is SwitchState.REFUSED or (_is_void(report) and not self._voided):
                values = {"switch": _name(order), "reason": report.reason}
                sentence = Sentence("the gateway has refused {switch}: {reason}", **values)
                if report.state is not SwitchState.REFUSED:
                    sentence = Sentence("the gateway has forgotten {switch}: {reason}", **values)
                return BoundaryEvent(ExecutorEvent.REFUSED, sentence)
        return None

    def _check_fired(self, now: int, tool: ToolReport) -> BoundaryEvent | None:
        """Confirm fired switches; return the event of an overdue one."""
        assert self._armed_at is not None  # the caller has seen to that
        late, all_in = None, True
        for order in self._ordered:
            if order.fired is None:
                all_in = False
                if now - self._armed_at > FIRE_TIMEOUT:
                    name, seconds = _name(order), FIRE_TIMEOUT / NANOSECONDS
                    words = Sentence(
                        "{switch} was not reported as fired within {seconds:g} s", switch=name, seconds=seconds
                    )
                    late = BoundaryEvent(ExecutorEvent.TIMEOUT, words)
            elif problem := tool.mismatch(order.switch.confirm):
                all_in = False
                if now - order.fired > order.switch.timeout * NANOSECONDS:
                    words = Sentence(
                        "{switch} has fired, but was not confirmed within {seconds:g} s: {problem}",
                        switch=_name(order),
                        seconds=order.switch.timeout,
                        problem=problem,
                    )
                    late = BoundaryEvent(ExecutorEvent.TIMEOUT, words)
        self._confirmed = all_in
        return late


def _is_void(report: SwitchReport | None) -> bool:
    return report is not None and report.state is SwitchState.VOID


def _name(order: _Order) -> str:
    output = order.switch.output
    if order.switch.value:
        return Sentence("the switch of {output} to on", output=output)
    return Sentence("the switch of {output} to off", output=output)


#: An engaged segment must be on the disk within this time [ns].
RECORD_TIMEOUT = 10 * NANOSECONDS


class SegmentRun:
    """The segments of one plan, in order, each entered only in its scene, with what it requires of the tool.

    Args:
        way_back: Whether it leads out of an engagement, which it ends when it is finished.

    Attributes:
        number: Of the segment that it is in, or at the end of, from 0; -1 before the first is entered. Sentences count from 1.
        at_boundary: Whether it stands at the end of that segment.
    """

    def __init__(self, plan: Plan, keeper: EngagementStore, way_back: bool = False):
        self.plan = plan
        self.number = -1
        self.at_boundary = True
        self.way_back = way_back
        self._engagements = keeper
        self._engagement: Engagement | None = None
        self._coming: Engagement | None = None
        self._recording_since: int | None = None
        self._boundary = Boundary(plan.id, -1, None, plan.scene)
        self._orders: list[ToolOrder] = []

    @property
    def segment(self) -> Segment | None:
        """The present segment; None before the first."""
        return self.plan.segments[self.number] if self.number >= 0 else None

    @property
    def wants_scene(self) -> bool:
        """Whether only the planned scene is missing at the boundary."""
        return self.at_boundary and self._boundary.wants_scene

    @property
    def expected_scene(self) -> str:
        """Hash of the missing scene; empty for none."""
        return self._boundary.scene_after if self.wants_scene else ""

    @property
    def where(self) -> str:
        """The place in the plan, as a clause for the operator."""
        if self.segment is None:
            return Sentence("before the first segment")
        name = repr(self.segment.name)
        if self.at_boundary:
            return Sentence("at the end of segment {number} ({name})", number=self.number + 1, name=name)
        return Sentence("in segment {number} ({name})", number=self.number + 1, name=name)

    def waits_for(self) -> str:
        """Return what a boundary waits for, as a clause for the operator."""
        if not self._boundary.confirmed:
            return Sentence("waits for the tool")
        if self._boundary.wants_scene:
            return Sentence("waits for the scene {scene}", scene=self._boundary.scene_after[:12])
        if self._recording_since is not None and not self._engagements.saved:
            return Sentence("waits for the disk")
        return Sentence("goes on")

    # -- events from outside

    def pop_orders(self) -> list[ToolOrder]:
        """Return the orders to the tool since the last call."""
        return self._boundary.pop_orders() if self.at_boundary else []

    def obstacle(self, tool: ToolReport, now: int) -> str:
        """Return the obstacle in a tool's report, as a clause; "" for none."""
        segment = self.segment
        if segment is None:
            return ""
        if self.at_boundary:
            self._boundary.on_report(tool, now)
            return tool.mismatch(self._boundary.required)
        if segment.switches and not tool.known:
            return tool.why_unknown()
        return tool.mismatch(segment.requires)

    def allows_scene(self, scene: str) -> bool:
        """Return whether a scene is the present one, or at a boundary the one that was planned for."""
        segment = self.segment
        if segment is None:
            return scene == self.plan.scene
        return scene == segment.scene or (self.at_boundary and scene == segment.scene_after)

    # -- the way through the segments

    def arrive(self) -> None:
        """Begin the boundary at the end of the present segment."""
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
        """Void armed switches at a boundary."""
        self._boundary.void()

    def resume(self, now: int) -> None:
        """Continue at a boundary after a pause."""
        if self._recording_since is not None:
            self._recording_since = now
        self._boundary.resume(now)

    def update(self, stamp: int, now: int, tool: ToolReport, scene: str, may_switch: bool) -> BoundaryEvent | None:
        """Advance by one cycle at a boundary; return its event, None while it waits. Arguments as of `Boundary.update`."""
        event = self._boundary.update(stamp, now, tool, scene, may_switch)
        if event is not None or not self._boundary.done:
            return event
        following = self.plan.segments[self.number + 1] if self.number + 1 < len(self.plan.segments) else None
        if not self._record_engagement(following, now):
            assert self._recording_since is not None  # `_record_engagement` has set it
            if now - self._recording_since > RECORD_TIMEOUT:
                late = Sentence("the disk did not take what the way back needs; see the executor's log")
                return BoundaryEvent(ExecutorEvent.TIMEOUT, late)
            return None
        if following is None:
            return BoundaryEvent(ExecutorEvent.GOAL, Sentence("goal reached"))
        if following.switches and not tool.known:
            return BoundaryEvent(ExecutorEvent.LOST, tool.why_unknown())
        if problem := tool.mismatch(following.requires):
            lost = Sentence("segment {name} cannot begin: {problem}", name=repr(following.name), problem=problem)
            return BoundaryEvent(ExecutorEvent.LOST, lost)
        return BoundaryEvent(ExecutorEvent.NEXT_SEGMENT)

    def _record_engagement(self, following: Segment | None, now: int) -> bool:
        """Record the next segment's engagement, or its absence; return whether it is on the disk."""
        if self.way_back:
            return True
        if self._recording_since is None:
            self._recording_since = now
            engaged = following is not None and following.engaged
            self._engagements.present = self._coming = engagement_of(self.plan, self.number + 1) if engaged else None
        return self._engagements.saved

    # -- the end

    def end(self, finished: bool, elapsed: float, reason: str) -> list[ToolOrder]:
        """End the plan, `elapsed` [s] along its trajectory; return the last orders to the tool."""
        if self.at_boundary:
            self._boundary.void()
        if self.way_back:
            if finished:
                self._engagements.clear()
            return self.pop_orders()
        last, inside = self._engagement, 0.0
        if last is not None:
            # its path begins with the first of the engaged segments
            inside = elapsed - (self.plan.segments[self.number].end - last.path.trajectory.duration)
        if finished or last is None or inside <= 0.0:
            self._engagements.clear()
        else:
            path = replace(last.path, end=min(inside, last.path.trajectory.duration))
            self._engagements.mark_engaged(replace(last, path=path, holding=self._possible_readings(), reason=reason))
        return self.pop_orders()

    def _possible_readings(self) -> Holding:
        """Return the possible readings of the tool's inputs at the plan's end, in the order of time, with their scenes."""
        segment, boundary = self.segment, self._boundary
        assert segment is not None  # it is engaged
        if not segment.switches:
            return holding_of(segment)
        if not self.at_boundary or not boundary.may_have_switched:
            return ((segment.requires, segment.scene),)
        if boundary.confirmed:
            return ((boundary.confirmation, segment.scene_after),)
        return holding_of(segment)
