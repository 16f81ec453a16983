"""Failures that were sent as files end as their sentence says, and files that are none are refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from construction_twin.replay import PLANNED, main, model_failure, replay

FILES = sorted((Path(__file__).parents[2] / "data" / "failures").glob("*.json"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_failure_ends_as_it_is_expected_to(file):
    document = json.loads(file.read_text())
    # `sentence` is how it ended then, `expected` how it has to end since it was mended
    assert replay(document) == document.get("expected", document["sentence"])


def test_what_ends_otherwise_than_then_is_told_by_the_exit_code(tmp_path, capsys):
    document = json.loads(next(file for file in FILES if file.stem == "through_a_plate").read_text())
    file = tmp_path / "failure.json"
    for scene, code, now in (
        (document["scene"], 0, document["sentence"]),
        (document["scene"] | {"objects": []}, 1, PLANNED),
    ):
        file.write_text(json.dumps(document | {"scene": scene}))
        assert main([str(file)]) == code
        assert capsys.readouterr().out == f"then: {document['sentence']}\nnow:  {now}\n"


def test_a_mesh_of_the_scene_comes_with_the_file(tmp_path):
    from planning_cell import HOME, REQUEST, ROBOT, SELF_COLLISION
    from scene_samples import box_triangles, write_stl

    from construction_twin.planning.pipeline import PlanningPipeline
    from construction_twin.replay import failure, request_json
    from construction_twin.robot.motion_errors import PlanningError
    from construction_twin.scene.objects import Scene, SceneObject

    mesh = tmp_path / "wall.stl"
    write_stl(mesh, box_triangles((0.2, 4.0, 3.0)))
    document = json.loads(next(file for file in FILES if file.stem == "through_a_plate").read_text())
    pipeline = PlanningPipeline(ROBOT, self_collision=SELF_COLLISION)
    pipeline.set_scene(Scene((SceneObject("wall", "mesh", position=(1.2, 0.0, 1.5), mesh=str(mesh)),)))
    with pytest.raises(PlanningError):
        pipeline.to_joints(tuple(HOME), tuple(HOME + 0.1), REQUEST)
    failed = pipeline.failed
    text = failure(
        "plan", failed.sentence, {}, **{key: document[key] for key in ("robot", "settings")}, **request_json(failed)
    )
    mesh.unlink()
    assert replay(json.loads(text)) == failed.sentence != PLANNED


def test_what_cannot_be_replayed_is_one_sentence(tmp_path, capsys):
    good = json.loads(FILES[0].with_name("goal_in_the_floor.json").read_text())
    file = tmp_path / "failure.json"
    for text, problem in (
        ("no JSON", "Expecting value"),
        ("[]", "cannot be replayed"),
        ('{"kind": "dream"}', "expected one of plan, hold, model"),
        (json.dumps(good | {"request": {"method": "__init__", "arguments": {}}}), "method: found '__init__'"),
        (json.dumps(good | {"scene": {"record": "Popen"}}), "record: found 'Popen'"),
    ):
        file.write_text(text)
        assert main([str(file)]) == 2
        error = capsys.readouterr().err
        assert problem in error and error.count("\n") == 1
    assert main([str(tmp_path / "absent.json")]) == 2


def test_a_model_that_is_read_is_no_failure():
    with pytest.raises(Exception, match="one that is refused"):
        model_failure(Path(__file__).parents[3] / "models" / "timber_panel.ifc")
