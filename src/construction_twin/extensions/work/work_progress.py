"""The work on one model, with its services: planning, answers of people, and the scene that follows the ledger.

The ledger comes first: the scene changes after its line is on the disk, and the executor waits for the scene.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.reports import ExecutionReport, WorkReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.worker import WorkerError
from construction_twin.extensions.work import decisions
from construction_twin.extensions.work.building import WorkError, with_names
from construction_twin.extensions.work.ledger import Ledger
from construction_twin.extensions.work.loaded_model import Deviation, LoadedModel, pose_tuple, scene_change
from construction_twin.extensions.work.process import DEFAULT, TaskMotions
from construction_twin.extensions.work.received_messages import Received
from construction_twin.extensions.work.task_board import TaskBoard, WorkRefused
from construction_twin.extensions.work.task_memory import UNDER_WAY, Entry, TaskState
from construction_twin.extensions.work.task_recorder import TaskRecorder, restoring_change
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.description import RobotModel
from construction_twin.scene.scene_change import SceneChange

#: Longest time until a change or a plan is received [s].
SCENE_TIME = 2.0


class NoAnswer(WorkError):
    """A service did not answer; it may have done what it was asked for."""


@dataclass(frozen=True)
class UnderReview:
    """A plan that waits for a verdict."""

    message: str
    task: str
    plan_id: str
    plan_hash: str
    duration: float


@dataclass(frozen=True)
class WorkServices:
    """What the work calls; raises a ConstructionTwinError, `NoAnswer` where the call may have had its effect.

    `plan_work` takes task, source and segments; `edit_scene` the hash before, a change, and the expected hash or "".
    """

    twin_pose: Callable[[], tuple[float, ...]]
    arm_pose: Callable[[], tuple[float, ...]]
    plan: Callable[..., TaskMotions]
    plan_work: Callable[[str, str, Sequence[WorkSegment]], UnderReview]
    plan_way_back: Callable[[], str]
    edit_scene: Callable[[str, SceneChange, str], str]
    refuse: Callable[[str, str], None]
    log: Callable[[str], None]


class WorkProgress:
    """The work on a loaded model, for several threads; its ledger is called after robot and cell file.

    `clock`: [ns] since 1970. `lock`: guards board and ledger; free while another node is waited for.
    """

    def __init__(
        self,
        loaded: LoadedModel,
        folder: Path,
        robot: RobotModel,
        received: Received,
        services: WorkServices,
        clock: Callable[[], int],
    ):
        ledger = Ledger(
            folder / f"{robot.name}_{Path(loaded.cell).stem}.jsonl", loaded.predecessors, loaded.digest, clock,
            str(Path(loaded.cell).resolve()), loaded.schedule.placing, loaded.standing_elements, robot.name,
            loaded.model_elements,
        )  # fmt: skip
        self.board = TaskBoard(loaded, ledger, robot.name, robot.tip_link)
        self._received, self._services, self._clock = received, services, clock
        opened = f"{loaded.model}: {len(loaded.schedule.jobs)} tasks, {ledger.lines} lines in {ledger.path}"
        for line in (opened, *self.board.notes):
            services.log(line)
        self._recorder = TaskRecorder(
            self.board, received, Chain(robot), services.arm_pose, services.refuse, services.log
        )
        self.lock = threading.RLock()
        self._planning = threading.Lock()
        #: Why an engaged arm has no scene to go back in.
        self._blocked = ""

    def recall(self, listen_time: float) -> None:
        """Find out what became of a plan that is offered or under way in the ledger; `listen_time`: [s]."""
        received = self._received
        # nothing is tidied before it is known whether the arm was left engaged
        received.wait_for(
            lambda: received.execution is not None and not received.is_engagement_unknown, min(1.0, listen_time)
        )
        if not self.board.states.busy:
            return
        # latched messages come within a moment of the connection; the executor may only now be starting
        received.wait_for(lambda: received.execution is not None and received.is_tool_settled, listen_time)
        received.wait_for(
            lambda: received.plan is not None and not received.is_engagement_unknown, min(1.0, listen_time)
        )
        with self.lock:
            self._recorder.on_report(received.execution)
            self._recorder.settle()

    def catch_up(self) -> None:
        """Act on what was received. For one thread."""
        # one report for both: the scene may change only after what was written of it
        received, report = self._received, self._received.execution
        with self.lock:
            self._recorder.catch_up(report)
            idle = not self.board.states.busy
        self._change_as_planned(report)
        engaged = received.engaged
        if not engaged:
            self._blocked = ""
        if (idle or engaged) and not received.playing and self._planning.acquire(blocking=False):
            try:
                if engaged:
                    self._restore_scene_for_way_back()
                elif received.is_executor_settled:
                    self._tidy()
            finally:
                self._planning.release()

    # the scene is changed without the lock: the scene node is waited for

    def _change_as_planned(self, report: ExecutionReport | None) -> None:
        known, scene, states = self._received.plan, self._received.scene, self.board.states
        if report is None or known is None or scene is None:
            return
        plan = known.plan
        if not report.wants_scene or report.plan_id != plan.id or not 0 <= report.segment < len(plan.segments):
            return
        segment = plan.segments[report.segment]
        if states.busy and states.tasks[states.busy].plan == plan.id and scene.hash != segment.scene_after:
            self._edit(segment.scene, known.changes[report.segment], segment.scene_after)

    def _tidy(self) -> None:
        scene = self._received.scene
        if scene is None:
            return
        with self.lock:
            wrong = scene_change(scene, *self.board.built.wanted_scene())
        if wrong != SceneChange():
            self._edit(scene.hash, wrong)

    def _restore_scene_for_way_back(self) -> str:
        """Make the scene one in which an engaged arm can go back, after the ledger's line; return why not."""
        received, left, board = self._received, self._received.left_engaged, self.board
        if left is None:
            return Sentence(
                "the executor has not said yet where the arm was left engaged; its log says whether the disk takes it"
            )
        with self.lock:
            scene = received.scene
            if scene is None:
                return "the scene is not known; see why the scene node is down"
            if scene.hash in left.scenes:
                self._blocked = ""
                return ""
            if received.playing:
                return Sentence("a plan is under way, and the scene is not the one for the way back; wait for its end")
            self._recorder.on_report(received.execution)
            self._recorder.settle_if_lost()
            memory = board.states.tasks.get(left.task)
            if memory is not None and memory.plan == left.plan_id and memory.state in UNDER_WAY:
                return Sentence("{task}: how its plan ended is not written yet; ask again", task=board.title(left.task))
            known = received.work_plan(left.plan_id)
            segments, changes = (known.plan.segments, known.changes) if known is not None else ((), ())
            element = board.element_of(left.task) if memory is not None else ""
            forms = board.built.forms(left.task) if memory is not None else ()
            found = restoring_change(left, scene, segments, changes, element, forms)
        if isinstance(found, str):
            if found != self._blocked:
                self._services.refuse("engagement", found)
            self._blocked = found
        else:
            # tried again as long as the scene node refuses
            self._blocked = self._edit(scene.hash, found, found.apply(scene).hash)
        return self._blocked

    def _edit(self, before: str, wanted: SceneChange, after: str = "") -> str:
        """Have the scene changed and wait until it is received; return why not."""
        received = self._received
        try:
            made = self._services.edit_scene(before, wanted, after)
        except ConstructionTwinError as error:
            self._services.refuse("edit_scene", str(error))
            return str(error)
        if not received.wait_for(lambda: received.scene is not None and received.scene.hash == made, SCENE_TIME):
            return "the scene was changed, but is not published"
        return ""

    # -- planning

    def plan(self, asked: str, patience: float) -> UnderReview:
        """Have a task (empty: the next one) planned, or while the arm is engaged the way back; `patience`: [s]."""
        if not self._planning.acquire(timeout=patience):
            raise WorkRefused("a task is being planned already; wait for it")
        received = self._received
        try:
            with self.lock:
                obstacle = self.board.empty_grip_remedy(self._recorder.grip().commanded)
            if obstacle:
                raise WorkRefused(obstacle)
            if received.engaged:
                received.wait_for(lambda: not received.is_engagement_unknown, SCENE_TIME)
            return self._plan_way_back(asked) if received.engaged else self._plan_task(asked)
        finally:
            self._planning.release()
            received.notify()

    def _plannable_task(self, asked: str) -> str:
        now = self._clock()
        with self.lock:
            task = asked or self.board.next(now)
            if obstacle := self.board.obstacle(task, now) if task else self.board.summary(now):
                raise WorkRefused(obstacle)
            return task

    def _plan_task(self, asked: str) -> UnderReview:
        board = self.board
        task = self._plannable_task(asked)
        self._tidy()
        with self.lock:
            # while the scene was made right, somebody may have said something else
            self._plannable_task(task)
            memory = board.states.tasks[task]
            held = memory.tool0_T_element if memory.state is TaskState.CARRIED else ()
            scene = self._received.scene
            if scene is None:
                raise WorkRefused("the scene is not known; see why the scene node is down")
            if scene_change(scene, *board.built.wanted_scene()) != SceneChange():
                raise WorkRefused(
                    "the scene could not be made what the ledger says; /diagnostics of the node work says why"
                )
        start = self._services.twin_pose()
        try:
            plan = self._services.plan(task=task, element=board.element_of(task), start=start, scene=scene, held=held)
        except (WorkError, WorkerError) as error:
            board.failures[task] = with_names(str(error), board.loaded.titles)
            raise WorkRefused(board.failures[task]) from error
        board.failures.pop(task, None)
        self._services.log(f"{board.title(task)}: planned with {plan.method}")
        return self._offer(task, plan)

    def _offer(self, task: str, plan: TaskMotions) -> UnderReview:
        board, offer = self.board, uuid.uuid4().hex[:12]
        title, process = board.title(task), board.loaded.schedule.job(task).process
        held = () if plan.tool0_T_element is None else pose_tuple(plan.tool0_T_element)
        named = "" if process == DEFAULT else process
        with self.lock:
            self._plannable_task(task)
            board.add(Entry("offered", task, offer=offer, grip=plan.method, pose=held, process=named))
        how = f"{named}, {plan.method}" if named else plan.method

        def unnamed() -> bool:
            memory = board.states.tasks[task]
            return memory.state is TaskState.PLANNED and not memory.plan

        try:
            answer = self._services.plan_work(task, f"{title} by {how}, offer {offer}", plan.segments)
        except ConstructionTwinError as error:
            with self.lock:
                if not isinstance(error, NoAnswer):
                    board.add(Entry("dropped", task, offer=offer, reason=str(error)))
                elif unnamed():
                    self._recorder.settle_offer(task, offer)
                board.failures[task] = str(error)
            raise WorkRefused(str(error)) from error
        with self.lock:
            if unnamed():
                board.add(Entry("planned", task, plan=answer.plan_id, offer=offer))
        sentence = f"{title}: plan {answer.plan_id} of {answer.duration:.1f} s with {plan.method} waits for approval"
        return replace(answer, message=sentence)

    def _plan_way_back(self, asked: str) -> UnderReview:
        received = self._received
        obstacle = self._restore_scene_for_way_back()
        before = received.plan.plan.id if received.plan is not None else ""
        if obstacle:
            raise WorkRefused(_only_way_back(obstacle))
        try:
            answer = self._services.plan_way_back()
        except ConstructionTwinError as error:
            raise WorkRefused(_only_way_back(str(error))) from error
        received.wait_for(lambda: received.plan is not None and received.plan.plan.id != before, SCENE_TIME)
        known = received.plan
        if known is None or known.plan.id == before:
            raise WorkRefused(Sentence("the way back was planned, but is not published"))
        plan = known.plan
        sentence = Sentence("the arm is engaged: the way back comes first; {answer}", answer=answer)
        return UnderReview(sentence, asked, plan.id, plan.hash, plan.trajectory.duration)

    # -- people

    def decide(self, decision: str, task: str, answer: str, person: str, reason: str, question: str) -> str:
        """Act on a decision of a person; return a sentence."""
        board = self.board
        with self.lock:
            match decision:
                case "accept_schedule":
                    sentence = decisions.accept(board, person, reason)
                case "answer":
                    sentence = decisions.answer(board, task, answer, person, reason, question)
                    if problem := board.empty_grip_remedy(self._recorder.grip().commanded):
                        sentence = Sentence("{first}; {second}", first=sentence, second=problem)
                case "skip" | "redo" | "removed":
                    sentence = getattr(decisions, decision)(board, task, person, reason)
                case _:
                    raise WorkRefused(
                        f"decision {decision!r}; expected skip, redo, answer, removed, measured or accept_schedule"
                    )
        self._services.log(f"{sentence} ({person})")
        self._received.notify()
        return sentence

    def record_measured(self, element: str, pose: Pose, person: str, reason: str) -> Deviation:
        """Record where a person has measured an element."""
        with self.lock:
            found = decisions.record_measured(self.board, element, pose, person, reason)
        self._received.notify()
        return found

    def state_report(self) -> WorkReport:
        """Return the state of the work."""
        with self.lock:
            report = self.board.state_report(self._clock())
        if self._received.execution is None or not self._received.execution.engaged:
            return report
        return replace(report, engaged=True, reason=_only_way_back(self._blocked))


def _only_way_back(problem: str) -> str:
    if not problem:
        return Sentence("the arm is engaged: only the way back can be planned")
    return Sentence("the arm is engaged: only the way back can be planned, and not yet: {problem}", problem=problem)
