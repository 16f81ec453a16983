"""What a reviewer sees of a work plan: paths, ends with names, what is carried and placed, and whether that is approved."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plan_samples import make_plan

from construction_twin.core.reports import ExecutionReport
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment, Signal, Switch
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange
from construction_twin.views.preview import MOST_ROWS, Preview, WorkContext, picture
from construction_twin.views.texts import plan_lines, segment_lines, under_review, work_lines
from construction_twin.views.work_picture import change_words, segment_words, work_path, work_states

TOOL = SceneObject("tool/frame", "box", (0.6, 0.1, 0.1), (0.0, 0.0, 0.05), link="tool0")
STOCK = [SceneObject(f"beam/{k}", "box", (0.1, 0.1, 1.0), (0.0, float(k), 0.5)) for k in range(2)]
HELD = [dataclasses.replace(item, position=(0.0, 0.0, 0.6), link="tool0") for item in STOCK]
BUILT = [dataclasses.replace(item, position=(3.0, 2.0, 0.5)) for item in STOCK]
TABLE = SceneObject("table", "box", (1.0, 1.0, 0.1))
START = Scene((TOOL, TABLE, *STOCK), 0.01)
CHANGES = (
    SceneChange(),
    SceneChange(tuple(HELD)),
    SceneChange(),
    SceneChange(),
    SceneChange(tuple(BUILT)),
    SceneChange(),
)
NAMES = ("to the stock", "approach", "lift", "carry", "set down", "home")
HOLDING = (Signal("held", True),)
#: Where the tool is at the ends of the segments: there and back again over the stock.
PLACES = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 0.0], [3.0, 2.0], [3.0, 2.5], [0.0, 0.0]])


def forward(q: np.ndarray) -> Pose:
    return Pose(np.array([q[0], q[1], 1.0]), np.eye(3))


def plan(changes=CHANGES) -> Plan:
    rest = np.zeros((7, 2))
    motion = Trajectory(("joint_a1", "joint_a2"), 2.0 * np.arange(7.0), PLACES, rest, rest)
    scene, segments = START, []
    for number, change in enumerate(changes):
        after = change.apply(scene)
        switches = {1: (Switch("vacuum", True, HOLDING, 2.0),), 4: (Switch("vacuum", False, (), 2.0),)}.get(number, ())
        requires = HOLDING if number in (2, 3, 4) else ()
        segments.append(
            Segment(NAMES[number], 2.0 * (number + 1), number in (2, 4), requires, switches, scene.hash, after.hash)
        )
        scene = after
    made, task = make_plan(motion, scene=START.hash), "task-1"
    found = content_hash(motion, task, tuple(segments))
    return dataclasses.replace(made, hash=found, task=task, segments=tuple(segments))


def test_what_is_carried_in_each_segment_and_placed_in_the_end_follows_from_the_changes():
    states = work_states(plan(), CHANGES, START)
    assert states.problem == ""
    assert [tuple(item.name for item in held) for held in states.carried] == [
        ("tool/frame",), ("tool/frame",), *[("tool/frame", "beam/0", "beam/1")] * 3, ("tool/frame",), ("tool/frame",)
    ]  # fmt: skip
    assert states.placed == tuple(BUILT)
    assert [bool(states.loads(number)) for number in range(6)] == [False, False, True, True, True, False]


def test_a_scene_that_is_not_known_is_said_and_the_rest_is_drawn():
    for scene in (None, Scene((TABLE,), 0.01)):
        states = work_states(plan(), CHANGES, scene)
        assert states.problem == Sentence("view.picture.scene_unknown")
        assert states.placed == tuple(BUILT) and states.loads(3) == tuple(HELD)


@pytest.mark.parametrize(
    "number,change",
    [(1, SceneChange((HELD[0],))), (4, SceneChange((TABLE,))), (4, SceneChange()), (0, SceneChange((), ("table",)))],
)
def test_objects_that_are_not_those_of_the_approved_scenes_are_pointed_out(number, change):
    """The hashes are what is approved; what is drawn comes from fields that the approval does not cover."""
    lied = [*CHANGES[:number], change, *CHANGES[number + 1 :]]
    states = work_states(plan(), lied, START)
    assert states.problem == Sentence("view.picture.scene_other", segment=repr(NAMES[number]))
    text = picture(plan(), skeleton, 9.0, WorkContext(lied, states, forward, "tool0")).text
    assert Sentence("view.picture.problem", problem=states.problem) in text


def test_a_removal_of_what_is_not_there_is_drawn_as_nothing_and_pointed_out():
    lied = [SceneChange((), ("nobody",)), *CHANGES[1:]]
    assert work_states(plan(), lied, START).problem == ""  # the scene is the same: nothing is missing in the picture
    assert work_states(plan(), CHANGES[:1], START).problem.values == {"segment": "'approach'"}


def test_the_path_is_in_parts_that_join_and_ends_at_one_place_share_a_label():
    drawn = work_path(plan(), work_states(plan(), CHANGES, START), forward, "tool0", 0.02, 1000)
    assert len(drawn.parts) == 6 and drawn.engaged == (False, False, True, False, True, False)
    for number, part in enumerate(drawn.parts):
        np.testing.assert_allclose(part[[0, -1], :2], PLACES[number : number + 2])
    assert sum(map(len, drawn.parts)) <= 1000 + 12
    assert [label for label, _ in drawn.marks] == [
        "1 to the stock, 3 lift",
        "2 approach",
        "4 carry",
        "5 set down",
        "6 home",
    ]


def test_what_is_carried_is_drawn_where_one_segment_carries_it_into_the_next():
    drawn = work_path(plan(), work_states(plan(), CHANGES, START), forward, "tool0", 0.02, 1000)
    # at the ends of lift and carry; not in the stock, not where it is placed, and never the tool
    assert [(item.name, pose.position.tolist()) for item, pose in drawn.on_the_way] == [
        ("beam/0", [1.0, 0.0, 1.6]), ("beam/1", [1.0, 0.0, 1.6]), ("beam/0", [3.0, 2.0, 1.6]), ("beam/1", [3.0, 2.0, 1.6])
    ]  # fmt: skip
    elsewhere = work_path(plan(), work_states(plan(), CHANGES, START), forward, "flange", 0.02, 1000)
    assert elsewhere.on_the_way == () and elsewhere.placed == tuple(BUILT)


def skeleton(q: np.ndarray) -> np.ndarray:
    return np.array([(0.0, 0.0, 0.0), (q[0], q[1], 1.0)])


def test_the_text_lists_the_segments_and_what_happens_in_them():
    told = WorkContext(CHANGES, work_states(plan(), CHANGES, START), forward, "tool0")
    assert picture(plan(), skeleton, 9.0, told).text.splitlines() == [
        "12.00 s, none for test",
        "task task-1: 6 segments, blue: engaged",
        "1 to the stock 2.00 s",
        "2 approach 2.00 s, then vacuum on, carries beam",
        "3 lift 2.00 s, engaged, needs held on",
        "4 carry 2.00 s, needs held on",
        "5 set down 2.00 s, engaged, needs held on, then vacuum off, puts beam",
        "6 home 2.00 s",
        "nothing to touch",
        "largest fraction of velocity / acceleration / jerk: 50% / 60% / 70%",
    ]


def test_of_many_segments_the_text_lists_the_first():
    rest, count = np.zeros((31, 1)), 30
    motion = Trajectory(("joint_a1",), np.arange(31.0), np.arange(31.0)[:, None], rest, rest)
    segments = tuple(Segment(f"s{k}", k + 1.0, False, (), (), "a", "a") for k in range(count))
    long = dataclasses.replace(
        make_plan(motion, scene="a"), hash=content_hash(motion, "t", segments), task="t", segments=segments
    )
    told = WorkContext((), work_states(long, (), None), lambda q: Pose(np.zeros(3), np.eye(3)), "tool0")
    lines = picture(long, lambda q: np.zeros((2, 3)), 9.0, told).text.splitlines()
    assert (
        f"{MOST_ROWS} s{MOST_ROWS - 1} 1.00 s" in lines
        and Sentence("view.picture.more", count=count - MOST_ROWS) in lines
    )
    assert len(segment_lines(long)) == count + 1


def test_the_ghost_tells_which_segment_it_plays():
    preview = Preview()
    preview.on_plan(plan())
    assert preview.segment(0.0) is None
    preview.play(2.0, False, 100.0)
    assert [preview.segment(100.0 + elapsed) for elapsed in (0.0, 0.99, 1.0, 5.99, 6.0, 60.0)] == [
        0,
        0,
        1,
        5,
        None,
        None,
    ]
    preview.play(2.0, True, 0.0)
    assert preview.segment(6.5 + 1.2) == 1


def test_the_terminal_shows_a_table_of_the_segments():
    lines = plan_lines(plan(), (False, False), CHANGES)
    assert lines[-7:] == [
        "segments   6, each from rest to rest and in the scene that the one before leaves",
        "   1 to the stock    0.00 to    2.00 s",
        "   2 approach        2.00 to    4.00 s  then vacuum on; carries beam",
        "   3 lift            4.00 to    6.00 s  engaged; needs held on",
        "   4 carry           6.00 to    8.00 s  needs held on",
        "   5 set down        8.00 to   10.00 s  engaged; needs held on; then vacuum off; puts beam",
        "   6 home           10.00 to   12.00 s",
    ]
    # without the changes, that there is one
    assert segment_lines(plan())[2].endswith("then vacuum on; the scene changes")
    assert under_review(plan()).key == "view.review.work" and under_review(plan()).values["count"] == 6


def test_another_plan_has_no_table():
    motion = plan().trajectory
    assert segment_lines(make_plan(motion)) == [] and under_review(make_plan(motion)).key == "view.review.plan"


def test_changes_are_told_by_whole_things():
    assert change_words(CHANGES[1]) == "carries beam"
    both = SceneChange((HELD[0], BUILT[1], TABLE), ("rack/0", "old/1", "old/2"))
    assert change_words(both) == "carries beam, puts beam and 1 more, removes rack, old"
    assert change_words(SceneChange((), ("a" * 40,))) == f"removes {'a' * 40}"
    unchanged = Segment("x", 1.0, False, (), (), "a", "a")
    assert segment_words(unchanged, CHANGES[1]) == []


def test_the_status_says_where_a_work_plan_is_and_that_the_arm_is_engaged():
    facts = ExecutionReport("PLAYING", "", "p", segment=3, segment_name="carry")
    assert work_lines(facts) == ["segment    4 carry"]
    waits = dataclasses.replace(facts, at_boundary=True, wants_scene=True)
    assert work_lines(waits) == ["segment    4 carry, at its end, waits for the scene to change as planned"]
    stopped = dataclasses.replace(facts, text="IDLE", outcome="stopped", engaged=True)
    assert work_lines(stopped) == ["engaged    only the way back along the executed path can be planned: twin back"]
    assert work_lines(ExecutionReport("IDLE", "")) == work_lines(None) == []
