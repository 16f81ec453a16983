"""What rviz shows of a rehearsal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from construction_twin.core.motion_errors import SceneError
from construction_twin.kinematics.chain import Pose
from construction_twin.review.rehearsal_report import BROKEN, PASSED, AxisLoad, RehearsalReport, RehearsedContact
from construction_twin.scene.objects import SceneObject
from construction_twin.views.rehearsal_picture import GHOSTS, rehearsal_picture
from construction_twin.views.sync_picture import Shape

SHAPES = (
    Shape("base", "box", "", (1.0, 1.0, 1.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)),
    Shape("tool", "mesh", "package://x/tool.stl", (1.0, 1.0, 1.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
)
HELD = SceneObject("beam", "box", (1.0, 0.1, 0.1), (0.0, 0.0, 0.2), link="tool")


def load(joint: str, peak: float, limit: float = 1000.0, estimated: bool = False) -> AxisLoad:
    return AxisLoad(joint, peak, 0.5, 0.0, 0.0, limit, estimated)


REPORT = RehearsalReport(
    plan_id="p", state=PASSED, worst_time=1.25, worst_pose=(0.3, 0.5),
    axes=(load("joint_a1", 100.0), load("joint_a2", 870.0, estimated=True)),
)  # fmt: skip


def link_pose(q, link: str) -> Pose:
    """The tool slides up with the second joint and is turned by a quarter about z."""
    if link == "base":
        return Pose(np.zeros(3), np.eye(3))
    if link != "tool":
        raise SceneError("a link's name", link, "one of this arm")
    return Pose(np.array((0.0, 0.0, q[1])), np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))))


def drawn(report: RehearsalReport = REPORT, carried=()):
    return rehearsal_picture(report, SHAPES, link_pose, 2.0, carried)


def test_the_ghost_stands_at_the_worst_moment_with_what_it_carries():
    picture = drawn(carried=(HELD,))
    (_, base), (_, tool) = picture.ghost
    assert base.position.tolist() == [0.0, 0.0, 0.5]
    assert tool.position == pytest.approx([0.0, 0.1, 0.5])
    ((item, pose),) = picture.carried
    assert (item, pose.position.tolist()) == (HELD, [0.0, 0.0, 0.7])
    assert picture.ghost_colour == GHOSTS[PASSED]


def test_a_contact_is_marked_where_it_is():
    hit = RehearsedContact("link_5", "wall", 1.5, (0.9, 0.2, 1.1), 230.0, 0.1)
    ((point, said),) = drawn(replace(REPORT, contacts=(hit,))).contacts
    assert point == (0.9, 0.2, 1.1)
    assert all(word in said for word in ("link_5", "wall", "1.50 s", "230 N"))


def test_one_that_broke_off_has_its_reasons_and_no_arm():
    report = RehearsalReport(plan_id="p", state=BROKEN, reasons=tuple("abcde"))
    picture = drawn(report)
    assert picture.ghost == picture.columns == picture.contacts == ()
    assert picture.text.split("\n")[1:4] == ["a", "b", "c"] and "2 reasons more" in picture.text
