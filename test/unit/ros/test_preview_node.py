"""The preview node's markers of a work plan: all of it in every message, and the element in the ghost's grip."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rospy
from construction_twin.msg import Rehearsal
from construction_twin.srv import PreviewPlanRequest
from plan_samples import make_plan
from planning_cell import HOME, LEFT, RIGHT, ROBOT
from unplugged import Unplugged
from visualization_msgs.msg import Marker

from construction_twin.core.errors import PoseUnknownError
from construction_twin.kinematics.chain import Chain
from construction_twin.physics.report import FAILED, PASSED, AxisLoad, RehearsalReport, RehearsedContact, finished
from construction_twin.planning.timing import time_path
from construction_twin.planning.work_plan import joined
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment
from construction_twin.ros.messages.convert import plan_to_msg
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.ros.nodes import preview as module
from construction_twin.ros.nodes.preview import NODE, Settings
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

STOCK = SceneObject("beam/0", "box", (0.1, 0.1, 1.0), (1.0, -1.0, 0.5))
HELD = dataclasses.replace(STOCK, position=(0.0, 0.0, 0.5), link="tool0")
BUILT = dataclasses.replace(STOCK, position=(1.0, 1.0, 0.5))
SCENES = [Scene((item,), 0.01) for item in (STOCK, HELD, BUILT)]
CHANGES = (SceneChange((HELD,)), SceneChange((BUILT,)), SceneChange())


def work_plan() -> Plan:
    motion, ends = joined([time_path(np.array(pair), ROBOT) for pair in ((HOME, RIGHT), (RIGHT, LEFT), (LEFT, HOME))])
    hashes = [scene.hash for scene in (*SCENES, SCENES[2])]
    segments = tuple(
        Segment(name, end, name == "carry", (), (), *hashes[number : number + 2])
        for number, (name, end) in enumerate(zip(("fetch", "carry", "home"), ends))
    )
    made = make_plan(motion, "w1", hashes[0])
    return dataclasses.replace(made, hash=content_hash(motion, "t", segments), task="t", segments=segments)


class Bench:
    """The node without ROS; the markers as rviz would hold them."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        patch = monkeypatch.setattr
        patch(module, "now_ns", lambda: 0)
        patch(module.time, "monotonic", lambda: self.now)
        settings = Settings(tf_prefix="kr120/preview")
        unplugged = Unplugged(monkeypatch, NODE, settings, ROBOT, self.unknown)
        self.callbacks, self.services, self.refused = unplugged.callbacks, unplugged.services, unplugged.refused
        self.messages = unplugged.published["plan_markers"]
        self.rehearsals = unplugged.published["rehearsal_markers"]
        self.ghosts = unplugged.published["preview/joint_states"]
        (self._timer,) = unplugged.timers

    def unknown(self, _):
        raise PoseUnknownError("twin/joint_states", 1.0, 0.5)

    def hear_plan(self, plan: Plan) -> None:
        path = np.zeros((len(plan.trajectory.times), 3))
        self.callbacks["plan"](plan_to_msg(plan, "kr120/twin/base_link", path, CHANGES if plan.segments else ()))

    def hear_scene(self, scene: Scene) -> None:
        self.callbacks["scene"](scene_to_msg(scene, rospy.Time(1), "kr120/twin/base_link"))

    def at(self, now: float) -> None:
        self.now = now
        self._timer(None)

    def shown(self, namespace: str) -> list[Marker]:
        """Markers of a namespace in the newest message, which stands alone: it begins with the removal of all others."""
        first, *markers = self.messages[-1].markers
        assert first.action == Marker.DELETEALL
        return [marker for marker in markers if marker.ns == namespace]


@pytest.fixture
def bench(monkeypatch) -> Bench:
    made = Bench(monkeypatch)
    made.hear_scene(SCENES[0])
    made.hear_plan(work_plan())
    return made


def test_a_work_plan_is_drawn_with_paths_ends_names_and_the_placed_element(bench):
    assert [len(marker.points) > 1 for marker in bench.shown("plan_path")] == [True] * 3
    fetch, carry, home = bench.shown("plan_path")
    assert carry.color != fetch.color and carry.scale.x > fetch.scale.x and home.color.b < carry.color.b
    assert [marker.text for marker in bench.shown("plan_names")] == ["1 fetch", "2 carry", "3 home"]
    (placed,) = bench.shown("plan_placed")
    assert (placed.header.frame_id, placed.pose.position.y, placed.color.a < 1.0) == ("kr120/twin/base_link", 1.0, True)
    text = bench.shown("plan")[0].text
    assert "2 carry" in text and "LOOK TWICE" not in text


def test_the_ghost_has_the_element_in_its_grip_while_it_carries_it(bench):
    ends = [segment.end for segment in work_plan().segments]
    assert bench.shown("plan_grip") == []
    assert bench.services["preview_plan"](PreviewPlanRequest(speed=1.0, loop=False)).success
    bench.at(100.0 + ends[0] - 0.01)
    assert bench.shown("plan_grip") == []
    bench.at(100.0 + ends[0] + 0.01)
    (grip,) = bench.shown("plan_grip")
    # it moves with the ghost's tool, not with the twin's
    assert (grip.header.frame_id, grip.frame_locked, grip.pose.position.z) == ("kr120/preview/tool0", True, 0.5)
    assert len(bench.shown("plan_path")) == 3
    count = len(bench.messages)
    bench.at(100.0 + ends[1] - 0.01)
    assert len(bench.messages) == count
    bench.at(100.0 + ends[1] + 0.01)
    assert bench.shown("plan_grip") == []


def test_a_plan_with_an_object_that_makes_no_sense_is_refused(bench):
    path = np.zeros((len(work_plan().trajectory.times), 3))
    message = plan_to_msg(dataclasses.replace(work_plan(), id="w2"), "base", path, CHANGES)
    message.segments[0].put[0].size = [-1.0, 1.0, 1.0]
    count = len(bench.messages)
    bench.callbacks["plan"](message)
    assert len(bench.messages) == count and "beam/0" in bench.refused[0][1]


# -- its rehearsal


def rehearsal(plan: Plan, **changes) -> Rehearsal:
    axes = tuple(AxisLoad(f"joint_a{number}", 100.0 * number, 0.0, 0.0, 0.0, 500.0, False) for number in range(1, 7))
    contact = RehearsedContact("link_5", "wall", 0.5, (1.0, 0.5, 1.5), 90.0, 0.1)
    report = RehearsalReport(
        plan.id, plan.hash, plan.scene, state=PASSED, axes=axes, contacts=(contact,), worst_time=0.1,
        worst_pose=tuple(HOME.tolist()),
    )  # fmt: skip
    return to_msg(finished(dataclasses.replace(report, **changes), 0.1), Rehearsal)


class Rehearsed(Bench):
    """The same, with what is heard of rehearsals."""

    def hear_rehearsal(self, message: Rehearsal) -> None:
        self.callbacks["rehearsal"](message)

    def namespaces(self) -> list[str]:
        """Namespaces of the newest markers of a rehearsal, each once; they begin with the removal of all before."""
        first, *markers = self.rehearsals[-1].markers
        assert first.action == Marker.DELETEALL
        return list(dict.fromkeys(marker.ns for marker in markers))


PARTS = [
    "rehearsal_arm", "rehearsal_torques", "rehearsal_limits", "rehearsal_axes", "rehearsal_contacts",
    "rehearsal_contact_names", "rehearsal",
]  # fmt: skip


def plain_plan() -> Plan:
    return make_plan(time_path(np.array([HOME, RIGHT]), ROBOT), "p2", SCENES[0].hash)


@pytest.fixture
def rehearsed(monkeypatch) -> Rehearsed:
    made = Rehearsed(monkeypatch)
    made.hear_scene(SCENES[0])
    return made


@pytest.mark.parametrize("first", ["plan", "rehearsal"])
def test_the_rehearsal_of_the_plan_under_review_is_drawn_whichever_comes_first(rehearsed, first):
    plan = plain_plan()
    if first == "plan":
        rehearsed.hear_plan(plan)
    rehearsed.hear_rehearsal(rehearsal(plan))
    if first == "rehearsal":
        assert rehearsed.rehearsals == []
        rehearsed.hear_plan(plan)
    assert rehearsed.namespaces() == PARTS
    markers = rehearsed.rehearsals[-1].markers[1:]
    assert {marker.header.frame_id for marker in markers} == {"kr120/twin/base_link"}
    assert [m.text for m in markers if m.ns == "rehearsal_axes"][1] == "A2 40 %"
    (place,) = [m.pose.position for m in markers if m.ns == "rehearsal_contacts"]
    assert (place.x, place.y, place.z) == (1.0, 0.5, 1.5)
    # the arm's first link stands where it always does, the last one where the pose brings it
    arm = [m for m in markers if m.ns == "rehearsal_arm"]
    tip = Chain(ROBOT).forward(HOME).position
    assert np.linalg.norm(np.array([arm[-1].pose.position.x, arm[-1].pose.position.z]) - tip[[0, 2]]) < 0.5


def test_one_that_is_not_what_its_hash_says_or_is_of_another_arm_is_refused(rehearsed):
    plan = plain_plan()
    rehearsed.hear_plan(plan)
    forged = rehearsal(plan)
    forged.state = FAILED
    rehearsed.hear_rehearsal(forged)
    rehearsed.hear_rehearsal(rehearsal(plan, worst_pose=(0.0, 0.0)))
    assert [reason for reason, _ in rehearsed.refused] == ["rehearsal", "rehearsal"]
    assert rehearsed.rehearsals == []


def test_the_ghost_of_a_rehearsal_carries_what_the_arm_carries_then(rehearsed):
    plan = work_plan()
    rehearsed.hear_plan(plan)
    rehearsed.hear_rehearsal(rehearsal(plan))
    assert "rehearsal_carried" not in rehearsed.namespaces()
    rehearsed.hear_rehearsal(rehearsal(plan, worst_time=plan.segments[0].end + 0.01))
    assert "rehearsal_carried" in rehearsed.namespaces()
