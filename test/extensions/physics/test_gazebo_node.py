"""The node `gazebo`: in which scene it becomes Gazebo's server. The server is a small program."""

from __future__ import annotations

import os
import sys

import pytest
import rospy
from executor_bench import ROBOT
from unplugged import Unplugged

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.extensions.physics.nodes import gazebo as module
from construction_twin.extensions.physics.nodes.gazebo import GazeboNode, Settings
from construction_twin.ros.messages.scene_convert import scene_to_msg
from construction_twin.scene.objects import Scene, SceneObject

SCENE = Scene((SceneObject("cube", "box", (0.1,) * 3, (1.0, 1.0, 1.0)),))


@pytest.fixture
def node(monkeypatch, tmp_path) -> GazeboNode:
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    for name in ("loginfo", "logerr", "signal_shutdown"):
        monkeypatch.setattr(rospy, name, lambda *_: None)
    settings = Settings(gzserver=f"{sys.executable} -I", drives="", realtime=7)
    return Unplugged(monkeypatch, module.NODE, settings, ROBOT).node


class Became(Exception):
    """In place of another program."""


@pytest.fixture
def become(monkeypatch):
    def other(program: str, words: list[str]) -> None:
        raise Became(program, *words)

    monkeypatch.setattr(os, "execvp", other)


def send_scene(node: GazeboNode, scene: Scene) -> None:
    node.on_scene(scene_to_msg(scene, rospy.Time(1), "base_link"))


def test_before_the_scene_is_known_it_waits(node):
    assert node.diagnose().sentence == "Gazebo is started when the scene is known"


def test_it_becomes_the_program_that_it_was_told_with_the_world_of_its_robot(node, become):
    send_scene(node, SCENE)
    with pytest.raises(Became) as became:
        node.run()
    program, *words, path = became.value.args
    assert (program, words) == (sys.executable, [sys.executable, "-I"])
    with open(path) as world:
        text = world.read()
    assert "<realtime>7</realtime>" in text and 'name="cube_' in text


def test_a_scene_that_cannot_be_simulated_is_reported_and_the_next_one_is_used(node, become, monkeypatch):
    made, world_of = [], module.world_of

    def make(bodies, scene, *more):
        made.append(scene.hash)
        if scene.objects:
            send_scene(node, Scene())
            raise ConstructionTwinError("no such mesh")
        assert node.diagnose().level == module.ERROR and "no such mesh" in node.diagnose().sentence
        return world_of(bodies, scene, *more)

    monkeypatch.setattr(module, "world_of", make)
    send_scene(node, SCENE)
    with pytest.raises(Became):
        node.run()
    assert made == [SCENE.hash, Scene().hash]


def test_of_several_scenes_the_newest_is_simulated_and_after_a_signal_none(node, become, monkeypatch):
    made, world_of = [], module.world_of

    def make(bodies, scene, *more):
        made.append(scene.hash)
        monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
        return world_of(bodies, scene, *more)

    monkeypatch.setattr(module, "world_of", make)
    send_scene(node, Scene())
    send_scene(node, SCENE)
    node.run()
    assert made == [SCENE.hash]
