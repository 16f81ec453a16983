"""An arm on a linear axis: its carriage, and a target as the arm sees it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from inverse_cases import IIWA_LIKE, KR120, TRACK, joints

from construction_twin.kinematics.carriage import Carriage, carries
from construction_twin.kinematics.chain import Chain

CHAIN = Chain(TRACK)
CARRIAGE = Carriage(CHAIN)


@pytest.mark.parametrize(("robot", "expected"), [(TRACK, True), (KR120, False), (IIWA_LIKE, False)])
def test_one_prismatic_joint_before_six_revolute_ones_carries_an_arm(robot, expected):
    assert carries(Chain(robot)) is expected


@given(joints(TRACK))
@settings(max_examples=50, deadline=None)
def test_the_arm_reaches_what_it_sees_from_its_carriage(q):
    seen, reached = CARRIAGE.seen_from(CHAIN.forward(q), q[0]), CARRIAGE.arm.forward(q[1:])
    np.testing.assert_allclose(seen.matrix(), reached.matrix(), atol=1e-12)
