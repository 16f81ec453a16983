"""What stands before a plan begins: a wall that stands is never reported; what would fall anyway is not blamed on the plan."""

import math
import re

import numpy as np
import pytest
from physics_samples import READY, between, bricks, rehearse, robot_of
from scene_samples import FLOOR

from construction_twin.extensions.physics.rehearsal import MOST, nearest_bodies
from construction_twin.kinematics.chain import Chain
from construction_twin.review.rehearsal_report import FAILED, PASSED, RehearsalReport
from construction_twin.scene.objects import Scene, SceneObject

TIP = robot_of("kr120").tip_link
ASIDE = READY + np.array((0.6, 0.0, 0.0, 0.0, 0.0, 0.0))
#: A block at the flange [m], and a pose with it just above the floor.
BLOCK = SceneObject("block", "box", (0.2, 0.2, 0.2), (0.0, 0.0, 0.12), link=TIP)
LOW = np.radians((0.0, -35.0, 95.0, 0.0, 30.0, 0.0))
SWING = np.array((0.5, 0.0, 0.0, 0.0, 0.0, 0.0))


def weights(objects, mass: float = 3.5) -> dict[str, float]:
    return {item.name: mass for item in objects}


def fixed(report: RehearsalReport) -> list[str]:
    """The remarks on what is fixed in the rehearsal."""
    return [remark for remark in report.remarks if "fixed in this rehearsal" in remark]


def remark_with(report: RehearsalReport, words: str) -> str:
    (remark,) = [each for each in report.remarks if words in each]
    return remark


@pytest.mark.parametrize(
    "wall",
    [
        bricks(),
        bricks(head=0.0),
        bricks(head=-0.0005, bed=-0.0005),
        bricks(shift=0.003),
    ],
    ids=["dry", "closed heads", "all inside", "askew"],
)
def test_a_wall_that_stands_is_never_reported(wall):
    assert len(wall) == 20
    report = rehearse(between(READY, ASIDE, 2.0), Scene((FLOOR, *wall)), masses=weights(wall))
    assert (report.state, report.objects, report.contacts, fixed(report)) == (PASSED, (), (), [])


@pytest.mark.parametrize(("bed", "sinks"), [(0.01, 40.0), (0.0015, 6.0)])
def test_a_wall_with_mortar_that_the_scene_does_not_have_is_fixed_and_told(bed, sinks):
    wall = bricks(bed=bed)
    report = rehearse(between(READY, ASIDE, 2.0), Scene((FLOOR, *wall)), masses=weights(wall))
    assert (report.state, report.objects) == (PASSED, ())
    remark = remark_with(report, "they would move without any plan")
    assert float(re.search(r"by up to ([\d.]+) mm", remark)[1]) == pytest.approx(sinks, abs=0.2)
    # the lowest course stands
    assert "brick1.0" in remark and "brick4.1" in remark and "brick0." not in remark


def test_what_would_fall_by_itself_is_told_and_not_blamed_on_the_plan():
    standing = SceneObject("standing", "box", (0.2, 0.2, 0.2), (-2.0, 0.0, 0.1))
    hanging = SceneObject("hanging", "box", (0.2, 0.2, 0.2), (-2.0, 1.0, 0.7))
    tilted = SceneObject(
        "tilted", "box", (0.1, 0.1, 0.6), (-2.0, -1.0, 0.34), (0.0, math.sin(math.radians(15.0)), 0.0, math.cos(math.radians(15.0)))
    )  # fmt: skip
    objects = (standing, hanging, tilted)
    report = rehearse(between(READY, ASIDE, 2.0), Scene((FLOOR, *objects)), masses=weights(objects))
    assert (report.state, report.objects) == (PASSED, ())
    remark = remark_with(report, "they would move without any plan")
    assert "'hanging', 'tilted'" in remark and "standing" not in remark


def struck(count: int = 5, **changes: object) -> tuple[RehearsalReport, tuple[SceneObject, ...]]:
    """Return the rehearsal of a motion whose load goes through a wall, and the wall."""
    pose = Chain(robot_of("kr120")).forward(LOW)
    x, y, _ = pose.position + pose.rotation @ np.array(BLOCK.position)
    assert abs(y) < 1e-6
    wall = bricks((count, count - 1, count - 2, count - 3), at=(float(x), 0.0))
    settings = {"masses": weights(wall) | {"block": 20.0}} | changes
    return rehearse(between(LOW + SWING, LOW - SWING, 3.0), Scene((FLOOR, BLOCK, *wall)), **settings), wall


def test_a_load_that_strikes_the_stack_tips_it_over():
    report, wall = struck()
    assert report.state == FAILED
    assert any("block touches brick" in reason for reason in report.reasons)
    assert any("which the plan does not touch, moves" in reason for reason in report.reasons)
    assert {"block"} == {contact.first for contact in report.contacts if contact.second.startswith("brick")}
    fallen = [one for one in report.objects if one.name.startswith("brick")]
    assert max(one.moved for one in fallen) > 0.1 and all(math.isnan(one.released) for one in fallen)
    # and not because of how it stood
    assert fixed(report) == []


def test_the_same_strike_gives_the_same_bytes_and_a_fixed_wall_only_contacts():
    (first, wall), (second, _) = struck(), struck()
    assert repr(first) == repr(second)
    unweighed, _ = struck(masses={"block": 20.0}, unweighed=tuple(item.name for item in wall))
    assert unweighed.state == FAILED and unweighed.objects == ()
    assert "brick3.1" in remark_with(unweighed, "their masses are unknown")


def test_of_many_bodies_those_near_the_path_can_be_tipped_over():
    far = [
        SceneObject(f"far{number}", "box", (0.1, 0.1, 0.1), (-3.0, 0.2 * number - 4.0, 0.05)) for number in range(MOST)
    ]
    near = SceneObject("near", "box", (0.1, 0.1, 0.1), (2.0, 0.0, 0.05))
    objects = (*far, near)
    report = rehearse(between(READY, ASIDE, 1.0), Scene((FLOOR, *objects)), masses=weights(objects))
    assert report.state == PASSED and f"1 elements further from the path than the nearest {MOST}" in " ".join(
        fixed(report)
    )
    bodies = {item.name: item.name for item in objects}
    ordered = nearest_bodies(objects, bodies, robot_of("kr120"), np.linspace(READY, ASIDE, 100))
    assert ordered[0] == "near" and set(ordered) == set(bodies)
