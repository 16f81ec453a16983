"""The KR 120's URDF against docs/rsi.md, section 10."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from urdf_shapes import numbers

from construction_twin.robot.urdf import expand_xacro

ROOT = Path(__file__).parents[3]
XACRO = ROOT / "urdf" / "kr120r2500.urdf.xacro"
#: origin from parent [m], axis, range [deg], speed [deg/s], torque [Nm]
JOINTS = {
    "joint_a1": ((0, 0, 0.675), (0, 0, -1), (-185, 185), 123, 7290),
    "joint_a2": ((0.350, 0, 0), (0, 1, 0), (-140, -5), 115, 8910),
    "joint_a3": ((1.150, 0, 0), (0, 1, 0), (-120, 155), 120, 7759),
    "joint_a4": ((1.000, 0, -0.041), (-1, 0, 0), (-350, 350), 179, 2462),
    "joint_a5": ((0, 0, 0), (0, 1, 0), (-125, 125), 172, 1492),
    "joint_a6": ((0, 0, 0), (-1, 0, 0), (-350, 350), 219, 908),
}


@pytest.fixture(scope="module")
def text() -> str:
    return expand_xacro(XACRO)


@pytest.fixture(scope="module")
def robot(text) -> ElementTree.Element:
    return ElementTree.fromstring(text)


def test_check_urdf_passes(text, tmp_path):
    program = shutil.which("check_urdf")
    assert program, "check_urdf is missing: apt-get install liburdfdom-tools"
    path = tmp_path / "kr120.urdf"
    path.write_text(text)
    result = subprocess.run([program, str(path)], capture_output=True, text=True, timeout=30)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Successfully Parsed XML" in result.stdout
    assert result.stderr == ""


def test_movable_joints_are_a1_to_a6_in_order(robot):
    movable = [joint.get("name") for joint in robot.iter("joint") if joint.get("type") != "fixed"]
    assert movable == list(JOINTS)


@pytest.mark.parametrize("name", JOINTS)
def test_joint_is_the_facts_sheets(robot, name):
    xyz, axis, (lower, upper), speed, torque = JOINTS[name]
    joint = robot.find(f"joint[@name='{name}']")
    limit = joint.find("limit")
    number = int(name[-1])
    assert joint.find("parent").get("link") == f"link_{number - 1}"
    assert joint.find("child").get("link") == f"link_{number}"
    assert numbers(joint.find("origin"), "xyz") == list(xyz)
    assert numbers(joint.find("origin"), "rpy") == [0, 0, 0]
    assert numbers(joint.find("axis"), "xyz") == list(axis)
    assert float(limit.get("lower")) == math.radians(lower)
    assert float(limit.get("upper")) == math.radians(upper)
    assert float(limit.get("velocity")) == math.radians(speed)
    assert float(limit.get("effort")) == torque


@pytest.mark.parametrize(
    "child, parent, xyz, rpy",
    [
        ("base", "base_link", [0, 0, 0], [0, 0, 0]),
        ("link_0", "base_link", [0, 0, 0], [0, 0, 0]),
        ("flange", "link_6", [0.215, 0, 0], [0, 0, 0]),
        ("tool0", "flange", [0, 0, 0], [0, math.pi / 2, 0]),
    ],
)
def test_fixed_frame(robot, child, parent, xyz, rpy):
    (joint,) = [joint for joint in robot.iter("joint") if joint.find("child").get("link") == child]
    assert joint.get("type") == "fixed"
    assert joint.find("parent").get("link") == parent
    assert numbers(joint.find("origin"), "xyz") == xyz
    assert numbers(joint.find("origin"), "rpy") == rpy


def test_centres_of_mass_lie_within_their_links_shapes(robot):
    for link in robot.iter("link"):
        if link.find("inertial") is None:
            continue
        low, high = extent(link)
        centre = np.array(numbers(link.find("inertial/origin"), "xyz"))
        assert (low <= centre).all() and (centre <= high).all(), link.get("name")


def extent(link) -> tuple[np.ndarray, np.ndarray]:
    """Bounding box of a link's collision shapes, which all lie along the axes."""
    lows, highs = [], []
    for shape in link.iter("collision"):
        half = half_size(shape)
        centre = np.array(numbers(shape.find("origin"), "xyz"))
        lows.append(centre - half)
        highs.append(centre + half)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def half_size(shape) -> np.ndarray:
    box = shape.find("geometry/box")
    if box is not None:
        return np.array(numbers(box, "size")) / 2
    cylinder = shape.find("geometry/cylinder")
    radius, length = float(cylinder.get("radius")), float(cylinder.get("length"))
    roll, pitch, _ = numbers(shape.find("origin"), "rpy")
    along = 1 if roll else 0 if pitch else 2
    return np.where(np.arange(3) == along, length / 2, radius)


def test_the_flange_s_face_stays_free_for_tools(robot):
    """Nothing of the wrist's collision shapes reaches beyond the flange, capsule ends included."""
    for link in ("link_5", "link_6"):
        element = robot.find(f"link[@name='{link}']")
        assert element.find("collision_checking") is None
        _, high = extent(element)
        assert high[0] <= 0.215 + 1e-12


def test_upright_pedestal_stands_on_the_floor(robot):
    low, _ = extent(robot.find("link[@name='link_0']"))
    assert low[2] == pytest.approx(0.0, abs=1e-12)
