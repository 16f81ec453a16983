"""robot.new_robot: what a URDF says about an arm that has no robot YAML yet; and `estimates`, which the YAML's loader reads."""

from __future__ import annotations

import math
import re

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


LIMIT = '<limit lower="-2.5" upper="2.5" effort="1" velocity="2"/>'


def one_joint(folder, limit):
    """Return the robot of a URDF of one joint."""
    joint = f'<parent link="base_link"/><child link="tool0"/><axis xyz="0 0 1"/>{limit}'
    (folder / "arm.urdf").write_text(
        f'<robot name="arm"><link name="base_link"/><link name="tool0"/><joint name="j" type="revolute">{joint}</joint></robot>'
    )
    return robot_of_urdf(folder / "arm.urdf")


@pytest.mark.parametrize(
    "soft, ends",
    [
        ('soft_lower_limit="-1" soft_upper_limit="0.5"', (-1.0, 0.5)),
        ('soft_lower_limit="-3" soft_upper_limit="1"', (-2.5, 1.0)),
        # without soft limits it holds gains alone
        ("", (-2.5, 2.5)),
    ],
)
def test_soft_limits_of_the_safety_controller_are_the_range(tmp_path, caplog, soft, ends):
    robot = one_joint(tmp_path, f'{LIMIT}<safety_controller k_velocity="1" {soft}/>')
    assert (robot.lower, robot.upper) == ((ends[0],), (ends[1],))
    assert robot.home == pytest.approx([sum(ends) / 2], abs=1e-5)
    assert ("safety_controller are the range of j" in caplog.text) == bool(soft)


@pytest.mark.parametrize(
    "limit, sentence",
    [
        ('lower="-170" upper="170" effort="1"', "URDF joints: found 'j without velocity', expected effort="),
        ('lower="-170" upper="170"', "j without effort and velocity"),
        (
            'lower="-2" upper="2" effort="1" velocity="0"',
            "URDF joint j limit velocity: found 0.0, expected the full speed",
        ),
        ('lower="-170" upper="90.5" effort="1" velocity="2"', 'joint j limit: .*lower="-2.96706" upper="1.57952"'),
    ],
)
def test_what_a_limit_lacks_is_named_with_what_to_write(tmp_path, limit, sentence):
    with pytest.raises(ConfigurationError, match=sentence):
        one_joint(tmp_path, f"<limit {limit}/>")


@pytest.mark.parametrize(
    "values, remark",
    [
        (("-10", "10", "2"), 'joint j limit: lower -10, upper 10 .*573 deg.*lower="-0.174533" upper="0.174533"'),
        (("-2", "2", "120"), 'joint j limit: velocity 120 .*6875 deg/s.*velocity="2.0944"'),
        # two turns, and a fast wrist
        ((f"{-2 * math.pi}", "6.98", "21"), None),
    ],
)
def test_degrees_are_suspected_aloud(tmp_path, caplog, values, remark):
    lower, upper, velocity = values
    robot = one_joint(tmp_path, f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="{velocity}"/>')
    assert robot.upper == (float(upper),)
    assert re.search(remark, caplog.text) if remark else not caplog.text
