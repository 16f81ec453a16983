"""Cartesian motions: on the commanded path at every 4 ms sample, by KDL and arithmetic of this file's own."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from limit_use import limit_use
from rotations import rotation_angle
from scipy.spatial.transform import Rotation

from construction_twin.core.units import CYCLE
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import inverse_kinematics
from construction_twin.kinematics.solution import IkSettings
from construction_twin.planning.cartesian import DEVIATION_M, DEVIATION_RAD, plan_cartesian
from construction_twin.planning.ik_branch import CartesianPathError
from construction_twin.planning.timing import ACCELERATION_FRACTION, VELOCITY_FRACTION
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.motion_errors import PlanningError

ROOT = Path(__file__).parents[3]


def inverse_of(urdf: str, yaml: str):
    chain = Chain(read_robot_files(ROOT / urdf, ROOT / yaml))
    return inverse_kinematics(chain, IkSettings(), np.random.default_rng(1), time.monotonic)


KR120 = inverse_of("urdf/kr120r2500.urdf.xacro", "config/kr120.yaml")
OTHERS = {
    "track": inverse_of("urdf/kr120_track.urdf.xacro", "config/kr120_track.yaml"),
    "ur_like": inverse_of("test/data/ur_like.urdf", "test/data/ur_like.yaml"),
}
HOME = np.array(KR120.chain.robot.home)
START = KR120.chain.forward(HOME)


def away(x=0.0, y=0.0, z=0.0, turn=(0, 0, 0), start=START, **options) -> ToolWaypoint:
    rotation = Rotation.from_rotvec(turn).as_matrix() @ start.rotation
    return ToolWaypoint(Pose(start.position + [x, y, z], rotation), **options)


def tool_of(motion, chain=KR120.chain):
    """Return times, positions and rotations of the tool at every 4 ms sample."""
    times = np.append(np.arange(0.0, motion.trajectory.duration, CYCLE), motion.trajectory.duration)
    poses = [chain.forward(motion.trajectory.sample(t)[0]) for t in times.tolist()]
    return times, np.array([pose.position for pose in poses]), np.array([pose.rotation for pose in poses])


def check_limits(motion, robot=KR120.chain.robot, fraction=1.0) -> None:
    use = limit_use(motion.trajectory, robot)
    assert use.velocity <= fraction * VELOCITY_FRACTION * (1 + 1e-6)
    assert use.acceleration <= fraction * ACCELERATION_FRACTION * (1 + 1e-6) and use.jerk <= 1.0 + 1e-6
    assert not motion.trajectory.velocities[[0, -1]].any() and not motion.trajectory.accelerations[[0, -1]].any()


def test_a_line_is_straight_and_keeps_its_speed():
    motion = plan_cartesian(HOME, [away(0.0, 1.0, 0.0, (0, 0, 0.5))], KR120, speed=0.25)
    times, positions, rotations = tool_of(motion)
    check_limits(motion)
    assert motion.trajectory.positions[0].tobytes() == HOME.tobytes()
    off = positions - START.position
    assert np.max(np.hypot(off[:, 0], off[:, 2])) <= DEVIATION_M
    angles = 0.5 * off[:, 1]
    expected = Rotation.from_rotvec(np.outer(angles, [0, 0, 1])).as_matrix() @ START.rotation
    assert max(rotation_angle(a, b) for a, b in zip(rotations, expected)) <= DEVIATION_RAD
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / CYCLE
    assert np.max(speed) <= 0.25 * (1 + 1e-9) and np.median(speed) >= 0.249
    assert np.max(off[:, 1]) == pytest.approx(1.0, abs=1e-7) and np.min(np.diff(off[:, 1])) > -1e-7


def test_an_arc_keeps_its_radius():
    side = 0.25 * math.sqrt(0.5)
    motion = plan_cartesian(HOME, [away(0.0, 0.5, 0.0, via=START.position + [0.25, 0.25, 0])], KR120, speed=0.2)
    _, positions, _ = tool_of(motion)
    off = positions - START.position - [0, 0.25, 0]
    assert (
        np.max(np.abs(np.linalg.norm(off[:, :2], axis=1) - 0.25)) <= DEVIATION_M
        and np.max(np.abs(off[:, 2])) <= DEVIATION_M
    )
    assert np.min(np.linalg.norm(off - [side, side, 0], axis=1)) < 1e-3
    assert motion.path.length == pytest.approx(0.25 * math.pi)
    check_limits(motion)


def test_without_a_blend_the_tool_stops_in_the_corner():
    motion = plan_cartesian(HOME, [away(0.2), away(0.2, 0.2), away(0.0, 0.2)], KR120, speed=0.3)
    check_limits(motion)
    _, positions, _ = tool_of(motion)
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / CYCLE
    for corner in ([0.2, 0, 0], [0.2, 0.2, 0]):
        nearest = int(np.argmin(np.linalg.norm(positions - START.position - corner, axis=1)))
        assert np.linalg.norm(positions[nearest] - START.position - corner) < 1e-7 and speed[nearest] < 1e-3
    off = positions - START.position
    edges = np.min(
        [np.hypot(off[:, 1], off[:, 2]), np.hypot(off[:, 0] - 0.2, off[:, 2]), np.hypot(off[:, 1] - 0.2, off[:, 2])],
        axis=0,
    )
    assert np.max(edges) <= DEVIATION_M


def test_with_blends_the_tool_goes_on_and_stays_on_the_rounded_path():
    waypoints = [
        away(0.3, turn=(0.2, 0, 0), blend=0.05),
        away(0.3, 0.3, turn=(0, 0.2, 0), blend=0.1),
        away(0.0, 0.3, 0.1),
    ]
    motion = plan_cartesian(HOME, waypoints, KR120, speed=0.2)
    check_limits(motion)
    _, positions, rotations = tool_of(motion)
    inner = np.linalg.norm(np.diff(positions, axis=0), axis=1)[100:-100] / CYCLE
    assert np.min(inner) > 0.1 and motion.top_speed <= 0.2
    # against a dense table of the commanded path, whose own spacing is allowed for
    s = np.linspace(0.0, motion.path.length, 40001)
    table, table_rotations = motion.path.poses(s)
    for position, rotation in zip(positions[::7], rotations[::7]):
        row = int(np.argmin(np.linalg.norm(table - position, axis=1)))
        assert np.linalg.norm(table[row] - position) <= DEVIATION_M + s[1]
        assert rotation_angle(table_rotations[row], rotation) <= DEVIATION_RAD + 2.0 * s[1]


def test_a_turn_on_the_spot_keeps_the_position():
    motion = plan_cartesian(HOME, [away(turn=(0, 0, 1.0))], KR120, speed=0.01)
    _, positions, rotations = tool_of(motion)
    assert np.max(np.linalg.norm(positions - START.position, axis=1)) <= DEVIATION_M
    assert rotation_angle(rotations[-1], START.rotation) == pytest.approx(1.0)
    check_limits(motion)


def test_joint_limits_slow_the_tool_down():
    fast = plan_cartesian(HOME, [away(0.0, 1.0)], KR120)
    check_limits(fast)
    gentle = plan_cartesian(HOME, [away(0.0, 1.0)], KR120, speed=5.0, speed_scale=0.2, acceleration_scale=0.1)
    use = limit_use(gentle.trajectory, KR120.chain.robot)
    assert use.velocity <= 0.2 * VELOCITY_FRACTION * (1 + 1e-6)
    assert use.acceleration <= 0.1 * ACCELERATION_FRACTION * (1 + 1e-6)
    assert gentle.trajectory.duration > 2.0 * fast.trajectory.duration


def test_close_to_a_singularity_the_tool_slows_down_but_stays_on_its_path():
    # joint 5 comes within 3 deg of straight
    start = np.array([0.0, -1.6, 1.6, 0.3, 0.05, 0.0])
    pose = KR120.chain.forward(start)
    motion = plan_cartesian(start, [away(0.1, 0.3, 0.0, start=pose)], KR120)
    check_limits(motion)
    assert motion.deviation_m <= DEVIATION_M and motion.deviation_rad <= DEVIATION_RAD


@pytest.mark.parametrize(("name", "way"), [("track", (0.4, 0.3, 0.1)), ("ur_like", (0.1, 0.25, 0.1))])
def test_other_arms_follow_lines_too(name, way):
    inverse = OTHERS[name]
    robot, start = inverse.chain.robot, inverse.chain.forward(inverse.chain.robot.home)
    motion = plan_cartesian(robot.home, [away(*way, (0.1, 0, 0.2), start=start)], inverse, speed=0.2)
    check_limits(motion, robot)
    _, positions, _ = tool_of(motion, inverse.chain)
    direction = np.array(way) / np.linalg.norm(way)
    off = positions - start.position
    assert np.max(np.linalg.norm(off - np.outer(off @ direction, direction), axis=1)) <= DEVIATION_M
    assert np.linalg.norm(off[-1] - way) < 1e-6


@pytest.mark.parametrize("inside", [0.0, 1e-6])
@pytest.mark.parametrize(("end", "x"), [(0, -0.2), (1, 0.2)])
def test_a_carriage_at_its_end_stays_there_where_the_arm_can_go_on(end, x, inside):
    """The least motion of all joints would take it beyond: where the carriage stands, six joints are enough."""
    inverse = OTHERS["track"]
    robot = inverse.chain.robot
    limit = (robot.lower[0] + inside, robot.upper[0] - inside)[end]
    at_end = np.array([limit, *robot.home[1:]])
    start = inverse.chain.forward(at_end)
    # the track leads along the axis in which its carriage moves the tool
    along = (
        inverse.chain.forward([0.1 + robot.home[0], *robot.home[1:]]).position
        - inverse.chain.forward(robot.home).position
    ) / 0.1
    for way in (x * along, x * along + [0.0, 0.0, -0.1], -0.5 * x * along):
        motion = plan_cartesian(at_end, [away(*way, start=start)], inverse, speed=0.2)
        check_limits(motion, robot)
        _, positions, _ = tool_of(motion, inverse.chain)
        assert np.linalg.norm(positions[-1] - start.position - way) < 1e-6
        carriage = motion.trajectory.positions[:, 0]
        assert carriage.min() >= robot.lower[0] and carriage.max() <= robot.upper[0]


small = st.floats(-0.25, 0.25)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    steps=st.lists(st.tuples(small, small, small), min_size=1, max_size=3),
    turn=st.tuples(small, small, small),
    speed=st.floats(0.05, 2.0),
)
def test_what_is_planned_is_on_its_path_and_within_the_limits(steps, turn, speed):
    places = np.cumsum(np.array(steps), axis=0)
    waypoints = [away(*place, (np.array(turn) * (number + 1) / 3).tolist()) for number, place in enumerate(places)]
    try:
        motion = plan_cartesian(HOME, waypoints, KR120, speed=speed)
    except CartesianPathError as error:
        assert 0.0 <= error.fraction < 1.0 and error.reason != "deviation"
        return
    except PlanningError as error:
        assert "already there" in str(error)
        return
    check_limits(motion)
    assert motion.deviation_m <= DEVIATION_M and motion.deviation_rad <= DEVIATION_RAD
    _, positions, _ = tool_of(motion)
    corners = np.vstack([np.zeros(3), places]) + START.position
    distances = [_distance(positions, a, b) for a, b in zip(corners[:-1], corners[1:])]
    assert np.max(np.min(distances, axis=0)) <= DEVIATION_M


def _distance(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    fraction = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-18), 0.0, 1.0)
    return np.linalg.norm(points - a - fraction[:, None] * (b - a), axis=1)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_a_speed_that_makes_no_sense_is_refused(speed):
    with pytest.raises(PlanningError, match="the requested tool speed is"):
        plan_cartesian(HOME, [away(0.1)], KR120, speed=speed)
