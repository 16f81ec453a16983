"""The node `rehearsal`: which plan it rehearses in which scenes and with which masses, and what it says when that breaks off."""

from __future__ import annotations

import dataclasses
import math
import threading

import numpy as np
import pytest
import rospy
from construction_twin.msg import Rehearsal, Review, WorkTask, WorkTasks
from plan_samples import make_plan
from planning_cell import HOME, RIGHT, ROBOT, ROOT, work_plan
from unplugged import Unplugged

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.extensions import check_extras
from construction_twin.core.worker import Worker, WorkerError
from construction_twin.extensions.physics.nodes import rehearsal as module
from construction_twin.extensions.physics.nodes.rehearsal import NODE, Settings
from construction_twin.extensions.physics.process import PROGRAM, RehearsalRequest
from construction_twin.planning.timing import time_path
from construction_twin.review.rehearsal_report import BROKEN, FAILED, PASSED, RehearsalReport, with_hash
from construction_twin.robot.plan import Plan
from construction_twin.robot.tool import tool_hash
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.ros.messages.records import from_msg, to_msg
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

STOCK = SceneObject("beam/0", "box", (0.1, 0.1, 1.0), (1.0, -1.0, 0.5))
HELD = dataclasses.replace(STOCK, position=(0.0, 0.0, 0.55), link="tool0", touch=("link_6",))
BUILT = dataclasses.replace(STOCK, position=(1.0, 1.0, 0.5))
SCENES = [Scene((item,), 0.01) for item in (STOCK, HELD, BUILT)]
CHANGES = (SceneChange((HELD,)), SceneChange((BUILT,)), SceneChange())
SETTINGS = Settings(
    mode="advise",
    time_limit=60.0,
    drives=str(ROOT / "config/kr120_drives.yaml"),
    tool="",
    self_collision=str(ROOT / "config/kr120_self_collision.yaml"),
)
#: No test waits longer than this for what must come [s].
SOON = 60.0


def plain_plan(name: str = "p") -> Plan:
    return make_plan(time_path(np.array([HOME, RIGHT]), ROBOT), name, SCENES[0].hash)


class Process:
    """What rehearses, as the node sees it: it answers at once, or as a test says."""

    def __init__(self):
        self.requests: list[RehearsalRequest] = []
        self.closed = 0
        self.asked, self.interrupted = threading.Event(), threading.Event()
        self.answers = True
        self.error: WorkerError | None = None
        self.interrupts = 0

    def ask(self, name, arm, request: RehearsalRequest) -> RehearsalReport:
        assert name == "rehearse"
        self.tool = tool_hash(arm["tool"])
        self.requests.append(request)
        self.asked.set()
        if self.error is not None:
            raise self.error
        if not self.answers:
            assert self.interrupted.wait(SOON)
            raise WorkerError("", "signal 9")
        plan = request.plan
        return with_hash(RehearsalReport(plan.id, plan.hash, plan.scene, self.tool, request.inputs, PASSED), 0.1)

    def interrupt(self) -> None:
        self.interrupts += 1
        self.interrupted.set()

    def close(self) -> None:
        self.closed += 1
        self.interrupted.clear()
        self.answers = True


class Bench:
    """The node without ROS."""

    def __init__(self, monkeypatch, **changes):
        self.process = Process()
        monkeypatch.setattr(module, "Worker", lambda program: self.process)
        monkeypatch.setattr(module, "check_extras", lambda group: None)
        monkeypatch.setattr(module, "now_ns", lambda: 5)
        monkeypatch.setattr(module, "SCENE_DELAY", 0.0)
        monkeypatch.setattr(module.rospy, "is_shutdown", lambda: False)
        self.settings = SETTINGS.model_copy(update=changes)
        self.plug = Unplugged(monkeypatch, NODE, self.settings, ROBOT)
        self.node, self.published = self.plug.node, self.plug.published["rehearsal"]
        # nobody says what an element weighs
        self.plug.callbacks["work/tasks"](WorkTasks())

    def send_plan(self, plan: Plan, changes=CHANGES) -> None:
        path = np.zeros((len(plan.trajectory.times), 3))
        self.plug.callbacks["plan"](plan_to_msg(plan, "base_link", path, changes if plan.segments else ()))

    def send_verdict(self, name: str, approved: bool = False) -> None:
        self.plug.callbacks["review"](Review(plan_id=name, approved=approved, reviewer="executor"))

    def begin(self, name: str) -> threading.Thread:
        """Have a plan rehearsed, by a process that does not come to an end, and return who waits for it."""
        self.process.answers = False
        self.process.asked.clear()
        self.send_plan(plain_plan(name))
        running = threading.Thread(target=self.node.work, args=(0.0,))
        running.start()
        assert self.process.asked.wait(SOON)
        return running

    @property
    def rehearsed(self) -> list[str]:
        """Return the plans of which a result was told, when nothing waits any more."""
        for _ in range(5):
            self.node.work(0.0)
        return [message.plan_id for message in self.published]

    def send_scene(self, scene: Scene = SCENES[0]) -> None:
        self.plug.callbacks["scene"](scene_to_msg(scene, rospy.Time(1), "base_link"))

    @property
    def newest(self) -> RehearsalReport:
        return from_msg(RehearsalReport, self.published[-1])


@pytest.fixture
def bench(monkeypatch) -> Bench:
    return Bench(monkeypatch)


class TestWhatIsRehearsed:
    def test_each_plan_in_the_scene_that_it_begins_in(self, bench):
        bench.send_scene()
        plan = plain_plan()
        bench.send_plan(plan)
        bench.node.work(0.0)
        (request,) = bench.process.requests
        assert (request.plan.hash, set(request.scenes)) == (plan.hash, {SCENES[0].hash})
        found = bench.newest
        assert (found.plan_id, found.plan_hash, found.scene, found.state, found.stamp) == (
            "p", plan.hash, SCENES[0].hash, PASSED, 5,
        )  # fmt: skip

    def test_of_a_work_plan_the_scenes_of_all_its_segments(self, bench):
        bench.send_scene()
        bench.send_plan(work_plan(SCENES))
        bench.node.work(0.0)
        assert set(bench.process.requests[0].scenes) == {scene.hash for scene in SCENES}

    def test_a_change_that_leads_elsewhere_is_a_broken_rehearsal(self, bench):
        bench.send_scene()
        bench.send_plan(work_plan(SCENES), (SceneChange((BUILT,)), *CHANGES[1:]))
        bench.node.work(0.0)
        assert bench.newest.state == BROKEN and SCENES[1].hash in bench.newest.reasons[0]
        assert bench.process.requests == []


class TestAPlanThatTheExecutorRefuses:
    """It has superseded the one under review, which is taken up again."""

    def test_while_it_is_rehearsed(self, bench):
        bench.send_scene()
        bench.send_plan(plain_plan("p1"))
        running = bench.begin("p2")
        bench.send_verdict("p2")
        running.join(SOON)
        assert not running.is_alive()
        assert bench.rehearsed == ["p1"]


class TestMasses:
    def test_of_the_tool_and_of_what_its_task_carries(self, monkeypatch):
        bench = Bench(monkeypatch, tool=str(ROOT / "config/tools/vacuum_frame.yaml"))
        tasks = [
            WorkTask(id=name, element=name, mass_kg=mass)
            for name, mass in (("beam", 42.0), ("u", math.nan), ("v", 3.0))
        ]
        bench.plug.callbacks["work/tasks"](WorkTasks(tasks=tasks))
        bench.send_scene()
        bench.send_plan(work_plan(SCENES))
        bench.node.work(0.0)
        assert bench.process.requests[0].masses == {"beam": 42.0}
        frame = dataclasses.replace(STOCK, name="tool/frame", link="tool0")
        equipped = Scene((frame,), 0.01)
        bench.send_scene(equipped)
        bench.send_plan(dataclasses.replace(plain_plan("p2"), scene=equipped.hash))
        bench.node.work(0.0)
        assert bench.process.requests[1].masses == {"tool": 18.0}
        assert bench.newest.tool == tool_hash(bench.settings.tool) != ""

    def test_of_what_earlier_tasks_have_placed_and_who_says_none_is_named(self, bench):
        stands = [dataclasses.replace(STOCK, name=f"{name}/0") for name in ("laid", "guessed", "waits")]
        scene = Scene((*SCENES[0].objects, *stands), 0.01)
        bench.send_scene(scene)
        hashes = []
        # what is not in the scene counts for nothing
        for state in ("done", "ready"):
            tasks = [
                WorkTask(id=name, element=name, mass_kg=mass, state=said)
                for name, mass, said in (
                    ("laid", 3.5, state), ("guessed", math.nan, "done"), ("waits", 3.5, "ready"), ("gone", 3.5, "done"),
                )
            ]  # fmt: skip
            bench.plug.callbacks["work/tasks"](WorkTasks(tasks=tasks))
            bench.send_plan(dataclasses.replace(plain_plan(state), scene=scene.hash))
            bench.node.work(0.0)
            hashes.append(bench.newest.inputs)
        laid, ready = bench.process.requests
        assert (laid.masses, laid.standing, laid.unweighed) == ({"laid": 3.5}, ("laid",), ("guessed",))
        assert (ready.masses, ready.standing, ready.unweighed) == ({}, (), ("guessed",))
        assert hashes[0] != hashes[1]


class TestBroken:
    def test_a_work_plan_whose_tasks_were_not_heard_is_not_rehearsed_with_a_guess(self, monkeypatch):
        bench = Bench(monkeypatch)
        silent = Unplugged(monkeypatch, NODE, SETTINGS, ROBOT)
        bench.plug, bench.node, bench.published = silent, silent.node, silent.published["rehearsal"]
        bench.send_scene()
        bench.send_plan(work_plan(SCENES))
        bench.node.work(0.0)
        assert bench.newest.state == BROKEN and "task t" in bench.newest.reasons[0]
        # a plan of no task needs none
        bench.send_plan(plain_plan())
        bench.node.work(0.0)
        assert bench.newest.state == PASSED

    def test_a_process_that_ends_is_an_answer_and_the_next_plan_has_its_own(self, bench):
        bench.send_scene()
        bench.process.error = WorkerError("", "signal 11")
        bench.send_plan(plain_plan("p1"))
        bench.node.work(0.0)
        assert bench.newest.state == BROKEN and "signal 11" in bench.newest.reasons[0]
        bench.process.error = None
        bench.send_plan(plain_plan("p2"))
        bench.node.work(0.0)
        assert (bench.newest.plan_id, bench.newest.state) == ("p2", PASSED)

    def test_one_that_is_late_is_broken_off_and_says_so(self, monkeypatch):
        bench = Bench(monkeypatch, time_limit=0.01)
        bench.process.answers = False
        bench.send_scene()
        bench.send_plan(plain_plan())
        bench.node.work(0.0)
        assert bench.newest.state == BROKEN and "0.01 s" in bench.newest.reasons[0]
        assert bench.process.closed == 1

    def test_a_newer_plan_supersedes_the_one_that_runs(self, bench):
        bench.process.answers = False
        bench.send_scene()
        bench.send_plan(plain_plan("p1"))
        running = threading.Thread(target=bench.node.work, args=(0.0,))
        running.start()
        assert bench.process.asked.wait(SOON)
        bench.send_plan(plain_plan("p2"))
        running.join(SOON)
        assert not running.is_alive() and bench.published == []
        bench.node.work(0.0)
        assert (bench.newest.plan_id, bench.newest.state) == ("p2", PASSED)

    def test_a_message_that_is_no_plan_is_refused_and_counted(self, bench):
        message = plan_to_msg(plain_plan(), "base_link", np.zeros((2, 3)))
        message.hash = "0" * 64
        bench.plug.callbacks["plan"](message)
        assert [reason for reason, _ in bench.plug.refused] == ["plan"]


def test_without_mujoco_it_rests_where_nobody_asked_for_it_and_else_does_not_start(monkeypatch):
    def missing(group):
        raise ConfigurationError("mujoco", None, "that it is installed")

    bench = Bench(monkeypatch, mode="auto")
    monkeypatch.setattr(module, "check_extras", missing)
    rests = Unplugged(monkeypatch, NODE, SETTINGS.model_copy(update={"mode": "auto"}), ROBOT)
    rests.callbacks["plan"](plan_to_msg(plain_plan(), "base_link", np.zeros((2, 3))))
    rests.node.work(0.0)
    assert rests.published["rehearsal"] == [] and bench.process.requests == []
    assert "mujoco" in rests.node.diagnose().sentence
    NODE.check(SETTINGS.model_copy(update={"mode": "auto"}), ROBOT, {})
    with pytest.raises(ConfigurationError):
        NODE.check(SETTINGS, ROBOT, {})


def test_the_process_rehearses_a_plan_and_its_result_crosses_the_topic_unchanged():
    check_extras("physics")
    process = Worker(PROGRAM)
    try:
        tool = str(ROOT / "config/tools/vacuum_frame.yaml")
        arm = {"robot": ROBOT, "self_collision": SETTINGS.self_collision, "drives": SETTINGS.drives, "tool": tool}
        plan = plain_plan()
        request = RehearsalRequest(plan, {SCENES[0].hash: SCENES[0]}, {}, "i")
        report = process.ask("rehearse", arm=arm, request=request)
        assert (report.state, report.plan_hash, report.inputs) == (PASSED, plan.hash, "i"), report.reasons
        assert report.tool == tool_hash(tool)
        assert [axis.joint for axis in report.axes] == list(ROBOT.joint_names)
        back = from_msg(RehearsalReport, to_msg(report, Rehearsal))
        assert with_hash(back, back.took).hash == report.hash == back.hash
        assert back == report
        # a held beam that weighs far more than the arm may carry
        work = work_plan(SCENES)
        scenes = {scene.hash: scene for scene in SCENES}
        heavy = process.ask("rehearse", arm=arm, request=RehearsalRequest(work, scenes, {"beam": 240.0}, "i"))
        assert heavy.state == FAILED and heavy.payload.mass == pytest.approx(240.0)
        assert not heavy.payload.estimated and "240.0 kg" in heavy.reasons[0]
    finally:
        process.close()
