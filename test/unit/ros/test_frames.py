"""Frames of requests: a link by its URDF name is the robot's own; what is not known is refused with what is."""

from __future__ import annotations

import numpy as np
import pytest
import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped
from scene_samples import kr120

from construction_twin.ros.shared.frames import FrameError, Frames, StampError


def buffer_of(*frames: tuple[str, str, float]) -> tf2_ros.Buffer:
    """Return a buffer that was told of static frames: parent, child, height [m]."""
    buffer = tf2_ros.Buffer(debug=False)
    for parent, child, z in frames:
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id = parent
        transform.transform.translation.z, transform.transform.rotation.w = z, 1.0
        buffer.set_transform_static(transform, "test")
    return buffer


def frames_of(buffer: tf2_ros.Buffer, prefix: str = "kr120/twin") -> Frames:
    return Frames(kr120(), prefix, buffer)


TREE = (
    ("world", "kr120/twin/base_link", 0.5),
    ("kr120/twin/base_link", "kr120/twin/tool0", 2.0),
    ("world", "table", 1.5),
)


@pytest.mark.parametrize("frame", ["", "base_link", "/base_link", "kr120/twin/base_link", "/kr120/twin/base_link"])
def test_the_base_is_known_by_its_urdf_name_and_without_tf(frame):
    pose = frames_of(buffer_of()).in_base(frame, rospy.Time())
    assert not pose.position.any() and np.array_equal(pose.rotation, np.eye(3))


@pytest.mark.parametrize(
    "frame, z", [("tool0", 2.0), ("kr120/twin/tool0", 2.0), ("/tool0", 2.0), ("/table", 1.0), ("world", -0.5)]
)
def test_a_link_of_the_robot_is_where_the_twin_has_it_and_other_frames_where_tf_has_them(frame, z):
    assert frames_of(buffer_of(*TREE)).in_base(frame, rospy.Time()).position.tolist() == [0.0, 0.0, z]


def test_a_link_is_the_robot_s_own_where_another_tree_has_a_frame_of_that_name():
    """MoveIt's frame, or an arm without a prefix."""
    frames = frames_of(buffer_of(*TREE, ("world", "tool0", 9.0)))
    assert frames.in_base("tool0", rospy.Time()).position[2] == 2.0


@pytest.mark.parametrize("hours, where", [(2, "7200.0 s ahead of"), (-2, "7200.0 s behind")])
def test_a_stamp_of_another_clock_is_said_in_one_sentence(monkeypatch, hours, where):
    now = rospy.Time(1_790_000_000)
    monkeypatch.setattr(rospy.Time, "now", lambda: now)
    buffer = buffer_of(*TREE)
    moving = TransformStamped(child_frame_id="camera")
    moving.header.frame_id, moving.transform.rotation.w = "world", 1.0
    for moving.header.stamp in (now - rospy.Duration(1), now):
        buffer.set_transform(moving, "test")
    frames = frames_of(buffer)
    with pytest.raises(
        StampError, match=f"the stamp of 'camera' is {where} this machine's clock; set the sender's clock"
    ):
        frames.in_base("camera", now + rospy.Duration(3600 * hours))
    # what tf just has not heard yet is none
    with pytest.raises(FrameError, match="extrapolation"):
        frames.in_base("camera", now + rospy.Duration(0.5))
    for stamp in (now, rospy.Time()):
        assert frames.in_base("camera", stamp).position[2] == -0.5


def test_a_frame_that_is_not_known_is_refused_with_those_that_are():
    with pytest.raises(FrameError) as caught:
        frames_of(buffer_of(*TREE)).in_base("tabel", rospy.Time())
    said = str(caught.value)
    assert said.startswith("no transform from frame 'tabel' to 'kr120/twin/base_link': ")
    known = said.partition("; known are ")[2].split(", ")
    assert {"base_link", "tool0", "link_3", "table", "world"} <= set(known) and len(known) == len(set(known))
    assert "kr120/twin/tool0" not in known
