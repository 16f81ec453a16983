"""What the cups of a tool must hold, against statics that can be done by hand, and in rehearsals."""

from dataclasses import replace

import numpy as np
import pytest
from physics_samples import READY, between, bodies_of, drives, pairs_of, plan_of, robot_of

from construction_twin.extensions.physics.grip import FRICTION, SuctionGrip
from construction_twin.extensions.physics.model import GRAVITY
from construction_twin.extensions.physics.rehearsal import Rehearsal
from construction_twin.review.rehearsal_report import FAILED, PASSED
from construction_twin.robot.tool import Cups, FilePose
from construction_twin.scene.objects import Scene, SceneObject

TIP = robot_of("kr120").tip_link
#: Four cups of 12 kg in a square, 0.25 m before the flange.
CUPS = Cups(radius=0.02, holds=12.0, at=((-0.1, -0.1), (-0.1, 0.1), (0.1, -0.1), (0.1, 0.1)))
PLACE = FilePose(xyz=(0.0, 0.0, 0.25))
GRIP = SuctionGrip.of(CUPS, PLACE)
WEIGHT = 12.0 * GRAVITY


def usage(force=(0.0, 0.0, 0.0), moment=(0.0, 0.0, 0.0), grip: SuctionGrip = GRIP) -> float:
    return float(grip.usages(np.array([force]), np.array([moment]))[0])


def board(across: float = 0.0, size: float = 0.4) -> SceneObject:
    """Return a board that hangs at the cups."""
    return SceneObject("board/0", "box", (size, size, 0.04), (across, 0.0, 0.27), link=TIP)


def test_shear_costs_as_much_as_friction_makes_of_it():
    assert usage((4 * WEIGHT * FRICTION, 0.0, 0.0)) == pytest.approx(1.0)


def test_a_moment_is_held_by_the_cups_on_the_far_side():
    # two cups pull, 0.1 m from the middle, the others are pressed on; the lip of a cup that is outside of its middle pulls most
    worst = usage(moment=(0.0, 4 * 0.1 * WEIGHT, 0.0))
    assert 1.0 < worst < 1.2
    assert usage(moment=(0.0, -4 * 0.1 * WEIGHT, 0.0)) == pytest.approx(worst)


def test_one_row_of_cups_resists_a_moment_about_itself_by_their_lips():
    row = SuctionGrip.of(Cups(radius=0.02, holds=12.0, at=((-0.1, 0.0), (0.1, 0.0))), PLACE)
    assert 1.0 < usage(moment=(0.02 * WEIGHT, 0.0, 0.0), grip=row) < 10.0


def test_only_the_cups_that_lie_on_the_workpiece_hold():
    bodies, item = bodies_of("kr120"), board(0.15, 0.2)
    frame = bodies.model.frames[bodies.model.getFrameId(TIP)]
    (piece,) = bodies.place(item, (item.name,))
    at_tip = replace(piece, placement=frame.placement.inverse() * piece.placement)
    assert GRIP.on([at_tip]).cups.tolist() == [[0.1, -0.1], [0.1, 0.1]]
    assert len(GRIP.on([]).cups) == 0


def rehearsed(mass: float, duration: float, item: SceneObject, grip: SuctionGrip | None = GRIP):
    motion = between(READY, READY + np.array((0.8, 0.0, 0.0, 0.0, 0.0, 0.0)), duration)
    scene = Scene((item,))
    of = Rehearsal(bodies_of("kr120"), pairs_of("kr120"), drives(), masses={item.name: mass}, grip=grip)
    return of.of_plan(plan_of(motion, scene), {scene.hash: scene}, lambda: 0.0)


def test_a_board_that_is_moved_slowly_costs_its_weight_as_it_hangs():
    report = rehearsed(20.0, 10.0, board())
    # the flange of READY looks at the ground under 45 deg: a part of the weight pulls, the rest shears
    assert (report.state, report.grip.name, report.grip.cups) == (PASSED, "board", 4), report.reasons
    assert 0.4 < report.grip.usage < 1.0


def test_the_same_board_in_a_hurry_slips():
    slow, fast = rehearsed(20.0, 10.0, board()), rehearsed(20.0, 1.1, board())
    assert fast.grip.usage > slow.grip.usage
    heavy = rehearsed(60.0, 10.0, board())
    assert heavy.state == FAILED and any("may slip or come off" in reason for reason in heavy.reasons)
    assert heavy.grip.usage == pytest.approx(3 * slow.grip.usage, rel=0.05)


def test_what_no_cup_lies_on_is_a_remark_and_without_cups_nothing_is_looked_at():
    report = rehearsed(20.0, 10.0, board(0.5))
    assert report.grip.name == "" and any("no cup of the tool lies on" in remark for remark in report.remarks)
    assert rehearsed(20.0, 10.0, board(), grip=None).grip.name == ""
