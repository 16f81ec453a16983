"""Loading a robot: what the files say arrives in SI, and what makes no sense is named."""

from __future__ import annotations

import copy
import math
from pathlib import Path

import pytest
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import (
    AxisMapping,
    load_robot,
    read_robot_files,
)
from construction_twin.robot.motion_errors import JointRangeError
from construction_twin.robot.urdf import expand_xacro

ROOT = Path(__file__).parents[3]
XACRO = ROOT / "urdf" / "kr120r2500.urdf.xacro"
YAML = ROOT / "config" / "kr120.yaml"
URDF_TEXT = expand_xacro(XACRO)
DESCRIPTION = yaml.safe_load(YAML.read_text())
JOINTS = tuple(f"joint_a{number}" for number in range(1, 7))


@pytest.fixture(scope="module")
def robot():
    return read_robot_files(XACRO, YAML)


@pytest.fixture
def description() -> dict:
    return copy.deepcopy(DESCRIPTION)


def refused(urdf: str, description) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        load_robot(urdf, description)
    return caught.value


def test_joints_are_the_chains_from_base_to_tip(robot):
    assert robot.name == "kr120"
    assert (robot.base_link, robot.tip_link) == ("base_link", "tool0")
    assert robot.joint_names == JOINTS


def test_limits_and_home_are_si(robot):
    assert robot.upper[1] == math.radians(-5)
    assert robot.velocity[0] == math.radians(123)
    assert robot.acceleration == tuple(map(math.radians, (155.8, 134.2, 368.7, 998.8, 518.0, 492.1)))
    assert robot.home == (0.0, -math.pi / 2, math.pi / 2, 0.0, math.pi / 2, 0.0)


def test_order_follows_the_joints_not_the_file(description):
    description["joints"] = dict(reversed(description["joints"].items()))
    description["joints"]["joint_a2"] |= {"sign": -1, "offset_deg": 90}
    robot = load_robot(URDF_TEXT, description)
    assert robot.home == (0.0, -math.pi / 2, math.pi / 2, 0.0, math.pi / 2, 0.0)
    assert [axis.name for axis in robot.axes] == ["A1", "A2", "A3", "A4", "A5", "A6"]
    assert robot.axes[1] == AxisMapping("A2", -1, math.pi / 2)


def test_range_includes_its_ends(robot):
    robot.check_range(robot.lower)
    robot.check_range(robot.upper)


@pytest.mark.parametrize("value", [math.radians(-4.999), math.nan, math.inf])
def test_range_error_names_the_joint(robot, value):
    q = list(robot.home)
    q[1] = value
    with pytest.raises(JointRangeError) as caught:
        robot.check_range(q)
    assert caught.value.joint == "joint_a2"
    assert (caught.value.lower, caught.value.upper) == (robot.lower[1], robot.upper[1])


@pytest.mark.parametrize(
    "key, value, where",
    [
        ("name", "KR 120", "robot/name"),
        ("base_link", "pedestal", "robot/base_link"),
        ("tip_link", "gripper", "robot/tip_link"),
        ("tip_link", "base", "robot/tip_link"),
        ("joints", {"joint_a1": DESCRIPTION["joints"]["joint_a1"]}, "robot/joints"),
        ("joints", DESCRIPTION["joints"] | {"joint_a7": DESCRIPTION["joints"]["joint_a6"]}, "robot/joints"),
        ("joints", [0, 1], "robot/joints"),
        ("joints", DESCRIPTION["joints"] | {"joint_a2": 3}, "robot/joints/joint_a2"),
        ("speed", 3, "robot/speed"),
    ],
)
def test_wrong_key_is_named_with_value_and_expectation(description, key, value, where):
    description[key] = value
    error = refused(URDF_TEXT, description)
    assert error.where == where
    assert error.expected
    assert where in str(error) and repr(error.value) in str(error)


@pytest.mark.parametrize("key", list(DESCRIPTION))
def test_missing_key_is_named(description, key):
    del description[key]
    assert refused(URDF_TEXT, description).where == f"robot/{key}"


@pytest.mark.parametrize(
    "field, value",
    [
        ("sign", 2),
        ("sign", 0),
        ("rsi", "A7"),
        ("rsi", "joint_a1"),
        ("offset_deg", math.inf),
        ("home_deg", math.nan),
        ("home_deg", 160.0),
        ("acceleration_deg_s2", 0.0),
        ("jerk_deg_s3", -1.0),
        ("jerk_deg_s3", "fast"),
        ("scale", 1),
        ("home_mm", 0.0),
    ],
)
def test_wrong_field_of_a_joint_is_named(description, field, value):
    description["joints"]["joint_a3"][field] = value
    assert refused(URDF_TEXT, description).where == f"robot/joints/joint_a3/{field}"


def test_two_joints_on_one_rsi_axis_are_refused(description):
    description["joints"]["joint_a3"]["rsi"] = "A2"
    error = refused(URDF_TEXT, description)
    assert error.where == "robot/joints/joint_a3/rsi"
    assert "joint_a2" in error.expected


def test_chain_without_joints_is_refused(description):
    description["tip_link"] = "link_0"
    assert refused(URDF_TEXT, description).where == "robot/tip_link"


ONE_JOINT = """<robot name="x"><link name="base_link"/><link name="tool0"/>
<joint name="j" type="{type}"><parent link="base_link"/><child link="tool0"/>{limit}</joint></robot>"""


@pytest.mark.parametrize(
    "type, limit",
    [
        ("continuous", ""),
        ("floating", ""),
        ("prismatic", ""),
        ("prismatic", '<limit lower="1" upper="0" effort="1" velocity="1"/>'),
        ("revolute", ""),
        ("revolute", '<limit effort="1" velocity="1"/>'),
        ("revolute", '<limit lower="1" upper="-1" effort="1" velocity="1"/>'),
        ("revolute", '<limit lower="-inf" upper="1" effort="1" velocity="1"/>'),
        ("revolute", '<limit lower="-1" upper="1" effort="1" velocity="0"/>'),
        ("revolute", '<limit lower="-1" upper="1" effort="1" velocity="nan"/>'),
        ("revolute", '<limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="k"/>'),
    ],
)
def test_joint_the_twin_cannot_drive_is_named(description, type, limit):
    assert "joint j" in refused(ONE_JOINT.format(type=type, limit=limit), description).where


ENDLESS = '<robot name="x"><link name="base_link"/><link name="tool0"/><joint name="j" type="continuous"><parent link="base_link"/>'
ENDLESS += '<child link="tool0"/><axis xyz="0 0 1"/><limit effort="1" velocity="2"/></joint></robot>'
TURNS = {"home_deg": 0.0, "acceleration_deg_s2": 10.0, "jerk_deg_s3": 100.0, "rsi": "A1", "sign": 1, "offset_deg": 0.0}


def endless(urdf=ENDLESS, **keys):
    joints = {"j": {**TURNS, **keys}}
    return load_robot(urdf, {"name": "x", "base_link": "base_link", "tip_link": "tool0", "joints": joints})


def test_a_joint_that_turns_without_end_has_the_range_of_the_yaml():
    robot = endless(range_deg=[-360, 270])
    assert (robot.lower, robot.upper) == (pytest.approx([-2 * math.pi]), pytest.approx([1.5 * math.pi]))
    assert (robot.velocity, robot.linear) == ((2.0,), (False,))
    with pytest.raises(JointRangeError):
        robot.check_range([5.0])


@pytest.mark.parametrize(
    "keys", [{}, {"range_deg": [10, 10]}, {"range_deg": [-1e9, 1e9]}, {"range_deg": [float("nan"), 1]}]
)
def test_without_a_range_it_is_refused_with_the_key_that_gives_one(keys):
    with pytest.raises(ConfigurationError, match="robot/joints/j/range_deg"):
        endless(**keys)


def test_a_range_in_the_yaml_is_refused_where_the_urdf_has_one():
    urdf = ENDLESS.replace("continuous", "revolute").replace("<limit ", '<limit lower="-1" upper="1" ')
    with pytest.raises(ConfigurationError, match="range_deg: .*the URDF has this joint's"):
        endless(urdf, range_deg=[-90, 90])


TRACK_XACRO = ROOT / "urdf" / "kr120_track.urdf.xacro"
TRACK_YAML = ROOT / "config" / "kr120_track.yaml"


def test_linear_joint_is_in_metres():
    robot = read_robot_files(TRACK_XACRO, TRACK_YAML)
    assert robot.joint_names == ("track", *JOINTS)
    assert robot.linear == (True,) + (False,) * 6
    assert (robot.lower[0], robot.upper[0], robot.velocity[0]) == (-1.0, 1.0, 2.5)
    assert (robot.home[0], robot.acceleration[0], robot.jerk[0]) == (0.0, 6.81, 68.1)
    assert robot.axes[0] == AxisMapping("E1", 1, 0.0)


def test_offset_and_home_of_a_linear_joint_are_millimetres_in_the_file():
    description = yaml.safe_load(TRACK_YAML.read_text())
    description["joints"]["track"] |= {"offset_mm": -2500, "home_mm": 125.5, "sign": -1}
    robot = load_robot(expand_xacro(TRACK_XACRO), description)
    assert robot.axes[0] == AxisMapping("E1", -1, -2.5)
    assert robot.home[0] == 0.1255
    assert robot.to_axes(robot.home)[0] == pytest.approx(-2.6255)
    assert robot.from_axes(robot.to_axes(robot.home)) == pytest.approx(robot.home)


@pytest.mark.parametrize("key", ["home", "acceleration", "jerk", "offset"])
def test_unit_that_does_not_fit_the_joint_is_refused(key):
    description = yaml.safe_load(TRACK_YAML.read_text())
    suffix = {"acceleration": "_s2", "jerk": "_s3"}.get(key, "")
    track = description["joints"]["track"]
    track[f"{key}_deg{suffix}"] = track.pop(f"{key}_mm{suffix}")
    error = refused(expand_xacro(TRACK_XACRO), description)
    assert error.where == f"robot/joints/track/{key}_deg{suffix}"
    assert f"did you mean {key}_mm{suffix}?" in str(error)


def test_home_of_a_linear_joint_out_of_range_is_named():
    description = yaml.safe_load(TRACK_YAML.read_text())
    description["joints"]["track"]["home_mm"] = 1200
    error = refused(expand_xacro(TRACK_XACRO), description)
    assert (error.where, error.value) == ("robot/joints/track/home_mm", 1200)


@pytest.mark.parametrize("text", ["", "<robot", "<robot/>", '<robot name="x"><joint name="j" type="bogus"/></robot>'])
def test_what_is_no_urdf_is_refused(description, text):
    assert refused(text, description).where == "URDF"


@pytest.mark.parametrize("content", ["- a list", "a: [", ""])
def test_yaml_that_is_no_mapping_names_the_file(tmp_path, content):
    path = tmp_path / "arm.yaml"
    path.write_text(content)
    with pytest.raises(ConfigurationError) as caught:
        read_robot_files(XACRO, path)
    assert caught.value.where == str(path)


@pytest.mark.parametrize(
    "content",
    [
        None,
        '<robot name="x"><link',
        '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="${nobody}"/></robot>',
        '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="/none.xacro"/></robot>',
    ],
)
def test_xacro_that_does_not_expand_names_the_file(tmp_path, content):
    path = tmp_path / "arm.urdf.xacro"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigurationError) as caught:
        expand_xacro(path)
    assert caught.value.where == str(path)
