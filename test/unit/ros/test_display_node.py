"""The display node: low rates of the twin, trees of tf, the gate's state, a work plan with the ghost's grip, and its rehearsal."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rospy
from construction_twin.msg import Rehearsal, Sync
from construction_twin.srv import PreviewPlanRequest
from plan_samples import make_plan
from planning_cell import HOME, RIGHT, ROBOT, work_plan
from sensor_msgs.msg import JointState
from unplugged import Unplugged
from visualization_msgs.msg import Marker

from construction_twin.core.units import NANOSECONDS
from construction_twin.kinematics.chain import Chain
from construction_twin.monitor.states import SyncState
from construction_twin.planning.timing import time_path
from construction_twin.review.rehearsal_report import (
    FAILED,
    PASSED,
    AxisLoad,
    RehearsalReport,
    RehearsedContact,
    with_hash,
)
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.convert import plan_to_msg, pose_from_transform_msg
from construction_twin.ros.messages.display_markers import COLOURS
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.ros.nodes import display as module
from construction_twin.ros.nodes.display import NODE, Settings
from construction_twin.ros.shared.frames import DISPLAY_ONLY, PUBLISHERS
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

STOCK = SceneObject("beam/0", "box", (0.1, 0.1, 1.0), (1.0, -1.0, 0.5))
HELD = dataclasses.replace(STOCK, position=(0.0, 0.0, 0.5), link="tool0")
BUILT = dataclasses.replace(STOCK, position=(1.0, 1.0, 0.5))
SCENES = [Scene((item,), 0.01) for item in (STOCK, HELD, BUILT)]
CHANGES = (SceneChange((HELD,)), SceneChange((BUILT,)), SceneChange())
PERIOD = 20_000_000
THERE = tuple(HOME.tolist())


class Bench:
    """The node without ROS; the markers as rviz would hold them."""

    def __init__(self, monkeypatch, **settings: str):
        self.now = 100.0
        self.slept: list[float] = []
        patch = monkeypatch.setattr
        patch(module, "now_ns", lambda: 7 * NANOSECONDS)
        patch(module.time, "monotonic", lambda: self.now)
        patch(module.time, "sleep", self.slept.append)
        given = Settings(**{"arm": "mock", "twin": "kinematic", "servo_model": ""} | settings)
        unplugged = Unplugged(monkeypatch, NODE, given, dataclasses.replace(ROBOT, name="kr120"))
        self.callbacks, self.services, self.refused = unplugged.callbacks, unplugged.services, unplugged.refused
        self.published, self.diagnose = unplugged.published, unplugged.node.diagnose
        self.messages = unplugged.published["plan_markers"]
        self._move_ghost, self._show_sync = unplugged.timers

    def receive_plan(self, plan: Plan) -> None:
        path = np.zeros((len(plan.trajectory.times), 3))
        self.callbacks["plan"](plan_to_msg(plan, "kr120/twin/base_link", path, CHANGES if plan.segments else ()))

    def receive_scene(self, scene: Scene) -> None:
        self.callbacks["scene"](scene_to_msg(scene, rospy.Time(1), "kr120/twin/base_link"))

    def receive_twin(self, now: float, cycle: int, q=THERE) -> None:
        """Hear a pose of the twin, the one of a cycle of 20 ms."""
        self.now = now
        self.callbacks["twin/joint_states"](5 * NANOSECONDS + cycle * PERIOD, q)

    def receive_sync(self, state: int) -> None:
        self.callbacks["sync"](Sync(state=state, reason="joint_a1 differs"))
        self._show_sync(None)

    def at(self, now: float) -> None:
        self.now = now
        self._move_ghost(None)
        self._show_sync(None)

    def receive_rehearsal(self, message: Rehearsal) -> None:
        self.callbacks["rehearsal"](message)

    @property
    def rehearsal(self) -> list[Marker]:
        """Markers of the newest message that show a rehearsal."""
        return [marker for marker in self.messages[-1].markers if marker.ns.startswith("rehearsal")]

    def namespaces(self) -> list[str]:
        """Namespaces of the newest markers of a rehearsal, each once."""
        return list(dict.fromkeys(marker.ns for marker in self.rehearsal))

    def shown(self, namespace: str) -> list[Marker]:
        """Markers of a namespace in the newest message, which stands alone: it begins with the removal of all others."""
        first, *markers = self.messages[-1].markers
        assert first.action == Marker.DELETEALL
        return [marker for marker in markers if marker.ns == namespace]


@pytest.fixture
def plain(monkeypatch) -> Bench:
    return Bench(monkeypatch)


# -- the twin at a low rate


def test_the_twin_s_pose_is_published_with_velocities_and_its_own_stamp(plain):
    sent = plain.published["velocities/joint_states"]
    assert plain.diagnose().sentence == "the twin has no pose yet" and plain.diagnose().level != 0
    plain.receive_twin(107.0, 0)
    plain.receive_twin(107.001, 1, tuple(HOME + 0.01))
    assert (sent[1].header.stamp.to_nsec(), tuple(sent[1].name)) == (5 * NANOSECONDS + PERIOD, ROBOT.joint_names)
    np.testing.assert_allclose(sent[1].position, HOME + 0.01)
    np.testing.assert_allclose(sent[1].velocity, 0.5)
    # the thread reads on when the next one is of interest
    assert plain.slept == [0.0, pytest.approx(0.019)] and plain.diagnose().level == 0


def test_a_twin_that_falls_silent_in_mid_motion_is_shown_at_rest_once_and_watched_again_when_it_is_back(plain):
    sent = plain.published["velocities/joint_states"]
    plain.at(100.0)
    assert not sent, "it never had a pose"
    for back in (0, 1):
        plain.receive_twin(110.0 + back, 100 * back)
        plain.receive_twin(110.02 + back, 100 * back + 1, tuple(HOME + 0.01))
        plain.at(110.26 + back)
        assert len(sent) == 3 * back + 2 and max(sent[-1].velocity) > 0.4, "not silent yet"
        for later in (110.28, 110.5, 110.9):
            plain.at(later + back)
        assert len(sent) == 3 * back + 3 and tuple(sent[-1].velocity) == (0.0,) * 6
        assert (sent[-1].position, sent[-1].header.stamp) == (sent[-2].position, sent[-2].header.stamp)
        assert "silent" in plain.diagnose().sentence and plain.diagnose().level != 0


# -- tf


def test_what_the_twin_s_tree_is_made_of_is_passed_on_a_few_times_a_second_at_rest(plain):
    for now in (107.0, 107.1, 107.3):
        plain.now = now
        plain.callbacks["joint_states"](JointState(name=["a"], position=[1.0]))
    assert len(plain.published["shown/twin"]) == 2


@pytest.mark.parametrize(
    "settings, streams",
    [
        ({}, {"physical": "physical/joint_states"}),
        ({"arm": "none", "servo_model": "/servos.yaml"}, {}),
        (
            {"twin": "mujoco", "servo_model": "/servos.yaml"},
            {"physical": "physical/joint_states", "simulated": "twin/effort", "expected": "expected/joint_states"},
        ),
    ],
)
def test_each_tree_that_is_shown_is_made_of_one_stream_and_stands_in_the_world(monkeypatch, settings, streams):
    bench = Bench(monkeypatch, **settings)
    (static,) = bench.published["/tf_static"]
    roots = {each.child_frame_id.split("/")[1] for each in static.transforms if each.header.frame_id == "world"}
    # what is believed of tf is all but what is only shown
    assert roots == {*PUBLISHERS, *streams} and roots - {*PUBLISHERS} <= {*DISPLAY_ONLY}
    assert {"physical/joint_states", "twin/effort", "expected/joint_states"} & bench.callbacks.keys() == {
        *streams.values()
    }
    for number, (tree, topic) in enumerate(streams.items()):
        bench.callbacks[topic](number * NANOSECONDS, tuple(RIGHT))
        frames = bench.published["/tf"][-1].transforms
        assert [each.child_frame_id for each in frames] == [f"kr120/{tree}/link_{joint}" for joint in range(1, 7)]
        assert {each.header.stamp.to_nsec() for each in frames} == {number * NANOSECONDS}
        assert len(bench.published["/tf"]) == number + 1


def test_the_frames_lead_to_where_forward_kinematics_has_the_tool(plain):
    plain.callbacks["physical/joint_states"](0, tuple(RIGHT))
    (static,), (moving,) = plain.published["/tf_static"], plain.published["/tf"]
    below = {each.child_frame_id: each for each in [*static.transforms, *moving.transforms]}
    frame, found = f"kr120/physical/{ROBOT.tip_link}", np.eye(4)
    while frame != "world":
        found = pose_from_transform_msg(below[frame].transform).matrix() @ found
        frame = below[frame].header.frame_id
    np.testing.assert_allclose(found, Chain(ROBOT).forward(RIGHT).matrix(), atol=1e-9)


def test_the_ghost_hides_in_the_twin_and_keeps_its_frames_with_it(plain):
    plain.at(100.0)
    assert not plain.published["preview/joint_states"], "there is nothing to hide in"
    plain.receive_twin(100.0, 0)
    plain.at(100.04)
    assert plain.published["preview/joint_states"] == [(7 * NANOSECONDS, THERE)]
    frames = plain.published["/tf"][-1].transforms
    assert {each.header.stamp.to_nsec() for each in frames} == {7 * NANOSECONDS}
    assert all(each.child_frame_id.startswith("kr120/preview/") for each in frames)


# -- the monitor's state


def test_the_arm_has_the_colour_of_the_state_until_nothing_is_heard_of_it(plain):
    plain.receive_sync(Sync.HOLDING)
    plain.receive_sync(Sync.HOLDING)
    plain.at(101.1)
    held, silent = plain.published["sync_markers"]
    for message, state in ((held, SyncState.HOLDING), (silent, SyncState.WAITING)):
        *arm, text = message.markers
        colours = [(each.color.r, each.color.g, each.color.b, each.color.a) for each in arm]
        np.testing.assert_allclose(colours, [COLOURS[state]] * len(colours), rtol=1e-6)
        assert text.text.startswith(state.name)
        assert (text.header.frame_id, text.action) == ("kr120/physical/base_link", Marker.ADD)
    assert "joint_a1 differs" in held.markers[-1].text


def test_a_state_that_nobody_knows_is_refused(plain):
    plain.receive_sync(99)
    assert [reason for reason, _ in plain.refused] == ["sync"]


# -- a work plan


@pytest.fixture
def bench(plain) -> Bench:
    plain.receive_scene(SCENES[0])
    plain.receive_plan(work_plan(SCENES))
    return plain


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
    ends = [segment.end for segment in work_plan(SCENES).segments]
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
    path = np.zeros((len(work_plan(SCENES).trajectory.times), 3))
    message = plan_to_msg(dataclasses.replace(work_plan(SCENES), id="w2"), "base", path, CHANGES)
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
    return to_msg(with_hash(dataclasses.replace(report, **changes), 0.1), Rehearsal)


PARTS = [
    "rehearsal_arm", "rehearsal_torques", "rehearsal_limits", "rehearsal_axes", "rehearsal_contacts",
    "rehearsal_contact_names", "rehearsal",
]  # fmt: skip


def plain_plan() -> Plan:
    return make_plan(time_path(np.array([HOME, RIGHT]), ROBOT), "p2", SCENES[0].hash)


@pytest.fixture
def rehearsed(plain) -> Bench:
    plain.receive_scene(SCENES[0])
    return plain


@pytest.mark.parametrize("first", ["plan", "rehearsal"])
def test_the_rehearsal_of_the_plan_under_review_is_drawn_whichever_comes_first(rehearsed, first):
    plan = plain_plan()
    if first == "plan":
        rehearsed.receive_plan(plan)
    rehearsed.receive_rehearsal(rehearsal(plan))
    if first == "rehearsal":
        assert rehearsed.messages == []
        rehearsed.receive_plan(plan)
    assert rehearsed.namespaces() == PARTS
    markers = rehearsed.rehearsal
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
    rehearsed.receive_plan(plan)
    forged = rehearsal(plan)
    forged.state = FAILED
    rehearsed.receive_rehearsal(forged)
    rehearsed.receive_rehearsal(rehearsal(plan, worst_pose=(0.0, 0.0)))
    assert [reason for reason, _ in rehearsed.refused] == ["rehearsal", "rehearsal"]
    assert rehearsed.rehearsal == []


def test_the_ghost_of_a_rehearsal_carries_what_the_arm_carries_then(rehearsed):
    plan = work_plan(SCENES)
    rehearsed.receive_plan(plan)
    rehearsed.receive_rehearsal(rehearsal(plan))
    assert "rehearsal_carried" not in rehearsed.namespaces()
    rehearsed.receive_rehearsal(rehearsal(plan, worst_time=plan.segments[0].end + 0.01))
    assert "rehearsal_carried" in rehearsed.namespaces()
