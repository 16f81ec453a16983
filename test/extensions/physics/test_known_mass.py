from dataclasses import replace

import pytest
from physics_samples import bodies_of, robot_of

from construction_twin.extensions.physics.known_mass import body_of, masses_of
from construction_twin.extensions.physics.rehearsal import rigid_bodies
from construction_twin.scene.objects import Scene, SceneObject

TIP = robot_of("kr120").tip_link
SMALL = SceneObject("beam/0", "box", (0.1, 0.1, 0.1), (0.0, 0.0, 0.3), link=TIP)
LARGE = SceneObject("beam/1", "box", (0.1, 0.1, 0.3), (0.0, 0.0, 0.5), link=TIP)
STANDING = SceneObject("wall/0", "box", (0.1, 0.1, 0.3), (2.0, 0.0, 0.5))


def test_a_mass_is_divided_as_the_volumes_of_the_pieces_are():
    found = masses_of({"beam": 8.0, "wall": 5.0, "other": 1.0}, (Scene((SMALL, LARGE, STANDING)),), bodies_of("kr120"))
    assert found == pytest.approx({"beam/0": 2.0, "beam/1": 6.0})


def test_an_object_without_pieces_is_a_body():
    assert (body_of("beam/0"), body_of("tool/post"), body_of("link_6")) == ("beam", "tool", "link_6")


def test_pieces_are_one_body_while_they_are_together():
    whole = {"beam/0": "beam", "beam/1": "beam", "wall/0": "wall"}
    moved = [replace(item, link="", position=(1.0, y, 0.3)) for item, y in ((SMALL, 0.0), (LARGE, 0.2))]
    # turned by 90 deg about x, and set down: as they were to one another
    turned = [replace(item, quaternion=(-(0.5**0.5), 0.0, 0.0, 0.5**0.5)) for item in moved]
    together = Scene((LARGE, SMALL, STANDING))
    assert rigid_bodies((together, Scene(tuple(turned)), Scene())) == whole
    apart = {"beam/0": "beam/0", "beam/1": "beam/1", "wall/0": "wall"}
    standing = replace(LARGE, link="")
    for other in (
        Scene((SMALL,)),
        Scene((SMALL, standing)),
        Scene(tuple(moved)),
        Scene((SMALL, replace(LARGE, position=(0.0, 0.0, 0.501)))),
        Scene((SMALL, LARGE, replace(LARGE, name="beam/2"))),
    ):
        for scenes in ((together, other), (other, together)):
            assert {**rigid_bodies(scenes), "beam/2": ""} == {**apart, "beam/2": ""}
    # never together, however alike the scenes are
    assert rigid_bodies((Scene((SMALL, standing)),) * 2) == {"beam/0": "beam/0", "beam/1": "beam/1"}
