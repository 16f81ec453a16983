"""What touches whatever the joints do is told, with the way out: bases in objects, and links that no pose frees."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scene_samples import FLOOR, ROOT, kr120, kr120_pairs, track7, track7_pairs, ur_like, ur_like_pairs

from construction_twin.ros.nodes.scene import POSES, lasting_contacts
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_yaml import read_scene


def found(*objects, padding: float = 0.02, robot=ur_like, pairs=ur_like_pairs):
    return lasting_contacts(CollisionWorld(robot(), Scene(objects, padding), pairs()))


def floor(top: float, **keys) -> SceneObject:
    return replace(FLOOR, position=(0.0, 0.0, top - 0.5), **keys)


@pytest.mark.parametrize(
    "robot, pairs", [(kr120, kr120_pairs), (track7, track7_pairs), (ur_like, ur_like_pairs)], ids=["kr120", "track", "ur"]
)  # fmt: skip
def test_an_arm_that_stands_on_the_shipped_floor_is_in_order(robot, pairs):
    scene = read_scene(ROOT / "config/scene.yaml")
    assert scene.names == ("floor",)
    assert lasting_contacts(CollisionWorld(robot(), scene, pairs())) == []


def test_a_base_in_the_floor_says_how_deep_and_what_to_do():
    (contact,) = found(floor(0.03))
    assert (contact.name, contact.link, contact.moves) == ("floor", "pedestal", False)
    assert contact.distance == pytest.approx(-0.03, abs=1e-6)
    assert "object 'floor' and link 'pedestal' overlap by 30.0 mm; no joint moves the link" in contact.sentence
    assert "add `touch: [pedestal]` to the object" in contact.sentence


def test_what_the_object_may_touch_is_meant():
    assert found(floor(0.03, touch=("pedestal",))) == []


def test_a_link_that_every_pose_leaves_in_contact_means_that_nothing_can_be_planned():
    # the shoulder turns in place, and so does the hinge of the upper arm, 95 mm above the foot; what is kept reaches them
    contact, hinge = found(floor(0.0), padding=0.11)
    assert (contact.name, contact.link, contact.moves) == ("floor", "shoulder", True)
    assert (contact.distance, hinge.distance) == pytest.approx((0.095, 0.095), abs=1e-6)
    told = "link 'shoulder' are apart by 95.0 mm, expected 110.0 mm of clearance, in every pose"
    assert told in contact.sentence and "add `touch: [shoulder]` to the object" in contact.sentence
    assert found(floor(0.0, touch=("shoulder", "upper_arm")), padding=0.11) == []


def test_a_link_inside_of_an_object_overlaps():
    contacts = found(floor(0.2))
    assert [(contact.link, contact.moves) for contact in contacts][:2] == [("pedestal", False), ("shoulder", True)]
    depth = -contacts[1].distance * 1e3
    assert depth > 0.0 and f"overlap by {depth:.1f} mm, expected 20.0 mm of clearance" in contacts[1].sentence


def test_an_object_that_some_pose_frees_is_not_told():
    at_home = SceneObject("post", "box", (0.3, 0.3, 0.3), (0.7, 0.17, 0.8))
    world = CollisionWorld(ur_like(), Scene((at_home,), 0.02), ur_like_pairs())
    assert world.contacts(ur_like().home), "the post is in the way at home"
    assert POSES >= 100 and lasting_contacts(world) == []


def test_what_a_link_carries_is_no_link():
    tool = SceneObject("tool", "box", (0.1, 0.1, 0.1), link="shoulder")
    names = {contact.link for contact in found(floor(0.2), tool)}
    assert "shoulder" in names and "tool" not in names


@pytest.mark.parametrize("path", ["none", ""])
def test_no_scene_is_a_scene_of_nothing(path):
    assert read_scene(path) == Scene()
