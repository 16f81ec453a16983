"""The same arm in DART: another engine's masses, gravity and motion."""

import dartpy
import numpy as np
import pytest
from physics_samples import READY, model_of, robot_of
from scene_samples import random_poses

import mujoco


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The KR 120 in DART, without shapes, whose files it would look for."""
    from xml.etree import ElementTree

    root = ElementTree.fromstring(robot_of("kr120").urdf)
    for link in root.iterfind("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    file = tmp_path_factory.mktemp("dart") / "kr120.urdf"
    file.write_text(ElementTree.tostring(root, encoding="unicode"))
    loader = dartpy.utils.DartLoader() if hasattr(dartpy.utils, "DartLoader") else dartpy.io.DartLoader()
    skeleton = loader.parseSkeleton(str(file))
    world = dartpy.simulation.World()
    world.setGravity([0.0, 0.0, -9.80665])
    world.setTimeStep(0.001)
    world.addSkeleton(skeleton)
    return world, skeleton
