"""Joints outside of the chain: where they stand, what is said of them, and what they carry in frames and collision checks."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest
import yaml
from genpy import Time
from scene_samples import ROOT, ur_like

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.robot.description import (
    Following,
    OtherJoint,
    RobotModel,
    load_robot,
    other_joints_text,
    read_robot_files,
)
from construction_twin.robot.launch_parameters import home_positions
from construction_twin.robot.urdf import expand_xacro
from construction_twin.ros.messages.convert import pose_from_transform_msg
from construction_twin.ros.nodes.display import RobotFrames
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld, Contact
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision

DATA = ROOT / "test" / "data"
XACRO, YAML = DATA / "ur_like_gripper.urdf.xacro", DATA / "ur_like_gripper.yaml"
URDF, DESCRIPTION = expand_xacro(XACRO), yaml.safe_load(YAML.read_text())
NONE = SelfCollision({}, "")


def gripper(urdf: str = URDF, **positions: float) -> RobotModel:
    return load_robot(urdf, DESCRIPTION | {"other_joints": positions})


def text(robot: RobotModel) -> str:
    return other_joints_text(robot.other_joints, robot.base_link, robot.tip_link)


def changed(name: str, **attributes) -> str:
    """Return the URDF with another joint type, or without its limit."""
    robot = ElementTree.fromstring(URDF)
    joint = robot.find(f"joint[@name='{name}']")
    for key, value in attributes.items():
        if value is None:
            joint.remove(joint.find(key))
        elif key == "type":
            joint.set("type", value)
        else:
            ElementTree.SubElement(joint, key, value)
    return ElementTree.tostring(robot, encoding="unicode")


def refused(urdf: str = URDF, **positions) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        gripper(urdf, **positions)
    return caught.value


def test_an_arm_without_any_has_none():
    assert ur_like().other_joints == ()
    assert text(ur_like()) == ""


def test_they_stand_where_the_yaml_says_and_the_mimic_follows():
    robot = read_robot_files(XACRO, YAML)
    assert robot.other_joints == (
        OtherJoint("slide_left", "prismatic", 0.03, ""),
        OtherJoint("slide_right", "prismatic", 0.03, "slide_left"),
        OtherJoint("hinge", "revolute", pytest.approx(0.4), ""),
    )
    assert robot.joint_names == ur_like().joint_names


def test_without_a_value_they_stand_at_zero_or_where_that_is_out_of_range_in_the_middle():
    assert {joint.name: joint.position for joint in gripper().other_joints} == {
        "slide_left": 0.0, "slide_right": 0.0, "hinge": pytest.approx(0.4),
    }  # fmt: skip


def test_a_mimic_joint_has_its_factor_and_offset_and_may_follow_a_follower():
    urdf = changed("hinge", mimic={"joint": "slide_right", "multiplier": "-10", "offset": "0.5"})
    joints = {joint.name: joint for joint in gripper(urdf, slide_left=0.02).other_joints}
    assert joints["hinge"].position == pytest.approx(0.3)
    assert joints["hinge"].follows == "slide_right"


@pytest.mark.parametrize(
    "positions, where, expected",
    [
        ({"slide_left": 0.07}, "robot/other_joints/slide_left", "0 to 0.06 [m]"),
        ({"hinge": 0.0}, "robot/other_joints/hinge", "0.2 to 0.6 [rad]"),
        ({"slide_right": 0.01}, "robot/other_joints/slide_right", "no value: it follows slide_left"),
        ({"pan": 0.0}, "robot/other_joints/pan", "take a value: ['slide_left', 'hinge']"),
        ({"nobody": 0.0}, "robot/other_joints/nobody", "take a value: ['slide_left', 'hinge']"),
        ({"slide_left": math.nan}, "robot/other_joints/slide_left", "finite"),
        ({"slide_left": "open"}, "robot/other_joints/slide_left", "number"),
    ],
)
def test_a_wrong_value_is_named(positions, where, expected):
    error = refused(**positions)
    assert error.where == where
    assert expected in error.expected


def test_limits_and_leaders_that_are_missing_are_named():
    assert refused(changed("hinge", limit=None)).where == "URDF joint hinge limit"
    assert "found 'nobody'" in str(refused(changed("hinge", mimic={"joint": "nobody"})))
    both = changed("slide_left", mimic={"joint": "slide_right"})
    assert "a joint that does not follow it" in str(refused(both))


def test_home_pose_of_the_yaml_names_them_for_the_twin_s_frames():
    assert home_positions(YAML) == dict(zip(ur_like().joint_names, ur_like().home)) | {"slide_left": 0.03}


def frames_of(robot: RobotModel) -> RobotFrames:
    return RobotFrames(robot, Pose(np.zeros(3), np.eye(3)))


def test_their_frames_are_where_they_stand():
    frames = frames_of(read_robot_files(XACRO, YAML)).static_frames("physical", Time(1))
    found = {frame.child_frame_id: frame for frame in frames}
    assert {"physical/finger_left", "physical/finger_right", "physical/camera"} <= found.keys()
    assert found["physical/finger_right"].header.frame_id == "physical/palm"
    pose = pose_from_transform_msg(found["physical/finger_right"].transform)
    np.testing.assert_allclose(pose.position, (-0.03, 0.0, 0.06), atol=1e-12)
    np.testing.assert_allclose(pose.rotation, np.eye(3), atol=1e-12)
    turned = pose_from_transform_msg(found["physical/camera"].transform).rotation
    np.testing.assert_allclose(turned @ (0.0, 1.0, 0.0), (0.0, math.cos(0.4), math.sin(0.4)), atol=1e-12)


def test_every_tree_has_a_floating_joint_because_no_joint_state_holds_it():
    """joint_state_publisher leaves it out, and robot_state_publisher too; the others of the twin come from there."""
    frames = frames_of(gripper(changed("hinge", type="floating", limit=None)))
    twin = [(frame.header.frame_id, frame.child_frame_id) for frame in frames.unpublished_frames("twin", Time(1))]
    assert twin == [("world", "twin/base_link"), ("twin/palm", "twin/camera")]
    assert "more/camera" in {frame.child_frame_id for frame in frames.static_frames("more", Time(1))}


def test_a_follower_of_the_chain_moves_with_its_leader():
    robot = gripper(changed("hinge", mimic={"joint": "wrist_3", "multiplier": "2", "offset": "0.1"}))
    assert robot.other_joints[2] == OtherJoint("hinge", "revolute", None, "wrist_3", Following("wrist_3", 2.0, 0.1))
    frames = frames_of(robot)
    assert "p/camera" not in {frame.child_frame_id for frame in frames.static_frames("p", Time(1))}
    moving = {frame.child_frame_id: frame for frame in frames.moving_frames("p", Time(1), (0.0,) * 5 + (0.3,))}
    assert len(moving) == 7
    turned = pose_from_transform_msg(moving["p/camera"].transform).rotation
    np.testing.assert_allclose(turned @ (0.0, 1.0, 0.0), (0.0, math.cos(0.7), math.sin(0.7)), atol=1e-12)
    assert text(robot).endswith("; others move with it: hinge (revolute, moves with wrist_3)")


def test_fingers_are_bodies_of_the_last_link_at_their_pose():
    bodies = RobotBodies(read_robot_files(XACRO, YAML))
    named = {body.link: body for body in bodies.bodies}
    assert {"palm", "finger_left", "finger_right", "camera"} <= set(named)
    assert named["finger_left"].joint == named["palm"].joint == bodies.link_joints["tool0"]
    palm, left, right = (named[link].placement for link in ("palm", "finger_left", "finger_right"))
    np.testing.assert_allclose(palm.actInv(left.translation) - palm.actInv(right.translation), (0.08, 0, 0), atol=1e-9)
    chain = Chain(bodies.robot)
    tool = chain.forward(bodies.robot.home)
    finger = bodies.link_pose(bodies.robot.home, "finger_left")
    np.testing.assert_allclose(finger.position, tool.position + tool.rotation @ (0.03, 0.0, 0.06), atol=1e-9)


def test_open_fingers_touch_what_closed_ones_do_not():
    robot = gripper()
    tool = Chain(robot).forward(robot.home)
    beside = tool.position + tool.rotation @ (0.065, 0.0, 0.10)
    quaternion = tuple(map(float, pinocchio.Quaternion(tool.rotation).coeffs()))
    part = SceneObject("part", "box", (0.02, 0.02, 0.02), tuple(beside), quaternion)
    closed = CollisionWorld(robot, Scene((part,)), NONE)
    wide = CollisionWorld(gripper(slide_left=0.05), Scene((part,)), NONE)
    pair = Contact(("finger_left", "part"))
    assert pair not in closed.contacts(robot.home)
    assert pair in wide.contacts(robot.home)
