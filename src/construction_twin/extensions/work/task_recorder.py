"""What the executor's reports mean for the task whose plan it plays.

The executor goes on from a grip or a release when the scene has changed: after `gripped` or `released` is on the disk.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from construction_twin.core.errors import PayloadError, PoseUnknownError
from construction_twin.core.reports import EngagementReport, ExecutionReport
from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work import decisions
from construction_twin.extensions.work.building import first_few
from construction_twin.extensions.work.loaded_model import as_built, pose_of_tuple, pose_tuple
from construction_twin.extensions.work.received_messages import GripReading, KnownPlan, Received
from construction_twin.extensions.work.task_board import TaskBoard
from construction_twin.extensions.work.task_memory import (
    FROM_ARM,
    FROM_PLAN,
    UNDER_WAY,
    Entry,
    TaskEvent,
    TaskMemory,
    TaskState,
)
from construction_twin.kinematics.chain import Chain
from construction_twin.review.record import PlanRecord
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.segments import Segment
from construction_twin.robot.tool import Tool
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

#: Outcome of a plan that reached its end.
FINISHED = "finished"


@dataclass(frozen=True)
class PlanActions:
    """Numbers of the segments at whose end a plan grips and releases, and of the first engaged one; -1: none, or unknown."""

    id: str
    grips: int
    releases: int
    first_engaged: int = -1


def plan_actions(
    plan_id: str, memory: TaskMemory, segments: Sequence[Segment], changes: Sequence[SceneChange], tool: Tool
) -> PlanActions:
    """Return the segments in which a plan grips, works on and releases its element."""
    grips, releases = -1, -1
    for number, (segment, change) in enumerate(zip(segments, changes)):
        for switch in segment.switches:
            if tool.grip.set.get(switch.output) == switch.value and change.carries:
                grips = number
            lets_go = tool.release.set.get(switch.output) == switch.value
            if lets_go and releases < 0 and (grips >= 0 or memory.in_grip):
                releases = number
    first_engaged = next((number for number, segment in enumerate(segments) if segment.engaged), -1)
    return PlanActions(plan_id, grips, releases, first_engaged)


def actions_by_outcome(plan_id: str, memory: TaskMemory, outcome: str) -> PlanActions:
    """Return what the outcome tells of a plan with unknown segments."""
    if memory.stays or outcome != FINISHED:
        return PlanActions(plan_id, -1, -1)
    return PlanActions(plan_id, -1 if memory.in_grip else 0, 0)


class _Events:
    def __init__(self, memory: TaskMemory, plan: str):
        self.memory, self._plan = memory, plan
        self.entries: list[Entry] = []

    @property
    def state(self) -> TaskState:
        return self.memory.state

    def add(self, event: TaskEvent, reason: str = "", pose: tuple[float, ...] = (), source: str = "") -> None:
        entry = Entry(event.value, self.memory.task, plan=self._plan, pose=pose, source=source, reason=reason)
        self.memory = self.memory.with_entry(entry)
        self.entries.append(entry)


def events_of_report(
    memory: TaskMemory, plan: PlanActions, report: ExecutionReport, grip: GripReading, built: tuple[float, ...] = (),
    source: str = "", confirmed: bool = False,
) -> list[Entry]:  # fmt: skip
    """Return the events that a report adds to the task of a plan.

    `built`: where the element stands if let go now. `confirmed`: the plan ended after the tool's switches at the segment's end.
    """
    if report.plan_id != plan.id or memory.state not in (TaskState.PLANNED, *UNDER_WAY):
        return []
    events = _Events(memory, plan.id)
    if memory.state is TaskState.PLANNED:
        if not report.playing and not report.final_outcome:
            return []
        if not memory.plan:
            events.add(TaskEvent.PLANNED)
        events.add(TaskEvent.BEGUN)
    # what lies behind, up to the present segment; a plan that has come to its end has been through everything
    segment = 10**6 if report.final_outcome == FINISHED else report.segment
    stands = report.at_boundary or report.wants_scene or confirmed
    confirmed = confirmed or (report.wants_scene and report.playing)

    def behind(number: int, at_its_end: bool) -> bool:
        # of a plan that is not known any more, no segment says that the grip closed or let go
        return number >= 0 and (segment > number or (segment == number and at_its_end))

    for state, number, at_its_end, event in (
        (TaskState.WORKING, plan.grips, stands, TaskEvent.GRIPPING),
        (TaskState.GRIPPING, plan.grips, confirmed, TaskEvent.GRIPPED),
        (TaskState.CARRYING, plan.releases, stands, TaskEvent.RELEASING),
    ):
        if events.state is state and behind(number, at_its_end):
            events.add(event)
    if events.state is TaskState.RELEASING and behind(plan.releases, confirmed):
        events.add(TaskEvent.RELEASED, pose=built, source=source if built else "")
    if report.final_outcome:
        _end(events, plan, report, grip)
    return events.entries


def _end(events: _Events, plan: PlanActions, report: ExecutionReport, grip: GripReading) -> None:
    reason = f"{report.outcome}: {report.reason}"
    if events.state is TaskState.WORKING and events.memory.stays:
        # from the first engaged segment on only a person sees what was done
        stopped = TaskEvent.STOPPED if 0 <= report.segment < plan.first_engaged else TaskEvent.UNKNOWN
        events.add(TaskEvent.FINISHED if report.outcome == FINISHED else stopped, reason)
        return
    if events.state is TaskState.RETREATING and report.outcome == FINISHED:
        events.add(TaskEvent.FINISHED, reason)
        return
    if events.state is TaskState.WORKING and not (0 <= report.segment < plan.grips or grip.is_surely_open):
        # from the segment on at whose end the grip closes, it may have closed: unless the tool says that it did not
        events.add(TaskEvent.GRIPPING)
    surely_not = events.state is TaskState.GRIPPING and grip.is_surely_open
    events.add(TaskEvent.NOT_GRIPPED if surely_not else TaskEvent.STOPPED, reason)


def events_after_restart(memory: TaskMemory, fate: PlanRecord, grip: GripReading) -> list[Entry]:
    """Return the events of a task whose plan the executor does not report."""
    events = _Events(memory, fate.plan or memory.plan)
    if memory.state is TaskState.PLANNED:
        if fate.under_review:
            if not memory.plan:
                events.add(TaskEvent.PLANNED)
        elif fate.approved is False:
            events.add(TaskEvent.DROPPED, "it was never approved")
        elif grip.is_surely_open and not memory.in_grip and not memory.stays:
            # nothing can have been carried: the line that must be written before is not there
            events.add(TaskEvent.DROPPED, "nothing was gripped")
        else:
            events.add(TaskEvent.UNKNOWN, "whether the plan was carried out is not known")
    elif memory.state is TaskState.WORKING and grip.is_surely_open and not memory.stays:
        events.add(TaskEvent.STOPPED, "nothing was gripped")
    elif memory.state is TaskState.GRIPPING and grip.is_surely_open:
        events.add(TaskEvent.NOT_GRIPPED, "nothing was gripped")
    elif memory.state in UNDER_WAY:
        events.add(TaskEvent.UNKNOWN, f"what became of the plan is not known; the last known was {memory.state.value}")
    return events.entries


class TaskRecorder:
    """Records how the task under way goes on and ends. For one thread."""

    def __init__(
        self, board: TaskBoard, received: Received, chain: Chain, arm_pose: Callable[[], tuple[float, ...]],
        refuse: Callable[[str, str], None], log: Callable[[str], None],
    ):  # fmt: skip
        self._board, self._received = board, received
        self._chain, self._arm_pose = chain, arm_pose
        self._refuse, self._log = refuse, log

    def catch_up(self, report: ExecutionReport | None) -> None:
        """Record what reports, verdicts and tool say; settle what nobody will report."""
        self.on_report(report)
        self._drop_if_rejected()
        self.settle_if_lost()
        if not self._received.playing and self.grip().is_surely_open:
            # what counts as carried is asked about
            if sentence := decisions.ask_about_carried(self._board):
                self._log(sentence)

    def grip(self) -> GripReading:
        """Return what the tool says of its grip."""
        return self._received.grip(self._board.loaded.tool)

    def on_report(self, report: ExecutionReport | None) -> None:
        """Record what a report means for the task under way."""
        left, memory = self._received.left_engaged, self._under_way()
        if memory is None or report is None or self._received.is_engagement_unknown:
            return
        known = self._received.work_plan(left.plan_id) if left is not None else None
        if left is not None and left.plan_id == memory.plan and known is not None:
            if report.plan_id != memory.plan or not report.playing:
                self._record_engaged_end(memory, left, known, report)
                return
        actions = self._actions_of(memory, self._received.plan)
        if actions is None or actions.id != report.plan_id:
            # without the plan nothing can be told of its segments; its end will be received
            if not memory.plan or report.plan_id != memory.plan or not report.outcome:
                return
            actions = actions_by_outcome(memory.plan, memory, report.outcome)
        self._write(memory, actions, report)

    def _record_engaged_end(
        self, memory: TaskMemory, left: EngagementReport, known: KnownPlan, report: ExecutionReport
    ) -> None:
        """Record how a plan ended inside an engaged segment, with what the tool has done by then."""
        actions, plan = self._actions_of(memory, known), known.plan
        if actions is None:
            return
        numbers = [number for number, segment in enumerate(plan.segments) if segment.name == left.segment]
        mine = report.plan_id == plan.id
        # after a restart of the executor only the segment's name is known
        number = report.segment if mine else numbers[0] if len(numbers) == 1 else -1
        confirmed = 0 <= number < len(plan.segments) and switches_confirmed(left, plan.segments[number])
        # only there the arm still stands as it let go
        stands, outcome = mine and (confirmed or report.at_boundary), (report.outcome if mine else "") or "stopped"
        ended = ExecutionReport("", left.reason, plan.id, outcome, segment=number, at_boundary=stands)
        self._write(memory, actions, ended, confirmed)

    def _write(
        self, memory: TaskMemory, actions: PlanActions, report: ExecutionReport, confirmed: bool = False
    ) -> None:
        built, source = self._as_built(memory, actions, report) if actions.releases >= 0 else ((), "")
        self._add(events_of_report(memory, actions, report, self.grip(), built, source, confirmed))

    def _add(self, entries: list[Entry]) -> None:
        for entry in entries:
            self._board.add(entry)
            reason = f"; {entry.reason}" if entry.reason else ""
            self._log(f"{self._board.title(entry.task)}: {entry.event}{reason}")

    def _under_way(self) -> TaskMemory | None:
        return self._board.states.tasks.get(self._board.states.busy)

    def _actions_of(self, memory: TaskMemory, known: KnownPlan | None) -> PlanActions | None:
        """Return the actions of a plan; None: it is another task's."""
        if known is None or known.plan.task != memory.task:
            return None
        plan = known.plan
        if plan.id != memory.plan and not (memory.offer and memory.offer in plan.source):
            return None
        return plan_actions(plan.id, memory, plan.segments, known.changes, self._board.loaded.tool)

    def _as_built(
        self, memory: TaskMemory, actions: PlanActions, report: ExecutionReport
    ) -> tuple[tuple[float, ...], str]:
        """Return where the element stands if let go now, by the arm's pose at the boundary or the plan's, and which."""
        known = self._received.work_plan(actions.id)
        if known is None or not 0 <= actions.releases < len(known.plan.segments):
            return (), ""
        if not memory.tool0_T_element or memory.state is TaskState.RETREATING:
            return (), ""
        planned = tuple(known.plan.trajectory.sample(known.plan.segments[actions.releases].end)[0])
        q, source = planned, FROM_PLAN
        if report.segment == actions.releases and (report.at_boundary or report.wants_scene):
            try:
                q, source = self._arm_pose(), FROM_ARM
            except (PoseUnknownError, PayloadError) as error:
                self._refuse("pose", f"the planned pose is taken for the arm's: {error}")
        held, goal = pose_of_tuple(memory.tool0_T_element), self._board.built.element(memory.task).base_T_goal
        return pose_tuple(as_built(self._chain.forward(q), self._chain.forward(planned), held, goal)), source

    def settle_if_lost(self) -> None:
        """Settle a task under way that the executor does not know."""
        memory, report = self._under_way(), self._received.execution
        if memory is None or report is None:
            return
        if memory.state in UNDER_WAY and report.plan_id != memory.plan:
            self.settle()
        elif memory.state is TaskState.PLANNED and self._received.forget_orphaned_plan(memory.plan):
            self.settle()

    def settle(self) -> None:
        """Settle a task that the executor will not report: by its record, else by asking."""
        memory, report = self._under_way(), self._received.execution
        if memory is None or self._received.is_engagement_unknown:
            return
        if report is not None and memory.plan and report.plan_id == memory.plan:
            return
        fate = self._received.fate(memory.plan, memory.offer)
        if fate.outcome != FINISHED:
            self._add(events_after_restart(memory, fate, self.grip()))
            return
        # where the element was to be let go is known as long as the plan is
        actions = self._actions_of(memory, self._received.work_plan(fate.plan))
        actions = actions or actions_by_outcome(fate.plan, memory, fate.outcome)
        self._write(memory, actions, ExecutionReport("", "", fate.plan, fate.outcome))

    def settle_offer(self, task: str, offer: str) -> None:
        """Settle a task whose plan the planner may have published without an answer."""
        self._add(events_after_restart(self._board.states.tasks[task], self._received.fate("", offer), self.grip()))

    def _drop_if_rejected(self) -> None:
        memory = self._under_way()
        verdict = self._received.verdict(memory.plan) if memory is not None else None
        if memory is not None and memory.state is TaskState.PLANNED and verdict is not None and not verdict.approved:
            who, why = verdict.reviewer, verdict.reason
            self._board.add(Entry("dropped", memory.task, plan=memory.plan, reason=f"{who}: {why}"))
            self._board.failures[memory.task] = f"its plan was turned down by {who}: {why}"


# -- the scene in which an engaged arm goes back


def restoring_change(
    left: EngagementReport,
    scene: Scene,
    segments: Sequence[Segment],
    changes: Sequence[SceneChange],
    element: str = "",
    forms: Sequence[tuple[SceneObject, ...]] = (),
) -> SceneChange | str:
    """Return the change after which an engaged arm can go back, or why none is known.

    `segments`, `changes`: of the plan that ended inside. `forms`: objects of the element as the ledger can have them.
    """
    tried = [change for segment, change in zip(segments, changes) if segment.scene_after in left.scenes]
    there = tuple(name for name in scene.names if element and name.startswith(f"{element}/"))
    for form in forms if element else ():
        # replaced one by one, other objects keep leave to touch them
        gone = tuple(name for name in there if name not in {item.name for item in form})
        tried += [SceneChange(form, there), SceneChange(form, gone)]
    for change in tried:
        try:
            made = change.apply(scene)
        except SceneError:
            continue  # it removes what is not there
        if made.hash in left.scenes:
            return change
    return Sentence(
        "the arm was left in engaged segment {segment} of plan {plan}; no change of the work's objects makes the present scene "
        "{scene} the one in which it may go back ({scenes}): look at what hangs on the tool, undo what was changed in the scene "
        "since (beside the work it has {others}), or free the arm by hand and call release_engagement",
        segment=repr(left.segment),
        plan=left.plan_id,
        scene=scene.hash[:12],
        scenes=" or ".join(each[:12] for each in left.scenes) or "none is known",
        others=first_few(name for name in scene.names if "/" not in name),
    )


def switches_confirmed(left: EngagementReport, segment: Segment) -> bool:
    """Return whether an engagement confirms the switches at a segment's end."""
    return segment.scene_after != segment.scene and set(left.scenes) == {segment.scene_after}
