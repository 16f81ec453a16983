"""What finds the nearest point of self-motions: many postures at once, hinges."""

from __future__ import annotations

import math

import numpy as np
import pytest
from inverse_cases import IIWA_LIKE, KR120, PANDA_LIKE, TRACK

from construction_twin.kinematics.axes import joint_axes
from construction_twin.kinematics.batch_kinematics import BatchKinematics, tangents
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.self_motion import find_hinges
from construction_twin.kinematics.solution import residual

ROBOTS = {"panda": PANDA_LIKE, "iiwa": IIWA_LIKE, "track": TRACK, "kr120": KR120}


def drawn(robot, count):
    return np.random.default_rng(5).uniform(robot.lower, robot.upper, (count, len(robot.lower)))


@pytest.mark.parametrize("name", ROBOTS)
def test_many_postures_are_those_of_kdl(name):
    chain = Chain(ROBOTS[name])
    q = drawn(chain.robot, 20)
    tips, jacobians = BatchKinematics(chain).frames(q)
    for each, tip, jacobian in zip(q, tips, jacobians):
        pose = chain.forward(each)
        np.testing.assert_allclose(tip[:3, 3], pose.position, atol=1e-12)
        np.testing.assert_allclose(tip[:3, :3], pose.rotation, atol=1e-12)
        np.testing.assert_allclose(jacobian, chain.jacobian(each), atol=1e-12)


@pytest.mark.parametrize("name, held", [("panda", 6), ("panda", 3), ("iiwa", 6), ("track", 0)])
def test_tangents_leave_the_tip_in_place(name, held):
    chain = Chain(ROBOTS[name])
    _, jacobian = BatchKinematics(chain).frames(drawn(chain.robot, 20))
    along = tangents(jacobian, held)
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 1.0)
    assert (along[:, held] > 0.0).all()
    assert np.abs(jacobian @ along[:, :, None]).max() < 1e-6


def test_projection_brings_postures_beside_the_curve_onto_it_and_says_which_it_could_not():
    chain = Chain(PANDA_LIKE)
    many = BatchKinematics(chain)
    for q in drawn(PANDA_LIKE, 20):
        beside = q + np.random.default_rng(6).normal(0.0, 0.02, (4, 7))
        found, arrived, _ = many.projected(beside, chain.forward(q))
        for each in found[arrived]:
            assert max(residual(chain, each, chain.forward(q))) < 1e-5
        assert arrived.sum() >= 3
    beyond = Pose(chain.shoulder + [0.0, 0.0, chain.reach + 1.0], np.eye(3))
    assert not many.projected(drawn(PANDA_LIKE, 3), beyond)[1].any()


def test_hinges_are_where_two_axes_lie_in_one_line():
    def places(robot):
        return {
            (hinge.joint, round(math.cos(hinge.angle)), hinge.sense)
            for hinge in find_hinges(joint_axes(Chain(robot)), robot.linear)
        }

    # the shoulder of both; the elbow of the Panda-like arm has its axes 3 and 5 in one line only when it is straight
    shoulder = {(1, 1, 1.0), (1, -1, -1.0)}
    assert places(PANDA_LIKE) == shoulder | {(3, 1, 1.0)}
    # of the iiwa also elbow and wrist, straight; folded back they are in line as well
    assert places(IIWA_LIKE) == shoulder | {(3, 1, 1.0), (3, -1, -1.0), (5, 1, 1.0), (5, -1, -1.0)}
    # the wrist of the KR 120, where joint 5 is at 0 or turned over
    assert {joint for joint, _, _ in places(KR120)} == {4}
