"""The pose of the tool that a controller reports, compared with the model, and the cause that is named where they differ."""

from __future__ import annotations

import math

import pytest
from chain_samples import ROBOT

from construction_twin.core.units import radians
from construction_twin.kinematics.arm_identity import ArmIdentity
from construction_twin.kinematics.chain import pendant_frame
from construction_twin.mock.program import AnotherArm, build_forward_kinematics

NOTHING = (0.0,) * 6
TOOL, BASE = (12.5, -40.0, 310.0, 30.0, 0.0, 90.0), (1500.0, -200.0, 250.0, 45.0, 0.0, 0.0)
POSES = [ROBOT.home, radians((30, -80, 100, 20, 60, -45)), radians((-35, -60, 95, -25, 40, -50))]
#: Axes [deg], and X, Y, Z [mm], A, B, C [deg] of the flange: docs/rsi.md, section 10.
PENDANT = [
    ((0, -90, 90, 0, 90, 0), (1350.0, 0.0, 1569.0, 180.0, 0.0, 180.0)),
    ((30, -80, 100, 20, 60, -45), (1281.521, -813.421, 1225.799, 114.8444, 19.2695, -172.4208)),
    ((-90, -60, 70, 0, 80, 0), (0.0, 1902.688, 1241.904, -90.0, 0.0, 180.0)),
]


def identity(tool=NOTHING, base=NOTHING) -> ArmIdentity:
    return ArmIdentity(ROBOT, pendant_frame(tool), pendant_frame(base), 0.005, math.radians(0.5))


def reported(q, **another):
    position, angles = build_forward_kinematics(ROBOT, AnotherArm(**another))(ROBOT.to_axes(q))
    return (*position, *angles)


def named(arm: ArmIdentity, poses, **another) -> str:
    """The cause after so many poses of another arm, without its figures."""
    for q in poses:
        *_, problem = arm.compare(ROBOT.to_axes(q), reported(q, **another))
    return problem.partition("): ")[2]


@pytest.mark.parametrize("axes, pose", PENDANT)
def test_the_poses_of_the_fact_sheet_are_the_model_s_arm(axes, pose):
    pose = (*[value / 1e3 for value in pose[:3]], *radians(pose[3:]))
    distance, angle, problem = identity().compare(radians(axes), pose)
    assert distance < 1e-6 and angle < 2e-6 and not problem


def test_the_tool_and_base_that_are_expected_are_taken_into_account():
    arm = identity(TOOL, BASE)
    for q in POSES:
        compared = arm.compare(ROBOT.to_axes(q), reported(q, tool=TOOL, base=BASE))
        assert compared == (pytest.approx(0.0, abs=1e-9), pytest.approx(0.0, abs=1e-9), "")


def test_no_cause_is_looked_for_where_there_is_no_time():
    *_, problem = identity().compare(ROBOT.home, reported(ROBOT.home, tool=(0.0, 0.0, 80.0, 0.0, 0.0, 0.0)), False)
    assert problem == "the controller's tool is 80.00 mm and 0.00 deg off the model's (allowed 5 mm, 0.5 deg)"


@pytest.mark.parametrize(
    "another, cause",
    [
        ({"tool": TOOL}, "$TOOL is X 12.500 Y -40.000 Z 310.000 A 30.000 B 0.000 C 90.000"),
        ({"base": BASE}, "$BASE is X 1500.000 Y -200.000 Z 250.000 A 45.000 B 0.000 C 0.000, seen from $ROBROOT"),
        ({"reversed": "A3"}, "axis A3 counts the other way (`sign` in the robot YAML)"),
        ({"longer": {"joint_a3": 200.0}}, "another model: the 1150 mm to link_3 are 1350 mm"),
    ],
)
def test_what_is_wrong_is_named_after_two_poses(another, cause):
    assert named(identity(), POSES[:2], **another) == named(identity(), POSES, **another) == cause


def test_an_offset_is_named_in_degrees_with_its_sign():
    q = POSES[1]
    moved = (*q[:2], q[2] - math.radians(2.0), *q[3:])
    *_, problem = identity().compare(ROBOT.to_axes(q), reported(moved))
    assert "axis A3 has another zero (`offset_deg` in the robot YAML: 2.00 deg more)" in problem


def test_a_tool_or_base_that_is_not_set_is_named():
    assert named(identity(TOOL), POSES[:1]) == "$TOOL is not set"
    assert named(identity(TOOL, BASE), POSES[:1], tool=TOOL) == "$BASE is not set"


def test_one_pose_that_several_causes_explain_names_them_and_says_what_tells_them_apart():
    cause = named(identity(), POSES[:1], base=(0.0, 0.0, 300.0, 0.0, 0.0, 0.0))
    assert "$TOOL is X 0.000 Y 0.000 Z 300.000" in cause and "$BASE is X 0.000 Y 0.000 Z 300.000" in cause
    assert cause.endswith("the same at another pose of the arm tells them apart")


def test_after_a_correction_on_the_pendant_what_was_seen_before_does_not_count():
    arm = identity()
    named(arm, POSES[:2], tool=TOOL)
    assert "$BASE is X 1500.000" in named(arm, POSES[2:], base=BASE)
