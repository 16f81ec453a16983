"""The message of `edit_scene`: asker and scene node agree on the scene after it, to the last bit. Needs no ROS master."""

from __future__ import annotations

import io

import numpy as np
from construction_twin.srv import EditSceneRequest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import box_triangles, clutter, write_stl

from construction_twin.kinematics.chain import Pose
from construction_twin.ros.messages.scene_convert import object_from_msg, object_to_msg
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
