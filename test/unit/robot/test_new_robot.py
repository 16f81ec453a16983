"""robot.new_robot: what a URDF says about an arm that has no robot YAML yet; and `estimates`, which the YAML's loader reads."""

from __future__ import annotations

import pytest
import yaml
from scene_samples import ur_like

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import load_robot
from construction_twin.robot.new_robot import (
    ESTIMATED,
    find_ends,
    new_description,
    robot_name,
    robot_of_urdf,
    robot_yaml,
    rsi_axes,
    with_home,
)


@pytest.mark.parametrize(
    "linear, axes",
    [
        ([False] * 6, ["A1", "A2", "A3", "A4", "A5", "A6"]),
        ([False] * 7, ["A1", "A2", "A3", "A4", "A5", "A6", "E1"]),
        ([True] + [False] * 6, ["E1", "A1", "A2", "A3", "A4", "A5", "A6"]),
        ([True, True] + [False] * 6, ["E1", "E2", "A1", "A2", "A3", "A4", "A5", "A6"]),
        ([True] + [False] * 7, ["E1", "A1", "A2", "A3", "A4", "A5", "A6", "E2"]),
        # a SCARA's stroke is one of its own axes, and so is everything of a gantry
        ([False, False, True, False], ["A1", "A2", "A3", "A4"]),
        ([True, True, True], ["A1", "A2", "A3"]),
    ],
)
def test_axes_of_rsi(linear, axes):
    assert rsi_axes(linear) == axes


def tree(*joints: str) -> str:
    """Return a URDF of fixed joints, each ``parent child``."""
    links = dict.fromkeys(link for joint in joints for link in joint.split())
    parts = [f'<link name="{link}"/>' for link in links]
    for parent, child in (joint.split() for joint in joints):
        parts.append(
            f'<joint name="{parent}-{child}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>'
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


@pytest.mark.parametrize(
    "joints, base",
    [
        (("base_link tool0",), "base_link"),
        (("world base_link", "base_link tool0"), "base_link"),
        (("world stand", "stand tool0"), "stand"),
        (("foot arm", "arm tool0", "foot base_link"), "foot"),
    ],
)
def test_the_base_is_the_one_that_is_usual_or_the_root(joints, base):
    assert find_ends(tree(*joints)) == (base, "tool0")


def test_a_tip_that_is_not_there_is_told_with_those_that_are():
    with pytest.raises(ConfigurationError, match="found 'tool0', expected a link of the URDF; .*: camera, hand"):
        find_ends(tree("base_link arm", "arm hand", "arm camera"))


def test_what_is_written_is_read_back_with_its_estimates():
    urdf = ur_like().urdf
    description = new_description(urdf, "mine", "base_link", "tool0", 2.0)
    home = [0.5, -1.0, 1.0, 0.25, 1.5, -0.5]
    text = robot_yaml(with_home(description, home), "rosrun construction_twin new_arm /my.urdf", 2.0)
    robot = load_robot(urdf, yaml.safe_load(text))
    assert (robot.name, robot.base_link, robot.tip_link) == ("mine", "base_link", "tool0")
    assert robot.home == pytest.approx(home, abs=1e-5)
    assert robot.acceleration == pytest.approx([speed / 2 for speed in robot.velocity], rel=0.005)
    assert robot.estimates == ESTIMATED
    assert "#   rosrun construction_twin new_arm /my.urdf\n" in text and "full speed within 2 s" in text


def test_a_urdf_alone_makes_a_robot_with_estimates(tmp_path):
    (tmp_path / "arm.urdf").write_text(ur_like().urdf)
    robot = robot_of_urdf(tmp_path / "arm.urdf")
    description = new_description(robot.urdf, robot_name(robot.urdf), *find_ends(robot.urdf), 1.0)
    assert robot == load_robot(robot.urdf, description)
    assert (robot.joint_names, robot.velocity) == (ur_like().joint_names, ur_like().velocity)
    assert robot.estimates == (*ESTIMATED, "home")
    with pytest.raises(ConfigurationError, match="tip link: found 'nowhere'"):
        robot_of_urdf(tmp_path / "arm.urdf", tip_link="nowhere")
