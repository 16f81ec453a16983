"""What is done about the scene of an arm that was left engaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from construction_twin.core.reports import EngagementReport
from construction_twin.extensions.work.task_recorder import restoring_change, switches_confirmed
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.segments import Segment
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

SIDE = (0.1, 0.1, 0.1)


def at(x: float) -> Pose:
    return Pose(np.array([x, 0.0, 0.0]), np.eye(3))


BODY = SceneObject("E1/0", "box", SIDE)
STOCK, HELD, PLACED = BODY.moved(at(1.0)), BODY.moved(at(0.3), "tool0"), BODY.moved(at(2.0))
TOOL = SceneObject("tool/post", "box", SIDE, link="tool0", touch=("E1/0",))
FLOOR = SceneObject("floor", "box", (5.0, 5.0, 0.1), touch=("E1/0",))
FENCE = SceneObject("fence", "box", SIDE).moved(at(-2.0))


def scene(*items: SceneObject) -> Scene:
    return Scene((FLOOR, TOOL, *items), 0.01)


BEFORE, GRIPPED, BUILT = scene(STOCK), scene(HELD), scene(PLACED)
GRIP = Segment("grip", 1.0, True, (), (), BEFORE.hash, GRIPPED.hash)
LET_GO = Segment("let go", 2.0, True, (), (), GRIPPED.hash, BUILT.hash)
PLAN = ((GRIP, LET_GO), (SceneChange((HELD,)), SceneChange((PLACED,))))
#: Of a plan that is not known any more.
UNKNOWN = ((), ())


def engagement(*scenes: Scene) -> EngagementReport:
    return EngagementReport("p1", "lower", tuple(one.hash for one in scenes))


def hash_after(found: SceneChange | str, present: Scene) -> str:
    """Return the scene that a change leads to; fails when none is due."""
    assert isinstance(found, SceneChange), found
    return found.apply(present).hash


@pytest.mark.parametrize(("present", "wanted"), [(BEFORE, GRIPPED), (GRIPPED, BUILT)])
def test_the_change_that_a_stop_has_cut_off_is_due(present, wanted):
    assert hash_after(restoring_change(engagement(wanted), present, *PLAN), present) == wanted.hash


@pytest.mark.parametrize("wanted", [BEFORE, GRIPPED, BUILT])
@pytest.mark.parametrize("present", [BEFORE, GRIPPED, BUILT])
def test_without_plan_and_earlier_scenes_the_ledger_has_what_it_takes(present, wanted):
    found = restoring_change(engagement(wanted), present, *UNKNOWN, element="E1", forms=[(STOCK,), (HELD,), (PLACED,)])
    assert hash_after(found, present) == wanted.hash


@pytest.mark.parametrize(
    "present",
    [scene(STOCK, FENCE), scene(HELD, FENCE), Scene((replace(FLOOR, size=(4.0, 4.0, 0.1)), TOOL, HELD), 0.01)],
)
def test_what_was_changed_in_the_scene_meanwhile_is_left_to_people(present):
    found = restoring_change(engagement(GRIPPED), present, *PLAN, element="E1", forms=[(STOCK,), (HELD,), (PLACED,)])
    assert "undo what was changed in the scene since" in found


def test_a_plan_that_nobody_knows_any_more_is_asked_about():
    found = restoring_change(engagement(GRIPPED), BEFORE, *UNKNOWN)
    assert "in engaged segment 'lower' of plan p1; no change" in found


def test_a_plans_change_that_leads_elsewhere_is_not_made():
    for wrong in SceneChange((HELD.moved(at(0.4), "tool0"),), ("nobody",)), SceneChange((HELD.moved(at(0.4)),)):
        assert isinstance(restoring_change(engagement(GRIPPED), BEFORE, [GRIP], [wrong]), str)


def test_a_switch_counts_as_confirmed_only_where_no_other_scene_is_named():
    assert switches_confirmed(engagement(GRIPPED), GRIP)
    assert not switches_confirmed(engagement(BEFORE), GRIP)
    assert not switches_confirmed(engagement(BEFORE, GRIPPED), GRIP)
    assert not switches_confirmed(engagement(), GRIP)
    assert not switches_confirmed(engagement(GRIPPED), replace(GRIP, scene=GRIPPED.hash))
