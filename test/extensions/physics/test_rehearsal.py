import math
from dataclasses import replace

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from physics_samples import READY, between, bodies_of, drives, pairs_of, plan_of, rehearse, robot_of
from scene_samples import FLOOR

from construction_twin.extensions.physics import judgement, model
from construction_twin.extensions.physics.arm import SimulatedArm
from construction_twin.extensions.physics.drive import PayloadRating
from construction_twin.extensions.physics.mass import of_shape
from construction_twin.extensions.physics.rehearsal import Rehearsal
from construction_twin.kinematics.chain import Chain
from construction_twin.review.rehearsal_report import BROKEN, FAILED, PASSED, AxisLoad, is_consistent, with_hash
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.segments import Segment
from construction_twin.scene.objects import Scene, SceneObject

ASIDE = READY + np.array((0.6, 0.0, 0.0, 0.0, 0.0, 0.0))
SMALL = between(READY, READY + 0.1, 1.0)
TIP = robot_of("kr120").tip_link


def tip(q: np.ndarray) -> np.ndarray:
    return Chain(robot_of("kr120")).forward(q).position


def tile(link: bool, q: np.ndarray = READY, beyond: float = 0.15) -> SceneObject:
    """Return a tile at the flange in pose `q`: carried, or where it stands then."""
    if link:
        return SceneObject("tile", "box", (0.3, 0.3, 0.04), (0.0, 0.0, beyond), link=TIP)
    pose = Chain(robot_of("kr120")).forward(q)
    x, y, z = pose.position + pose.rotation @ (0.0, 0.0, beyond)
    return SceneObject("tile", "box", (0.3, 0.3, 0.04), (x, y, z))


def has_reason(report, words: str) -> bool:
    return any(words in reason for reason in report.reasons)


def test_a_motion_in_the_open_passes():
    report = rehearse(between(READY, ASIDE, 2.0), Scene((FLOOR,)))
    assert (report.state, report.reasons) == (PASSED, ())
    assert [axis.joint for axis in report.axes] == list(robot_of("kr120").joint_names)
    assert all(0.0 < axis.rms <= axis.peak < axis.limit for axis in report.axes)
    assert report.contacts == report.objects == ()
    assert report.axes[1].gravity > 0.5 > report.axes[0].gravity
    assert report.duration == 2.0


def test_a_wall_in_the_way_is_named_with_the_time():
    wall = SceneObject("wall", "box", (1.5, 0.05, 1.5), (1.6, -0.7, 1.5))
    report = rehearse(between(READY, READY + np.array((1.2, 0, 0, 0, 0, 0)), 3.0), Scene((FLOOR, wall)))
    assert report.state == FAILED
    assert has_reason(report, " touches ")
    assert all(contact.second == "wall" for contact in report.contacts)
    assert all(0.2 < contact.time < 2.8 and contact.force > 100.0 for contact in report.contacts)
    # on the side of the wall that the arm comes from, below the arm's reach
    for contact in report.contacts:
        x, y, z = contact.point
        assert 0.8 < x < 2.4 and y == pytest.approx(-0.7, abs=0.06) and 0.7 < z < 2.3
    # the wall's push is none of the plan's torques
    assert not has_reason(report, " needs ")
    # two links that press for two seconds do so for no longer than the rehearsal lasts
    assert all(contact.seconds <= report.duration + 2.0 for contact in report.contacts)


def test_a_load_beyond_the_rating_fails():
    load = of_shape(coal.Box(0.3, 0.3, 0.3)).scaled_to(130.0)
    report = rehearse(SMALL, flange=load)
    assert len(report.reasons) == 1 and has_reason(report, "the load's mass is")
    assert (report.payload.mass, report.payload.rated_mass) == (130.0, 120.0)
    assert not report.payload.estimated
    assert rehearse(SMALL, flange=of_shape(coal.Box(0.3, 0.3, 0.3)).scaled_to(119.0)).state == PASSED


@pytest.mark.parametrize(
    "rating, reason",
    [
        (PayloadRating(mass_kg=120.0, inertia_kg_m2=0.5, source="test"), "the load's moment of inertia"),
        (PayloadRating(mass_kg=120.0, across_m=0.2, along_m=0.1, source="test"), "the load's centre of mass"),
        (PayloadRating(mass_kg=120.0, across_m=0.05, along_m=0.5, source="test"), "the load's centre of mass"),
    ],
)
def test_a_load_that_is_spread_too_far_fails(rating, reason):
    load = replace(of_shape(coal.Box(0.3, 0.3, 0.3)).scaled_to(50.0), centre=np.array((0.1, 0.0, 0.3)))
    report = rehearse(SMALL, flange=load, drives=replace(drives(), rating=rating))
    assert len(report.reasons) == 1 and has_reason(report, reason)


def test_a_motion_that_is_too_fast_for_a_drive_names_axis_and_time():
    weak = replace(drives(), torque=(7290.0, 8910.0, 7759.0, 2462.0, 1492.0, 20.0))
    report = rehearse(between(READY, READY + np.array((0, 0, 0, 0, 0, 3.0)), 1.0), drives=weak)
    assert report.state == FAILED
    (torque,) = [one for one in report.reasons if " needs " in one]
    assert torque.values["joint"] == "A6"
    assert report.axes[5].usage > 1.0
    assert torque.values["peak"].value == report.axes[5].peak
    assert report.worst_time == report.axes[5].time


def test_a_tile_that_is_let_go_in_mid_air_falls():
    report = rehearse(between(READY, ASIDE, 2.0), Scene((FLOOR, tile(True))), Scene((FLOOR, tile(False, ASIDE))))
    assert has_reason(report, "falls")
    (found,) = report.objects
    assert found.name == "tile"
    assert found.released == 2.0
    assert found.fell == pytest.approx(tile(False, ASIDE).position[2] - 0.02, abs=0.01)


def test_a_tile_that_is_let_go_on_a_table_stays():
    stands = tile(False, ASIDE)
    x, y, z = stands.position
    table = SceneObject("table", "box", (0.6, 0.6, z - 0.02), (x, y, (z - 0.02) / 2.0), touch=("tile",))
    report = rehearse(between(READY, ASIDE, 2.0), Scene((FLOOR, table, tile(True))), Scene((FLOOR, table, stands)))
    assert report.state == PASSED, report.reasons
    (found,) = report.objects
    assert found.resting
    assert found.moved < 0.002


def neighbour() -> SceneObject:
    x, y, z = tip(0.5 * (READY + ASIDE))
    return SceneObject("neighbour", "box", (0.12, 0.12, z + 0.15), (x, y, (z + 0.15) / 2.0))


def test_a_neighbour_that_stands_in_the_way_is_knocked_over():
    report = rehearse(between(READY, ASIDE, 2.0), Scene((FLOOR, neighbour())), masses={"neighbour": 20.0})
    assert has_reason(report, " touches ") and has_reason(report, "which the plan does not touch, moves")
    (found,) = report.objects
    assert found.name == "neighbour"
    assert math.isnan(found.released)
    assert found.turned > math.radians(45.0)


def test_a_scene_that_is_not_known_breaks_the_rehearsal():
    scene = Scene((FLOOR, tile(True)))
    rehearsal = Rehearsal(bodies_of("kr120"), pairs_of("kr120"), drives())
    report = rehearsal.of_plan(plan_of(SMALL, scene), {}, lambda: 0.0)
    assert report.state == BROKEN
    assert report.reasons[0].values["scene"] == scene.hash[:12]
    # nor may the one be missing in which what was let go has to lie
    after = Scene((FLOOR, tile(False)))
    segment = Segment("set down", SMALL.duration, False, (), (), scene.hash, after.hash)
    report = rehearsal.of_plan(plan_of(SMALL, scene, (segment,)), {scene.hash: scene}, lambda: 0.0)
    assert report.state == BROKEN
    assert report.reasons[0].values["scene"] == after.hash[:12]


def test_a_simulation_that_comes_apart_has_failed(monkeypatch):
    monkeypatch.setattr(model, "GRAVITY", 1e13)
    report = rehearse(SMALL)
    assert report.state == FAILED and len(report.reasons) == 1 and has_reason(report, "the simulation came apart")


def test_an_estimated_mass_is_named_and_one_that_is_said_is_not():
    scene = Scene((FLOOR, tile(True)))
    guessed = rehearse(SMALL, scene)
    said = rehearse(SMALL, scene, masses={"tile": 4.0})
    assert guessed.payload.estimated and not said.payload.estimated
    assert guessed.payload.mass == pytest.approx(3.6)
    assert said.payload.mass == 4.0
    assert [one for one in guessed.remarks if "mass of" in one] == [
        "mass of tile is an estimate from its volume: 3.6 kg"
    ]
    assert not any("mass of" in one for one in said.remarks)


def test_a_tool_that_stays_on_the_arm_is_never_loose():
    tool = SceneObject("tool", "cylinder", (0.05, 0.1), (0.0, 0.0, 0.05), link=TIP)
    report = rehearse(SMALL, Scene((tool, tile(True))), Scene((tool, tile(False, READY + 0.1))), masses={"tool": 10.0})
    assert [one.name for one in report.objects] == ["tile"]
    assert report.payload.mass == pytest.approx(13.6)


def test_the_same_plan_gives_the_same_bytes_twice_and_another_one_another_hash():
    scene = Scene((FLOOR, neighbour()))
    motion = between(READY, ASIDE, 2.0)
    first, second = (rehearse(motion, scene, masses={"neighbour": 20.0}) for _ in range(2))
    # repr: a nan is no other nan's equal
    assert repr(first) == repr(second)
    hashes = {
        rehearse(motion, scene, masses={"neighbour": mass}, tool=tool).hash
        for mass in (20.0, 21.0)
        for tool in ("", "other")
    }
    assert len(hashes) == 4
    assert first.hash in hashes


@given(st.integers(0, 5), st.floats(0.3, 1.5), st.sampled_from((-1.0, 1.0)))
@settings(deadline=None, max_examples=15)
def test_the_arm_brakes_within_half_the_square_of_its_speed(joint, angle, sign):
    goal = READY.copy()
    goal[joint] += sign * min(angle, 0.6 if joint in (1, 2, 4) else 1.5)
    report = rehearse(between(READY, goal, 2.0))
    robot = robot_of("kr120")
    # at its fastest a quintic motion has 15/8 of its mean speed
    fastest = abs(goal[joint] - READY[joint]) * 15.0 / 8.0 / 2.0
    braking = report.braking
    assert braking.joint == robot.joint_names[joint]
    assert braking.angle == pytest.approx(fastest**2 / (2.0 * robot.acceleration[joint]), rel=0.02)
    assert braking.seconds == pytest.approx(fastest / robot.acceleration[joint], rel=0.02)


def test_the_pieces_of_an_element_fall_as_one_body():
    # an L of two pieces, let go in mid air with its short leg down
    parts = {"beam/0": ((0.4, 0.1, 0.04), (0.0, 0.0, 0.15)), "beam/1": ((0.1, 0.1, 0.2), (0.15, 0.0, 0.27))}
    held = Scene((FLOOR, *(SceneObject(name, "box", size, at, link=TIP) for name, (size, at) in parts.items())))
    motion, pose = between(READY, READY + 0.1, 1.0), Chain(robot_of("kr120")).forward(READY + 0.1)
    let_go = [
        SceneObject(
            name, "box", size, tuple(pose.position + pose.rotation @ at), tuple(rotation_to_quaternion(pose.rotation))
        )
        for name, (size, at) in parts.items()
    ]
    after = Scene((FLOOR, *let_go))
    segments = (Segment("carry", 1.0, True, (), (), held.hash, after.hash),)
    scenes = {scene.hash: scene for scene in (held, after)}
    report = Rehearsal(bodies_of("kr120"), pairs_of("kr120"), drives(), masses={"beam/0": 5.0, "beam/1": 5.0}).of_plan(
        plan_of(motion, held, segments), scenes, lambda: 0.0
    )
    assert len(report.objects) == 1
    beam = report.objects[0]
    assert (beam.name, beam.released) == ("beam", 1.0) and beam.fell > 0.5
    assert report.payload.mass == pytest.approx(10.0)


def stack(names: tuple[str, ...], first: str, away: float = 0.3) -> tuple[SceneObject, ...]:
    """Return tiles on a table under the flange, side by side, `first` the one at the flange; and the table."""
    x, y, z = tile(False).position
    table = SceneObject("table", "box", (1.2, 1.2, z - 0.02), (x, y, (z - 0.02) / 2.0), touch=names)
    items = [
        SceneObject(name, "box", (0.25, 0.25, 0.04), (x, y + (0.0 if name == first else away), z)) for name in names
    ]
    return (table, *items)


def held(item: SceneObject) -> SceneObject:
    return replace(item, link=TIP, position=(0.0, 0.0, 0.15), touch=("table",))


def watched(monkeypatch, *names: str) -> list[np.ndarray]:
    """Return a list that gets the places of objects after each cycle of an arm that is simulated."""
    places, steps = [], SimulatedArm.steps

    def watching(arm, setpoint):
        yield from steps(arm, setpoint)
        places.append(arm.data.geom_xpos[[arm.physics.owners.index(name) for name in names]].copy())

    monkeypatch.setattr(SimulatedArm, "steps", watching)
    return places


@pytest.mark.parametrize("taken", ["stock/1", "stock/2"])
def test_of_objects_with_like_names_the_one_that_stays_does_not_move(monkeypatch, taken):
    table, *items = stack(("stock/1", "stock/2"), taken)
    (stays,) = [item for item in items if item.name != taken]
    (goes,) = [item for item in items if item.name == taken]
    places = watched(monkeypatch, stays.name)
    scenes = [Scene((table, *items)), Scene((table, held(goes), stays)), Scene((table, stays, goes))]
    motion = between(READY, READY, 1.0)
    segments = tuple(
        Segment(str(number), end, False, (), (), scenes[number].hash, scenes[number + 1].hash)
        for number, end in enumerate((0.5, 1.0))
    )
    rehearsal = Rehearsal(bodies_of("kr120"), pairs_of("kr120"), drives(), masses={"stock/1": 2.0, "stock/2": 3.0})
    plan = plan_of(motion, scenes[0], segments)
    report = rehearsal.of_plan(plan, {scene.hash: scene for scene in scenes}, lambda: 0.0)
    assert report.state == PASSED, report.reasons
    assert np.abs(np.array(places) - places[0]).max() < 1e-3
    # what is let go beside it is a body of its own, with its full name
    assert [one.name for one in report.objects] == [taken]


@pytest.mark.parametrize("masses, number", [((100.0, 130.0), "mass"), ((50.0, 20.0), "inertia")])
def test_every_load_of_a_plan_is_judged_and_the_largest_of_each_number_is_told(masses, number):
    # the light one is far away: its moment of inertia is the larger one
    loads = [
        SceneObject(name, "box", (0.2, 0.2, 0.2), (0.0, 0.0, beyond), link=TIP)
        for name, beyond in (("near", 0.2), ("far", 1.0))
    ]
    scenes = [Scene((load,)) for load in loads]
    inertia = 20.0 if number == "inertia" else None
    rating = PayloadRating(mass_kg=120.0, inertia_kg_m2=inertia, across_m=0.1, along_m=0.9, source="test")
    rated = replace(drives(), rating=rating)
    known = dict(zip(("near", "far"), masses))
    report = rehearse(SMALL, *scenes, drives=rated, masses=known)
    alone = [rehearse(SMALL, scene, drives=rated, masses=known).payload for scene in scenes]
    assert has_reason(report, {"mass": "the load's mass is", "inertia": "moment of inertia"}[number])
    assert has_reason(report, "the load's centre of mass")
    assert report.payload.mass == max(masses)
    assert report.payload.inertia == max(load.inertia for load in alone) == alone[1].inertia
    assert report.payload.along == max(load.along for load in alone) > 0.9


class TestNumbersThatAreNone:
    """Nothing that is compared with a limit passes by being nan."""

    def test_a_torque(self, monkeypatch):
        follow = SimulatedArm.follow

        def broken(arm, *course):
            for _ in follow(arm, *course):
                # in one step alone, in the midst of a cycle
                if 0.5015 < arm.data.time < 0.5025:
                    arm.needed = arm.needed * math.nan
                yield

        monkeypatch.setattr(SimulatedArm, "follow", broken)
        report = rehearse(SMALL)
        assert report.state == FAILED and len(report.reasons) == 1 and has_reason(report, "the simulation came apart")
        assert report.reasons[0].values["time"] == pytest.approx(0.5, abs=0.01)

    @pytest.mark.parametrize("bad", [math.nan, math.inf])
    def test_any_other_number(self, monkeypatch, bad):
        monkeypatch.setattr(
            judgement,
            "AxisLoad",
            lambda *numbers: replace(AxisLoad(*numbers), rms=bad if numbers[0] == "joint_a3" else 0.0),
        )
        report = rehearse(SMALL)
        assert report.state == FAILED and len(report.reasons) == 1 and has_reason(report, "the simulation came apart")


def test_a_report_that_passed_for_reasons_is_none():
    passed = rehearse(SMALL)
    assert passed.state == PASSED and is_consistent(passed)
    failed = with_hash(replace(passed, state=FAILED, reasons=("why",)), 0.0)
    assert is_consistent(failed)
    assert not is_consistent(with_hash(replace(failed, state=PASSED), 0.0))
