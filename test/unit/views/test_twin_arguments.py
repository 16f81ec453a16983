"""The command line's words and goals."""

from __future__ import annotations

import math
import shlex

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import kr120, track7

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.frames import rotation_to_abc
from construction_twin.views.arguments import Exit, check, parser, read_command_line
from construction_twin.views.goals import joint_goal, pose_goal

ANGLES = st.floats(-89.0, 89.0)


def parsed(text: str):
    return parser("kr120").parse_args(shlex.split(text))


# -- words


def test_options_go_before_and_after_the_command():
    assert parsed("--robot a stop").robot == parsed("stop --robot a").robot == "a"
    assert parsed("stop").robot == "kr120" and parsed("--timeout 2 stop").timeout == 2.0


@pytest.mark.parametrize(
    "text",
    [
        "", "dance", "plan", "plan --pose 1 2 3", "plan --joints 1 --csv a", "plan --joints nan", "plan --joints 1 --speed 101",
        "plan --joints 1 --speed 0", "plan --joints 1 --duration -1", "status --rea dy x",
    ],
)  # fmt: skip
def test_nonsense_is_a_usage_error(text, capsys):
    with pytest.raises(SystemExit) as ending:
        parsed(text)
    assert ending.value.code == Exit.USAGE and "usage" in capsys.readouterr().err


@pytest.mark.parametrize(
    "text, part",
    [
        ("plan --joints 1 --line", "--line belongs to --pose"),
        ("plan --csv a --frame b", "--frame belongs to --pose"),
        ("plan --joints 1 --configuration front", "--configuration belongs"),
        ("plan --pose 1 2 3 4 5 6 --tool-speed 5", "belongs to --line"),
        ("plan --pose 1 2 3 4 5 6 --line --configuration front", "does not go with --line"),
        ("plan --csv a --duration 5", "--duration does not go with --csv"),
        ("arm", "arm needs --responsible NAME"),
        ("arm --responsible=", "arm needs --responsible NAME"),
    ],
)
def test_options_that_do_not_fit_together(text, part):
    assert part in check(parsed(text))


# -- goals


def test_joint_goals_in_deg_and_mm():
    np.testing.assert_allclose(joint_goal([10.0] * 6, kr120()), np.radians([10.0] * 6))
    track = track7()
    q = joint_goal([1500.0, *[10.0] * 6], track)
    assert track.linear[0] and q[0] == pytest.approx(1.5) and q[1] == pytest.approx(math.radians(10.0))
    with pytest.raises(
        ConfigurationError,
        match=f"--joints: .*6 values, one for each of {', '.join(kr120().joint_names)}",
    ):
        joint_goal([1.0], kr120())


@settings(deadline=None)
@given(st.tuples(*[st.floats(-5000.0, 5000.0)] * 3, ANGLES, ANGLES, ANGLES))
def test_poses_in_mm_and_kuka_s_angles(values):
    pose = pose_goal(values, "kr120/twin/tool0")
    np.testing.assert_allclose(pose.position * 1e3, values[:3], atol=1e-9)
    np.testing.assert_allclose(np.degrees(rotation_to_abc(pose.rotation)), values[3:], atol=1e-9)


@pytest.mark.parametrize("frame", ["", "base_link", "kr120/twin/base_link", "world"])
def test_a_pose_inside_of_the_robot_s_foot_is_refused_as_probably_metres_and_never_converted(frame):
    with pytest.raises(ConfigurationError) as caught:
        pose_goal([1.3, -0.3, 1.4, 0.0, 90.0, 0.0], frame)
    said = str(caught.value)
    assert said.startswith("--pose: found '1.3 -0.3 1.4', expected X, Y, Z in mm")
    assert said.endswith("probably in metres. If so, give 1300 -300 1400")


def test_a_comma_is_refused_and_not_taken_for_two_values(capsys):
    for words in ("30,5 -75,0 70,5", "30,5 -75 70 20 70 -40", "-30,-75,70,0,45,0", "-.5,1"):
        with pytest.raises(SystemExit):
            read_command_line(["plan", "--joints", *words.split()])
        assert f"'{words.split()[0]}' holds a comma: write decimals with a point" in capsys.readouterr().err
    assert parsed("plan --joints -30.0 -75 +70 2e1 70. -40").joints == [-30.0, -75.0, 70.0, 20.0, 70.0, -40.0]
