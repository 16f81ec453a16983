"""What the work node writes into the ledger of a building: what the executor's reports say of the task under way.

Everything but `WorkFollower.grip` is to be called under the node's lock. When a method returns, its lines are on the disk.
"""

from __future__ import annotations

from collections.abc import Callable

import rospy

from construction_twin.core.errors import PayloadError, PoseUnknownError
from construction_twin.core.reports import EngagementReport, ExecutionReport
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Chain
from construction_twin.review.record import Fate
from construction_twin.ros.messages.convert import trajectory_from_msg
from construction_twin.ros.shared.work_listener import KnownPlan, WorkListener
from construction_twin.work import engaged_scene, following
from construction_twin.work.built import as_built, pose_of_tuple, pose_tuple
from construction_twin.work.following import Followed, GripReading
from construction_twin.work.task_board import TaskBoard
from construction_twin.work.task_memory import MEASURED, PLANNED, Entry, TaskMemory
from construction_twin.work.task_states import UNDER_WAY, TaskState


class WorkFollower:
    """Adds to the ledger how the task under way goes on and ends.

    Args:
        chain: Of the arm.
        arm_pose: Returns the physical arm's present joint positions [rad], [m]; raises PoseUnknownError or PayloadError.
        refuse: Counts what could not be used; takes reason and sentence.
    """

    def __init__(
        self,
        board: TaskBoard,
        heard: WorkListener,
        chain: Chain,
        arm_pose: Callable[[], tuple[float, ...]],
        refuse: Callable[[str, str], None],
    ):
        self._board, self._heard = board, heard
        self._chain, self._arm_pose = chain, arm_pose
        self._refuse = refuse

    def catch_up(self, report: ExecutionReport | None) -> None:
        """Write all that a report, verdicts and tool have to say, and settle what nobody will report any more."""
        self.follow(report)
        self._drop_if_turned_down()
        self.settle_if_lost()
        self._doubt_if_open()

    def grip(self) -> GripReading:
        """Return what the tool says of its grip."""
        return self._heard.grip(self._board.prepared.tool)

    # -- the task under way

    def follow(self, report: ExecutionReport | None) -> None:
        """Write what a report says of the task under way."""
        left, memory = self._heard.left, self._under_way()
        if memory is None or report is None or self._heard.unsaid:
            return
        known = self._heard.work_plan(left.plan_id) if left is not None else None
        if left is not None and left.plan_id == memory.plan and known is not None:
            if report.plan_id != memory.plan or not report.playing:
                self._follow_left(memory, left, known, report)
                return
        followed = self._followed(memory, self._heard.plan)
        if followed is None or followed.id != report.plan_id:
            # without the plan nothing can be told of its segments; its end will be heard
            if not memory.plan or report.plan_id != memory.plan or not report.outcome:
                return
            followed = following.followed_unseen(memory.plan, memory, report.outcome)
        self._write(memory, followed, report)

    def _follow_left(
        self, memory: TaskMemory, left: EngagementReport, known: KnownPlan, report: ExecutionReport
    ) -> None:
        """Write how the task's plan ended inside an engaged segment: what the tool has done by then is done."""
        followed = self._followed(memory, known)
        if followed is None:
            return
        numbers = [number for number, segment in enumerate(known.segments) if segment.name == left.segment]
        mine = report.plan_id == known.message.id
        # after a restart of the executor only the segment's name is known
        number = report.segment if mine else numbers[0] if len(numbers) == 1 else -1
        confirmed = 0 <= number < len(known.segments) and engaged_scene.confirmed(left, known.segments[number])
        ended = ExecutionReport(
            text="",
            reason=left.reason,
            plan_id=known.message.id,
            outcome=(report.outcome if mine else "") or "stopped",
            segment=number,
            # only there the arm still stands as it let go
            at_boundary=mine and (confirmed or report.at_boundary),
        )
        self._write(memory, followed, ended, confirmed)

    def _write(self, memory: TaskMemory, followed: Followed, report: ExecutionReport, confirmed: bool = False) -> None:
        """Write the lines that follow from a report."""
        built, source = self._as_built(memory, followed, report) if followed.releases >= 0 else ((), "")
        events = following.follow(memory, followed, report, self.grip(), built, source, confirmed)
        self._add(events, rospy.loginfo)

    def _add(self, entries: list[Entry], log: Callable[..., None]) -> None:
        """Add events to the ledger, in their order."""
        for entry in entries:
            self._board.add(entry)
            reason = f"; {entry.reason}" if entry.reason else ""
            log("%s: %s%s", self._board.title(entry.task), entry.event, reason)

    def _under_way(self) -> TaskMemory | None:
        """Return what is known of the task that is under review or under way; None: none is."""
        return self._board.book.tasks.get(self._board.book.busy)

    def _followed(self, memory: TaskMemory, known: KnownPlan | None) -> Followed | None:
        """Return a plan of a task as it is followed; None when it is another's."""
        if known is None or known.message.task != memory.task:
            return None
        plan = known.message
        if plan.id != memory.plan and not (memory.offer and memory.offer in plan.source):
            return None
        return following.followed(plan.id, memory, known.segments, known.changes, self._board.prepared.tool)

    def _as_built(
        self, memory: TaskMemory, followed: Followed, report: ExecutionReport
    ) -> tuple[tuple[float, ...], str]:
        """Return where the element stands if let go now: by the arm's own pose at the boundary, else by the plan's; and which."""
        planned = self._planned_pose(followed)
        if planned is None or not memory.tool0_T_element or memory.state is TaskState.RETREATING:
            return (), ""
        q, source = planned, PLANNED
        if report.segment == followed.releases and (report.at_boundary or report.wants_scene):
            try:
                q, source = self._arm_pose(), MEASURED
            except (PoseUnknownError, PayloadError) as error:
                self._refuse("pose", f"the planned pose is taken for the arm's: {error}")
        held, goal = pose_of_tuple(memory.tool0_T_element), self._board.goal(memory.task)
        return pose_tuple(as_built(self._chain.forward(q), self._chain.forward(planned), held, goal)), source

    def _planned_pose(self, followed: Followed) -> tuple[float, ...] | None:
        """Return where the arm was to let go [rad], [m]; None when the plan is not known any more."""
        known = self._heard.work_plan(followed.id)
        if known is None or not 0 <= followed.releases < len(known.segments):
            return None
        end = known.segments[followed.releases].end
        return tuple(trajectory_from_msg(known.message.trajectory).sample(end)[0])

    # -- a task that nobody reports

    def settle_if_lost(self) -> None:
        """Settle a task under way that the executor does not know: it was started anew, or has gone on to another plan."""
        memory, report = self._under_way(), self._heard.execution
        if memory is None or report is None:
            return
        if memory.state in UNDER_WAY and report.plan_id != memory.plan:
            self.settle()
        elif memory.state is TaskState.PLANNED and self._heard.forget_if_nobody_has(memory.plan):
            self.settle()

    def settle(self) -> None:
        """Settle a task whose plan the executor does not report, and never will: by its record, else by asking."""
        memory, report = self._under_way(), self._heard.execution
        if memory is None or self._heard.unsaid:
            return
        if report is not None and memory.plan and report.plan_id == memory.plan:
            return
        fate = self._heard.fate(memory.plan, memory.offer)
        if fate.outcome != following.FINISHED:
            self._settle(memory, fate)
            return
        ended = ExecutionReport("", "", fate.plan, fate.outcome)
        unseen = following.followed_unseen(fate.plan, memory, fate.outcome)
        # where the element was to be let go is known as long as the plan is
        known = self._heard.plan
        followed = self._followed(memory, known) if known is not None and known.message.id == fate.plan else None
        built, source = self._as_built(memory, followed, ended) if followed is not None else ((), "")
        self._add(following.follow(memory, unseen, ended, self.grip(), built, source), rospy.logwarn)

    def settle_offer(self, task: str, offer: str) -> None:
        """Settle a task whose plan was offered to a planner that did not answer: it may have published it before it went away."""
        self._settle(self._board.book.tasks[task], self._heard.fate("", offer))

    def _settle(self, memory: TaskMemory, fate: Fate) -> None:
        self._add(following.after_restart(memory, fate, self.grip()), rospy.logwarn)

    # -- what others say

    def _drop_if_turned_down(self) -> None:
        """Take note of a plan under review that was rejected, replaced, or is void."""
        memory = self._under_way()
        review = self._heard.review(memory.plan) if memory is not None else None
        if memory is not None and memory.state is TaskState.PLANNED and review is not None and not review.approved:
            who, why = review.reviewer, review.reason
            self._board.add(Entry("dropped", memory.task, plan=memory.plan, reason=f"{who}: {why}"))
            self._board.failures[memory.task] = Sentence("work.task.turned_down", who=who, reason=why)

    def _doubt_if_open(self) -> None:
        """Have it asked about what counts as carried, when the tool is surely open."""
        if not self._heard.playing and self.grip().surely_open:
            sentence = self._board.lost()
            if sentence:
                rospy.logwarn("%s", sentence)
