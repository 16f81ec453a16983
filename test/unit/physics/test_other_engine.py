"""The same arm in another engine, DART: masses, gravity, and how it moves when nothing drives it."""

from xml.etree import ElementTree

import dartpy
import mujoco
import numpy as np
import pytest
from physics_samples import READY, model_of, robot_of
from scene_samples import random_poses

from construction_twin.physics.constants import GRAVITY
from construction_twin.physics.model import PhysicsModel


@pytest.fixture(scope="module", params=["kr120", "ur_like"])
def arms(request, tmp_path_factory) -> tuple[PhysicsModel, dartpy.simulation.World, dartpy.dynamics.Skeleton]:
    """An arm here and in DART, there without its shapes, and here without contacts."""
    root = ElementTree.fromstring(robot_of(request.param).urdf)
    for link in root.iterfind("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
        if link.find("inertial") is None:
            # DART gives 1 kg to a link of which nothing is said
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value="1e-9")
            moments = dict.fromkeys(("ixx", "iyy", "izz"), "1e-9") | dict.fromkeys(("ixy", "ixz", "iyz"), "0")
            ElementTree.SubElement(inertial, "inertia", moments)
    for joint in root.iterfind("joint"):
        for dynamics in joint.findall("dynamics"):
            joint.remove(dynamics)
    file = tmp_path_factory.mktemp("dart") / "arm.urdf"
    file.write_text(ElementTree.tostring(root, encoding="unicode"))
    options = dartpy.utils.DartLoaderOptions()
    options.mDefaultRootJointType = dartpy.utils.DartLoaderRootJointType.FIXED
    loader = dartpy.utils.DartLoader()
    loader.setOptions(options)
    skeleton = loader.parseSkeleton(str(file))
    assert [skeleton.getDof(number).getName() for number in range(6)] == list(robot_of(request.param).joint_names)
    world = dartpy.simulation.World()
    world.setGravity([0.0, 0.0, -GRAVITY])
    world.setTimeStep(0.001)
    world.addSkeleton(skeleton)
    physics = model_of(request.param)
    physics.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return physics, world, skeleton


def test_masses_and_gravity_are_the_same_in_dart(arms):
    physics, _, skeleton = arms
    product = np.zeros(physics.model.nv)
    for q in random_poses(physics.robot, 100):
        data = physics.at_rest(q)
        skeleton.setPositions(q)
        skeleton.setVelocities(np.zeros(6))
        mass = np.empty((6, 6))
        for column, unit in enumerate(np.eye(6)):
            mujoco.mj_mulM(physics.model, data, product, unit)
            mass[:, column] = product
        np.testing.assert_allclose(mass, skeleton.getMassMatrix(), rtol=1e-6, atol=1e-9 * np.abs(mass).max())
        gravity = skeleton.getGravityForces()
        np.testing.assert_allclose(data.qfrc_bias, gravity, rtol=1e-6, atol=1e-9 * np.abs(gravity).max())


def test_an_arm_that_nothing_drives_falls_as_in_dart(arms):
    physics, world, skeleton = arms
    begin = READY * 0.5
    data = physics.at_rest(begin)
    skeleton.setPositions(begin)
    skeleton.setVelocities(np.zeros(6))
    for number in range(6):
        skeleton.getJoint(number).setLimitEnforcement(False)
    for _ in range(300):
        mujoco.mj_step(physics.model, data)
        world.step()
    fallen = np.abs(data.qpos - begin).max()
    assert fallen > 0.2
    # two methods of integration, both of first order
    assert np.abs(data.qpos - skeleton.getPositions()).max() < 0.01 * fallen
