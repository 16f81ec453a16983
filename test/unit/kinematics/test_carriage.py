"""An arm on a linear axis: its carriage, and a target as the arm sees it."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from inverse_cases import TRACK, joints

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.rail import Carriage

CHAIN = Chain(TRACK)
CARRIAGE = Carriage(CHAIN)


@given(joints(TRACK))
@settings(max_examples=50, deadline=None)
def test_the_arm_reaches_what_it_sees_from_its_carriage(q):
    seen, reached = CARRIAGE.seen_from(CHAIN.forward(q), q[0]), CARRIAGE.arm.forward(q[1:])
    np.testing.assert_allclose(seen.matrix(), reached.matrix(), atol=1e-12)
