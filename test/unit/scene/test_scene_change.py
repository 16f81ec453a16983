"""scene.scene_change: several objects change at once, as planned or not at all."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import FLOOR, clutter

from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange

RACK = SceneObject("rack", "box", (1.0, 1.0, 0.5), (1.5, 0.0, 0.25), touch=("stud/0", "tool0"))
STUD = SceneObject("stud/0", "box", (0.06, 0.12, 2.4), (1.5, 0.0, 0.6), touch=("rack",))
CLADDING = SceneObject("stud/1", "box", (0.06, 0.02, 2.4), (1.5, 0.07, 0.6))
SCENE = Scene((FLOOR, RACK, STUD, CLADDING), 0.01)


def held(item: SceneObject) -> SceneObject:
    return replace(item, position=(0.0, 0.0, 0.1), link="tool0", touch=("link_6",))


def test_a_grip_takes_every_piece_at_once():
    change = SceneChange(put=(held(STUD), held(CLADDING)))
    after = change.apply(SCENE)
    assert {item.name: item.link for item in after.objects} == {
        "floor": "", "rack": "", "stud/0": "tool0", "stud/1": "tool0"
    }  # fmt: skip
    expected = SCENE.add(held(STUD), replace_existing=True).add(held(CLADDING), replace_existing=True)
    assert after.hash == expected.hash
    assert str(change) == "put 'stud/0' and 1 more"


def test_what_stays_forgets_what_goes_and_what_comes_again_is_another_object():
    gone = SceneChange(remove=("stud/0",)).apply(SCENE)
    assert gone.get("rack").touch == ("tool0",)
    assert gone.hash == SCENE.without(["stud/0"]).hash
    again = SceneChange(put=(STUD,), remove=("stud/0",)).apply(SCENE)
    assert again.get("rack").touch == ("tool0",) and again.get("stud/0") == STUD
    # put without removing it first keeps what others may touch
    assert SceneChange(put=(STUD,)).apply(SCENE) == SCENE


def test_a_fixed_object_that_is_replaced_stays_fixed():
    lower = replace(FLOOR, position=(0.0, 0.0, -0.6), fixed=False)
    assert SceneChange(put=(lower,)).apply(SCENE).get("floor") == replace(lower, fixed=True)
    assert not SceneChange(put=(lower,), remove=("floor",)).apply(SCENE).get("floor").fixed


def test_an_unknown_name_is_refused_and_the_scene_is_as_it_was():
    with pytest.raises(SceneError, match="'stud/7', expected one of the scene's .*'stud/0'.*nothing was changed"):
        SceneChange(put=(held(STUD),), remove=("rack", "stud/7")).apply(SCENE)
    many = Scene(tuple(replace(STUD, name=f"stud/{number}", touch=()) for number in range(100)))
    with pytest.raises(SceneError, match="one of the scene's 100 objects; nothing was changed"):
        SceneChange(remove=("rack",)).apply(many)


@pytest.mark.parametrize("change", [{"put": (STUD, held(STUD))}, {"remove": ("rack", "rack")}])
def test_a_name_twice_is_refused(change):
    with pytest.raises(SceneError, check=lambda error: error.expected == "each name once"):
        SceneChange(**change)


def test_another_scene_before_or_after_is_refused():
    change = SceneChange(put=(held(STUD),), remove=("stud/1",))
    after = change.apply(SCENE)
    assert change.apply_checked(SCENE, SCENE.hash, after.hash) == change.apply_checked(SCENE) == after
    with pytest.raises(SceneError, match=f"scene to change: .*{after.hash}.*{SCENE.hash}.*plan it anew"):
        change.apply_checked(after, SCENE.hash, after.hash)
    with pytest.raises(SceneError, match=f"after the change: .*{after.hash}.*{SCENE.hash}"):
        change.apply_checked(SCENE, SCENE.hash, SCENE.hash)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    put=st.sets(st.integers(0, 12), max_size=6),
    remove=st.sets(st.integers(0, 8), max_size=6),
)
def test_a_change_equals_its_edits_one_by_one(seed, put, remove):
    scene, other = clutter(seed, 9), {item.name: item for item in clutter(seed + 1, 13).objects}
    change = SceneChange(
        tuple(other[f"object{number}"] for number in sorted(put)), tuple(f"object{number}" for number in remove)
    )
    expected = scene
    for name in change.remove:
        expected = expected.without([name])
    for item in change.put:
        expected = expected.add(item, replace_existing=True)
    assert change.apply(scene).hash == expected.hash
