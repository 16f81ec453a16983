"""Where and why a Cartesian path ends: every reason, with the fraction that can be followed; nothing is jumped over."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from construction_twin.kinematics.batch_kinematics import BatchKinematics
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import inverse_kinematics
from construction_twin.kinematics.solution import IkSettings, UnreachableError
from construction_twin.planning.cartesian import plan_cartesian
from construction_twin.planning.ik_branch import SINGULAR, CartesianPathError
from construction_twin.planning.recheck import CollisionError
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.motion_errors import JointRangeError, PlanningError

ROOT = Path(__file__).parents[3]
CHAIN = Chain(read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml"))
INVERSE = inverse_kinematics(CHAIN, IkSettings(), np.random.default_rng(1), time.monotonic)
HOME = np.array(CHAIN.robot.home)
START = CHAIN.forward(HOME)


def away(x=0.0, y=0.0, z=0.0, turn=(0, 0, 0), start=START, blend=0.0) -> ToolWaypoint:
    rotation = Rotation.from_rotvec(turn).as_matrix() @ start.rotation
    return ToolWaypoint(Pose(start.position + [x, y, z], rotation), blend=blend)


def singularity_distance(q) -> float:
    """Return the smallest singular value of the Jacobian, its lengths in halves of the arm's."""
    length, jacobian = 0.5 * CHAIN.arm_length, CHAIN.jacobian(q)
    jacobian[:3] /= length
    return float(np.linalg.svd(jacobian, compute_uv=False)[-1])


def ended(waypoints, start=HOME, world=None) -> CartesianPathError:
    with pytest.raises(CartesianPathError) as caught:
        plan_cartesian(start, waypoints, INVERSE, world)
    error = caught.value
    assert 0.0 <= error.fraction < 1.0 and f"{error.fraction:.4f}" in str(error)
    return error


def followed(waypoint: ToolWaypoint, error: CartesianPathError, start=START, fraction=0.999) -> ToolWaypoint:
    """Return the waypoint almost as far as the path can be followed, on the same straight line."""
    part = fraction * error.fraction
    turn = (Rotation.from_matrix(waypoint.pose.rotation) * Rotation.from_matrix(start.rotation).inv()).as_rotvec()
    rotation = Rotation.from_rotvec(part * turn).as_matrix() @ start.rotation
    return ToolWaypoint(Pose(start.position + part * (waypoint.pose.position - start.position), rotation))


def test_out_of_reach_says_by_how_much():
    far = away(3.0)
    error = ended([far])
    assert error.reason == "unreachable" and isinstance(error.cause, UnreachableError) and error.waypoint == 0
    # as far as the arm is long: what is missing and what was followed make up the way
    assert error.cause.missing == pytest.approx(3.0 - error.distance, abs=0.2) and error.distance < 3.0
    assert error.fraction == pytest.approx(error.distance / 3.0)
    plan_cartesian(HOME, [followed(far, error)], INVERSE)


def test_a_joint_limit_names_the_joint():
    up = away(0.0, 0.0, 3.0)
    error = ended([up])
    assert error.reason == "joint limit" and isinstance(error.cause, JointRangeError)
    assert error.cause.joint == "joint_a5" and "joint_a5" in str(error)
    motion = plan_cartesian(HOME, [followed(up, error)], INVERSE)
    upper = CHAIN.robot.upper[4]
    assert upper - 0.01 < np.max(np.abs(motion.trajectory.positions[:, 4])) <= upper


def test_a_whole_turn_too_many_is_a_joint_limit_not_a_jump():
    turns = [away(turn=(0, 0, angle)) for angle in np.arange(1, 8) * 2.0]
    error = ended(turns)
    assert error.reason == "joint limit" and error.cause.joint == "joint_a6" and 0.3 < error.fraction < 0.6


def test_through_the_wrist_singularity_is_refused():
    start = np.array([0.0, -1.6, 1.6, 0.0, 0.4, 0.0])
    pose = CHAIN.forward(start)
    down = ToolWaypoint(Pose(pose.position, CHAIN.forward([0.0, -1.6, 1.6, 0.0, -0.4, 0.0]).rotation))
    error = ended([down], start)
    assert error.reason == "singularity" and 0.3 < error.fraction < 0.7
    motion = plan_cartesian(start, [followed(down, error, pose)], INVERSE)
    distances = [singularity_distance(q) for q in motion.trajectory.positions]
    assert SINGULAR <= min(distances) < 2.0 * SINGULAR


def test_a_singular_start_is_refused():
    error = ended([away(0.1, start=CHAIN.forward([0.0, -1.6, 1.6, 0.0, 0.0, 0.0]))], [0.0, -1.6, 1.6, 0.0, 0.0, 0.0])
    assert error.reason == "singularity" and error.fraction == 0.0


def test_the_second_waypoint_is_named():
    error = ended([away(0.0, 0.2), away(3.0, 0.2)])
    assert error.waypoint == 1 and error.distance > 0.2 and "waypoint 1" in str(error)


class Wall:
    """A world with a wall at y = 0.3 m from the start."""

    rows = BatchKinematics(CHAIN)

    def first_contact(self, qs):
        touching = np.flatnonzero(self.rows.poses(qs)[0][:, 1] >= 0.3)
        return (float(touching[0]), SimpleNamespace(between=("link_6", "wall"))) if len(touching) else None


def test_contact_names_the_pair_and_where():
    error = ended([away(0.0, 0.5)], world=Wall())
    assert error.reason == "collision" and isinstance(error.cause, CollisionError)
    assert error.cause.between == ("link_6", "wall") and "wall" in str(error)
    assert error.distance == pytest.approx(0.3, abs=0.02) and error.distance < 0.3
    plan_cartesian(HOME, [away(0.0, 0.29)], INVERSE, Wall())


def test_what_is_asked_in_millimetres_is_refused_in_millimetres():
    """As by `twin plan --line`: speeds and lengths, in the sentence and in those behind it."""
    # the last 4 ms sample before the wall at 300 mm
    assert re.search(r"touches wall \(29\d\.\d mm along the path\)", str(ended([away(0.0, 0.5)], world=Wall()).cause))
    refused = [
        (dict(speed=-0.1), [away(0.1)], "the requested tool speed is -100 mm/s; expected a positive number"),
        ({}, [away(0.1, blend=-0.02), away(0.2)], "waypoint 0: the blend is -20 mm; expected 0 or a positive number"),
        (
            {},
            [away(0.1, blend=0.06), away(0.1, 0.05)],
            "the segment to waypoint 1 is 50 mm long; its blends need 60 mm, choose smaller ones",
        ),
    ]
    for options, waypoints, sentence in refused:
        with pytest.raises(PlanningError) as caught:
            plan_cartesian(HOME, waypoints, INVERSE, **options)
        assert str(caught.value) == sentence


def test_a_start_out_of_range_is_refused():
    with pytest.raises(JointRangeError):
        plan_cartesian([0, 0, 0, 0, 0, 0], [away(0.1)], INVERSE)


def test_rows_agree_with_kdl():
    rng = np.random.default_rng(2)
    q = rng.uniform(CHAIN.robot.lower, CHAIN.robot.upper, (50, 6))
    rows = BatchKinematics(CHAIN)
    positions, rotations = rows.poses(q)
    for row, jacobian in enumerate(rows.frames(q)[1]):
        pose = CHAIN.forward(q[row])
        assert np.allclose(positions[row], pose.position, atol=1e-12) and np.allclose(
            rotations[row], pose.rotation, atol=1e-12
        )
        assert np.allclose(jacobian, CHAIN.jacobian(q[row]), atol=1e-12)
    near = rows.newton(q[:20] + 1e-3, positions[:20], rotations[:20], steps=5)
    assert np.median(np.max(np.abs(rows.errors(near, positions[:20], rotations[:20])), axis=1)) < 1e-12
    assert math.isclose(rows.poses(near)[0][0, 0], positions[0, 0], abs_tol=1e-9)
