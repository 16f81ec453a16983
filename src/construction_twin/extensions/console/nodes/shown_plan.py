"""The plan under review on MQTT, and what its rehearsal has found: what a person sees before a verdict. Both are retained.

They are on the connection by which verdicts come, whose last will takes the plan away: while that is lost, nobody hears a verdict.
"""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import replace

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.records import SPACED, to_json
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.remote_review import (
    ClearanceView,
    PlanBoard,
    PlanView,
    SegmentView,
    SwitchView,
    UseView,
)
from construction_twin.msg import Link, Plan, PlanCaller, Rehearsal, Review, Signal
from construction_twin.review.rehearsal_report import RehearsalReport, is_consistent
from construction_twin.robot.segments import segments_content
from construction_twin.ros.messages.convert import plan_from_msg
from construction_twin.ros.messages.records import from_msg

#: Period at which what the broker holds is compared with what it should hold [s].
CHECK_PERIOD = 1.0
#: A tool path on MQTT is thinned to at most so many points, beside the ends of its segments; 200 are about 6 kB.
PATH_POINTS = 200


class ShownPlan:
    """Publishes `plan` and `rehearsal`; `tool`: hash of the tool file. Each ROS topic has its thread."""

    def __init__(self, connection: Connection, tool: str = ""):
        self._topics, self._connection, self._tool = connection.topics, connection, tool
        self._board, self._rehearsals = PlanBoard(), PlanBoard()
        self.rehearsal: RehearsalReport | None = None
        self._view: PlanView | None = None
        self._disconnected_plan = ""
        self._lock = threading.Lock()
        self._session: str | None = None
        self._received = b""
        self._checked_at = 0.0

    @property
    def plan(self) -> str:
        """Id of the plan under review; empty: none."""
        with self._lock:
            return self._board.plan

    def on_plan(self, message: Plan) -> None:
        """Publish a plan; refuse a work plan whose hash is wrong."""
        try:
            view = plan_view(message, self._tool)
        except ConstructionTwinError as error:
            self._connection.refuse("plan", str(error))
            return
        with self._lock:
            self._view = view
            self._show()
        self._publish_plan()

    def on_rehearsal(self, message: Rehearsal) -> None:
        """Publish a rehearsal until its plan is decided."""
        report = from_msg(RehearsalReport, message)
        if not is_consistent(report):
            self._connection.refuse("rehearsal", f"the rehearsal of plan {report.plan_id!r} is not what its hash says")
            return
        with self._lock:
            self.rehearsal = report
            self._rehearsals.on_plan(report.plan_id, to_json(report, separators=SPACED, translatable=True))
        self.publish_rehearsal()

    def on_caller(self, message: PlanCaller) -> None:
        """Publish whether the program that asked for the plan is still connected."""
        with self._lock:
            self._disconnected_plan = "" if message.connected else message.plan_id
            if self._view is None or self._view.id != message.plan_id:
                return
            self._show()
        self._publish_plan()

    def _show(self) -> None:
        """Put the newest plan on the board, unless it was decided."""
        view = self._view
        assert view is not None  # there is a plan
        if view.id == self._disconnected_plan:
            # in the one text about who asked that every screen shows
            view = replace(view, source=f"{view.source} (connected no more: nobody waits for the result)")
        self._board.on_plan(view.id, view.to_json(PATH_POINTS))

    def on_review(self, message: Review) -> None:
        """Clear a plan that was decided."""
        self._change(PlanBoard.on_verdict, message.plan_id)

    def on_link(self, message: Link) -> None:
        """Clear the plan when another session begins."""
        if message.session and message.session != self._session:
            if self._session is not None:
                self._change(PlanBoard.restart)
            self._session = message.session

    def _change(self, change: Callable[..., None], *arguments: str) -> None:
        with self._lock:
            for board in (self._board, self._rehearsals):
                change(board, *arguments)
        self._publish_plan()
        self.publish_rehearsal()

    # -- to MQTT

    def first(self) -> tuple[str, bytes, bool]:
        """Return topic, payload and retain flag of a connection's first message."""
        self._received = b""
        return self._topics.plan, self._board.payload, True

    def publish_rehearsal(self) -> None:
        """Publish the rehearsal."""
        self._connection.publish(self._topics.rehearsal, self._rehearsals.payload, retain=True)

    def _publish_plan(self) -> None:
        self._connection.publish(self._topics.plan, self._board.payload, retain=True)

    def on_own_plan(self, payload: bytes) -> None:
        """Store the retained `plan` of the broker."""
        self._received = payload

    def check(self) -> None:
        """Publish again when the broker holds something else, as after the late last will of a predecessor."""
        now = time.monotonic()
        if now - self._checked_at < CHECK_PERIOD:
            return
        self._checked_at = now
        if self._received != self._board.payload:
            self._publish_plan()

    def clear_retained(self) -> None:
        """Clear both retained messages."""
        for topic in (self._topics.plan, self._topics.rehearsal):
            self._connection.publish(topic, b"", retain=True)


def plan_view(message: Plan, tool: str = "") -> PlanView:
    """Return what is shown of a plan; PlanningError if a work plan is not what its hash says.

    Every measured plan has its fractions of the velocity limits, so their absence means that nothing was measured.
    """
    points, is_work = message.trajectory.points, bool(message.segments)
    clearance = ClearanceView(
        message.clearance, message.clearance_time, message.clearance_between, _xyz(message.clearance_point)
    )
    same = ("id", "hash", "source", "planner", "scene", "duration", "planning_time")
    return PlanView(
        **{name: getattr(message, name) for name in same},
        frame=message.header.frame_id,
        created_ns=message.header.stamp.to_nsec(),
        joints=message.trajectory.joint_names,
        start=points[0].positions if points else (),
        goal=points[-1].positions if points else (),
        waypoints=len(message.tool_path),
        tool_path=[_xyz(point) for point in message.tool_path],
        clearance=clearance if message.velocity_use else None,
        use=UseView(message.velocity_use, message.acceleration_use, message.jerk_use),
        trajectory=_trajectory(message),
        tool=tool or None,
        task=message.task if is_work else None,
        content=_content(message) if is_work else None,
        segments=segment_views(message) if is_work else None,
    )


def segment_views(message: Plan) -> list[SegmentView]:
    """Return what is shown of a work plan's segments."""
    times = [point.time_from_start.to_nsec() for point in message.trajectory.points]
    return [
        SegmentView(
            name=segment.name,
            end=segment.end,
            tool_path_end=end,
            engaged=segment.engaged,
            requires=_values(segment.requires),
            switches=[
                SwitchView(switch.output, switch.value, _values(switch.confirm), switch.timeout)
                for switch in segment.switches
            ],
            scene=segment.scene,
            scene_after=segment.scene_after,
            put=[item.name for item in segment.put],
            remove=segment.remove,
        )
        for segment, end in zip(message.segments, segment_ends(message, times))
    ]


def segment_ends(message: Plan, times: list[int]) -> list[int]:
    """Return the number of the point at which each segment of a work plan ends; `times` of the points [ns]."""
    last = max(len(times) - 1, 0)
    return [min(bisect_left(times, round(segment.end * NANOSECONDS)), last) for segment in message.segments]


def _content(message: Plan) -> str:
    """Return the text that a work plan's hash covers."""
    plan = plan_from_msg(message)
    return segments_content(plan.trajectory.content_hash(), plan.task, plan.segments)


def _trajectory(message: Plan) -> dict[str, list]:
    """Return what the trajectory's hash covers, as it is in the message: who shows the plan compares."""
    points = message.trajectory.points
    return {
        "times": [point.time_from_start.to_nsec() / NANOSECONDS for point in points],
        "positions": [point.positions for point in points],
        "velocities": [point.velocities for point in points],
        "accelerations": [point.accelerations for point in points],
    }


def _values(signals: Iterable[Signal]) -> dict[str, bool]:
    return {signal.name: signal.value for signal in signals}


def _xyz(point) -> tuple[float, float, float]:
    return point.x, point.y, point.z
