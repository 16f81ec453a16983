"""Many postures at once: what KDL says of each."""

from __future__ import annotations

import numpy as np
import pytest
from inverse_cases import KR120, PANDA_LIKE, TRACK

from construction_twin.kinematics.batch_kinematics import BatchKinematics
from construction_twin.kinematics.chain import Chain


@pytest.mark.parametrize("robot", [KR120, TRACK, PANDA_LIKE], ids=lambda robot: robot.name)
def test_many_postures_are_those_of_kdl(robot):
    chain = Chain(robot)
    q = np.random.default_rng(5).uniform(robot.lower, robot.upper, (20, len(robot.lower)))
    tips, jacobians = BatchKinematics(chain).frames(q)
    for each, tip, jacobian in zip(q, tips, jacobians):
        pose = chain.forward(each)
        np.testing.assert_allclose(tip[:3, 3], pose.position, atol=1e-12)
        np.testing.assert_allclose(tip[:3, :3], pose.rotation, atol=1e-12)
        np.testing.assert_allclose(jacobian, chain.jacobian(each), atol=1e-12)
