"""The work node among scripted neighbours, without ROS: worker, planner, executor, scene node and tool, for one task.

What the node publishes and asks for is noted in the order in which it happens, with the ledger's last line on the disk at that
moment. Messages go through the wire format.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import rospy
import work_samples
from construction_twin.msg import Engagement, Execution, Review, ToolState
from construction_twin.srv import (
    EditSceneResponse,
    PlanWorkResponse,
    WorkPlanTaskRequest,
    WorkPlanTaskResponse,
)
from executor_bench import ROBOT, joined, reach
from plan_samples import make_report
from std_srvs.srv import TriggerResponse
from unplugged import ask, over_the_wire

from construction_twin.core.errors import RequestRefused
from construction_twin.core.freshness import Moment
from construction_twin.extensions.work import work_progress
from construction_twin.extensions.work.layout import Slot, StockPlan
from construction_twin.extensions.work.ledger import read_entries
from construction_twin.extensions.work.loaded_model import ElementFacts, LoadedModel
from construction_twin.extensions.work.nodes import work as module
from construction_twin.extensions.work.schedule import Job, Schedule
from construction_twin.extensions.work.task_board import TaskBoard
from construction_twin.extensions.work.task_memory import Entry
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.review.plan_under_review import ExecutionEnd, Verdict
from construction_twin.review.record import ReviewLog
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment, Signal, Switch
from construction_twin.ros.messages.convert import plan_to_msg, work_segment_from_msg
from construction_twin.ros.messages.scene_convert import object_from_msg, scene_to_msg
from construction_twin.scene.objects import Scene, SceneObject, product
from construction_twin.scene.scene_change import SceneChange

TASK, ELEMENT = "T1", "E1"
_CHAIN = Chain(ROBOT)
_STOCK, _GOAL = (np.array(ROBOT.home) + np.radians([turn, 10, 0, 0, 0, 0]) for turn in (-40, 40))
HOME, AT_STOCK, AT_GOAL = (tuple(map(float, q)) for q in (ROBOT.home, _STOCK, _GOAL))
HELD = Pose(np.array([0.0, 0.0, 0.3]), np.eye(3))
BODY = SceneObject(f"{ELEMENT}/0", "box", (0.1, 0.1, 0.1))
IN_STOCK, PLACED = (BODY.moved(product(_CHAIN.forward(q), HELD)) for q in (AT_STOCK, AT_GOAL))
GRIPPED = BODY.moved(HELD, ROBOT.tip_link)
POST = SceneObject("tool/post", "box", (0.1, 0.1, 0.1), link=ROBOT.tip_link)
FLOOR = SceneObject("floor", "box", (20.0, 20.0, 1.0), (0.0, 0.0, -0.5))
#: Numbers of the plan's segments.
FETCH, GRIP, CARRY, LEAVE = range(4)


def loaded_model() -> LoadedModel:
    """Return a model of one element, which one task places."""
    goal, stock = (product(_CHAIN.forward(q), HELD) for q in (AT_GOAL, AT_STOCK))
    facts = ElementFacts("stud", (BODY,), goal, np.zeros((1, 3, 3)))
    schedule = Schedule((Job(TASK, TASK, "Place stud", ELEMENT, (), ()),), (), False)
    slots = StockPlan({ELEMENT: Slot(ELEMENT, "rack", 1, 0, stock, "")})
    tool = work_samples.tool().tool
    return LoadedModel("panel.ifc", "a" * 64, "/cell.yaml", schedule, "s" * 64, {ELEMENT: facts}, slots, tool, (POST,))


def segments() -> tuple[WorkSegment, ...]:
    """Return what the worker plans: fetch, grip, carry and let go, leave."""
    close = Switch("vacuum", True, (Signal("vacuum_reached", True),), 3.0)
    open_ = Switch("vacuum", False, (Signal("vacuum_reached", False),), 3.0)
    above = tuple(0.5 * (a + b) for a, b in zip(HOME, AT_STOCK))
    made: list[WorkSegment] = []
    for name, begin, end, engaged, switches, put in (
        ("fetch", HOME, above, False, (), ()),
        ("grip", above, AT_STOCK, True, (close,), (GRIPPED,)),
        ("carry", AT_STOCK, AT_GOAL, True, (open_,), (PLACED,)),
        ("leave", AT_GOAL, HOME, False, (), ()),
    ):
        made.append(WorkSegment(name, reach(begin, end, 1.0, 9), engaged, (), switches, SceneChange(put)))
    return tuple(made)


class Killed(Exception):
    """The node ends at this point."""


class Bench:
    """The node and its neighbours.

    Attributes:
        scene_refuses: Why the scene node changes nothing.
        planner_dies: ``before`` or ``after`` it has published a plan: it does not answer then. ``node``: the node ends instead, by
            `Killed`.
        noted: What the node asked others for, and the event of the ledger's last line on the disk then.
    """

    def __init__(self, monkeypatch, folder: Path):
        self._folder = folder
        self.scene = Scene((FLOOR,), 0.01)
        self.scene_refuses = self.planner_dies = ""
        self.publishers = {"execution": 1, "plan": 1, "tool": 1}
        self.arm_pose: Callable[[], tuple[float, ...]] = lambda: AT_GOAL
        self.noted: list[tuple[str, str]] = []
        self.refused: list[tuple[str, str]] = []
        self.tasks: list = []
        self._plans = 0
        monkeypatch.setenv("ROS_HOME", str(folder))
        monkeypatch.setattr(work_progress, "SCENE_TIME", 0.05)
        monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(7))
        for level in ("loginfo", "logwarn", "logerr"):
            monkeypatch.setattr(rospy, level, lambda *_: None)
        self._patch = monkeypatch.setattr
        self._patch(rospy, "on_shutdown", lambda _: None)
        frames = SimpleNamespace(in_base=lambda *_: Pose(np.zeros(3), np.eye(3)))
        self._patch(module, "listen_to_frames", lambda *_: frames)
        self.start()

    def start(self, worker=None, **files: str) -> None:
        """Start a node that has heard nothing yet, with a worker and files of its own if they are given."""
        settings = module.Settings(
            model="panel.ifc", cell="/cell.yaml", self_collision="", tf_prefix="",
            folder="work", arm="mock", service_timeout=1.0, listen_time=0.02, retry_time=0.01,
        ).model_copy(update=files)  # fmt: skip
        made = worker or SimpleNamespace(ask_first=lambda *_, **__: loaded_model(), ask=self._planned, close=None)
        self._patch(module, "Worker", lambda _program: made)
        poses = {"twin": lambda *_: HOME, "physical": lambda *_: self.arm_pose()}
        takers = {"tasks": lambda message: self.tasks.append(over_the_wire(message)), "markers": lambda _: None}
        ports = SimpleNamespace(
            parameters={"planner": {}, module.RECORD: str(self.review_file)},
            poses={f"{of}/joint_states": SimpleNamespace(pose=pose) for of, pose in poses.items()},
            publishers={f"work/{topic}": SimpleNamespace(publish=take) for topic, take in takers.items()},
            connections=self.publishers.__getitem__,
            diagnostics=SimpleNamespace(refuse=self.refuse, count=self.refuse),
        )
        self.node = module.WorkNode(settings, ROBOT, ports)
        self.node._call = self._call
        self.received = self.node.received

    def ready(self) -> Bench:
        """Read the model beside an executor that rests and a tool that is open; the scene gets tool and stock."""
        self.show()
        self.execution(Execution.IDLE)
        self.tool(False)
        self.node.open()
        return self.run()

    def kill(self) -> None:
        """End the node where it stands; what it had heard is lost, the ledger is not."""
        self.board.ledger.close()
        self.noted.clear()
        self.tasks.clear()

    @property
    def board(self) -> TaskBoard:
        """The node's board of tasks."""
        return self.node.progress.board

    def run(self, times: int = 8) -> Bench:
        """Let the node do what follows from all it has heard, and try again what does not work."""
        for _ in range(times):
            self.node.run_once()
        return self

    # -- what the node hears

    def hear(self, topic: str, message) -> None:
        """Publish a message on one of the topics that the node hears."""
        (one,) = (one for one in module.INTERFACE.subscribes if one.topic == topic)
        one.handler(self.node, over_the_wire(message))

    def show(self, scene: Scene | None = None) -> None:
        """Publish the scene, or another one from now on."""
        self.scene = scene or self.scene
        self.hear("scene", scene_to_msg(self.scene, rospy.Time(6), "base_link"))

    def execution(self, state: int, segment: int = -1, **fields) -> None:
        """Publish what the executor does; `plan_id` is the offered plan's while it plays."""
        if state not in (Execution.IDLE, Execution.WAITING):
            fields.setdefault("plan_id", self.plan.id)
        self.hear("execution", Execution(state=state, segment=segment, **fields))

    def tool(self, closed: bool, commanded: bool | None = None) -> None:
        """Publish what the tool reads; `commanded` is what its output reads, by default the same as its input."""
        output = closed if commanded is None else commanded
        said = ToolState(
            known=True, outputs=["vacuum"], output_values=[output], inputs=["vacuum_reached"], input_values=[closed]
        )
        self.hear("tool", said)

    def left_engaged(self, segment: str, *scenes: str) -> None:
        """Publish where the arm was left engaged, and in which scenes it may go back."""
        message = Engagement(
            engaged=True, plan_id=self.plan.id, task=TASK, segment=segment, reason="a person", scenes=scenes
        )
        self.hear("engagement", message)

    def verdict(self, approved: bool, plan_id: str = "", reason: str = "") -> None:
        """Publish a person's verdict on the offered plan, or on another."""
        message = Review(plan_id=plan_id or self.plan.id, approved=approved, reviewer="Ada", reason=reason)
        self.hear("review", message)

    # -- what the executor keeps

    @property
    def review_file(self) -> Path:
        """The record of verdicts."""
        return self._folder / "reviews.jsonl"

    def record(self, approved: bool, outcome: str = "") -> None:
        """Write a verdict on the offered plan into the record, and how its execution ended."""
        log = ReviewLog(self.review_file, lambda: 7)
        plan = self.plan
        log.append(Verdict("approved" if approved else "rejected", plan.id, plan.hash, "Ada", "", plan))
        if outcome:
            log.append(ExecutionEnd(plan, outcome, ""))
        log.close()

    def refuse(self, *said) -> None:
        """Note what is refused."""
        self.refused.append(said)

    # -- what the node does

    def ask(self, task: str = TASK) -> WorkPlanTaskResponse:
        """Ask for a plan as a person would."""
        return self.call("work/plan", WorkPlanTaskRequest(task))

    def call(self, name: str, request):
        """Return the answer of one of the node's services."""
        return ask(module.NODE, self.node, name, over_the_wire(request), self.refuse)

    def play(self, segment: int, at_boundary: bool = False, wants_scene: bool = False) -> Bench:
        """Have the executor say where it is, and the node act on it."""
        state = Execution.AT_BOUNDARY if at_boundary else Execution.PLAYING
        self.execution(state, segment, at_boundary=at_boundary, wants_scene=wants_scene)
        return self.run()

    def planned(self) -> Bench:
        """Have the task planned; its plan waits for a verdict."""
        answer = self.ready().ask()
        assert answer.success, answer.message
        self.noted.clear()
        return self.run()

    def carrying(self) -> Bench:
        """Play until the element is carried."""
        self.planned().play(FETCH).play(GRIP).tool(True)
        return self.play(GRIP, True).play(GRIP, True, True).play(CARRY)

    @property
    def entries(self) -> list[Entry]:
        """The ledger's lines about the task, as they are on the disk."""
        (path,) = (self._folder / "work").glob("*.jsonl")
        return [entry for entry in read_entries(path) if entry.task == TASK]

    @property
    def ledger_lines(self) -> list[str]:
        """The ledger as it is on the disk."""
        (path,) = (self._folder / "work").glob("*.jsonl")
        return path.read_text().splitlines()

    @property
    def events(self) -> list[str]:
        """The words of those lines."""
        return [entry.event for entry in self.entries]

    @property
    def row(self):
        """The task as it was published last."""
        return self.tasks[-1].tasks[0]

    def _note(self, what: str) -> None:
        self.noted.append((what, (self.events or [""])[-1]))

    # -- the neighbours

    def _planned(self, *_, **__) -> SimpleNamespace:
        return SimpleNamespace(method="top", segments=segments(), tool0_T_element=HELD)

    def _call(self, name: str, kind, **fields):
        self._note(name)
        answer = over_the_wire(getattr(self, f"_{name}")(over_the_wire(kind._request_class(**fields))))
        if not answer.success:
            raise RequestRefused(answer.message)
        return answer

    def _edit_scene(self, request) -> EditSceneResponse:
        try:
            if self.scene_refuses:
                raise SceneError("the scene", self.scene_refuses, "another one")
            wanted = SceneChange(tuple(map(object_from_msg, request.put)), tuple(request.remove))
            scene = wanted.apply_checked(self.scene, request.before, request.after)
        except SceneError as error:
            return EditSceneResponse(False, str(error), self.scene.hash)
        self.show(scene)
        return EditSceneResponse(True, "changed", scene.hash)

    def _plan_work(self, request) -> PlanWorkResponse:
        if self.planner_dies == "before":
            raise work_progress.NoAnswer("the planner does not answer")
        work = [work_segment_from_msg(segment) for segment in request.segments]
        scene, end, parts = self.scene, 0.0, []
        for each in work:
            end, after = end + each.trajectory.duration, each.change.apply(scene)
            parts.append(Segment(each.name, end, each.engaged, each.requires, each.switches, scene.hash, after.hash))
            scene = after
        motion = joined(*(each.trajectory for each in work))
        self._publish_plan(motion, request.source, request.task, tuple(parts), [each.change for each in work])
        if self.planner_dies == "node":
            raise Killed
        if self.planner_dies == "after":
            raise work_progress.NoAnswer("the planner does not answer")
        plan = self.plan
        return PlanWorkResponse(True, "planned", plan.id, plan.hash, plan.trajectory.duration, "")

    def _plan_way_back(self, _) -> TriggerResponse:
        motion, here = reach(AT_STOCK, HOME, 1.0, 9), self.scene.hash
        back = Segment("way back", motion.duration, True, (), (), here, here)
        work = self.plan
        self._publish_plan(motion, "way back", TASK, (back,), (SceneChange(),))
        self.plan = work
        return TriggerResponse(True, "the way back waits")

    def _publish_plan(self, motion, source: str, task: str, parts: tuple[Segment, ...], changes) -> None:
        self._plans += 1
        self.plan = Plan(
            f"p{self._plans}", content_hash(motion, task, parts), source, "work", parts[0].scene, Moment("c0ffee00", 7), 0.0,
            motion, make_report(len(ROBOT.joint_names)), task=task, segments=parts,
        )  # fmt: skip
        self._published = plan_to_msg(self.plan, "base_link", np.zeros((0, 3)), changes)
        self.publish_plan()

    def publish_plan(self) -> None:
        """Publish the plan that was published last, as a latched topic does for a node that comes later."""
        self.hear("plan", self._published)
