"""Tool paths: lines, arcs, turns and blends as commanded, and what cannot be one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from construction_twin.kinematics.chain import Pose
from construction_twin.planning.tool_path import TURN_LENGTH, ToolPath, ToolWaypoint
from construction_twin.robot.motion_errors import PlanningError

ORIGIN = np.zeros(3)
EYE = np.eye(3)
QUARTER = Rotation.from_euler("z", 90, degrees=True).as_matrix()


def at(x, y=0.0, z=0.0, rotation=EYE, **options) -> ToolWaypoint:
    return ToolWaypoint(Pose(np.array([x, y, z], dtype=float), rotation), **options)


def path_of(*waypoints) -> ToolPath:
    return ToolPath(Pose(ORIGIN, EYE), waypoints)


def sampled(path: ToolPath, count: int = 4001):
    s = np.linspace(0.0, path.length, count)
    positions, rotations = path.poses(s)
    steps = (Rotation.from_matrix(rotations[1:]) * Rotation.from_matrix(rotations[:-1]).inv()).as_rotvec()
    return s, positions, rotations, np.linalg.norm(steps, axis=1)


def test_a_line_is_straight_and_turns_evenly():
    path = path_of(at(2.0, 0, 0, QUARTER))
    s, positions, rotations, steps = sampled(path)
    assert path.length == 2.0 and np.allclose(positions, s[:, None] * [1, 0, 0], atol=1e-12)
    assert np.ptp(steps) < 1e-9 and np.sum(steps) == pytest.approx(math.pi / 2)
    assert np.allclose(rotations[-1], QUARTER, atol=1e-12)


def test_an_arc_is_part_of_the_circle_through_its_points():
    path = path_of(at(2.0, 0.0, via=np.array([1.0, 1.0, 0.0])))
    s, positions, *_ = sampled(path)
    assert path.length == pytest.approx(math.pi)
    assert np.allclose(np.linalg.norm(positions - [1, 0, 0], axis=1), 1.0, atol=1e-12)
    assert np.min(np.linalg.norm(positions - [1, 1, 0], axis=1)) < 1e-3 and positions[:, 1].min() > -1e-12


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_arcs_pass_via_and_end_in_space(values):
    via, end = np.array(values[:3]), np.array(values[3:])
    if np.linalg.norm(np.cross(via, end)) < 0.05 or np.linalg.norm(via - end) < 0.1:
        return
    path = path_of(at(*end, via=via))
    _, positions, *_ = sampled(path, 20001)
    assert np.linalg.norm(positions[0]) < 1e-9 and np.linalg.norm(positions[-1] - end) < 1e-9
    assert np.min(np.linalg.norm(positions - via, axis=1)) < path.length / 10000
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() == pytest.approx(path.length, rel=1e-6)


def test_corners_without_a_blend_are_stops_and_the_last_waypoint_is_one():
    path = path_of(at(1.0), at(1.0, 1.0), at(1.0, 2.0), at(1.0, 3.0, blend=0.5))
    assert [(piece.begin, piece.end) for piece in path.pieces] == [(0.0, 1.0), (1.0, 4.0)]
    assert path.pieces[1].knots == (1.0, 2.0, 3.0, 4.0)


def test_a_change_of_turning_is_a_corner_too():
    assert len(path_of(at(1.0), at(2.0, rotation=QUARTER)).pieces) == 2
    assert (
        len(
            path_of(
                at(1.0), at(1.5, 0.5, via=np.array([1.0 + 0.5 * math.sqrt(0.5), 0.5 - 0.5 * math.sqrt(0.5), 0]))
            ).pieces
        )
        == 1
    )


def test_a_turn_on_the_spot_is_a_piece_of_its_own():
    path = path_of(at(1.0), at(1.0, rotation=QUARTER), at(2.0, rotation=QUARTER))
    assert [piece.turn for piece in path.pieces] == [False, True, False]
    assert path.length == pytest.approx(2.0 + TURN_LENGTH * math.pi / 2)
    positions, rotations = path.poses(np.array([1.0 + 0.5 * TURN_LENGTH * math.pi / 2]))
    assert np.allclose(positions, [[1, 0, 0]])
    assert np.allclose(Rotation.from_matrix(rotations[0]).as_rotvec(), [0, 0, math.pi / 4])


@pytest.mark.parametrize("corner", [10.0, 60.0, 90.0, 150.0])
def test_a_blend_is_smooth_short_and_within_its_radius(corner):
    turn = math.radians(corner)
    rotation = Rotation.from_euler("y", 40, degrees=True).as_matrix()
    path = path_of(at(1.0, blend=0.2), at(1.0 + math.cos(turn), math.sin(turn), rotation=rotation))
    assert len(path.pieces) == 1
    s, positions, rotations, steps = sampled(path, 20001)
    h = s[1]
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / h
    assert speed == pytest.approx(np.ones(len(speed)), abs=1e-4)
    # second derivatives of position and orientation go on: no step from one sample to the next
    for values in (np.diff(positions, 2, axis=0) / h**2, np.diff(steps)[:, None] / h**2):
        assert np.max(np.abs(np.diff(values, axis=0))) < 0.05 * max(1.0, np.max(np.abs(values)))
    on_lines = np.minimum(
        np.abs(positions[:, 1]), np.abs((positions - [1, 0, 0]) @ [-math.sin(turn), math.cos(turn), 0])
    )
    inside = np.linalg.norm(positions - [1, 0, 0], axis=1) < 0.2 * (1 + 1e-9)
    assert np.max(on_lines[~inside]) < 1e-9 and np.max(on_lines) > 1e-4
    assert np.allclose(rotations[-1], rotation, atol=1e-9)


def test_a_blend_between_line_and_arc_is_smooth():
    path = path_of(at(1.0, blend=0.1), at(1.0, 1.0, via=np.array([1.5, 0.5, 0.0]), blend=0.1), at(0.0, 1.5))
    s, positions, *_ = sampled(path, 40001)
    bends = np.diff(positions, 2, axis=0) / s[1] ** 2
    assert len(path.pieces) == 1 and np.max(np.abs(np.diff(bends, axis=0))) < 0.02 * np.max(np.abs(bends))


def test_blends_may_use_up_a_segment():
    path = path_of(at(1.0, blend=0.5), at(1.0, 1.0, blend=0.5), at(0.0, 1.0))
    assert len(path.pieces) == 1 and np.allclose(path.poses(np.array([path.length]))[0], [[0, 1, 0]])


def test_waypoints_are_counted_along_the_path():
    path = path_of(at(0.0), at(1.0, blend=0.2), at(1.0, 1.0), at(1.0, 1.0, rotation=QUARTER))
    assert [path.waypoint_at(s) for s in (0.0, 0.5, 0.9, 1.5, path.length)] == [1, 1, 1, 2, 3]
    assert np.allclose(path.pose(path.waypoint_end(1.5)).position, [1, 1, 0])


@pytest.mark.parametrize(
    ("waypoints", "message"),
    [
        ([], "already there"),
        ([at(0.0), at(0.0)], "already there"),
        ([at(1.0, via=np.array([0.5, 0, 0]))], "waypoint 0: .*one line"),
        ([at(0.0, via=np.array([0.5, 0, 0]))], "waypoint 0: .*one line"),
        ([at(1.0, via=np.array([1.0, 0, 0]))], "waypoint 0: .*one line"),
        ([at(1.0, blend=0.3), at(1.0, 0.2)], "segment to waypoint 1 is 200 mm long"),
        ([at(1.0, blend=0.6), at(1.0, 1.0, blend=0.6), at(0.0, 1.0)], "segment to waypoint 1"),
        ([at(1.0, blend=0.1), at(0.0, 1e-6)], "waypoint 0: the path turns back"),
        ([at(1.0, blend=0.1), at(1.0, rotation=QUARTER)], "waypoint 0: a turn on the spot"),
        ([at(1.0, blend=-0.1), at(2.0)], "waypoint 0: the blend is -100 mm"),
        ([at(1.0, blend=math.nan), at(2.0)], "waypoint 0: the blend is nan"),
        ([at(1.0), at(math.inf)], "waypoint 1: .*not finite"),
    ],
)
def test_what_is_no_path_is_refused(waypoints, message):
    with pytest.raises(PlanningError, match=message):
        path_of(*waypoints)
