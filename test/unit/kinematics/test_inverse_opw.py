"""Which arms are of the OPW kind, and with which parameters: from axes alone, against docs/rsi.md and KDL."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_cases import KR120, TRACK, UR_LIKE, assert_solves, changed, make_inverse

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.closed_form import ClosedFormInverse
from construction_twin.kinematics.opw import OpwModel, find_opw
from construction_twin.kinematics.rail import RailInverse, find_rail
from construction_twin.kinematics.subproblems import SubproblemInverse


def test_parameters_of_the_kr120_are_the_facts_sheets():
    model = find_opw(Chain(KR120))
    found = [getattr(model, name) for name in ("a1", "a2", "b", "c1", "c2", "c3", "c4")]
    assert found == pytest.approx([0.350, 0.041, 0.0, 0.675, 1.150, 1.000, 0.215], abs=1e-12)
    assert np.degrees(model.offsets) == pytest.approx([0, -90, 0, 0, 0, 0], abs=1e-12)
    assert model.signs == (-1, 1, 1, -1, 1, -1)
    np.testing.assert_allclose(model.base_T_opw, np.eye(4), atol=1e-12)


@pytest.mark.parametrize(
    "robot, reason",
    [
        (UR_LIKE, r"axis 6 passes 0\.12 m beside .* not spherical"),
        (TRACK, "6 revolute and 1 prismatic"),
        (changed("joint_a3", rpy="0.1 0 0"), "axes 2 and 3 are 0.1 rad from parallel"),
        (changed("joint_a5", xyz="0.05 0.02 0"), "axis 6 passes 0.02 m beside"),
        (changed("joint_a5", axis="1 0 0"), "axes 4 and 5 do not meet"),
        (changed("joint_a6", rpy="0 0 0.2"), "axes 5 and 6 are 0.2 rad from perpendicular"),
        (changed("joint_a4", rpy="0 0 0.3"), "axes 3 and 4 are 0.3 rad from perpendicular"),
        (changed("joint_a2", rpy="0.2 0 0"), "axes 1 and 2 are 0.2 rad from perpendicular"),
        (changed("joint_a3", xyz="0 0.3 0"), "axes 2 and 3 are the same line"),
    ],
)
def test_arms_of_other_kinds_are_told_why(robot, reason):
    found = find_opw(Chain(robot))
    assert isinstance(found, str)
    assert re.search(reason, found), found


@pytest.mark.parametrize(
    "robot, kind", [(KR120, ClosedFormInverse), (TRACK, RailInverse), (UR_LIKE, SubproblemInverse)]
)
def test_the_arm_decides_how_it_is_solved(robot, kind):
    assert type(make_inverse(robot)) is kind


lengths = st.floats(-0.4, 0.4)
angles = st.floats(-math.pi, math.pi)
VARIANTS = [
    changed("joint_a1", xyz="0.1 -0.2 0.9", rpy="0.3 -0.2 1.1"),
    changed("joint_a1", axis="0 0 1"),
    changed("joint_a2", xyz="-0.2 0.1 0.1"),
    changed("joint_a2", rpy="0 0.7 0", axis="0 -1 0"),
    changed("joint_a3", rpy="0 -1.3 0"),
    changed("joint_a3", axis="0 -1 0"),
    changed("joint_a4", xyz="1.0 0.15 0.06"),
    changed("joint_a4", rpy="0.9 0 0"),
    changed("joint_a5", rpy="-0.8 0 0", axis="0 -1 0"),
    changed("joint_a6", rpy="1.2 0.4 0", axis="1 0 0"),
    changed("link_6-flange", xyz="0.2 0.3 -0.1", rpy="0.5 -1.0 2.0"),
    changed("link_6-flange", xyz="-0.2 0 0"),
]


@pytest.mark.parametrize("robot", VARIANTS)
def test_axes_may_point_and_frames_may_lie_as_they_like(robot):
    chain = Chain(robot)
    assert isinstance(find_opw(chain), OpwModel)
    inverse = make_inverse(robot)
    rng = np.random.default_rng(6)
    for q, seed in rng.uniform(robot.lower, robot.upper, (40, 2, 6)):
        pose = chain.forward(q)
        solution = inverse.nearest(pose, seed)
        assert_solves(chain, solution, pose, seed)
        assert solution.distance <= np.linalg.norm(q - seed) + 1e-6
        assert inverse.configuration(solution.q) == solution.configuration


@given(st.tuples(lengths, lengths, lengths), st.tuples(angles, angles, angles))
@settings(max_examples=25)
def test_any_tool_and_any_base(offset, rpy):
    text = " ".join(map(repr, offset)), " ".join(map(repr, rpy))
    for joint in ("joint_a1", "link_6-flange"):
        chain = Chain(changed(joint, *text))
        model = find_opw(chain)
        assert isinstance(model, OpwModel), model
        assert (model.c2, model.c3, abs(model.a1), abs(model.a2)) == pytest.approx((1.15, 1.0, 0.35, 0.041))


def test_the_arm_on_the_track_is_the_arm_on_the_floor():
    carriage, model = find_rail(Chain(TRACK))
    assert carriage.arm.robot.base_link == "track_carriage"
    assert (model.a1, model.a2, model.c1, model.c2) == pytest.approx((0.35, 0.041, 0.675, 1.15))


def test_joint_5_opposed_is_singular_too():
    wide = make_inverse(
        replace(KR120, lower=(*KR120.lower[:4], -3.4, KR120.lower[5]), upper=(*KR120.upper[:4], 3.4, 6.1))
    )
    q = np.array([0.2, -1.6, 1.5, 0.5, math.pi, -0.3])
    seed = np.array([0.2, -1.6, 1.5, 0.7, 3.1, 0.1])
    pose = wide.chain.forward(q)
    solution = wide.nearest(pose, seed)
    assert_solves(wide.chain, solution, pose, seed)
    # axes 4 and 6 turn against each other: 0.5 - (-0.3) = 0.8 is given, 0.7 - 0.1 = 0.6 was; each takes half of the rest
    assert solution.q[[3, 5]] == pytest.approx([0.8, 0.0], abs=1e-6)
