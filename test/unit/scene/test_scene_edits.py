"""The scene's file: what a scene node keeps of its edits, and when it must not go on with it."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import FLOOR, box_triangles, clutter, write_stl

from construction_twin.robot.motion_errors import SceneError
from construction_twin.ros.nodes.scene import SceneFile
from construction_twin.scene.objects import Scene, SceneObject

START = Scene((FLOOR,), 0.02)
WALL = SceneObject("wall", "box", (0.1, 2.0, 2.0), (1.8, 0.0, 1.0), touch=("floor",))


def scene_file(tmp_path, run="run-1", start=START) -> SceneFile:
    return SceneFile(tmp_path / "home" / "scene_edits.json", run, start)


def test_the_same_run_goes_on_after_its_last_edit(tmp_path):
    assert scene_file(tmp_path).load() == START
    for scene in (START.add(WALL), START, START.add(WALL).attach("wall", "tool0", WALL.pose, ("link_6",))):
        scene_file(tmp_path).save(scene)
        assert scene_file(tmp_path).load() == scene
    assert len(list((tmp_path / "home").iterdir())) == 1


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 20))
def test_every_scene_comes_back_to_the_last_bit(seed, count, tmp_path_factory):
    file = scene_file(tmp_path_factory.mktemp("edits"))
    scene = clutter(seed, count)
    file.save(scene)
    assert file.load() == scene and file.load().hash == scene.hash


def test_another_run_begins_with_its_start(tmp_path):
    scene_file(tmp_path).save(START.add(WALL))
    other = replace(START, padding=0.05)
    assert scene_file(tmp_path, "run-2", other).load() == other


def test_the_same_run_with_another_start_is_refused(tmp_path):
    scene_file(tmp_path).save(START.add(WALL))
    with pytest.raises(SceneError, match="began as .* move the file away"):
        scene_file(tmp_path, start=replace(START, padding=0.05)).load()


def edited(tmp_path, change) -> SceneFile:
    file = scene_file(tmp_path)
    file.save(START.add(WALL))
    contents = json.loads(file.path.read_text())
    change(contents)
    file.path.write_text(json.dumps(contents))
    return file


@pytest.mark.parametrize(
    "change",
    [
        lambda contents: contents["objects"].pop(),
        lambda contents: contents.update(hash="0" * 64),
        lambda contents: contents.update(padding=0.0),
        lambda contents: contents["objects"][1].update(position=[1.9, 0.0, 1.0]),
        lambda contents: contents["objects"][1].update(size=[-1.0, 0.0, 1.0]),
        lambda contents: contents.update(colour="red"),
        lambda contents: contents.pop("run"),
    ],
)
def test_a_file_that_does_not_fit_is_never_ignored(change, tmp_path):
    with pytest.raises(SceneError, match=r"scene_edits.json.*move the file away"):
        edited(tmp_path, change).load()


@pytest.mark.parametrize("text", ["", "{", "[]", "\x00"])
def test_a_torn_file_is_refused(text, tmp_path):
    file = edited(tmp_path, lambda contents: None)
    file.path.write_text(text)
    with pytest.raises(SceneError, match="as the scene node writes it"):
        file.load()
    file.path.unlink()
    file.path.mkdir()
    with pytest.raises(SceneError, match="file that can be read"):
        file.load()


def test_a_mesh_that_changed_since_is_noticed(tmp_path):
    path = tmp_path / "part.stl"
    part = SceneObject("part", "mesh", mesh=write_stl(path, box_triangles((1, 1, 1))))
    scene_file(tmp_path).save(START.add(part))
    assert scene_file(tmp_path).load().names == ("floor", "part")
    write_stl(path, box_triangles((1, 1, 2)))
    with pytest.raises(SceneError, match="hash"):
        scene_file(tmp_path).load()


def test_an_edit_that_cannot_be_kept_is_refused_and_the_old_one_stays(tmp_path):
    (tmp_path / "home").write_text("not a folder")
    with pytest.raises(SceneError, match="would not survive a restart"):
        scene_file(tmp_path).save(START.add(WALL))
