"""The message of `edit_scene`: asker and scene node agree on the scene after it, to the last bit. Needs no ROS master."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
import rospy
from construction_twin.srv import AddObjectRequest, EditSceneRequest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import ROOT, box_triangles, clutter, kr120, write_stl
from unplugged import Unplugged

from construction_twin.kinematics.chain import Pose
from construction_twin.ros.messages.scene_convert import object_from_msg, object_to_msg
from construction_twin.ros.nodes import scene as module
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.scene_change import SceneChange


def received(change: SceneChange) -> SceneChange:
    request = EditSceneRequest(put=list(map(object_to_msg, change.put)), remove=list(change.remove))
    buffer = io.BytesIO()
    request.serialize(buffer)
    request = EditSceneRequest().deserialize(buffer.getvalue())
    return SceneChange(tuple(map(object_from_msg, request.put)), tuple(request.remove))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_a_change_survives_to_the_last_bit(seed, count):
    rng = np.random.default_rng(seed)
    scene = clutter(seed, count)
    moved = tuple(
        item.moved(Pose(rng.normal(size=3), np.linalg.qr(rng.normal(size=(3, 3)))[0]), "tool0", ("link_6",))
        for item in clutter(seed + 1, count + 2).objects[2:]
        if rng.random() < 0.5
    )
    change = SceneChange(moved, ("object0",))
    assert received(change) == change
    assert received(change).apply(scene).hash == change.apply(scene).hash


def test_a_mesh_keeps_its_digest(tmp_path):
    piece = SceneObject("panel/0", "mesh", mesh=write_stl(tmp_path / "panel.stl", box_triangles((1, 1, 1))))
    change = SceneChange((piece,))
    assert received(change).apply(clutter()).hash == change.apply(clutter()).hash


def test_what_is_added_is_removed_by_name_or_with_all_that_is_not_fixed(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(7)))
    frames = SimpleNamespace(base="base", tf_name=lambda name: name or "base")
    monkeypatch.setattr(module, "listen_to_frames", lambda *_: frames)
    files = {"scene": str(ROOT / "config/scene.yaml"), "self_collision": str(ROOT / "config/kr120_self_collision.yaml")}
    settings = module.Settings(**files, tf_prefix="kr120/twin")
    robot = kr120()
    bench = Unplugged(monkeypatch, module.NODE, settings, robot, lambda *_: robot.home, {"/run_id": "run"})

    def edited(**fields):
        answer = bench.services["edit_scene"](EditSceneRequest(**fields))
        return answer.success, [item.name for item in bench.published["scene"][-1].objects]

    for name in ("a", "b", "c"):
        item = SceneObject(name, "sphere", (0.1,), (9.0, 9.0, 9.0))
        assert bench.services["add_object"](AddObjectRequest(object=object_to_msg(item))).success
        again = bench.services["add_object"](AddObjectRequest(object=object_to_msg(item)))
        assert not again.success and again.hash == bench.published["scene"][-1].hash
    assert edited(remove=["a"]) == (True, ["floor", "b", "c"])
    assert edited(remove=["a"])[0] is edited(remove=["b", "b"])[0] is edited(clear=True, before="0" * 64)[0] is False
    assert edited(clear=True, remove=["b"], put=[object_to_msg(item)]) == (True, ["floor", "c"])
